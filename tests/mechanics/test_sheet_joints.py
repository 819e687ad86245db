"""The joints between the nodes of a sheet: the paper's, and the one that keeps the length of an arc."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from plate_oracles import bodies_at

from mbfmu.mechanics import CompiledMechanism, Mechanism
from mbfmu.sheets import Geodesic, OutOfPlane
from mbfmu.util.errors import UserError


def hinged(joint: type[OutOfPlane | Geodesic], q: tuple[float, float, float]) -> tuple[Any, Any]:
    """Position and orientation of a node on its neighbor at the origin, s' = (0.3, 0, 0.4) m."""
    m = Mechanism()
    m.body("node", m.ground, joint(at=(0.3, 0.0, 0.4), start=q), mass=1.0, inertia=(1, 1, 1))
    compiled = CompiledMechanism(m)
    node = bodies_at(compiled, compiled.assembly.start_positions())[1]
    return node["r"].copy(), node["A"].copy()


def test_out_of_plane_joint_of_the_paper() -> None:
    """A = A_z A_x, r = s' + g' alpha."""
    r, A = hinged(OutOfPlane, (0.1, 0.5, -0.7))
    c, s, C, S = np.cos(0.5), np.sin(0.5), np.cos(-0.7), np.sin(-0.7)
    np.testing.assert_allclose(r, (0.3, 0.1, 0.4), atol=1e-16)
    np.testing.assert_allclose(
        A, np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array([[1, 0, 0], [0, C, -S], [0, S, C]]), atol=1e-15
    )


def test_geodesic_keeps_the_length_of_a_circular_arc_to_fourth_order() -> None:
    """An arc of length |s'| = 0.5 m that turns by phi ends sin(phi) / kappa along s'."""

    def error(phi: float) -> float:
        radius = 0.5 / phi
        r, A = hinged(Geodesic, (radius * (1.0 - np.cos(phi)), 0.6 * phi, -0.8 * phi))  # about the normal to s'
        np.testing.assert_allclose(
            A @ (0.6, 0.0, 0.8), (0.6 * np.cos(phi), np.sin(phi), 0.8 * np.cos(phi)), atol=phi**3
        )
        np.testing.assert_allclose(r[0] / 0.3, r[2] / 0.4, rtol=1e-14)
        return float(abs(r[0] / 0.6 - radius * np.sin(phi)))

    assert error(0.1) < 1e-6
    assert error(0.2) / error(0.1) == pytest.approx(16.0, rel=0.02)


@pytest.mark.parametrize(("start", "end"), [(0.02, -0.02), (0.02, 0.02), (0.0, 0.03), (-0.02, 0.05)])
def test_geodesic_keeps_the_length_of_any_cubic(start: float, end: float) -> None:
    """w(s) leaves its chord by slopes ``start`` and ``end``: it is longer by half the mean square of its slope."""
    s, weight = np.polynomial.legendre.leggauss(3)
    slope = start * (1 - s) * (-1 - 3 * s) / 4 + end * (1 + s) * (3 * s - 1) / 4
    shorter = 0.25 * weight @ slope**2
    turn = end - start
    r, _ = hinged(Geodesic, (-0.5 * start, 0.6 * turn, -0.8 * turn))  # leaves the parent along s'
    assert 1.0 - np.linalg.norm(r) / 0.5 == pytest.approx(shorter, rel=0.01)


def test_geodesic_does_not_turn_about_the_normal() -> None:
    """The rotation vector lies in the plane; bending and twist are its first terms."""
    for theta_z, theta_x in ((0.5, -0.7), (2.0, 1.0), (0.02, 0.03)):
        _, A = hinged(Geodesic, (0.1, theta_z, theta_x))
        skew = np.array([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]])
        assert abs(skew[1]) < 1e-15
        np.testing.assert_allclose(A @ A.T, np.eye(3), atol=1e-15)
        if theta_z < 0.1:
            np.testing.assert_allclose(0.5 * skew[[2, 0]], (theta_z, theta_x), rtol=1e-3)


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), (0.0, 0.1, 0.0)])
def test_geodesic_leads_somewhere_in_the_plane(at: Any) -> None:
    m = Mechanism()
    m.body("node", m.ground, Geodesic(at=at), mass=1.0)
    with pytest.raises(UserError, match="needs some way in the x-z plane"):
        CompiledMechanism(m)

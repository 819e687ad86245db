"""The public calls of a compiled mechanism: poses, mass matrix, inverse dynamics."""

from __future__ import annotations

import numpy as np
import pytest

from mbfmu.mechanics import CompiledMechanism, DistanceCutJoint, Mechanism, Revolute, rod


def chain(links: int, *, loop: bool = False) -> CompiledMechanism:
    """Links of 0.5 m suspended from the ground, their tip on a rod to the ground or free."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    body = m.ground
    for k in range(links):
        at = (0.5, 0.0, 0.0) if k else (0.0, 0.0, 0.0)
        body = m.body(
            f"link{k}", body, Revolute(at=at, start=0.3 - 0.02 * k, rate=0.1 * k), **rod(mass=1.0 + k, length=0.5)
        )
    if loop:
        m.cut("rod", DistanceCutJoint(at_a=(0.5, 0.0, 0.0), at_b=(0.2 * links, 1.0, 0.0), length=1.0), body, m.ground)
    return CompiledMechanism(m)


def test_poses_of_two_links() -> None:
    compiled, q = chain(2), np.array([0.3, -1.1])
    r, A = compiled.poses(0.0, q)
    np.testing.assert_allclose(r[2], [0.5 * np.cos(0.3), 0.5 * np.sin(0.3), 0.0], atol=1e-15)
    np.testing.assert_allclose(A[2][:, 0], [np.cos(-0.8), np.sin(-0.8), 0.0], atol=1e-15)
    compiled.poses(0.0, q + 1.0)
    assert r[2][0] == pytest.approx(0.5 * np.cos(0.3))  # a copy


@pytest.mark.parametrize("links", [3, 70])  # by matrices; as a large tree
@pytest.mark.parametrize("loop", [False, True])
def test_mass_matrix_is_that_of_the_kinetic_energy(links: int, loop: bool) -> None:
    compiled, random = chain(links, loop=loop), np.random.default_rng(3)
    q, v = compiled.assembly.start_positions(), random.normal(size=links)
    kinetic = compiled.energy(0.0, q, v) - compiled.energy(0.0, q, 0.0 * v)
    assert 0.5 * v @ compiled.mass_matrix(0.0, q) @ v == pytest.approx(kinetic, rel=1e-12)


@pytest.mark.parametrize("links", [3, 70])
def test_inverse_dynamics_is_affine_in_accelerations_and_multipliers(links: int) -> None:
    compiled, random = chain(links, loop=True), np.random.default_rng(4)
    q, v, a = compiled.assembly.start_positions(), random.normal(size=links), random.normal(size=links)
    bias = compiled.inverse_dynamics(0.0, q, v, np.zeros(links))
    inertia = compiled.mass_matrix(0.0, q) @ a
    scale = np.abs(inertia).max()
    np.testing.assert_allclose(compiled.inverse_dynamics(0.0, q, v, a) - bias, inertia, atol=1e-11 * scale)
    # a force along the rod on the tip: by virtual work, how far each coordinate moves the tip along it
    lam, step, pull = np.array([2.0]), 1e-6, np.zeros(links)

    def length(q: np.ndarray) -> float:
        r, A = compiled.poses(0.0, q)
        return float(np.linalg.norm(r[-1] + 0.5 * A[-1][:, 0] - [0.2 * links, 1.0, 0.0]))

    for k in range(links):
        ahead, behind = q.copy(), q.copy()
        ahead[k] += step
        behind[k] -= step
        pull[k] = 0.5 * (length(ahead) ** 2 - length(behind) ** 2) / (2.0 * step)  # of (d.d - L^2) / (2 L), L = 1 m
    found = compiled.inverse_dynamics(0.0, q, v, a, lam) - compiled.inverse_dynamics(0.0, q, v, a)
    np.testing.assert_allclose(found, 2.0 * pull, atol=1e-7 * np.abs(pull).max())

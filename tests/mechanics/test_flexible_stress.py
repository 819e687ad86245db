"""Stresses of bodies of meshes: a bar in bending and tension against closed forms."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.flexible.recovery import VON_MISES, von_mises

skfem = pytest.importorskip("skfem")
skfem_meshio = pytest.importorskip("skfem.io.meshio")

YOUNG, POISSON, DENSITY = 2e11, 0.3, 7800.0
LENGTH, HEIGHT = 1.0, 0.1  # of the bar of size 1; its section is a square


@cache
def bar(kind: str, size: float = 1.0) -> mb.FlexibleBody:
    """A bar along x, held at x = 0; the axis is y = z = 0."""
    across = np.linspace(-0.5, 0.5, 3) * HEIGHT * size
    axes = np.linspace(0.0, LENGTH * size, 9), across, across
    mesh = (skfem.MeshTet if kind == "tetrahedra" else skfem.MeshHex).init_tensor(*axes)
    ends = {"root": lambda x: x[:, 0] < 1e-9 * size, "tip": lambda x: x[:, 0] > (LENGTH - 1e-9) * size}
    material = {"density": DENSITY, "young": YOUNG, "poisson": POISSON}
    return mb.FlexibleBody.from_mesh(skfem_meshio.to_meshio(mesh), **material, interfaces=ends, modes=2, stresses=True)


def amplitudes(body: mb.FlexibleBody, wrench: Any) -> Any:
    """Static amplitudes under a force and a moment on the tip."""
    return body.interfaces["tip"].motion.T @ wrench / (body.modal_masses * body.frequencies**2)


def stress_at(body: mb.FlexibleBody, wrench: Any, *places: Any) -> Any:
    found = body.stress(amplitudes(body, wrench))
    return np.array([found[nearest(body, np.multiply(place, body.size))] for place in places])


def nearest(body: mb.FlexibleBody, place: Any) -> int:
    return int(np.linalg.norm(body.nodes - place, axis=1).argmin())


@pytest.mark.parametrize(
    ("kind", "size", "error"),
    [("hexahedra", 1e-3, 0.01), ("hexahedra", 1.0, 0.01), ("hexahedra", 1e3, 0.01), ("tetrahedra", 1.0, 0.03)],
)
def test_a_bar_has_the_stresses_of_its_closed_form(kind: str, size: float, error: float) -> None:
    """Bending M c / I at the top and the bottom, tension F / A, in the middle of the bar; errors of the mesh."""
    body, h = bar(kind, size), HEIGHT * size
    force = YOUNG * 1e-3 * h**2
    middle, top, bottom = (0.5, 0.0, 0.0), (0.5, 0.05, 0.0), (0.5, -0.05, 0.0)
    pulled = stress_at(body, [force, 0, 0, 0, 0, 0], middle, top, bottom)
    exact = np.zeros((3, 6))
    exact[:, 0] = force / h**2
    np.testing.assert_allclose(pulled, exact, rtol=0.0, atol=1e-3 * force / h**2)
    bent = stress_at(body, [0, force, 0, 0, 0, 0], top, bottom, middle)
    largest = force * 0.5 * size * 0.5 * h / (h**4 / 12.0)  # moment times distance over second moment of area
    exact = np.array([-largest, largest, 0.0])
    np.testing.assert_allclose(bent[:, 0], exact, rtol=0.0, atol=error * largest)
    np.testing.assert_allclose(bent[:, 1:3], 0.0, rtol=0.0, atol=error * largest)
    assert bent[2, 3] == pytest.approx(1.5 * force / h**2, rel=0.12)  # shear of a parabola, two cells across


def test_equivalent_stress() -> None:
    """Principal stresses of a random tensor, turned by a random rotation, have the same equivalent stress."""
    rng = np.random.default_rng(1)
    tensor = rng.normal(size=(3, 3))
    tensor = tensor + tensor.T
    s = np.linalg.eigvalsh(tensor)
    exact = np.sqrt(0.5 * ((s[0] - s[1]) ** 2 + (s[1] - s[2]) ** 2 + (s[2] - s[0]) ** 2))
    assert von_mises(tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]) == pytest.approx(exact, rel=1e-14)


def test_sensors_of_stress_are_those_of_the_amplitudes() -> None:
    body = bar("hexahedra")
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    handle = m.flexible_body("bar", m.ground, mb.Weld(), body)
    place = (0.5, 0.05, 0.0)
    for component in ("xx", "xy", VON_MISES):
        m.output(component, handle.stress(place, component))
    node = nearest(body, place)
    m.output("number", handle.stress(node))
    compiled = CompiledMechanism(m)
    p = amplitudes(body, [0, -1e4, 0, 0, 0, 0])
    out = np.zeros(len(compiled.outputs))
    compiled.observe(0.0, p, np.zeros(body.modes), np.zeros(body.modes), np.zeros(0), out)
    found = dict(zip([variable.name for variable in compiled.outputs], out.tolist(), strict=True))
    exact = body.stress(p)[node]
    assert found["xx"] == pytest.approx(exact[0], rel=1e-12)
    assert found["xy"] == pytest.approx(exact[3], abs=1e-12 * exact[0])
    assert found[VON_MISES] == found["number"] == pytest.approx(von_mises(exact), rel=1e-12)
    assert found["xx"] == pytest.approx(6.0 * 1e4 * 0.5 * LENGTH / HEIGHT**3, rel=0.01)


def test_the_surface_is_closed_and_seen_from_outside() -> None:
    """Its volume by the theorem of Gauss is that of the bar, and every edge belongs to two triangles."""
    for kind in ("hexahedra", "tetrahedra"):
        body = bar(kind)
        assert body.triangles is not None
        a, b, c = np.moveaxis(body.nodes[body.triangles], 1, 0)
        volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0
        assert volume == pytest.approx(LENGTH * HEIGHT**2, rel=1e-12)
        edges = np.sort(np.concatenate([body.triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])]))
        assert set(np.unique(edges, axis=0, return_counts=True)[1].tolist()) == {2}


def test_stresses_and_surface_are_saved(tmp_path: Path) -> None:
    body = bar("hexahedra")
    body.save(tmp_path / "bar.npz")
    found = mb.FlexibleBody.load(tmp_path / "bar.npz")
    np.testing.assert_array_equal(found.stress_shapes, body.stress_shapes)
    np.testing.assert_array_equal(found.triangles, body.triangles)
    content = dict(np.load(tmp_path / "bar.npz"))
    np.savez(tmp_path / "bad.npz", **(content | {"triangles": content["triangles"] + len(body.nodes)}))
    with pytest.raises(mb.UserError, match=r"array 'triangles' .* has unknown nodes"):
        mb.FlexibleBody.load(tmp_path / "bad.npz")


def test_stresses_that_do_not_exist_are_refused() -> None:
    body = bar("hexahedra")
    m = mb.Mechanism()
    handle = m.flexible_body("bar", m.ground, mb.Weld(), body)
    beam = m.flexible_body("beam", m.ground, mb.Weld(), mb.Beam(length=1.0, mass=1.0, bending_stiffness=1.0, modes=1))
    for ask, message in (
        (lambda: handle.stress(0, "x"), "component of the stress in 'bar' is 'x'; allowed: 'xx'"),
        (lambda: handle.stress(10**6), "node is 1000000; allowed: a number from 0 to"),
        (lambda: handle.stress((0.0, 1.0)), "node is"),
        (lambda: beam.stress(0), "stress of flexible body 'beam': it is a Beam"),
        (lambda: body.stress([1.0]), r"amplitudes have the shape \(1,\); allowed"),
    ):
        with pytest.raises(mb.UserError, match=message):
            ask()

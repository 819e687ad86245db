"""Mass properties of closed meshes: boxes, spheres and convex hulls, in all file formats, sizes and orientations."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import ConvexHull, Delaunay
from scipy.spatial.transform import Rotation

import mbfmu as mb
from mbfmu.mechanics.builder.mesh_inertia import volume_integrals
from mbfmu.util.mesh_files import TriangleMesh, read_mesh
from mbfmu.viewer import meshes

SIZE = (0.2, 0.3, 0.5)


def stl(points: np.ndarray, triangles: np.ndarray) -> bytes:
    corners = points[triangles].reshape(-1, 9)
    body = b"".join(struct.pack("<12fH", 0.0, 0.0, 0.0, *row, 0) for row in corners)
    return b"solid, as many programs begin their binary files".ljust(80) + struct.pack("<I", len(corners)) + body


def text_stl(points: np.ndarray, triangles: np.ndarray) -> bytes:
    lines = ["solid part"]
    for corners in points[triangles]:
        vertices = [f"  vertex {' '.join(map(repr, map(float, corner)))}" for corner in corners]
        lines += [" facet normal 0 0 0", " outer loop", *vertices, " endloop", " endfacet"]
    return "\n".join([*lines, "endsolid"]).encode()


def obj(points: np.ndarray, triangles: np.ndarray) -> bytes:
    lines = ["# part", *(f"v {' '.join(map(repr, map(float, point)))}" for point in points), "vn 0 0 1"]
    lines += ["f " + " ".join(f"{corner - len(points)}//1" for corner in triangle) for triangle in triangles]
    return "\n".join(lines).encode()


def saved(folder: Path, content: bytes, name: str = "part.stl") -> Path:
    path = folder / name
    path.write_bytes(content)
    return path


def box(size: Any = SIZE) -> tuple[np.ndarray, np.ndarray]:
    """Each face is divided into 2 x 2 x 2 triangles."""
    corners = np.array(meshes.box().points) * size
    mesh = meshes.box()
    a, b, c = (corners[mesh.triangles[:, k]] for k in range(3))
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    parts = np.concatenate([np.stack(part, axis=1) for part in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return parts.reshape(-1, 3), np.arange(3 * len(parts)).reshape(-1, 3)


def check(found: dict[str, Any], expected: dict[str, Any], rel: float = 1e-12) -> None:
    """Single precision of STL files is avoided by sizes that are multiples of a power of two."""
    inertia = np.asarray(expected["inertia"])
    inertia = np.diag(inertia) if inertia.ndim == 1 else inertia
    assert found["mass"] == pytest.approx(expected["mass"], rel=rel)
    np.testing.assert_allclose(found["com"], expected["com"], rtol=0.0, atol=rel)
    np.testing.assert_allclose(found["inertia"], inertia, rtol=0.0, atol=rel * np.abs(inertia).max())


@pytest.mark.parametrize(("write", "name"), [(stl, "p.stl"), (text_stl, "p.STL"), (obj, "p.obj")])
def test_a_box_has_the_mass_properties_of_its_closed_form(tmp_path: Path, write: Any, name: str) -> None:
    size = np.array((0.25, 0.5, 0.75))
    path = saved(tmp_path, write(*box(size)), name)
    check(mb.solid_mesh(path, density=1000.0), mb.box(mass=1000.0 * size.prod(), size=size))
    check(mb.solid_mesh(path, mass=3.0), mb.box(mass=3.0, size=size))


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3, -1.0, (1.0, -2.0, 3.0)])
def test_scaled_mirrored_rotated_and_shifted_meshes(tmp_path: Path, scale: Any) -> None:
    size, R, at = np.array((0.25, 0.5, 0.75)), Rotation.from_euler("xyz", (0.3, 0.2, 0.1)), (0.1, 0.2, 0.3)
    path = saved(tmp_path, stl(*box(size)))
    found = mb.solid_mesh(path, density=500.0, scale=scale, rotation=R, at=at)
    own = np.abs(size * scale)
    check(found, mb.box(mass=500.0 * own.prod(), size=own, rotation=R, com=at))


def test_a_sphere_converges_to_its_closed_form() -> None:
    """Second order in the size of the triangles."""
    errors = []
    for count in (20, 40, 80):
        polar = np.linspace(np.pi, 0.0, count + 1)[:, None, None]
        points = 0.5 * (np.sin(polar) * meshes.ring(2 * count) + np.cos(polar) * [0.0, 0.0, 1.0])
        mesh = meshes.grid(points, points)
        volume, center, second = volume_integrals(TriangleMesh(mesh.points, mesh.triangles))
        np.testing.assert_allclose(center, 0.0, atol=1e-15)
        inertia = np.trace(second) * np.eye(3) - second
        expected = mb.sphere(mass=np.pi / 6.0, radius=0.5)
        errors.append((volume / expected["mass"] - 1.0, inertia[2, 2] / expected["inertia"][2] - 1.0))
    orders = np.log2(np.abs(np.array(errors[:-1]) / np.array(errors[1:])))
    np.testing.assert_allclose(orders, 2.0, atol=0.05)


@pytest.mark.parametrize("seed", range(3))
def test_convex_hulls_agree_with_quadrature_over_tetrahedra(seed: int) -> None:
    """The rule with 4 points a tetrahedron is exact for polynomials of degree 2."""
    points = np.random.default_rng(seed).standard_normal((20, 3)) + 5.0
    hull = ConvexHull(points)
    triangles = hull.simplices.copy()
    a, b, c = (points[triangles[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    triangles[inward] = triangles[inward][:, ::-1]
    tetrahedra = points[Delaunay(points).simplices]
    volumes = np.abs(np.linalg.det(tetrahedra[:, 1:] - tetrahedra[:, :1])) / 6.0
    near, far = (5.0 + 3.0 * np.sqrt(5.0)) / 20.0, (5.0 - np.sqrt(5.0)) / 20.0
    weights = np.full((4, 4), far) + (near - far) * np.eye(4)
    x = np.einsum("ij,tjk->tik", weights, tetrahedra)
    center = np.einsum("t,tik->k", volumes, x) / (4.0 * volumes.sum())
    second = np.einsum("t,tik,til->kl", volumes, x - center, x - center) / 4.0
    found = volume_integrals(TriangleMesh(points, triangles))
    np.testing.assert_allclose(found[0], volumes.sum(), rtol=1e-13)
    np.testing.assert_allclose(found[1], center, rtol=1e-13)
    np.testing.assert_allclose(found[2], second, rtol=0.0, atol=1e-12 * second.max())


def test_polygons_of_obj_files_are_divided(tmp_path: Path) -> None:
    lines = ["v 0 0 0", "v 1 0 0", "v 1 1 0", "v 0 1 0", "f 1 2 3 4", "f 1/2 2/3/4 3//2"]
    mesh = read_mesh(saved(tmp_path, "\n".join(lines).encode(), "square.obj"))
    assert mesh.points.shape == (4, 3)
    assert mesh.triangles.shape == (3, 3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p, t: (p, t[1:]), "is not closed: 3 of "),
        (lambda p, t: (p, np.concatenate((t[:1, ::-1], t[1:]))), "is not closed: 3 of "),
        (lambda p, t: (p, t[:, ::-1]), "encloses a volume of -0.03 m"),
        (lambda p, t: (p * (1.0, 1.0, 0.0), t), "encloses a volume of 0 m|is not closed"),
        (lambda p, t: (p, t[:0]), "has 0 triangles"),
    ],
)  # fmt: skip
def test_meshes_that_enclose_no_solid_are_refused(tmp_path: Path, change: Any, message: str) -> None:
    with pytest.raises(mb.UserError, match=message):
        mb.solid_mesh(saved(tmp_path, stl(*change(*box()))), density=1.0)


@pytest.mark.parametrize(
    ("name", "content", "arguments", "message"),
    [
        ("part.stl", b"solid", {"density": 1.0}, "has 0 triangles"),
        ("part.stl", stl(*box())[:-100], {"density": 1.0}, "has 0 triangles"),
        ("part.dae", b"x", {"density": 1.0}, r"has the format '.dae'; allowed: .stl, .obj"),
        ("part.obj", b"v 1 2\nf 1 1 1", {"density": 1.0}, "cannot be read"),
        ("part.obj", b"v 1 2 3\nf 1 2 3", {"density": 1.0}, "points that do not exist"),
        ("part.stl", stl(*box()), {}, "density is None and mass is None; allowed: one of them"),
        ("part.stl", stl(*box()), {"density": 1.0, "mass": 1.0}, "allowed: one of them"),
        ("part.stl", stl(*box()), {"density": -1.0}, "density of mesh file"),
        ("part.stl", stl(*box()), {"density": 1.0, "scale": 0.0}, "scale of mesh file .* is 0.0; allowed: one number"),
    ],
)  # fmt: skip
def test_wrong_files_and_values_are_refused(
    tmp_path: Path, name: str, content: bytes, arguments: Any, message: str
) -> None:
    with pytest.raises(mb.UserError, match=message):
        mb.solid_mesh(saved(tmp_path, content, name), **arguments)
    with pytest.raises(mb.UserError, match="cannot be read: No such file"):
        mb.solid_mesh(tmp_path / "none.stl", density=1.0)

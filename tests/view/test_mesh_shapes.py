"""Shapes from mesh files, capsules and ellipsoids in pictures, pages and glTF files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scripts import NODE, evaluated

import mbfmu as mb
from mbfmu.util.mesh_files import TriangleMesh, read_mesh
from mbfmu.viewer import Motion, html, meshes
from mbfmu.viewer.drawing import draw
from mbfmu.viewer.gltf import glb
from mbfmu.viewer.images import Artist, Shot
from mbfmu.viewer.mesh_solids import MAX_TRIANGLES, with_fewer_triangles

TETRAHEDRON = "v 0 0 0\nv 2 0 0.1\nv 0 1.5 0.2\nv 0.3 0.2 1.1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"


@pytest.fixture
def part(tmp_path: Path) -> Path:
    path = tmp_path / "part.obj"
    path.write_text(TETRAHEDRON)
    return path


def mechanism(*shapes: Any) -> mb.Mechanism:
    m = mb.Mechanism()
    arm = m.body("arm", m.ground, mb.Floating(), mass=1.0)
    m.shape(arm, *shapes)
    return m


def motion_of(m: mb.Mechanism) -> Motion:
    count = len(m.bodies)
    return Motion(
        title="part",
        times=np.zeros(1),
        names=tuple(body.name for body in m.bodies),
        parents=(0,) * count,
        joints=("",) * count,
        r=np.zeros((1, count, 3), np.float32),
        e=np.tile(np.array((1.0, 0.0, 0.0, 0.0), np.float32), (1, count, 1)),
        p=np.zeros((1, 0), np.float32),
        outputs=(),
        values=np.zeros((1, 0)),
        arrows=(),
        forces=np.zeros((1, 0, 3), np.float32),
        picture=draw(m, 1.0),
    )


def placed_corners(picture: Any, part: Any) -> np.ndarray:
    """Corners of the triangles of a part, body axes."""
    solid = picture.meshes[int(part.solid.removeprefix("mesh"))]
    corners: np.ndarray = solid.corners() @ np.reshape(part.axes, (3, 3)) + part.at
    return corners


@pytest.mark.parametrize("scale", [1.0, 1e-3, (1.0, -2.0, 3.0)])
def test_a_mesh_is_drawn_where_its_file_and_its_placement_have_it(part: Path, scale: Any) -> None:
    R, at = Rotation.from_euler("xyz", (0.3, 0.2, 0.1)), (0.1, 0.2, 0.3)
    picture = draw(mechanism(mb.MeshFile(part, scale=scale, rotation=R, at=at, color="#ff0000", opacity=0.5)), 1.0)
    (own,) = (part for part in picture.parts if part.body == 1)
    assert (own.solid, own.color, own.opacity) == ("mesh0", "#ff0000", 0.5)
    mesh = read_mesh(part)
    expected = (mesh.points * scale) @ R.as_matrix().T + at
    found = placed_corners(picture, own)
    np.testing.assert_allclose(found, expected[mesh.triangles], rtol=0.0, atol=1e-4 * np.ptp(expected))
    box = picture.points()[1]
    np.testing.assert_allclose(box.min(axis=0), expected.min(axis=0), rtol=0.0, atol=1e-4 * np.ptp(expected))
    assert type(picture).from_dict(picture.as_dict()) == picture


def test_a_file_of_several_bodies_is_stored_once(part: Path) -> None:
    m = mechanism(mb.MeshFile(part), mb.MeshFile(part, at=(1, 0, 0)))
    picture = draw(m, 1.0)
    assert len(picture.meshes) == 1
    assert [own.solid for own in picture.parts if own.body == 1] == ["mesh0", "mesh0"]


def test_a_missing_file_gives_a_warning_and_the_default_picture(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match=r"none.stl' cannot be read: .*; body 'arm' is drawn without this shape"):
        picture = draw(mechanism(mb.MeshFile(tmp_path / "none.stl")), 1.0)
    assert {own.solid for own in picture.parts if own.body == 1} == {"sphere", "cylinder"}
    assert picture.meshes == ()


def test_capsules_and_ellipsoids_consist_of_unit_solids() -> None:
    capsule = mb.Capsule(radius=0.1, length=0.6, axis="x", at=(1, 0, 0))
    ellipsoid = mb.Ellipsoid(size=(0.2, 0.4, 0.6))
    parts = [own for own in draw(mechanism(capsule, ellipsoid), 1.0).parts if own.body == 1]
    assert [own.solid for own in parts] == ["cylinder", "sphere", "sphere", "sphere"]
    np.testing.assert_allclose([own.at for own in parts[1:3]], [(0.7, 0, 0), (1.3, 0, 0)], atol=1e-15)
    np.testing.assert_allclose(np.reshape(parts[3].axes, (3, 3)), np.diag((0.1, 0.2, 0.3)))


def test_meshes_of_many_triangles_are_drawn_with_fewer() -> None:
    """The volume of a sphere changes by less than the size of a cell relative to its diameter."""
    polar = np.linspace(np.pi, 0.0, 201)[:, None, None]
    points = np.sin(polar) * meshes.ring(400) + np.cos(polar) * [0.0, 0.0, 1.0]
    fine = meshes.grid(points, points)
    few = with_fewer_triangles(TriangleMesh(fine.points, fine.triangles))
    assert 500 < len(few.triangles) <= MAX_TRIANGLES < len(fine.triangles)
    a, b, c = np.moveaxis(few.points[few.triangles], 1, 0)
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0
    assert abs(volume) == pytest.approx(4.0 / 3.0 * np.pi, rel=1.0 / 24.0)


def test_pictures_and_files_contain_the_mesh(part: Path) -> None:
    motion = motion_of(mechanism(mb.MeshFile(part)))
    faces = Artist(motion, Shot())._faces(0)[0]
    corners = read_mesh(part).points[read_mesh(part).triangles]
    assert any(np.allclose(faces[k : k + 4, :3], corners, atol=1e-4) for k in range(len(faces) - 3))
    facets = meshes.facets(motion.picture.meshes[0])
    np.testing.assert_allclose(np.linalg.norm(facets.normals, axis=1), 1.0)
    a, b, c = np.moveaxis(facets.points[facets.triangles], 1, 0)
    assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0.0, "normals face outward"
    assert np.all(np.einsum("ij,ij->i", np.cross(b - a, c - a), facets.normals[::3]) > 0.0)
    assert b"arm" in glb(motion)[0]


@pytest.mark.skipif(NODE is None, reason="no node here, which the page's program is tested with")
def test_the_page_draws_and_picks_the_mesh(part: Path) -> None:
    motion = motion_of(mechanism(mb.MeshFile(part)))
    found = evaluated(
        """
        const scene = JSON.parse(block("scene"));
        const motion = new Motion(scene, await recorded());
        const meshes = [];
        const renderer = {
          solids: (mesh, count) => { meshes.push(mesh); return { data: new Float32Array(INSTANCE * count), count }; },
          update() {},
        };
        const figure = new Figure(renderer, scene, motion, scene.scale, scene.stops);
        figure.place(0);
        const own = figure.meshes.mesh0();
        return [own.indices.length, own.positions.length, picked(figure, [0.4, 0.3, 9], [0, 0, -1])];
        """,
        html.page(motion)[0],
    )
    assert found == [12, 36, 1]

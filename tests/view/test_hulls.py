"""Surfaces of bodies of finite elements in pictures, pages and files of other programs."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scripts import NODE, evaluated
from test_gltf import File
from test_page import scene_in

import mbfmu as mb
from mbfmu.viewer import Motion, html, hulls, images
from mbfmu.viewer.drawing import draw
from mbfmu.viewer.fields import colored, hull_fields
from mbfmu.viewer.gltf import glb
from mbfmu.viewer.motion import quaternions

skfem = pytest.importorskip("skfem")
skfem_meshio = pytest.importorskip("skfem.io.meshio")

FIGURE = """
const scene = JSON.parse(block("scene"));
const renderer = {
  solids: (mesh, count) => ({ data: new Float32Array(INSTANCE * count), count }),
  surface: (count) => ({ data: new Float32Array(VERTEX * count) }),
  update() {},
};
const motion = new Motion(scene, await recorded());
const figure = new Figure(renderer, scene, motion, scene.scale, scene.stops);
"""
TURN = Rotation.from_euler("xyz", (0.3, -0.5, 0.8))
PLACE = np.array((1.0, 2.0, -0.5))


@cache
def block(stresses: bool) -> mb.FlexibleBody:
    mesh = skfem.MeshHex.init_tensor(np.linspace(0, 1, 4), [0.0, 0.2], [0.0, 0.3])
    return mb.FlexibleBody.from_mesh(
        skfem_meshio.to_meshio(mesh),
        density=1000.0,
        young=1e9,
        poisson=0.3,
        interfaces={"root": lambda x: x[:, 0] < 1e-9},
        modes=3,
        stresses=stresses,
    )


def mechanism(stresses: bool) -> mb.Mechanism:
    """A block that moves, after a beam, whose amplitudes come first."""
    m = mb.Mechanism()
    m.flexible_body("beam", m.ground, mb.Weld(), mb.Beam(length=1.0, mass=1.0, bending_stiffness=1.0, modes=2))
    m.flexible_body("block", m.ground, mb.Floating(), block(stresses))
    return m


AMPLITUDES = np.array([[0.1, 0.2, 0.0, 0.0, 0.0], [0.3, -0.1, 0.02, -0.03, 0.05]])


def motion_of(stresses: bool = False) -> Motion:
    m = mechanism(stresses)
    bodies = len(m.bodies)
    r, A = np.tile(PLACE, (2, bodies, 1)), np.tile(TURN.as_matrix(), (2, bodies, 1, 1))
    return Motion(
        title="block",
        times=np.array([0.0, 1.0]),
        names=tuple(body.name for body in m.bodies),
        parents=tuple(body.parent for body in m.bodies),
        joints=("",) * bodies,
        r=r.astype(np.float32),
        e=quaternions(A).astype(np.float32),
        p=AMPLITUDES.astype(np.float32),
        outputs=(),
        values=np.zeros((2, 0)),
        arrows=(),
        forces=np.zeros((2, 0, 3), np.float32),
        picture=draw(m, 1.0),
    )


def exact_points(body: mb.FlexibleBody, scale: float) -> Any:
    used = np.unique(body.triangles)
    return PLACE + body.displaced(AMPLITUDES[1, 2:], scale)[used] @ TURN.as_matrix().T


def exact_values(body: mb.FlexibleBody, stresses: bool) -> Any:
    used, p = np.unique(body.triangles), AMPLITUDES[1, 2:]
    return body.von_mises_stress(p)[used] if stresses else np.linalg.norm(body.shapes[used] @ p, axis=1)


@pytest.mark.parametrize("stresses", [False, True])
def test_a_hull_has_the_displaced_nodes_and_their_values(stresses: bool, tmp_path: Path) -> None:
    body, motion = block(stresses), motion_of(stresses).scaled(4.0)
    motion.save(tmp_path / "motion.npz")
    assert Motion.load(tmp_path / "motion.npz").picture == motion.picture
    (hull,), (field,) = motion.picture.hulls, hull_fields(motion)
    np.testing.assert_allclose(motion.hull_points(hull, 1), exact_points(body, 4.0), atol=1e-5)
    values = exact_values(body, stresses)
    np.testing.assert_allclose(hull.values(AMPLITUDES[1, hull.modes]), values, atol=1e-5 * values.max())
    assert field.title == ("von Mises stress [Pa]" if stresses else "displacement [m]")
    assert (field.low, field.limit) == (0.0, pytest.approx(values.max(), rel=1e-5))
    images.write_png(motion, tmp_path / "block.png", 1.0, images.Shot(width=200, height=150))
    assert (tmp_path / "block.png").stat().st_size > 1000


def test_a_gltf_has_a_morph_target_for_every_mode() -> None:
    motion = motion_of()
    (hull,) = motion.picture.hulls
    file = File(glb(motion)[0])
    (mesh,) = [own for own in file.told["meshes"] if len(own.get("weights", ())) == 3]
    (primitive,) = mesh["primitives"]
    targets = np.array([file.array(target["POSITION"]) for target in primitive["targets"]])
    np.testing.assert_allclose(targets, np.reshape(hull.shapes, targets.shape), atol=1e-6)


@pytest.mark.skipif(NODE is None, reason="no node here, which the page's program is tested with")
@pytest.mark.parametrize("stresses", [False, True])
def test_the_page_draws_the_same_hull(stresses: bool) -> None:
    body, motion = block(stresses), motion_of(stresses).scaled(4.0)
    page = html.page(motion)[0]
    code = "figure.place(1.0); return { data: Array.from(figure.hulls[0].item.data), vertex: VERTEX };"
    found = evaluated(FIGURE + code, page)
    data = np.reshape(found["data"], (-1, found["vertex"]))
    points = exact_points(body, 4.0)
    np.testing.assert_allclose(data[:, :3], points, atol=1e-5)
    (field,) = scene_in(page)["hull_fields"]
    colors = colored(exact_values(body, stresses), field["limit"])
    np.testing.assert_allclose(data[:, 6:], colors, atol=1e-3)
    outside = np.einsum("ij,ij->i", data[:, 3:6], points - points.mean(axis=0))
    assert outside.min() > 0.0, "normals point out of the block"


def test_large_surfaces_are_drawn_with_fewer_triangles(monkeypatch: pytest.MonkeyPatch) -> None:
    """Points of one cell become their mean, also those of the modes, so that rigid motions remain."""
    monkeypatch.setattr(hulls, "MAX_HULL_TRIANGLES", 60)
    body = block(False)
    assert body.triangles is not None
    T = np.tile([1.0, 2.0, 3.0], (len(body.nodes), 1))
    triangles, (points, moved) = hulls.with_fewer_triangles(body.triangles, [body.nodes, T])
    assert 0 < len(triangles) <= 60 < len(body.triangles)
    assert triangles.max() < len(points) == len(moved)
    np.testing.assert_allclose(moved, T[: len(moved)], rtol=1e-14)

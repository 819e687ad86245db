"""Geometries of files are shapes of the bodies in pictures, at the places where MuJoCo has them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from imported_texts import INERTIAL, LINK, mjcf, written

import mbfmu as mb
from mbfmu.formats.compiler import compile_file
from mbfmu.formats.imported import model_of, source_code
from mbfmu.mechanics.shapes import Shape
from mbfmu.util.mesh_files import read_mesh

TETRAHEDRON = "v 0.4 0.4 0.4\nv 2.4 0.4 0.5\nv 0.4 1.9 0.6\nv 0.7 0.6 1.5\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
GEOMETRIES = """
<body name="a" pos="1 0 0" euler="0 0 40"><joint name="j" pos="0.1 0.2 0" axis="1 2 3"/>{inertial}
  <geom type="sphere" size="0.1" pos="1 2 3" rgba="1 0 0 1"/>
  <geom type="capsule" size="0.1" fromto="0 0 0 1 1 0" rgba="0 1 0 0.5"/>
  <geom type="cylinder" size="0.1 0.2" euler="10 20 30"/>
  <geom type="box" size="0.1 0.2 0.3" euler="10 20 30" pos="0.1 0 0"/>
  <geom type="ellipsoid" size="0.1 0.2 0.3" euler="30 20 10" material="blue"/>
  <geom type="mesh" mesh="part" pos="0.1 0.2 0.3" euler="10 20 30"/>
  <geom type="box" size="1 1 1" group="3"/><geom type="box" size="1 1 1" rgba="0 0 0 0"/>
</body><geom type="plane" size="1 1 1"/><geom type="box" size="0.5 0.5 0.5"/>
"""
ASSETS = '<asset><mesh name="part" file="part.obj" {}/><material name="blue" rgba="0 0 1 1"/></asset>'
KINDS = [mb.Sphere, mb.Capsule, mb.Cylinder, mb.Box, mb.Ellipsoid, mb.MeshFile]


def shapes_of(path: Path) -> tuple[Any, dict[str, list[Shape]]]:
    model = model_of(source_code(path)[0])
    found: dict[str, list[Shape]] = {}
    for body, shape in model.built().shapes:
        found.setdefault(body.name, []).append(shape)
    return model, found


@pytest.mark.parametrize("inertial", [INERTIAL, ""], ids=["given inertia", "inertia from shapes"])
@pytest.mark.parametrize("mesh", ["", 'scale="0.5 0.5 -0.5" refpos="0.1 0.2 0.3"', 'refquat="1 0.2 0.3 0.4"'])
def test_geometries_are_where_those_of_mujoco_are(tmp_path: Path, inertial: str, mesh: str) -> None:
    """MuJoCo moves the frames of meshes; its vertices in global axes are compared with those of the file."""
    written(tmp_path, TETRAHEDRON, "part.obj")
    path = written(tmp_path, mjcf(GEOMETRIES.format(inertial=inertial), ASSETS.format(mesh)))
    model, shapes = shapes_of(path)
    assert [type(shape) for shape in shapes["a"]] == KINDS
    assert [type(shape) for shape in shapes["ground"]] == [mb.Box]
    reference = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(reference)
    mujoco.mj_forward(reference, data)
    compiled = model.compile()
    compiled.place_bodies(0.0, data.qpos)
    motion = compiled.data.state.bodies[1]
    for shape, kind in zip(shapes["a"], (2, 3, 5, 6, 4, 7), strict=True):
        k = next(k for k in range(reference.ngeom) if reference.geom_type[k] == kind and reference.geom_bodyid[k] == 1)
        R = motion["A"] @ shape.axes()
        at = motion["r"] + motion["A"] @ np.asarray(shape.at, float)
        if isinstance(shape, mb.MeshFile):
            points = read_mesh(shape.path).points @ R.T + at
            vertices = reference.mesh_vert @ data.geom_xmat[k].reshape(3, 3).T + data.geom_xpos[k]
            order = [np.argsort(x @ (0.36, 0.48, 0.8)) for x in (points, vertices)]
            np.testing.assert_allclose(points[order[0]], vertices[order[1]], atol=1e-6)
            continue
        np.testing.assert_allclose(at, data.geom_xpos[k], atol=1e-14)
        G, size = data.geom_xmat[k].reshape(3, 3), reference.geom_size[k]
        if isinstance(shape, mb.Cylinder):
            np.testing.assert_allclose(R[:, 2], 2.0 * size[1] * G[:, 2], atol=1e-14)
        elif isinstance(shape, mb.Box | mb.Ellipsoid):
            factor = 2.0 if isinstance(shape, mb.Box) else 1.0
            np.testing.assert_allclose(R, factor * G * size, atol=1e-14)
    assert [shape.color for shape in shapes["a"]] == ["#ff0000", "#00ff00", "", "", "#0000ff", ""]
    assert shapes["a"][1].opacity == 0.5


def urdf(visual: str) -> str:
    joint = "<joint name='j' type='continuous'><parent link='a'/><child link='b'/><origin xyz='1 0 0'/></joint>"
    return (
        f"<robot name='r'><material name='red'><color rgba='1 0 0 0.25'/></material><link name='a'/>"
        f"<link name='b'>{LINK}{visual}</link>{joint}</robot>"
    )


SHAPES = {
    "box": ("<box size='0.1 0.2 0.3'/>", mb.Box, {"size": (0.1, 0.2, 0.3)}),
    "sphere": ("<sphere radius='0.2'/>", mb.Sphere, {"radius": 0.2}),
    "cylinder": ("<cylinder radius='0.2' length='3'/>", mb.Cylinder, {"radius": 0.2, "length": 3}),
    "mesh": ("<mesh filename='package://robot/meshes/part.obj' scale='1 2 3'/>", mb.MeshFile, {"scale": (1, 2, 3)}),
}


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("element", ["visual", "collision"])
def test_visuals_of_urdf_files_are_shapes(tmp_path: Path, name: str, element: str) -> None:
    """The pose is compared with that of the same element as a shape of contact, which MuJoCo reads."""
    solid, kind, sizes = SHAPES[name]
    folder = tmp_path / "robot" / "urdf"
    folder.mkdir(parents=True)
    (tmp_path / "robot" / "meshes").mkdir()
    written(tmp_path / "robot" / "meshes", TETRAHEDRON, "part.obj")
    pose, color = "<origin xyz='0.1 0.2 0.3' rpy='0.3 0.2 0.1'/>", "<material name='red'/>"
    path = written(folder, urdf(f"<{element}>{pose}<geometry>{solid}</geometry>{color}</{element}>"), "r.urdf")
    (shape,) = shapes_of(path)[1]["b"]
    assert type(shape) is kind
    for key, value in sizes.items():
        np.testing.assert_allclose(getattr(shape, key), value)
    assert (shape.color, shape.opacity) == ("#ff0000", 0.25)
    np.testing.assert_allclose(shape.at, (0.1, 0.2, 0.3))
    box = "<geometry><box size='2 2 2'/></geometry>"
    other = written(folder, urdf(f"<collision>{pose}{box}</collision>"), "other.urdf")
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, compile_file(other).model.geom_quat[0])
    R = R.reshape(3, 3)
    axes = shape.axes()
    if kind is mb.Cylinder:
        np.testing.assert_allclose(axes[:, 2], 3.0 * R[:, 2], atol=1e-14)
    elif kind is not mb.Sphere:
        np.testing.assert_allclose(axes, R * next(iter(sizes.values())), atol=1e-14)


def test_meshes_that_cannot_be_drawn_are_reported(tmp_path: Path) -> None:
    names = ("none.stl", "part.dae", "part.obj")
    written(tmp_path, "x", "part.dae")
    written(tmp_path, TETRAHEDRON, "part.obj")
    visuals = "".join(f"<visual><geometry><mesh filename='{name}'/></geometry></visual>" for name in names)
    code, found = source_code(written(tmp_path, urdf(visuals), "r.urdf"), strict=True)
    assert [d.text for d in found] == ["meshes are not drawn (none.stl, part.dae)"]
    assert 'mb.MeshFile(FOLDER / "part.obj")' in code

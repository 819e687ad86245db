"""Motions as binary glTF: read back, and held to the poses they were made of."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recording import recorded
from scipy.spatial.transform import Rotation

import mbfmu as mb
from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from mbfmu.util.errors import UserError
from mbfmu.viewer import gltf, meshes
from mbfmu.viewer.gltf import glb
from mbfmu.viewer.meshes import Mesh

COMPONENTS = {5126: "<f4", 5123: "<u2", 5125: "<u4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


class File:
    """A glTF as a program that follows the specification reads it."""

    def __init__(self, content: bytes) -> None:
        magic, version, length = struct.unpack_from("<4sII", content)
        assert (magic, version, length) == (b"glTF", 2, len(content))
        size, kind = struct.unpack_from("<I4s", content, 12)
        assert (kind, size % 4) == (b"JSON", 0)
        self.told: dict[str, Any] = json.loads(content[20 : 20 + size])
        rest, kind = struct.unpack_from("<I4s", content, 20 + size)
        self.numbers = content[28 + size :]
        assert (kind, rest) == (b"BIN\0", len(self.numbers))
        assert self.told["buffers"] == [{"byteLength": rest}]

    def array(self, k: int) -> np.ndarray:
        accessor = self.told["accessors"][k]
        view = self.told["bufferViews"][accessor["bufferView"]]
        kind, width = np.dtype(COMPONENTS[accessor["componentType"]]), WIDTHS[accessor["type"]]
        assert view["byteOffset"] % 4 == 0
        assert view["byteLength"] == kind.itemsize * width * accessor["count"]
        assert view["byteOffset"] + view["byteLength"] <= len(self.numbers)
        found = np.frombuffer(self.numbers, kind, accessor["count"] * width, view["byteOffset"]).reshape(-1, width)
        if "min" in accessor:
            assert np.array_equal(found.min(axis=0), np.array(accessor["min"], kind))
            assert np.array_equal(found.max(axis=0), np.array(accessor["max"], kind))
        return found

    def channel(self, node: int, path: str, frame: int) -> np.ndarray | None:
        animation = self.told["animations"][0]
        for channel in animation["channels"]:
            if channel["target"] == {"node": node, "path": path}:
                sampler = animation["samplers"][channel["sampler"]]
                frames = len(self.array(sampler["input"]))
                return self.array(sampler["output"]).reshape(frames, -1)[frame].astype(float)
        return None

    def local(self, node: int, frame: int) -> np.ndarray:
        own, whole = self.told["nodes"][node], np.eye(4)
        if "matrix" in own:
            return np.reshape(own["matrix"], (4, 4)).T
        defaults = {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0), "scale": (1.0, 1.0, 1.0)}
        place, turn, size = (
            own.get(path, default) if (moved := self.channel(node, path, frame)) is None else moved
            for path, default in defaults.items()
        )
        whole[:3, :3] = Rotation.from_quat(turn).as_matrix() * size
        whole[:3, 3] = place
        return whole

    def place(self, node: int, frame: int) -> np.ndarray:
        """The 4x4 matrix from a node's axes to the scene's."""
        for k, other in enumerate(self.told["nodes"]):
            if node in other.get("children", ()):
                return self.place(k, frame) @ self.local(node, frame)
        return self.local(node, frame)


def volume(mesh: Mesh) -> float:
    """Of what a mesh encloses: negative, if its triangles face inward."""
    a, b, c = (mesh.points[mesh.triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


@pytest.mark.parametrize(
    ("mesh", "exact"),
    [
        (meshes.sphere(), 4.0 / 3.0 * np.pi),
        (meshes.cylinder(), np.pi),
        (meshes.box(), 1.0),
        (meshes.coil(0.1), 2.0 * np.pi * (meshes.COIL_TURNS - 1) * np.pi * 0.16**2 * 0.1),
    ],
    ids=["sphere", "cylinder", "box", "coil"],
)
def test_solids_are_closed_and_face_outward(mesh: Mesh, exact: float) -> None:
    assert volume(mesh) == pytest.approx(exact, rel=0.2 if exact < 1.0 else 0.04)
    assert np.linalg.norm(mesh.normals, axis=1) == pytest.approx(np.ones(len(mesh.normals)))
    a, b, c = (mesh.points[mesh.triangles[:, k]] for k in range(3))
    faces = np.cross(b - a, c - a)
    normals = mesh.normals[mesh.triangles].mean(axis=1)
    assert np.einsum("ij,ij->i", faces, normals).min() > -1e-12  # at the ends of a coil its wire is flat


@pytest.mark.parametrize("model", [FourBar(), Governor(), SwingPendulum()], ids=["fourbar", "governor", "pendulum"])
def test_nodes_go_where_the_bodies_went(model: mb.Model) -> None:
    _, motion = recorded(model, 0.2)
    content, stride = glb(motion)
    file = File(content)
    assert stride == 1
    names = [node.get("name") for node in file.told["nodes"]]
    for body, name in enumerate(motion.names):
        node = 1 + body
        assert names[node] == name
        for frame in (0, 7, 20):
            whole = file.place(node, frame)
            assert whole[:3, 3] == pytest.approx(motion.r[frame, body], abs=1e-6)  # y is up in these models
            assert whole[:3, :3] @ (1.0, 2.0, 3.0) + whole[:3, 3] == pytest.approx(
                motion.point(body, (1.0, 2.0, 3.0))[frame, 0], abs=1e-5
            )
    animation = file.told["animations"][0]
    times = file.array(animation["samplers"][0]["input"])
    assert "min" in file.told["accessors"][animation["samplers"][0]["input"]]
    assert times.ravel() == pytest.approx(motion.times, abs=1e-6)
    links = [
        k for k, node in enumerate(file.told["nodes"]) if "mesh" in node and k in file.told["nodes"][0]["children"]
    ]
    for node, link in zip(links, motion.picture.links, strict=True):
        ends = [motion.point(body, at)[11, 0] for body, at in ((link.a, link.at_a), (link.b, link.at_b))]
        whole = file.place(node, 11)
        assert whole @ (0.0, 0.0, -0.5, 1.0) == pytest.approx((*ends[0], 1.0), abs=1e-5)
        assert whole @ (0.0, 0.0, 0.5, 1.0) == pytest.approx((*ends[1], 1.0), abs=1e-5)


def test_every_accessor_fits_and_positions_have_bounds() -> None:
    for model in (FourBar(coupler_modes=2), Governor()):
        file = File(glb(recorded(model, 0.1)[1])[0])
        for k in range(len(file.told["accessors"])):
            assert np.isfinite(file.array(k)).all()
        for mesh in file.told["meshes"]:
            for primitive in mesh["primitives"]:
                position = file.told["accessors"][primitive["attributes"]["POSITION"]]
                assert {"min", "max"} <= set(position)
                assert file.array(primitive["indices"]).max() < position["count"]


def test_parts_keep_their_place_and_colors_are_linear() -> None:
    _, motion = recorded(FourBar(), 0.1)
    file = File(glb(motion)[0])
    part = motion.picture.parts[-1]
    own = [file.told["nodes"][k] for k in file.told["nodes"][1 + part.body]["children"]][-1]
    assert np.reshape(own["matrix"], (4, 4))[:3, :3] == pytest.approx(np.reshape(part.axes, (3, 3)))
    assert own["matrix"][12:15] == pytest.approx(part.at)
    material = file.told["materials"][file.told["meshes"][own["mesh"]]["primitives"][0]["material"]]
    gray = int(part.color[1:3], 16) / 255.0
    assert material["pbrMetallicRoughness"]["baseColorFactor"][0] == pytest.approx(((gray + 0.055) / 1.055) ** 2.4)


def test_elastic_body_bends_by_its_modes() -> None:
    _, motion = recorded(FourBar(coupler_modes=2))
    motion = motion.scaled(10.0)
    file, bar = File(glb(motion)[0]), motion.picture.bars[0]
    (node,) = [k for k, node in enumerate(file.told["nodes"]) if node.get("name") == bar.name and "mesh" in node]
    (primitive,) = file.told["meshes"][file.told["nodes"][node]["mesh"]]["primitives"]
    points = file.array(primitive["attributes"]["POSITION"]).astype(float)
    moved = [file.array(target["POSITION"]).astype(float) for target in primitive["targets"]]
    weights = file.channel(node, "weights", 30)
    assert weights == pytest.approx(motion.p[30])
    assert np.abs(weights).max() > 1e-4
    bent = points + sum(w * own for w, own in zip(weights, moved, strict=True))
    assert volume(Mesh(points, points, file.array(primitive["indices"]).reshape(-1, 3).astype(int))) == pytest.approx(
        3.0 * bar.height * bar.width, rel=1e-5
    )
    for x, place in zip(bar.x, bar.axis(motion.p[30].astype(float), 10.0), strict=True):
        own = np.isclose(points[:, 0], x)
        assert bent[own].mean(axis=0)[1] == pytest.approx(place[1], abs=1e-5)


def sheet(up: str) -> mb.Mechanism:
    turned = np.eye(3) if up == "y" else Rotation.from_euler("x", 90.0, degrees=True).as_matrix()
    m = mb.Mechanism(gravity=turned @ (0.0, -9.81, 0.0))
    mb.add_sheet(
        m, "flag", length=0.3, width=0.2, thickness=1e-3, youngs_modulus=1e9, density=1000.0, grid=(4, 3),
        supports=[mb.Support("x0", "clamped")], rotation=turned,
    )  # fmt: skip
    m.output("energy", m.energy)
    return m


@pytest.mark.parametrize("up", ["y", "z"])
def test_sheet_is_a_skin_that_its_bodies_carry(tmp_path: Path, up: str) -> None:
    mb.view(sheet(up), tmp_path / "flag.glb", 0.05, interval=0.01)
    recorder = mb.viewer.Recorder()
    mb.simulate(sheet(up), 0.05, interval=0.01, watch=recorder)
    motion, file = recorder.motion("flag"), File((tmp_path / "flag.glb").read_bytes())
    (skin,) = file.told["skins"]
    (node,) = [node for node in file.told["nodes"] if "skin" in node]
    attributes = file.told["meshes"][node["mesh"]]["primitives"][0]["attributes"]
    joints, weights = file.array(attributes["JOINTS_0"]), file.array(attributes["WEIGHTS_0"])
    points = file.array(attributes["POSITION"])
    assert np.array_equal(weights, np.tile((1.0, 0.0, 0.0, 0.0), (12, 1)))
    turned = np.array([file.place(skin["joints"][j], 5) @ (*p, 1.0) for j, p in zip(joints[:, 0], points, strict=True)])
    bodies = np.array(motion.picture.skins[0].bodies).ravel()
    wanted = motion.r[5, bodies] if up == "y" else motion.r[5, bodies][:, [0, 2, 1]] * (1.0, 1.0, -1.0)
    assert turned[:, :3] == pytest.approx(wanted, abs=1e-6)


def test_large_motion_is_thinned_to_its_last_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    _, motion = recorded(FourBar(), 0.5)
    monkeypatch.setattr(gltf, "MAX_ANIMATION_BYTES", 2_000)
    content, stride = glb(motion)
    file = File(content)
    times = file.array(file.told["animations"][0]["samplers"][0]["input"]).ravel()
    assert stride > 1
    assert times[[0, 1, -1]] == pytest.approx(motion.times[[0, stride, -1]])


def test_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    _, motion = recorded(FourBar(), 0.05)
    with pytest.raises(UserError, match="cannot be written"):
        gltf.write_glb(motion, tmp_path / "no" / "x.glb")
    with pytest.raises(UserError, match="against requires an HTML page"):
        mb.view(motion, tmp_path / "x.glb", against=motion)

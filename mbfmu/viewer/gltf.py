"""A motion as a binary glTF 2.0: shapes and an animation that other programs show and render.

A node a body, with its parts beneath; one a link, which is stretched; a surface is a skin whose joints are the bodies;
a flexible body has a morph target a mode (its shortening by bending, of second order, and the colors of
hulls are left out).

The file is packed here: pygltflib would save about ten lines for seven further packages, and trimesh writes no
animations, skins and morph targets.
"""

from __future__ import annotations

import json
import struct
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.util.files import write_bytes

from . import meshes
from .camera import basis
from .hulls import Hull
from .meshes import Mesh
from .motion import Motion
from .picture import Link, Part

Array = NDArray[np.float64]

MAX_ANIMATION_BYTES = 14_000_000  # bytes of an animation
FLOAT_TYPE, SHORT_TYPE, INDEX_TYPE = 5126, 5123, 5125  # component types
ACCESSOR_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
CLOSED_SOLIDS = {"sphere": meshes.sphere, "cylinder": meshes.cylinder, "box": meshes.box}
UNIT_SOLIDS = CLOSED_SOLIDS | {"panel": meshes.panel}
VERTICES, INDICES = 34962, 34963  # what a part of the buffer is for


def write_glb(motion: Motion, path: Path) -> int:
    """Write the file; return the stride with which it takes frames (more than 1: it would have been too large)."""
    content, stride = glb(motion)
    write_bytes(path, content)
    return stride


def glb(motion: Motion) -> tuple[bytes, int]:
    """Return the file and the stride with which it takes frames."""
    size = 4 * len(motion.times) * (7 * len(motion.names) + 10 * len(motion.picture.links) + motion.p.shape[1])
    stride = ceil(size / MAX_ANIMATION_BYTES)
    seconds = (motion.times - motion.times[0]).astype(np.float32)
    frames = np.unique(np.append(np.arange(0, len(seconds), stride), len(seconds) - 1))
    frames = frames[np.diff(seconds[frames], prepend=-1.0) > 0.0]  # they must ascend in single precision too
    document = _Document(motion, frames)
    document.time = document.accessor(seconds[frames], bounds=True)
    for body in range(len(motion.names)):
        document.add_body(body)
    for part in motion.picture.parts:
        document.add_part(part)
    for link in motion.picture.links:
        document.add_link(link)
    for k in range(len(motion.picture.bars)):
        document.add_bar(k)
    for hull in motion.picture.hulls:
        document.add_hull(hull)
    for k in range(len(motion.picture.skins)):
        document.add_skin(k)
    return document.whole(), stride


class _Document:
    """A glTF on its way: node 0 turns up to y, then come the bodies in their order."""

    def __init__(self, motion: Motion, frames: NDArray[np.int64]) -> None:
        self.motion, self.frames = motion, frames
        self.time = -1
        turned = np.eye(4)
        turned[:3, :3] = basis(np.array(motion.picture.up))
        self.nodes: list[dict[str, Any]] = [{"name": motion.title}]
        if np.any(turned != np.eye(4)):
            self.nodes[0]["matrix"] = turned.T.ravel().tolist()
        self.content: dict[str, list[Any]] = {
            "accessors": [],
            "bufferViews": [],
            "meshes": [],
            "materials": [],
            "skins": [],
        }
        self.samplers: list[dict[str, Any]] = []
        self.channels: list[dict[str, Any]] = []
        self.scene = [0]
        self.buffer = bytearray()
        self.solids: dict[str, dict[str, Any]] = {}  # primitives without their material, by solid
        self.found: dict[tuple[str, str, float], int] = {}  # meshes by solid and look, materials by "" and look

    def accessor(self, values: Any, target: int = 0, bounds: bool = False) -> int:
        """Put an array (n,) or (n, components) into the buffer; return the number of its accessor."""
        array = np.asarray(values)
        if array.dtype.kind == "f":
            array, kind = array.astype("<f4"), FLOAT_TYPE
        else:
            array, kind = (array.astype("<u2"), SHORT_TYPE) if target == VERTICES else (array.astype("<u4"), INDEX_TYPE)
        view = {"buffer": 0, "byteOffset": len(self.buffer), "byteLength": array.nbytes}
        self.buffer += array.tobytes()
        self.buffer += bytes(-len(self.buffer) % 4)
        self.content["bufferViews"].append(view | ({"target": target} if target else {}))
        rows = array.reshape(len(array), -1)
        content: dict[str, Any] = {"bufferView": len(self.content["bufferViews"]) - 1, "componentType": kind}
        content |= {"count": len(rows), "type": ACCESSOR_TYPES[rows.shape[1]]}
        if bounds:
            content |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        self.content["accessors"].append(content)
        return len(self.content["accessors"]) - 1

    def material(self, color: str, both_sides: bool = False, opacity: float = 1.0) -> int:
        """Return the number of a plain material; glTF's colors are linear."""
        key = ("both" if both_sides else "", color, opacity)
        if key not in self.found:
            plain = np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
            linear = np.where(plain <= 0.04045, plain / 12.92, ((plain + 0.055) / 1.055) ** 2.4)
            look = {"baseColorFactor": [*linear.tolist(), opacity], "metallicFactor": 0.0, "roughnessFactor": 0.55}
            blended = {"alphaMode": "BLEND"} if opacity < 1.0 else {}
            self.content["materials"].append({"pbrMetallicRoughness": look, "doubleSided": both_sides} | blended)
            self.found[key] = len(self.content["materials"]) - 1
        return self.found[key]

    def primitive(self, mesh: Mesh) -> dict[str, Any]:
        """Put a mesh into the buffer."""
        position = self.accessor(mesh.points, VERTICES, bounds=True)
        normal = self.accessor(mesh.normals, VERTICES)
        found: dict[str, Any] = {"attributes": {"POSITION": position, "NORMAL": normal}}
        found["indices"] = self.accessor(mesh.triangles.ravel(), INDICES)
        if mesh.morphs:
            found["targets"] = [{"POSITION": self.accessor(morph, VERTICES, bounds=True)} for morph in mesh.morphs]
        return found

    def mesh(self, primitive: dict[str, Any], material: int) -> int:
        """Return the number of a new mesh."""
        self.content["meshes"].append({"primitives": [primitive | {"material": material}]})
        return len(self.content["meshes"]) - 1

    def solid(self, name: str, color: str, opacity: float = 1.0) -> int:
        """Return the mesh of a unit solid in a color."""
        if name not in self.solids:
            number = name.removeprefix("mesh")
            of_file = number != name
            mesh = meshes.facets(self.motion.picture.meshes[int(number)]) if of_file else UNIT_SOLIDS[name]()
            self.solids[name] = self.primitive(mesh)
        key = (name, color, opacity)
        if key not in self.found:
            self.found[key] = self.mesh(self.solids[name], self.material(color, name not in CLOSED_SOLIDS, opacity))
        return self.found[key]

    def node(self, parent: int, **node: Any) -> int:
        """Hang a new node on another; return its number."""
        self.nodes.append(node)
        self.nodes[parent].setdefault("children", []).append(len(self.nodes) - 1)
        return len(self.nodes) - 1

    def animate(self, node: int, path: str, values: NDArray[Any]) -> None:
        """Let a property of a node run through ``values`` (frames, components); what stays is set once."""
        if path != "weights":
            self.nodes[node][path] = values[0].astype(np.float32).tolist()
        if np.any(values != values[0]):
            self.samplers.append(
                {"input": self.time, "output": self.accessor(values if path != "weights" else values.ravel())}
            )
            self.channels.append({"sampler": len(self.samplers) - 1, "target": {"node": node, "path": path}})

    def add_body(self, body: int) -> None:
        """Add the frame of a body."""
        node = self.node(0, name=self.motion.names[body])
        self.animate(node, "translation", self.motion.r[self.frames, body])
        self.animate(node, "rotation", continuous_quaternions(self.motion.e[self.frames, body]))

    def add_part(self, part: Part) -> None:
        """Add what is fixed to a body."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = np.reshape(part.axes, (3, 3)).T, part.at
        mesh = self.solid(part.solid, part.color, part.opacity)
        self.node(1 + part.body, mesh=mesh, matrix=matrix.T.ravel().tolist())

    def add_link(self, link: Link) -> None:
        """Add a link: its node turns along it and takes its length."""
        a, b = (
            self.motion.point(body, at, self.frames)[:, 0] for body, at in ((link.a, link.at_a), (link.b, link.at_b))
        )
        size = np.linalg.norm(b - a, axis=1, keepdims=True)
        along = np.divide(b - a, size, out=np.tile((0.0, 0.0, 1.0), (len(a), 1)), where=size > 0.0)
        if link.solid == "coil":
            slender = link.radius / (float(size.mean()) or link.radius)
            mesh = self.mesh(self.primitive(meshes.coil(slender)), self.material(link.color))
        else:
            mesh = self.solid(link.solid, link.color)
        node = self.node(0, mesh=mesh)
        self.animate(node, "translation", 0.5 * (a + b))
        self.animate(node, "rotation", continuous_quaternions(rotations_onto(along)))
        self.animate(node, "scale", np.column_stack((np.full((len(a), 2), link.radius), size)))

    def add_bar(self, k: int) -> None:
        """Add a flexible body beneath its frame."""
        bar = self.motion.picture.bars[k]
        mesh = self.mesh(self.primitive(meshes.bar(bar, self.motion.scale)), self.material(bar.color))
        weights = self.motion.p[self.frames, bar.modes]
        self.content["meshes"][mesh]["weights"] = weights[0].tolist()
        self.animate(self.node(1 + bar.body, name=bar.name, mesh=mesh), "weights", weights)

    def add_hull(self, hull: Hull) -> None:
        """Add the surface of a body of finite elements beneath its frame."""
        mesh = self.mesh(self.primitive(meshes.hull(hull, self.motion.scale)), self.material(hull.color))
        weights = self.motion.p[self.frames, hull.modes]
        self.content["meshes"][mesh]["weights"] = weights[0].tolist()
        self.animate(self.node(1 + hull.body, name=hull.name, mesh=mesh), "weights", weights)

    def add_skin(self, k: int) -> None:
        """Add a surface that its bodies carry."""
        skin, first = self.motion.picture.skins[k], self.frames[0]
        nodes = np.array(skin.bodies).ravel()
        mesh = meshes.skin(skin, self.motion.r[first].astype(float), self.motion.e[first].astype(float))
        primitive = self.primitive(mesh)
        zero = np.zeros((len(nodes), 3))
        joints = np.column_stack((np.arange(len(nodes)), zero)).astype(int)
        primitive["attributes"]["JOINTS_0"] = self.accessor(joints, VERTICES)
        primitive["attributes"]["WEIGHTS_0"] = self.accessor(np.column_stack((zero[:, 0] + 1.0, zero)), VERTICES)
        self.content["skins"].append({"joints": [1 + int(body) for body in nodes], "skeleton": 0})
        own = {"name": skin.name, "mesh": self.mesh(primitive, self.material(skin.color, both_sides=True))}
        self.nodes.append(own | {"skin": len(self.content["skins"]) - 1})
        self.scene.append(len(self.nodes) - 1)  # its own place would not matter

    def whole(self) -> bytes:
        """Return the file: a header, the description and the numbers."""
        content: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "mbfmu"},
            "scene": 0,
            "scenes": [{"name": self.motion.title, "nodes": self.scene}],
            "nodes": self.nodes,
            "buffers": [{"byteLength": len(self.buffer)}],
            **{name: things for name, things in self.content.items() if things},
        }
        if self.channels:
            content["animations"] = [{"name": "motion", "samplers": self.samplers, "channels": self.channels}]
        text = json.dumps(content, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = ((b"JSON", text), (b"BIN\0", bytes(self.buffer)))
        body = b"".join(struct.pack("<I4s", len(content), kind) + content for kind, content in chunks)
        return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def continuous_quaternions(e: Array) -> Array:
    """Return unit quaternions (frames, 4), scalar last as glTF has them, from one to the next the short way."""
    e = np.asarray(e, float)
    flips = np.cumprod(np.where(np.einsum("ij,ij->i", e[1:], e[:-1]) < 0.0, -1.0, 1.0))
    e = e * np.concatenate(([1.0], flips))[:, None]
    return np.roll(e / np.linalg.norm(e, axis=1, keepdims=True), -1, axis=1)


def rotations_onto(along: Array) -> Array:
    """Return quaternions (n, 4), scalar first, that turn z onto unit vectors (n, 3)."""
    x, y, z = along.T
    e = np.stack((1.0 + z, -y, x, 0.0 * z), axis=1)
    e[z < -1.0 + 1e-9] = (0.0, 1.0, 0.0, 0.0)
    found: Array = e / np.linalg.norm(e, axis=1, keepdims=True)
    return found

"""MJCF of MuJoCo from the description of a mechanism."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from mbfmu.util.errors import UserError
from mbfmu.util.mesh_files import is_binary_stl, read_mesh

from .description import GROUND_NAME, Description, ImportedBody, ImportedJoint, Matrix, Vector
from .export_losses import ExportLosses
from .losses import listed, printable
from .names import Names
from .tree import rotation_about

LEAST_MASS = 2e-15  # kg and kg m^2, of bodies that move; MuJoCo requires more than 1e-15
LARGEST_IMPEDANCE = 0.95  # of constraints, dmax of solimp, by default
ROUNDING_RATIO = 1e-14  # of moments of inertia, relative to the largest one
MIN_MESH_POINTS, MAX_MESH_TRIANGLES = 4, 200_000  # of the meshes that MuJoCo reads
NEGLIGIBLE_INERTIA_RATIO = 1e-6  # of a change of a moment of inertia to the moment about the joints of the body
MAX_DEPTH = 490  # bodies in a row; the XML parser of MuJoCo reads up to 500 elements in a row
MJCF_TYPES = {"Revolute": "hinge", "Translational": "slide", "Spherical": "ball"}
GEOMETRIES = {"Box": "box", "Sphere": "sphere", "Ellipsoid": "ellipsoid", "Cylinder": "cylinder", "Capsule": "capsule"}


def text_of(values: Iterable[float]) -> str:
    """Return numbers as text that MuJoCo reads without a change."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def quaternion_of(R: Matrix) -> Vector:
    """Return the unit quaternion (4,), scalar first, of a rotation matrix."""
    from scipy.spatial.transform import Rotation

    found: Vector = Rotation.from_matrix(R).as_quat(canonical=True, scalar_first=True)
    return found


class MjcfWriter:
    """Elements of an MJCF file.

    Attributes
    ----------
    root
        Root element.
    """

    def __init__(self, description: Description, folder: Path, losses: ExportLosses) -> None:
        self.description, self.folder, self.losses = description, folder, losses
        self.bodies = {body.name: body for body in description.bodies}
        self.children: dict[str, list[ImportedBody]] = {}
        for body in description.bodies:
            self.children.setdefault(body.parent, []).append(body)
        self._check_depth()
        self.raised: list[str] = []
        self.sites, self.equalities = Names(frozenset()), Names(frozenset())
        self.points: dict[str, list[tuple[str, Vector, Matrix]]] = {}
        self.geometries: dict[str, list[dict[str, str]]] = {}
        self.root = Element("mujoco", model=description.name)
        SubElement(self.root, "compiler", angle="radian")
        SubElement(self.root, "option", gravity=text_of(description.gravity))
        self._add_geometries()
        world = SubElement(self.root, "worldbody")
        relations = self._relations()
        for point in description.points:
            self._site(point.body, point.name, point.at, np.eye(3))
        self._fill_body(world, GROUND_NAME)
        for body in self.children.get(GROUND_NAME, []):
            self._add_body(world, body)
        self.root.extend(relations)
        if self.raised:
            self.losses.note(
                f"inertias of bodies are changed by a negligible amount ({listed(self.raised)})",
                "MuJoCo requires principal moments above 1e-15 kg m^2",
            )

    def _check_depth(self) -> None:
        """Refuse chains that the XML parser of MuJoCo cannot read."""
        depths = {GROUND_NAME: 0}
        for body in self.description.bodies:
            depths[body.name] = depths[body.parent] + 1
        deepest = max(depths, key=lambda name: depths[name])
        if depths[deepest] > MAX_DEPTH:
            raise UserError(
                f"body {deepest!r} is the last of a chain of {depths[deepest]} bodies; allowed in MJCF: up to "
                f"{MAX_DEPTH}. Export a shorter chain, or an FMU"
            )

    def _site(self, body: str, name: str, at: Vector, axes: Matrix) -> str:
        """Add a point of a body; return its name."""
        own = self.sites.unique(name)
        self.points.setdefault(body, []).append((own, at, axes))
        return own

    # ---- bodies -----------------------------------------------------------------------------------------------------

    def _add_body(self, parent: Element, body: ImportedBody) -> None:
        """Add a body and those that it carries; bodies without mass between joints are parts of the next one."""
        chain = [body]
        while self._is_part_of_next(chain[-1]):
            chain += self.children[chain[-1].name]
        last = chain[-1]
        element = SubElement(parent, "body", name=last.name)
        poses = []  # of the joint frames, in the parent of the first one
        at, R = np.zeros(3), np.eye(3)
        for own in chain:
            at, R = at + R @ own.joint.at, R @ own.joint.rotation
            poses.append((at, R))
            at, R = move(own.joint, at, R)
        element.attrib |= {"pos": text_of(at), "quat": text_of(quaternion_of(R))}
        for own, (origin, axes) in zip(chain, poses, strict=True):
            self._add_joint(element, own, R.T @ (origin - at), R.T @ axes)
        self._add_inertia(element, last)
        self._fill_body(element, last.name)
        for child in self.children.get(last.name, []):
            self._add_body(element, child)

    def _is_part_of_next(self, body: ImportedBody) -> bool:
        """Whether a body without mass is only between two joints."""
        carried = self.children.get(body.name, [])
        if body.mass or np.any(body.inertia) or body.joint.kind == "Weld":
            return False
        used = body.name in self.points or body.name in self.geometries
        ends = used or len(carried) != 1 or not body.joint.has_one_coordinate
        if (ends or carried[0].joint.kind == "Weld") and self._carries_mass(body):
            return False
        if ends or carried[0].joint.kind in ("Weld", "Floating"):
            raise UserError(
                f"body {body.name!r} has a joint and no mass; allowed in MJCF: such bodies between two joints of one "
                "coordinate, to which nothing else is connected, or with a mass that is welded to them. Give it a mass "
                "and an inertia"
            )
        return True

    def _carries_mass(self, body: ImportedBody) -> bool:
        """Whether a body that is welded to this one has a mass."""
        welded = [child for child in self.children.get(body.name, []) if child.joint.kind == "Weld"]
        return any(child.mass or self._carries_mass(child) for child in welded)

    def _add_joint(self, element: Element, body: ImportedBody, at: Vector, axes: Matrix) -> None:
        """Add a joint at a point of the body whose frame it moves; ``axes`` are those of its joint frame."""
        joint = body.joint
        if joint.kind == "Weld":
            return
        if joint.kind == "Floating":
            if body.parent != GROUND_NAME:
                raise UserError(
                    f"joint {joint.name!r} has six degrees of freedom relative to body {body.parent!r}; allowed in "
                    "MJCF: relative to the ground"
                )
            SubElement(element, "freejoint", name=joint.name)
            return
        own = SubElement(element, "joint", name=joint.name, type=MJCF_TYPES[joint.kind])
        if joint.kind != "Translational" and np.any(at):
            own.set("pos", text_of(at))
        if joint.axis is None:
            if joint.start is not None and not np.array_equal(joint.start, (1.0, 0.0, 0.0, 0.0)):
                self.losses.add("starts", joint.name)
            return
        own.set("axis", text_of(axes @ joint.axis))
        values = {
            "ref": start_of(joint),
            "stiffness": joint.stiffness,
            "springref": joint.unloaded if joint.stiffness else 0.0,
            "damping": joint.damping,
            "frictionloss": joint.friction,
            "armature": joint.armature,
        }
        for key, value in values.items():
            if value or (key == "springref" and joint.stiffness):
                own.set(key, text_of([value]))
        if joint.lower is not None and joint.upper is not None:
            own.set("range", text_of((joint.lower, joint.upper)))
            if joint.stop_time:
                own.set("solreflimit", text_of((joint.stop_time / LARGEST_IMPEDANCE, 1.0)))

    def _add_inertia(self, element: Element, body: ImportedBody) -> None:
        """Add mass and inertia; moments that MuJoCo refuses because they are zero are changed by rounding errors."""
        if not body.mass and not np.any(body.inertia):
            return
        moments, axes = np.linalg.eigh(body.inertia)
        moves = body.joint.kind != "Weld"
        least = max(LEAST_MASS, ROUNDING_RATIO * moments[2]) if moves else 0.0
        raised = np.maximum(moments, least)
        raised[2] = min(raised[2], raised[0] + raised[1])
        own = SubElement(element, "inertial", pos=text_of(body.com), mass=text_of([max(body.mass, LEAST_MASS * moves)]))
        if np.any(np.abs(raised - moments) > ROUNDING_RATIO * moments[2]) or (moves and body.mass < LEAST_MASS):
            if self._is_negligible(body, moments):
                self.raised.append(printable(body.name))
            else:
                self.losses.add("inertias", body.name)
        if np.count_nonzero(body.inertia - np.diag(np.diag(body.inertia))) == 0 and np.array_equal(raised, moments):
            own.set("diaginertia", text_of(np.diag(body.inertia)))
            return
        axes = axes * np.sign(np.linalg.det(axes))
        own.attrib |= {"quat": text_of(quaternion_of(axes)), "diaginertia": text_of(raised)}

    def _is_negligible(self, body: ImportedBody, moments: Vector) -> bool:
        """Whether the least mass and inertia are small relative to those of a body about its joints."""
        places = (body.com, body.joint.at, *(child.joint.at for child in self.children.get(body.name, [])))
        inertia = max(moments[2], body.mass * max(float(place @ place) for place in places))
        return LEAST_MASS <= NEGLIGIBLE_INERTIA_RATIO * inertia and not 0.0 < body.mass < LEAST_MASS

    def _fill_body(self, element: Element, name: str) -> None:
        """Add the points and geometries of a body."""
        for attributes in self.geometries.get(name, []):
            SubElement(element, "geom", attributes)
        for site, at, axes in self.points.get(name, []):
            own = SubElement(element, "site", name=site, pos=text_of(at))
            if not np.array_equal(axes, np.eye(3)):
                own.set("quat", text_of(quaternion_of(axes)))
        lifts = [lift for lift in self.description.lifts if lift.body == name]
        if lifts:
            weight = -self.bodies[name].mass * self.description.gravity
            total = sum(float(lift.force @ weight) for lift in lifts) / float(weight @ weight)
            element.set("gravcomp", text_of([total]))

    # ---- relations --------------------------------------------------------------------------------------------------

    def _relations(self) -> list[Element]:
        """Return loops, couplings, springs and drives, and add the points that they need."""
        found = [Element("tendon"), Element("equality"), Element("actuator")]
        tendons, equalities, actuators = found
        for spring in self.description.springs:
            tendon = SubElement(tendons, "spatial", name=spring.name, springlength=text_of([spring.unloaded]))
            tendon.attrib |= {"stiffness": text_of([spring.stiffness]), "damping": text_of([spring.damping])}
            for name, at, end in ((spring.a, spring.at_a, "a"), (spring.b, spring.at_b, "b")):
                SubElement(tendon, "site", site=self._site(name, f"{spring.name}_{end}", at, np.eye(3)))
        for cut in self.description.cuts:
            self._add_cut(equalities, cut)
        for coupling in self.description.couplings:
            follower, leader = self.bodies[coupling.a].joint, self.bodies[coupling.b].joint
            c, x0 = coupling.coefficients, start_of(leader) - coupling.origin
            shifted = np.polynomial.Polynomial(c)(np.polynomial.Polynomial((x0, 1.0))).coef
            shifted = np.pad(shifted, (0, 5 - len(shifted)))
            shifted[0] -= start_of(follower)
            name = self.equalities.unique(coupling.name)
            own = SubElement(equalities, "joint", name=name, joint1=follower.name, joint2=leader.name)
            own.set("polycoef", text_of(shifted))
        for body in self.description.bodies:
            if body.joint.is_locked:
                name = self.equalities.unique(f"{body.joint.name}_lock")
                SubElement(equalities, "joint", name=name, joint1=body.joint.name)
        for equality in equalities.findall("joint"):
            if equality.get("joint2") is None:
                equality.set("polycoef", "0 0 0 0 0")
        for drive in self.description.drives:
            own = SubElement(actuators, "motor", name=drive.name, joint=drive.joint)
            if drive.gain != 1.0:
                own.set("gear", text_of([drive.gain]))
            if drive.limits is not None:
                own.set("forcerange", text_of(sorted(limit / drive.gain for limit in drive.limits)))
        return [element for element in found if len(element)]

    def _add_cut(self, equalities: Element, cut: Any) -> None:
        """Add a loop-closing joint; a hinge is two points on its axis."""
        offsets = [np.zeros(3)]
        if cut.kind == "RevoluteCutJoint":
            size = max(float(np.abs(cut.at_a).max()), float(np.abs(cut.at_b).max())) or 1.0
            offsets.append(np.array((0.0, 0.0, size)))
            self.losses.note(
                f"the hinge {cut.name} that closes a loop is two points on its axis",
                "One of six equations is redundant",
            )
        for number, offset in enumerate(offsets):
            suffix = f"_{number + 1}" if number else ""
            ends = [
                self._site(cut.a, f"{cut.name}{suffix}_a", cut.at_a + cut.rotation_a @ offset, cut.rotation_a),
                self._site(cut.b, f"{cut.name}{suffix}_b", cut.at_b + cut.rotation_b @ offset, cut.rotation_b),
            ]
            kind = "weld" if cut.kind == "WeldCutJoint" else "connect"
            name = self.equalities.unique(f"{cut.name}{suffix}")
            SubElement(equalities, kind, name=name, site1=ends[0], site2=ends[1])

    # ---- shapes -----------------------------------------------------------------------------------------------------

    def _add_geometries(self) -> None:
        """Add the geometries of all bodies, which have no mass and no contact."""
        assets = Element("asset")
        names: dict[tuple[str, str], str] = {}
        for shape in self.description.shapes:
            own = {"pos": text_of(shape.at), "quat": text_of(quaternion_of(shape.rotation))}
            if shape.file is not None:
                if not is_readable(shape.file):
                    self.losses.add("mesh formats", str(shape.file))
                    continue
                file = os.path.relpath(shape.file, self.folder)
                scale = text_of(np.broadcast_to(np.asarray(shape.size["scale"], float), (3,)))
                if (file, scale) not in names:
                    names[file, scale] = f"mesh{len(names) + 1}"
                    mesh = SubElement(assets, "mesh", name=names[file, scale], file=Path(file).as_posix(), scale=scale)
                    mesh.set("inertia", "shell")  # which flat meshes have, too
                own |= {"type": "mesh", "mesh": names[file, scale]}
            else:
                own |= {"type": GEOMETRIES[shape.kind], "size": text_of(half_sizes(shape.size))}
            own |= {"contype": "0", "conaffinity": "0", "mass": "0", "group": "1"}
            if shape.color or shape.opacity != 1.0:
                color = shape.color or "#808080"
                rgb = [int(color[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
                own["rgba"] = text_of((*rgb, shape.opacity))
            self.geometries.setdefault(shape.body, []).append(own)
        if len(assets):
            self.root.append(assets)


def is_readable(path: Path) -> bool:
    """Whether MuJoCo reads a mesh file: OBJ or binary STL."""
    mesh = read_mesh(path)
    if path.suffix.lower() == ".stl" and not is_binary_stl(path.read_bytes()):
        return False
    return len(mesh.points) >= MIN_MESH_POINTS and len(mesh.triangles) <= MAX_MESH_TRIANGLES


def start_of(joint: ImportedJoint) -> float:
    """Return the start of a joint of one coordinate."""
    return 0.0 if joint.start is None else float(joint.start[0])


def move(joint: ImportedJoint, at: Vector, R: Matrix) -> tuple[Vector, Matrix]:
    """Return the frame of a body in the start position, from its joint frame."""
    if joint.kind == "Floating" and joint.start is not None:
        from scipy.spatial.transform import Rotation

        turned = Rotation.from_quat(joint.start[3:], scalar_first=True).as_matrix()
        return at + R @ joint.start[:3], R @ turned
    if joint.axis is None:
        return at, R
    if joint.kind == "Translational":
        return at + R @ joint.axis * start_of(joint), R
    return at, R @ rotation_about(joint.axis, start_of(joint)) if start_of(joint) else R


def half_sizes(size: dict[str, Any]) -> Vector:
    """Return the sizes of a geometry of MuJoCo, which has half lengths."""
    if "size" in size:
        return 0.5 * np.asarray(size["size"], float)
    return np.array([size["radius"], *([0.5 * size["length"]] if "length" in size else [])], float)


def mjcf_of(description: Description, folder: Path, losses: ExportLosses) -> str:
    """Return the text of an MJCF file in a folder.

    Raises
    ------
    UserError
        A joint or a body has no counterpart.
    """
    root = MjcfWriter(description, folder, losses).root
    indent(root)
    return f"{tostring(root, encoding='unicode')}\n"

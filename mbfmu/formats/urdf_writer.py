"""URDF from the description of a mechanism."""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from .description import GROUND_NAME, Description, ImportedBody, ImportedJoint, Matrix, Vector
from .export_losses import ExportLosses
from .losses import listed
from .mjcf_writer import move, text_of
from .names import Names

STANDARD_GRAVITY = (0.0, 0.0, -9.81)  # m/s^2, of programs that read URDF
REST = np.array((0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))  # positions of a free joint, and at their end of a ball joint
UNLIMITED = 1e9  # N, N m, m/s and rad/s: URDF requires an effort and a velocity of joints with a range
URDF_TYPES = {
    "Weld": "fixed",
    "Revolute": "continuous",
    "Translational": "prismatic",
    "Spherical": "spherical",
    "Floating": "floating",
}
SOLIDS = {"Box": "box", "Sphere": "sphere", "Cylinder": "cylinder", "Capsule": "capsule", "MeshFile": "mesh"}


class UrdfWriter:
    """Elements of a URDF file.

    Attributes
    ----------
    root
        Root element.
    """

    def __init__(self, description: Description, folder: Path, losses: ExportLosses) -> None:
        self.description, self.folder, self.losses = description, folder, losses
        self.ground = "world"  # the name by which other programs recognize the ground; no body has it
        self.names = Names(frozenset({self.ground, *(body.name for body in description.bodies)}))
        self.joints = Names(frozenset(body.joint.name for body in description.bodies if not is_fixed(body.joint)))
        self.by_name = {body.name: body for body in description.bodies}
        self.root = Element("robot", name=description.name)
        self.limits = {drive.joint: drive for drive in description.drives}
        self._add_link(self.ground, None)
        for body in description.bodies:
            self._add_link(body.name, body)
            self._add_joint(body)
        for point in description.points:
            own = self.names.unique(point.name)
            SubElement(self.root, "link", name=own)
            name = self.joints.unique(f"{own}_fixed")
            joint = self._new_joint(name, "fixed", self._link(point.body), own)
            SubElement(joint, "origin", xyz=text_of(point.at))
        self._add_losses()

    def _link(self, body: str) -> str:
        """Return the name of the link of a body."""
        return self.ground if body == GROUND_NAME else body

    def _add_link(self, name: str, body: ImportedBody | None) -> None:
        """Add a link with its inertia and shapes."""
        link = SubElement(self.root, "link", name=name)
        if body is not None and (body.mass or np.any(body.inertia)):
            inertial = SubElement(link, "inertial")
            SubElement(inertial, "origin", xyz=text_of(body.com))
            SubElement(inertial, "mass", value=text_of([body.mass]))
            letters = [(i, j) for i in range(3) for j in range(i, 3)]
            SubElement(
                inertial,
                "inertia",
                {f"i{'xyz'[i]}{'xyz'[j]}": text_of([body.inertia[i, j]]) for i, j in letters},
            )
        for shape in self.description.shapes:
            if shape.body == (body.name if body is not None else GROUND_NAME):
                if shape.kind not in SOLIDS:
                    self.losses.add("shapes", name)
                    continue
                visual = SubElement(link, "visual")
                SubElement(visual, "origin", xyz=text_of(shape.at), rpy=text_of(angles_of(shape.rotation)))
                sizes = {key: text_of(np.atleast_1d(np.asarray(value, float))) for key, value in shape.size.items()}
                if shape.file is not None:
                    sizes["scale"] = text_of(np.broadcast_to(np.asarray(shape.size["scale"], float), (3,)))
                    sizes["filename"] = Path(os.path.relpath(shape.file, self.folder)).as_posix()
                SubElement(SubElement(visual, "geometry"), SOLIDS[shape.kind], sizes)
                if shape.color or shape.opacity != 1.0:
                    color = shape.color or "#808080"
                    rgb = [int(color[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
                    material = SubElement(visual, "material", name=f"color{len(list(self.root.iter('material'))) + 1}")
                    SubElement(material, "color", rgba=text_of((*rgb, shape.opacity)))

    def _new_joint(self, name: str, kind: str, parent: str, child: str) -> Element:
        """Add a joint between two links."""
        joint = SubElement(self.root, "joint", name=name, type=kind)
        SubElement(joint, "parent", link=parent)
        SubElement(joint, "child", link=child)
        return joint

    def _add_joint(self, body: ImportedBody) -> None:
        """Add the joint of a body."""
        own = body.joint
        kind = URDF_TYPES[own.kind]
        if own.kind == "Revolute" and own.lower is not None:
            kind = "revolute"
        at, R = own.at, own.rotation
        if own.is_locked:
            kind, (at, R) = "fixed", move(own, at, R)
        name = self.joints.unique(own.name or f"{body.name}_fixed") if is_fixed(own) else own.name
        joint = self._new_joint(name, kind, self._link(body.parent), body.name)
        SubElement(joint, "origin", xyz=text_of(at), rpy=text_of(angles_of(R)))
        if kind == "fixed":
            return
        if own.axis is not None:
            SubElement(joint, "axis", xyz=text_of(own.axis))
        if own.damping or own.friction:
            SubElement(joint, "dynamics", damping=text_of([own.damping]), friction=text_of([own.friction]))
        self._add_limit(joint, own)
        self._add_mimic(joint, body)
        is_rest = own.start is None or not np.any(own.start - (REST[-len(own.start) :] if len(own.start) > 1 else 0.0))
        if not is_rest:
            self.losses.add("starts", own.name)
        if own.stiffness:
            self.losses.add("springs", own.name)
        if own.armature:
            self.losses.add("armatures", own.name)

    def _add_mimic(self, joint: Element, body: ImportedBody) -> None:
        """Add the gear by which a joint follows another one."""
        for coupling in self.description.couplings:
            leader = self.by_name[coupling.b].joint
            if coupling.a == body.name and joint.find("mimic") is None and not leader.is_locked:
                offset, ratio = (
                    coupling.coefficients[0] - coupling.coefficients[1] * coupling.origin,
                    coupling.coefficients[1],
                )
                SubElement(joint, "mimic", joint=leader.name, multiplier=text_of([ratio]), offset=text_of([offset]))
            elif coupling.a == body.name:
                self.losses.add("mimics", coupling.name)

    def _add_limit(self, joint: Element, own: ImportedJoint) -> None:
        """Add the range of a joint and the limit of its drive."""
        drive = self.limits.get(own.name)
        effort = max(map(abs, drive.limits)) if drive is not None and drive.limits is not None else 0.0
        if own.lower is None and own.kind != "Translational" and not effort:
            return
        limit = SubElement(joint, "limit", effort=text_of([effort or UNLIMITED]), velocity=text_of([UNLIMITED]))
        if own.lower is not None and own.upper is not None:
            limit.attrib |= {"lower": text_of([own.lower]), "upper": text_of([own.upper])}

    def _add_losses(self) -> None:
        """Add what URDF cannot contain."""
        description, losses = self.description, self.losses
        for cut in description.cuts:
            losses.add("loops", cut.name)
        for coupling in description.couplings:
            if self.by_name[coupling.a].joint.is_locked:
                losses.add("mimics", coupling.name)
        light = [body.name for body in description.bodies if not body.mass and not is_fixed(body.joint)]
        thin = [body.name for body in description.bodies if body.mass and np.linalg.det(body.inertia) <= 0.0]
        for names, what in ((light, "mass"), (thin, "inertia about an axis")):
            if names:
                losses.note(
                    f"links have no {what} ({listed(names)})",
                    "URDF allows it, and `mbfmu import` reads it. MuJoCo and other programs refuse such links",
                )
        for spring in description.springs:
            losses.add("springs", spring.name)
        for lift in description.lifts:
            losses.add("forces", lift.name)
        for drive in description.drives:
            if drive.gain != 1.0:
                losses.add("inputs", drive.name)
        if not np.array_equal(description.gravity, STANDARD_GRAVITY):
            losses.add("gravity")
        if any(body.joint.kind == "Spherical" for body in description.bodies):
            losses.note("ball joints have the type spherical", "URDF does not define it; Bullet and MuJoCo read it")


def is_fixed(joint: ImportedJoint) -> bool:
    """Whether the type of a joint is ``fixed``."""
    return joint.kind == "Weld" or joint.is_locked


def angles_of(R: Matrix) -> Vector:
    """Return the angles (3,) about the fixed axes x, y, z of a rotation matrix."""
    from scipy.spatial.transform import Rotation

    found: Vector = Rotation.from_matrix(R).as_euler("xyz", suppress_warnings=True)
    return found


def urdf_of(description: Description, folder: Path, losses: ExportLosses) -> str:
    """Return the text of a URDF file in a folder."""
    root = UrdfWriter(description, folder, losses).root
    indent(root)
    return f"{tostring(root, encoding='unicode')}\n"

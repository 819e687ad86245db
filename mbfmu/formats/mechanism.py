"""Description of a mechanism that is built in Python, for the writers of MJCF and URDF.

Joints of several coordinates are described by bodies without mass between joints of one coordinate. The frame of a
described body is the joint frame that is fixed in it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbfmu.mechanics import (
    CompiledMechanism,
    Cylindrical,
    Floating,
    Gear,
    Mechanism,
    Planar,
    Polynomial,
    Revolute,
    RevoluteCutJoint,
    Spherical,
    SphericalCutJoint,
    Translational,
    Universal,
    Weld,
    WeldCutJoint,
)
from mbfmu.mechanics.arrays.assembly import free_bodies
from mbfmu.mechanics.axes import plane_axes, unit_axis
from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.checks import rotation
from mbfmu.mechanics.sensors import Coordinate, PointPosition
from mbfmu.mechanics.shapes import Box, Capsule, Cylinder, Ellipsoid, MeshFile, Shape, Sphere, scale_factors
from mbfmu.util.errors import UserError
from mbfmu.util.mesh_files import read_mesh

from .description import (
    GROUND_NAME,
    Description,
    ImportedBody,
    ImportedCoupling,
    ImportedCut,
    ImportedJoint,
    ImportedPoint,
    ImportedShape,
    Matrix,
    Vector,
)
from .export_losses import ExportLosses
from .losses import listed
from .mechanism_forces import add_forces, is_number
from .names import Names

CUTS = {SphericalCutJoint: "SphericalCutJoint", RevoluteCutJoint: "RevoluteCutJoint", WeldCutJoint: "WeldCutJoint"}
HINGE_KIND, SLIDE_KIND = "Revolute", "Translational"
NAMES_OF_GROUND = frozenset({"world", GROUND_NAME})  # of the ground: in MJCF and URDF, and in a description


class Step(NamedTuple):
    """Joint of one coordinate as a part of a joint: kind, axis in the joint frame, number of its coordinate."""

    kind: str
    axis: Vector
    coordinate: int


def steps_of(joint: Any) -> list[Step]:
    """Return the joints of one coordinate that a joint consists of, in the order from the parent."""
    if isinstance(joint, Revolute):
        return [Step(HINGE_KIND, joint.direction, 0)]
    if isinstance(joint, Translational):
        return [Step(SLIDE_KIND, joint.direction, 0)]
    if isinstance(joint, Universal):
        second = unit_axis(joint.second, "second axis")
        return [Step(HINGE_KIND, joint.direction, 0), Step(HINGE_KIND, second, 1)]
    if isinstance(joint, Planar):
        first, other = plane_axes(joint.direction)
        return [Step(SLIDE_KIND, first, 0), Step(SLIDE_KIND, other, 1), Step(HINGE_KIND, joint.direction, 2)]
    if isinstance(joint, Cylindrical):
        kinds = [SLIDE_KIND if unit == "m" else HINGE_KIND for unit in joint.units]
        return [Step(kind, joint.direction, k) for k, kind in enumerate(kinds)]
    return []


def constant_of(drive: Any) -> float | None:
    """Return the position in which a constant drive locks a joint; None: it moves."""
    if isinstance(drive, Polynomial) and len(drive.c) == 1:
        return float(drive.c[0])
    return float(drive) if is_number(drive) else None


def names_in_outputs(mechanism: Mechanism) -> dict[int, str]:
    """Return names of joints by the number of the body, from outputs of their coordinates such as ``elbow.angle``."""
    found: dict[int, str] = {}
    for name, sensor, *_ in mechanism.outputs:
        owner, is_body = name.rpartition(".")[0], isinstance(sensor.item, Body)
        if isinstance(sensor, Coordinate) and is_body and sensor.item.joint.nv == 1 and owner:
            found.setdefault(sensor.item.index, owner)
    names = list(found.values())
    others = {body.name for body in mechanism.bodies if body.index not in found}
    return {index: name for index, name in found.items() if names.count(name) == 1 and name not in others}


class Described:
    """Builds the description of a mechanism, with the start positions in which its loops are closed.

    Attributes
    ----------
    description
        Description.
    coordinates
        Described bodies and their joints, by the number of the body and of the coordinate.
    body_names, joint_names
        Names by the number of the body. Formats require that each body has another name, and each joint.
    limiters
        Names of blocks that are limits of drives.
    """

    def __init__(self, compiled: CompiledMechanism, name: str, losses: ExportLosses) -> None:
        self.mechanism = mechanism = compiled.mechanism
        self.losses = losses
        if mechanism.flexible_bodies or mechanism.meshes:
            raise UserError("the mechanism has flexible bodies or sheets; allowed: rigid bodies. Export an FMU instead")
        self.q: Vector | None = None  # of all joints, in the start position in which loops are closed
        if mechanism.cuts or mechanism.couplings:
            compiled.place_bodies(0.0, compiled.assemble()[0])
            self.q = np.array(compiled.data.state.q, float)
        self.first = [int(record["qi"]) for record in compiled.data.arrays.bodies]
        self.description = Description(name=name, source=name, origin="", gravity=np.array(mechanism.gravity, float))
        self._name_bodies_and_joints()
        self.coordinates: dict[tuple[int, int], tuple[str, ImportedJoint]] = {}
        self.limiters: set[str] = set()
        self.frames = [(np.zeros(3), np.eye(3))]  # of described bodies in the bodies of the mechanism
        for body in mechanism.bodies[1:]:
            self._add_body(body)
        for cut in mechanism.cuts:
            self._add_cut(cut)
        for coupling in mechanism.couplings:
            self._add_coupling(coupling)
        add_forces(self)
        self._set_stop_times(compiled)
        self._add_points()
        for body, shape in mechanism.shapes:
            self._add_shape(body, shape)
        self._add_rest()

    def name_of(self, body: Body) -> str:
        """Return the name of a body in the description."""
        return self.body_names[body.index] if body.index else GROUND_NAME

    def _name_bodies_and_joints(self) -> None:
        """Choose the names of bodies and joints; those of the parts of joints follow, since they can be changed."""
        self._bodies_named, self._joints_named = Names(NAMES_OF_GROUND), Names(frozenset())
        self.body_names: dict[int, str] = {}
        self.joint_names: dict[int, str] = {}
        in_outputs = names_in_outputs(self.mechanism)
        changed = []
        for body in self.mechanism.bodies[1:]:
            own = self.body_names[body.index] = self._bodies_named.unique(body.name)
            if own != body.name:
                changed.append(f"{body.name} to {own}")
            given = in_outputs.get(body.index, body.coordinate_name)
            self.joint_names[body.index] = self._joints_named.unique(given)
        if changed:
            self.losses.note(f"names of bodies are changed ({listed(changed)})", "The ground has the name world")

    def place(self, body: Body, point: Any) -> Vector:
        """Return a point of a body in the frame of the described body."""
        at, R = self.frames[body.index]
        placed: Vector = R.T @ (np.asarray(point, float) - at)
        return placed

    def turn(self, body: Body, axes: Any, what: str) -> Matrix:
        """Return axes in a body as axes in the described body."""
        turned: Matrix = self.frames[body.index][1].T @ rotation(what, axes)
        return turned

    def _add_body(self, body: Body) -> None:
        """Add a body and its joint."""
        joint, parent = body.joint, self.mechanism.bodies[body.parent]
        if body.reversed and isinstance(joint, Floating):
            raise UserError(f"joint {body.coordinate_name!r} is declared from its body to the ground; exchange them")
        self.frames.append((np.asarray(body.joint_at, float), np.asarray(body.joint_rotation, float)))
        at, axes = (
            self.place(parent, joint.at),
            self.turn(parent, joint.rotation, f"rotation of the joint of {body.name!r}"),
        )
        here = self.name_of(parent)
        described = self._joints(body, at, axes)
        for label, own in described[:-1]:
            zero = np.zeros(3)
            self.description.bodies.append(
                ImportedBody(name=label, parent=here, joint=own, mass=0.0, com=zero, inertia=np.zeros((3, 3)))
            )
            here = label
        R = self.frames[-1][1]
        self.description.bodies.append(
            ImportedBody(
                name=self.name_of(body),
                parent=here,
                joint=described[-1][1],
                mass=body.mass,
                com=self.place(body, body.com),
                inertia=R.T @ body.inertia @ R,
            )
        )

    def _joints(self, body: Body, at: Vector, axes: Matrix) -> list[tuple[str, ImportedJoint]]:
        """Return the described joints of a body with the names of the described bodies."""
        joint, name, last = body.joint, self.joint_names[body.index], self.name_of(body)
        start = self._start_of(body)
        if joint.rate is not None and np.any(joint.rate):
            self.losses.add("rates", name)
        if isinstance(joint, Weld | Spherical | Floating):
            kind = type(joint).__name__
            own = ImportedJoint(kind=kind, name=name, at=at, rotation=axes, start=start)  # type: ignore[arg-type]
            return [(last, own)]
        steps = steps_of(joint)
        if not steps:
            raise UserError(
                f"joint {name!r} is a {type(joint).__name__}, which these formats do not have; allowed: Weld, "
                "Revolute, Translational, Cylindrical, Universal, Planar, Spherical, Floating"
            )
        if body.reversed:
            steps = [Step(kind, -axis, k) for kind, axis, k in reversed(steps)]
        found: list[tuple[str, ImportedJoint]] = []
        for number, (kind, axis, k) in enumerate(steps):
            suffix = joint.coordinates[k]
            own = ImportedJoint(
                kind=kind,  # type: ignore[arg-type]
                name=self._joints_named.unique(f"{name}_{suffix}") if suffix else name,
                at=np.zeros(3) if number else at,
                rotation=np.eye(3) if number else axes,
                axis=axis,
                start=start[k : k + 1],
                armature=joint.armature,
            )
            label = last if number == len(steps) - 1 else self._bodies_named.unique(f"{last}_{own.name}")
            self.coordinates[body.index, k] = label, own
            found.append((label, own))
        position = constant_of(joint.drive)
        if position is not None:
            found[0][1].is_locked, found[0][1].start = True, np.array([position])
        elif joint.drive is not None:
            self.losses.add("drives", name)
        return found

    def _set_stop_times(self, compiled: CompiledMechanism) -> None:
        """Set the time constants of stops: T^2 = 1 / (k (M^-1)_ii), stiffness k, mass matrix M at the start."""
        limited = [own for own in self.coordinates if self.coordinates[own][1].lower is not None]
        if not limited:
            return
        free = free_bodies(self.mechanism)
        q = np.concatenate([self._start_of(body) for body in free])
        first = dict(
            zip((body.index for body in free), np.cumsum([0, *(body.joint.nv for body in free)]), strict=False)
        )
        inverse = np.diag(np.linalg.pinv(compiled.mass_matrix(0.0, q)))
        for index, k in limited:
            joint = self.coordinates[index, k][1]
            mobility = float(inverse[first[index] + k]) if index in first else 0.0
            if joint.stop_stiffness > 0.0 and mobility > 0.0:
                joint.stop_time = 1.0 / np.sqrt(joint.stop_stiffness * mobility)
        self.losses.note(
            f"stops of joints ({len(limited)}) are limits of the format",
            "In MJCF they have the same stiffness in the start position, and critical damping; URDF has ranges only",
        )

    def _start_of(self, body: Body) -> Vector:
        """Return the start positions (nq,) of the joint of a body."""
        joint = body.joint
        if self.q is not None:
            first = self.first[body.index]
            return self.q[first : first + joint.nq]
        given: Vector = joint.rest() if joint.start is None else np.atleast_1d(np.asarray(joint.start, float))
        return given

    def _add_cut(self, handle: Any) -> None:
        """Add a cut joint."""
        cut = handle.cut
        kind = CUTS.get(type(cut))
        if kind is None:
            self.losses.add("cut joints", f"{handle.name}: {type(cut).__name__}")
            return
        Ra, Rb = cut.frames()
        self.description.cuts.append(
            ImportedCut(
                name=handle.name,
                kind=kind,  # type: ignore[arg-type]
                a=self.name_of(handle.a),
                b=self.name_of(handle.b),
                at_a=self.place(handle.a, cut.at_a),
                at_b=self.place(handle.b, cut.at_b),
                rotation_a=self.turn(handle.a, Ra, "rotation_a"),
                rotation_b=self.turn(handle.b, Rb, "rotation_b"),
            )
        )

    def _add_coupling(self, handle: Any) -> None:
        """Add a gear."""
        keys = (handle.a.index, handle.coordinate_a), (handle.b.index, handle.coordinate_b)
        if not isinstance(handle.coupling, Gear) or not all(key in self.coordinates for key in keys):
            self.losses.add("couplings", handle.name)
            return
        (a, _), (b, _) = (self.coordinates[key] for key in keys)
        self.description.couplings.append(
            ImportedCoupling(
                name=handle.name,
                a=a,
                b=b,
                coefficients=np.array((float(handle.coupling.offset), float(handle.coupling.ratio), 0.0, 0.0, 0.0)),
                origin=0.0,
            )
        )

    def _add_points(self) -> None:
        """Add the points whose positions are outputs."""
        seen: dict[tuple[int, tuple[float, ...]], str] = {}
        for name, sensor, *_ in self.mechanism.outputs:
            if isinstance(sensor, PointPosition) and isinstance(sensor.item, Body) and sensor.item.index:
                point = tuple(map(float, sensor.point))
                seen.setdefault((sensor.item.index, point), name.rpartition(".")[0] or name)
        for (index, point), name in seen.items():
            body = self.mechanism.bodies[index]
            self.description.points.append(
                ImportedPoint(name=name, body=self.name_of(body), at=self.place(body, point))
            )

    def _add_shape(self, body: Body, shape: Shape) -> None:
        """Add a shape."""
        size: dict[str, Any] = {}
        axes = np.eye(3)
        file = None
        if isinstance(shape, Sphere):
            size = {"radius": shape.radius}
        elif isinstance(shape, Cylinder):
            size = {"radius": shape.radius, "length": shape.length}
            axes = shape.axes() / np.array((shape.radius, shape.radius, shape.length))
        elif isinstance(shape, Box | Ellipsoid):
            size = {"size": np.asarray(shape.size, float)}
            axes = rotation("rotation of a shape", shape.rotation)
        elif isinstance(shape, MeshFile):
            size, file = {"scale": scale_factors("scale of a mesh", shape.scale)}, Path(shape.path)
            axes = rotation("rotation of a shape", shape.rotation)
            try:
                read_mesh(file)
            except UserError:
                self.losses.add("meshes", str(file))
                return
        else:
            self.losses.add("shapes", body.name)
            return
        kind = next(c.__name__ for c in (Sphere, Capsule, Cylinder, Box, Ellipsoid, MeshFile) if isinstance(shape, c))
        self.description.shapes.append(
            ImportedShape(
                body=self.name_of(body),
                kind=kind,  # type: ignore[arg-type]
                at=self.place(body, shape.at),
                rotation=self.frames[body.index][1].T @ axes,
                size=size,
                file=file,
                color=shape.color,
                opacity=shape.opacity,
            )
        )

    def _add_rest(self) -> None:
        """Add what has no counterpart at all."""
        m = self.mechanism
        if m.gravity_inputs:
            self.losses.add("inputs of gravity")
        for axis in m.gravity_signals:
            self.losses.add("signals of gravity", "xyz"[axis])
        for acting in (*m.elements, *m.others, *m.state_equations):
            self.losses.add("forces", acting.name or acting.what)
        for name, *_ in m.pressures:
            self.losses.add("forces", name)

"""Statements of the method ``build`` of a model, and the parameters that they use."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .description import Description, ImportedBody, ImportedDrive, ImportedJoint, ImportedShape
from .literals import MAX_LINE_LENGTH, axis_text, call, inertia_text, number_text, real_text, rotation_text, vector_text
from .names import RESERVED, Names
from .transmission_statements import Units, transmission_lines


class Quantities(NamedTuple):
    """Words and units for joints of one coordinate: names of outputs, unit of the coordinate and of what acts on it."""

    position: str
    rate: str
    title: str
    unit: str
    force: str
    stiffness: str
    damping: str
    inertia: str
    stop_damping: str
    stop_parameter: str


HINGE = Quantities("angle", "rate", "Angle", "rad", "N.m", "N.m/rad", "N.m.s/rad", "kg.m2", "s/rad", "stop_damping")
SLIDE = Quantities("position", "velocity", "Displacement", "m", "N", "N/m", "N.s/m", "kg", "s/m", "slide_stop_damping")
JOINT_QUANTITIES = {"Revolute": HINGE, "Translational": SLIDE}


class Statements:
    """Statements for a description.

    Attributes
    ----------
    parameters
        Lines that declare the parameters.
    gravity
        Code of the acceleration of gravity.
    lines
        Lines of the statements.
    uses_folder
        Whether the statements use FOLDER, the folder of the imported file.
    """

    def __init__(self, description: Description) -> None:
        self.description = description
        self.bodies = {body.name: body for body in description.bodies}
        self.parameters: list[str] = []
        self.uses_folder = False
        self._parameter_names, self._force_names = Names(frozenset({"stops"})), Names(frozenset())
        self._blocks = Names(RESERVED | set(self.bodies))  # names of blocks are also those of variables, as of bodies
        self.gravity = self._gravity()
        self.lines = [line for body in description.bodies for line in self._body(body)]
        self._section("loops and couplings", self._constraints())
        self._section("springs, dampers and friction", self._forces())
        self._section("ranges of joints", self._stops())
        self._section("drives", self._drives())
        self._section("servos and tendons", self._transmissions())
        self._section("outputs", self._outputs())
        self._section("shapes in pictures", self._shapes())

    def _section(self, title: str, lines: Iterator[str]) -> None:
        """Add statements under a comment, if there are any."""
        if found := list(lines):
            self.lines += ["", f"        # {title}", *found]

    def _parameter(self, name: str, value: float, unit: str, text: str, *, positive: bool = False) -> str:
        """Declare a parameter, with another name if this is taken; return its use. ``positive``: at least zero."""
        arguments = [real_text(value), f'unit="{unit}"', *(["min=0.0"] if positive else []), f'doc="{text}"']
        own = self._parameter_names.unique(name)
        self.parameters += call(f"{own}: float = mb.parameter", arguments, 4)
        return f"self.{own}"

    def _force(self, name: str, force: str, bodies: Sequence[str], indent: int = 8) -> list[str]:
        """Return the statement that adds a force."""
        return call("m.force", [f'"{self._force_names.unique(name)}"', force, *bodies], indent)

    def _gravity(self) -> str:
        """Declare gravity as parameters; return the vector."""
        given = self.description.gravity
        acting = np.flatnonzero(given)
        if len(acting) > 1:
            parts = [
                self._parameter(f"gravity_{letter}", value, "m/s2", f"Acceleration of gravity along {letter}")
                for letter, value in zip("xyz", given, strict=True)
            ]
            return f"({', '.join(parts)})"
        k = int(acting[0]) if len(acting) else 2
        sign = "" if given[k] > 0.0 else "-"
        text = f"Acceleration of gravity along {sign}{'xyz'[k]}"
        own = self._parameter("gravity", abs(float(given[k])), "m/s2", text)
        return "(" + ", ".join(f"{sign}{own}" if i == k else "0" for i in range(3)) + ")"

    # ---- bodies -----------------------------------------------------------------------------------------------------

    def _joint(self, joint: ImportedJoint) -> str:
        """Return the joint as code, and declare its parameters."""
        arguments = [f"at={vector_text(joint.at)}"] if np.any(joint.at) else []
        if turned := rotation_text(joint.rotation):
            arguments.append(f"rotation={turned}")
        if joint.axis is not None and (axis := axis_text(joint.axis)) != '"z"':
            arguments.append(f"axis={axis}")
        if joint.start is not None and joint.has_one_coordinate:
            of = JOINT_QUANTITIES[joint.kind]
            text = f"{of.title} of {joint.name} {'in which it is locked' if joint.is_locked else 'at the start'}"
            start = self._parameter(f"{joint.name}_start", joint.start[0], of.unit, text)
            arguments.append(f"drive={start}" if joint.is_locked else f"start={start}")
        elif joint.start is not None:
            arguments.append(f"start={vector_text(joint.start)}")
        if joint.armature:
            text = f"Inertia of the rotor of the drive as seen at {joint.name}"
            unit = JOINT_QUANTITIES[joint.kind].inertia
            own = self._parameter(f"{joint.name}_armature", joint.armature, unit, text, positive=True)
            arguments.append(f"armature={own}")
        return f"mb.{joint.kind}({', '.join(arguments)})"

    def _body(self, body: ImportedBody) -> list[str]:
        """Return the statement that adds a body, and declare its parameters."""
        arguments = [f'"{body.name}"', body.parent, self._joint(body.joint)]
        if body.mass:
            mass = self._parameter(f"{body.name}_mass", body.mass, "kg", f"Mass of {body.name}", positive=True)
            arguments.append(f"mass={mass}")
            if np.any(body.com):
                arguments.append(f"com={vector_text(body.com)}")
        if np.any(body.inertia):
            arguments.append(f"inertia={inertia_text(body.inertia)}")
        return call(f"{body.name} = m.body", arguments)

    # ---- constraints and forces -------------------------------------------------------------------------------------

    def _constraints(self) -> Iterator[str]:
        """Yield the loop-closing joints and the couplings."""
        for cut in self.description.cuts:
            places = [f"at_a={vector_text(cut.at_a)}", f"at_b={vector_text(cut.at_b)}"]
            for name, turned in (("rotation_a", cut.rotation_a), ("rotation_b", cut.rotation_b)):
                if text := rotation_text(turned):
                    places.append(f"{name}={text}")
            yield from call("m.cut", [f'"{cut.name}"', f"mb.{cut.kind}({', '.join(places)})", cut.a, cut.b])
        for coupling in self.description.couplings:
            c, origin = coupling.coefficients, coupling.origin
            if np.any(c[2:]):
                x = f"(q - {real_text(origin)})" if origin else "q"
                powers = [f"{real_text(value)} * {x}**{power}" for power, value in enumerate(c) if power and value]
                law = f'mb.Cam("{" + ".join([real_text(c[0]), *powers])}", width=1.0)'
            else:
                offset = float(c[0] - c[1] * origin)
                values = [f"ratio={number_text(c[1])}", *([f"offset={number_text(offset)}"] if offset else [])]
                law = f"mb.Gear({', '.join(values)})"
            yield from call("m.couple", [f'"{coupling.name}"', law, coupling.a, coupling.b])

    def _forces(self) -> Iterator[str]:
        """Yield springs, dampers and friction of joints, springs between points, and constant forces."""
        for name, body in self.bodies.items():
            if body.joint.has_one_coordinate:
                yield from self._forces_of_joint(name, body.joint)
        for spring in self.description.springs:
            values = []
            for key, value, unit in (("stiffness", spring.stiffness, "N/m"), ("damping", spring.damping, "N.s/m")):
                text = f"{key.capitalize()} of the spring {spring.name}"
                values.append(f"{key}={self._parameter(f'{spring.name}_{key}', value, unit, text, positive=True)}")
            values += [f"free={number_text(spring.unloaded)}", f"at_a={vector_text(spring.at_a)}"]
            values.append(f"at_b={vector_text(spring.at_b)}")
            yield from self._force(spring.name, f"mb.Spring({', '.join(values)})", [spring.a, spring.b])
        for lift in self.description.lifts:
            size = float(np.linalg.norm(lift.force))
            values = [f"magnitude={number_text(size)}", f"axis={axis_text(lift.force / size)}"]
            values.append(f"at_a={vector_text(lift.at)}")
            yield from self._force(lift.name, f"mb.PointForce({', '.join(values)})", [lift.body])

    def _forces_of_joint(self, body: str, joint: ImportedJoint) -> Iterator[str]:
        """Yield spring, damper and friction of a joint."""
        of, values = JOINT_QUANTITIES[joint.kind], []
        if joint.stiffness:
            text = f"Stiffness of {joint.name}"
            own = self._parameter(f"{joint.name}_stiffness", joint.stiffness, of.stiffness, text, positive=True)
            values.append(f"stiffness={own}")
        if joint.damping:
            text = f"Damping of {joint.name}"
            own = self._parameter(f"{joint.name}_damping", joint.damping, of.damping, text, positive=True)
            values.append(f"damping={own}")
        if joint.stiffness and joint.unloaded:
            values.append(f"free={number_text(joint.unloaded)}")
        if values:
            name, kind = ("spring", "JointSpring") if joint.stiffness else ("damper", "JointDamper")
            yield from self._force(f"{joint.name}_{name}", f"mb.{kind}({', '.join(values)})", [body])
        if joint.friction:
            text = f"Dry friction of {joint.name}; 0: none"
            own = self._parameter(f"{joint.name}_friction", joint.friction, of.force, text, positive=True)
            yield f"        if {own}:"
            yield from self._force(f"{joint.name}_friction", f"mb.JointFriction(coulomb={own})", [body], 12)

    def _stops(self) -> Iterator[str]:
        """Yield the stops of joints and of distances with a range, and declare their damping."""
        limited = {name: body.joint for name, body in self.bodies.items() if body.joint.lower is not None}
        ropes = self.description.distance_ranges
        if not limited and not ropes:
            return
        text = "Elastic stops at the ranges of joints"
        self.parameters.append(f'    stops: bool = mb.parameter(True, structural=True, doc="{text}")')
        damping, kinds = {}, {joint.kind for joint in limited.values()} | ({"Translational"} if ropes else set())
        for kind, of, joints in (("Revolute", HINGE, "hinges"), ("Translational", SLIDE, "slides")):
            if kind in kinds:
                text = f"Damping of the stops of {joints}, see JointStop"
                damping[kind] = self._parameter(of.stop_parameter, 1.0, of.stop_damping, text, positive=True)
        yield "        if self.stops:"
        for body, joint in limited.items():
            values = stop_arguments(joint.lower, joint.upper, joint.stop_stiffness, damping[joint.kind])
            yield from self._force(f"{joint.name}_stop", f"mb.JointStop({', '.join(values)})", [body], 12)
        for rope in ropes:
            values = stop_arguments(rope.lower, rope.upper, rope.stiffness, damping["Translational"])
            values += [f"at_a={vector_text(rope.at_a)}", f"at_b={vector_text(rope.at_b)}"]
            yield from self._force(f"{rope.name}_stop", f"mb.DistanceStop({', '.join(values)})", [rope.a, rope.b], 12)

    def _drives(self) -> Iterator[str]:
        """Yield the inputs and the drives."""
        for drive in self.description.drives:
            of = JOINT_QUANTITIES[self.bodies[drive.body].joint.kind]
            signal = self._signal(drive, of)
            if drive.limits is not None:
                block, limits = self._blocks.unique(f"{drive.name}_limit"), self._limits(drive, of)
                yield from call(f"{block} = m.limiter", [f'"{block}"', signal, *limits, f'unit="{of.force}"'])
                signal = block
            yield from self._force(drive.name, f"mb.JointForce({signal})", [drive.body])
            if drive.bias:
                yield from self._force(f"{drive.name}_bias", f"mb.JointForce({number_text(drive.bias)})", [drive.body])
            if drive.stiffness or drive.damping:
                values = []
                for key, value, unit in (
                    ("stiffness", drive.stiffness, of.stiffness),
                    ("damping", drive.damping, of.damping),
                ):
                    text = f"{key.capitalize()} of the servo {drive.name}"
                    own = self._parameter(f"{drive.name}_servo_{key}", value, unit, text, positive=True)
                    values.append(f"{key}={own}")
                servo = f"mb.JointSpring({', '.join(values)})"
                yield from self._force(f"{drive.name}_servo", servo, [drive.body])

    def _transmissions(self) -> Iterator[str]:
        """Yield limited servos, and forces on linear combinations of joint coordinates."""
        for own in self.description.transmissions:
            kinds = {self.bodies[body].joint.kind for body in own.bodies}
            of = JOINT_QUANTITIES[kinds.pop()] if len(kinds) == 1 else None
            units = Units() if of is None else Units(of.force, of.stiffness, of.damping)
            yield from transmission_lines(own, units, self._parameter, self._blocks.unique, self._force)

    def _signal(self, drive: ImportedDrive, of: Quantities) -> str:
        """Return the force of a drive as code, and declare its gain."""
        signal = f'mb.Input(name="{drive.input}", unit="{drive.unit}", description="{drive.description}")'
        if drive.gain != 1.0:
            text = f"Force of {drive.name} on {drive.joint} per unit of its input"
            signal = f"mb.Product({signal}, {self._parameter(f'{drive.name}_gain', drive.gain, of.force, text)})"
        return signal

    def _limits(self, drive: ImportedDrive, of: Quantities) -> list[str]:
        """Return the limits of the force of a drive as code, and declare them if they are symmetric."""
        lower, upper = drive.limits or (0.0, 0.0)
        if lower != -upper:
            return [f"lower={number_text(lower)}", f"upper={number_text(upper)}"]
        text = f"Limit of the force of {drive.name} on {drive.joint}"
        own = self._parameter(f"{drive.name}_limit", upper, of.force, text, positive=True)
        return [f"lower=-{own}", f"upper={own}"]

    # ---- outputs ----------------------------------------------------------------------------------------------------

    def _outputs(self) -> Iterator[str]:
        """Yield the outputs: coordinates of joints, positions of points and of the last bodies, energy, residuals."""
        for name, body in self.bodies.items():
            joint = body.joint
            if joint.has_one_coordinate:
                of = JOINT_QUANTITIES[joint.kind]
                yield output(f"{joint.name}.{of.position}", f"{name}.coordinate()", f"{of.title} of {joint.name}")
                yield output(f"{joint.name}.{of.rate}", f"{name}.rate()", f"Velocity of {joint.name}")
            elif joint.kind != "Weld":
                for k, letter in enumerate("wxyz"):
                    text = f"Component {letter} of the quaternion of {name}"
                    yield output(f"{name}.q{letter}", f"{name}.quaternion({k})", text)
        for name in self.description.ends:
            yield from self._position(name, name, self.bodies[name].origin)
        for point in self.description.points:
            yield from self._position(point.name, point.body, point.at)
        yield output("energy", "m.energy", "Kinetic and potential energy")
        if self.description.cuts or self.description.couplings:
            yield output("position_residual", "m.position_residual", "Closure error of the loops")
            yield output("velocity_residual", "m.velocity_residual", "Rate of the closure error of the loops")

    def _shapes(self) -> Iterator[str]:
        """Yield the shapes of bodies, those of a body in one statement."""
        of_body: dict[str, list[list[str]]] = {}
        for shape in self.description.shapes:
            lines = call(f"mb.{shape.kind}", self._shape(shape), 12)
            of_body.setdefault(shape.body, []).append(lines)
        for body, shapes in of_body.items():
            line = f"        m.shape({', '.join((body, *(lines[0].strip() for lines in shapes)))})"
            if len(line) <= MAX_LINE_LENGTH and all(len(lines) == 1 for lines in shapes):
                yield line
                continue
            yield from ("        m.shape(", f"            {body},")
            for lines in shapes:
                yield from (*lines[:-1], f"{lines[-1]},")
            yield "        )"

    def _shape(self, shape: ImportedShape) -> list[str]:
        """Return the arguments of a shape as code."""
        arguments = [f"{key}={size_text(key, value)}" for key, value in shape.size.items()]
        if shape.file is not None:
            arguments = [self._file(shape.file), *(text for text in arguments if text != "scale=1")]
        if np.any(shape.at):
            arguments.append(f"at={vector_text(shape.at)}")
        if shape.kind in ("Cylinder", "Capsule"):
            axis = axis_text(shape.rotation[:, 2])
            arguments += [f"axis={axis}"] if axis != '"z"' else []
        elif shape.kind != "Sphere" and (turned := rotation_text(shape.rotation)):
            arguments.append(f"rotation={turned}")
        arguments += [f'color="{shape.color}"'] if shape.color else []
        arguments += [f"opacity={number_text(shape.opacity)}"] if shape.opacity != 1.0 else []
        return arguments

    def _file(self, file: Path) -> str:
        """Return the path of a mesh as code: in the folder of the imported file, if it is there."""
        if file.is_relative_to(self.description.folder):
            self.uses_folder = True
            return f"FOLDER / {text_of(file.relative_to(self.description.folder).as_posix())}"
        return text_of(str(file))

    def _position(self, name: str, body: str, at: np.ndarray) -> Iterator[str]:
        """Yield the outputs of the position of a point."""
        point = f", {vector_text(at)}" if np.any(at) else ""
        for letter in "xyz":
            yield output(f"{name}.{letter}", f'{body}.position("{letter}"{point})', f"Position {letter} of {name}")


def stop_arguments(lower: float | None, upper: float | None, stiffness: float, damping: str) -> list[str]:
    """Return the arguments of stops as code."""
    ends = [f"{key}={number_text(end)}" for key, end in (("lower", lower), ("upper", upper)) if end is not None]
    return [*ends, f"stiffness={number_text(float(f'{stiffness:.4g}'))}", f"damping={damping}"]


def text_of(text: str) -> str:
    """Return text as code."""
    return json.dumps(text, ensure_ascii=False)


def size_text(key: str, value: float | np.ndarray) -> str:
    """Return sizes of a shape as code; one number for equal scales."""
    sizes = np.atleast_1d(np.asarray(value, float))
    if len(sizes) == 1 or (key == "scale" and np.ptp(sizes) == 0.0):
        return number_text(float(sizes[0]))
    return vector_text(sizes)


def output(name: str, sensor: str, text: str) -> str:
    """Return the statement that adds an output."""
    return f'        m.output("{name}", {sensor}, "{text}")'

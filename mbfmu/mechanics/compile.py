"""From the builder's objects to flat arrays: numbering, and one record a body, cut, force, signal, sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.errors import UserError
from solvers.kernel import records

from .arrays import (
    BODY,
    CUT,
    DRAG,
    ELASTIC,
    FORCE,
    NODE,
    PLATE,
    PRESSURE,
    SENSOR,
    SIGNAL,
    WORLD,
    Arrays,
    Data,
    allocate_state,
)
from .bodies import Body, CutHandle
from .checks import rotation, signal_of, vector
from .cuts import REGISTRY as CUTS
from .forces import REGISTRY as FORCES
from .joints import REGISTRY as JOINTS
from .joints import Section
from .joints.base import unit_axis
from .mechanism import Mechanism
from .sensors import Kind, Sensor
from .signals import Input, Signal, SpeedInput


@dataclass(frozen=True)
class Variable:
    """An input or output as a host sees it."""

    name: str
    unit: str
    description: str = ""
    start: float = 0.0
    nominal: float | None = None


GRAVITY = -1  # in place of a signal's number


@dataclass(frozen=True)
class Slot:
    """Where the value of an input is kept: a coefficient of a signal, or a component of gravity."""

    variable: Variable
    signal: int
    coefficient: int


class Numbering:
    """Offsets of every joint in the full and the free coordinates; signals in the order they are met."""

    def __init__(self, mechanism: Mechanism) -> None:
        self.signals: list[Signal] = []
        self.slots: list[Slot] = []
        self.q: list[int] = []
        self.v: list[int] = []
        self.qf: list[int] = []
        self.vf: list[int] = []
        self.drive: list[int] = []
        self.coordinate_names: list[str] = []
        self.nq_full = self.nv_full = self.nq = self.nv = 0
        for axis, gravity in mechanism.gravity_inputs.items():
            ((name, unit, description, start),) = gravity.variables()
            self._slot(Variable(name, unit, description, start), GRAVITY, axis)
        for body in mechanism.bodies:
            self._count(body)
        self.s = list(self.v)
        self.subspaces = self.nv_full
        for body in mechanism.bodies:
            if shared(body):
                self.s[body.index] = self.subspaces
                self.subspaces += body.joint.nv

    def _count(self, body: Body) -> None:
        joint = body.joint
        if isinstance(joint, Section) and joint.frame is not None:
            for numbers in (self.q, self.v, self.qf, self.vf, self.drive):
                numbers.append(numbers[joint.frame.index])
            return
        driven = joint.drive is not None
        self.q.append(self.nq_full)
        self.v.append(self.nv_full)
        self.nq_full += joint.nq
        self.nv_full += joint.nv
        self.qf.append(-1 if driven else self.nq)
        self.vf.append(-1 if driven else self.nv)
        self.drive.append(self.signal(joint.drive, f"drive of body {body.name!r}") if driven else -1)
        if not driven:
            self.nq += joint.nq
            self.nv += joint.nv
            self.coordinate_names += [f"{body.name}.{c}" if c else body.name for c in joint.coordinates]

    def signal(self, value: Any, what: str) -> int:
        """Number a signal and, if it is an input, its slots."""
        signal = signal_of(value, what)
        index = len(self.signals)
        self.signals.append(signal)
        if isinstance(signal, Input | SpeedInput):
            for coefficient, (name, unit, description, start) in enumerate(signal.variables()):
                if name:
                    self._slot(Variable(name, unit, description, start), index, coefficient)
        return index

    def _slot(self, variable: Variable, signal: int, coefficient: int) -> None:
        if variable.name in [slot.variable.name for slot in self.slots]:
            raise UserError(f"input {variable.name!r} is used twice; each input moves one thing")
        self.slots.append(Slot(variable, signal, coefficient))


def shared(body: Body) -> bool:
    """Whether the coordinates of a body's joint are another body's."""
    return isinstance(body.joint, Section) and body.joint.frame is not None


def compile_data(mechanism: Mechanism, numbering: Numbering) -> Data:
    """Return arrays and state; every cut-joint row is kept for now."""
    world = records(1, WORLD)
    world["gravity"] = mechanism.gravity
    forces = force_records(mechanism, numbering)  # numbers its signals, so before they are written
    pressures = pressure_records(mechanism, numbering)
    cuts, rows = cut_records(mechanism)
    bodies, signals = body_records(mechanism, numbering), signal_records(numbering)
    elements = (*plate_records(mechanism), *elastic_records(mechanism, numbering), pressures)
    arrays = Arrays(world, bodies, cuts, forces, signals, np.arange(rows), *elements)
    world["drives"] = np.any(bodies["drive"] >= 0)
    world["works"] = works(arrays)
    sizes = (len(mechanism.bodies), rows, numbering.nq_full, numbering.nv_full, numbering.subspaces)
    return Data(arrays, allocate_state(*sizes))


def works(arrays: Arrays) -> bool:
    """Return whether a drive, a damper or a given force is there."""
    given = np.any(arrays.forces["signal"] >= 0) or len(arrays.pressures) > 0
    damped = np.any(arrays.forces["damping"]) or np.any(arrays.plates["damped"]) or np.any(arrays.elastics["beta"])
    return bool(np.any(arrays.bodies["drive"] >= 0) or given or damped or len(arrays.drags) > 0)


def body_records(mechanism: Mechanism, numbering: Numbering) -> NDArray[Any]:
    """One record a body, ground first."""
    table, nodes = records(len(mechanism.bodies), BODY), 0
    for i, body in enumerate(mechanism.bodies):
        record, joint = table[i], body.joint
        record["parent"], record["node"] = body.parent, -1
        if isinstance(joint, Section):
            record["node"], nodes = nodes, nodes + 1
        else:
            record["joint"] = JOINTS.index(type(joint))
        record["nq"], record["nv"], record["quaternion"] = joint.nq, joint.nv, int(joint.quaternion)
        record["qi"], record["vi"], record["si"] = numbering.q[i], numbering.v[i], numbering.s[i]
        record["qf"], record["vf"], record["drive"] = numbering.qf[i], numbering.vf[i], numbering.drive[i]
        record["mass"] = body.mass
        record["com"], record["inertia"] = body.com, body.inertia
        record["s"] = vector(f"placement of body {body.name!r}", joint.at)
        record["R"] = rotation(f"rotation of body {body.name!r}", joint.rotation)
        record["axis"] = joint.direction
    return table


def cut_records(mechanism: Mechanism) -> tuple[NDArray[Any], int]:
    """One record a cut, and the number of rows."""
    table, row = records(len(mechanism.cuts), CUT), 0
    for record, handle in zip(table, mechanism.cuts, strict=True):
        cut, what = handle.cut, f"of cut {handle.name!r}"
        record["kind"], record["a"], record["b"], record["row"] = (
            CUTS.index(type(cut)),
            handle.a.index,
            handle.b.index,
            row,
        )
        record["Pa"], record["Pb"] = vector(f"at_a {what}", cut.at_a), vector(f"at_b {what}", cut.at_b)
        record["Ra"] = rotation(f"rotation_a {what}", cut.rotation_a)
        record["Rb"] = rotation(f"rotation_b {what}", cut.rotation_b)
        record["length"] = getattr(cut, "length", 0.0)
        row += len(cut.rows)
    return table, row


def force_records(mechanism: Mechanism, numbering: Numbering) -> NDArray[Any]:
    """One record a force."""
    table = records(len(mechanism.forces), FORCE)
    for record, (name, force, a, b) in zip(table, mechanism.forces, strict=True):
        record["kind"] = FORCES.index(type(force))
        record["a"], record["b"] = a.index, b.index
        record["q"], record["v"] = (numbering.q[a.index], numbering.v[a.index]) if force.on_joint else (-1, -1)
        record["signal"] = -1
        if hasattr(force, "magnitude"):
            record["signal"] = numbering.signal(force.magnitude, f"magnitude of force {name!r}")
        record["Pa"] = vector(f"at_a of force {name!r}", getattr(force, "at_a", (0.0, 0.0, 0.0)))
        record["Pb"] = vector(f"at_b of force {name!r}", getattr(force, "at_b", (0.0, 0.0, 0.0)))
        record["axis"] = unit_axis(force.axis) if hasattr(force, "axis") else 0.0
        for key in ("stiffness", "damping", "free", "section"):
            record[key] = getattr(force, key, 0.0)
    return table


def plate_records(mechanism: Mechanism) -> tuple[NDArray[Any], NDArray[Any]]:
    """One record a plate element, and one for each that the air drags."""
    plates, drags = records(len(mechanism.plates), PLATE), []
    for record, (plate, nodes) in zip(plates, mechanism.plates, strict=True):
        record["node"] = [body.index for body in nodes]
        plate.fill(record)
        if plate.drag > 0.0:
            drags.append((record["node"], 0.5 * plate.drag * plate.a * plate.b))
    dragged = records(len(drags), DRAG)
    for record, (node, coefficient) in zip(dragged, drags, strict=True):
        record["node"], record["coefficient"] = node, coefficient
    return plates, dragged


def elastic_records(mechanism: Mechanism, numbering: Numbering) -> tuple[NDArray[Any], NDArray[Any]]:
    """One record an elastic body, and one a cross-section in the order of the bodies."""
    elastics = records(len(mechanism.elastics), ELASTIC)
    for record, elastic in zip(elastics, mechanism.elastics, strict=True):
        i = elastic.modes.index
        record["body"], record["qi"], record["vi"] = i, numbering.q[i], numbering.v[i]
        elastic.beam.fill(record)
    sections = [body.joint for body in mechanism.bodies if isinstance(body.joint, Section)]
    nodes = records(len(sections), NODE)
    for record, section in zip(nodes, sections, strict=True):
        if section.frame is not None:  # bending leaves the frame in place
            section.beam.fill_node(section.x, record)
    return elastics, nodes


def pressure_records(mechanism: Mechanism, numbering: Numbering) -> NDArray[Any]:
    """One record a surface that a pressure acts on; those of one pressure share its signal."""
    found = []
    for name, magnitude, faces in mechanism.pressures:
        signal = numbering.signal(magnitude, f"magnitude of pressure {name!r}")
        found += [([body.index for body in corners], signal) for corners in faces]
    table = records(len(found), PRESSURE)
    for record, (node, signal) in zip(table, found, strict=True):
        record["node"], record["signal"] = node, signal
    return table


def signal_records(numbering: Numbering) -> NDArray[Any]:
    """One record a signal."""
    table = records(len(numbering.signals), SIGNAL)
    for i, signal in enumerate(numbering.signals):
        signal.fill(table[i])
    return table


def sensor_records(mechanism: Mechanism, numbering: Numbering, kept: NDArray[np.int64]) -> NDArray[Any]:
    """One record an output, and last the energy and the kinetic energy."""
    table = records(len(mechanism.outputs) + 2, SENSOR)
    table["kind"][-2:] = Kind.ENERGY, Kind.KINETIC
    first_row = np.cumsum([0] + [len(c.cut.rows) for c in mechanism.cuts])
    for record, (name, sensor, _, _) in zip(table[:-2], mechanism.outputs, strict=True):
        record["kind"], record["component"] = sensor.kind, sensor.component
        record["point"] = sensor.point
        record["index"] = sensor_index(name, sensor, numbering, first_row, kept)
    return table


def sensor_index(
    name: str, sensor: Sensor, numbering: Numbering, first_row: NDArray[np.int64], kept: NDArray[np.int64]
) -> int:
    """Return what a sensor's record points at; see :class:`.sensors.Kind`."""
    match sensor.kind, sensor.item:
        case Kind.COORDINATE, Body(index=i):
            return numbering.q[i] + sensor.component
        case ((Kind.RATE | Kind.ACCELERATION | Kind.EFFORT), Body(index=i)):
            return numbering.v[i] + sensor.component
        case Kind.CUT_FORCE, CutHandle(index=i, name=cut):
            row = int(kept[first_row[i] + sensor.component])
            if row < 0:
                raise UserError(
                    f"output {name!r} reads row {sensor.item.cut.rows[sensor.component]!r} of cut {cut!r}, "
                    "which is void in this mechanism: no free motion works against it"
                )
            return row
        case _, (Body(index=i) | CutHandle(index=i)):
            return i
    return 0

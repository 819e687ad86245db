"""From the builder's objects to flat arrays: a record for everything, see :mod:`.numbering` for the places."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.builder.loading import Acting
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.checks import rotation, vector
from mbfmu.mechanics.flexible.records import FlexibleRecord, NodeRecord
from mbfmu.mechanics.joints import Section
from mbfmu.mechanics.kind import ElementType, kernel_of, record_of
from mbfmu.mechanics.records import (
    MAX_KERNELS,
    MODAL,
    RIGID,
    SECTION,
    Arrays,
    BodyRecord,
    CouplingRecord,
    CutRecord,
    Data,
    ItemRecord,
    SensorRecord,
    WorldRecord,
    allocate_state,
    share_lists,
    to_complex_data,
    to_complex_state,
)
from mbfmu.mechanics.sensors import CouplingEffort, Energy, KineticEnergy, RowForce, Sensor, with_arguments
from mbfmu.mechanics.signals import InUse
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import records
from solvers.compiled.record import R, Table
from solvers.compiled.record_view import complex_dtype

from .numbering import CompiledAttachment, Magnitudes, Numbering, shares_coordinates
from .tables import COMPLEX, COMPLEX_STEP_NUMBERS, REAL, TANGENT_NUMBERS, CalledKernel, NumberTypes, Tables

# Margin of the search for active loads relative to the largest lever: at a smaller one there are more searches, at a
# larger one more loads are listed.
SEARCH_MARGIN_RATIO = 0.2


class CompiledElements:
    """The elements of a mechanism as arrays.

    Attributes
    ----------
    data
        Arrays and state; every constraint equation is kept for now.
    signals
        By number.
    sensors
        What can be observed: the outputs, and last the energy and the kinetic energy.
    watched, watched_rates
        Numbers of the parts that are the sensors of events, and their rates as far as they are known.
    sampled
        Numbers of the parts that are the inputs of sampled blocks.
    magnitudes
        Numbers of the signals of loads, by what each is in messages.
    used
        Signals that each item refers to, in the order of ``ends``.
    used_parts
        Parts that each item refers to, in this order.
    used_states
        Places in State.v of the first-order states that each item refers to, in this order.
    parts
        The parts.
    holding
        Kinds and places (k, 2) of the cut joints that hold sensors at stops, see :mod:`.stop_rows`.
    """

    def __init__(self, mechanism: Mechanism, numbering: Numbering) -> None:
        self._numbering = numbering
        self.sensors: list[Sensor] = [*(output[1] for output in mechanism.outputs), Energy(), KineticEnergy()]
        loads = list(mechanism.loads())
        rigid = [body for body in mechanism.bodies if not isinstance(body.joint, Section)]
        self.magnitudes = Magnitudes()
        sites = self._sites_in_order(mechanism, rigid, loads)
        counts = (len(rigid), len(mechanism.cuts), len(mechanism.couplings), len(loads), len(self.sensors))
        self.ends = np.cumsum(counts)
        filled = [filled_record(item, place) for item, place in sites]
        watching = CompiledAttachment("an event", (), numbering, {})
        watched = [event.sensor for event in mechanism.events if event.sensor is not None]
        rates = [rate for sensor in watched if (rate := sensor.rate_sensor())]
        self.watched, self.watched_rates = (
            np.array([watching.part(sensor) for sensor in sensors], np.int64) for sensors in (watched, rates)
        )
        sampled = [sensor for block in mechanism.sampled for sensor in block.inputs]
        self.sampled = np.array([watching.part(sensor) for sensor in sampled], np.int64)
        of_parts: list[tuple[ElementType, CompiledAttachment]] = []
        filled_parts = []
        for part in numbering.parts:  # those that a part is made of come up meanwhile
            observed = observed_sensors(part) if isinstance(part, Sensor) else ()
            of_parts.append((part, CompiledAttachment(f"part {type(part).__name__}", observed, numbering, {})))
            filled_parts.append(filled_record(*of_parts[-1]))
        for signal in numbering.signals:  # as of parts
            sites.append((signal, CompiledAttachment("a signal", (), numbering, {})))
            filled.append(filled_record(*sites[-1]))
        self.ends = np.append(self.ends, len(sites))
        sites, filled = sites + of_parts, filled + filled_parts
        self.ends = np.append(self.ends, len(sites))
        for event in mechanism.events:
            if holding := event.holding_cut:
                sites.append((holding.cut, CompiledAttachment(f"event {event.name!r}", (), numbering, {})))
                filled.append(filled_record(*sites[-1]))
        self.used, self.used_parts, self.used_states = (
            [getattr(place, name) for _, place in sites] for name in ("used", "used_parts", "used_states")
        )
        self.parts = list(numbering.parts)
        self._tables = tables = Tables([item for item, _ in sites], filled, numbering.parts)
        places = np.column_stack((MAX_KERNELS * np.array(tables.kinds), tables.places))
        *items, self.holding = np.split(places, self.ends)
        arrays = self._arrays(mechanism, loads, *items)
        widest = max((body.joint.nv for body in mechanism.bodies), default=0)
        sizes = (numbering.nq_full, numbering.nv_full, widest, numbering.subspaces, numbering.scratch_size)
        n_rows = len(arrays.kept) - len(mechanism.couplings)
        self.data = Data(
            arrays,
            allocate_state(
                len(mechanism.bodies), n_rows, len(mechanism.couplings), len(loads), *sizes, numbering.bearings
            ),
        )
        self.signals = self.signals_in(self.data)

    def _sites_in_order(
        self, mechanism: Mechanism, rigid: Sequence[Body], loads: Sequence[Acting]
    ) -> list[tuple[ElementType, CompiledAttachment]]:
        """Return joints, cut joints, couplings, loads and sensors with where each is attached."""
        numbering, known = self._numbering, self.magnitudes
        return [
            *((body.joint, CompiledAttachment(f"body {body.name!r}", (body,), numbering, known)) for body in rigid),
            *((c.cut, CompiledAttachment(f"cut {c.name!r}", (c.a, c.b), numbering, known)) for c in mechanism.cuts),
            *(
                (c.coupling, CompiledAttachment(f"coupling {c.name!r}", (c.a, c.b), numbering, known))
                for c in mechanism.couplings
            ),
            *(
                (a.load, CompiledAttachment(a.what, a.bodies, numbering, known, first))
                for a, first in zip(loads, numbering.first_states, strict=True)
            ),
            *(
                (sensor, CompiledAttachment("a sensor", observed_sensors(sensor), numbering, known))
                for sensor in self.sensors
            ),
        ]

    def _arrays(
        self,
        mechanism: Mechanism,
        loads: list[Acting],
        joints: NDArray[np.int64],
        cuts: NDArray[np.int64],
        couplings: NDArray[np.int64],
        acting: NDArray[np.int64],
        sensors: NDArray[np.int64],
        signals: NDArray[np.int64],
        parts: NDArray[np.int64],
    ) -> Arrays:
        """Return the records; of every kind of item, its kernels and places (k, 2)."""
        numbering, tables = self._numbering, self._tables
        world = WorldRecord.zeros(1)
        world["gravity"], world["states"] = mechanism.gravity, len(numbering.states)
        bodies, (closing, rows) = body_records(mechanism, numbering, joints), cut_records(mechanism, cuts)
        flexibles, nodes = flexible_records(mechanism, numbering)
        world["drives"] = np.any(bodies["drive"] >= 0)
        world["nonconservative"] = (
            world["drives"]
            | any(a.load.is_nonconservative for a in loads)
            | any(handle.elastic.is_damped for handle in mechanism.flexible_bodies)
        )
        set_levers(loads, world, bodies)
        observing = item_records(sensors, SensorRecord)
        observing["energy"] = [sensor.reads_energy for sensor in self.sensors]
        return Arrays(
            world=world,
            bodies=bodies,
            cuts=closing,
            couplings=coupling_records(mechanism, numbering, couplings, rows),
            loads=item_records(acting, ItemRecord),
            signals=item_records(signals, ItemRecord),
            parts=item_records(parts, ItemRecord),
            sensors=observing,
            kept=np.arange(rows + len(couplings)),
            residual_scale=np.ones(rows + len(couplings)),
            flexibles=flexibles,
            nodes=nodes,
            kernels=tables.kernels(),
            memory=tables.memory,
            numbers=np.array(numbering.numbers, float),
        )

    def complex_step_data(self) -> Data:
        """Return the same arrays with a complex state, for derivatives by complex steps."""
        arrays = self.data.arrays._replace(kernels=self._tables.kernels(COMPLEX_STEP_NUMBERS))
        return Data(arrays, share_lists(to_complex_state(self.data.state), self.data.state))

    def tangent_arrays(self) -> Arrays:
        """Return the same arrays with the kernels that give derivatives by the state."""
        return self.data.arrays._replace(kernels=self._tables.kernels(TANGENT_NUMBERS))

    def called(self, numbers: NumberTypes = REAL) -> list[CalledKernel | None]:
        """Return what addresses of kernels for these numbers are of, in the order of ``Arrays.kernels``."""
        return self._tables.called(numbers)

    def signals_in(self, data: Data) -> list[InUse]:
        """Return every signal with its record in the data, or in those of a :meth:`complex_data`."""
        kind = complex_dtype if data.state.q.dtype == complex else np.dtype
        found: list[InUse] = []
        for signal, at in zip(self._numbering.signals, data.arrays.signals["at"], strict=True):
            dtype = kind(record_of(signal))
            found.append(InUse(signal, data.arrays.memory[at : at + dtype.itemsize].view(dtype)[0], found, len(found)))
        return found

    def complex_data(self) -> Data:
        """Return data as they are now with complex numbers for real ones."""
        arrays, state = to_complex_data(self.data)
        memory, places = self._tables.complex_memory()
        joints, *others, _ = np.split(np.array(places, np.int64), self.ends)
        arrays.bodies["at"][arrays.bodies["role"] == RIGID] = joints
        tables: Any = (arrays.cuts, arrays.couplings, arrays.loads, arrays.sensors, arrays.signals, arrays.parts)
        for table, own in zip(tables, others, strict=True):
            table["at"] = own
        arrays = arrays._replace(memory=memory, kernels=self._tables.kernels(COMPLEX))
        return Data(arrays, state)

    @property
    def tables(self) -> list[NDArray[Any]]:
        """The records of every kind, as they lie in the memory."""
        return self._tables.tables

    def table(self, kind: type[ElementType]) -> NDArray[Any]:
        """Return the records of a kind in the order they were added."""
        return self._tables.table(kind)


def filled_record(item: ElementType, place: CompiledAttachment) -> NDArray[Any]:
    """Return the record (1,) of something."""
    record = records(1, record_of(item))
    try:
        item.fill(record[0], place)
    except UserError:
        raise
    except Exception as error:
        kind = type(item).__name__
        raise UserError(f"{place.name}: fill of {kind} failed: {type(error).__name__}: {error}") from error
    return record


def observed_sensors(sensor: Sensor) -> tuple[Body, ...]:
    """Return the bodies of a sensor: those it lists, or the one body that is its item."""
    return sensor.bodies or ((sensor.item,) if isinstance(sensor.item, Body) else ())


def set_levers(loads: list[Acting], world: Table[WorldRecord], bodies: Table[BodyRecord]) -> None:
    """Write what the search for active loads requires, see :mod:`mbfmu.mechanics.recursions.active_loads`."""
    bodies["lever"] = -1.0
    for acting in loads:
        if kernel_of(acting.load, "clearance") is not None:
            for body, lever in zip(acting.bodies, acting.load.levers, strict=False):
                bodies["lever"][body.index] = max(bodies["lever"][body.index], lever)
    largest = float(bodies["lever"].max())
    world["has_clearances"], world["search_margin"] = largest > 0.0, SEARCH_MARGIN_RATIO * largest


def item_records(items: NDArray[np.int64], record: type[R]) -> Table[R]:
    """Return one record an item, from its kind and place (items, 2)."""
    table = record.zeros(len(items))
    table["kind"], table["at"] = items.T
    return table


def body_records(mechanism: Mechanism, numbering: Numbering, joints: NDArray[np.int64]) -> Table[BodyRecord]:
    """One record a body, ground first; ``joints`` are those of rigid bodies, kind and place."""
    table, nodes, own = BodyRecord.zeros(len(mechanism.bodies)), 0, iter(joints)
    for i, body in enumerate(mechanism.bodies):
        record, joint = table[i], body.joint
        record["parent"], record["node"] = body.parent, -1
        if isinstance(joint, Section):
            record["role"] = SECTION if shares_coordinates(body) else MODAL
            record["node"], nodes = nodes, nodes + 1
        else:
            record["kind"], record["at"] = next(own)
        record["nq"], record["nv"], record["quaternion"] = joint.nq, joint.nv, int(joint.quaternion)
        record["qi"], record["vi"], record["si"] = numbering.q[i], numbering.v[i], numbering.s[i]
        record["qf"], record["vf"], record["drive"] = numbering.qf[i], numbering.vf[i], numbering.drive[i]
        record["armature"], record["mass"] = joint.armature, body.mass
        record["com"], record["inertia"] = body.com, body.inertia
        record["s"] = vector(f"placement of body {body.name!r}", joint.at)
        record["R"] = rotation(f"rotation of body {body.name!r}", joint.rotation)
        record["attached"], record["reversed"] = body.attached, body.reversed
        record["child_s"], record["child_R"] = body.joint_at, body.joint_rotation
    return table


def cut_records(mechanism: Mechanism, cuts: NDArray[np.int64]) -> tuple[Table[CutRecord], int]:
    """One record a cut, from their kinds and places, and the number of rows."""
    table, row = CutRecord.zeros(len(mechanism.cuts)), 0
    for record, handle, (kind, at) in zip(table, mechanism.cuts, cuts, strict=True):
        record["kind"], record["at"] = kind, at
        record["a"], record["b"], record["row"] = handle.a.index, handle.b.index, row
        row += len(handle.cut.rows)
        record["end"] = row
    return table, row


def coupling_records(
    mechanism: Mechanism, numbering: Numbering, couplings: NDArray[np.int64], row: int
) -> Table[CouplingRecord]:
    """One record a coupling, from their kinds and places; ``row`` is the first of their rows."""
    table = CouplingRecord.zeros(len(mechanism.couplings))
    for record, handle, (kind, at) in zip(table, mechanism.couplings, couplings, strict=True):
        record["kind"], record["at"], record["row"] = kind, at, row + handle.index
        for end, body, k in (("a", handle.a, handle.coordinate_a), ("b", handle.b, handle.coordinate_b)):
            i, free = body.index, body.joint.drive is None
            record[end], record["q" + end], record["v" + end] = i, numbering.q[i] + k, numbering.v[i] + k
            record["f" + end] = numbering.vf[i] + k if free else -1
    return table


def flexible_records(mechanism: Mechanism, numbering: Numbering) -> tuple[Table[FlexibleRecord], Table[NodeRecord]]:
    """One record a flexible body, and one a cross-section in the order of the bodies."""
    flexibles = FlexibleRecord.zeros(len(mechanism.flexible_bodies))
    for record, handle in zip(flexibles, mechanism.flexible_bodies, strict=True):
        i = handle.modes.index
        record["body"], record["qi"], record["vi"] = i, numbering.q[i], numbering.v[i]
        handle.elastic.fill(record, numbering.keep)
    sections = [body.joint for body in mechanism.bodies if isinstance(body.joint, Section)]
    nodes = NodeRecord.zeros(len(sections))
    for node, section in zip(nodes, sections, strict=True):
        if section.frame is None:
            section.elastic.fill_frame(node, numbering.keep)
        else:
            section.elastic.fill_node(section.key, node, numbering.keep)
    return flexibles, nodes


def check_rows(mechanism: Mechanism, kept: NDArray[np.int64]) -> None:
    """Raise UserError if an output reads a trivially satisfied equation of a cut joint or a coupling."""
    first = np.cumsum([0] + [len(c.rows) for c in mechanism.constraints])
    read = [(name, part) for name, sensor, *_ in mechanism.outputs for part in with_arguments(sensor)]
    for name, sensor in read:
        if isinstance(sensor, CouplingEffort) and kept[first[len(mechanism.cuts) + sensor.item.index]] < 0:
            raise UserError(
                f"output {name!r} reads coupling {sensor.item.name!r}, whose constraint is trivially satisfied "
                "in this mechanism: both its "
                "coordinates are driven"
            )
        if isinstance(sensor, RowForce) and kept[first[sensor.item.index] + sensor.component] < 0:
            raise UserError(
                f"output {name!r} reads component {sensor.item.cut.rows[sensor.component]!r} of cut "
                f"{sensor.item.name!r}, which is trivially satisfied in this mechanism: no free motion violates "
                "it. Read another component"
            )

"""A compiled mechanism at work: what simulation and FMU hold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.errors import AssemblyError, UserError
from solvers.system import Array, System, TreeSystem

from .arrays import Data, complex_twin
from .assembly import assemble_positions, assemble_velocities, check_frames, check_inertia, frame_angles
from .bending import Bend, bend
from .bodies import Body
from .checks import with_unit_quaternion
from .compile import GRAVITY, Numbering, Variable, compile_data, sensor_records, shared
from .dynamics import audit_callbacks, callbacks, energy, observe, observe_all, tree_callbacks
from .mechanism import Mechanism
from .motion import Departure, InputMotion, impulse
from .numbers import array_of
from .rows import Probe, dependent_rows, describe, pace, row_names, row_units
from .scale import characteristic_length, coordinate_sizes, joint_sizes, row_sizes
from .sensors import largest_residual
from .signals import POLYNOMIAL, RUN_UP, SpeedInput
from .tangent import Groups, Tangent, find_groups

LARGE = 60  # coordinates of a tree without loops from which on no dense matrix is made
LARGE_LOOPS = 100  # ... of a mechanism with cut joints; the partitions take its matrices all the same
WIDEST = 1000  # bodies in a group of the structured tangent: its matrix has twelve rows a body


class Plant:
    """A mechanism as arrays, with its inputs, its outputs and the system a solver takes.

    Attributes
    ----------
    system
        The equations of motion over the free coordinates.
    inputs, outputs
        Variables in the order of :meth:`set_input` and :meth:`observe`.
    length
        Characteristic length, m; see :func:`.scale.characteristic_length`.
    void_rows
        Names of cut-joint rows that no free motion works against; dropped.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        self._numbering = numbering = Numbering(mechanism)
        self.data = compile_data(mechanism, numbering)
        self.length = characteristic_length(self.data.arrays)
        self._size = coordinate_sizes(self._free_bodies(), self.length)
        names = row_names(mechanism.cuts)
        self._row_size = np.concatenate([np.zeros(0), *(row_sizes(c.cut, self.length) for c in mechanism.cuts)])
        self.void_rows: list[str] = []
        large = not mechanism.elastics and numbering.nv > (LARGE_LOOPS if names else LARGE)  # T knows no modes
        make = self._tree_system if large else self._system
        self.system: Any = make(names, self.data)
        if names:
            self.void_rows = self._drop_void_rows(names)
            self.system = make([n for n in names if n not in self.void_rows], self.data)
        self.inputs = tuple(slot.variable for slot in numbering.slots)
        self.outputs = tuple(Variable(n, s.unit, d, 0.0, nominal) for n, s, d, nominal in mechanism.outputs)
        self._motions = self._input_motions()
        self._sensors = sensor_records(mechanism, numbering, self.data.arrays.kept)

    def complex_system(self) -> System:
        """Return the system as it is now on complex numbers, for derivatives by complex step."""
        return self._system(list(self.system.constraint_names), complex_twin(self.data), complex)

    def _system(self, constraint_names: list[str], data: Data, scalar: type = float) -> System:
        dynamics, position, motion, retract, jacobi = callbacks(scalar)
        power, exposure = audit_callbacks(tree=False) if scalar is float else (None, None)
        return System(
            nq=self._numbering.nq,
            n=self._numbering.nv,
            m=len(constraint_names),
            data=data,
            dynamics=dynamics,
            position=position,
            motion=motion,
            retract=retract,
            jacobi=jacobi,
            size=self._size,
            row_size=self._row_sizes(constraint_names),
            rate=self._rate(),
            power=power,
            exposure=exposure,
            works=self._works,
            coordinate_names=tuple(self._numbering.coordinate_names),
            constraint_names=tuple(constraint_names),
        )

    def _tree_system(self, constraint_names: list[str], data: Data) -> TreeSystem:
        """Return the system of a large tree."""
        inverse, forward, mobility, position, constraints, retract = tree_callbacks()
        power, exposure = audit_callbacks(tree=True)
        places: list[tuple[int, int]] = []
        quaternions: list[tuple[int, int]] = []
        for record in self.data.arrays.bodies:
            if record["vf"] < 0:
                continue
            plain = int(record["nq"] - 4 * record["quaternion"])
            places += [(int(record["qf"]) + k, int(record["vf"]) + k) for k in range(plain)]
            if record["quaternion"]:
                quaternions.append((int(record["qf"]) + plain, int(record["vf"]) + plain))
        in_q, in_v = np.array(places, np.int64).reshape(-1, 2).T
        return TreeSystem(
            nq=self._numbering.nq,
            n=self._numbering.nv,
            m=len(constraint_names),
            data=data,
            inverse=inverse,
            forward=forward,
            mobility=mobility,
            position=position,
            constraints=constraints,
            retract=retract,
            tangent=Tangent(data, self._groups()),
            size=self._size,
            row_size=self._row_sizes(constraint_names),
            plain=(in_q, in_v),
            quaternions=tuple(quaternions),
            dense=lambda: self._system(constraint_names, data),
            power=power,
            exposure=exposure,
            works=self._works,
            coordinate_names=tuple(self._numbering.coordinate_names),
            constraint_names=tuple(constraint_names),
        )

    def _works(self) -> bool:
        return bool(self.data.arrays.world["works"][0])

    def _groups(self) -> Groups:
        """Return the groups of the structured tangent; UserError where they would be too wide to be solved."""
        groups = find_groups(self.mechanism)
        widest = int(np.bincount(groups.of[1:]).argmax())
        members = np.flatnonzero(groups.of == widest)
        if len(members) > WIDEST:
            raise UserError(
                f"joints, forces and elements tie {len(members)} bodies to each other, "
                f"{self.mechanism.bodies[members[-1]].name!r} among them, so that they must be solved at once; "
                f"allowed: {WIDEST}; tie bodies that are near each other in the tree"
            )
        return groups

    def _drop_void_rows(self, names: list[str]) -> list[str]:
        """Find the rows whose Jacobian vanishes wherever the mechanism may be, and number the others anew.

        A few random positions decide, of the free coordinates and of the drives: those that are functions of time
        where they are at some time, those that are inputs anywhere. A row that is not void vanishes there with
        probability zero.

        Raises
        ------
        AssemblyError
            A void row is not closed, or the drives open it.
        """
        signals, probe, start = self.data.arrays.signals, Probe(self.system), self.start_positions()
        given = {slot.signal for slot in self._numbering.slots}
        before = signals["c"].copy()
        drives = [(k, self._drive_size(k)) for k in set(self.drive_signals())]
        paces = [pace(signals[k], size) for k, size in drives if k not in given]
        for scale in (0.0, *(x for x in paces if x), *(1.0 for k, _ in drives if k in given)):
            for _ in range(3):
                probe.try_at(scale * probe.turns(), start)
                for k, size in drives:
                    if k in given:
                        signals["c"][k, 0] = before[k, 0] + size * probe.normal()
        signals["c"] = before
        void = probe.void(row_units(self.mechanism.cuts))
        self.data.arrays.kept[:] = np.where(void, -1, np.cumsum(~void) - 1)
        return [names[i] for i in np.flatnonzero(void)]

    def _drive_size(self, signal: int) -> float:
        """Return the unit of the coordinate that a signal drives."""
        body = self.mechanism.bodies[self._numbering.drive.index(signal)]
        return float(joint_sizes(body.name, body.joint, self.length)[0])

    def _rate(self) -> float:
        """Return how fast gravity and drives move the mechanism, 1/s; zero: neither does."""
        signals = self.data.arrays.signals
        paces = [pace(signals[k], self._drive_size(k)) for k in set(self.drive_signals())]
        weight = float(np.linalg.norm(self.data.arrays.world["gravity"][0]))
        return max(np.sqrt(weight / self.length), *(1.0 / x for x in paces if x), 0.0)

    def _row_sizes(self, names: list[str]) -> Array:
        """Return the units of the kept rows; before any is dropped, of all."""
        return self._row_size[self.data.arrays.kept >= 0] if names else np.zeros(0)

    def _free_bodies(self) -> list[Body]:
        """Return the bodies whose joints have free coordinates of their own."""
        return [b for b in self.mechanism.bodies if b.joint.drive is None and not shared(b)]

    def start_positions(self) -> Array:
        """Return the first free positions (nq,) as given to the builder, loops not closed yet."""
        return self._gather("start", "nq", "rest")

    def start_velocities(self) -> Array:
        """Return the first free velocities (n,) as given to the builder."""
        return self._gather("rate", "nv", None)

    def _gather(self, attribute: str, count: str, default: str | None) -> Array:
        parts = [np.zeros(0)]
        for body in self._free_bodies():
            joint = body.joint
            given = getattr(joint, attribute)
            if given is None:
                parts.append(getattr(joint, default)() if default else np.zeros(getattr(joint, count)))
                continue
            value = np.atleast_1d(array_of(f"{attribute} of body {body.name!r}", given))
            if value.shape != (getattr(joint, count),) or not np.all(np.isfinite(value)):
                raise UserError(
                    f"{attribute} of body {body.name!r} is {given!r}; it needs {getattr(joint, count)} finite numbers"
                )
            if attribute == "start" and joint.quaternion:
                value = with_unit_quaternion(body.name, value)
            parts.append(value)
        return np.concatenate(parts)

    def held(self) -> NDArray[np.bool_]:
        """Return which free velocity coordinates (n,) assembly must leave as they are."""
        parts = [np.full(b.joint.nv, b.joint.fixed) for b in self._free_bodies()]
        return np.concatenate([np.zeros(0, bool), *parts])

    def assemble(self, t: float = 0.0) -> tuple[Array, Array]:
        """Close the loops from the start given to the builder; return consistent (q, v).

        Raises
        ------
        AssemblyError
            A loop cannot close (says which and by how much), or a free motion has no inertia.
        """
        q = self.close(t, self.start_positions(), self.held())
        v = assemble_velocities(self.system, t, q, self.start_velocities(), self.held())
        check_inertia(self.system, t, q, v)
        return q, v

    def close(self, t: float, start: Array, held: NDArray[np.bool_]) -> Array:
        """Return positions (nq,) with closed loops near ``start``; ``held`` coordinates (n,) stay.

        Raises
        ------
        AssemblyError
            A loop cannot close, or closes the wrong way round; says which and by how much.
        """
        if not self.mechanism.cuts:
            return start.copy()
        self.system.fill_position(t, start, self.system.allocate_terms())
        drawn = frame_angles(self.mechanism.cuts, self.data.state)
        try:
            q = assemble_positions(self.system, t, start, held)
        except AssemblyError as error:
            if drawn.max() < 1.0:  # rad
                raise
            worst = int(np.argmax(drawn))
            raise AssemblyError(
                f"{error}; the frames of cut joint {self.mechanism.cuts[worst].name!r} are drawn "
                f"{np.degrees(drawn[worst]):.0f} deg apart"
            ) from error
        self.check_frames(t, q, drawn)
        return q

    def check_frames(self, t: float, q: Array, drawn: Array | None = None) -> None:
        """Raise AssemblyError where the frames of a cut joint are closed, but the wrong way round.

        ``drawn`` are the angles between them, rad, in the position the loops were closed from.
        """
        self.system.fill_position(t, q, self.system.allocate_terms())
        check_frames(self.mechanism.cuts, self.data.state, drawn)

    def beside(self, t: float, q: Array) -> Array:
        """Return a closed position near q (nq,) off singular ones, where the fewest rows depend on others; or q.

        One coordinate is held where it was moved to: closing would lead back to a singular position else.
        """
        best, random, n = q, np.random.default_rng(1), self.system.n
        fewest = len(dependent_rows(self.system, t, q))
        for moved in random.permutation(n)[:4]:
            near = q.copy()
            self.system.apply(near, self.system.size * random.uniform(0.02, 0.05, n) * random.choice((-1.0, 1.0), n))
            try:
                near = self.close(t, near, np.arange(n) == moved)
            except AssemblyError:
                continue
            count = len(dependent_rows(self.system, t, near))
            if count <= fewest:
                best, fewest = near, count
        return best

    def loops(self, t: float, q: Array) -> list[str]:
        """Return in sentences which rows of the cut joints are void and which are redundant about q (nq,)."""
        names = self.system.constraint_names
        redundant = dependent_rows(self.system, t, self.beside(t, q))
        lines = describe(self.mechanism.cuts, self.void_rows, [names[i] for i in redundant])
        lost = len(dependent_rows(self.system, t, q)) - len(redundant)
        if lost > 0:
            rows = "1 more row depends" if lost == 1 else f"{lost} more rows depend"
            lines.append(f"a singular position: {rows} on the others there")
        return lines

    def cut_wrenches(self, t: float, q: Array, v: Array, lam: Array) -> Array:
        """Return what every cut joint exerts on its bodies a and b (cuts, 2, 6), each in the axes of that body."""
        self.system.fill(t, q, v, self.system.allocate_terms())
        arrays, state = self.data
        rows, load = state.rows, np.where(arrays.kept >= 0, lam[arrays.kept], 0.0)
        found = np.zeros((len(arrays.cuts), 2, 6))
        ends = [*arrays.cuts["row"][1:], len(rows)]
        for wrenches, cut, end in zip(found, arrays.cuts, ends, strict=True):
            own = slice(int(cut["row"]), int(end))
            for wrench, body, G in zip(wrenches, (cut["a"], cut["b"]), (rows["Ga"], rows["Gb"]), strict=True):
                wrench[:] = -(load[own] @ G[own]).reshape(2, 3).dot(state.bodies["A"][int(body)]).ravel()
        return found

    def drives(self) -> list[tuple[str, float, float]]:
        """Return name, speed and largest higher coefficient of every driven coordinate's signal at its start.

        A signal that is no polynomial counts as one of no constant speed.
        """
        found = []
        for i, body in enumerate(self.mechanism.bodies):
            if body.joint.drive is not None:
                signal = self.data.arrays.signals[self._numbering.drive[i]]
                higher = np.abs(signal["c"][2 if signal["kind"] == POLYNOMIAL else 1 :]).max()
                speed = 0.0 if signal["kind"] == RUN_UP else float(signal["c"][1])
                found.append((body.name, speed, float(higher)))
        return found

    def drive_rates(self) -> list[float]:
        """Return the constant speed of every drive, without sign, in units of its coordinate per second."""
        signals = self.data.arrays.signals
        return [abs(float(signals[k]["c"][1])) / self._drive_size(k) for k in set(self.drive_signals())]

    def finish_run_ups(self) -> None:
        """Let every drive that runs up have its full speed from now on."""
        for k in self.drive_signals():
            signal = self.data.arrays.signals[k]
            if signal["kind"] == RUN_UP:
                signal["kind"], signal["c"][2] = POLYNOMIAL, 0.0

    def drive_signals(self) -> list[int]:
        """Return the index of every driven coordinate's signal."""
        return [k for k in self._numbering.drive if k >= 0]

    def input_places(self, arrays: Any) -> list[tuple[Any, int]]:
        """Return where ``arrays`` of this plant or its complex twin keep every input: a vector and an index."""
        return [
            (
                arrays.world["gravity"][0] if slot.signal == GRAVITY else arrays.signals["c"][slot.signal],
                slot.coefficient,
            )
            for slot in self._numbering.slots
        ]

    def observe_complex(self, system: System, t: float, q: Any, v: Any, a: Any, lam: Any) -> NDArray[np.complex128]:
        """Return the outputs at a state of :meth:`complex_system`."""
        out = np.zeros(len(self.outputs), complex)
        observe(t, q, v, a, lam, self._sensors[: len(out)], system.held_data, out)
        return out

    def _input_motions(self) -> dict[int, InputMotion]:
        """Return the motion of every drive that is an input, by the number of its signal."""
        motions: dict[int, InputMotion] = {}
        for slot in self._numbering.slots:
            if slot.signal in self.drive_signals() and slot.signal not in motions:
                speed = isinstance(self._numbering.signals[slot.signal], SpeedInput)
                record = self.data.arrays.signals[slot.signal]
                motions[slot.signal] = InputMotion(slot.variable.name, record, speed=speed)
        return motions

    def moves_support(self, index: int) -> bool:
        """Whether an input is the position or the rate of a driven coordinate."""
        return self._numbering.slots[index].signal in self._motions

    def start_input(self, index: int, value: float, t: float = 0.0) -> None:
        """Let an input (finite) have another value at the start, t."""
        self._hold(index, value, t)
        if self.moves_support(index):
            self._motions[self._numbering.slots[index].signal].start()

    def set_input(self, index: int, value: float, t: float = 0.0) -> None:
        """Take the value (finite) of an input at time t.

        What loads the mechanism holds from t on, and one with a rate goes on from what it has reached. What moves a
        support is noted, for :meth:`depart`.
        """
        if self.moves_support(index):
            slot = self._numbering.slots[index]
            self._motions[slot.signal].give(slot.coefficient, self._finite(index, value))
        else:
            self._hold(index, value, t)

    def _hold(self, index: int, value: float, t: float) -> None:
        slot = self._numbering.slots[index]
        if slot.signal != GRAVITY:
            signal = self.data.arrays.signals[slot.signal]
            signal["c"][0] += (t - signal["t0"]) * signal["c"][1]
            signal["t0"] = t
        place, k = self.input_places(self.data.arrays)[index]
        place[k] = self._finite(index, value)

    def _finite(self, index: int, value: float) -> float:
        if not np.isfinite(value):
            raise UserError(f"input {self.inputs[index].name!r} is {value!r}; it must be finite")
        return float(value)

    @property
    def settled(self) -> bool:
        """Whether every support goes on as it does until an input is set."""
        return all(motion.settled for motion in self._motions.values())

    def depart(self, t: float, end: float) -> list[Departure]:
        """Return the supports whose motion changes at t for a step until ``end`` (s), see :mod:`.motion`."""
        found = (motion.depart(t, end) for motion in self._motions.values())
        return [departure for departure in found if departure is not None]

    def set_out(self, t: float, departures: Sequence[Departure], accelerations: Callable[[], Array]) -> Array:
        """Let supports depart at t; return the jump of the free velocities (n,).

        ``accelerations`` returns v' (n,) at t; what it raises leaves the supports on their way.
        """
        dv = np.zeros(self.system.n)
        if any(d.jump != 0.0 for d in departures):
            signals: Any = self.data.arrays.signals
            before = signals.copy()
            try:
                dv = impulse(t, departures, accelerations)
            finally:
                signals[:] = before
        for motion, leg, _ in departures:
            motion.set_out(leg)
        return dv

    def input_state(self) -> dict[str, list[Any]]:
        """Return what the inputs hold, to be given to :meth:`restore_inputs`."""
        arrays: Any = self.data.arrays
        held: list[Any] = []
        for slot in self._numbering.slots:
            if slot.signal == GRAVITY:
                held.append((0.0, [float(arrays.world["gravity"][0, slot.coefficient])]))
            else:
                signal = arrays.signals[slot.signal]
                held.append((float(signal["t0"]), [float(x) for x in signal["c"]]))
        return {"held": held, "motions": [motion.state() for motion in self._motions.values()]}

    def restore_inputs(self, state: dict[str, list[Any]]) -> None:
        """Let the inputs hold what they held when ``state`` was taken."""
        arrays: Any = self.data.arrays
        for slot, (t0, c) in zip(self._numbering.slots, state["held"], strict=True):
            if slot.signal == GRAVITY:
                arrays.world["gravity"][0, slot.coefficient] = c[0]
            else:
                signal = arrays.signals[slot.signal]
                signal["t0"], signal["c"] = t0, c
        for motion, remembered in zip(self._motions.values(), state["motions"], strict=True):
            motion.restore(remembered)

    def observe(self, t: float, q: Array, v: Array, a: Array, lam: Array, out: Array) -> None:
        """Fill ``out`` (len(outputs),) from the solution: accelerations a (n,), multipliers lam (m,).

        With two entries more its last are the energy and the kinetic energy, J.
        """
        observe(t, q, v, a, lam, self._sensors[: len(out)], self.system.held_data, out)

    def observe_all(self, times: Array, q: Array, v: Array, a: Array, lam: Array, out: Array) -> None:
        """Fill ``out`` (k, len(outputs)), or two columns more, from the solution at k times as :meth:`observe` does."""
        observe_all(times, q, v, a, lam, self._sensors[: out.shape[1]], self.system.held_data, out)

    def energy(self, t: float, q: Array, v: Array) -> float:
        """Kinetic and potential energy, J."""
        return float(energy(t, q, v, self.system.held_data))

    def bend(self, t: float, q: Array) -> Bend | None:
        """Return how plates bend at free positions q (nq,); None where there are none."""
        if not self.mechanism.plates:
            return None
        self.energy(t, q, np.zeros(self.system.n))  # places them
        return bend(self.mechanism, self.data)

    def residuals(self, t: float, q: Array, v: Array) -> tuple[float, float]:
        """Largest constraint residual in position and in velocity."""
        if self.system.m == 0:
            return 0.0, 0.0
        terms = self.system.allocate_terms()
        self.system.fill(t, q, v, terms)
        return tuple(float(largest_residual(which, *self.data)) for which in (False, True))  # type: ignore[return-value]

    def adopt(self, other: Plant) -> None:
        """Take over the numbers of a plant of the same structure, built with other parameter values.

        Inputs keep their values. Raises UserError where the structures differ.
        """
        mine: Any = self.data.arrays
        theirs: Any = other.data.arrays
        if any(a.shape != b.shape for a, b in zip(mine, theirs, strict=True)) or np.any(mine.kept != theirs.kept):
            raise UserError("the parameter changes the structure of the mechanism; it cannot change during a run")
        inputs = self.input_state()
        for a, b in zip(mine, theirs, strict=True):
            a[...] = b
        self.restore_inputs(inputs)

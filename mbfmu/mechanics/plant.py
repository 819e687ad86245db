"""A compiled mechanism at work: what simulation and FMU hold."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.errors import AssemblyError, UserError
from solvers.system import Array, System, TreeSystem

from .arrays import Data, complex_twin
from .assembly import assemble_positions, assemble_velocities, check_inertia
from .bending import Bend, bend
from .checks import with_unit_quaternion
from .compile import GRAVITY, Numbering, Variable, compile_data, sensor_records, shared
from .dynamics import callbacks, energy, observe, observe_all, tree_callbacks
from .mechanism import Mechanism
from .numbers import array_of
from .sensors import largest_residual
from .signals import POLYNOMIAL, RUN_UP
from .tangent import Groups, Tangent, find_groups

LARGE = 60  # coordinates of a tree without loops from which on no dense matrix is made
LARGE_LOOPS = 100  # ... of a mechanism with cut joints, which only 'ida' advances then
WIDEST = 1000  # bodies in a group of the structured tangent: its matrix has twelve rows a body


class Plant:
    """A mechanism as arrays, with its inputs, its outputs and the system a solver takes.

    Attributes
    ----------
    system
        The equations of motion over the free coordinates.
    inputs, outputs
        Variables in the order of :meth:`set_input` and :meth:`observe`.
    void_rows
        Names of cut-joint rows that no free motion works against; dropped.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        self._numbering = numbering = Numbering(mechanism)
        self.data = compile_data(mechanism, numbering)
        names = [f"{c.name}.{r}" if r else c.name for c in mechanism.cuts for r in c.cut.rows]
        self.void_rows: list[str] = []
        large = not mechanism.elastics and numbering.nv > (LARGE_LOOPS if names else LARGE)  # T knows no modes
        make = self._tree_system if large else self._system
        self.system: Any = make(names, self.data)
        if names:
            self.void_rows = self._drop_void_rows(names)
            self.system = make([n for n in names if n not in self.void_rows], self.data)
        self.inputs = tuple(slot.variable for slot in numbering.slots)
        self.outputs = tuple(Variable(n, s.unit, d, 0.0, nominal) for n, s, d, nominal in mechanism.outputs)
        self._sensors = sensor_records(mechanism, numbering, self.data.arrays.kept)

    def complex_system(self) -> System:
        """Return the system as it is now on complex numbers, for derivatives by complex step."""
        return self._system(list(self.system.constraint_names), complex_twin(self.data), complex)

    def _system(self, constraint_names: list[str], data: Data, scalar: type = float) -> System:
        dynamics, position, motion, retract, jacobi = callbacks(scalar)
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
            coordinate_names=tuple(self._numbering.coordinate_names),
            constraint_names=tuple(constraint_names),
        )

    def _tree_system(self, constraint_names: list[str], data: Data) -> TreeSystem:
        """Return the system of a large tree."""
        inverse, forward, mobility, position, constraints, retract = tree_callbacks()
        places: list[tuple[int, int]] = []
        quaternions: list[tuple[int, int]] = []
        sizes = [np.zeros(0)]
        for record, body in zip(self.data.arrays.bodies, self.mechanism.bodies, strict=True):
            if record["vf"] < 0:
                continue
            plain = int(record["nq"] - 4 * record["quaternion"])
            places += [(int(record["qf"]) + k, int(record["vf"]) + k) for k in range(plain)]
            if record["quaternion"]:
                quaternions.append((int(record["qf"]) + plain, int(record["vf"]) + plain))
            sizes.append(np.full(int(record["nv"]), body.joint.size))
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
            size=np.concatenate(sizes),
            plain=(in_q, in_v),
            quaternions=tuple(quaternions),
            coordinate_names=tuple(self._numbering.coordinate_names),
            constraint_names=tuple(constraint_names),
        )

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

        A few random positions decide: a row that is not void vanishes there with probability zero.
        """
        system, kept = self.system, self.data.arrays.kept
        terms = system.allocate_terms()
        largest, residual = np.zeros(system.m), np.zeros(system.m)
        random = np.random.default_rng(0)
        for _ in range(3):
            q = self.start_positions()
            system.apply(q, random.normal(size=system.n))
            system.fill_position(0.0, q, terms)
            largest = np.maximum(largest, np.abs(terms.J).max(axis=1, initial=0.0))
            residual = np.maximum(residual, np.abs(terms.Phi))
        void = largest < 1e-12
        for i in np.flatnonzero(void & (residual > 1e-9)):
            raise AssemblyError(
                f"loop cannot close: {names[i]!r} is off by {residual[i]:.3g} and no free joint can change that"
            )
        kept[:] = np.where(void, -1, np.cumsum(~void) - 1)
        return [names[i] for i in np.flatnonzero(void)]

    def start_positions(self) -> Array:
        """Return the first free positions (nq,) as given to the builder, loops not closed yet."""
        return self._gather("start", "nq", "rest")

    def start_velocities(self) -> Array:
        """Return the first free velocities (n,) as given to the builder."""
        return self._gather("rate", "nv", None)

    def _gather(self, attribute: str, count: str, default: str | None) -> Array:
        parts = [np.zeros(0)]
        for body in self.mechanism.bodies:
            joint = body.joint
            if joint.drive is not None or shared(body):
                continue
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
        free = [b for b in self.mechanism.bodies if b.joint.drive is None and not shared(b)]
        parts = [np.full(b.joint.nv, b.joint.fixed) for b in free]
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
            A loop cannot close; says which and by how much.
        """
        return assemble_positions(self.system, t, start, held)

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
        observe(t, q, v, a, lam, self._sensors, system.held_data, out)
        return out

    def set_input(self, index: int, value: float, t: float = 0.0) -> None:
        """Write an input (finite) that holds from time t on; one with a rate goes on from what it has reached."""
        if not np.isfinite(value):
            raise UserError(f"input {self.inputs[index].name!r} is {value!r}; it must be finite")
        slot = self._numbering.slots[index]
        if slot.signal != GRAVITY:
            signal = self.data.arrays.signals[slot.signal]
            signal["c"][0] += (t - signal["t0"]) * signal["c"][1]
            signal["t0"] = t
        place, k = self.input_places(self.data.arrays)[index]
        place[k] = value

    def input_state(self) -> list[tuple[float, list[float]]]:
        """Return what the inputs hold, to be given to :meth:`restore_inputs`."""
        arrays: Any = self.data.arrays
        state = []
        for slot in self._numbering.slots:
            if slot.signal == GRAVITY:
                state.append((0.0, [float(arrays.world["gravity"][0, slot.coefficient])]))
            else:
                signal = arrays.signals[slot.signal]
                state.append((float(signal["t0"]), [float(x) for x in signal["c"]]))
        return state

    def restore_inputs(self, state: list[tuple[float, list[float]]]) -> None:
        """Let the inputs hold what they held when ``state`` was taken."""
        arrays: Any = self.data.arrays
        for slot, (t0, c) in zip(self._numbering.slots, state, strict=True):
            if slot.signal == GRAVITY:
                arrays.world["gravity"][0, slot.coefficient] = c[0]
            else:
                signal = arrays.signals[slot.signal]
                signal["t0"], signal["c"] = t0, c

    def observe(self, t: float, q: Array, v: Array, a: Array, lam: Array, out: Array) -> None:
        """Fill ``out`` (len(outputs),) from the solution: accelerations a (n,), multipliers lam (m,)."""
        observe(t, q, v, a, lam, self._sensors, self.system.held_data, out)

    def observe_all(self, times: Array, q: Array, v: Array, a: Array, lam: Array, out: Array) -> None:
        """Fill ``out`` (k, len(outputs)) from the solution at k times, one row each."""
        observe_all(times, q, v, a, lam, self._sensors, self.system.held_data, out)

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

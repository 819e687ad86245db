"""Joints that are locked during a run: the same arrays with fewer free coordinates.

A locked joint follows a constant signal, as the joint of a drive follows the signal of the drive. The arrays of the
mechanism remain where they are, so that inputs, sensors and forces are not affected: only the joint becomes a driven
one, and the coordinates that remain free are numbered again. Every set of locked joints thus has its own system of
equations, and solvers start with it as with another mechanism. Constraint equations that no free coordinate changes
are left out of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.sensors import CouplingEffort, RowForce
from solvers.system import MAX_SOLVER_DENSE_COORDINATES, AnySystem, Array

from .numbering import Numbering
from .rows import find_constant_rows
from .stop_rows import StopRows
from .systems import MAX_DENSE_TREE_COORDINATES

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays
    from mbfmu.mechanics.signals import InUse

    from .compiled_mechanism import CompiledMechanism
    from .systems import Systems


class JointLocks:
    """The locked joints of a compiled mechanism.

    Parameters
    ----------
    mechanism, arrays, numbering, signals
        Mechanism, its arrays, its numbering and its signals.
    systems, system
        What makes its systems, and the one without locked joints.
    rows
        Constraint equations that hold sensors at stops.

    Attributes
    ----------
    system
        The system without locked joints.
    held
        Coordinates of the locked joints, rad or m, by the numbers of their bodies.
    held_stops
        Numbers of the constraint equations that hold sensors at stops now, ascending.
    is_driven
        Whether drives move the mechanism.
    can_lock
        Whether joints are locked in runs: by events, or at stops that are rested on.
    signals
        Numbers of the signals that joints follow while they are locked, by the numbers of their bodies.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        arrays: Arrays,
        numbering: Numbering,
        signals: list[InUse],
        systems: Systems,
        system: AnySystem,
        rows: StopRows,
    ) -> None:
        self._rows = rows
        self._arrays, self._systems, self.system = arrays, systems, system
        self.signals = dict(numbering.holds)
        self._signals = {body: (number, signals[number]) for body, number in numbering.holds.items()}
        self.held: dict[int, float] = {}
        self.held_stops: tuple[int, ...] = ()
        self._kept, self._is_read = arrays.kept.copy(), find_read_rows(mechanism, arrays)
        bodies, couplings = arrays.bodies, arrays.couplings
        fields = ((bodies, ("qf", "vf", "drive")), (couplings, ("fa", "fb")), (arrays.world, ("drives",)))
        self._free = [(table, name, table[name].copy()) for table, names in fields for name in names]
        self._places = {body: (int(bodies["qf"][body]), int(bodies["vf"][body])) for body in self._signals}
        self.can_lock = bool(self._signals) or bool(rows.names)
        self.is_driven = bool(arrays.world["drives"][0])

    @contextmanager
    def suspended(self) -> Iterator[None]:
        """Number the arrays in this block as without locked joints."""
        held, kept = self.held, self._arrays.kept.copy()
        self._number({})
        try:
            yield
        finally:
            self._number(held)
            self._arrays.kept[:] = kept

    def _number(self, held: Mapping[int, float]) -> None:
        """Number the free coordinates in the arrays, with these joints locked at these coordinates."""
        self.held = dict(held)
        if not self._signals:
            return
        for table, name, free in self._free:
            table[name] = free
        self._arrays.kept[:] = self._kept
        if not held:
            return
        removed_q, removed_v = (np.array(sorted(self._places[body][k] for body in held), np.int64) for k in range(2))
        arrays, bodies = self._arrays, list(held)
        arrays.bodies["qf"] = renumbered(arrays.bodies["qf"], removed_q)
        arrays.bodies["vf"] = renumbered(arrays.bodies["vf"], removed_v)
        arrays.bodies["qf"][bodies], arrays.bodies["vf"][bodies] = -1, -1
        for name in ("fa", "fb"):
            coupled = arrays.couplings[name]
            arrays.couplings[name] = np.where(np.isin(coupled, removed_v), -1, renumbered(coupled, removed_v))
        for body, value in held.items():
            arrays.bodies["drive"][body], signal = self._signals[body]
            signal.signal.hold(signal, value)
        arrays.world["drives"] = 1

    def lock(self, held: Mapping[int, float], stops: tuple[int, ...], t: float, q: Array) -> AnySystem:
        """Lock these joints at these coordinates, and hold sensors at these stops, and no others; return the system of
        what remains free.

        t, s, and q (nq,) are a time and positions without locked joints with closed loops.
        """
        self._number(held)
        self.held_stops = stops
        if not held and not stops:
            return self.system
        systems, free = self._systems_now()
        names = list(self.system.constraint_names)
        system = systems.make(names)
        kept = self._arrays.kept >= 0
        constant = find_constant_rows(system, t, q[free]) & ~self._is_read[kept] if held else np.zeros(len(names), bool)
        if constant.any():
            self._arrays.kept[kept] = np.where(constant, -1, np.cumsum(~constant) - 1)
            names = [name for name, drops in zip(names, constant, strict=True) if not drops]
            system = systems.make(names)
        return self._rows.system(systems, names, stops) if stops else system

    def _systems_now(self) -> tuple[Systems, NDArray[np.bool_]]:
        """Return what makes systems with the locked joints of now, and which positions (nq,) are free."""
        free, remaining = self._remaining()
        found = self._systems.with_locked_joints(frozenset(self.held), int(free.sum()), remaining, self.system.m)
        return found, free

    def stop_slopes(self, system: AnySystem, t: float, q: Array, v: Array) -> tuple[Array, Array]:
        """Return J (k, n) and gamma (k,) of the constraint equations of stops, none of which holds, at a state of the
        present system.
        """
        return self._rows.slopes(self._systems_now()[0], system.constraint_names, t, q, v)

    def stop_number(self, event: str, by_matrices: bool) -> int | None:
        """Return the number of the constraint equation of the stop of an event; None: there is none.

        There is none in large models if the solver of the run does not solve equations ``by_matrices``.
        """
        limit = MAX_SOLVER_DENSE_COORDINATES if by_matrices else MAX_DENSE_TREE_COORDINATES
        has_matrices = self.system.has_matrices or by_matrices
        is_held = has_matrices and self.system.n <= limit and event in self._rows.names
        return self._rows.names.index(event) if is_held else None

    def stop_forces(self, lam: Array) -> Array:
        """Return the multipliers (k,) of the stops that hold, of those of the present system (m,)."""
        return lam[len(lam) - len(self.held_stops) :]

    def size_of(self, body: int) -> float:
        """Return the unit of the coordinate of a joint that can be locked."""
        return float(self.system.size[self._places[body][1]])

    def all_coordinates(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return positions and velocities without locked joints of those of the present system, (nq,) and (n,)."""
        positions, velocities = self._remaining()
        all_q, all_v = np.zeros(len(positions)), np.zeros(len(velocities))
        all_q[positions], all_v[velocities] = q, v
        for body, value in self.held.items():
            all_q[self._places[body][0]] = value
        return all_q, all_v

    def free_coordinates(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return positions and velocities of the present system of all those without locked joints."""
        positions, velocities = self._remaining()
        return q[positions], v[velocities]

    def _remaining(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which positions (nq,) and velocities (n,) without locked joints are free now."""
        q, v = np.ones(self.system.nq, bool), np.ones(self.system.n, bool)
        for body in self.held:
            at = self._places[body]
            q[at[0]], v[at[1]] = False, False
        return q, v


@contextmanager
def without_locks(compiled: CompiledMechanism) -> Iterator[None]:
    """Let a compiled mechanism take positions and velocities without locked joints in this block."""
    system = compiled.system
    with compiled.locks.suspended():
        compiled.system = compiled.locks.system
        try:
            yield
        finally:
            compiled.system = system


def find_read_rows(mechanism: Mechanism, arrays: Arrays) -> NDArray[np.bool_]:
    """Return which constraint equations outputs read, of all those of cut joints and couplings."""
    found = np.zeros(len(arrays.kept), bool)
    for _, sensor, *_ in mechanism.outputs:
        if isinstance(sensor, CouplingEffort):
            found[int(arrays.couplings["row"][sensor.item.index])] = True
        elif isinstance(sensor, RowForce):
            found[int(arrays.cuts["row"][sensor.item.index]) + sensor.component] = True
    return found


def renumbered(numbers: NDArray[np.int64], removed: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the numbers that coordinates have without those ``removed``, ascending; -1 where there is none."""
    return np.where(numbers < 0, -1, numbers - np.searchsorted(removed, numbers))

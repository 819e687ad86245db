"""A compiled mechanism at work: what simulation and FMU hold."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from math import log10, prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.builder.arrangement import arrange
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.builder.short_forces import declare_short_forces
from mbfmu.mechanics.elimination import EliminatedLoops
from mbfmu.mechanics.kind import ElementType
from mbfmu.mechanics.records import Arrays, Data, ItemRecord
from mbfmu.mechanics.recursions.dynamics import energy, observe
from mbfmu.mechanics.sensors import Follows, largest_residual
from mbfmu.mechanics.signals import Input, InUse
from mbfmu.mechanics.tangent import Groups, Tangent
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import AssemblyError, UserError
from mbfmu.util.units import read_unit
from solvers.compiled.record import Table
from solvers.compiled.tuple_pointer import unpin
from solvers.system import Array, System

from .assembly import Assembly, free_bodies, start_positions
from .bounds import check_bounds
from .coincident import WITH_DIRECTION, find_coincident
from .compile import CompiledElements, check_rows
from .given_inputs import GivenInputs
from .inputs import Drives, Inputs
from .joint_locks import JointLocks
from .load_estimates import fill_estimates
from .load_groups import LoadGroup, largest_ratio, load_groups
from .numbering import Numbering, Variable
from .redundant import drive_motions
from .rounded import describe_omitted, measure_rows
from .rounding import Rounding
from .rows import VANISHING_TOLERANCE, find_vanishing_rows, first_of, row_names
from .scale import characteristic_length, describe_assumed_length
from .signal_dependence import SignalDependence
from .stop_rows import StopRows
from .systems import Systems
from .tables import REAL, CalledKernel, NumberTypes


class CompiledMechanism:
    """Compiled mechanism: arrays, inputs, outputs, and the system of equations for solvers.

    Parameters
    ----------
    mechanism
        Complete mechanism.
    given_inputs
        Inputs given for the whole run; these are not inputs of the compiled mechanism.

    Attributes
    ----------
    system
        The equations of motion over the free coordinates.
    assembly
        Assembly of its loops at the start.
    drives, inputs
        Drives and inputs of the mechanism.
    outputs
        Variables in the order of :meth:`observe`.
    watched, watched_rates
        Numbers of the parts that are the sensors of events, and their rates as far as they are known.
    sampled
        Numbers of the parts that are the inputs of sampled blocks.
    locks
        Joints that events lock.
    length
        Characteristic length, m; see :func:`.scale.characteristic_length`.
    vanishing_rows
        Names of trivially satisfied constraint equations, which are removed.
    rounded_rows
        Those that are trivially satisfied except for rounding of the geometry, with a warning about each.
    corrections
        Warnings about loops whose joints are shifted and turned so that redundant equations close.
    """

    def __init__(self, mechanism: Mechanism, given_inputs: GivenInputs | None = None) -> None:
        if len(mechanism.bodies) == 1:
            raise UserError("the mechanism has no bodies; add at least one with Mechanism.body")
        if not mechanism.compiled:
            declare_short_forces(mechanism)
            arrange(mechanism)
        mechanism.compiled = True
        self.mechanism = mechanism
        numbering = Numbering(mechanism, given_inputs)
        try:
            self._elements = elements = CompiledElements(mechanism, numbering)
        except MemoryError as error:
            what = f"a mechanism of {len(mechanism.bodies)} bodies"
            raise UserError(f"{what} needs more memory than is available; use fewer bodies") from error
        self._history = np.array(numbering.history, np.int64)
        self.data, self.watched, self.watched_rates = elements.data, elements.watched, elements.watched_rates
        self.sampled = elements.sampled
        check_bounds(mechanism, elements.called(), self.data)
        self.length = characteristic_length(mechanism, self.data.arrays)
        self.drives = Drives(mechanism, numbering, elements.signals, self.length)
        polynomials = elements.table(Input)
        self.inputs = Inputs(numbering, self.data.arrays, elements.signals, polynomials, self.drives)
        self._systems = Systems(mechanism, numbering, elements, self.drives, self.length)
        self.data.arrays.residual_scale[:] = self.length / self._systems.row_size
        names = row_names(mechanism.constraints)
        self.vanishing_rows: list[str] = []
        self.rounded_rows: dict[str, Diagnostic] = {}
        self.system: Any = self._systems.make(names)
        if names:
            self.vanishing_rows = self._drop_vanishing_rows(names)
            self.system = self._systems.make([n for n in names if n not in self.vanishing_rows])
        fill_estimates(mechanism, self.system, self.data, self.length)
        rows = StopRows(mechanism, elements, self.length)
        fixed = mechanism, self.data.arrays, numbering, elements.signals
        self.locks = JointLocks(*fixed, self._systems, self.system, rows)
        loops, row_size = EliminatedLoops.of(self.system), self._systems.row_size
        motions = drive_motions(self.drives, self.inputs, elements.signals)
        self._rounding = Rounding(mechanism, self.data, self.system, row_size, motions, loops)
        self.corrections = self._rounding.correct()
        self.assembly = Assembly(mechanism, self.system, self.data, self.vanishing_rows, loops)
        self.outputs = tuple(Variable(n, s.unit, d, 0.0, nominal) for n, s, d, nominal in mechanism.outputs)
        check_rows(mechanism, self.data.arrays.kept)

    def _drop_vanishing_rows(self, names: list[str]) -> list[str]:
        """Renumber the constraint equations that are not trivially satisfied; return the names of the others, which are
        removed.
        """
        signals, before = self._elements.signals, self.data.arrays.memory.copy()
        start, system, mechanism = start_positions(self.mechanism), self.system, self.mechanism
        self.place_bodies(0.0, start)
        measures = measure_rows(mechanism, self.data.state, system.row_size)
        units = [unit for handle in mechanism.constraints for unit in handle.units]
        slack, why = measures.allowed(mechanism.assembly_tolerance) / system.row_size, measures.axes
        vanishing, gaps = find_vanishing_rows(system, start, self.drives, self.inputs, signals, units, slack, why)
        for i in np.flatnonzero(vanishing & (gaps > VANISHING_TOLERANCE)):
            self.rounded_rows[names[i]] = describe_omitted(
                names[i], f"{gaps[i] * system.row_size[i]:.2g} {units[i]}", mechanism.assembly_tolerance, why[i]
            )
        self.data.arrays.memory[:] = before
        self.data.arrays.kept[:] = np.where(vanishing, -1, np.cumsum(~vanishing) - 1)
        return [names[i] for i in np.flatnonzero(vanishing)]

    @property
    def rounding(self) -> list[Diagnostic]:
        """Warnings about constraint equations that are left out, and corrected joint frames; of many the first."""
        dropped = first_of([*self.rounded_rows.values()], "constraints are left out")
        return [*dropped, *first_of(self.corrections, "groups of loops are corrected")]

    def assemble(self, t: float = 0.0) -> tuple[Array, Array]:
        """Close the loops from the given start; return consistent positions (nq,) and velocities (n,).

        Raises
        ------
        AssemblyError
            A loop cannot be closed (with its name and the residual), or a free motion has no inertia.
        UserError
            The bodies of an element are not where it needs them.
        """
        try:
            q, v = self.assembly.assemble(t)
        except AssemblyError as error:
            raise AssemblyError(". ".join([str(error), *self._rounding.explain_open(t)])) from error
        self.check_positions(t, q)
        return q, v

    def explain_lock(self, t: float, q: Array, freedom: int) -> list[Diagnostic]:
        """Return warnings about joints that cannot move about q (nq,) because of the given numbers, or one that nothing
        can if there is no ``freedom``; empty: nothing is locked so.
        """
        locked = self._rounding.explain_lock(t, q)
        return (self.assembly.explain_lock(t, q, locked) if freedom == 0 else []) or locked

    def check_positions(self, t: float, q: Array) -> None:
        """Raise UserError if at free positions q (nq,) bodies are not where the elements between them need them."""
        for group in self._load_groups("check_positions", t, q):
            group.ask("check_positions")
        for group in self._load_groups("misplacement", t, q):
            group.require_places()

    def check_start(self, t: float, q: Array) -> list[Diagnostic]:
        """Return what loads warn of where a run starts at free positions q (nq,); UserError where it cannot."""
        groups = self._load_groups("check_start", t, q)
        found = []
        for group in groups:
            texts = group.ask("check_start")
            if not isinstance(texts, list | tuple) or not all(isinstance(text, str) for text in texts):
                kind = type(group.acting[0].load).__name__
                raise UserError(
                    f"check_start of {kind} returned {texts!r}; allowed: a list of texts, empty if all is well"
                )
            found += [Diagnostic.parse(text, "warning", "element-at-start") for text in texts]
        return found

    def _load_groups(self, hook: str, t: float, q: Array) -> list[LoadGroup]:
        """Return the loads of every type with this hook, with the bodies at free positions q (nq,)."""
        found = list(load_groups(self.mechanism, self.data, self.kernel_data, hook))
        if found:
            self.place_bodies(t, q)
        return found

    def feedthrough(self) -> list[tuple[int, ...]]:
        """Return for every output the numbers of the inputs with direct feedthrough."""
        behind = SignalDependence(self.mechanism, self._elements)
        return [
            tuple(k for k in range(len(self.inputs)) if self.inputs.changes(k, sensor.follows, behind.signals(sensor)))
            for _, sensor, *_ in self.mechanism.outputs
        ]

    def nonlinear_inputs(self) -> list[int]:
        """Return the numbers of the inputs in which the equations of motion or the outputs are not known to be linear,
        such as arguments of laws and normal forces of frictions; none that move joints.
        """
        return self.inputs.of_loads(SignalDependence(self.mechanism, self._elements).nonlinear_signals())

    @property
    def has_force_outputs(self) -> bool:
        """Whether some output is a force, a moment or a generalized force."""
        return any(sensor.follows is Follows.FORCES for _, sensor, *_ in self.mechanism.outputs)

    @property
    def stiff_outputs(self) -> list[str]:
        """Names of the outputs with large errors due to small errors of positions."""
        return [name for name, sensor, *_ in self.mechanism.outputs if sensor.stiff]

    def nominal(self, unit: str) -> float:
        """Return the order of magnitude of quantities with this unit: by the heaviest body, the length and the rate."""
        exponents, factor = read_unit(unit)
        mass = float(self.data.arrays.bodies["mass"].max()) or 1.0
        sizes = {"kg": mass, "m": self.length, "s": 1.0 / (self.system.rate or 1.0), "rad": 1.0, "A": 1.0}
        size = prod(sizes[base] ** n for base, n in exponents.items()) / factor
        return 10.0 ** round(log10(size))

    def records(self, kind: type[ElementType]) -> NDArray[Any]:
        """Return the records of a type of joint, cut joint, load, signal or sensor, in the order of their addition."""
        return self._elements.table(kind)

    @property
    def tables(self) -> list[NDArray[Any]]:
        """The records of all element types in the order of ``data.arrays.memory``."""
        return self._elements.tables

    @property
    def kernel_data(self) -> Any:
        """Arrays and state for kernels; see :mod:`solvers.compiled.tuple_pointer`."""
        return unpin(self.system.pinned_data)

    def called(self, numbers: NumberTypes = REAL) -> list[CalledKernel | None]:
        """Return the kernels of element types for these numbers, in the order of their addresses in the arrays."""
        return self._elements.called(numbers)

    @property
    def histories(self) -> list[Array]:
        """Arrays with the histories of loads, which are a part of the state of a run; empty: no load has one."""
        return [self.data.arrays.numbers] if len(self._history) else []

    @contextmanager
    def histories_kept(self) -> Iterator[None]:
        """Let the histories of loads after this block be those before it: steps in it are a trial."""
        numbers = self.data.arrays.numbers
        kept = numbers[self._history]
        try:
            yield
        finally:
            numbers[self._history] = kept

    def signals(self, data: Data) -> list[InUse]:
        """Return every signal as it is in data of this compiled mechanism: its own, or those of a complex system."""
        return self._elements.signals_in(data)

    def magnitudes(self) -> list[tuple[str, InUse]]:
        """Return what each signal of a load is in messages, and the signal."""
        elements = self._elements
        return [(what, elements.signals[k]) for what, known in elements.magnitudes.items() for _, k in known]

    def complex_system(self) -> System:
        """Return the system as it is now on complex numbers, for derivatives by complex step."""
        return self._systems.make_complex(list(self.system.constraint_names))

    def tangent(self, groups: Groups | None = None) -> Tangent:
        """Return the structured tangent at the state of this compiled mechanism, over these groups of bodies."""
        return self._systems.tangent(groups)

    def tangent_arrays(self) -> Arrays:
        """Return the arrays with the kernels ``tangent`` of loads; a real state has none of them otherwise."""
        return self._elements.tangent_arrays()

    def place_bodies(self, t: float, q: Array) -> None:
        """Place the bodies in ``data.state`` where they are at rest at free positions q (nq,)."""
        self.energy(t, q, np.zeros(self.system.n))

    def poses(self, t: float, q: Array) -> tuple[Array, Array]:
        """Return origins (bodies, 3), m, and axes as columns (bodies, 3, 3), global, of all bodies, ground first."""
        self.place_bodies(t, q)
        bodies = self.data.state.bodies
        return bodies["r"].copy(), bodies["A"].copy()

    def mass_matrix(self, t: float, q: Array) -> Array:
        """Return M (n, n) of the free velocities at positions q (nq,), independent of loops."""
        system = self._with_matrices()
        terms = system.allocate_terms()
        system.fill(t, q, np.zeros(system.n), terms)
        return terms.M

    def inverse_dynamics(self, t: float, q: Array, v: Array, a: Array, lam: Array | None = None) -> Array:
        """Return the generalized forces M a + h + J^T lambda (n,) that a motion requires in addition to the loads.

        q (nq,), v and a (n,), multipliers lam (m,), none by default. Zero where a and lam are those of the motion.
        """
        system = self.system
        if not system.has_matrices:
            return np.asarray(system.residual(t, q, v, a, lam))
        terms = system.allocate_terms()
        system.fill(t, q, v, terms)
        return np.asarray(terms.M @ a + terms.h + (0.0 if lam is None else lam @ terms.J))

    def _with_matrices(self) -> System:
        return self.system if self.system.has_matrices else self.system.dense()

    def cut_wrenches(self, t: float, q: Array, v: Array, lam: Array) -> Array:
        """Return the wrench of every cut joint on its bodies a and b (cuts, 2, 6), in the axes of that body."""
        self.system.fill(t, q, v, self.system.allocate_terms())
        arrays, state = self.data
        rows, load = state.rows, np.zeros(len(arrays.kept))
        load[arrays.kept >= 0] = lam  # numbers of kept rows ascend
        found = np.zeros((len(arrays.cuts), 2, 6))
        for wrenches, cut in zip(found, arrays.cuts, strict=True):
            own = slice(int(cut["row"]), int(cut["end"]))
            for wrench, body, G in zip(wrenches, (cut["a"], cut["b"]), (rows["Ga"], rows["Gb"]), strict=True):
                wrench[:] = -(load[own] @ G[own]).reshape(2, 3).dot(state.bodies["A"][int(body)]).ravel()
        return found

    def observe_complex(self, system: System, t: float, q: Any, v: Any, a: Any, lam: Any) -> NDArray[np.complex128]:
        """Return the outputs at a state of :meth:`complex_system`."""
        out = np.zeros(len(self.outputs), complex)
        observe(t, q, v, a, lam, system.pinned_data, out)
        return out

    def observe(self, t: float, q: Array, v: Array, a: Array, lam: Array, out: Array) -> None:
        """Fill ``out`` (len(outputs),) from the solution: accelerations a (n,), multipliers lam (m,).

        With two entries more its last are the energy and the kinetic energy, J.
        """
        observe(t, q, v, a, lam, self.system.pinned_data, out)

    def observe_all(self, times: Array, q: Array, v: Array, a: Array, lam: Array, out: Array) -> None:
        """Fill ``out`` (k, len(outputs)), or two columns more, from the solution at k times as :meth:`observe` does."""
        self.system.observe_all(times, q, v, a, lam, out)

    def energy(self, t: float, q: Array, v: Array) -> float:
        """Kinetic and potential energy, J."""
        return float(energy(t, q, v, self.system.pinned_data))

    def coincident(self, t: float, q: Array) -> list[Diagnostic]:
        """Return a warning about every force between points that has no direction at free positions q (nq,)."""
        if not any(isinstance(acting.load, WITH_DIRECTION) for acting in self.mechanism.loads()):
            return []
        self.place_bodies(t, q)
        return find_coincident(self.mechanism, self.data.state.bodies, self.length)

    def describe_assumed_length(self) -> list[Diagnostic]:
        """Return a note if displacements are measured by a length that the mechanism does not have."""
        return describe_assumed_length(self.mechanism, self.data.arrays, free_bodies(self.mechanism))

    @cached_property
    def monitored(self) -> Table[ItemRecord]:
        """The loads that have limits of their theory."""
        found = load_groups(self.mechanism, self.data, self.kernel_data, "monitor")
        numbers = np.concatenate([np.zeros(0, np.int64), *(group.numbers for group in found)])
        loads: Any = self.data.arrays.loads
        return loads[numbers]

    def limit_ratio(self, t: float, q: Array) -> float:
        """Return the largest ratio of :func:`mbfmu.mechanics.limit_ratio` at free positions q (nq,); zero: no load has
        one.
        """
        if not len(self.monitored):
            return 0.0
        self.place_bodies(t, q)
        return float(largest_ratio(self.monitored, *self.kernel_data))

    def describe_limit(self, t: float, q: Array, when: str = "") -> str:
        """Return which elements are beyond the limits of their theory at free positions q (nq,), and what to do.

        ``when`` is text about the time, such as ``" at t = 0.3 s"``.
        """
        groups = self._load_groups("monitor", t, q)
        loads: Any = self.data.arrays.loads
        ratios = [largest_ratio(loads[group.numbers], *self.kernel_data) for group in groups]
        worst = int(np.argmax(ratios))
        group, ratio = groups[worst], float(ratios[worst])
        try:
            text = group.ask("describe_limit", ratio, when)
        except UserError as error:
            text, failed = "", f" ({error})"
        else:
            failed = f" (describe_limit returned {text!r}; allowed: a text)"
        if isinstance(text, str) and text:
            return text
        return (
            f"an element of type {type(group.acting[0].load).__name__} is beyond the limits of its theory{when}{failed}"
        )

    def residuals(self, t: float, q: Array, v: Array) -> tuple[float, float]:
        """Largest constraint residual in position, m, and velocity, m/s, of the residual outputs."""
        if self.system.m == 0:
            return 0.0, 0.0
        terms = self.system.allocate_terms()
        self.system.fill(t, q, v, terms)
        return tuple(float(largest_residual(which, *self.kernel_data)) for which in (False, True))  # type: ignore[return-value]

    def adopt(self, other: CompiledMechanism) -> None:
        """Copy the numbers of a compiled mechanism of the same structure, built with other parameter values.

        Inputs and histories of loads keep their values, and locked joints remain locked. Raises UserError where the
        structures differ.
        """
        mine: Any = self.data.arrays
        theirs: Any = other.data.arrays
        with self.locks.suspended():
            alike = all(a.shape == b.shape for a, b in zip(mine, theirs, strict=True))
            if not alike or np.any(mine.kept != theirs.kept) or np.any(mine.kernels != theirs.kernels):
                raise UserError("the parameter changes the structure of the mechanism; it cannot change during a run")
            inputs, history = self.inputs.state(), mine.numbers[self._history]
            for a, b in zip(mine, theirs, strict=True):
                a[...] = b
            mine.numbers[self._history] = history
            self.inputs.restore(inputs)

"""What the runtime offers to a host: entry points over one instance, and the kernels that recursions call by address.

Kernels know types of arrays and no sizes, so what is compiled for an example serves every model of its family: all that
one stepper integrates. Callbacks of the equations are called by their names here, where a simulation in Python hands
them on by their addresses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.arrays.closing import CutFrames
from mbfmu.mechanics.arrays.compile import CompiledElements
from mbfmu.mechanics.arrays.compiled_mechanism import CompiledMechanism
from mbfmu.mechanics.arrays.input_kernels import InputRecords, start_input
from mbfmu.mechanics.arrays.tables import LINEARIZED, TANGENT_NUMBERS, CalledKernel
from mbfmu.mechanics.dispatch import cut_monitor
from mbfmu.mechanics.elimination import closes_by_elimination
from mbfmu.mechanics.records import ItemRecord, empty_data
from mbfmu.mechanics.recursions.active_loads import discard_lists
from mbfmu.mechanics.recursions.dynamics import input_step_limit
from mbfmu.modeling.variables import COUNTERS
from mbfmu.session.event_search import search_memory
from mbfmu.session.kernels.event_points import EventSearch
from mbfmu.session.kernels.points import Session, begin_session, energy_at
from mbfmu.session.kernels.sequence import SolverActions, sequence_of
from mbfmu.session.simulation import Simulation
from solvers.compiled.kernel import jit_uncached, records, types
from solvers.compiled.tuple_pointer import pin, unpin
from solvers.energy_account import ACCOUNT_SIZE, WORK, EnergyScales
from solvers.loop_closure import ASSEMBLED, ClosureScratch
from solvers.options import OPTIONS
from solvers.outcome import NOT_FINITE, OK
from solvers.positions import Positions
from solvers.stepper import advance_in_pieces_of
from solvers.steppers.step_control import TRUNCATED_STEPS
from solvers.steppers.step_loop import Integration
from solvers.system import Array

from . import eliminated
from .derivatives import LINEAR_LOAD, NONLINEAR_LOAD, Linearization, empty_linearized, to_linearized
from .event_exchange import event_exchange_entries
from .event_memory import StepBegin, empty_memory, memory_of
from .event_steps import event_entries
from .exchange_memory import Exchange
from .families import ELIMINATED_FAMILIES, FAMILIES
from .image import MemoryImage
from .kernel_table import kernel_numbers, numbers_in_fmu
from .model_exchange import FORMULATIONS, exchange_entries
from .refusals import refuse_model
from .resting_memory import empty_resting_memory, resting_memory
from .sampled_blocks import no_sampled_memory, sampled_memory
from .start_checks import Start, check_resolution, find_misplaced
from .steady_export import steady_start
from .steady_start import SteadyStart


class Instance(NamedTuple):
    """One instance of a model, as the entry points take it: a run of :mod:`mbfmu.session.kernels.sequence`."""

    session: Any  # mbfmu.session.kernels.points.Session
    inputs: Any  # mbfmu.mechanics.arrays.input_kernels.InputRecords, those of the session
    clock: Array  # (1,) s, the reported time
    q: Array  # the reported state and its energy account, those of ``given``
    v: Array
    energy_account: Array
    a: Array  # (n,) accelerations
    lam: Array  # (m,) multipliers
    dv: Array  # (n,) jump of the velocities
    out: Array  # outputs
    given: Any  # solvers.steppers.step_loop.Integration
    eqs: Any  # equations and scratch of the formulation: those of ``given``, or what they have of it
    work: Any
    start: Any  # .start_checks.Start
    # (4,) rates of the system and of its loops, 1/s; the characteristic length, m, and that of the export
    known: Array
    options: NDArray[Any]  # (1,) solvers.options.OPTIONS
    counts: NDArray[np.int64]  # of the solver, by COUNTERS
    frames: Any  # mbfmu.mechanics.arrays.closing.CutFrames
    angles: Array  # (cuts,) rad, scratch
    positions: Any  # solvers.positions.Positions
    exchange: Any  # mbfmu.native.exchange_memory.Exchange
    steady: Any  # mbfmu.native.steady_start.SteadyStart
    linearization: Any  # mbfmu.native.derivatives.Linearization
    search: Any  # mbfmu.session.kernels.event_points.EventSearch
    events: Any  # .event_memory.EventMemory
    resting: Any  # .resting_memory.RestingMemory
    step_begin: Any  # .event_memory.StepBegin
    sampled: Any  # .sampled_blocks.SampledMemory


class Entry(NamedTuple):
    """An entry point: a function over an instance, and types of what it is called with after that."""

    function: Callable[..., int]
    more: tuple[Any, ...]


def family_of(simulation: Simulation) -> str:
    """Return the family of a simulation; empty: the runtime has none for its solver."""
    loop = getattr(simulation.stepper, "loop", None)
    return next((name for name, own in FAMILIES.items() if own.loop is loop), "")


def called_in_fmu(
    elements: CompiledMechanism | CompiledElements, family: str, differentiates: bool
) -> list[CalledKernel | None]:
    """Return the kernels that an FMU of a family calls: in steps, by the structured tangent, for derivatives."""
    derived = elements.called(TANGENT_NUMBERS) if FAMILIES[family].uses_tangent else []
    return [*elements.called(), *derived, *(elements.called(LINEARIZED) if differentiates else [])]


def instance_of(simulation: Simulation, differentiates: bool) -> Instance:
    """Return an instance that is assembled and yet to begin, where a simulation began; with zeros for the functions.

    ``differentiates``: it has the memory for derivatives.
    """
    stepper: Any = simulation.stepper
    compiled, system, family = simulation.compiled, simulation.compiled.system, FAMILIES[family_of(simulation)]
    given, (q, v) = unpin(stepper.integration), (array.copy() for array in simulation.start)
    sizes = system.nq, system.n, system.m
    structure = family.structure.of(compiled)
    eqs = family.equations(dict.fromkeys(family.callbacks, 0), system.pinned_data, structure, *sizes)
    work = family.work(*sizes, system.placed)
    if "nonholonomic" in work._fields:
        work = work._replace(nonholonomic=system.nonholonomic.copy())
    shared_eqs, shared = family.formulation(eqs, work)
    shared.size[:] = system.size
    shared.inertia["watched"] = family.formulation(unpin(given.eqs), unpin(given.work))[1].inertia["watched"]
    for name in {"mesh_mask", "friction_velocity"} & {*work._fields}:
        getattr(work, name)[:] = getattr(unpin(given.work), name)
    assembly = compiled.assembly
    scratch = ClosureScratch.of(system, assembly.held(), assembly.given())._replace(size=shared.size)
    start = Start(assembly.start_positions(), assembly.start_velocities(), scratch, int(closes_by_elimination(system)))
    scales = EnergyScales.of(simulation.settings.tolerance, np.zeros(system.n), np.zeros(system.n))
    own = Integration(eqs, given.settings, family.memory(*sizes), work, scales, q, v, np.zeros(ACCOUNT_SIZE))
    lengths = compiled.length, compiled.length
    known = np.array([system.rate, system.loop_rate if system.has_matrices else 0.0, *lengths])
    session = Session.allocate(system.pinned_data, compiled.inputs.own, compiled.monitored)
    state = np.array([simulation.t]), q, v, own.energy_account
    buffers = np.zeros(system.n), np.zeros(system.m), np.zeros(system.n), np.zeros(len(simulation.variables))
    settings = known, stepper.options.record(), np.zeros(len(COUNTERS), np.int64)
    places = assembly.frames, np.zeros(len(compiled.mechanism.cuts)), system.placed
    linear = linearization_of(simulation) if differentiates else Linearization.example(pin(empty_linearized()))
    branch = FORMULATIONS[family_of(simulation)].branch
    more = Exchange.allocate(system.nq, system.n, lambda: branch(*sizes)), steady_start(simulation), linear
    first = session, session.inputs, *state, *buffers, own, shared_eqs, shared, start
    events = memory_of(compiled)
    search = search_memory(compiled)._replace(crossed=events.crossed)
    step_begin = StepBegin.allocate(len(search.sides))
    examined = search, events, resting_memory(compiled), step_begin, sampled_memory(compiled)
    return Instance(*first, *settings, *places, *more, *examined)


def linearization_of(simulation: Simulation) -> Linearization:
    """Return the memory for derivatives of a simulation, with zeros for the addresses of kernels."""
    compiled, system = simulation.compiled, simulation.compiled.system
    data = pin(to_linearized(compiled.data, np.zeros_like(compiled.data.arrays.kernels)))
    inputs = compiled.inputs
    signals = np.full(len(inputs), LINEAR_LOAD)
    signals[compiled.nonlinear_inputs()] = NONLINEAR_LOAD
    for signal, (_, coefficients, _) in inputs.supports().items():
        signals[[inputs.number(signal, k) for k in coefficients]] = signal
    return Linearization.allocate(data, signals, system.nq, system.n, system.m, len(simulation.variables))


def has_events(compiled: CompiledMechanism) -> bool:
    """Whether a mechanism has events or sampled blocks, so that the steps of the solver are examined."""
    return bool(compiled.mechanism.events or compiled.mechanism.sampled)


def uses_sundials(instance: Instance) -> bool:
    """Whether an instance calls SUNDIALS."""
    return "ida" in instance.given.memory._fields


def image_of(simulation: Simulation, differentiates: bool = False) -> tuple[Instance, MemoryImage]:
    """Return the instance of a simulation that has just been made, and its block; see :func:`instance_of`.

    Raises
    ------
    UserError
        Its solver, or a kernel of it, is not in the runtime.
    """
    family, compiled = family_of(simulation), simulation.compiled
    refuse_model(simulation, family)
    instance = instance_of(simulation, differentiates)
    tables = _kernel_tables(compiled, instance, family, differentiates)
    restarts = any(event.restarts for event in compiled.mechanism.events)
    snapshot = instance.step_begin.snapshot(instance.events.control, restarts) if has_events(compiled) else None
    return instance, MemoryImage(instance, _saved_arrays(compiled, instance, family), tables, snapshot)


def _kernel_tables(
    compiled: CompiledMechanism, instance: Instance, family: str, differentiates: bool
) -> list[tuple[NDArray[np.int64], Sequence[int]]]:
    """Return the tables of addresses of kernels, with the numbers of these kernels in the runtime."""
    known, arrays = numbers_in_fmu(called_in_fmu(compiled, family, differentiates)), compiled.data.arrays
    tables: list[tuple[NDArray[np.int64], Sequence[int]]] = [(arrays.kernels, kernel_numbers(compiled.called(), known))]
    if FAMILIES[family].uses_tangent:
        table = unpin(unpin(instance.given.eqs.tangent).arrays).kernels
        tables.append((table, kernel_numbers(compiled.called(TANGENT_NUMBERS), known)))
    if differentiates:
        linear = unpin(unpin(instance.linearization.data).arrays)
        tables.append((linear.kernels, kernel_numbers(compiled.called(LINEARIZED), known)))
    return tables


def _saved_arrays(compiled: CompiledMechanism, instance: Instance, family: str) -> list[NDArray[Any]]:
    """Return the arrays that are saved and restored, those of the solver first."""
    own, start, arrays = instance.given, instance.start, compiled.data.arrays
    memory = own.memory
    state = [
        *(memory.memory() if uses_sundials(instance) else memory),
        instance.clock,
        own.q,
        own.v,
        own.energy_account,
        own.settings,
        *own.work.memory(),
        *own.scales,
    ]
    state += [*instance.events.memory(), *instance.resting.memory()]
    state += [*instance.search.memory(), *instance.sampled.memory()]
    units = instance.work.size, instance.work.size_q, start.scratch.row
    state += [start.q, start.v, *units, instance.known, instance.options]
    if family in ELIMINATED_FAMILIES:
        state += eliminated.units_of(instance.eqs)
    state += instance.session.memory()
    state += [array for array in arrays if array is not arrays.kernels]
    return [*state, *instance.exchange.memory()]


def example(name: str) -> Any:
    """Return an instance of the types that all of a family have, held."""
    family, z = FAMILIES[name], np.zeros
    positions = Positions(z(1, np.int64), z(1, np.int64), z((1, 2), np.int64), z(1, np.int64))
    data = pin(empty_data())
    eqs = family.equations(family.callbacks, data, family.structure.empty(), 1, 1, 1)
    work = family.work(1, 1, 1, positions)
    own = family.memory(1, 1, 1), work, EnergyScales.of(1e-6, z(1), z(1))
    state = z(1), z(1), z(ACCOUNT_SIZE)
    given = Integration(eqs, records(1, family.loop.SETTINGS), *own, *state)
    session = Session.allocate(data, InputRecords.example(), ItemRecord.zeros(1))
    start, frames = Start(z(1), z(1), ClosureScratch.allocate(1, 1), 0), CutFrames.example()
    settings = z(4), records(1, OPTIONS), z(1, np.int64)
    run = session, session.inputs, z(1), *state, z(1), z(1), z(1), z(1)
    linear = Linearization.example(pin(empty_linearized()))
    more = Exchange.allocate(1, 1, lambda: FORMULATIONS[name].branch(1, 1, 1)), SteadyStart.empty(), linear
    shared_eqs, shared = family.formulation(eqs, work)
    places = np.zeros(2, np.int64), np.zeros(1, np.int64), np.zeros(1, np.int64), np.zeros(1, np.int64), z(1)
    stops = empty_memory(), empty_resting_memory()
    event_parts = EventSearch.allocate(*places), *stops, StepBegin.allocate(), no_sampled_memory()
    first = *run, given, shared_eqs, shared, start, *settings
    return pin(Instance(*first, frames, z(1), positions, *more, *event_parts))


def solver_actions(name: str) -> SolverActions:
    """Return what the solvers of a family do for an instance, as kernels."""
    family = FAMILIES[name]
    advance_reported, needs_work = family.loop.advance_reported, family.needs_work
    start_method, limit_method, _ = family.method

    @jit_uncached
    def limit_steps(instance: Any, t: float) -> float:
        own = instance.given
        longest, until = input_step_limit(t, instance.eqs.data)
        longest = min(longest, instance.options[0].max_step)
        limit_method(own.memory, own.settings, t, own.q, own.v, own.energy_account[WORK], longest)
        return float(until)

    @jit_uncached
    def advance_to(instance: Any, t: float) -> int:
        code: int = advance_reported(instance.given, t)
        return code

    advance_in_pieces: Any = jit_uncached(advance_in_pieces_of(limit_steps, advance_to))

    @jit_uncached
    def advance(instance: Any, end: float) -> int:
        """Advance to ``end``, s; on failure the last good state stays."""
        status = instance.session.status[0]
        if end > instance.clock[0] or status.code != OK:
            status.code = advance_in_pieces(instance, instance.clock[0], end)
            instance.clock[0] = end if status.code == OK else instance.given.memory.control[0].t
        return int(status.code)

    @jit_uncached
    def start_at_state(instance: Any, truncated_steps: int, keeps_position: bool) -> None:
        own = instance.given
        has_work = instance.eqs.data.arrays.world[0].nonconservative == 1 and needs_work(own.settings[0])
        own.settings[0].works = 1 if has_work else 0
        state = instance.clock[0], own.q, own.v, own.energy_account[WORK]
        start_method(own.memory, *state, truncated_steps, keeps_position)

    start: Any = family.start or start_at_state

    @jit_uncached
    def continue_at_state(instance: Any) -> None:
        start(instance, TRUNCATED_STEPS, instance.session.status[0].code == OK)

    @jit_uncached
    def restart(instance: Any) -> None:
        start(instance, 0, False)

    continue_after_jump = continue_at_state if family.keeps_history_at_jumps else restart

    @jit_uncached
    def jump(instance: Any) -> None:
        for i in range(instance.dv.shape[0]):
            instance.v[i] += instance.dv[i]
        continue_after_jump(instance)

    placed = family.leaves_placed, family.evaluates_placed
    return SolverActions(advance, family.evaluate, continue_at_state, restart, jump, *placed)


def entries(name: str) -> dict[str, Entry]:
    """Return the entry points of a family by their names."""
    family, actions = FAMILIES[name], solver_actions(name)
    assembled, begun, counted = family.assemble, family.begin, family.method.count
    restored, closed, balanced = family.restore, family.close, family.balance
    sequence, advanced = sequence_of(actions, jit_uncached), actions.advance
    read_advanced = sequence_of(actions._replace(evaluate=family.evaluate_advanced), jit_uncached).read
    restarted, continued = actions.restart, actions.continue_at_state

    def start(instance: Any, index: int, value: float) -> int:
        """Let an input have another value at the start, before :func:`begin`."""
        if not abs(value) < np.inf:
            return NOT_FINITE
        start_input(instance.inputs, index, value, instance.clock[0])
        return OK

    def assemble(instance: Any, t: float) -> int:
        """Let the reported state be the start with its loops closed at t (s); return a code of solvers.loop_closure.

        If it is not ASSEMBLED, ``worst`` or ``massless`` of the scratch contains the cause, and there is no state.
        It may be TURNED or MISPLACED too.
        """
        discard_lists(instance.eqs.data.state)
        code: int = assembled(instance, t)
        return code if code != ASSEMBLED else int(find_misplaced(instance, t))

    def balance(instance: Any) -> int:
        """Let the reported state be the steady state near the start."""
        code: int = balanced(instance)
        return code

    def begin(instance: Any, t: float) -> int:
        """Begin at t (s) and the reported state, as a stepper that is constructed there."""
        problem = instance.given
        instance.clock[0], problem.scales.rtol[0] = t, instance.options[0].rtol
        code, rate = begun(instance, t)
        restarted(instance)
        options, states = instance.options[0], instance.positions.states.shape[0]
        freedom = problem.v.shape[0] - states - problem.memory.control[0].rank
        begin_session(
            instance.session,
            t,
            problem.q,
            problem.v,
            code,
            options.energy_check == 1,
            freedom,
            options.rtol,
            instance.known[0],
            instance.known[2],
        )
        size_q, worst = instance.work.size_q, instance.start.scratch.worst[0]
        found = check_resolution(t, rate, problem.q, size_q, options.rtol, worst)
        if found != ASSEMBLED:
            instance.session.status[0].flaw = found
        return int(code)

    def continue_at_state(instance: Any) -> int:
        """Go on where loads have changed."""
        continued(instance)
        return OK

    def advance(instance: Any, t: float) -> int:
        """Advance to t, s, without what communication points do."""
        code: int = advanced(instance, t)
        return code

    def count(instance: Any) -> int:
        """Write the cost of the run so far."""
        counted(instance.given.memory, instance.counts)
        return OK

    def restore(instance: Any) -> int:
        """Continue from arrays that were saved, which are in their places again."""
        discard_lists(instance.eqs.data.state)
        restored(instance.given, instance.options)
        return OK

    def locate_contact(instance: Any, cut: float) -> int:
        """Write where a wheel touches its profile in the reported state; ``cut`` is the number of the cut joint."""
        session, status = instance.session, instance.session.status[0]
        energy_at(session, instance.clock[0], instance.q, instance.v)  # places the bodies
        arrays = session.data.arrays
        found = cut_monitor(arrays.cuts[int(cut)], arrays, session.data.state)
        status.contact, status.second_contact, status.depth = found
        return OK

    def close(instance: Any) -> int:
        """Free what was allocated outside of the block."""
        closed(instance.given)
        return OK

    timed, given = (types.float64,), (types.int64, types.float64)
    exchange = exchange_entries(name, jit_uncached(sequence.read))
    events = event_entries(family, actions, sequence)
    events |= event_exchange_entries(family, FORMULATIONS[name], exchange["exchange_update"][0])
    return {
        "start": Entry(start, given),
        "assemble": Entry(assemble, timed),
        "balance": Entry(balance, ()),
        "begin": Entry(begin, timed),
        "set": Entry(sequence.set_input, (*given, types.float64)),
        "step": Entry(sequence.step, timed),
        "advance": Entry(advance, timed),
        "continue_at_state": Entry(continue_at_state, ()),
        "note_energy": Entry(sequence.note_energy, ()),
        "retune": Entry(sequence.retune, ()),
        "read": Entry(sequence.read, ()),
        "read_advanced": Entry(read_advanced, ()),  # directly after a step
        "count": Entry(count, ()),
        "restore": Entry(restore, ()),
        "close": Entry(close, ()),
        "locate_contact": Entry(locate_contact, timed),
        **{own: Entry(*entry) for own, entry in exchange.items()},
        **{own: Entry(function, timed) for own, function in events.items()},
    }

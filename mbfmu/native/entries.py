"""What the runtime offers to a host: entry points over one instance, and the kernels that recursions call by address.

Kernels know types of arrays and no sizes, so what is compiled for an example serves every model of its family: all that
one stepper integrates. Callbacks of the equations are called by their names here, where a simulation in Python hands
them on by their addresses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import couplings, cuts, elements, joints, loads, sensors, signals
from mbfmu.mechanics.arrays.points import (
    LOADS_CHANGED,
    MOTION_STARTS,
    RATE_JUMPS,
    SUPPORT_MOTION,
    InputRecords,
    begin_support_motions,
    perturb_motions,
    restore_motions,
    start_input,
)
from mbfmu.mechanics.arrays.tables import REAL, CalledKernel
from mbfmu.mechanics.kind import ElementType, element_types_of, kernel_of, record_of
from mbfmu.mechanics.records import empty_data
from mbfmu.mechanics.recursions.dynamics import input_step_limit, observe
from mbfmu.modeling.variables import COUNTERS
from mbfmu.session.simulation import Simulation
from mbfmu.util.errors import UserError
from solvers.assembly import Scratch
from solvers.balance import BALANCE
from solvers.compiled.kernel import as_kernel, jit_uncached, records, types
from solvers.compiled.tuple_pointer import pin, unpin
from solvers.energy_account import ACCOUNT_SIZE, EnergyScales
from solvers.options import OPTIONS
from solvers.outcome import NOT_FINITE, OK
from solvers.positions import Positions
from solvers.steppers import drop_unlisted
from solvers.steppers.compiled_loop import Integration
from solvers.system import Array

from .communication_points import (
    RUN_STATUS,
    apply_input,
    begin_points,
    check_energy,
    energy_at,
    fill_energy_outputs,
    measure_plate_bending,
    record_outcome,
    start_support_motion,
    store_velocity_jump,
)
from .families import FAMILIES, NATIVE_SOLVERS
from .image import MemoryImage
from .start_checks import Frames, check_resolution

COMPONENT_ROLES: dict[ModuleType, type[ElementType]] = {
    joints: joints.Joint, cuts: cuts.Cut, couplings: couplings.Coupling, loads: loads.Load, elements: loads.Load,
    signals: signals.Signal, sensors: sensors.Sensor,
}  # fmt: skip
KERNEL_TABLE_SYMBOL = "mb_kinds"  # symbol of the addresses of all kernels of kinds


class Start(NamedTuple):
    """What a mechanism is assembled from."""

    q: Array  # (nq,) first positions, as given to the builder
    v: Array  # (n,) first velocities, see q
    scratch: Any  # solvers.assembly.Scratch: units, what is held, and which rows or coordinates are wrong


class Instance(NamedTuple):
    """One instance of a model, as the entry points take it."""

    given: Any  # solvers.steppers.compiled_loop.Integration
    start: Any  # Start
    a: Array  # (n,) accelerations
    lam: Array  # (m,) multipliers
    out: Array  # outputs
    clock: Array  # (1,) s, the reported time
    known: Array  # (3,) rates of the system and of its loops, 1/s; the characteristic length, m
    options: NDArray[Any]  # (1,) solvers.options.OPTIONS
    counts: NDArray[np.int64]  # of the solver, by COUNTERS
    inputs: Any  # mbfmu.mechanics.arrays.points.InputRecords
    balance: NDArray[Any]  # (1,) solvers.balance.BALANCE
    run_status: NDArray[Any]  # (1,) RUN_STATUS
    dv: Array  # (n,) jump of the velocities
    cells: NDArray[np.int64]  # (P, 4) bodies at the corners of all plates
    frames: Any  # mbfmu.native.start_checks.Frames
    positions: Any  # solvers.positions.Positions


class Entry(NamedTuple):
    """An entry point: a function over an instance, and types of what it is called with after that."""

    function: Callable[..., int]
    more: tuple[Any, ...]


def family_of(simulation: Simulation) -> str:
    """Return the family of a simulation; empty: the runtime has none for its solver."""
    loop = getattr(simulation.stepper, "loop", None)
    return next((name for name, own in FAMILIES.items() if own.loop is loop), "")


def instance_of(simulation: Simulation) -> Instance:
    """Return an instance that is assembled and yet to begin, where a simulation began; with zeros for the functions."""
    stepper: Any = simulation.stepper
    plant, system, family = simulation.plant, simulation.plant.system, FAMILIES[family_of(simulation)]
    given, (q, v) = unpin(stepper.integration), (array.copy() for array in simulation.start)
    sizes = system.nq, system.n, system.m
    eqs = family.equations(dict.fromkeys(family.callbacks, 0), system.pinned_data, *sizes)
    work = family.work(*sizes, system.placed)
    work.size[:] = system.size
    work.inertia["watched"] = unpin(given.work).inertia["watched"]
    assembly = plant.assembly
    scratch = Scratch.of(system, assembly.held(), assembly.given())._replace(size=work.size)
    if simulation.settings.start_at_equilibrium:
        start = Start(q.copy(), v.copy(), scratch)
    else:
        start = Start(assembly.start_positions(), assembly.start_velocities(), scratch)
    scales = EnergyScales.of(simulation.settings.tolerance, np.zeros(system.n), np.zeros(system.n))
    own = Integration(eqs, given.settings, family.memory(*sizes), work, scales, q, v, np.zeros(ACCOUNT_SIZE))
    known = np.array([system.rate, system.loop_rate if system.has_matrices else 0.0, plant.length])
    buffers = np.zeros(system.n), np.zeros(system.m), np.zeros(len(simulation.variables))
    settings = stepper.options.record(), np.zeros(len(COUNTERS), np.int64)
    balance = simulation.energy_check.balance.copy() if simulation.energy_check else records(1, BALANCE)
    accounts = plant.inputs.own, balance, records(1, RUN_STATUS), np.zeros(system.n), plant.mechanism.cells
    places = Frames.of(plant), system.placed
    return Instance(own, start, *buffers, np.array([simulation.t]), known, *settings, *accounts, *places)  # type: ignore[arg-type]


def image_of(simulation: Simulation) -> tuple[Instance, MemoryImage]:
    """Return the instance of a simulation that has just been made, and its block.

    Raises
    ------
    UserError
        Its solver, or a kernel of it, is not in the runtime.
    """
    family, system = family_of(simulation), simulation.plant.system
    if not family:
        raise UserError(
            f"native FMUs do not support the solver {simulation.solver_choice.solver!r}; allowed: "
            f"{', '.join(drop_unlisted(NATIVE_SOLVERS))}",
            "not-native",
        )
    if family != "tree" and not system.has_matrices:
        what = f"{simulation.solver_choice.solver!r}" if not system.m else f"{system.m} constraints"
        raise UserError(
            f"native FMUs support large models, here with {system.n} joint coordinates, only with 'adams' and without "
            f"constraints; this one has {what}. Export it without --native",
            "not-native",
        )
    known, numbers = {own: k for k, own in enumerate(shipped_kernels())}, []
    for own in simulation.plant.called():
        if own is not None and own not in known:
            what = f"{own.function.__module__}.{own.function.__qualname__}"
            foreign = "<locals>" in what or not what.startswith("mbfmu.")  # or made of a function of the model
            why = "user-defined" if foreign else "not in the runtime"
            raise UserError(
                f"kernel {what} is {why}, and native FMUs support those of mbfmu only; export the model without "
                "--native",
                "not-native",
            )
        numbers.append(-1 if own is None else known[own])
    instance, arrays = instance_of(simulation), simulation.plant.data.arrays
    own, start = instance.given, instance.start
    state = [
        *own.memory,
        instance.clock,
        own.q,
        own.v,
        own.energy_account,
        own.settings,
        *own.work.memory(),
        *own.scales,
    ]
    state += [start.q, start.v, own.work.size, own.work.size_q, start.scratch.row, instance.known, instance.options]
    state += [*instance.inputs.memory(), instance.balance, instance.run_status]
    state += [array for array in arrays if array is not arrays.kernels]
    return instance, MemoryImage(instance, state, arrays.kernels, numbers)


def example(name: str) -> Any:
    """Return an instance of the types that all of a family have, held."""
    family, z = FAMILIES[name], np.zeros
    callbacks = {own: _named(function) for own, function in family.callbacks.items()}
    positions = Positions(z(1, np.int64), z(1, np.int64), z((1, 2), np.int64))
    eqs = family.equations(callbacks, pin(empty_data()), 1, 1, 1)
    own = family.memory(1, 1, 1), family.work(1, 1, 1, positions), EnergyScales.of(1e-6, z(1), z(1))
    given = Integration(eqs, records(1, family.loop.SETTINGS), *own, z(1), z(1), z(ACCOUNT_SIZE))
    start = Start(z(1), z(1), Scratch.allocate(1, 1))
    settings = records(1, OPTIONS), np.zeros(1, np.int64), InputRecords.example()
    frames = Frames(z(1, np.int64), z(1))
    accounts: tuple[Any, ...] = (
        records(1, BALANCE),
        records(1, RUN_STATUS),
        z(1),
        z((1, 4), np.int64),
        frames,
        positions,
    )
    return pin(Instance(given, start, z(1), z(1), z(1), z(1), z(3), *settings, *accounts))


_named = cache(as_kernel)  # what two families call is compiled once


def entries(name: str) -> dict[str, Entry]:
    """Return the entry points of a family by their names."""
    family = FAMILIES[name]
    advance_reported, limit = family.loop.advance_reported, family.limit
    assembled, begun, evaluated = family.assemble, family.begin, family.evaluate
    continued, counted = family.continue_at_state, family.count

    @jit_uncached
    def advance_in_pieces(instance: Any, t: float) -> int:
        """Go to t, s, in pieces in each of which no step may miss a signal, as ``Stepper.advance`` does."""
        problem, reached, code = instance.given, instance.clock[0], OK
        while code == OK:
            longest, until = input_step_limit(reached, problem.eqs.data)
            limit(problem, reached, min(longest, instance.options[0].max_step))
            reached = min(t, until)
            code = advance_reported(problem, reached)
            if not until < t:
                break
        return code

    @jit_uncached
    def impulse(instance: Any) -> int:
        """Put the jump of the velocities into ``instance.dv``, see :mod:`mbfmu.mechanics.arrays.points`."""
        code: int = OK
        for k in range(2):
            if code == OK:
                perturb_motions(instance.inputs, instance.clock[0], float(k))
                code = evaluated(instance)
                store_velocity_jump(instance, k)
        restore_motions(instance.inputs)
        return code

    def start(instance: Any, index: int, value: float) -> int:
        """Let an input have another value at the start, before :func:`begin`."""
        if not abs(value) < np.inf:
            return NOT_FINITE
        start_input(instance.inputs, index, value, instance.clock[0])
        return OK

    def assemble(instance: Any, t: float) -> int:
        """Let the reported state be the start with its loops closed at t (s); return a code of solvers.assembly.

        If it is not ASSEMBLED, ``worst`` or ``massless`` of the scratch contains the cause, and there is no state.
        It may be TURNED too.
        """
        code: int = assembled(instance, t)
        return code

    def begin(instance: Any, t: float) -> int:
        """Begin at t (s) and the reported state, as a stepper that is constructed there."""
        problem = instance.given
        instance.clock[0], problem.scales.rtol[0] = t, instance.options[0].rtol
        code, rate = begun(instance, t)
        continued(instance, True)
        instance.balance[0].is_checked = (
            1 if instance.options[0].energy_check == 1 and problem.v.shape[0] > problem.memory.control[0].rank else 0
        )
        instance.balance[0].tolerance = instance.options[0].rtol
        begin_points(instance, code)
        instance.run_status[0].flaw = check_resolution(
            t, rate, problem.q, problem.work.size_q, problem.scales.rtol[0], instance.start.scratch.worst[0]
        )
        return int(code)

    def continue_at_state(instance: Any) -> int:
        """Go on where loads have changed."""
        continued(instance, False)
        return OK

    def note_energy(instance: Any) -> int:
        """Note the energy, before parameters change; :func:`retune` comes after that."""
        instance.run_status[0].before = energy_at(instance)
        return OK

    def retune(instance: Any) -> int:
        """Restart with other parameters, like ``Simulation.retune``."""
        instance.balance[0].reference_energy += energy_at(instance) - instance.run_status[0].before
        continued(instance, True)
        return OK

    def take_input(instance: Any, index: int, value: float) -> int:
        """Take the value of an input at the time reached, as ``Simulation.set_input`` does."""
        if not abs(value) < np.inf:
            return NOT_FINITE
        if apply_input(instance, index, value) != SUPPORT_MOTION:
            continued(instance, False)
        return OK

    def advance(instance: Any, t: float) -> int:
        """Go to t, s; on failure the last good state stays."""
        record_outcome(instance, t, advance_in_pieces(instance, t))
        return int(instance.run_status[0].code)

    def step(instance: Any, end: float) -> int:
        """Go to a communication point, s, as ``Simulation.advance`` does; on failure the last good state stays."""
        t = instance.clock[0]
        if end > t:
            found = begin_support_motions(instance.inputs, t, end)
            if found & LOADS_CHANGED:
                continued(instance, False)
            if found & MOTION_STARTS:
                jumps, before = found & RATE_JUMPS != 0, energy_at(instance)
                code: int = impulse(instance) if jumps else OK
                instance.run_status[0].unknown = 1 if code != OK else 0
                if code != OK:
                    return code
                start_support_motion(instance, before, jumps)
                continued(instance, False)
        if end > t or instance.run_status[0].code != OK:
            record_outcome(instance, end, advance_in_pieces(instance, end))
        if instance.balance[0].is_checked == 1:
            check_energy(instance, energy_at(instance))
        measure_plate_bending(instance)
        return int(instance.run_status[0].code)

    def read(instance: Any) -> int:
        """Read all outputs at the reported state."""
        problem, t = instance.given, instance.clock[0]
        code: int = evaluated(instance)
        if code == OK:
            observe(t, problem.q, problem.v, instance.a, instance.lam, problem.eqs.data, instance.out)
            fill_energy_outputs(instance)
        return code

    def count(instance: Any) -> int:
        """Write the cost of the run so far."""
        counted(instance.given, instance.counts)
        return OK

    timed, given = (types.float64,), (types.int64, types.float64)
    return {
        "start": Entry(start, given),
        "assemble": Entry(assemble, timed),
        "begin": Entry(begin, timed),
        "set": Entry(take_input, given),
        "step": Entry(step, timed),
        "advance": Entry(advance, timed),
        "continue_at_state": Entry(continue_at_state, ()),
        "note_energy": Entry(note_energy, ()),
        "retune": Entry(retune, ()),
        "read": Entry(read, ()),
        "count": Entry(count, ()),
    }


def shipped_kernels() -> tuple[CalledKernel, ...]:
    """Return the kernels of all kinds that ship, in the order of their addresses in the runtime."""
    return tuple(dict.fromkeys(called for module, role in COMPONENT_ROLES.items() for called in _kernels(module, role)))


def _kernels(module: ModuleType, role: type[ElementType]) -> Iterator[CalledKernel]:
    for kind in element_types_of(module, role):
        for name, signature in kind.kernels.items():
            function = kernel_of(kind, name)
            if function is not None and name in REAL.names:
                yield CalledKernel(function, record_of(kind), signature)

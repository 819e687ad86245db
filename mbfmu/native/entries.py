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
from solvers.steppers.compiled_loop import Integration
from solvers.system import Array

from .communication_points import (
    TOLD,
    arrive,
    begin_points,
    energy_at,
    leave,
    look,
    look_at_plates,
    note_rates,
    take,
    tell_balance,
)
from .families import FAMILIES, SOLVERS
from .image import Image
from .start_checks import Frames, judge_start

ROLES: dict[ModuleType, type[ElementType]] = {
    joints: joints.Joint, cuts: cuts.Cut, couplings: couplings.Coupling, loads: loads.Load, elements: loads.Load,
    signals: signals.Signal, sensors: sensors.Sensor,
}  # fmt: skip
KINDS = "mb_kinds"  # symbol of the addresses of all kernels of kinds


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
    told: NDArray[Any]  # (1,) TOLD
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
    rooms = np.zeros(system.n), np.zeros(system.m), np.zeros(len(simulation.variables))
    settings = stepper.options.record(), np.zeros(len(COUNTERS), np.int64)
    balance = simulation.energy_check.balance.copy() if simulation.energy_check else records(1, BALANCE)
    books = plant.inputs.own, balance, records(1, TOLD), np.zeros(system.n), plant.mechanism.cells
    places = Frames.of(plant), system.placed
    return Instance(own, start, *rooms, np.array([simulation.t]), known, *settings, *books, *places)  # type: ignore[arg-type]


def image_of(simulation: Simulation) -> tuple[Instance, Image]:
    """Return the instance of a simulation that has just been made, and its block.

    Raises
    ------
    UserError
        Its solver, or a kernel of it, is not in the runtime.
    """
    family, system = family_of(simulation), simulation.plant.system
    if not family:
        raise UserError(
            f"native FMUs do not support the solver {simulation.solver_choice.solver!r}; allowed: {', '.join(SOLVERS)}",
            "not-native",
        )
    if family != "tree" and not system.has_matrices:
        what = f"{simulation.solver_choice.solver!r}" if not system.m else f"{system.m} constraints"
        raise UserError(
            f"native FMUs support large models, here with {system.n} joint coordinates, only with 'adams' and without "
            f"constraints; this one has {what}. Export it without --native",
            "not-native",
        )
    known, numbers = {own: k for k, own in enumerate(kinds())}, []
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
    state += [*instance.inputs.memory(), instance.balance, instance.told]
    state += [array for array in arrays if array is not arrays.kernels]
    return instance, Image(instance, state, arrays.kernels, numbers)


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
    books: tuple[Any, ...] = records(1, BALANCE), records(1, TOLD), z(1), z((1, 4), np.int64), frames, positions
    return pin(Instance(given, start, z(1), z(1), z(1), z(1), z(3), *settings, *books))


_named = cache(as_kernel)  # what two families call is compiled once


def entries(name: str) -> dict[str, Entry]:
    """Return the entry points of a family by their names."""
    family = FAMILIES[name]
    advance_reported, limit = family.loop.advance_reported, family.limit
    assembled, begun, evaluated = family.assemble, family.begin, family.evaluate
    renewed, counted = family.renew, family.count

    @jit_uncached
    def go(s: Any, t: float) -> int:
        """Go to t, s, in pieces in each of which no step may miss a signal, as ``Stepper.advance`` does."""
        g, reached, code = s.given, s.clock[0], OK
        while code == OK:
            longest, until = input_step_limit(reached, g.eqs.data)
            limit(g, reached, min(longest, s.options[0].max_step))
            reached = min(t, until)
            code = advance_reported(g, reached)
            if not until < t:
                break
        return code

    @jit_uncached
    def impulse(s: Any) -> int:
        """Put the jump of the velocities into ``s.dv``, see :mod:`mbfmu.mechanics.arrays.points`."""
        code: int = OK
        for k in range(2):
            if code == OK:
                perturb_motions(s.inputs, s.clock[0], float(k))
                code = evaluated(s)
                note_rates(s, k)
        restore_motions(s.inputs)
        return code

    def start(s: Any, index: int, value: float) -> int:
        """Let an input have another value at the start, before :func:`begin`."""
        if not abs(value) < np.inf:
            return NOT_FINITE
        start_input(s.inputs, index, value, s.clock[0])
        return OK

    def assemble(s: Any, t: float) -> int:
        """Let the reported state be the start with its loops closed at t (s); return a code of solvers.assembly.

        If it is not ASSEMBLED, ``worst`` or ``massless`` of the scratch contains the cause, and there is no state.
        It may be TURNED too.
        """
        code: int = assembled(s, t)
        return code

    def begin(s: Any, t: float) -> int:
        """Begin at t (s) and the reported state, as a stepper that is constructed there."""
        g = s.given
        s.clock[0], g.scales.rtol[0] = t, s.options[0].rtol
        code, rate = begun(s, t)
        renewed(s, True)
        s.balance[0].is_checked = 1 if s.options[0].energy_check == 1 and g.v.shape[0] > g.memory.control[0].rank else 0
        s.balance[0].tolerance = s.options[0].rtol
        begin_points(s, code)
        s.told[0].flaw = judge_start(t, rate, g.q, g.work.size_q, g.scales.rtol[0], s.start.scratch.worst[0])
        return int(code)

    def renew(s: Any) -> int:
        """Go on where loads have changed."""
        renewed(s, False)
        return OK

    def weigh(s: Any) -> int:
        """Note the energy, before parameters change; :func:`retune` comes after that."""
        s.told[0].before = energy_at(s)
        return OK

    def retune(s: Any) -> int:
        """Restart with other parameters, like ``Simulation.retune``."""
        s.balance[0].reference_energy += energy_at(s) - s.told[0].before
        renewed(s, True)
        return OK

    def take_input(s: Any, index: int, value: float) -> int:
        """Take the value of an input at the time reached, as ``Simulation.set_input`` does."""
        if not abs(value) < np.inf:
            return NOT_FINITE
        if take(s, index, value) != SUPPORT_MOTION:
            renewed(s, False)
        return OK

    def advance(s: Any, t: float) -> int:
        """Go to t, s; on failure the last good state stays."""
        arrive(s, t, go(s, t))
        return int(s.told[0].code)

    def step(s: Any, end: float) -> int:
        """Go to a communication point, s, as ``Simulation.advance`` does; on failure the last good state stays."""
        t = s.clock[0]
        if end > t:
            found = begin_support_motions(s.inputs, t, end)
            if found & LOADS_CHANGED:
                renewed(s, False)
            if found & MOTION_STARTS:
                jumps, before = found & RATE_JUMPS != 0, energy_at(s)
                code: int = impulse(s) if jumps else OK
                s.told[0].unknown = 1 if code != OK else 0
                if code != OK:
                    return code
                leave(s, before, jumps)
                renewed(s, False)
        if end > t or s.told[0].code != OK:
            arrive(s, end, go(s, end))
        if s.balance[0].is_checked == 1:
            look(s, energy_at(s))
        look_at_plates(s)
        return int(s.told[0].code)

    def read(s: Any) -> int:
        """Read all outputs at the reported state."""
        g, t = s.given, s.clock[0]
        code: int = evaluated(s)
        if code == OK:
            observe(t, g.q, g.v, s.a, s.lam, g.eqs.data, s.out)
            tell_balance(s)
        return code

    def count(s: Any) -> int:
        """Write the cost of the run so far."""
        counted(s.given, s.counts)
        return OK

    timed, given = (types.float64,), (types.int64, types.float64)
    return {
        "start": Entry(start, given),
        "assemble": Entry(assemble, timed),
        "begin": Entry(begin, timed),
        "set": Entry(take_input, given),
        "step": Entry(step, timed),
        "advance": Entry(advance, timed),
        "renew": Entry(renew, ()),
        "weigh": Entry(weigh, ()),
        "retune": Entry(retune, ()),
        "read": Entry(read, ()),
        "count": Entry(count, ()),
    }


def kinds() -> tuple[CalledKernel, ...]:
    """Return the kernels of all kinds that ship, in the order of their addresses in the runtime."""
    return tuple(dict.fromkeys(called for room, role in ROLES.items() for called in _kernels(room, role)))


def _kernels(room: ModuleType, role: type[ElementType]) -> Iterator[CalledKernel]:
    for kind in element_types_of(room, role):
        for name, signature in kind.kernels.items():
            function = kernel_of(kind, name)
            if function is not None and name in REAL.names:
                yield CalledKernel(function, record_of(kind), signature)

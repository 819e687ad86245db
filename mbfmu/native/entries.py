"""What the runtime offers to a host: entry points over one instance, and the kernels that recursions call by address.

Kernels know types of arrays and no sizes, so what is compiled for an example serves every model of its family: all that
one stepper integrates. Callbacks of the equations are called by their names here, where a simulation in Python hands
them on by their addresses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.errors import UserError
from mbfmu.interface import COUNTERS
from mbfmu.mechanics import couplings, cuts, elements, joints, loads, sensors, signals
from mbfmu.mechanics.arrays.points import CHANGED, DEPARTS, JUMPS, MOVES, InputRecords, set_out, start_input
from mbfmu.mechanics.arrays.tables import REAL, Called
from mbfmu.mechanics.kind import Kind, kernel_of, kinds_of, record_of
from mbfmu.mechanics.records import empty_data
from mbfmu.mechanics.recursions import dynamics as recursions
from mbfmu.mechanics.recursions.dynamics import observe, resolves
from mbfmu.simulation import Simulation
from solvers.assembly import ASSEMBLED, Scratch, close_positions, close_velocities, move_mass
from solvers.balance import BALANCE
from solvers.compiled.held import contents, hold
from solvers.compiled.kernel import by_name, kept_nowhere, kernel, records, types
from solvers.ledger import ROW, WORK, Scales
from solvers.options import OPTIONS
from solvers.outcome import NOT_FINITE, OK
from solvers.projection.projection import close
from solvers.projection.rank import normal_rank
from solvers.projection.reported import evaluate
from solvers.projection.workspace import Workspace
from solvers.steppers.adams import loop as adams
from solvers.steppers.adams.explicit import SINGLES
from solvers.steppers.adams.formulas import History, begin_anew
from solvers.steppers.adams.hybrid import HYBRID
from solvers.steppers.closed import ClosedStepper, Given
from solvers.steppers.dense import find_position_sizes, measure_pace
from solvers.steppers.radau import loop as radau
from solvers.steppers.radau.formulas import Memory
from solvers.steppers.radau.small import STOPS
from solvers.system import Array, Equations, Terms

from .image import Image
from .points import TOLD, arrive, begin_points, energy_at, leave, look, take, tell_balance

FAMILIES = {"adams": adams, "radau": radau}  # loops by the prefix of their entry points
SOLVERS = ("adams", "hybrid", "adams-lu", "radau")  # that they serve
ROLES: dict[ModuleType, type[Kind]] = {
    joints: joints.Joint, cuts: cuts.Cut, couplings: couplings.Coupling, loads: loads.Load, elements: loads.Load,
    signals: signals.Signal, sensors: sensors.Sensor,
}  # fmt: skip
CALLBACKS = Equations._fields[:-2]  # of the equations, by the names of the functions
KINDS = "mb_kinds"  # symbol of the addresses of all kernels of kinds


class Start(NamedTuple):
    """What a mechanism is assembled from."""

    q: Array  # (nq,) first positions, as given to the builder
    v: Array  # (n,) first velocities, likewise
    scratch: Any  # solvers.assembly.Scratch: units, what is held, and which rows or coordinates are wrong


class Instance(NamedTuple):
    """One instance of a model, as the entry points take it."""

    given: Any  # solvers.steppers.closed.Given
    start: Any  # Start
    a: Array  # (n,) accelerations
    lam: Array  # (m,) multipliers
    out: Array  # outputs
    clock: Array  # (1,) s, the reported time
    known: Array  # (3,) what a system says of its rate and of its loops', 1/s; the characteristic length, m
    options: NDArray[Any]  # (1,) solvers.options.OPTIONS
    counts: NDArray[np.int64]  # of the solver, by COUNTERS
    inputs: Any  # mbfmu.mechanics.arrays.points.InputRecords
    balance: NDArray[Any]  # (1,) solvers.balance.BALANCE
    told: NDArray[Any]  # (1,) TOLD
    dv: Array  # (n,) jump of the velocities


class Entry(NamedTuple):
    """An entry point: a function over an instance, and types of what it is called with after that."""

    function: Callable[..., int]
    more: tuple[Any, ...]


def family_of(simulation: Simulation) -> str:
    """Return the family of a simulation; empty: the runtime has none for its solver."""
    loop = getattr(simulation.stepper, "loop", None)
    return next((name for name, own in FAMILIES.items() if own is loop), "")


def instance_of(simulation: Simulation) -> Instance:
    """Return an instance that is assembled and yet to begin, where a simulation began; with zeros for the functions."""
    stepper: ClosedStepper = simulation.stepper  # type: ignore[assignment]
    plant, system = simulation.plant, simulation.plant.system
    given, (q, v) = contents(stepper.given), plant.assemble(simulation.t)
    sizes = system.nq, system.n, system.m
    eqs = Equations(**dict.fromkeys(CALLBACKS, 0), data=system.held_data, terms=Terms.allocate(*sizes))
    work = Workspace.allocate(*sizes)
    work.size[:] = system.size
    assembly = plant.assembly
    scratch = Scratch.of(system, assembly.held())._replace(size=work.size)
    start = Start(assembly.start_positions(), assembly.start_velocities(), scratch)
    scales = Scales.of(simulation.settings.tolerance, np.zeros(system.n), np.zeros(system.n))
    own = Given(eqs, given.settings, _memory(family_of(simulation), *sizes), work, scales, q, v, np.zeros(ROW))
    known = np.array([system.rate, system.loop_rate, plant.length])
    rooms = np.zeros(system.n), np.zeros(system.m), np.zeros(len(simulation.variables))
    settings = stepper.options.record(), np.zeros(len(COUNTERS), np.int64)
    balance = simulation.audit.balance.copy() if simulation.audit else records(1, BALANCE)
    books = plant.inputs.own, balance, records(1, TOLD), np.zeros(system.n)
    return Instance(own, start, *rooms, np.array([simulation.t]), known, *settings, *books)  # type: ignore[arg-type]


def _memory(family: str, nq: int, n: int, m: int) -> Any:
    return History.allocate(nq, n, m) if family == "adams" else Memory.allocate(nq, n)


def image_of(simulation: Simulation) -> tuple[Instance, Image]:
    """Return the instance of a simulation that has just been made, and its block.

    Raises
    ------
    UserError
        Its solver, or a kernel of it, is not in the runtime.
    """
    if not family_of(simulation):
        raise UserError(f"machine code has no solver {simulation.pick.solver!r}; it has {', '.join(FAMILIES)}")
    known, numbers = {own: k for k, own in enumerate(kinds())}, []
    for own in simulation.plant.called():
        if own is not None and own not in known:
            what = f"{own.function.__module__}.{own.function.__qualname__}"
            raise UserError(f"kernel {what} is the model's own, and machine code has those of mbfmu; run it as an FMU")
        numbers.append(-1 if own is None else known[own])
    instance, arrays = instance_of(simulation), simulation.plant.data.arrays
    own, start = instance.given, instance.start
    state = [*own.memory, instance.clock, own.q, own.v, own.ledger, own.settings, *own.work.memory(), *own.scales]
    state += [start.q, start.v, own.work.size, own.work.size_q, start.scratch.row, instance.known, instance.options]
    state += [*instance.inputs.memory(), instance.balance, instance.told]
    state += [array for array in arrays if array is not arrays.kernels]
    return instance, Image(instance, state, arrays.kernels, numbers)


def example(family: str) -> Any:
    """Return an instance of the types that all of a family have, held."""
    z, data = np.zeros, hold(empty_data())
    callbacks = {name: by_name(getattr(recursions, name)) for name in CALLBACKS}
    eqs = Equations(**callbacks, data=data, terms=hold(Terms.allocate(1, 1, 1)))
    own = hold(_memory(family, 1, 1, 1)), hold(Workspace.allocate(1, 1, 1)), hold(Scales.of(1e-6, z(1), z(1)))
    given = Given(hold(eqs), records(1, FAMILIES[family].SETTINGS), *own, z(1), z(1), z(ROW))
    settings = records(1, OPTIONS), np.zeros(1, np.int64)
    books = hold(InputRecords.example()), records(1, BALANCE), records(1, TOLD), z(1)
    start = hold(Start(z(1), z(1), hold(Scratch.allocate(1, 1))))
    return hold(Instance(hold(given), start, z(1), z(1), z(1), z(1), z(3), *settings, *books))


@kernel
def renew_adams(s: Any, fresh: bool) -> None:
    """As ``AdamsStepper.renew`` does; ``fresh``: as its ``restart``."""
    g, kept = s.given, not fresh and s.told[0].code == OK
    o, singles = g.settings[0], 0 if fresh else SINGLES
    o.works = 1 if (o.audit == 1 or o.partition == HYBRID) and g.eqs.data.arrays.world[0].works == 1 else 0
    begin_anew(g.memory, s.clock[0], g.q, g.v, g.ledger[WORK], singles, 0 if fresh else 1, kept)


@kernel
def renew_radau(s: Any, fresh: bool) -> None:
    """As ``RadauStepper.renew`` does; ``fresh``: as its ``restart``."""
    g, kept = s.given, not fresh and s.told[0].code == OK
    o = g.settings[0]
    o.works = 1 if o.audit == 1 and g.eqs.data.arrays.world[0].works == 1 else 0
    radau.begin_anew(g.memory, s.clock[0], g.q, g.v, g.ledger[WORK], 0 if fresh else STOPS, kept)
    if fresh:
        g.memory.control[0].known = 0


@kernel
def limit_adams(g: Any, longest: float) -> None:
    """As ``ExplicitStepper._limit`` does."""
    if longest != g.settings[0].max_step:
        g.settings[0].max_step = longest
        g.memory.control[0].h = min(g.memory.control[0].h, longest)


@kernel
def limit_radau(g: Any, longest: float) -> None:
    """As ``RadauStepper._limit`` does."""
    g.settings[0].max_step = longest


@kernel
def count_adams(g: Any, counts: Any) -> None:
    """Tell what ``AdamsStepper.statistics`` does, in the order of COUNTERS."""
    c = g.memory.control[0]
    left = c.by_turn + c.by_flicker + c.by_energy + c.by_collapse
    counts[0], counts[1], counts[2], counts[3] = c.steps, c.rejected, c.evaluations, left + c.returns
    counts[4], counts[5] = max(0, c.starts - 1), c.limited


@kernel
def count_radau(g: Any, counts: Any) -> None:
    """Tell what ``RadauStepper.statistics`` does, in the order of COUNTERS."""
    c = g.memory.control[0]
    counts[0], counts[1], counts[2] = c.steps, c.rejected, c.evaluations
    counts[4] = max(0, c.starts - 1)


def entries(family: str) -> dict[str, Entry]:
    """Return the entry points of a family by their names."""
    loop, renewed = FAMILIES[family], {"adams": renew_adams, "radau": renew_radau}[family]
    advance_reported, set_up, take_options = loop.advance_reported, loop.set_up, loop.take_options
    counted = {"adams": count_adams, "radau": count_radau}[family]
    limit = {"adams": limit_adams, "radau": limit_radau}[family]

    @kept_nowhere
    def go(s: Any, t: float) -> int:
        """Go to t, s, in pieces in each of which no step may miss a signal, as ``Stepper.advance`` does."""
        g, reached, code = s.given, s.clock[0], OK
        while code == OK:
            longest, until = resolves(reached, g.eqs.data)
            limit(g, min(longest, s.options[0].max_step))
            reached = min(t, until)
            code = advance_reported(g, reached)
            if not until < t:
                break
        return code

    def start(s: Any, index: int, value: float) -> int:
        """Let an input have another value at the start, before :func:`begin`."""
        if not abs(value) < np.inf:
            return NOT_FINITE
        start_input(s.inputs, index, value, s.clock[0])
        return OK

    def assemble(s: Any, t: float) -> int:
        """Let the reported state be the start with its loops closed at t (s); return a code of solvers.assembly.

        Where it is not ASSEMBLED, ``worst`` or ``massless`` of the scratch says what is wrong, and there is no state.
        """
        g, start, work = s.given, s.start, s.start.scratch
        code: int = close_positions(g.eqs, t, start.q, g.q, work)
        if code == ASSEMBLED:
            code = close_velocities(g.eqs, t, g.q, start.v, s.known[0], g.v, work)
        if code == ASSEMBLED:
            g.eqs.dynamics(t, g.q, g.v, g.eqs.data, g.eqs.terms)
            code = move_mass(g.eqs.terms, g.work.mass, work)
        return code

    def begin(s: Any, t: float) -> int:
        """Begin at t (s) and the reported state, as a stepper that is constructed there."""
        g = s.given
        s.clock[0], g.scales.rtol[0] = t, s.options[0].rtol
        take_options(s.options, g.settings)
        find_position_sizes(g.eqs, t, g.q, g.work)
        rank = normal_rank(g.eqs, t, g.q, g.v, g.work)
        code: int = close(g.eqs, t, g.q, g.v, rank, g.work)
        measure_pace(g.eqs, t, g.q, g.v, rank, s.known[0], s.known[1], g.work)
        set_up(g, rank, s.options[0].absolute)
        renewed(s, True)
        s.balance[0].kept = 1 if s.options[0].audit == 1 and g.v.shape[0] > rank else 0
        s.balance[0].tolerance = s.options[0].rtol
        begin_points(s, code)
        return code

    def renew(s: Any) -> int:
        """Go on where loads have changed."""
        renewed(s, False)
        return OK

    def weigh(s: Any) -> int:
        """Note the energy, before parameters change; :func:`retune` comes after that."""
        s.told[0].before = energy_at(s)
        return OK

    def retune(s: Any) -> int:
        """Go on anew with other parameters, as ``Simulation.retune`` does."""
        s.balance[0].level += energy_at(s) - s.told[0].before
        renewed(s, True)
        return OK

    def take_input(s: Any, index: int, value: float) -> int:
        """Take the value of an input at the time reached, as ``Simulation.set_input`` does."""
        if not abs(value) < np.inf:
            return NOT_FINITE
        if take(s, index, value) != MOVES:
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
            found = set_out(s.inputs, t, end)
            if found & CHANGED:
                renewed(s, False)
            if found & DEPARTS:
                code: int = leave(s, found & JUMPS != 0)
                if code != OK:
                    return code
                renewed(s, False)
        if end > t or s.told[0].code != OK:
            arrive(s, end, go(s, end))
        if s.balance[0].kept == 1:
            look(s, energy_at(s))
        return int(s.told[0].code)

    def read(s: Any) -> int:
        """Read all outputs at the reported state."""
        g, t = s.given, s.clock[0]
        code: int = evaluate(g.eqs, t, g.q, g.v, g.memory.control[0].rank, g.work, s.a, s.lam)
        if code == OK:
            observe(t, g.q, g.v, s.a, s.lam, g.eqs.data, s.out)
            tell_balance(s)
        return code

    def count(s: Any) -> int:
        """Tell what the run has cost so far."""
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


def kinds() -> tuple[Called, ...]:
    """Return the kernels of all kinds that ship, in the order of their addresses in the runtime."""
    return tuple(dict.fromkeys(called for room, role in ROLES.items() for called in _kernels(room, role)))


def _kernels(room: ModuleType, role: type[Kind]) -> Iterator[Called]:
    for kind in kinds_of(room, role):
        for name, signature in kind.kernels.items():
            function = kernel_of(kind, name)
            if function is not None and name in REAL.names:
                yield Called(function, record_of(kind), signature)

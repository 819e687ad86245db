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

from mbfmu.errors import UserError
from mbfmu.mechanics import couplings, cuts, elements, joints, loads, sensors, signals
from mbfmu.mechanics.arrays.tables import REAL, Called
from mbfmu.mechanics.kind import Kind, kernel_of, kinds_of, record_of
from mbfmu.mechanics.records import empty_data
from mbfmu.mechanics.recursions import dynamics as recursions
from mbfmu.mechanics.recursions.dynamics import observe
from mbfmu.simulation import Simulation
from solvers.compiled.held import contents, hold
from solvers.compiled.kernel import by_name, records, types
from solvers.ledger import ROW, Scales
from solvers.outcome import OK
from solvers.projection.reported import evaluate
from solvers.projection.workspace import Workspace
from solvers.steppers.adams import loop as adams
from solvers.steppers.adams.formulas import History
from solvers.steppers.closed import ClosedStepper, Given
from solvers.steppers.radau import loop as radau
from solvers.steppers.radau.formulas import Memory
from solvers.system import Array, Equations, Terms

from .image import Image

FAMILIES = {"adams": adams, "radau": radau}  # loops by the prefix of their entry points
ROLES: dict[ModuleType, type[Kind]] = {
    joints: joints.Joint, cuts: cuts.Cut, couplings: couplings.Coupling, loads: loads.Load, elements: loads.Load,
    signals: signals.Signal, sensors: sensors.Sensor,
}  # fmt: skip
CALLBACKS = Equations._fields[:-2]  # of the equations, by the names of the functions
KINDS = "mb_kinds"  # symbol of the addresses of all kernels of kinds


class Instance(NamedTuple):
    """One instance of a model, as the entry points take it."""

    given: Any  # solvers.steppers.closed.Given
    a: Array  # (n,) accelerations
    lam: Array  # (m,) multipliers
    out: Array  # outputs
    clock: Array  # (1,) s, the reported time


class Entry(NamedTuple):
    """An entry point: a function over an instance, and types of what it is called with after that."""

    function: Callable[..., int]
    more: tuple[Any, ...]


def family_of(simulation: Simulation) -> str:
    """Return the family of a simulation; empty: the runtime has none for its solver."""
    loop = getattr(simulation.stepper, "loop", None)
    return next((name for name, own in FAMILIES.items() if own is loop), "")


def _instance_of(simulation: Simulation) -> Instance:
    """Return a simulation as an instance, with zeros for the functions."""
    stepper: ClosedStepper = simulation.stepper  # type: ignore[assignment]
    given, system = contents(stepper.given), simulation.plant.system
    own = contents(given.eqs)._replace(**dict.fromkeys(CALLBACKS, 0))
    rooms = np.zeros(system.n), np.zeros(system.m), np.zeros(len(simulation.variables))
    return Instance(given._replace(eqs=own), *rooms, stepper.clock)


def image_of(simulation: Simulation) -> tuple[Instance, Image]:
    """Return a simulation as an instance, and its block where it stands.

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
    instance, arrays = _instance_of(simulation), simulation.plant.data.arrays
    state = [*simulation.stepper.arrays(), *(array for array in arrays if array is not arrays.kernels)]
    return instance, Image(instance, state, arrays.kernels, numbers)


def example(family: str) -> Any:
    """Return an instance of the types that all of a family have, held."""
    z, data = np.zeros, hold(empty_data())
    callbacks = {name: by_name(getattr(recursions, name)) for name in CALLBACKS}
    eqs = Equations(**callbacks, data=data, terms=hold(Terms.allocate(1, 1, 1)))
    memory = {"adams": History.allocate(1, 1, 1), "radau": Memory.allocate(1, 1)}[family]
    own = hold(memory), hold(Workspace.allocate(1, 1, 1)), hold(Scales.of(1e-6, z(1), z(1)))
    given = Given(hold(eqs), records(1, FAMILIES[family].SETTINGS), *own, z(1), z(1), z(ROW))
    return hold(Instance(hold(given), z(1), z(1), z(1), z(1)))


def entries(family: str) -> dict[str, Entry]:
    """Return the entry points of a family by their names."""
    advance_reported = FAMILIES[family].advance_reported

    def advance(s: Any, t: float) -> int:
        """Go to t, s; on failure the last good state stays."""
        code: int = advance_reported(s.given, t)
        s.clock[0] = t if code == OK else s.given.memory.control[0].t
        return code

    def read(s: Any) -> int:
        """Read all outputs at the reported state."""
        g, t = s.given, s.clock[0]
        code: int = evaluate(g.eqs, t, g.q, g.v, g.memory.control[0].rank, g.work, s.a, s.lam)
        if code == OK:
            observe(t, g.q, g.v, s.a, s.lam, g.eqs.data, s.out)
        return code

    return {"advance": Entry(advance, (types.float64,)), "read": Entry(read, ())}


def kinds() -> tuple[Called, ...]:
    """Return the kernels of all kinds that ship, in the order of their addresses in the runtime."""
    return tuple(dict.fromkeys(called for room, role in ROLES.items() for called in _kernels(room, role)))


def _kernels(room: ModuleType, role: type[Kind]) -> Iterator[Called]:
    for kind in kinds_of(room, role):
        for name, signature in kind.kernels.items():
            function = kernel_of(kind, name)
            if function is not None and name in REAL.names:
                yield Called(function, record_of(kind), signature)

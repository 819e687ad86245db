"""The state of a run besides its solver, and the kernels that change it at communication points.

Time, positions and velocities of the reported state come from the solver, whichever it is. The order in which a run
calls these kernels is in :mod:`.sequence`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.arrays.input_kernels import (
    GRAVITY_LOAD,
    InputRecords,
    begin_inputs,
    begin_support_motions,
    set_input,
    start_motions,
)
from mbfmu.mechanics.arrays.load_groups import largest_ratio
from mbfmu.mechanics.loads.base import MAX_VALID_RATIO
from mbfmu.mechanics.recursions.dynamics import begin_histories, energy, evaluate_outputs, observe, placed_energy
from solvers.balance import BALANCE_OK, BalanceRecord, check_energy_balance, energy_floor
from solvers.compiled.kernel import inlined, kernel, records
from solvers.compiled.record import Record, f8, i8
from solvers.energy_account import EXCHANGED_ENERGY, PASSAGE_ENERGY
from solvers.outcome import OK

if TYPE_CHECKING:
    from mbfmu.mechanics.records import ItemRecord
    from solvers.compiled.record import Reals, Table


class RunStatusRecord(Record):
    """How a run stands at its communication points."""

    code: i8  # result of the projection of the start, then of the last advance of a native run, see solvers.outcome
    unknown: i8  # 1: the rate of a support jumps where its impulse is not determined
    jumps: i8  # 1: a support has jumped in position, farther than its rate explains; then the first of them
    jump_support: i8  # ... at the last point where one has, by its number
    jump_size: f8  # ... and by how much, m or rad
    singular: i8  # 1: the loops do not determine all rates at the start of a native run
    flaw: i8  # what is wrong with the start of a native run, see start_checks.Flaw; zero: nothing
    lost: i8  # first result of the check of the energy balance that is not BALANCE_OK
    lost_at: f8  # s, time of that check; then energy error and exchanged energy there, J
    energy_error: f8
    exchanged: f8
    passage: f8  # J, energy of the last slow passage until then, see solvers.energy_account
    before: f8  # J, energy before parameters change
    limit_ratio: f8  # of elements at the last communication point, see mbfmu.mechanics.loads.base
    discontinuity_work: f8  # J, work done by jumps of inputs and of parameters so far
    contact: f8  # m, result of :func:`.profile_contacts.locate_contact` for the wheel that a native run examined last
    second_contact: f8
    depth: f8


RUN_STATUS = RunStatusRecord.dtype


class Session(NamedTuple):
    """The state of a run besides its solver."""

    data: Any  # mbfmu.mechanics.records.Data, pinned
    inputs: Any  # mbfmu.mechanics.arrays.input_kernels.InputRecords
    balance: Table[BalanceRecord]  # (1,)
    status: NDArray[Any]  # (1,) RUN_STATUS
    monitored: Table[ItemRecord]  # mbfmu.mechanics.records.ItemRecord, loads that have limits of their theory

    @staticmethod
    def allocate(data: Any, inputs: InputRecords, monitored: Table[ItemRecord]) -> Session:
        """Return a session that has not begun."""
        return Session(data, inputs, BalanceRecord.zeros(1), records(1, RUN_STATUS), monitored)

    def memory(self) -> list[NDArray[Any]]:
        """Return the arrays to save, but for the values of inputs."""
        return [*self.inputs.memory(), self.balance, self.status]


@kernel
def energy_at(session: Session, t: float, q: Reals, v: Reals) -> float:
    """Kinetic and potential energy of the state (q, v) at t, J."""
    found: float = energy(t, q, v, session.data)
    return found


@kernel
def note_limits(session: Session) -> None:
    """Note how far elements are from their limits where the bodies are."""
    if session.monitored.shape[0] > 0:
        session.status[0].limit_ratio = largest_ratio(session.monitored, session.data.arrays, session.data.state)


@kernel
def begin_session(
    session: Session,
    t: float,
    q: Reals,
    v: Reals,
    code: int,
    is_checked: bool,
    freedom: int,
    tolerance: float,
    rate: float,
    length: float,
) -> None:
    """Begin at the state (q, v) of time t, s, as the inputs say.

    ``code`` is the result of its assembly, ``is_checked`` whether the energy balance is to be checked, ``freedom`` the
    number of degrees of freedom: if there is none nothing is integrated but the work, whose error no tolerance
    controls. ``rate`` (1/s) and ``length`` (m) are those of :func:`solvers.balance.energy_floor`.
    """
    status, balance, bodies, mass = session.status[0], session.balance[0], session.data.arrays.bodies, 0.0
    begin_inputs(session.inputs)
    status.code, status.unknown, status.jumps, status.lost, status.limit_ratio = code, 0, 0, BALANCE_OK, 0.0
    status.discontinuity_work = 0.0
    for k in range(bodies.shape[0]):
        mass += bodies[k].mass
    balance.is_checked = 1 if is_checked and freedom > 0 else 0
    balance.has_one_freedom = 1 if freedom == 1 and session.data.arrays.world[0].drives == 0 else 0
    balance.tolerance, balance.last_passage_energy = tolerance, 0.0
    balance.reference_energy = energy_at(session, t, q, v)
    balance.energy_floor = energy_floor(mass, length, rate, tolerance)
    begin_histories(t, session.data)
    note_limits(session)


@kernel
def account_discontinuity(session: Session, before: float, t: float, q: Reals, v: Reals) -> None:
    """Count the change of the energy at one state from ``before``, J, as work: it is no energy error."""
    work = energy_at(session, t, q, v) - before
    session.status[0].discontinuity_work += work
    session.balance[0].reference_energy += work


@kernel
def apply_input(session: Session, index: int, value: float, rate: float, t: float, q: Reals, v: Reals) -> bool:
    """Set an input at the time reached, with its rate if it is a number; return whether the equations of motion change
    there.
    """
    is_gravity = session.inputs.inputs[index].role == GRAVITY_LOAD
    before = energy_at(session, t, q, v) if is_gravity else 0.0
    changed: bool = set_input(session.inputs, index, value, rate, t)
    if is_gravity and changed:
        account_discontinuity(session, before, t, q, v)
    return changed


@kernel
def note_energy(session: Session, t: float, q: Reals, v: Reals) -> None:
    """Note the energy before parameters change."""
    session.status[0].before = energy_at(session, t, q, v)


@kernel
def account_parameters(session: Session, t: float, q: Reals, v: Reals) -> None:
    """Count the change of the energy since :func:`note_energy` as work."""
    account_discontinuity(session, session.status[0].before, t, q, v)


@kernel
def plan_step(session: Session, t: float, end: float) -> int:
    """Plan a step from t to ``end``, s; return what :func:`.input_kernels.begin_support_motions` finds.

    A step of length zero changes nothing.
    """
    session.status[0].unknown = 0
    found: int = begin_support_motions(session.inputs, t, end) if end > t else 0
    return found


@kernel
def store_velocity_jump(a: Reals, k: int, dv: Reals) -> None:
    """Put into dv (n,) the difference of the accelerations a (n,) for two motions of the supports, ``k`` = 0 and 1."""
    for i in range(dv.shape[0]):
        dv[i] = a[i] - (dv[i] if k == 1 else 0.0)


@kernel
def note_impulse(session: Session, code: int) -> None:
    """Note whether the impulse of the supports is determined; ``code`` is the result of its evaluation."""
    session.status[0].unknown = 0 if code == OK else 1


@kernel
def start_support_motions(session: Session) -> None:
    """Start the motions of the supports that are planned."""
    inputs, status = session.inputs, session.status[0]
    if start_motions(inputs, session.balance[0].tolerance):
        status.jumps = 1
        for k in range(inputs.supports.shape[0] - 1, -1, -1):
            if inputs.supports[k].departs == 1 and inputs.ahead[k].jumps == 1:
                status.jump_support, status.jump_size = k, inputs.ahead[k].position - inputs.ahead[k].path[0]


@kernel
def check_energy(session: Session, t: float, now: float, account: Reals) -> float:
    """Check the energy balance of a state at t (s) of energy ``now`` (J); return the energy error, J.

    ``account`` (ACCOUNT_SIZE,) is the energy account of the state. The first violation is noted.
    """
    energy_error, found = check_energy_balance(session.balance, now, account)
    status = session.status[0]
    if found != BALANCE_OK and status.lost == BALANCE_OK:
        status.lost, status.lost_at = found, t
        status.energy_error, status.exchanged, status.passage = (
            energy_error,
            account[EXCHANGED_ENERGY],
            account[PASSAGE_ENERGY],
        )
    return energy_error


@kernel
def check_point(session: Session, t: float, q: Reals, v: Reals, account: Reals, is_placed: bool) -> None:
    """Check the energy balance of the state reached, and note how far elements are from their limits there.

    ``is_placed``: the bodies are placed and move as at this state.
    """
    if session.balance[0].is_checked == 0 and session.monitored.shape[0] == 0:
        return
    now = placed_energy(session.data) if is_placed else energy_at(session, t, q, v)  # which places the bodies
    if session.balance[0].is_checked == 1:
        check_energy(session, t, now, account)
    note_limits(session)


@inlined
def fill_energies(session: Session, t: float, account: Reals, out: Reals) -> None:
    """Put the energy error and the exchanged energy, J, in place of the energies that the outputs ``out`` end in; nan
    if the energy balance is not checked.
    """
    last = out.shape[0] - 1
    if session.balance[0].is_checked == 1:
        out[last - 1], out[last] = check_energy(session, t, out[last - 1], account), account[EXCHANGED_ENERGY]
    else:
        out[last - 1], out[last] = np.nan, np.nan


@kernel
def check_samples(
    session: Session, times: Reals, q: Reals, v: Reals, accounts: Reals, ratios: Reals, out: Reals
) -> int:
    """:func:`check_point` and the end of :func:`read_outputs` at k points that a solver has passed in one call.

    ``out`` (k, outputs) contains the outputs; ``ratios`` (k,) receives how far elements are from their limits. Return
    the number of points before the first at which an element is invalid.
    """
    count: int = times.shape[0]
    for i in range(count):
        if session.monitored.shape[0] > 0:
            energy_at(session, times[i], q[i], v[i])  # places the bodies
            note_limits(session)
        ratios[i] = session.status[0].limit_ratio
        if not ratios[i] <= MAX_VALID_RATIO:
            return i
        fill_energies(session, times[i], accounts[i], out[i])
    return count


@kernel
def read_outputs(
    session: Session, t: float, q: Reals, v: Reals, a: Reals, lam: Reals, account: Reals, is_placed: bool, out: Reals
) -> None:
    """Put the outputs at the solution (q, v, a, lam) into ``out``, and in place of the energies that they end in the
    energy error and the exchanged energy, J; nan if the energy balance is not checked.

    ``is_placed``: the bodies are placed, move and are loaded as at this state, multipliers excluded.
    """
    if is_placed:
        evaluate_outputs(a, lam, session.data, out)
    else:
        observe(t, q, v, a, lam, session.data, out)
    fill_energies(session, t, account, out)

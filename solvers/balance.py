"""Check of the energy balance: the difference between energy and work that the tolerance explains.

The balance of a run holds while

    |E - reference - W| <= min(explained, most) + rounding + energy floor,

    explained = max(BOUND_FRACTION bound, min(bound, LAST_STEP_FACTOR (step bound + work error)), at work / extent),
    most      = max(MAX_ENERGY_FRACTION, 1 / extent) at work + work error,

with W, bound, step bound, work error and extent of a reported row of :mod:`.energy_account`, and the reference energy:
that of the start plus every jump since. The bound takes the local errors of all steps at their largest and all of
one sign; in correct runs the energy error was at most 0.08 of it, and mostly 0.01. ``most`` is for runs in which that
is more than there is: a part of the energy at work, which is the kinetic energy at its largest and what was exchanged.
A motion whose extent is a few absolute tolerances is not known to that part: its first-order error of energy is the
energy at work over the extent. The steps do not explain this error where forces balance, as where a body is lifted off
a stop: their bound contains the sum of the forces, the energy and the work contain each of them.
"""

from __future__ import annotations

from typing import Any

from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, f8, i8

from .energy_account import (
    ENERGY_ERROR_BOUND,
    EXCHANGED_ENERGY,
    EXTENT,
    KINETIC_MAX,
    MAX_WORK_ERROR,
    PASSAGE_ENERGY,
    STEP_BOUND,
    WORK,
)


class BalanceRecord(Record):
    """What the check of the energy balance compares with."""

    is_checked: i8  # 1: the balance is checked
    reference_energy: f8  # J, energy at the start and every jump since
    tolerance: f8
    energy_floor: f8  # J, energies below it are not resolved, see :func:`energy_floor`
    has_one_freedom: i8  # 1: the mechanism has one degree of freedom, and no drives
    last_passage_energy: f8  # J, of the last slow passage that was examined


BOUND_FRACTION = 0.25  # of what the steps could add up to
LAST_STEP_FACTOR = 6.0  # times what the last step could add: errors of a few steps need not cancel each other
MAX_ENERGY_FRACTION = 0.02  # of the energy at work
# Of the kinetic energy in a slow passage, which the energy error may be. A motion that passes an unstable equilibrium
# at a speed as cosh(k t), with too much energy by that part, is ahead afterwards by part / k (s). A pendulum moves at
# up to 2 k (rad/s) later on, and is off by twice the part then: 0.1 rad.
PASSAGE_ERROR_FRACTION = 0.05
# Results of the check: the balance holds; it is violated; the energy error is too large for a slow passage
BALANCE_OK, BALANCE_VIOLATED, PASSAGE_INACCURATE = 0, 1, 2
ENERGY_ROUNDING = 1e-13  # of every energy that was added up; besides, what moves as slowly as the tolerance has none


@kernel
def energy_floor(mass: float, length: float, rate: float, tolerance: float) -> float:
    """Energy (J) of the slowest motion that counts: of all mass (kg), by the tolerance in a length (m) a second.

    ``rate`` (1/s) makes it slower where gravity and drives are slow; that of a drive may be of one short jerk.
    """
    speed = tolerance * length * (min(rate, 1.0) if rate > 0.0 else 1.0)
    return mass * speed * speed


@kernel
def energy_error_limit(record: BalanceRecord, energy: float, row: Any) -> float:
    """What the tolerance and rounding explain of the energy error of a state, J; a BalanceRecord."""
    bound, at_work = row[ENERGY_ERROR_BOUND], row[KINETIC_MAX] + row[EXCHANGED_ENERGY]
    rounding = ENERGY_ROUNDING * (abs(energy) + abs(record.reference_energy) + at_work + bound / record.tolerance)
    one_tolerance = at_work / max(1.0, row[EXTENT])
    most = max(MAX_ENERGY_FRACTION * at_work, one_tolerance) + row[MAX_WORK_ERROR]
    steps = max(BOUND_FRACTION * bound, min(bound, LAST_STEP_FACTOR * (row[STEP_BOUND] + row[MAX_WORK_ERROR])))
    explained: float = min(max(steps, one_tolerance), most) + rounding + record.energy_floor
    return explained


@kernel
def check_energy_balance(balance: Any, energy: float, row: Any) -> tuple[float, int]:
    """Return the energy error (J) of a state with this energy and reported row (ACCOUNT_SIZE,), and the result of
    the check: BALANCE_VIOLATED if it exceeds the limit or is not a number, PASSAGE_INACCURATE if it is too large for a
    slow passage since the last call, else BALANCE_OK.
    balance (1,) BalanceRecord.
    """
    record = balance[0]
    error, passes = (
        energy - record.reference_energy - row[WORK],
        record.has_one_freedom == 1 and row[PASSAGE_ENERGY] != record.last_passage_energy,
    )
    record.last_passage_energy = row[PASSAGE_ENERGY]
    if not abs(error) <= energy_error_limit(record, energy, row):
        return error, BALANCE_VIOLATED
    return error, PASSAGE_INACCURATE if passes and abs(error) > PASSAGE_ERROR_FRACTION * row[
        PASSAGE_ENERGY
    ] else BALANCE_OK

"""What difference between energy and work the tolerance explains.

A run keeps its balance while

    |E - level - W| <= min(explained, most) + rounding + energy of the slowest motion,

    explained = max(EXPLAINED stray, min(stray, FEW (exposure + slip))),
    most      = max(PART, 1 / extent) at work + slip,

with W, stray, exposure, slip and extent of a reported row of :mod:`.ledger`, and the ``level`` that E started from with
every jump since. ``stray`` takes the local errors of all steps at their largest and all of one sign; of healthy runs
the energy error was at most 0.08 of it, and mostly 0.01. ``most`` is for runs in which that is more than there is: a
part of the energy at work, which is the kinetic energy at its largest and what was exchanged. A motion whose extent is
a few absolute tolerances is not known to that part: its first-order error of energy is the energy at work over the
extent.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers.compiled.kernel import kernel

from .ledger import EXPOSURE, EXTENT, MOST, PASSAGE, SLIPPED, STRAY, THROUGHPUT, WORK

BALANCE = np.dtype(
    [
        ("kept", np.int64),  # 1: there is one
        ("level", np.float64),  # J, energy at the start and every jump since
        ("tolerance", np.float64),
        ("unseen", np.float64),  # J, of the slowest motion
        ("single", np.int64),  # 1: the mechanism has one degree of freedom, and no drives
        ("passage", np.float64),  # J, of the last slow passage that was examined
    ],
    align=True,
)
EXPLAINED = 0.25  # of what the steps could add up to
FEW = 6.0  # times what the last step could add: errors of a few steps need not cancel each other
PART = 0.02  # of the energy at work
# Of the kinetic energy in a slow passage, which the energy error may be. A motion that passes an unstable equilibrium
# at a speed as cosh(k t), with too much energy by that part, is ahead afterwards by part / k (s). A pendulum moves at
# up to 2 k (rad/s) later on, and is off by twice the part then: 0.1 rad.
SLOW = 0.05
KEPT, LOST, UNSURE = 0, 1, 2  # the balance is kept; it is lost; it is too inaccurate for a slow passage
ROUNDING = 1e-13  # of every energy that was added up; besides, what moves as slowly as the tolerance has none


@kernel
def slowest(mass: float, length: float, rate: float, tolerance: float) -> float:
    """Energy (J) of the slowest motion that counts: of all mass (kg), by the tolerance in a length (m) a second.

    ``rate`` (1/s) makes it slower where gravity and drives are slow; that of a drive may be of one short jerk.
    """
    speed = tolerance * length * (min(rate, 1.0) if rate > 0.0 else 1.0)
    return mass * speed * speed


@kernel
def bound(b: Any, energy: float, row: Any) -> float:
    """What the tolerance and rounding explain of the energy error of a state, J; b a record of BALANCE."""
    stray, at_work = row[STRAY], row[MOST] + row[THROUGHPUT]
    rounding = ROUNDING * (abs(energy) + abs(b.level) + at_work + stray / b.tolerance)
    most = max(PART, 1.0 / max(1.0, row[EXTENT])) * at_work + row[SLIPPED]
    steps = max(EXPLAINED * stray, min(stray, FEW * (row[EXPOSURE] + row[SLIPPED])))
    explained: float = min(steps, most) + rounding + b.unseen
    return explained


@kernel
def judge(balance: Any, energy: float, row: Any) -> tuple[float, int]:
    """Return the energy error (J) of a state with this energy and reported row (ROW,), and what it means: LOST if it is
    more than explained, or no number, UNSURE where it is large for a slow passage since the last call, else KEPT.
    balance (1,) of BALANCE.
    """
    b = balance[0]
    error, passes = energy - b.level - row[WORK], b.single == 1 and row[PASSAGE] != b.passage
    b.passage = row[PASSAGE]
    if not abs(error) <= bound(b, energy, row):
        return error, LOST
    return error, UNSURE if passes and abs(error) > SLOW * row[PASSAGE] else KEPT


@kernel
def find_lost(balance: Any, energies: Any, rows: Any, found: Any) -> tuple[int, int]:
    """Put the energy error of states into ``found`` (k,); return the number of the first that is not KEPT, k if all
    are, and what :func:`judge` finds there.
    """
    first, kind = found.shape[0], KEPT
    for i in range(found.shape[0]):
        found[i], here = judge(balance, energies[i], rows[i])
        if here != KEPT and kind == KEPT:
            first, kind = i, here
    return first, kind

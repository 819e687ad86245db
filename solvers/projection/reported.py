"""Reported states: on the constraints, with accelerations, multipliers and outputs."""

from __future__ import annotations

from typing import Any

from solvers.compiled.kernel import inlined, kernel
from solvers.linalg.dense import rank_at, ratio
from solvers.outcome import OK

from .projection import (
    AT_REST,
    UNRESOLVED,
    acceleration,
    close,
    correct_position,
    limit,
    multipliers,
    position_off,
)
from .singular import CROSSING, SINGULAR, judge
from .workspace import factor_here, loop_speed


@kernel
def close_report(eqs: Any, t: float, q: Any, v: Any, rank: int, work: Any) -> int:
    """As :func:`close`; at a crossing what lies across the branch is removed too: of the position as far as it is
    resolved, of the velocity by the same limit.

    For states from a solver that does not control these well (IDA's regularization leaves them free).
    """
    code = close(eqs, t, q, v, rank, work)
    if code != OK or rank_at(work.pivot, rank, SINGULAR) == rank:
        return code
    if judge(eqs, t, q, rank, work) != CROSSING or not loop_speed(v, work) > AT_REST * work.rate[1]:
        return code
    if rank_at(work.pivot, rank, UNRESOLVED) == rank and position_off(eqs.terms, rank, work) < ratio(work.pivot, rank):
        correct_position(eqs, t, q, rank, work)
    code = limit(eqs, t, q, v, True, rank, work, work.a)
    if code == OK:
        for i in range(v.shape[0]):
            v[i] = work.a[i]
    return code


@kernel
def unresolved(rtol: float, rank: int, work: Any) -> bool:
    """Whether so little is left of a pivot that forces are not known: positions are no better than the tolerance."""
    return rank > 0 and rank_at(work.pivot, rank, max(UNRESOLVED, rtol)) < rank


@kernel
def evaluate(eqs: Any, t: float, q: Any, v: Any, rank: int, work: Any, a: Any, lam: Any) -> int:
    """Accelerations and shortest multipliers at a closed state; leaves ``terms`` there."""
    factor_here(eqs, t, q, v, work)
    code = acceleration(eqs, t, q, v, rank, work, a)
    if code == OK:
        multipliers(eqs.terms, rank, work, a, lam)
    return code


@inlined
def report_state(
    eqs: Any, t: float, q: Any, v: Any, rtol: float, c: Any, work: Any, a: Any, lam: Any, outputs: Any
) -> int:
    """Accelerations, multipliers and outputs of the system at the last projected state, whose factors exist.

    The record ``c`` has the rank, and takes note of where forces are not known.
    """
    code = acceleration(eqs, t, q, v, c.rank, work, a)
    if code != OK:
        return code
    if rank_at(work.pivot, c.rank, SINGULAR) < c.rank:  # neighbors have been looked at
        factor_here(eqs, t, q, v, work)
    multipliers(eqs.terms, c.rank, work, a, lam)
    if unresolved(rtol, c.rank, work):
        c.undetermined, c.undetermined_at = 1, t
    if outputs.shape[0] > 0:
        eqs.evaluate_outputs(a, lam, eqs.data, outputs)
    return OK

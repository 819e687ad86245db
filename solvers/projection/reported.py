"""Reported states: on the constraints, with accelerations, multipliers and outputs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from solvers.compiled.kernel import inlined, kernel
from solvers.linalg.dense import pivot_ratio, rank_at
from solvers.outcome import OK

from .projection import (
    MIN_TANGENT_SPEED,
    UNRESOLVED_PIVOT_RATIO,
    correct_position,
    evaluate_acceleration,
    evaluate_multipliers,
    limit_at_bifurcation,
    project,
    solve_position_correction,
)
from .singular import BIFURCATION, SINGULAR_PIVOT_RATIO, classify_singularity
from .workspace import evaluate_and_factor, loop_speed

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.projection.workspace import Workspace
    from solvers.system import Equations


@kernel
def project_reported_state(eqs: Equations, t: float, q: Reals, v: Reals, rank: int, work: Workspace) -> int:
    """As :func:`project`; at a crossing what lies across the branch is removed too: of the position as far as it is
    resolved, of the velocity by the same limit.

    For states from a solver that does not control these well (IDA's regularization leaves them free).
    """
    code = project(eqs, t, q, v, rank, work)
    if code != OK or rank_at(work.pivot, rank, SINGULAR_PIVOT_RATIO) == rank:
        return code
    if (
        classify_singularity(eqs, t, q, rank, work) != BIFURCATION
        or not loop_speed(v, work) > MIN_TANGENT_SPEED * work.rate[1]
    ):
        return code
    if rank_at(work.pivot, rank, UNRESOLVED_PIVOT_RATIO) == rank and solve_position_correction(
        eqs.terms, rank, work
    ) < pivot_ratio(work.pivot, rank):
        correct_position(eqs, t, q, rank, work)
    code = limit_at_bifurcation(eqs, t, q, v, True, rank, work, work.a)
    if code == OK:
        for i in range(v.shape[0]):
            v[i] = work.a[i]
        evaluate_and_factor(eqs, t, q, v, work)
    return code


@kernel
def has_unresolved_forces(rtol: float, rank: int, work: Workspace) -> bool:
    """Whether so little is left of a pivot that forces are not known: positions are no better than the tolerance."""
    return rank > 0 and rank_at(work.pivot, rank, max(UNRESOLVED_PIVOT_RATIO, rtol)) < rank


@kernel
def evaluate_state(
    eqs: Equations, t: float, q: Reals, v: Reals, rank: int, work: Workspace, a: Reals, lam: Reals
) -> int:
    """Accelerations and shortest multipliers at a closed state; leaves ``terms`` there."""
    evaluate_and_factor(eqs, t, q, v, work)
    return solve_state(eqs, t, q, v, rank, work, a, lam)


@kernel
def solve_state(eqs: Equations, t: float, q: Reals, v: Reals, rank: int, work: Workspace, a: Reals, lam: Reals) -> int:
    """As :func:`evaluate_state`; ``terms`` and the factors of J belong to the state."""
    code = evaluate_acceleration(eqs, t, q, v, rank, work, a)
    if code == OK:
        evaluate_multipliers(eqs.terms, rank, work, a, lam)
    return code


@inlined
def fill_reported_state(
    eqs: Equations,
    t: float,
    q: Reals,
    v: Reals,
    rtol: float,
    control: Any,
    work: Workspace,
    a: Reals,
    lam: Reals,
    outputs: Reals,
) -> int:
    """Accelerations, multipliers and outputs of the system at the last projected state, whose factors exist.

    The record ``control`` has the rank; a state in which forces are not resolved is recorded in it.
    """
    code = evaluate_acceleration(eqs, t, q, v, control.rank, work, a)
    if code != OK:
        return code
    if rank_at(work.pivot, control.rank, SINGULAR_PIVOT_RATIO) < control.rank:  # the terms are those of a neighbor
        evaluate_and_factor(eqs, t, q, v, work)
    evaluate_multipliers(eqs.terms, control.rank, work, a, lam)
    if has_unresolved_forces(rtol, control.rank, work):
        control.undetermined, control.undetermined_at = 1, t
    if outputs.shape[0] > 0:
        eqs.evaluate_outputs(a, lam, eqs.data, outputs)
    return OK

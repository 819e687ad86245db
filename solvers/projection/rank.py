"""Properties found once at the start: the rank of the constraints along the motion, and their units."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import kernel
from solvers.linalg.dense import rank_at

from .projection import (
    CORRECTION_TOLERANCE,
    LIMIT_NODE_DISTANCE,
    MAX_PROJECTION_CORRECTIONS,
    correct_position,
    fill_tangent_basis,
)
from .workspace import count_freedom, factor, scaled_norm

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.projection.workspace import Workspace
    from solvers.system import Equations

REDUNDANT_PIVOT_RATIO = 1e-6  # ratio that separates a redundant constraint from a nearby singular configuration
ZERO_ENTRY_RATIO = 1e-12  # part of a row that is no more than that
ROW_UNIT_SAMPLES = 5  # positions that the units of the rows are taken from


@kernel
def find_normal_rank(eqs: Equations, t: float, q: Reals, v: Reals, work: Workspace) -> int:
    """Largest rank of J at q and at neighbors a finite move away, along v and along every allowed motion.

    A start in a singular configuration has a smaller rank than the motion that leaves it; constraints that are
    redundant everywhere on the way do not count. The neighbors are closed first: off the constraints
    redundancy is hidden.
    """
    m, n = eqs.terms.J.shape
    set_row_units(eqs, t, q, work)
    eqs.position(t, q, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    here = rank_at(work.pivot, min(m, n), REDUNDANT_PIVOT_RATIO)
    best = here
    fill_tangent_basis(here, work)
    freedom = count_freedom(here, work)
    for k in range(freedom):
        for i in range(n):
            work.directions[k, i] = work.T[k, i]
    for k in range(freedom + 1):
        for i in range(n):
            work.v_near[i] = work.directions[k, i] if k < freedom else v[i]
        best = max(best, rank_at_neighbor(eqs, t, q, work.v_near, work))
    return best


@kernel
def set_row_units(eqs: Equations, t: float, q: Reals, work: Workspace) -> None:
    """Set the unit of every row to its largest length at q and at a few positions far from q, closed or not: if it is
    short at q, q may be singular. Record which coordinates occur in constraints (``in_loops``).
    """
    m, n = eqs.terms.J.shape
    for i in range(m):
        work.row[i] = 0.0
    for j in range(n):
        work.in_loops[j] = 0.0
    for far in range(ROW_UNIT_SAMPLES):
        for i in range(q.shape[0]):
            work.q_near[i] = q[i]
        for j in range(n):
            work.dq[j] = work.size[j] * np.sin(far * (1.0 + 0.7 * j))
        eqs.retract(work.q_near, work.dq, eqs.data)
        eqs.position(t, work.q_near, eqs.data, eqs.terms)
        for i in range(m):
            square = 0.0
            for j in range(n):
                square += (eqs.terms.J[i, j] * work.size[j]) ** 2
            for j in range(n):
                if abs(eqs.terms.J[i, j]) * work.size[j] > ZERO_ENTRY_RATIO * np.sqrt(square):
                    work.in_loops[j] = 1.0
            work.row[i] = max(work.row[i], np.sqrt(square))
    for i in range(m):
        if not work.row[i] > 0.0:
            work.row[i] = 1.0


@kernel
def rank_at_neighbor(eqs: Equations, t: float, q: Reals, e: Reals, work: Workspace) -> int:
    """Rank of J after a small projected move from q along e; zero if the projection fails."""
    m, n = eqs.terms.J.shape
    size = scaled_norm(e, work)
    if not size > 0.0:
        return 0
    for i in range(q.shape[0]):
        work.q_near[i] = q[i]
    for i in range(n):
        work.dq[i] = 5.0 * LIMIT_NODE_DISTANCE * e[i] / size
    eqs.retract(work.q_near, work.dq, eqs.data)
    eqs.position(t, work.q_near, eqs.data, eqs.terms)
    for _ in range(MAX_PROJECTION_CORRECTIONS):
        factor(eqs.terms, work)
        here = rank_at(work.pivot, min(m, n), REDUNDANT_PIVOT_RATIO)
        largest = correct_position(eqs, t, work.q_near, here, work)
        if largest <= CORRECTION_TOLERANCE:
            factor(eqs.terms, work)
            return rank_at(work.pivot, min(m, n), REDUNDANT_PIVOT_RATIO)
        if not largest < np.inf:
            return 0
    return 0

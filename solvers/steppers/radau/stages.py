"""The stages of a step of Radau IIA: accelerations there, their derivatives, and Newton's method."""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.linalg.dense import pivot_ratio
from solvers.outcome import COLLAPSED, NOT_FINITE, OK
from solvers.projection.projection import evaluate_acceleration, evaluate_multipliers, project
from solvers.projection.workspace import evaluate_and_factor

from .formulas import NODES, STAGES, A, correct_stages, extrapolate

DIFFERENCE_STEP = 1e-6  # of the derivatives, in units of size, and of size times the rate
CLOSED_STAGES_PIVOT_RATIO = 0.1  # below this ratio of the pivots stages are closed
MAX_NEWTON_ITERATIONS = 8
NEGLIGIBLE_CORRECTION = 1e-9  # of the tolerance of Newton's method: from smaller ones no rate of convergence follows
MAX_EXTRAPOLATION = 6.0  # step in units of the last one, up to which its polynomial predicts the stages


@kernel
def differentiate(eqs: Any, t: float, c: Any, work: Any, a: Any) -> int:
    """a = v' at (work.q, work.v), which need not be closed; leaves ``terms`` there.

    What is off the constraints is in v' by the inverse square of the smallest pivot: where that is small it is closed.
    """
    c.evaluations += 1
    evaluate_and_factor(eqs, t, work.q, work.v, work)
    if c.rank > 0 and pivot_ratio(work.pivot, c.rank) < CLOSED_STAGES_PIVOT_RATIO:
        code = project(eqs, t, work.q, work.v, c.rank, work)
        if code != OK:
            return code
    return evaluate_acceleration(eqs, t, work.q, work.v, c.rank, work, a)


@kernel
def power(eqs: Any, t: float, c: Any, o: Any, work: Any, a: Any) -> float:
    """W' at the state evaluated last, with v' = a."""
    if o.works == 0:
        return 0.0
    evaluate_multipliers(eqs.terms, c.rank, work, a, work.lam)
    return eqs.power(t, work.q, work.v, a, work.lam, eqs.data)


@inlined
def at_state(q: Any, v: Any, work: Any) -> None:
    """(work.q, work.v) <- (q, v)."""
    for i in range(q.shape[0]):
        work.q[i] = q[i]
    for i in range(v.shape[0]):
        work.v[i] = v[i]


@kernel
def take_derivatives(eqs: Any, c: Any, H: Any, work: Any) -> None:
    """a_q and a_v at (H.q, H.v) by differences, in units of size; they are not ``known`` where one is not finite."""
    n = H.v.shape[0]
    c.matrices += 1
    c.known = 0
    at_state(H.q, H.v, work)
    if differentiate(eqs, c.t, c, work, H.e_q) != OK:
        return
    for k in range(2 * n):
        j = k % n
        at_state(H.q, H.v, work)
        apart = DIFFERENCE_STEP
        if k < n:
            for i in range(n):
                H.e_v[i] = 0.0
            H.e_v[j] = DIFFERENCE_STEP * work.size[j]
            eqs.retract(work.q, H.e_v, eqs.data)
        else:
            apart = DIFFERENCE_STEP * work.rate[0]
            work.v[j] += apart * work.size[j]
        if differentiate(eqs, c.t, c, work, H.e_v) != OK:
            return
        for i in range(n):
            slope = (H.e_v[i] - H.e_q[i]) / (apart * work.size[i])
            if not np.isfinite(slope):
                return
            if k < n:
                H.a_q[i, j] = slope
            else:
                H.a_v[i, j] = slope
    c.known, c.fresh, c.rate = 1, 1, 0.0


@kernel
def place_stages(eqs: Any, h: float, c: Any, H: Any, work: Any) -> float:
    """Positions of the stages, from their velocities; return the square of how far they went, in tolerances.

    Quaternions take N from where they were: they come nearer with every correction, as Newton's matrix lets them.
    """
    nq, n = H.q.shape[0], H.v.shape[0]
    for s in range(STAGES):
        if nq == n:
            for i in range(n):
                H.N[s, i] = H.v[i] + H.Z[s, i]
        else:
            for i in range(n):
                work.v[i] = H.v[i] + H.Z[s, i]
            eqs.dynamics(c.t + NODES[s] * h, H.Q[s], work.v, eqs.data, eqs.terms)
            for i in range(nq):
                H.N[s, i] = eqs.terms.qdot[i]
    square = 0.0
    for s in range(STAGES):
        for i in range(nq):
            total = 0.0
            for k in range(STAGES):
                total += A[s, k] * H.N[k, i]
            total = H.q[i] + h * total
            square += ((total - H.Q[s, i]) / H.tol_q[i]) ** 2
            H.Q[s, i] = total
    return square / STAGES


@kernel
def solve_stages(eqs: Any, h: float, c: Any, o: Any, H: Any, work: Any) -> int:
    """Solve for the stages of a step of h from (H.q, H.v) with the existing factors; ``c.rate``: convergence rate."""
    nq, n = H.q.shape[0], H.v.shape[0]
    goes_on = c.follows == 1 and h <= MAX_EXTRAPOLATION * c.hold  # farther out a polynomial is no guess
    for s in range(STAGES):
        for i in range(n):
            if not goes_on:
                H.Z[s, i] = NODES[s] * h * H.a[i]
        for i in range(nq):
            H.Q[s, i] = H.q[i] + NODES[s] * h * H.qdot[i]
    if goes_on:
        extrapolate(h, H)
    place_stages(eqs, h, c, H, work)
    before, rate = 0.0, 0.0
    for k in range(MAX_NEWTON_ITERATIONS):
        for s in range(STAGES):
            at = c.t + NODES[s] * h
            for i in range(nq):
                work.q[i] = H.Q[s, i]
            for i in range(n):
                work.v[i] = H.v[i] + H.Z[s, i]
            code = differentiate(eqs, at, c, work, work.slope)
            if code != OK:
                return code
            H.P[s] = power(eqs, at, c, o, work, work.slope)
            for i in range(n):
                H.F[s, i] = work.slope[i]
        size = np.sqrt(correct_stages(h, H, work.size) + place_stages(eqs, h, c, H, work))
        if not size < np.inf:
            return NOT_FINITE
        if size <= NEGLIGIBLE_CORRECTION * o.exact:
            return OK
        if k > 0:
            rate = size / before if k == 1 else np.sqrt(rate * size / before)
            if rate >= 1.0 or size * rate ** (MAX_NEWTON_ITERATIONS - 1 - k) > o.exact * (1.0 - rate):
                c.rate = 1.0
                return COLLAPSED
            c.rate = rate
        if k > 0 and size * rate <= o.exact * (1.0 - rate):
            return OK
        before = size
    return COLLAPSED

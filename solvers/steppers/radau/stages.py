"""The stages of a step of Radau IIA: accelerations there, their derivatives, and Newton's method."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.linalg.dense import pivot_ratio
from solvers.outcome import COLLAPSED, NOT_FINITE, OK
from solvers.positions import has_quaternions
from solvers.projection.projection import evaluate_acceleration, evaluate_multipliers, project
from solvers.projection.workspace import count_motions, evaluate_and_factor

from .formulas import N_STAGES, NODES, A, correct_stages, extrapolate

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.projection.workspace import Workspace
    from solvers.steppers.radau.formulas import Memory
    from solvers.system import Equations

STAGE_DIFFERENCE_STEP = 1e-6  # of the derivatives, in units of size, and of size times the rate
CLOSED_STAGES_PIVOT_RATIO = 0.1  # below this ratio of the pivots stages are closed
MAX_STAGE_ITERATIONS = 8
NEGLIGIBLE_CORRECTION = 1e-9  # of the tolerance of Newton's method: from smaller ones no rate of convergence follows
MAX_EXTRAPOLATION = 6.0  # step in units of the last one, up to which its polynomial predicts the stages


@kernel
def evaluate_stage_acceleration(eqs: Equations, t: float, control: Any, work: Workspace, a: Reals) -> int:
    """a = v' at (work.q, work.v), which need not be closed; leaves ``terms`` there.

    What is off the constraints is in v' by the inverse square of the smallest pivot: where that is small it is closed.
    """
    control.evaluations += 1
    evaluate_and_factor(eqs, t, work.q, work.v, work)
    if control.rank > 0 and pivot_ratio(work.pivot, control.rank) < CLOSED_STAGES_PIVOT_RATIO:
        code = project(eqs, t, work.q, work.v, control.rank, work)
        if code != OK:
            return code
    return evaluate_acceleration(eqs, t, work.q, work.v, control.rank, work, a)


@kernel
def evaluate_power(eqs: Equations, t: float, control: Any, settings: Any, work: Workspace, a: Reals) -> float:
    """W' at the state evaluated last, with v' = a."""
    if settings.works == 0:
        return 0.0
    evaluate_multipliers(eqs.terms, control.rank, work, a, work.lam)
    return eqs.power(t, work.q, work.v, a, work.lam, eqs.data)


@inlined
def set_state(q: Reals, v: Reals, work: Workspace) -> None:
    """(work.q, work.v) <- (q, v)."""
    for i in range(q.shape[0]):
        work.q[i] = q[i]
    for i in range(v.shape[0]):
        work.v[i] = v[i]


@kernel
def difference_accelerations(eqs: Equations, control: Any, memory: Memory, work: Workspace) -> None:
    """a_q and a_v at (memory.q, memory.v) by differences, in units of size; none if one is not finite."""
    n = memory.v.shape[0]
    control.matrices += 1
    control.has_derivatives = 0
    set_state(memory.q, memory.v, work)
    if evaluate_stage_acceleration(eqs, control.t, control, work, memory.e_q) != OK:
        return
    for k in range(2 * n):
        j = k % n
        set_state(memory.q, memory.v, work)
        apart = STAGE_DIFFERENCE_STEP
        if k < n:
            for i in range(n):
                memory.e_v[i] = 0.0
            memory.e_v[j] = STAGE_DIFFERENCE_STEP * work.size[j]
            eqs.retract(work.q, memory.e_v, eqs.data)
        else:
            apart *= work.rate[0] if j < count_motions(work) else 1.0
            work.v[j] += apart * work.size[j]
        if evaluate_stage_acceleration(eqs, control.t, control, work, memory.e_v) != OK:
            return
        for i in range(n):
            slope = (memory.e_v[i] - memory.e_q[i]) / (apart * work.size[i])
            if not np.isfinite(slope):
                return
            if k < n:
                memory.a_q[i, j] = slope
            else:
                memory.a_v[i, j] = slope
    control.has_derivatives, control.derivatives_at_start, control.contraction = 1, 1, 0.0


@kernel
def update_stage_positions(eqs: Equations, h: float, control: Any, memory: Memory, work: Workspace) -> float:
    """Positions of the stages, from their velocities; return the square of how far they went, in tolerances.

    For quaternions N is that of the previous correction: they converge with every correction.
    """
    nq, n = memory.q.shape[0], memory.v.shape[0]
    for s in range(N_STAGES):
        if not has_quaternions(nq, n, work.states):
            for i in range(nq):
                memory.N[s, i] = memory.v[i] + memory.Z[s, i]
        else:
            for i in range(n):
                work.v[i] = memory.v[i] + memory.Z[s, i]
            eqs.dynamics(control.t + NODES[s] * h, memory.Q[s], work.v, eqs.data, eqs.terms)
            for i in range(nq):
                memory.N[s, i] = eqs.terms.qdot[i]
    square = 0.0
    for s in range(N_STAGES):
        for i in range(nq):
            total = 0.0
            for k in range(N_STAGES):
                total += A[s, k] * memory.N[k, i]
            total = memory.q[i] + h * total
            square += ((total - memory.Q[s, i]) / memory.tol_q[i]) ** 2
            memory.Q[s, i] = total
    return square / N_STAGES


@kernel
def solve_stages(eqs: Equations, h: float, control: Any, settings: Any, memory: Memory, work: Workspace) -> int:
    """Solve for the stages of a step of h from (memory.q, memory.v) with the existing factors.

    ``control.contraction`` is the rate of convergence.
    """
    nq, n = memory.q.shape[0], memory.v.shape[0]
    extrapolates = (
        control.extrapolates == 1 and h <= MAX_EXTRAPOLATION * control.hold
    )  # farther out a polynomial is no guess
    for s in range(N_STAGES):
        for i in range(n):
            if not extrapolates:
                memory.Z[s, i] = NODES[s] * h * memory.a[i]
        for i in range(nq):
            memory.Q[s, i] = memory.q[i] + NODES[s] * h * memory.qdot[i]
    if extrapolates:
        extrapolate(h, memory)
    update_stage_positions(eqs, h, control, memory, work)
    before, rate = 0.0, 0.0
    for k in range(MAX_STAGE_ITERATIONS):
        for s in range(N_STAGES):
            at = control.t + NODES[s] * h
            for i in range(nq):
                work.q[i] = memory.Q[s, i]
            for i in range(n):
                work.v[i] = memory.v[i] + memory.Z[s, i]
            code = evaluate_stage_acceleration(eqs, at, control, work, work.slope)
            if code != OK:
                return code
            memory.P[s] = evaluate_power(eqs, at, control, settings, work, work.slope)
            for i in range(n):
                memory.F[s, i] = work.slope[i]
        size = np.sqrt(correct_stages(h, memory, work.size) + update_stage_positions(eqs, h, control, memory, work))
        if not size < np.inf:
            return NOT_FINITE
        if size <= NEGLIGIBLE_CORRECTION * settings.newton_tolerance:
            return OK
        if k > 0:
            rate = size / before if k == 1 else np.sqrt(rate * size / before)
            if rate >= 1.0 or size * rate ** (MAX_STAGE_ITERATIONS - 1 - k) > settings.newton_tolerance * (1.0 - rate):
                control.contraction = 1.0
                return COLLAPSED
            control.contraction = rate
        if k > 0 and size * rate <= settings.newton_tolerance * (1.0 - rate):
            return OK
        before = size
    return COLLAPSED

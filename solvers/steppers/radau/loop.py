"""Radau IIA on constrained motion: the compiled step loop.

What is integrated is the motion that :mod:`solvers.projection.projection` makes of the equations: its accelerations are
tangent to the constraints, so that stages need not be closed, and the end of every step is. Newton's matrix is kept
while the corrections decrease fast, over steps, output times and jumps of the loads; derivatives are by differences,
and are not evaluated near a singular configuration, where v' turns within the step. The check of the branch, and the
step size near near misses, are as for Adams.

A step may pass the requested time; the reported state is then interpolated and projected. Where loads have just changed
at such a time, and may again, steps end there: what a step needs of the one before it is a guess and no more.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.energy_account import (
    add_energy_error_bound,
    count_rejected_step,
    energy_check_scheduled,
    fill_account_row,
    reset_check_schedule,
    set_energy_scales,
    update_energy_bound,
)
from solvers.inertia import clear_growth, tolerance_factor, update_growth
from solvers.outcome import BRANCHES, COLLAPSED, MAX_STEPS, OK
from solvers.projection.branch import BRANCH_RESOLUTION, on_same_branch
from solvers.projection.projection import evaluate_acceleration, project
from solvers.projection.reported import fill_reported_state
from solvers.projection.singular import IMPERFECT, branch_step_limit, record_accepted
from solvers.stepper import is_discontinuity, min_step_length
from solvers.steppers.step_control import (
    FIRST_STEP_RATIO,
    MIN_CONTROLLED_ERROR,
    MIN_RTOL_TIMES_GAP,
    MIN_STEP_CHANGE,
    MIN_STEP_RATIO,
    STEP_SAFETY_FACTOR,
    TARGET_TOLERANCE,
)

from .formulas import STAGES, A, error_of_step, error_of_work, factor_newton, interpolate
from .stages import MAX_EXTRAPOLATION, at_state, power, solve_stages, take_derivatives

SETTINGS = np.dtype(
    [
        ("rtol", "f8"), ("atol", "f8"),  # of the estimated error
        ("asked", "f8"),  # rtol of the motion
        ("exact", "f8"),  # what Newton may leave, in tolerances of the estimated error
        ("max_step", "f8"), ("max_steps", "i8"),
        ("energy_check", "i8"), ("works", "i8"),  # 1: book energy and work; 1: something does work
    ],
    align=True,
)  # fmt: skip
MIN_DERIVATIVE_PIVOT_RATIO = 1e-2  # below this ratio of the pivots no derivatives are evaluated
MAX_CONTRACTION = 0.3  # rate of the corrections that calls for new derivatives
MAX_STEP_CHANGE = MAX_EXTRAPOLATION  # next step in units of this one, at most
# The error that is estimated is that of a formula of order 3: its step is as tolerance^(1/4), and the motion's error,
# of order 5, as that step^5. For an error in proportion to rtol the estimate is held to RTOL_FACTOR rtol^RTOL_EXPONENT.
RTOL_FACTOR, RTOL_EXPONENT = 2.0, 0.8
# Ratio of errors, estimated and expected from the last step, that only a corner of a force explains. There the motion
# is no more accurate than the estimate, which is then held to the requested tolerance.
CORNER_ERROR_RATIO = 7.0
NEWTON_RTOL_RATIO = 0.1  # of rtol: the remainder of Newton's method has one sign in many steps, and adds up


@inlined
def weigh(c: Any, o: Any, H: Any, work: Any) -> None:
    """Tolerances at (H.q, H.v), larger near a near miss, where rounding limits the accuracy."""
    c.coarser = 1.0
    if work.critical[0].kind == IMPERFECT:
        gap = abs(work.critical[0].bifurcation_gap)
        c.coarser = max(1.0, MIN_RTOL_TIMES_GAP / (gap * o.asked))
        if c.coarser > c.coarsest:
            c.coarsest, c.narrowest = c.coarser, gap
    c.finer = tolerance_factor(o.rtol, RTOL_EXPONENT, work)
    scale = c.coarser * c.finer
    for i in range(H.q.shape[0]):
        H.tol_q[i] = scale * (o.rtol * abs(H.q[i]) + o.atol * work.size_q[i])
    for i in range(H.v.shape[0]):
        H.tol_v[i] = scale * (o.rtol * abs(H.v[i]) + o.atol * work.pace[i] * work.size[i])


@kernel
def arrive(eqs: Any, t: float, c: Any, o: Any, H: Any, work: Any, scales: Any) -> int:
    """Take q', v' and W' at (work.q, work.v), which is closed with its ``terms`` and factors at hand; book it."""
    c.evaluations += 1
    code = evaluate_acceleration(eqs, t, work.q, work.v, c.rank, work, work.slope)
    if code == OK:
        for i in range(H.q.shape[0]):
            H.q[i], H.qdot[i] = work.q[i], eqs.terms.qdot[i]
        for i in range(H.v.shape[0]):
            H.v[i], H.a[i] = work.v[i], work.slope[i]
        update_growth(t, eqs.terms.M, work.v, work)
        if o.energy_check == 1 and energy_check_scheduled(c):
            update_energy_bound(eqs.evaluate_energy_bound, eqs.data, c, scales)
            c.step_energy_error_bound *= max(1.0, c.coarser)
        H.power[0] = power(eqs, t, c, o, work, work.slope)
    return code


@kernel
def begin_anew(H: Any, t: float, q: Any, v: Any, done: float, ends: int, kept: bool) -> None:
    """Let the next step begin at a reported state, the work done J, and ``ends`` steps end where they are asked to.

    ``kept``: what is known of the state holds.
    """
    c = H.control[0]
    c.placed = c.placed if kept and c.t == t else 0
    c.t, c.start, c.ends, c.before = t, 1, ends, 0.0
    reset_check_schedule(H.control)
    for i in range(H.q.shape[0]):
        H.q[i] = q[i]
    for i in range(H.v.shape[0]):
        H.v[i] = v[i]
    H.work[0] = done


@kernel
def prepare(eqs: Any, c: Any, o: Any, H: Any, work: Any, scales: Any) -> int:
    """Close (H.q, H.v) where it is not, look around, and take its derivatives."""
    at_state(H.q, H.v, work)
    code = project(eqs, c.t, work.q, work.v, c.rank, work)
    if code != OK:
        return code
    if c.placed == 0:
        work.branch_history[0].pivot_ratio = 0.0
        record_accepted(eqs, c.t, work.q, 0.0, 0.0, c.rank, work)
    code = arrive(eqs, c.t, c, o, H, work, scales)
    if code == OK:
        c.start, c.placed, c.follows, c.fresh = 0, 1, 0, 0
        c.starts += 1
        if not c.h > 0.0:
            c.h = FIRST_STEP_RATIO / work.rate[0]
    return code


@inlined
def grow(c: Any, h: float, error: float) -> float:
    """By how much the step after one of h may be longer, with a look at how the error has changed (Gustafsson)."""
    factor = STEP_SAFETY_FACTOR * max(error, MIN_CONTROLLED_ERROR) ** -0.25
    if c.before > 0.0:
        factor = min(
            factor, STEP_SAFETY_FACTOR * h / c.before * (c.error / max(error, MIN_CONTROLLED_ERROR) ** 2) ** 0.25
        )
    return min(MAX_STEP_CHANGE, max(MIN_STEP_CHANGE, factor))


@inlined
def meets_corner(c: Any, h: float, error: float) -> bool:
    """Whether the error of a step of h is far above what the last step's lets expect of a smooth motion."""
    return c.before > 0.0 and error > CORNER_ERROR_RATIO * c.estimate * (h / c.before) ** 4


@inlined
def stop_at(c: Any, target: float) -> float:
    """Length of the next step where it is to end at ``target``, or half way where another would be shorter still."""
    left = target - c.t
    if left * (1.0 - TARGET_TOLERANCE) <= c.h:
        return left
    return 0.5 * left if left < 2.0 * c.h else c.h


@kernel
def step(eqs: Any, c: Any, o: Any, H: Any, work: Any, scales: Any, target: float) -> int:
    """One accepted step, however often it has to be cut; or the code of what made it too small."""
    nq, n = H.q.shape[0], H.v.shape[0]
    weigh(c, o, H, work)
    shortest = False
    while True:
        c.h = min(c.h, o.max_step)
        h = stop_at(c, target) if c.ends > 0 else c.h
        code, shorter, corner, exact = COLLAPSED, 0.5, False, True
        renewable = c.fresh == 0 and (c.rank == 0 or work.branch_history[0].pivot_ratio >= MIN_DERIVATIVE_PIVOT_RATIO)
        if renewable and (c.known == 0 or c.rate > MAX_CONTRACTION):
            renewable = False
            take_derivatives(eqs, c, H, work)
        if factor_newton(h, H):
            code = solve_stages(eqs, h, c, o, H, work)
        if code == OK:
            keep_start(H)
            error = error_of_step(h, H, work.size)
            corner = meets_corner(c, h, error)
            largest = min(1.0, o.asked / (c.finer * o.rtol)) if corner else 1.0
            exact = error <= largest
            if exact or shortest:
                for i in range(nq):
                    work.q[i] = H.Q[STAGES - 1, i]
                for i in range(n):
                    work.v[i] = H.v[i] + H.Z[STAGES - 1, i]
                after = target if c.ends > 0 and abs(target - c.t - h) <= TARGET_TOLERANCE * h else c.t + h
                code = project(eqs, after, work.q, work.v, c.rank, work)
                if code == OK and not on_same_branch(eqs, after, work.q, BRANCH_RESOLUTION, c.rank, work):
                    code = BRANCHES
                    c.refused += 1
                if code == OK:
                    code = arrive(eqs, after, c, o, H, work, scales)
                if code == OK:
                    accept(c, H, h, after, error)
                    return OK
                corner = False  # another test refuses the step
            else:
                code, shorter = COLLAPSED, max(MIN_STEP_CHANGE, STEP_SAFETY_FACTOR * (error / largest) ** -0.25)
                if corner:
                    c.corner_before = c.t + h
                if renewable:
                    c.known = 0
        elif renewable:
            c.known, shorter = 0, 1.0
        c.follows = 0
        count_rejected_step(c, corner)
        if shorter < 1.0:
            c.h = shorter * h
        smallest = min_step_length(MIN_STEP_RATIO, work.rate[0], o.max_step, c.t)
        if not c.h > smallest:
            if shortest or exact or not is_discontinuity(o.max_step, c.t):
                return code
            c.h, shortest = smallest, True


@inlined
def keep_start(H: Any) -> None:
    """Note where this step begins."""
    for i in range(H.q.shape[0]):
        H.q0[i], H.qdot0[i] = H.q[i], H.qdot[i]
    for i in range(H.v.shape[0]):
        H.v0[i], H.a0[i] = H.v[i], H.a[i]
    H.work0[0], H.power0[0] = H.work[0], H.power[0]


@inlined
def accept(c: Any, H: Any, h: float, after: float, error: float) -> None:
    """Go on from where the step of h has ended; the next is as long as accuracy lets it."""
    H.P[STAGES - 1] = H.power[0]  # what Newton left of the others is of the size of its tolerance
    done = 0.0
    for s in range(STAGES):
        done += h * A[STAGES - 1, s] * H.P[s]
    H.work[0] += done
    c.work_total_variation += abs(done)
    add_energy_error_bound(c, error_of_work(h, H), h)
    whole = h >= c.h
    c.t, c.hold = after, h
    longer = h * grow(c, h, error)
    if after < c.corner_before:  # a corner near the middle of a step is not in the estimate: on in short steps
        longer = min(longer, max(h, MIN_STEP_CHANGE * (c.corner_before - after)))
    c.error, c.estimate, c.before = max(error, 1e-2), max(error, MIN_CONTROLLED_ERROR), h
    c.h = longer if whole else max(c.h, longer)
    c.follows, c.fresh, c.ends = 1, 0, max(0, c.ends - 1)
    c.steps += 1


@inlined
def back_to(H: Any, q: Any, v: Any) -> None:
    """(q, v) <- where the last step ended."""
    for i in range(q.shape[0]):
        q[i] = H.q[i]
    for i in range(v.shape[0]):
        v[i] = H.v[i]


@kernel
def advance(
    eqs: Any, settings: Any, H: Any, work: Any, scales: Any, target: float, q: Any, v: Any, energy_account: Any
) -> int:
    """Step until ``target`` is passed; put the state there, closed, into (q, v), or the last good one on failure, and
    what is booked into ``energy_account`` (ROW,).
    """
    c, o = H.control[0], settings[0]
    code, taken = OK, 0
    while c.t < target:
        if taken >= o.max_steps:
            code = MAX_STEPS
            break
        if c.start == 1:
            code = prepare(eqs, c, o, H, work, scales)
            if code != OK:
                break
        code = step(eqs, c, o, H, work, scales, target)
        if code != OK:
            break
        taken += 1
        record_accepted(eqs, c.t, H.q, c.hold, c.h, c.rank, work)
        c.h = min(c.h, branch_step_limit(c.t, H.q, H.v, c.hold, eqs.terms, work))
    back_to(H, q, v)
    done = H.work[0]
    if code == OK:
        if target < c.t:
            done = interpolate(target, H, q, v)
        code = project(eqs, target, q, v, c.rank, work)
        if code != OK:
            back_to(H, q, v)
            done = H.work[0]
    fill_account_row(c, done, energy_account)
    return code


@kernel
def take_options(options: Any, settings: Any) -> None:
    """Set the options of a run (``solvers.options.OPTIONS``)."""
    asked, o = options[0], settings[0]
    looser = RTOL_FACTOR * asked.rtol**RTOL_EXPONENT
    o.rtol, o.atol = looser, asked.absolute * looser / asked.rtol
    o.asked, o.exact = asked.rtol, NEWTON_RTOL_RATIO * asked.rtol / looser
    o.max_step, o.max_steps, o.energy_check = asked.max_step, asked.max_steps, asked.energy_check


@kernel
def set_up(g: Any, rank: int, absolute: float) -> None:
    """Take rank, units and paces as they were found at the start; ``absolute`` is the tolerance in those units."""
    g.memory.control[0].rank = rank
    set_energy_scales(g.scales, absolute, g.work.size, g.work.pace)
    clear_growth(g.work)


@kernel
def advance_reported(g: Any, target: float) -> int:
    """:func:`advance` for the reported state."""
    return advance(g.eqs, g.settings, g.memory, g.work, g.scales, target, g.q, g.v, g.energy_account)


@kernel
def sample(g: Any, times: Any, q: Any, v: Any, a: Any, lam: Any, energy_account: Any, outputs: Any) -> tuple[int, int]:
    """:func:`advance` to each of ``times`` in turn; state, accelerations, multipliers, energy account and outputs of
    the system in a row each.

    Returns the code and the number of complete rows; where ``advance`` failed the next row holds the last good state.
    """
    eqs, H, work, o = g.eqs, g.memory, g.work, g.settings[0]
    for i in range(times.shape[0]):
        code = advance(eqs, g.settings, H, work, g.scales, times[i], q[i], v[i], energy_account[i])
        if code == OK:
            code = fill_reported_state(eqs, times[i], q[i], v[i], o.asked, H.control[0], work, a[i], lam[i], outputs[i])
        if code != OK:
            return code, i
    return OK, times.shape[0]

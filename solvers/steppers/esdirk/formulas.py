"""ESDIRK3(2) for q' = N(q) v, M v' + h = 0: its coefficients, its stages, its error, and what lies between two steps.

The method is the implicit one of ARK3(2)4L[2]SA (Kennedy, Carpenter, Appl. Numer. Math. 44, 2003): four stages, the
first explicit, L-stable, stiffly accurate: the last stage is where the step ends, and its slopes are the next step's
first. With Q_j = N v and A_j = v' in stage j, stage i is at

    q_i = q_e + h gamma Q_i,    v_i = v_e + h gamma A_i,    q_e = q + h sum_j<i a_ij Q_j,    v_e = v + h sum_j<i a_ij
    A_j.

Newton moves q_i alone: v_i and A_i follow from it, and where q is an angle or a length c = 1 / (h gamma) makes
dv = c dq, dA = c^2 dq, so that T = c^2 M + c D + K takes the residual's place. A unit quaternion u stands for the
position q_i = (u . q_e) u, whose slope is normal to it: the motion is extended to quaternions of any length by taking
the direction alone, which leaves q' = N(q) v and its order as they are.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import inlined, kernel, records
from solvers.energy_account import ACCOUNT_FIELDS, add_energy_error_bound, energy_check_scheduled, update_energy_bound
from solvers.inertia import update_tree_growth
from solvers.positions import angular_velocity, as_motion, as_slope
from solvers.system import Array, TreeSystem

GAMMA = 1767732205903 / 4055673282236
STAGES = 4
C = np.array([0.0, 2.0 * GAMMA, 0.6, 1.0])
B = np.array(
    [
        1471266399579 / 7840856788654,
        -4482444167858 / 7529755066697,
        11266239266428 / 11593286722821,
        GAMMA,
    ]
)
A = np.array(
    [
        [0.0, 0.0, 0.0, 0.0],
        [GAMMA, GAMMA, 0.0, 0.0],
        [2746238789719 / 10658868560708, -640167445237 / 6845629431997, GAMMA, 0.0],
        B,
    ]
)
EMBEDDED_WEIGHTS = np.array(  # weights of order 2
    [
        2756255671327 / 12835298489170,
        -10771552573575 / 22201958757719,
        9247589265047 / 10645013368117,
        2193209047091 / 5459859503100,
    ]
)
MAX_CORRECTIONS = 20  # corrections of a stage
DIFFERENCE_RATIO = 1e-3  # part of the way to a first guess, over which the equations are linear
MIN_INDEPENDENT_RATIO = 1e-4  # part of a change of corrections that must be left after removal of the others
CONTROL = np.dtype(
    [
        *ACCOUNT_FIELDS,
        ("t", "f8"), ("h", "f8"), ("hold", "f8"),  # s: where it stands, the next step, the last one
        ("error", "f8"), ("before", "f8"),  # of the last step, and its length, s; 0: there is none
        ("hard", "f8"), ("wait", "i8"),  # a length, s, at which Newton failed, and steps until it may be tried again
        ("start", "i8"),  # 1: the slopes are to be evaluated again
        ("ends", "i8"),  # number of steps that are yet to end at the requested time
        ("c", "f8"), ("at", "f8"),  # 1/s, s: of which T, taken when, the factors are; c = 0: there are none
        ("work", "f8"),  # J
        ("steps", "i8"), ("rejected", "i8"), ("evaluations", "i8"), ("starts", "i8"),
    ],
    align=True,
)  # fmt: skip


class Memory(NamedTuple):
    """All there is to go on from; where the last step ended, and how."""

    control: NDArray[Any]  # (1,)
    q: Array  # (nq,)
    v: Array  # (n,)
    lam: Array  # (m,)
    Q: Array  # (STAGES, nq) slopes; before a step, the first row
    A: Array  # (STAGES, n)
    P: Array  # (STAGES,) powers, W
    q0: Array  # (nq,) where it began
    slope0: Array  # (nq,)
    slope: Array  # (nq,) where it ended
    ends: Array  # (4,) W there, J, and its power, W, first where it began
    factors: Array  # (nq + 2 n + m,) state, accelerations and multipliers the factors were taken at

    @staticmethod
    def allocate(nq: int, n: int, m: int) -> Memory:
        """Return zeroed memory."""
        sizes = nq, n, m, (STAGES, nq), (STAGES, n), STAGES, nq, nq, nq, 4, nq + 2 * n + m
        return Memory(records(1, CONTROL), *(np.zeros(size) for size in sizes))


class Stage(NamedTuple):
    """The stage that is being solved, and scratch."""

    q: Array  # (nq,) quaternions of unit length
    v: Array  # (n,)
    a: Array  # (n,)
    lam: Array  # (m,)
    slope: Array  # (nq,)
    qe: Array  # (nq,)
    ve: Array  # (n,)
    tau: Array  # (n,) M a + h + J^T lambda
    qdot: Array  # (nq,)
    turn: Array  # (n,)
    near: Array  # (nq,) a position on the way to a guess, and what the equations say where that begins
    start: Array  # (n,)
    tol: Array  # (n,) of positions, as motions
    f: Array  # (n + m,) the last correction as Newton has it, and as it was made, of positions and multipliers
    step: Array  # (n + m,)
    df: Array  # (MOST, n) changes of corrections, in tolerances, orthonormal
    along: Array  # (MOST, n + m) what goes with them
    used: NDArray[np.int64]  # (1,) how many there are
    zero: Array  # (n,)
    none: Array  # (m,)
    in_q: NDArray[np.int64]  # these as in solvers.positions.Positions
    in_v: NDArray[np.int64]
    turning: NDArray[np.int64]

    @staticmethod
    def of(system: TreeSystem) -> Stage:
        """Return zeroed scratch for a system."""
        nq, n, m, z = system.nq, system.n, system.m, np.zeros
        return Stage(
            z(nq), z(n), z(n), z(m), z(nq), z(nq), z(n), z(n), z(nq), z(n), z(nq), z(n), z(n),
            z(n + m), z(n + m), z((MAX_CORRECTIONS, n)), z((MAX_CORRECTIONS, n + m)), np.zeros(1, np.int64),
            z(n), z(m), *system.positions,
        )  # fmt: skip


@kernel
def begin_stage(eqs: Any, i: int, h: float, M: Any, s: Any) -> None:
    """q_e and v_e of stage i, and a first guess from the stage before it: on at its velocity.

    The part of v' in unresolved modes would make the guess inaccurate.
    """
    for k in range(s.q.shape[0]):
        s.qe[k] = M.q[k]
    for k in range(s.v.shape[0]):
        s.ve[k] = M.v[k]
        s.turn[k] = (C[i] - C[i - 1]) * h * s.v[k]
    for j in range(i):
        a = h * A[i, j]
        for k in range(s.q.shape[0]):
            s.qe[k] += a * M.Q[j, k]
        for k in range(s.v.shape[0]):
            s.ve[k] += a * M.A[j, k]
    eqs.retract(s.q, s.turn, eqs.data)


@kernel
def rates(c: float, s: Any) -> None:
    """Slope, v and v' of the stage at s.q, c = 1 / (h gamma)."""
    for k in range(s.in_q.shape[0]):
        i = s.in_q[k]
        s.slope[i] = c * (s.q[i] - s.qe[i])
        s.v[s.in_v[k]] = s.slope[i]
    for k in range(s.turning.shape[0]):
        first = s.turning[k, 0]
        size = 0.0
        for i in range(first, first + 4):
            size += s.q[i] * s.qe[i]
        for i in range(first, first + 4):
            s.slope[i] = c * (size * s.q[i] - s.qe[i])
        angular_velocity(s.q, first, s.slope, 1.0 / size, s.v, s.turning[k, 1])
    for k in range(s.v.shape[0]):
        s.a[k] = c * (s.v[k] - s.ve[k])


@kernel
def residual(eqs: Any, t: float, c: float, s: Any) -> bool:
    """s.tau of the stage at s.q; False where it is not finite."""
    rates(c, s)
    eqs.inverse(t, s.q, s.v, s.a, s.lam, eqs.data, s.qdot, s.tau)
    finite = True
    for k in range(s.tau.shape[0]):
        finite = finite and np.isfinite(s.tau[k])
    return finite


@kernel
def foresee(eqs: Any, t: float, c: float, M: Any, s: Any) -> None:
    """s.tau <- residual of the first guess of stage 1, at s.q, by linear extrapolation of the equations from the
    end of the last step: by their difference over a small part of the way, s.turn.

    Friction is saturated at the guess itself, though it is not where the stage ends: a correction that starts from
    there goes far astray.
    """
    rates(c, s)
    for k in range(s.q.shape[0]):
        s.near[k] = M.q[k]
    begin = M.control[0].t
    eqs.inverse(begin, M.q, M.v, M.A[0], M.lam, eqs.data, s.qdot, s.start)
    for k in range(s.v.shape[0]):
        s.v[k] = M.v[k] + DIFFERENCE_RATIO * (s.v[k] - M.v[k])
        s.a[k] = M.A[0, k] + DIFFERENCE_RATIO * (s.a[k] - M.A[0, k])
        s.turn[k] *= DIFFERENCE_RATIO
    eqs.retract(s.near, s.turn, eqs.data)
    eqs.inverse(begin + DIFFERENCE_RATIO * (t - begin), s.near, s.v, s.a, M.lam, eqs.data, s.qdot, s.tau)
    for k in range(s.v.shape[0]):
        s.tau[k] = s.start[k] + (s.tau[k] - s.start[k]) / DIFFERENCE_RATIO


@kernel
def correct(eqs: Any, k: int, dq: Any, dlam: Any, s: Any) -> float:
    """Move the stage by correction k, accelerated; return its size in tolerances.

    Factors that are kept are wrong for a few modes only. With x_k the unknowns, f_k = -(dq, dlam) what Newton would add
    and dx, df their changes from one correction to the next, it is f - sum c (df + dx) that is added, c such that
    f - sum c df is least (Anderson; Walker, Ni, SIAM J. Numer. Anal. 49, 2011). The df are kept orthonormal.
    """
    n, size = dq.shape[0], size_of(dq, s)
    if k == 0:
        s.used[0] = 0
    else:
        keep_secant(s.used[0], dq, dlam, s)
    for i in range(n):
        s.f[i], s.step[i] = dq[i], dq[i]
    for i in range(dlam.shape[0]):
        s.f[n + i], s.step[n + i] = dlam[i], dlam[i]
    for j in range(s.used[0]):
        part = 0.0
        for i in range(n):
            part += s.df[j, i] * dq[i] / s.tol[i]
        for i in range(s.step.shape[0]):
            s.step[i] -= part * s.along[j, i]
    for i in range(n):
        s.turn[i] = -s.step[i]
    for i in range(dlam.shape[0]):
        s.lam[i] -= s.step[n + i]
    eqs.retract(s.q, s.turn, eqs.data)
    return size


@kernel
def keep_secant(k: int, dq: Any, dlam: Any, s: Any) -> None:
    """Row k of s.df and s.along from the last two corrections, by Gram and Schmidt; none where it is nothing new."""
    n = dq.shape[0]
    for i in range(s.step.shape[0]):
        change = (dq[i] if i < n else dlam[i - n]) - s.f[i]
        s.along[k, i] = s.step[i] + change
        if i < n:
            s.df[k, i] = change / s.tol[i]
    before = root_of_square(s.df, k)
    for j in range(k):
        part = 0.0
        for i in range(n):
            part += s.df[j, i] * s.df[k, i]
        for i in range(n):
            s.df[k, i] -= part * s.df[j, i]
        for i in range(s.step.shape[0]):
            s.along[k, i] -= part * s.along[j, i]
    left = root_of_square(s.df, k)
    if left > MIN_INDEPENDENT_RATIO * before:
        for i in range(n):
            s.df[k, i] /= left
        for i in range(s.step.shape[0]):
            s.along[k, i] /= left
        s.used[0] = k + 1


@inlined
def root_of_square(F: Any, k: int) -> float:
    """|F[k]|."""
    total = 0.0
    for i in range(F.shape[1]):
        total += F[k, i] * F[k, i]
    return np.sqrt(total)


@kernel
def size_of(dq: Any, s: Any) -> float:
    """The largest of dq (n,) in tolerances: one that moves among many that rest counts as if it were alone."""
    largest = 0.0
    for k in range(dq.shape[0]):
        size = abs(dq[k] / s.tol[k])
        if not size <= largest:
            largest = size
    return largest


@kernel
def end_stage(eqs: Any, i: int, t: float, c: float, works: int, M: Any, s: Any) -> None:
    """Keep the slopes of stage i, and its power."""
    rates(c, s)
    for k in range(s.slope.shape[0]):
        M.Q[i, k] = s.slope[k]
    for k in range(s.a.shape[0]):
        M.A[i, k] = s.a[k]
    M.P[i] = eqs.power(t, s.q, s.v, s.a, s.lam, eqs.data) if works == 1 else 0.0


@kernel
def error_of_step(h: float, M: Any, s: Any) -> None:
    """s.turn <- what formulas of order 3 and 2 differ by in the positions, as a motion."""
    for k in range(s.slope.shape[0]):
        s.slope[k] = 0.0
        for j in range(STAGES):
            s.slope[k] += h * (B[j] - EMBEDDED_WEIGHTS[j]) * M.Q[j, k]
    as_motion(s.q, s.slope, s, s.turn)


@kernel
def begin_motion(eqs: Any, t: float, works: int, M: Any, s: Any) -> None:
    """Take slope and power at (M.q, M.v), whose accelerations and multipliers are M.A[0] and M.lam."""
    as_slope(M.q, M.v, s, M.Q[0])
    M.P[0] = 0.0
    if works == 1:
        eqs.inverse(t, M.q, M.v, M.A[0], M.lam, eqs.data, s.qdot, s.tau)
        M.P[0] = eqs.power(t, M.q, M.v, M.A[0], M.lam, eqs.data)


@kernel
def accept(h: float, after: float, M: Any, s: Any) -> None:
    """Go on from (s.q, s.v), where the step of h has ended."""
    c = M.control[0]
    done, slip = 0.0, 0.0
    for j in range(STAGES):
        done += h * B[j] * M.P[j]
        slip += h * (B[j] - EMBEDDED_WEIGHTS[j]) * M.P[j]
    c.work_total_variation += abs(done)
    add_energy_error_bound(c, slip, h)
    M.ends[0], M.ends[1], M.ends[2], M.ends[3] = c.work, c.work + done, M.P[0], M.P[STAGES - 1]
    c.work, M.P[0] = c.work + done, M.P[STAGES - 1]
    for k in range(s.q.shape[0]):
        M.q0[k], M.slope0[k], M.q[k] = M.q[k], M.Q[0, k], s.q[k]
    as_slope(s.q, s.v, s, M.slope)
    for k in range(s.q.shape[0]):
        M.Q[0, k] = M.slope[k]
    for k in range(s.v.shape[0]):
        M.v[k], M.A[0, k] = s.v[k], M.A[STAGES - 1, k]
    for k in range(s.lam.shape[0]):
        M.lam[k] = s.lam[k]
    c.t, c.hold = after, h
    c.steps += 1


@kernel
def watch_inertia(eqs: Any, M: Any, s: Any, growth: Any) -> None:
    """Update the rate growth where the last step ended, at the cost of an inverse dynamics; see solvers.inertia."""
    eqs.inverse(M.control[0].t, M.q, M.v, s.zero, s.none, eqs.data, s.qdot, s.tau)
    eqs.inertia_parts(eqs.data, growth.parts)
    update_tree_growth(M.control[0].t, growth.parts, M.v, growth)


@kernel
def look_around(eqs: Any, M: Any, s: Any, scales: Any) -> None:
    """Update the energy bound where the last step ended, at the cost of an inverse dynamics.

    See :mod:`solvers.energy_account`.
    """
    c = M.control[0]
    if energy_check_scheduled(c):
        eqs.inverse(c.t, M.q, M.v, s.zero, s.none, eqs.data, s.qdot, s.tau)
        update_energy_bound(eqs.evaluate_energy_bound, eqs.data, c, scales)


@kernel
def interpolate(t: float, M: Any, s: Any, q: Any, v: Any) -> float:
    """Put into (q, v) the motion at t in the last step: cubic through the positions and slopes at its ends.

    Its velocity is the cubic's own; accelerations would bring in the unresolved modes. Returns W there.
    """
    c = M.control[0]
    h = c.hold
    x = 1.0 + (t - c.t) / h
    for k in range(q.shape[0]):
        rise = M.q[k] - M.q0[k]
        bend, skew = 3.0 * rise - h * (2.0 * M.slope0[k] + M.slope[k]), h * (M.slope0[k] + M.slope[k]) - 2.0 * rise
        q[k] = M.q0[k] + x * (h * M.slope0[k] + x * (bend + x * skew))
        s.slope[k] = M.slope0[k] + x * (2.0 * bend + 3.0 * x * skew) / h
    for k in range(s.turning.shape[0]):
        first, square = s.turning[k, 0], 0.0
        for i in range(first, first + 4):
            square += q[i] * q[i]
        for i in range(first, first + 4):
            q[i] /= np.sqrt(square)
            s.slope[i] /= np.sqrt(square)
    as_motion(q, s.slope, s, v)
    begin, end, p0, p = M.ends[0], M.ends[1], M.ends[2], M.ends[3]
    rise = end - begin
    bend, skew = 3.0 * rise - h * (2.0 * p0 + p), h * (p0 + p) - 2.0 * rise
    return begin + x * (h * p0 + x * (bend + x * skew))

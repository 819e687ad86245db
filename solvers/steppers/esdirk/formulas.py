"""ESDIRK3(2) for q' = N(q) v, M v' + h = 0: its coefficients, its stages, its error, and what lies between two steps.

The method is the implicit one of ARK3(2)4L[2]SA (Kennedy, Carpenter, Appl. Numer. Math. 44, 2003): four stages, the
first explicit, L-stable, stiffly accurate: the last stage is where the step ends, and its slopes are the next step's
first. With Q_j = N v and A_j = v' in stage j, stage i is at

    q_i = q_e + h gamma Q_i,    q_e = q + h sum_j<i a_ij Q_j,
    v_i = v_e + h gamma A_i,    v_e = v + h sum_j<i a_ij A_j.

Newton moves q_i alone: v_i and A_i follow from it, and where q is an angle or a length c = 1 / (h gamma) makes
dv = c dq, dA = c^2 dq, so that T = c^2 M + c D + K takes the residual's place. A unit quaternion u stands for the
position q_i = (u . q_e) u, whose slope is normal to it: the motion is extended to quaternions of any length by taking
the direction alone, which leaves q' = N(q) v and its order as they are. First-order states are entries of v without
positions: Newton moves them by c dq, with dq their entry in the solution of T.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import inlined, kernel, records
from solvers.energy_account import ACCOUNT_FIELDS, add_energy_error_bound, energy_check_scheduled, update_energy_bound
from solvers.inertia import update_tree_growth
from solvers.positions import Positions, angular_velocity, as_motion, as_slope
from solvers.system import Array

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.energy_account import EnergyScales
    from solvers.inertia import Growth
    from solvers.system import ComplexStepSystem, Equations

GAMMA = 1767732205903 / 4055673282236
N_STAGES = 4
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
MAX_STAGE_CORRECTIONS = 20  # corrections of a stage
DIFFERENCE_RATIO = 1e-3  # part of the way to a first guess, over which the equations are linear
CORNER_VELOCITY_ERROR_RATIO = 10.0  # error of velocities over the expected one, above which it is controlled
MIN_INDEPENDENT_RATIO = 1e-4  # part of a change of corrections that must be left after removal of the others
CONTROL = np.dtype(
    [
        *ACCOUNT_FIELDS,
        ("t", "f8"), ("h", "f8"), ("hold", "f8"),  # s: where it stands, the next step, the last one
        ("last_error", "f8"), ("last_error_step", "f8"),  # of the last step; its size, s; 0: none
        ("rate_error", "f8"), ("last_rate_error", "f8"),  # of velocities, by the last attempt and the last step
        ("rejected_rate_error", "f8"),  # by the attempt before, of the same step; inf: none
        ("failed_step", "f8"), ("retry_steps", "i8"),  # step size, s, at which Newton failed; wait for it
        ("start", "i8"),  # 1: the slopes are to be evaluated again
        ("truncated_steps", "i8"),  # number of steps that are yet to end at the requested time
        ("factored_c", "f8"), ("factored_at", "f8"),  # c, 1/s, and t, s, of the factors of T; c = 0: there are none
        ("n_factored", "i8"),  # how often T had been factored when they were made; -1: they must be made again
        ("keeps_factors", "i8"),  # 1: they are kept where loads jump
        ("work", "f8"),  # J
        ("steps", "i8"), ("rejected", "i8"), ("evaluations", "i8"), ("starts", "i8"),
        ("rank", "i8"),  # of the constraints; names from here on are those of other methods
        # always zero: a tree has no near misses, and its forces are determined
        ("undetermined", "i8"), ("undetermined_at", "f8"), ("max_near_miss_factor", "f8"), ("min_gap", "f8"),
    ],
    align=True,
)  # fmt: skip


class Memory(NamedTuple):
    """All that is needed to continue: the end of the last step, and its stages."""

    control: NDArray[Any]  # (1,)
    q: Array  # (nq,)
    v: Array  # (n,)
    lam: Array  # (m,)
    Q: Array  # (N_STAGES, nq) slopes; before a step, the first row
    A: Array  # (N_STAGES, n)
    P: Array  # (N_STAGES,) powers, W
    q0: Array  # (nq,) where it began
    slope0: Array  # (nq,)
    slope: Array  # (nq,) where it ended
    v0: Array  # (n,) first-order states where it began, and their rates
    a0: Array  # (n,)
    work_ends: Array  # (4,) W there, J, and its power, W, first where it began
    factored_state: Array  # (nq + 2 n + m,) state, accelerations and multipliers the factors were taken at

    @staticmethod
    def allocate(nq: int, n: int, m: int) -> Memory:
        """Return zeroed memory."""
        sizes = nq, n, m, (N_STAGES, nq), (N_STAGES, n), N_STAGES, nq, nq, nq, n, n, 4, nq + 2 * n + m
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
    dq: Array  # (n,) motion
    q_between: Array  # (nq,) a position between the last step and a guess
    tau_start: Array  # (n,) tau where the last step ended
    tol: Array  # (n,) of positions, as motions; of first-order states that over c
    state_tol: Array  # (n,) of first-order states
    c: Array  # (1,) 1/s
    newton_correction: Array  # (n + m,) the last correction of positions and multipliers by Newton
    applied_correction: Array  # (n + m,) the one that was made of it
    df: Array  # (MAX_STAGE_CORRECTIONS, n) changes of corrections, in tolerances, orthonormal
    along: Array  # (MAX_STAGE_CORRECTIONS, n + m) what goes with them
    n_secants: NDArray[np.int64]  # (1,) how many there are
    newton_x: Array  # (n,) solution of Newton's equations
    newton_y: Array  # (m,) its multipliers
    gap: Array  # (m,) how far accelerations are off those of the constraints, as a change of the positions
    guess: Array  # (nq,) first guess of the stage, its first-order states and multipliers
    guessed_v: Array  # (n,)
    guessed_lam: Array  # (m,)
    zero: Array  # (n,)
    no_multipliers: Array  # (m,) zero
    in_q: NDArray[np.int64]  # these as in solvers.positions.Positions
    in_v: NDArray[np.int64]
    turning: NDArray[np.int64]
    states: NDArray[np.int64]

    @staticmethod
    def allocate(nq: int, n: int, m: int, positions: Positions) -> Stage:
        """Return zeroed scratch."""
        z = np.zeros
        return Stage(
            z(nq), z(n), z(n), z(m), z(nq), z(nq), z(n), z(n), z(nq), z(n), z(nq), z(n), z(n), z(n), z(1),
            z(n + m), z(n + m), z((MAX_STAGE_CORRECTIONS, n)), z((MAX_STAGE_CORRECTIONS, n + m)), np.zeros(1, np.int64),
            z(n), z(m), z(m), z(nq), z(n), z(m), z(n), z(m), *positions,
        )  # fmt: skip


@kernel
def predict_stage(eqs: Any, i: int, h: float, memory: Memory, stage: Stage) -> None:
    """q_e and v_e of stage i, and a first guess from the stage before it: on at its velocity.

    The part of v' in unresolved modes would make the guess inaccurate.
    """
    for k in range(stage.q.shape[0]):
        stage.qe[k] = memory.q[k]
    for k in range(stage.v.shape[0]):
        stage.ve[k] = memory.v[k]
        stage.dq[k] = (C[i] - C[i - 1]) * h * stage.v[k]
    for j in range(i):
        a = h * A[i, j]
        for k in range(stage.q.shape[0]):
            stage.qe[k] += a * memory.Q[j, k]
        for k in range(stage.v.shape[0]):
            stage.ve[k] += a * memory.A[j, k]
    eqs.retract(stage.q, stage.dq, eqs.data)
    for k in range(stage.states.shape[0]):
        z = stage.states[k]
        stage.v[z] += (C[i] - C[i - 1]) * h * memory.A[i - 1, z]


@inlined
def move_stage(eqs: Any, stage: Stage) -> None:
    """Move the positions of the stage by stage.dq (n,), and its first-order states."""
    eqs.retract(stage.q, stage.dq, eqs.data)
    for k in range(stage.states.shape[0]):
        z = stage.states[k]
        stage.v[z] += stage.c[0] * stage.dq[z]


@kernel
def evaluate_rates(c: float, stage: Stage) -> None:
    """Slope, v and v' of the stage at stage.q, c = 1 / (h gamma)."""
    for k in range(stage.in_q.shape[0]):
        i = stage.in_q[k]
        stage.slope[i] = c * (stage.q[i] - stage.qe[i])
        stage.v[stage.in_v[k]] = stage.slope[i]
    for k in range(stage.turning.shape[0]):
        first = stage.turning[k, 0]
        size = 0.0
        for i in range(first, first + 4):
            size += stage.q[i] * stage.qe[i]
        for i in range(first, first + 4):
            stage.slope[i] = c * (size * stage.q[i] - stage.qe[i])
        angular_velocity(stage.q, first, stage.slope, 1.0 / size, stage.v, stage.turning[k, 1])
    for k in range(stage.v.shape[0]):
        stage.a[k] = c * (stage.v[k] - stage.ve[k])


@kernel
def residual(eqs: ComplexStepSystem, t: float, c: float, stage: Stage) -> bool:
    """Fill stage.tau at stage.q; False if it is not finite."""
    evaluate_rates(c, stage)
    eqs.inverse(t, stage.q, stage.v, stage.a, stage.lam, eqs.data, stage.qdot, stage.tau)
    finite = True
    for k in range(stage.tau.shape[0]):
        finite = finite and np.isfinite(stage.tau[k])
    return finite


@kernel
def predict_residual(eqs: ComplexStepSystem, t: float, c: float, memory: Memory, stage: Stage) -> None:
    """Predict the residual of the first guess of stage 1, at stage.q, in stage.tau.

    It is a linear extrapolation of the equations from the end of the last step: by their difference over a small part
    of the way, stage.dq.

    Friction is saturated at the guess itself, though it is not where the stage ends: a correction from there is far too
    large.
    """
    evaluate_rates(c, stage)
    for k in range(stage.q.shape[0]):
        stage.q_between[k] = memory.q[k]
    for k in range(stage.states.shape[0]):
        stage.guessed_v[stage.states[k]] = stage.v[stage.states[k]]
    begin = memory.control[0].t
    eqs.inverse(begin, memory.q, memory.v, memory.A[0], memory.lam, eqs.data, stage.qdot, stage.tau_start)
    for k in range(stage.v.shape[0]):
        stage.v[k] = memory.v[k] + DIFFERENCE_RATIO * (stage.v[k] - memory.v[k])
        stage.a[k] = memory.A[0, k] + DIFFERENCE_RATIO * (stage.a[k] - memory.A[0, k])
        stage.dq[k] *= DIFFERENCE_RATIO
    eqs.retract(stage.q_between, stage.dq, eqs.data)
    eqs.inverse(
        begin + DIFFERENCE_RATIO * (t - begin),
        stage.q_between,
        stage.v,
        stage.a,
        memory.lam,
        eqs.data,
        stage.qdot,
        stage.tau,
    )
    for k in range(stage.v.shape[0]):
        stage.tau[k] = stage.tau_start[k] + (stage.tau[k] - stage.tau_start[k]) / DIFFERENCE_RATIO
    for k in range(stage.states.shape[0]):
        stage.v[stage.states[k]] = stage.guessed_v[stage.states[k]]


@kernel
def correct_stage(eqs: Any, k: int, dq: Reals, dlam: Reals, stage: Stage) -> float:
    """Move the stage by correction k, accelerated; return its size in tolerances.

    Factors that are kept are wrong for a few modes only. With x_k the unknowns, f_k = -(dq, dlam) what Newton would add
    and dx, df their changes from one correction to the next, it is f - sum c (df + dx) that is added, c such that
    f - sum c df is least (Anderson; Walker, Ni, SIAM J. Numer. Anal. 49, 2011). The df are kept orthonormal.
    """
    n, size = dq.shape[0], measure_correction(dq, stage)
    if k == 0:
        stage.n_secants[0] = 0
    else:
        store_secant(stage.n_secants[0], dq, dlam, stage)
    for i in range(n):
        stage.newton_correction[i], stage.applied_correction[i] = dq[i], dq[i]
    for i in range(dlam.shape[0]):
        stage.newton_correction[n + i], stage.applied_correction[n + i] = dlam[i], dlam[i]
    for j in range(stage.n_secants[0]):
        part = 0.0
        for i in range(n):
            part += stage.df[j, i] * dq[i] / stage.tol[i]
        for i in range(stage.applied_correction.shape[0]):
            stage.applied_correction[i] -= part * stage.along[j, i]
    for i in range(n):
        stage.dq[i] = -stage.applied_correction[i]
    for i in range(dlam.shape[0]):
        stage.lam[i] -= stage.applied_correction[n + i]
    move_stage(eqs, stage)
    return size


@kernel
def store_secant(k: int, dq: Reals, dlam: Reals, stage: Stage) -> None:
    """Add row k to stage.df and stage.along from the last two corrections, by Gram and Schmidt.

    No row is added if it depends on the others.
    """
    n = dq.shape[0]
    for i in range(stage.applied_correction.shape[0]):
        change = (dq[i] if i < n else dlam[i - n]) - stage.newton_correction[i]
        stage.along[k, i] = stage.applied_correction[i] + change
        if i < n:
            stage.df[k, i] = change / stage.tol[i]
    before = row_norm(stage.df, k)
    for j in range(k):
        part = 0.0
        for i in range(n):
            part += stage.df[j, i] * stage.df[k, i]
        for i in range(n):
            stage.df[k, i] -= part * stage.df[j, i]
        for i in range(stage.applied_correction.shape[0]):
            stage.along[k, i] -= part * stage.along[j, i]
    left = row_norm(stage.df, k)
    if left > MIN_INDEPENDENT_RATIO * before:
        for i in range(n):
            stage.df[k, i] /= left
        for i in range(stage.applied_correction.shape[0]):
            stage.along[k, i] /= left
        stage.n_secants[0] = k + 1


@inlined
def row_norm(F: Reals, k: int) -> float:
    """|F[k]|."""
    total = 0.0
    for i in range(F.shape[1]):
        total += F[k, i] * F[k, i]
    return np.sqrt(total)


@kernel
def measure_correction(dq: Reals, stage: Stage) -> float:
    """The largest of dq (n,) in tolerances: one that moves among many that rest counts as if it were alone."""
    largest = 0.0
    for k in range(dq.shape[0]):
        size = abs(dq[k] / stage.tol[k])
        if not size <= largest:
            largest = size
    return largest


@kernel
def store_stage(eqs: Equations, i: int, t: float, c: float, works: int, memory: Memory, stage: Stage) -> None:
    """Keep the slopes of stage i, and its power."""
    evaluate_rates(c, stage)
    for k in range(stage.slope.shape[0]):
        memory.Q[i, k] = stage.slope[k]
    for k in range(stage.a.shape[0]):
        memory.A[i, k] = stage.a[k]
    memory.P[i] = eqs.power(t, stage.q, stage.v, stage.a, stage.lam, eqs.data) if works == 1 else 0.0


@kernel
def estimate_error(h: float, memory: Any, stage: Any) -> None:
    """stage.dq <- difference of the positions by the formulas of order 3 and 2, as a motion; of first-order states that
    over c.
    """
    for k in range(stage.slope.shape[0]):
        stage.slope[k] = 0.0
        for j in range(N_STAGES):
            stage.slope[k] += h * (B[j] - EMBEDDED_WEIGHTS[j]) * memory.Q[j, k]
    as_motion(stage.q, stage.slope, stage, stage.dq)
    for k in range(stage.states.shape[0]):
        z, error = stage.states[k], 0.0
        for j in range(N_STAGES):
            error += h * (B[j] - EMBEDDED_WEIGHTS[j]) * memory.A[j, z]
        stage.dq[z] = error / stage.c[0]


@kernel
def estimate_rate_error(h: float, memory: Any, stage: Any) -> None:
    """stage.dq <- difference of the velocities by the formulas of order 3 and 2."""
    for k in range(stage.dq.shape[0]):
        stage.dq[k] = 0.0
        for j in range(N_STAGES):
            stage.dq[k] += h * (B[j] - EMBEDDED_WEIGHTS[j]) * memory.A[j, k]


@inlined
def has_corner(h: float, control: Any) -> bool:
    """Whether the velocity error of a step of h is far above the one that follows from the last step if the motion is
    smooth, and a shorter step makes it smaller. What remains of Newton's method in the velocities does not become
    smaller.
    """
    last, error = control.last_error_step, control.rate_error
    if last == 0.0 or error >= control.rejected_rate_error:
        return False
    expected = control.last_rate_error * (h / last) ** 3
    return not error <= CORNER_VELOCITY_ERROR_RATIO * expected


@inlined
def set_state_tolerances(c: float, stage: Stage) -> None:
    """Let c be 1 / (h gamma), and set the tolerances that depend on it."""
    stage.c[0] = c
    for k in range(stage.states.shape[0]):
        stage.tol[stage.states[k]] = stage.state_tol[stage.states[k]] / c


@kernel
def evaluate_start(eqs: Any, t: float, works: int, memory: Any, stage: Any) -> None:
    """Slope and power at (memory.q, memory.v), with accelerations memory.A[0] and multipliers memory.lam."""
    as_slope(memory.q, memory.v, stage, memory.Q[0])
    memory.P[0] = 0.0
    if works == 1:
        eqs.inverse(t, memory.q, memory.v, memory.A[0], memory.lam, eqs.data, stage.qdot, stage.tau)
        memory.P[0] = eqs.power(t, memory.q, memory.v, memory.A[0], memory.lam, eqs.data)


@kernel
def accept_step(h: float, after: float, memory: Memory, stage: Any) -> None:
    """Accept the step of h, which has ended at (stage.q, stage.v)."""
    control = memory.control[0]
    done, slip = 0.0, 0.0
    for j in range(N_STAGES):
        done += h * B[j] * memory.P[j]
        slip += h * (B[j] - EMBEDDED_WEIGHTS[j]) * memory.P[j]
    control.work_total_variation += abs(done)
    add_energy_error_bound(control, slip, h)
    memory.work_ends[0], memory.work_ends[1], memory.work_ends[2], memory.work_ends[3] = (
        control.work,
        control.work + done,
        memory.P[0],
        memory.P[N_STAGES - 1],
    )
    control.work, memory.P[0] = control.work + done, memory.P[N_STAGES - 1]
    for k in range(stage.q.shape[0]):
        memory.q0[k], memory.slope0[k], memory.q[k] = memory.q[k], memory.Q[0, k], stage.q[k]
    as_slope(stage.q, stage.v, stage, memory.slope)
    for k in range(stage.q.shape[0]):
        memory.Q[0, k] = memory.slope[k]
    for k in range(stage.states.shape[0]):
        z = stage.states[k]
        memory.v0[z], memory.a0[z] = memory.v[z], memory.A[0, z]
    for k in range(stage.v.shape[0]):
        memory.v[k], memory.A[0, k] = stage.v[k], memory.A[N_STAGES - 1, k]
    for k in range(stage.lam.shape[0]):
        memory.lam[k] = stage.lam[k]
    control.t, control.hold = after, h
    control.steps += 1


@kernel
def update_inertia_growth(eqs: Any, memory: Memory, stage: Stage, growth: Growth) -> None:
    """Update the rate growth where the last step ended, at the cost of an inverse dynamics; see solvers.inertia."""
    eqs.inverse(
        memory.control[0].t, memory.q, memory.v, stage.zero, stage.no_multipliers, eqs.data, stage.qdot, stage.tau
    )
    eqs.inertia_parts(eqs.data, growth.parts)
    update_tree_growth(memory.control[0].t, growth.parts, memory.v, growth)


@kernel
def record_energy(eqs: Any, memory: Memory, stage: Stage, scales: EnergyScales) -> None:
    """Record the energy where the last step ended; this costs an inverse dynamics (`solvers.energy_account`)."""
    control = memory.control[0]
    if energy_check_scheduled(control):
        eqs.inverse(control.t, memory.q, memory.v, stage.zero, stage.no_multipliers, eqs.data, stage.qdot, stage.tau)
        update_energy_bound(eqs.evaluate_energy_bound, eqs.data, control, scales)


@kernel
def interpolate(t: float, memory: Any, stage: Any, q: Reals, v: Reals) -> float:
    """Put into (q, v) the motion at t in the last step: cubic through the positions and slopes at its ends.

    Its velocity is the cubic's own; accelerations would bring in the unresolved modes. Returns W there.
    """
    control = memory.control[0]
    h = control.hold
    x = 1.0 + (t - control.t) / h
    for k in range(q.shape[0]):
        rise = memory.q[k] - memory.q0[k]
        bend, skew = (
            3.0 * rise - h * (2.0 * memory.slope0[k] + memory.slope[k]),
            h * (memory.slope0[k] + memory.slope[k]) - 2.0 * rise,
        )
        q[k] = memory.q0[k] + x * (h * memory.slope0[k] + x * (bend + x * skew))
        stage.slope[k] = memory.slope0[k] + x * (2.0 * bend + 3.0 * x * skew) / h
    for k in range(stage.turning.shape[0]):
        first, square = stage.turning[k, 0], 0.0
        for i in range(first, first + 4):
            square += q[i] * q[i]
        for i in range(first, first + 4):
            q[i] /= np.sqrt(square)
            stage.slope[i] /= np.sqrt(square)
    as_motion(q, stage.slope, stage, v)
    for k in range(stage.states.shape[0]):
        z = stage.states[k]
        rise = memory.v[z] - memory.v0[z]
        bend, skew = (
            3.0 * rise - h * (2.0 * memory.a0[z] + memory.A[0, z]),
            h * (memory.a0[z] + memory.A[0, z]) - 2.0 * rise,
        )
        v[z] = memory.v0[z] + x * (h * memory.a0[z] + x * (bend + x * skew))
    begin, end, p0, p = memory.work_ends[0], memory.work_ends[1], memory.work_ends[2], memory.work_ends[3]
    rise = end - begin
    bend, skew = 3.0 * rise - h * (2.0 * p0 + p), h * (p0 + p) - 2.0 * rise
    return begin + x * (h * p0 + x * (bend + x * skew))

"""One step of ESDIRK3(2): Newton's iterations of its stages, factors of T, the error, and the next step size.

All kernels get a :class:`solvers.steppers.step_loop.Integration` with the memory of :mod:`.formulas` and a
:class:`Work`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.record import f8, i8
from solvers.compiled.tuple_pointer import pin
from solvers.inertia import InertiaRecord, tolerance_factor
from solvers.outcome import COLLAPSED, NOT_FINITE, OK
from solvers.positions import Positions, count_velocities
from solvers.projection.tree_constraints import (
    ConstraintScratch,
    SaddleMemory,
    factor_saddle,
    project_state,
    set_penalties,
    solve_saddle,
)
from solvers.steppers.step_loop import StepSettingsRecord
from solvers.system import Array

from .attempts import make_take_step
from .formulas import (
    GAMMA,
    MAX_STAGE_CORRECTIONS,
    N_STAGES,
    C,
    Stage,
    correct_stage,
    estimate_error,
    estimate_rate_error,
    has_corner,
    move_stage,
    predict_residual,
    predict_stage,
    record_energy,
    residual,
    set_state_tolerances,
    store_stage,
    update_inertia_growth,
)

if TYPE_CHECKING:
    from solvers.compiled.record import Reals, Table
    from solvers.steppers.step_loop import Integration

# Of the tolerance, to which the estimated error of a step is held: the error of the motion adds up to more.
ERROR_TOLERANCE_RATIO = 0.2
# What Newton may leave of a stage, in these tolerances: STAGE_TOLERANCE, or DRIFT_FACTOR (h rate)^2. It has one sign in
# many steps, and the rate that it leaves behind, larger by 1 / (h gamma), adds up to a drift.
STAGE_TOLERANCE, DRIFT_FACTOR = 0.05, 6.0
ROUNDING_OF_CORRECTIONS = 1e-12  # in units of size
MIN_SQUARED_MOTION = 1e-16  # square of rate times step: in shorter steps all corrections but one are rounding errors
PROJECTION_ITERATIONS = 2  # of the projection onto the constraints with the factors of the stages
MAX_CONTRACTION = 0.7  # above this rate of convergence factors are renewed
MAX_REFACTORIZATIONS = 8  # within a stage
FIRST_CONTRACTION, MIN_CONTRACTION = 0.5, 0.1  # rate of convergence before the second correction; the least assumed
NEGLIGIBLE_CORRECTION = 0.02  # of the tolerance of a stage: a correction that need not decrease
FACTOR_REUSE_TOLERANCE = 1e-3  # part by which 1 / (h gamma) may be off that of the factors
# Of the tolerance of a coordinate that of a node, whose error is the sum of those of all joints before it.
NODE_TOLERANCE_FACTOR = 0.4
VELOCITY_TOLERANCE_RATIO = 3.0  # tolerance of a velocity to that of its coordinate, in units of the rate of the motion
RTOL_EXPONENT = 1.3  # of the tolerance of a step, as that of the motion


class SettingsRecord(StepSettingsRecord):
    """Options of ESDIRK, and what its system is like."""

    rate: f8  # of the motion, 1/s
    stage_tolerance: f8  # see STAGE_TOLERANCE
    is_symmetric: i8  # 1: T may be taken as symmetric
    is_smooth: i8  # 0: forces change sharply within the tolerance
    mesh_length: f8  # m, see solvers.system.TreeSystem
    node_tolerance: f8  # of displacements of nodes in mesh_length, and of their rotations, rad, in this step


SETTINGS = SettingsRecord.dtype


class Work(NamedTuple):
    """Units and scratch; only the units and :meth:`memory` are needed after a call."""

    positions: Any  # solvers.positions.Positions
    size: Array  # (n,) units of the coordinates
    size_q: Array  # (nq,) units of the positions
    mesh_mask: Array  # (n,) 1: a coordinate of a mesh's node, whose error is that of the node
    node_motion: Array  # (2,) see solvers.system.TreeSystem.mesh_motion
    coordinate_rates: Array  # (n,) 1/s, as solvers.inertia.Growth has them
    parts: Array  # (1 + n,)
    inertia: Table[InertiaRecord]  # (1,)
    q: Array  # (nq,) a state, its rates, and zeros, for who evaluates the equations at other states
    v: Array  # (n,)
    a: Array  # (n,)
    qdot: Array  # (nq,)
    zero: Array  # (n,)
    stage: Any  # .formulas.Stage
    constraints: Any  # solvers.projection.tree_constraints.ConstraintScratch
    saddle: Any  # ... SaddleMemory

    @staticmethod
    def allocate(nq: int, n: int, m: int, positions: Positions) -> Work:
        """Return zeroed arrays; the units are to be filled."""
        z, own = np.zeros, ConstraintScratch.allocate(nq, n, m)
        return Work(
            positions, z(n), z(nq), z(n), z(2), z(n), z(1 + n), InertiaRecord.zeros(1), z(nq), z(n), z(n), z(nq), z(n),
            pin(Stage.allocate(nq, n, m, positions)), pin(own), pin(SaddleMemory.allocate(n, m)),
        )  # fmt: skip

    def memory(self) -> list[Any]:
        """Return the arrays that are needed to continue a motion."""
        return [self.inertia, self.coordinate_rates]


@kernel
def record_state(integration: Integration) -> None:
    """Record rate growth and energy where the last step ended."""
    eqs, memory, work = integration.eqs, integration.memory, integration.work
    if work.inertia[0].watched == 1:
        update_inertia_growth(eqs, memory, work.stage, work)
    if integration.settings[0].energy_check == 1:
        record_energy(eqs, memory, work.stage, integration.scales)


@inlined
def set_tolerances(integration: Integration) -> None:
    """Tolerances of the positions in this step."""
    settings, memory, work = integration.settings[0], integration.memory, integration.work
    stage = work.stage
    for k in range(stage.tol.shape[0]):
        stage.tol[k] = ERROR_TOLERANCE_RATIO * (settings.atol * work.size[k])
    for k in range(stage.in_q.shape[0]):
        stage.tol[stage.in_v[k]] += ERROR_TOLERANCE_RATIO * settings.rtol * abs(memory.q[stage.in_q[k]])
    for k in range(stage.states.shape[0]):
        stage.tol[stage.states[k]] += ERROR_TOLERANCE_RATIO * settings.rtol * abs(memory.v[stage.states[k]])
    finer = tolerance_factor(settings.rtol, RTOL_EXPONENT, work)
    bend = 0.0
    for k in range(stage.tol.shape[0]):
        stage.tol[k] *= finer
        if work.mesh_mask[k] == 1.0:
            bend = max(bend, stage.tol[k] / work.size[k])
    for k in range(stage.states.shape[0]):
        stage.state_tol[stage.states[k]] = stage.tol[stage.states[k]]
    settings.node_tolerance = NODE_TOLERANCE_FACTOR * bend


@kernel
def try_step(h: float, after: float, integration: Integration) -> tuple[int, float]:
    """Solve the stages of a step of h; return a code, and the error in tolerances."""
    eqs, settings, memory, work = integration.eqs, integration.settings[0], integration.memory, integration.work
    control, stage, c = memory.control[0], work.stage, 1.0 / (GAMMA * h)
    coarsest = 0.0
    set_state_tolerances(c, stage)
    for k in range(count_velocities(work.positions, stage.tol.shape[0])):
        coarsest = max(coarsest, stage.tol[k] / work.size[k])
    rounding, motion = ROUNDING_OF_CORRECTIONS / coarsest, (settings.rate * h) ** 2
    tolerance = min(settings.stage_tolerance, DRIFT_FACTOR * motion) if motion > MIN_SQUARED_MOTION else rounding
    if not ensure_factors(c, integration):
        return COLLAPSED, np.inf
    for k in range(stage.q.shape[0]):
        stage.q[k] = memory.q[k]
    for k in range(stage.v.shape[0]):
        stage.v[k] = memory.v[k]
    for row in range(stage.lam.shape[0]):
        stage.lam[row] = memory.lam[row]
    for i in range(1, N_STAGES):
        at = control.t + C[i] * h if i < N_STAGES - 1 else after
        predict_stage(eqs, i, h, memory, stage)
        if i == 1 and settings.is_smooth == 0 and stage.lam.shape[0] == 0:
            control.evaluations += 2
            predict_residual(eqs, at, c, memory, stage)
            solve_saddle(eqs, stage.tau, stage.no_multipliers, work.saddle, stage.newton_x, stage.newton_y)
            apply_change(eqs, stage)
        code = solve_stage(at, c, tolerance, rounding, integration)
        if code != OK:
            return code, np.inf
        store_stage(eqs, i, at, c, settings.works, memory, stage)
    code = close_step(after, integration)
    estimate_error(h, memory, stage)
    filter_error(c, integration)
    error = measure_error(stage.newton_x, integration)
    if not has_mesh(work):
        estimate_rate_error(h, memory, stage)
        filter_error(c, integration)
        control.rate_error = measure_rate_error(stage.newton_x, integration)
        if has_corner(h, control):
            error = larger_or_nan(error, control.rate_error)
    return code, error


@inlined
def has_mesh(work: Any) -> bool:
    """Whether some coordinates are those of a mesh: forces on it begin and end in most steps."""
    for k in range(work.mesh_mask.shape[0]):
        if work.mesh_mask[k] != 0.0:
            return True
    return False


@inlined
def filter_error(c: float, integration: Integration) -> None:
    """stage.newton_x <- the part of the error stage.dq (n,) in modes that the step resolves."""
    eqs, work, stage = integration.eqs, integration.work, integration.work.stage
    eqs.multiply_mass_matrix(stage.dq, eqs.tangent, stage.tau)
    for k in range(stage.tau.shape[0]):
        stage.tau[k] *= c**2
    solve_saddle(eqs, stage.tau, stage.no_multipliers, work.saddle, stage.newton_x, stage.newton_y)


@inlined
def larger_or_nan(a: float, b: float) -> float:
    """The larger of a and b; b, where it is not a number."""
    return a if b <= a else b


@kernel
def measure_error(dq: Reals, integration: Integration) -> float:
    """The largest error in tolerances by a motion dq (n,): of a coordinate, or in meshes of a node.

    The error of a node adds up along its path, and that of a joint between two nodes depends on how far apart they are.
    """
    eqs, settings, work = integration.eqs, integration.settings[0], integration.work
    tol, largest = work.stage.tol, 0.0
    for k in range(dq.shape[0]):
        if work.mesh_mask[k] == 0.0:
            largest = larger_or_nan(largest, abs(dq[k]) / tol[k])
    if settings.mesh_length == 0.0:
        return largest
    eqs.mesh_motion(dq, work.mesh_mask, eqs.data, work.node_motion)
    size = larger_or_nan(work.node_motion[0] / settings.mesh_length, work.node_motion[1])
    return larger_or_nan(largest, size / settings.node_tolerance)


@inlined
def measure_rate_error(dv: Reals, integration: Integration) -> float:
    """The largest error in tolerances by a change dv (n,) of velocities."""
    work, rate, largest = integration.work, VELOCITY_TOLERANCE_RATIO * integration.settings[0].rate, 0.0
    for k in range(count_velocities(work.positions, dv.shape[0])):
        largest = larger_or_nan(largest, abs(dv[k]) / (rate * work.stage.tol[k]))
    return largest


@inlined
def apply_change(eqs: Any, stage: Stage) -> None:
    """Change the positions of the stage by minus the solution of Newton's equations."""
    for k in range(stage.dq.shape[0]):
        stage.dq[k] = -stage.newton_x[k]
    move_stage(eqs, stage)


@kernel
def close_step(t: float, integration: Integration) -> int:
    """Bring the end of a step onto the constraints; return a code.

    First the way that reactions move it: what Newton leaves of the multipliers is all gone then, where the shortest
    way would turn a part of it into motion.
    """
    eqs, work, stage = integration.eqs, integration.work, integration.work.stage
    terms, m = work.constraints.terms, stage.lam.shape[0]
    for _ in range(PROJECTION_ITERATIONS if m > 0 else 0):
        eqs.position(t, stage.q, eqs.data, terms)
        solve_saddle(eqs, stage.zero, terms.Phi, work.saddle, stage.newton_x, stage.newton_y)
        apply_change(eqs, stage)
    if m > 0:
        eqs.position(t, stage.q, eqs.data, terms)
    for _ in range(PROJECTION_ITERATIONS if m > 0 else 0):
        for row in range(m):
            stage.gap[row] = -terms.nu[row]
            for k in range(stage.v.shape[0]):
                stage.gap[row] += terms.J[row, k] * stage.v[k]
        solve_saddle(eqs, stage.zero, stage.gap, work.saddle, stage.newton_x, stage.newton_y)
        for k in range(count_velocities(work.positions, stage.v.shape[0])):
            stage.v[k] -= stage.newton_x[k]
    code: int = project_state(eqs, t, stage.q, stage.v, work.size, work.constraints)
    return code


@kernel
def solve_stage(t: float, c: float, tolerance: float, rounding: float, integration: Integration) -> int:
    """Solve the stage that has been begun, to ``tolerance`` tolerances; return a code.

    If corrections decrease slowly, factors are renewed on the way; if they grow, at the first guess. Corrections
    below ``rounding`` tolerances that do not decrease are rounding errors.
    """
    eqs, memory, work, stage = integration.eqs, integration.memory, integration.work, integration.work.stage
    contraction, before, first, n_refactored, fresh = FIRST_CONTRACTION, 0.0, 0, 0, np.inf
    store_guess(stage)
    for k in range(MAX_STAGE_CORRECTIONS):
        refactors = k - first > 1 and contraction > MAX_CONTRACTION
        if refactors and n_refactored == 0 and contraction > 1.0:
            restore_guess(stage)
        memory.control[0].evaluations += 1
        if not residual(eqs, t, c, stage):
            return NOT_FINITE
        measure_gap(t, c, integration)
        if refactors:
            if n_refactored == MAX_REFACTORIZATIONS:
                break
            n_refactored, first = n_refactored + 1, k
            set_factor_point(t, c, stage.q, stage.v, stage.a, stage.lam, memory)
            if not factor(integration):
                break
        solve_saddle(eqs, stage.tau, stage.gap, work.saddle, stage.newton_x, stage.newton_y)
        size = correct_stage(eqs, k - first, stage.newton_x, stage.newton_y, stage)
        if not np.isfinite(size):
            return NOT_FINITE
        if refactors:
            if n_refactored > 1 and size > fresh:  # Newton's own corrections grow: what is far will not come nearer
                break
            fresh = size
        contraction = max(MIN_CONTRACTION, size / before) if k > first else contraction
        if size <= NEGLIGIBLE_CORRECTION * tolerance or contraction * size <= tolerance * (1.0 - contraction):
            return OK
        if k > first and size <= rounding and contraction > MAX_CONTRACTION:
            return OK
        before = size
    return COLLAPSED


@inlined
def store_guess(stage: Stage) -> None:
    """Note where the stage begins."""
    for k in range(stage.q.shape[0]):
        stage.guess[k] = stage.q[k]
    for k in range(stage.states.shape[0]):
        stage.guessed_v[stage.states[k]] = stage.v[stage.states[k]]
    for row in range(stage.lam.shape[0]):
        stage.guessed_lam[row] = stage.lam[row]


@inlined
def restore_guess(stage: Stage) -> None:
    """Return to where the stage began."""
    for k in range(stage.q.shape[0]):
        stage.q[k] = stage.guess[k]
    for k in range(stage.states.shape[0]):
        stage.v[stage.states[k]] = stage.guessed_v[stage.states[k]]
    for row in range(stage.lam.shape[0]):
        stage.lam[row] = stage.guessed_lam[row]


@kernel
def measure_gap(t: float, c: float, integration: Integration) -> None:
    """stage.gap (m,) <- how far the stage's accelerations are off the constraints', as a change of the positions.

    Position constraints in the stages would take the order to one.
    """
    eqs, stage, terms = integration.eqs, integration.work.stage, integration.work.constraints.terms
    if stage.gap.shape[0] == 0:
        return
    eqs.constraints(t, stage.q, stage.v, eqs.data, terms)
    for row in range(stage.gap.shape[0]):
        total = -terms.gamma[row]
        for k in range(stage.a.shape[0]):
            total += terms.J[row, k] * stage.a[k]
        stage.gap[row] = total / c**2


@kernel
def set_factor_point(t: float, c: float, q: Reals, v: Reals, a: Reals, lam: Reals, memory: Any) -> None:
    """Note where factors are to be taken, and for which 1 / (h gamma) = ``c``."""
    memory.control[0].factored_c, memory.control[0].factored_at = c, t
    at, n, m = q.shape[0], v.shape[0], lam.shape[0]
    for k in range(at):
        memory.factored_state[k] = q[k]
    for k in range(n):
        memory.factored_state[at + k], memory.factored_state[at + n + k] = v[k], a[k]
    for row in range(m):
        memory.factored_state[at + 2 * n + row] = lam[row]


@kernel
def ensure_factors(c: float, integration: Integration) -> bool:
    """Have factors for 1 / (h gamma) = ``c``, those there are if they are not far off; False: singular."""
    eqs, memory, control = integration.eqs, integration.memory, integration.memory.control[0]
    if abs(control.factored_c - c) > FACTOR_REUSE_TOLERANCE * c:
        set_factor_point(control.t, c, memory.q, memory.v, memory.A[0], memory.lam, memory)
    elif control.n_factored == eqs.tangent.n_factored[0]:
        return True
    return factor(integration)


@kernel
def factor(integration: Integration) -> bool:
    """Factor T where it has been placed; False where it is singular."""
    eqs, memory, work = integration.eqs, integration.memory, integration.work
    control, stage, state = memory.control[0], work.stage, memory.factored_state
    at, n, m = memory.q.shape[0], memory.v.shape[0], memory.lam.shape[0]
    q, v, a, lam = state[:at], state[at : at + n], state[at + n : at + 2 * n], state[at + 2 * n : at + 2 * n + m]
    set_penalties(eqs, control.factored_at, q, work.saddle, work.constraints)
    if m > 0:
        eqs.position(control.factored_at, q, eqs.data, work.constraints.terms)
    eqs.inverse(control.factored_at, q, v, a, lam, eqs.data, stage.qdot, work.constraints.change)
    good = factor_saddle(
        eqs, control.factored_c, control.factored_c**2, integration.settings[0].is_symmetric == 1, work.saddle,
        work.constraints,
    )  # fmt: skip
    control.n_factored = eqs.tangent.n_factored[0]
    if not good:
        control.factored_c = 0.0
    return good


take_step = make_take_step(__name__, set_tolerances=set_tolerances, try_step=try_step, record_state=record_state)

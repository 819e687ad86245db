"""What IDA is given in tree form: callbacks, and the function that accepts its steps. The equations: :mod:`.tree`.

All but :func:`residual` get the integration: :class:`solvers.steppers.step_loop.Integration` with the memory and the
work of :mod:`.tree_memory`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import inlined, kernel
from solvers.energy_account import energy_check_scheduled, record_step, update_energy_bound
from solvers.inertia import tolerance_factor, update_tree_growth
from solvers.linalg.inversion import invert
from solvers.outcome import NOT_CLOSED, OK
from solvers.positions import as_motion, as_slope
from solvers.projection.projection import RESIDUAL_TOLERANCE
from solvers.projection.tree_constraints import project_state
from solvers.system import Array

from .dense_callbacks import RTOL_EXPONENT
from .loop import JACOBIANS, NONFINITE_RESIDUALS, RESIDUALS, STEPS

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.steppers.step_loop import Integration

KRYLOV_STEP_SIZE = 1e-20  # of an imaginary step


class Scratch(NamedTuple):
    """Writable copies of what IDA passes, and scratch; N = nq + n + 2 m."""

    q: Array  # (nq,)
    v: Array  # (n,)
    a: Array  # (n,)
    lam: Array  # (m,)
    qdot: Array  # (nq,)
    unit: Array  # (nq,) q with unit quaternions
    slope: Array  # (nq,)
    zero: Array  # (n,)
    tau: Array  # (n,)
    res_motion: Array  # (n,) first residual as a motion
    load: Array  # (n,)
    dtheta: Array  # (n,) dtheta
    right: Array  # (2 m,)
    multipliers: Array  # (2 m,) dmu, dlambda

    @staticmethod
    def allocate(nq: int, n: int, m: int, scalar: type = float) -> Scratch:
        """Return zeroed arrays."""
        sizes = nq, n, n, m, nq, nq, nq, n, n, n, n, n, 2 * m, 2 * m
        return Scratch(*(np.zeros(size, scalar) for size in sizes))


class Reduced(NamedTuple):
    """The equations that are left for the constraints, taken with the tangent; see :mod:`.tree`."""

    c: Array  # (1,) 1/s
    length_rate: Array  # (1,) k, 1/s
    d: Array  # (2, m) d0 and d1
    metric: Array  # (n,) S^2
    J: Array  # (m, n)
    A: Array  # (m, n) rows T^-1 J^T
    X: Array  # (m, n) rows T^-1 c M S^2 J^T
    inverse: Array  # (2 m, 2 m) of their matrix
    scratch: Array  # (2 m, 2 m)
    order: NDArray[np.int64]  # (2 m,) scratch
    weight: Array  # (m,) zero: springs of the tangent, see solvers.system.TangentCallbacks

    @staticmethod
    def allocate(n: int, m: int) -> Reduced:
        """Return zeroed arrays."""
        z, square = np.zeros, (2 * m, 2 * m)
        rows = z((m, n)), z((m, n)), z((m, n))
        return Reduced(z(1), z(1), z((2, m)), z(n), *rows, z(square), z(square), np.zeros(2 * m, np.int64), z(m))


class ResidualData(NamedTuple):
    """What :func:`residual` works on, in real numbers or with an imaginary step."""

    scratch: Any  # Scratch
    terms: Any  # of the constraints
    reduced: Any  # Reduced
    positions: Any  # solvers.positions.Positions


class ComplexStep(NamedTuple):
    """Arguments of :func:`residual` with an imaginary step of the unknowns."""

    eqs: Any  # solvers.system.ComplexStepSystem
    own: Any  # ResidualData
    y: Array  # (N,) complex, as the two that follow
    slopes: Array
    res: Array


@inlined
def copy_unknowns(y: Reals, slopes: Reals, scratch: Any) -> None:
    """Copy IDA's arrays."""
    nq, n = scratch.q.shape[0], scratch.v.shape[0]
    for i in range(nq):
        scratch.q[i] = y[i]
    for i in range(n):
        scratch.v[i], scratch.a[i] = y[nq + i], slopes[nq + i]
    for row in range(scratch.lam.shape[0]):
        scratch.lam[row] = y[nq + n + row]


@kernel
def residual(t: float, y: Reals, slopes: Reals, res: Reals, eqs: Any, own: ResidualData) -> bool:
    """IDA's residual function; what is not finite IDA takes as a sign to cut the step."""
    scratch, d, metric, terms, rate = (
        own.scratch,
        own.reduced.d,
        own.reduced.metric,
        own.terms,
        own.reduced.length_rate[0],
    )
    nq, n, m = scratch.q.shape[0], scratch.v.shape[0], scratch.lam.shape[0]
    copy_unknowns(y, slopes, scratch)
    if m > 0:
        eqs.position(t, scratch.q, eqs.data, terms)
    eqs.inverse(t, scratch.q, scratch.v, scratch.a, scratch.lam, eqs.data, scratch.qdot, scratch.tau)
    for i in range(nq):
        scratch.unit[i] = scratch.q[i]
    eqs.retract(scratch.unit, scratch.zero, eqs.data)
    for i in range(nq):
        res[i] = slopes[i] - scratch.qdot[i] + rate * (scratch.q[i] - scratch.unit[i])
    finite = True
    for i in range(n):
        res[nq + i] = scratch.tau[i]
        finite = finite and np.isfinite(scratch.tau[i])
    if m == 0:
        return finite
    for i in range(n):
        scratch.load[i] = 0.0
        for row in range(m):
            scratch.load[i] += metric[i] * terms.J[row, i] * y[nq + n + m + row]
    as_slope(scratch.q, scratch.load, own.positions, scratch.slope)
    for i in range(nq):
        res[i] += scratch.slope[i]
    for row in range(m):
        speed = -terms.nu[row]
        for i in range(n):
            speed += terms.J[row, i] * scratch.v[i]
        res[nq + n + row] = speed - d[0, row] * scratch.lam[row]
        res[nq + n + m + row] = terms.Phi[row] - d[1, row] * y[nq + n + m + row]
    return finite


@kernel
def evaluate_residual(t: float, y: Reals, slopes: Reals, out: Reals, problem: Integration) -> None:
    """out (N,) <- residual of IDA."""
    counts = problem.memory.counts
    counts[RESIDUALS] += 1.0
    if not residual(t, y, slopes, out, problem.eqs, problem.work.own):
        counts[NONFINITE_RESIDUALS] += 1.0


@kernel
def multiply_matrix(t: float, y: Reals, slopes: Reals, x: Reals, c: float, out: Reals, problem: Integration) -> None:
    """out (N,) <- (dF/dy + c dF/dy') x of the residual F, exactly."""
    e = problem.work.complex_step
    for i in range(out.shape[0]):
        e.y[i], e.slopes[i] = y[i] + KRYLOV_STEP_SIZE * x[i] * 1j, slopes[i] + KRYLOV_STEP_SIZE * c * x[i] * 1j
    residual(t, e.y, e.slopes, e.res, e.eqs, e.own)
    for i in range(out.shape[0]):
        out[i] = e.res[i].imag / KRYLOV_STEP_SIZE


@kernel
def set_error_weights(y: Reals, out: Reals, problem: Integration) -> None:
    """out (N,) <- one over the tolerances of the unknowns."""
    tolerances = problem.work.tolerances
    finer = tolerance_factor(tolerances[0, 0], RTOL_EXPONENT, problem.work)
    for i in range(out.shape[0]):
        out[i] = 1.0 / (finer * min(tolerances[0, i] * abs(y[i]) + tolerances[1, i], tolerances[2, i]))


@kernel
def set_up_preconditioner(t: float, y: Reals, slopes: Reals, cj: float, problem: Integration) -> int:
    """Factor the tangent and the equations of the constraints; 1: it is singular there."""
    eqs, own = problem.eqs, problem.work.own
    problem.memory.counts[JACOBIANS] += 1.0
    evaluate_residual(t, y, slopes, problem.work.residual, problem)
    own.reduced.c[0] = cj
    if not eqs.factor_tangent(cj, cj * cj, own.reduced.weight, False, eqs.tangent):
        return 1
    return 0 if reduce_constraints(cj, eqs, own) else 1


@kernel
def reduce_constraints(cj: float, eqs: Any, own: ResidualData) -> bool:
    """Solve for the equations of the constraints; False: they are singular."""
    reduced, J, m, n = own.reduced, own.reduced.J, own.reduced.weight.shape[0], own.reduced.metric.shape[0]
    for row in range(m):
        for i in range(n):
            J[row, i] = own.terms.J[row, i]
            own.scratch.dtheta[i] = cj * (reduced.metric[i] * J[row, i])
        eqs.multiply_mass_matrix(own.scratch.dtheta, eqs.tangent, own.scratch.load)
        eqs.solve_tangent(own.scratch.load, eqs.tangent, reduced.X[row])
        eqs.solve_tangent(J[row], eqs.tangent, reduced.A[row])
    for row in range(m):
        for other in range(m):
            moved, mobile, compliance = 0.0, 0.0, 0.0
            for i in range(n):
                moved += J[row, i] * reduced.metric[i] * J[other, i]
                mobile += J[row, i] * reduced.X[other, i]
                compliance += J[row, i] * reduced.A[other, i]
            diagonal = 1.0 if row == other else 0.0
            reduced.inverse[row, other] = moved + diagonal * cj * reduced.d[1, row]
            reduced.inverse[row, m + other] = -diagonal * reduced.d[0, row]
            reduced.inverse[m + row, other] = -mobile - diagonal * reduced.d[1, row]
            reduced.inverse[m + row, m + other] = -compliance
    return invert(reduced.inverse, reduced.order, reduced.scratch)


@kernel
def apply_preconditioner(y: Reals, r: Reals, z: Reals, problem: Integration) -> None:
    """z (N,) <- the solution for the residual r, by the tangent as it was factored last."""
    eqs, own = problem.eqs, problem.work.own
    scratch, reduced, c, positions = own.scratch, own.reduced, own.reduced.c[0], own.positions
    nq, n, m = scratch.q.shape[0], scratch.v.shape[0], scratch.lam.shape[0]
    as_motion(y, r, positions, scratch.res_motion)
    eqs.multiply_mass_matrix(scratch.res_motion, eqs.tangent, scratch.load)
    for i in range(n):
        scratch.load[i] = r[nq + i] + c * scratch.load[i]
    eqs.solve_tangent(scratch.load, eqs.tangent, scratch.dtheta)
    for row in range(m):
        scratch.right[row], scratch.right[m + row] = r[nq + n + row] - c * r[nq + n + m + row], r[nq + n + m + row]
        for i in range(n):
            scratch.right[row] += reduced.J[row, i] * scratch.res_motion[i]
            scratch.right[m + row] -= reduced.J[row, i] * scratch.dtheta[i]
    for row in range(2 * m):
        scratch.multipliers[row] = 0.0
        for other in range(2 * m):
            scratch.multipliers[row] += reduced.inverse[row, other] * scratch.right[other]
    for row in range(m):
        z[nq + n + m + row], z[nq + n + row] = scratch.multipliers[row], scratch.multipliers[m + row]
        for i in range(n):
            scratch.dtheta[i] -= (
                reduced.X[row, i] * scratch.multipliers[row] + reduced.A[row, i] * scratch.multipliers[m + row]
            )
            scratch.res_motion[i] -= reduced.metric[i] * reduced.J[row, i] * scratch.multipliers[row]
    as_slope(y, scratch.dtheta, positions, z)
    for k in range(positions.turning.shape[0]):  # and the quaternions' length
        first, along = positions.turning[k, 0], 0.0
        for i in range(first, first + 4):
            along += y[i] * r[i] / (c + reduced.length_rate[0])
        for i in range(first, first + 4):
            z[i] += along * y[i]
    for i in range(n):
        z[nq + i] = c * scratch.dtheta[i] - scratch.res_motion[i]


@kernel
def record_energy(t: float, y: Reals, slopes: Reals, problem: Integration) -> None:
    """Record the energy after a step of IDA to (t, y, y'); see :mod:`solvers.energy_account`."""
    eqs, memory, scratch, done = problem.eqs, problem.memory, problem.work.own.scratch, 0.0
    record = memory.energy_record[0]
    copy_unknowns(y, slopes, scratch)
    if energy_check_scheduled(record):
        for row in range(scratch.lam.shape[0]):
            scratch.right[row] = 0.0
        eqs.inverse(t, scratch.q, scratch.v, scratch.zero, scratch.right, eqs.data, scratch.qdot, scratch.tau)
        update_energy_bound(eqs.evaluate_energy_bound, eqs.data, record, problem.scales)
    if memory.progress[0].works == 1:
        eqs.inverse(t, scratch.q, scratch.v, scratch.a, scratch.lam, eqs.data, scratch.qdot, scratch.tau)
        done = eqs.power(t, scratch.q, scratch.v, scratch.a, scratch.lam, eqs.data)
    record_step(memory.energy_record, t, done)


@kernel
def is_closed(t: float, y: Reals, problem: Integration) -> bool:
    """Whether the constraints can be satisfied next to the unknowns y (N,).

    IDA's regularization leaves a residual where drives contradict each other. Errors of the positions leave one too,
    which the projection removes.
    """
    eqs, work, own = problem.eqs, problem.work, problem.work.constraints
    for i in range(work.q.shape[0]):
        work.q[i] = y[i]
    for i in range(work.v.shape[0]):
        work.v[i] = y[work.q.shape[0] + i]
    eqs.position(t, work.q, eqs.data, own.terms)
    off = 0.0
    for row in range(own.row_size.shape[0]):
        off = max(off, abs(own.terms.Phi[row] / own.row_size[row]))
    if off <= max(RESIDUAL_TOLERANCE, problem.settings[0].motion_rtol):
        return True
    closed: bool = project_state(eqs, t, work.q, work.v, work.size, own) != NOT_CLOSED
    return closed


@kernel
def accept_step(t: float, y: Reals, slopes: Reals, problem: Integration) -> int:
    """Accept IDA's step to (t, y); return a code, NOT_CLOSED: constraints contradict each other there."""
    eqs, memory, work, progress = problem.eqs, problem.memory, problem.work, problem.memory.progress[0]
    memory.counts[STEPS] += 1.0
    progress.max_next_step, progress.t_reached = eqs.longest_load_step(progress.last_step, eqs.data), t
    if work.inertia[0].watched == 1:  # where Newton's last correction began
        eqs.inertia_parts(eqs.data, work.parts)
        update_tree_growth(t, work.parts, work.own.scratch.v, work)
    if work.constraints.row_size.shape[0] > 0 and not is_closed(t, y, problem):
        return NOT_CLOSED
    if progress.energy_check == 1:
        record_energy(t, y, slopes, problem)
    return OK

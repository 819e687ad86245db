"""Model exchange of small mechanisms by their matrices; functions over an instance are those of
:class:`.model_exchange.Formulation`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from solvers.compiled.kernel import inlined, kernel
from solvers.linalg.dense import solve_least_norm
from solvers.outcome import OK
from solvers.projection.branch import BRANCH_RESOLUTION, MAX_LINE_DISTANCE, on_same_branch
from solvers.projection.projection import (
    effective_rank,
    evaluate_acceleration,
    evaluate_multipliers,
    evaluate_regular_acceleration,
    project,
    solve_transposed_shortest,
)
from solvers.projection.singular import NO_CRITICAL_POINT, record_accepted
from solvers.projection.workspace import distance, evaluate_and_factor

from .derivatives import (
    CONSTRAINTS,
    MOTION,
    OUTPUTS,
    begin_direction,
    evaluate_complex,
    finish_direction,
    imaginary,
    set_point,
    step_solution,
    step_state,
)
from .exchange_memory import NOT_DIFFERENTIABLE, STATES_NOT_FINITE, fill_derivatives, unpack_states
from .load_derivatives import differentiate_loads

if TYPE_CHECKING:
    from mbfmu.mechanics.arrays.input_kernels import InputRecords
    from solvers.compiled.record import Reals
    from solvers.positions import Positions
    from solvers.projection.workspace import Workspace
    from solvers.system import Equations, Terms

    from .derivatives import Linearization
    from .exchange_memory import Exchange


@kernel
def copy_critical_point(source: Any, target: Any) -> None:
    """Copy what is known of the critical point between a workspace and a :class:`Branch`."""
    m, n = source.C.shape
    target.critical[0] = source.critical[0]
    for i in range(source.q_c.shape[0]):
        target.q_c[i] = source.q_c[i]
    for i in range(m):
        target.u[i], target.C_tau[i], target.C_pivots[i] = source.u[i], source.C_tau[i], source.C_pivots[i]
        for j in range(n):
            target.C[i, j] = source.C[i, j]


@kernel
def copy_branch(source: Any, target: Any) -> None:
    """The same, with the position that branches are compared with."""
    m, n = source.C.shape
    copy_critical_point(source, target)
    target.branch_history[0] = source.branch_history[0]
    for i in range(source.q_last.shape[0]):
        target.q_last[i] = source.q_last[i]
    for i in range(m):
        target.nu_last[i], target.frame_tau[i] = source.nu_last[i], source.frame_tau[i]
        target.frame_pivots[i] = source.frame_pivots[i]
        for j in range(n):
            target.frame[i, j], target.J_last[i, j] = source.frame[i, j], source.J_last[i, j]


@kernel
def project_states(exchange: Exchange, eqs: Any, t: float, rank: int, positions: Any, work: Any) -> int:
    """(work.q, work.v) = P(x), with its ``terms`` and factors; return a code."""
    if not unpack_states(exchange, work.q, work.v):
        return STATES_NOT_FINITE
    if positions.turning.shape[0] == 0 and eqs.terms.Phi.shape[0] == 0:
        evaluate_and_factor(eqs, t, work.q, work.v, work)
        return OK
    for i in range(work.dq.shape[0]):
        work.dq[i] = 0.0
    eqs.retract(work.q, work.dq, eqs.data)  # quaternions to unit length
    code: int = project(eqs, t, work.q, work.v, rank, work)
    return code


@inlined
def rate_of(k: int, work: Any) -> float:
    """|v_k| in units of the coordinate, 1/s; zero for no coordinate, -1."""
    rate: float = abs(work.v[k]) / work.size[k] if k >= 0 else 0.0
    return rate


@inlined
def find_fastest(rank: int, in_loops: Reals, work: Any) -> int:
    """The fastest coordinate of the loops in its units, which decides kappa; -1: none moves."""
    found, largest = -1, 0.0
    for i in range(work.v.shape[0] if rank > 0 else 0):
        if in_loops[i] * abs(work.v[i]) / work.size[i] > largest:
            found, largest = i, rate_of(i, work)
    return found


@kernel
def evaluate_projected(exchange: Exchange, eqs: Any, t: float, rank: int, positions: Any, work: Any) -> int:
    """Fill x' by matrices, and leave ``terms`` and factors at P(x) = (work.q, work.v); return a code."""
    code = project_states(exchange, eqs, t, rank, positions, work)
    if code == OK:
        code = evaluate_acceleration(eqs, t, work.q, work.v, rank, work, work.slope)
    if code == OK:
        fastest = find_fastest(rank, work.in_loops, work)
        attraction = rate_of(fastest, work)
        fill_derivatives(exchange, eqs.terms.qdot, work.slope, work.q, work.v, attraction, positions)
    return code


@kernel
def project_dense(instance: Any, t: float) -> int:
    """By matrices, as all of the following."""
    problem = instance.given
    rank = problem.memory.control[0].rank
    code: int = project_states(instance.exchange, problem.eqs, t, rank, instance.positions, problem.work)
    return code


@kernel
def evaluate_dense(instance: Any, t: float) -> int:
    """See :class:`.model_exchange.Formulation`."""
    problem = instance.given
    rank = problem.memory.control[0].rank
    code: int = evaluate_projected(instance.exchange, problem.eqs, t, rank, instance.positions, problem.work)
    return code


@kernel
def is_on_branch_dense(instance: Any, t: float) -> bool:
    """See :class:`.model_exchange.Formulation`; nothing is known of far positions before a step has been completed."""
    problem = instance.given
    rank, work = problem.memory.control[0].rank, problem.work
    if instance.exchange.counts[0] == 0 and distance(work.q_last, work.q, work) > MAX_LINE_DISTANCE:
        return True
    same: bool = on_same_branch(problem.eqs, t, problem.work.q, BRANCH_RESOLUTION, rank, problem.work)
    return same


@kernel
def record_position(instance: Any, t: float, taken: float) -> None:
    """Record P(x) as a position that later ones are compared with, a ``taken`` time (s) after the last one."""
    problem = instance.given
    record_accepted(problem.eqs, t, problem.work.q, taken, taken, problem.memory.control[0].rank, problem.work)


@kernel
def forget_branch(instance: Any) -> None:
    """Forget the position that branches are compared with."""
    work = instance.given.work
    work.branch_history[0].is_frame_known, work.branch_history[0].pivot_ratio = 0, 0.0
    work.critical[0].kind, work.critical[0].failed_search_ratio = NO_CRITICAL_POINT, 0.0


@inlined
def correct(residual: Any, rank: int, work: Workspace, motion: Reals) -> None:
    """motion (n,) -= J+ r, r (m,) the imaginary part of a complex residual."""
    for i in range(residual.shape[0]):
        work.b[i] = imaginary(residual[i]) / work.row[i]
    solve_least_norm(work.b, motion.shape[0], rank, work.A, work.tau, work.pivots, work.dq)
    for i in range(motion.shape[0]):
        motion[i] -= work.size[i] * work.dq[i]


@kernel
def correct_multipliers(
    inputs: InputRecords, positions: Positions, terms: Terms, rank: int, work: Workspace, own: Linearization
) -> None:
    """Add to dlam (m,) what changes because the space of the shortest multipliers moves, where rows are redundant.

    lam~ = A^+ f with A = J~^T in units of coordinates and rows, so that dlam~ also has (1 - A^+ A) dJ~ J~^+ lam~ (Golub
    and Pereyra 1973, The differentiation of pseudo-inverses, doi:10.1137/0710036).
    """
    (m, n), z = terms.J.shape, own.redundant
    for i in range(m):
        work.b[i] = own.lam[i] * work.row[i]
    solve_least_norm(work.b, n, rank, work.A, work.tau, work.pivots, work.dq)
    step_state(positions, own.positions, own.velocities, own)
    for sign in (1.0, -1.0):  # J w - nu less -nu
        for i in range(n):
            own.vc[i] = work.size[i] * work.dq[i] if sign > 0.0 else 0.0
        evaluate_complex(inputs, CONSTRAINTS, own)
        for i in range(m):
            z[i] = imaginary(own.rates[i]) / work.row[i] if sign > 0.0 else z[i] - imaginary(own.rates[i]) / work.row[i]
    for j in range(n):
        work.f[j] = 0.0
        for i in range(m):
            work.f[j] += work.size[j] * terms.J[i, j] * z[i] / work.row[i]
    solve_transposed_shortest(m, n, rank, work, work.b)  # A^+ A z
    for i in range(m):
        own.multipliers[i] += (z[i] - work.b[i]) / work.row[i]


@kernel
def differentiate_by_matrices(
    exchange: Exchange,
    inputs: InputRecords,
    positions: Positions,
    eqs: Equations,
    rank: int,
    work: Workspace,
    own: Linearization,
) -> int:
    """Fill the derivatives along the direction, by the matrices and factors of the point; return a code."""
    begin_direction(exchange, positions, own)
    differentiate_loads(inputs, eqs.data, own)
    if rank > 0:
        step_state(positions, own.positions, own.velocities, own)
        evaluate_complex(inputs, CONSTRAINTS, own)
        correct(own.gaps, rank, work, own.positions)
        step_state(positions, own.positions, own.velocities, own)
        evaluate_complex(inputs, CONSTRAINTS, own)
        correct(own.rates, rank, work, own.velocities)
    step_state(positions, own.positions, own.velocities, own)
    evaluate_complex(inputs, MOTION, own)
    terms = eqs.terms
    for i in range(own.loads.shape[0]):
        terms.h[i] = imaginary(own.tauc[i]) + own.loads[i]
    for i in range(own.residuals.shape[0]):
        terms.gamma[i] = -imaginary(own.residuals[i])
    code: int = evaluate_regular_acceleration(terms, rank, work, own.accelerations)
    if code == OK:
        evaluate_multipliers(terms, rank, work, own.accelerations, own.multipliers)
        if rank < own.multipliers.shape[0]:
            correct_multipliers(inputs, positions, terms, rank, work, own)
        step_solution(positions, own)
        evaluate_complex(inputs, OUTPUTS, own)
        finish_direction(exchange, positions, own)
    return code


@kernel
def linearize_dense(instance: Any, t: float, driving: int) -> int:
    """See :class:`.model_exchange.Formulation`."""
    problem, own = instance.given, instance.linearization
    rank, work = problem.memory.control[0].rank, problem.work
    code: int = evaluate_dense(instance, t)
    if code != OK:
        return code
    if effective_rank(problem.eqs, t, work.q, rank, work) < rank:
        return NOT_DIFFERENTIABLE
    evaluate_multipliers(problem.eqs.terms, rank, work, work.slope, own.lam)
    own.point[0].fastest = find_fastest(rank, work.in_loops, work)
    own.point[0].attraction = rate_of(own.point[0].fastest, work)
    set_point(t, driving, work.q, work.v, work.slope, own.lam, own)
    return OK


@kernel
def differentiate_dense(instance: Any) -> int:
    """See :class:`.model_exchange.Formulation`."""
    problem = instance.given
    given = instance.exchange, instance.inputs, instance.positions, problem.eqs, problem.memory.control[0].rank
    code: int = differentiate_by_matrices(*given, problem.work, instance.linearization)
    return code

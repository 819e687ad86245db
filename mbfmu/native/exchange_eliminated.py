"""Model exchange of large mechanisms with loops, whose constraints are eliminated along their structure.

Functions over an instance are those of :class:`.model_exchange.Formulation`. P(x) is on another branch if its
projection changes the velocity: then x has the velocity of the branch that was left.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.elimination.right_sides import solve_motion, subtract_shortest
from solvers.compiled.kernel import kernel
from solvers.outcome import NO_MASS, OK
from solvers.projection.eliminated import CLOSED_RESIDUAL, REDUNDANT_LENGTH, SINGULAR_LENGTH, project
from solvers.projection.eliminated_crossing import evaluate_closed, record_accepted, stays_on_branch

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
from .exchange_dense import find_fastest, rate_of
from .exchange_memory import NOT_DIFFERENTIABLE, STATES_NOT_FINITE, fill_derivatives, unpack_states
from .load_derivatives import differentiate_loads

if TYPE_CHECKING:
    from solvers.compiled.record import Reals

    from .derivatives import Complex


@kernel
def copy_branch(source: Any, target: Any) -> None:
    """Copy what is known of the branch between the scratch of the solver and an :class:`EliminatedBranch`."""
    target.near[0] = source.near[0]
    for i in range(source.q_c.shape[0]):
        target.q_c[i] = source.q_c[i]


@kernel
def record_position(instance: Any, t: float, taken: float) -> None:
    """See :func:`.exchange_branches.comparisons`: the shortest equation is evaluated there."""
    eqs, work = instance.eqs, instance.work
    if evaluate_closed(eqs, t, work.q, work.v, False, work, work.qdot, work.a, work.lam) == OK:
        record_accepted(eqs, t, work.q, work.v, work.a, taken, taken, work)


@kernel
def project_eliminated(instance: Any, t: float) -> int:
    """See :class:`.model_exchange.Formulation`."""
    eqs, work = instance.eqs, instance.work
    if not unpack_states(instance.exchange, work.q, work.v):
        return STATES_NOT_FINITE
    eqs.retract(work.q, work.zero, eqs.data)  # quaternions to unit length
    code: int = project(eqs, t, work.q, work.v, CLOSED_RESIDUAL, work)
    return code


@kernel
def evaluate_with(instance: Any, t: float, loaded: bool) -> int:
    """As :func:`evaluate_eliminated`, with the multipliers if ``loaded``."""
    eqs, work = instance.eqs, instance.work
    code: int = project_eliminated(instance, t)
    if code == OK:
        code = evaluate_closed(eqs, t, work.q, work.v, loaded, work, work.qdot, work.a, work.lam)
    if code == OK:
        attraction = rate_of(find_fastest(work.near[0].rank, eqs.in_loops, work), work)
        fill_derivatives(instance.exchange, work.qdot, work.a, work.q, work.v, attraction, instance.positions)
    return code


@kernel
def evaluate_eliminated(instance: Any, t: float) -> int:
    """See :class:`.model_exchange.Formulation`."""
    return int(evaluate_with(instance, t, False))


@kernel
def is_on_branch_eliminated(instance: Any, t: float) -> bool:
    """See :class:`.model_exchange.Formulation`."""
    same: bool = stays_on_branch(instance.work)
    return same


@kernel
def linearize_eliminated(instance: Any, t: float, driving: int) -> int:
    """See :class:`.model_exchange.Formulation`."""
    work, own = instance.work, instance.linearization
    code: int = evaluate_with(instance, t, True)
    if code != OK:
        return code
    if work.near[0].shortest < SINGULAR_LENGTH:
        return NOT_DIFFERENTIABLE
    own.point[0].fastest = find_fastest(work.near[0].rank, instance.eqs.in_loops, work)
    own.point[0].attraction = rate_of(own.point[0].fastest, work)
    set_point(t, driving, work.q, work.v, work.a, work.lam, own)
    return OK


@kernel
def correct(residual: Complex, eqs: Any, scratch: Reals, work: Any, motion: Reals) -> None:
    """motion (n,) -= J+ r, r (m,) the imaginary part of a complex residual."""
    for i in range(residual.shape[0]):
        scratch[i] = imaginary(residual[i])
    subtract_shortest(eqs.elimination, scratch, REDUNDANT_LENGTH, work.change, work.report)
    for i in range(motion.shape[0]):
        motion[i] += work.change[i]


@kernel
def differentiate_eliminated(instance: Any) -> int:
    """See :class:`.model_exchange.Formulation`; inertia and equations are those of the point."""
    exchange, inputs, positions, own = instance.exchange, instance.inputs, instance.positions, instance.linearization
    eqs, work, r = instance.eqs, instance.work, own.redundant
    begin_direction(exchange, positions, own)
    differentiate_loads(inputs, eqs.data, own)
    step_state(positions, own.positions, own.velocities, own)
    evaluate_complex(inputs, CONSTRAINTS, own)
    correct(own.gaps, eqs, r, work, own.positions)
    step_state(positions, own.positions, own.velocities, own)
    evaluate_complex(inputs, CONSTRAINTS, own)
    correct(own.rates, eqs, r, work, own.velocities)
    step_state(positions, own.positions, own.velocities, own)
    evaluate_complex(inputs, MOTION, own)
    for i in range(own.loads.shape[0]):
        own.loads[i] += imaginary(own.tauc[i])
    for i in range(r.shape[0]):
        r[i] = imaginary(own.residuals[i])
    solution = own.accelerations, own.multipliers
    if not solve_motion(eqs.elimination, own.loads, r, REDUNDANT_LENGTH, *solution, work.report):
        return NO_MASS
    step_solution(positions, own)
    evaluate_complex(inputs, OUTPUTS, own)
    finish_direction(exchange, positions, own)
    return OK

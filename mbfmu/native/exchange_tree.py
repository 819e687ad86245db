"""Model exchange of large trees by recursions: there is one branch of the motion."""

from __future__ import annotations

from typing import Any

from mbfmu.mechanics.recursions.aba import apply_inverse_mass_matrix
from solvers.compiled.kernel import kernel
from solvers.outcome import OK
from solvers.steppers.adams.tree_loop import evaluate_forward_dynamics

from .derivatives import (
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
from .exchange_memory import STATES_NOT_FINITE, fill_derivatives, unpack_states
from .load_derivatives import differentiate_loads


@kernel
def project_tree(instance: Any, t: float) -> int:
    """By recursions, as all of the following: there are quaternions only."""
    problem = instance.given
    if not unpack_states(instance.exchange, problem.work.q, problem.work.v):
        return STATES_NOT_FINITE
    problem.eqs.retract(problem.work.q, problem.work.zero, problem.eqs.data)
    return OK


@kernel
def evaluate_tree(instance: Any, t: float) -> int:
    """See :class:`.model_exchange.Formulation`."""
    problem, work = instance.given, instance.given.work
    code: int = project_tree(instance, t)
    if code == OK:
        code = evaluate_forward_dynamics(problem.eqs, t, work.q, work.v, work.qdot, work.a)
    if code == OK:
        fill_derivatives(instance.exchange, work.qdot, work.a, work.q, work.v, 0.0, instance.positions)
    return code


@kernel
def is_on_branch_tree(instance: Any, t: float) -> bool:
    """There is one branch."""
    return True


@kernel
def unchanged_at_tree(instance: Any, t: float) -> None:
    """There is one branch."""


@kernel
def unchanged_tree(instance: Any) -> None:
    """There is one branch, and evaluations change nothing."""


@kernel
def linearize_tree(instance: Any, t: float, driving: int) -> int:
    """See :class:`.model_exchange.Formulation`."""
    work, own = instance.given.work, instance.linearization
    code: int = evaluate_tree(instance, t)
    if code == OK:
        own.point[0].fastest, own.point[0].attraction = -1, 0.0
        set_point(t, driving, work.q, work.v, work.a, own.lam, own)
    return code


@kernel
def differentiate_tree(instance: Any) -> int:
    """See :class:`.model_exchange.Formulation`; the articulated inertias are those of the point."""
    exchange, inputs, positions, own = instance.exchange, instance.inputs, instance.positions, instance.linearization
    data = instance.given.eqs.data
    begin_direction(exchange, positions, own)
    differentiate_loads(inputs, data, own)
    step_state(positions, own.positions, own.velocities, own)
    evaluate_complex(inputs, MOTION, own)
    for i in range(own.loads.shape[0]):
        own.loads[i] = -imaginary(own.tauc[i]) - own.loads[i]
    apply_inverse_mass_matrix(data.arrays, data.state, own.loads, own.accelerations)
    step_solution(positions, own)
    evaluate_complex(inputs, OUTPUTS, own)
    finish_direction(exchange, positions, own)
    return OK

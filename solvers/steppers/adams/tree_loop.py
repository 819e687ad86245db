"""Adams PECE by recursions on a large tree, as the formulation of :mod:`.pece`.

State y = (q, v), y' by the articulated-body recursion; there is nothing to close. Quaternions are brought back to unit
length after each step, by a change of the size of the tolerance.

Explicit steps are bounded by stability: on a mesh the fastest mode turns some thousand times while the
slowest moves. The error control keeps the step there, because an unstable step fails its test;
:attr:`solvers.options.Statistics.stability_limited` is their number.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.record import f8, i8
from solvers.energy_account import energy_check_scheduled, update_energy_bound
from solvers.inertia import clear_growth, tolerance_factor, update_tree_growth
from solvers.outcome import NO_MASS, NOT_FINITE, OK
from solvers.positions import count_velocities, position_sizes, set_coordinate_rates
from solvers.resolution import start_rate
from solvers.steppers.step_loop import StepSettingsRecord
from solvers.steppers.tree import RATE_TOLERANCE_RATIO

from .formulas import pack_state, set_tolerance_units, unpack_state
from .pece import make_pece_loop

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.steppers.step_loop import Integration
    from solvers.system import TreeEquations


class SettingsRecord(StepSettingsRecord):
    """Options of Adams on trees."""

    max_order: i8
    rate: f8  # of the motion, 1/s


SETTINGS = SettingsRecord.dtype


@inlined
def evaluate_forward_dynamics(eqs: TreeEquations, t: float, q: Reals, v: Reals, qdot: Reals, a: Reals) -> int:
    """qdot (nq,) = N v and a (n,) = v' at (t, q, v)."""
    if eqs.forward(t, q, v, eqs.data, qdot, a) != 0:
        return NO_MASS
    for i in range(a.shape[0]):
        if not np.isfinite(a[i]):
            return NOT_FINITE
    return OK


@kernel
def begin(integration: Any) -> int:
    """Make y the state under evaluation."""
    unpack_state(integration.memory.y, integration.work.q, integration.work.v)
    return OK


@inlined
def motion_rate(integration: Any) -> float:
    """Rate of the motion, 1/s."""
    return integration.settings[0].rate


@inlined
def evaluate_derivative(integration: Integration, t: float, closing: bool) -> int:
    """y' in ``history.yp`` at (work.q, work.v), whose quaternions become of unit length if ``closing``."""
    eqs, work, history = integration.eqs, integration.work, integration.memory
    if closing:
        eqs.retract(work.q, work.zero, eqs.data)
    history.control[0].evaluations += 1
    code = evaluate_forward_dynamics(eqs, t, work.q, work.v, work.qdot, work.a)
    if code == OK:
        pack_state(work.qdot, work.a, history.yp)
    return code


@inlined
def set_error_weights(integration: Integration) -> None:
    """Error weights at y, such that in meshes the norm is a root mean square: they have many coordinates of a kind."""
    history, work, settings = integration.memory, integration.work, integration.settings[0]
    size = history.y.shape[0] - 1
    scale = tolerance_factor(settings.rtol, 1.0, work) if work.inertia[0].watched == 1 else np.sqrt(1.0 * size)
    for i in range(size):
        history.weight[i] = 1.0 / (scale * (settings.rtol * abs(history.y[i]) + settings.atol * history.unit[i]))


@inlined
def evaluate_power(integration: Integration, t: float) -> float:
    """W' at the state evaluated last."""
    eqs, work = integration.eqs, integration.work
    return eqs.power(t, work.q, work.v, work.a, work.lam, eqs.data) if integration.settings[0].works == 1 else 0.0


@kernel
def record_energy(integration: Integration, t: float) -> None:
    """Record the energy at (work.q, work.v); this costs an inverse dynamics (`solvers.energy_account`)."""
    eqs, work, control = integration.eqs, integration.work, integration.memory.control[0]
    if integration.settings[0].energy_check == 1 and energy_check_scheduled(control):
        eqs.inverse(t, work.q, work.v, work.zero, work.lam, eqs.data, work.qdot, work.a)
        update_energy_bound(eqs.evaluate_energy_bound, eqs.data, control, integration.scales)
    if work.inertia[0].watched == 1:
        eqs.inertia_parts(eqs.data, work.parts)
        update_tree_growth(t, work.parts, work.v, work)


@inlined
def accept_branch(integration: Any, t: float) -> bool:
    """There is one branch."""
    return True


@inlined
def respond_to_cuts(integration: Any, cuts: int) -> None:
    """There is no other formulation."""


@inlined
def may_end_at(integration: Any, target: float) -> bool:
    """There is no singular configuration."""
    return True


@inlined
def end_step(integration: Any) -> None:
    """There is nothing to record."""


@inlined
def close(integration: Integration, t: float, q: Reals, v: Reals) -> int:
    """Bring the quaternions of an interpolated state to unit length."""
    if t < integration.memory.control[0].t:
        integration.eqs.retract(q, integration.work.zero, integration.eqs.data)
    return OK


@kernel
def set_up(integration: Integration, t: float, known: float, duration: float) -> None:
    """Find units and the rate of the motion at the reported state, of time t (s); ``known`` (1/s) is what is known of
    the rate beforehand, ``duration`` (s) that of the run.
    """
    settings, history, scratch = integration.settings[0], integration.memory, integration.work
    if known > 0.0:
        settings.rate = start_rate(known, duration, scratch.size, integration.v[:0], scratch.a[:0])
    else:
        if evaluate(integration, t, scratch.a) != OK:
            for k in range(scratch.a.shape[0]):
                scratch.a[k] = 0.0
        moving = count_velocities(scratch.positions, integration.v.shape[0])
        settings.rate = start_rate(known, duration, scratch.size, integration.v[:moving], scratch.a)
    position_sizes(scratch.positions, scratch.size, scratch.size_q)
    set_coordinate_rates(scratch.positions, RATE_TOLERANCE_RATIO * settings.rate, scratch.coordinate_rates)
    integration.scales.mean_count[0] = 1 if scratch.inertia[0].watched == 1 else history.y.shape[0] - 1
    set_tolerance_units(history, settings.atol, scratch, integration.scales)
    clear_growth(scratch)


@kernel
def evaluate(integration: Integration, t: float, a: Reals) -> int:
    """Accelerations a (n,) at the reported state, of time t (s)."""
    return evaluate_forward_dynamics(integration.eqs, t, integration.q, integration.v, integration.work.qdot, a)


advance, advance_reported = make_pece_loop(
    __name__,
    begin=begin,
    motion_rate=motion_rate,
    set_error_weights=set_error_weights,
    evaluate_derivative=evaluate_derivative,
    evaluate_power=evaluate_power,
    record_energy=record_energy,
    accept_branch=accept_branch,
    respond_to_cuts=respond_to_cuts,
    may_end_at=may_end_at,
    close=close,
    end_step=end_step,
)

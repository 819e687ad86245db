"""Adams-Bashforth-Moulton formulas of variable order and step in modified divided differences.

The arithmetic of subroutine STEP of Shampine and Gordon, *Computer Solution of Ordinary Differential
Equations* (1975), chapter 10: PECE with local extrapolation, orders 1 to 12. Names are theirs. Indices count
from 1 as in the book; row and entry 0 of every array is unused. What is left out is the propagated-rounding
switch ``nornd``, of use below relative tolerances of 1e-12 only, and the wrapper's stiffness test, which counts
steps of low order and misses oscillations; :func:`.order_control.count_stability_limited` is ours.

The tolerance sits in the weights: a step is good where ||e * weight||_2 <= 1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import inlined, kernel, records
from solvers.energy_account import (
    ACCOUNT_FIELDS,
    WORK_ERROR_SAFETY,
    add_energy_error_bound,
    reset_check_schedule,
    set_energy_scales,
)
from solvers.steppers.step_control import FIRST_STEP_RATIO
from solvers.system import Array

from .order_control import GAMMA_STAR, choose_order, choose_step, count_stability_limited

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.energy_account import EnergyScales
    from solvers.projection.workspace import Workspace

MAX_ORDER = 12
N_DIFFERENCES = MAX_ORDER + 3  # entries of the arrays that are indexed by the order
CONTROL = np.dtype(
    [
        ("t", "f8"), ("h", "f8"), ("hold", "f8"),  # time reached, next step, last step
        ("k", "i8"), ("kold", "i8"), ("ns", "i8"),  # next order, last order, steps taken with h
        ("phase1", "i8"), ("start", "i8"),  # still doubling and raising; history to be built from y
        ("rk_steps", "i8"), ("rk_step_size", "f8"),  # Runge-Kutta steps yet to take, and how long accuracy lets them be
        ("needs_derivative", "i8"), ("is_projected", "i8"),  # y' at y is to be evaluated again; a step has ended at y
        ("knew", "i8"), ("erk", "f8"), ("erkm1", "f8"), ("erkm2", "f8"),  # order and error estimates of this step
        ("psi", "f8", N_DIFFERENCES),  # sums of steps, s
        ("alpha", "f8", N_DIFFERENCES), ("beta", "f8", N_DIFFERENCES), ("sig", "f8", N_DIFFERENCES),
        ("v", "f8", N_DIFFERENCES), ("w", "f8", N_DIFFERENCES),
        ("g", "f8", N_DIFFERENCES),  # coefficients of the predictor
        ("g_out", "f8", N_DIFFERENCES), ("w_out", "f8", N_DIFFERENCES),  # of the interpolation
        ("rank", "i8"), ("regime", "i8"),  # of J; which partition
        ("limited_streak", "i8"),  # steps near the bound of stability, less the others
        ("stability_limited", "i8"),  # steps whose length stability has set
        ("steps", "i8"), ("rejected", "i8"), ("evaluations", "i8"), ("starts", "i8"),
        ("h_before", "f8"), ("equal_steps", "i8"), ("changes", "i8"), ("changed_at", "i8"), ("flickers", "i8"),  # LU
        ("lu_ready_steps", "i8"),  # hybrid: projection steps in a row in which LU would have kept its choice
        ("last_energy", "f8"), ("energy_scale", "f8"),  # hybrid: J; largest kinetic energy so far, J
        ("by_turn", "i8"), ("by_flicker", "i8"), ("by_energy", "i8"), ("by_collapse", "i8"), ("returns", "i8"),
        ("time_lu", "f8"), ("time_projection", "f8"),
        ("is_det_positive", "i8"), ("min_pivot", "f8"),  # LU: det J_d at y is positive; its smallest pivot
        ("refused", "i8"),  # steps that might have jumped to another branch
        ("near_miss_factor", "f8"),  # tolerance of this step in units of the requested one
        ("max_near_miss_factor", "f8"),  # the largest so far
        ("min_gap", "f8"),  # gap of the loop that required it
        ("undetermined", "i8"), ("undetermined_at", "f8"),  # 1: requested forces were not resolved, and the last time
        *ACCOUNT_FIELDS,
    ],
    align=True,
)  # fmt: skip


class History(NamedTuple):
    """All an integration remembers; copying these arrays copies the integration. ``size`` is nq + n + 1.

    The last component is the work W: it carries no weight, and its W' is taken where a step ends.
    """

    control: NDArray[Any]  # (1,)          record of CONTROL
    y: Array  # (size,)       state (q, v, W) at control.t
    phi: Array  # (size, N_DIFFERENCES)  modified divided differences of y'
    unit: Array  # (size,)       what the absolute tolerance of y is measured in
    weight: Array  # (size,)       1 / (rtol |y| + atol unit), 0 where the error is not controlled
    p: Array  # (size,)       predicted state
    yp: Array  # (size,)       y' last evaluated
    trial: Array  # (size,)       corrected state before it is accepted
    yp_p: Array  # (size,)       y' at the predicted state
    rows: NDArray[np.int64]  # (m,)          chosen constraints, int64
    columns: NDArray[np.int64]  # (n,)          chosen dependents, then independents, int64
    tangents: Array  # (n, n)        allowed motions at y with the chosen independents; (0, 0) where m is zero

    @staticmethod
    def allocate(nq: int, n: int, m: int) -> History:
        """Return a zeroed history for ``nq`` positions, ``n`` velocities and ``m`` constraints."""
        size = nq + n + 1
        y, weight, p, yp, trial, yp_p = (np.zeros(size) for _ in range(6))
        phi, unit = np.zeros((size, N_DIFFERENCES)), np.ones(size)
        choice = np.arange(m), np.arange(n)
        control = records(1, CONTROL)
        return History(control, y, phi, unit, weight, p, yp, trial, yp_p, *choice, np.zeros((n, n) if m else (0, 0)))


@inlined
def weighted_norm(x: Reals, weight: Reals) -> float:
    """||x * weight||_2."""
    total = 0.0
    for i in range(x.shape[0]):
        total += (x[i] * weight[i]) ** 2
    return np.sqrt(total)


@inlined
def unpack_state(y: Reals, q: Reals, v: Reals) -> None:
    """(q, v) <- y."""
    nq = q.shape[0]
    for i in range(nq):
        q[i] = y[i]
    for i in range(v.shape[0]):
        v[i] = y[nq + i]


@inlined
def pack_state(q: Reals, v: Reals, y: Reals) -> None:
    """y <- (q, v)."""
    nq = q.shape[0]
    for i in range(nq):
        y[i] = q[i]
    for i in range(v.shape[0]):
        y[nq + i] = v[i]


@kernel
def restart_history(
    history: History, t: float, q: Reals, v: Reals, work: float, truncated_steps: int, keeps_position: bool
) -> None:
    """Begin the next step at a reported state, see :class:`solvers.steppers.compiled_loop.MethodKernels`.

    Truncated steps are of one-step formulas, which need no history but the derivative there.
    """
    control = history.control[0]
    control.is_projected = control.is_projected if keeps_position and control.t == t else 0
    control.t, control.start, control.rk_steps = t, 1, truncated_steps
    control.needs_derivative = 1 if truncated_steps > 0 else 0
    reset_check_schedule(history.control)
    pack_state(q, v, history.y)
    history.y[history.y.shape[0] - 1] = work


@kernel
def set_tolerance_units(history: History, absolute: float, work: Workspace, scales: EnergyScales) -> None:
    """Take what the absolute tolerance is measured in, by the units and paces in ``work``."""
    nq, n = work.size_q.shape[0], work.size.shape[0]
    for i in range(nq):
        history.unit[i] = work.size_q[i]
    for i in range(n):
        history.unit[nq + i] = work.coordinate_rates[i] * work.size[i]
    history.unit[nq + n] = 1.0
    set_energy_scales(scales, absolute, work.size, work.coordinate_rates)


@inlined
def start_history(control: Any, history: History, max_step: float, rate: float) -> None:
    """History of order 1 from y' = ``history.yp`` at ``control.t``; ``rate`` (1/s) times y' stands for y''."""
    for i in range(history.y.shape[0]):
        for j in range(N_DIFFERENCES):
            history.phi[i, j] = 0.0
        history.phi[i, 1] = history.yp[i]
    slope = weighted_norm(history.yp, history.weight)
    control.h = min(max_step, FIRST_STEP_RATIO / rate)  # a body at rest gives no bound by its slope
    if 16.0 * slope * rate * control.h * control.h > 1.0:
        control.h = 0.25 * np.sqrt(1.0 / (slope * rate))
    control.h = max(control.h, 4.0 * 2.3e-16 * abs(control.t))
    control.hold = 0.0
    control.k, control.kold, control.ns, control.phase1, control.start, control.is_projected = 1, 0, 0, 1, 0, 0


@inlined
def update_coefficients(control: Any) -> None:
    """Block 1 of STEP: coefficients for step ``control.h`` at order ``control.k``; unchanged ones are kept."""
    k, h, psi, alpha, beta, sig = control.k, control.h, control.psi, control.alpha, control.beta, control.sig
    if h != control.hold:
        control.ns = 0
    if control.ns <= control.kold:
        control.ns += 1
    ns = control.ns
    if k < ns:
        return
    control.g[1], control.g[2], sig[1] = 1.0, 0.5, 1.0
    beta[ns], alpha[ns], sig[ns + 1] = 1.0, 1.0 / ns, 1.0
    total = h * ns
    for i in range(ns + 1, k + 1):
        before = psi[i - 1]
        psi[i - 1] = total
        beta[i] = beta[i - 1] * total / before
        total = before + h
        alpha[i] = h / total
        sig[i + 1] = i * alpha[i] * sig[i]
    psi[k] = total
    update_predictor_coefficients(control)


@inlined
def update_predictor_coefficients(control: Any) -> None:
    """The g of block 1: integrals of the divided-difference basis, by recurrence over v and w."""
    k, ns, alpha, v, w, g = control.k, control.ns, control.alpha, control.v, control.w, control.g
    if ns <= 1:
        for iq in range(1, k + 1):
            v[iq] = 1.0 / (iq * (iq + 1))
            w[iq] = v[iq]
    else:
        if k > control.kold:
            v[k] = 1.0 / (k * (k + 1))
            for j in range(1, ns - 1):
                v[k - j] -= alpha[j + 1] * v[k - j + 1]
        for iq in range(1, k + 2 - ns):
            v[iq] -= alpha[ns] * v[iq + 1]
            w[iq] = v[iq]
        g[ns + 1] = w[1]
    for i in range(ns + 2, k + 2):
        for iq in range(1, k + 3 - i):
            w[iq] -= alpha[i - 1] * w[iq + 1]
        g[i] = w[1]


@inlined
def predict(control: Any, history: History) -> None:
    """Block 2, first half: the predicted state ``history.p`` and differences as of t + h without the new y'."""
    k, ns, h, phi = control.k, control.ns, control.h, history.phi
    for i in range(history.y.shape[0]):
        for j in range(ns + 1, k + 1):
            phi[i, j] *= control.beta[j]
        phi[i, k + 2] = phi[i, k + 1]
        phi[i, k + 1] = 0.0
        total, above = 0.0, 0.0
        for j in range(k, 0, -1):
            total += control.g[j] * phi[i, j]
            above += phi[i, j]
            phi[i, j] = above
        history.p[i] = history.y[i] + h * total


@inlined
def estimate_errors(control: Any, history: History) -> float:
    """Block 2, second half: return the weighted error at order k; note those of orders k, k-1, k-2 and the
    next order.
    """
    k, h, sig = control.k, control.h, control.sig
    two_below, one_below, here = 0.0, 0.0, 0.0
    for i in range(history.y.shape[0]):
        difference, weight = history.yp[i] - history.phi[i, 1], history.weight[i]
        if k > 2:
            two_below += ((history.phi[i, k - 1] + difference) * weight) ** 2
        if k > 1:
            one_below += ((history.phi[i, k] + difference) * weight) ** 2
        here += (difference * weight) ** 2
    scaled = h * np.sqrt(here)
    control.erk = scaled * sig[k + 1] * GAMMA_STAR[k]
    control.knew = k
    if k > 1:
        control.erkm1 = h * sig[k] * GAMMA_STAR[k - 1] * np.sqrt(one_below)
        if k == 2 and control.erkm1 <= 0.5 * control.erk:
            control.knew = 1
    if k > 2:
        control.erkm2 = h * sig[k - 1] * GAMMA_STAR[k - 2] * np.sqrt(two_below)
        if max(control.erkm1, control.erkm2) <= control.erk:
            control.knew = k - 1
    return scaled * (control.g[k] - control.g[k + 1])


@inlined
def undo_prediction(control: Any, history: History) -> None:
    """Block 3, first half: take :func:`predict` and :func:`update_coefficients` back after a failed step."""
    control.phase1 = 0
    for i in range(history.y.shape[0]):
        for j in range(1, control.k + 1):
            history.phi[i, j] = (history.phi[i, j] - history.phi[i, j + 1]) / control.beta[j]
    for j in range(2, control.k + 1):
        control.psi[j - 1] = control.psi[j] - control.h


@inlined
def correct_state(control: Any, history: History) -> None:
    """Block 4: the corrected state, one order higher, in ``history.trial``."""
    factor = control.h * control.g[control.k + 1]
    for i in range(history.y.shape[0]):
        history.trial[i] = history.p[i] + factor * (history.yp[i] - history.phi[i, 1])
        history.yp_p[i] = history.yp[i]


@inlined
def correct_work(control: Any, history: History, power: float) -> None:
    """The corrected work from W' where the step ends, after :func:`correct_state`."""
    last = history.y.shape[0] - 1
    history.yp[last] = power
    history.trial[last] = history.p[last] + control.h * control.g[control.k + 1] * (power - history.phi[last, 1])


@inlined
def record_step_energy(control: Any, history: History) -> None:
    """Record the work of a step, its error, and the bound of the energy error; see :mod:`solvers.energy_account`."""
    last = history.y.shape[0] - 1
    control.work_total_variation += abs(history.trial[last] - history.y[last])
    part = control.g[control.k] - control.g[control.k + 1]
    if (
        control.corner_rejections > 0.0
    ):  # the difference of two orders is small, though the power is wrong by its correction
        part = max(part, 1.0 / WORK_ERROR_SAFETY)
    add_energy_error_bound(control, control.h * part * (history.yp[last] - history.phi[last, 1]), control.h)


@inlined
def accept_adams_step(control: Any, history: History, max_order: int, max_step: float) -> None:
    """Rest of block 4: take over ``history.trial`` and its y' = ``history.yp``; choose the next order and step."""
    k, phi = control.k, history.phi
    count_stability_limited(control, history)
    record_step_energy(control, history)
    control.t += control.h
    control.kold, control.hold = k, control.h
    for i in range(history.y.shape[0]):
        history.y[i] = history.trial[i]
        difference = history.yp[i] - phi[i, 1]
        phi[i, k + 1] = difference
        phi[i, k + 2] = difference - phi[i, k + 2]
        for j in range(1, k + 1):
            phi[i, j] += difference
    choose_order(control, history, max_order)
    choose_step(control, max_step)


@inlined
def interpolate(control: Any, history: History, t: float, y: Reals) -> None:
    """State at t in the last step, in ``y`` (size,): subroutine INTRP."""
    hi, g, w = t - control.t, control.g_out, control.w_out
    last = control.kold + 1
    for i in range(1, last + 1):
        w[i] = 1.0 / i
    g[1] = 1.0
    term = 0.0
    for j in range(2, last + 1):
        before = control.psi[j - 1]
        gamma, eta = (hi + term) / before, hi / before
        for i in range(1, last + 2 - j):
            w[i] = gamma * w[i] - eta * w[i + 1]
        g[j] = w[1]
        term = before
    for i in range(y.shape[0]):
        total = 0.0
        for j in range(last, 0, -1):
            total += g[j] * history.phi[i, j]
        y[i] = history.y[i] + hi * total

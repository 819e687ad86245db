"""Adams-Bashforth-Moulton formulas of variable order and step in modified divided differences.

The arithmetic of subroutine STEP of Shampine and Gordon, *Computer Solution of Ordinary Differential
Equations* (1975), chapter 10: PECE with local extrapolation, orders 1 to 12. Names are theirs. Indices count
from 1 as in the book; row and entry 0 of every array is unused. What is left out is the propagated-rounding
switch ``nornd``, of use below relative tolerances of 1e-12 only, and the wrapper's stiffness test, which counts
steps of low order and misses oscillations; :func:`watch_stability` is ours.

The tolerance sits in the weights: a step is good where ||e * weight||_2 <= 1.
"""

from __future__ import annotations

from typing import Any, NamedTuple

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

MAX_ORDER = 12
N_DIFFERENCES = MAX_ORDER + 3  # entries of the arrays that are indexed by the order
STABILITY_BOUND, STABILITY_STEPS = 0.25, 50  # see watch_stability
GAMMA_STAR = np.array(
    [1.0, 0.5, 0.0833, 0.0417, 0.0264, 0.0188, 0.0143, 0.0114, 0.00936, 0.00789, 0.00679, 0.00592, 0.00524, 0.00468]
)  # |coefficient| of the error of the fixed-step formulas, gstr of STEP

CONTROL = np.dtype(
    [
        ("t", "f8"), ("h", "f8"), ("hold", "f8"),  # time reached, next step, last step
        ("k", "i8"), ("kold", "i8"), ("ns", "i8"),  # next order, last order, steps taken with h
        ("phase1", "i8"), ("start", "i8"),  # still doubling and raising; history to be built from y
        ("singles", "i8"), ("single", "f8"),  # steps without history yet to take, and how long accuracy lets them be
        ("renew", "i8"), ("placed", "i8"),  # y' at y is to be evaluated again; such a step has ended at y
        ("knew", "i8"), ("erk", "f8"), ("erkm1", "f8"), ("erkm2", "f8"),  # order and error estimates of this step
        ("psi", "f8", N_DIFFERENCES),  # sums of steps, s
        ("alpha", "f8", N_DIFFERENCES), ("beta", "f8", N_DIFFERENCES), ("sig", "f8", N_DIFFERENCES),
        ("v", "f8", N_DIFFERENCES), ("w", "f8", N_DIFFERENCES),
        ("g", "f8", N_DIFFERENCES),  # coefficients of the predictor
        ("g_out", "f8", N_DIFFERENCES), ("w_out", "f8", N_DIFFERENCES),  # of the interpolation
        ("rank", "i8"), ("regime", "i8"),  # of J; which partition
        ("long", "i8"), ("limited", "i8"),  # near the bound of stability: steps more than others; steps it set
        ("steps", "i8"), ("rejected", "i8"), ("evaluations", "i8"), ("starts", "i8"),
        ("h_before", "f8"), ("equal", "i8"), ("changes", "i8"), ("changed_at", "i8"), ("flickers", "i8"),  # LU choice
        ("calm", "i8"), ("energy", "f8"), ("kinetic", "f8"),  # hybrid: steps fit for LU, J, largest kinetic energy
        ("by_turn", "i8"), ("by_flicker", "i8"), ("by_energy", "i8"), ("by_collapse", "i8"), ("returns", "i8"),
        ("time_lu", "f8"), ("time_projection", "f8"),
        ("positive", "i8"), ("pivot", "f8"),  # LU: det J_d at y is positive; its smallest pivot
        ("refused", "i8"),  # steps that might have jumped to another branch
        ("coarser", "f8"), ("coarsest", "f8"),  # tolerance of this step in units of the requested one, and its largest
        ("narrowest", "f8"),  # the gap that made it so
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
    phi: Array  # (size, ROWS)  modified divided differences of y'
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
def weighted_norm(x: Any, weight: Any) -> float:
    """||x * weight||_2."""
    total = 0.0
    for i in range(x.shape[0]):
        total += (x[i] * weight[i]) ** 2
    return np.sqrt(total)


@inlined
def split(y: Any, q: Any, v: Any) -> None:
    """(q, v) <- y."""
    nq = q.shape[0]
    for i in range(nq):
        q[i] = y[i]
    for i in range(v.shape[0]):
        v[i] = y[nq + i]


@inlined
def join(q: Any, v: Any, y: Any) -> None:
    """y <- (q, v)."""
    nq = q.shape[0]
    for i in range(nq):
        y[i] = q[i]
    for i in range(v.shape[0]):
        y[nq + i] = v[i]


@kernel
def begin_anew(H: Any, t: float, q: Any, v: Any, work: float, singles: int, renew: int, kept: bool) -> None:
    """Let the next step begin at a reported state, see CONTROL; ``kept``: what is known of it holds."""
    c = H.control[0]
    c.placed = c.placed if kept and c.t == t else 0
    c.t, c.start, c.singles, c.renew = t, 1, singles, renew
    reset_check_schedule(H.control)
    join(q, v, H.y)
    H.y[H.y.shape[0] - 1] = work


@kernel
def set_units(H: Any, absolute: float, work: Any, scales: Any) -> None:
    """Take what the absolute tolerance is measured in, by the units and paces in ``work``."""
    nq, n = work.size_q.shape[0], work.size.shape[0]
    for i in range(nq):
        H.unit[i] = work.size_q[i]
    for i in range(n):
        H.unit[nq + i] = work.pace[i] * work.size[i]
    H.unit[nq + n] = 1.0
    set_energy_scales(scales, absolute, work.size, work.pace)


@inlined
def begin(c: Any, H: Any, max_step: float, rate: float) -> None:
    """History of order 1 from y' = ``H.yp`` at ``c.t``; ``rate`` (1/s) times y' stands for y''."""
    for i in range(H.y.shape[0]):
        for j in range(N_DIFFERENCES):
            H.phi[i, j] = 0.0
        H.phi[i, 1] = H.yp[i]
    slope = weighted_norm(H.yp, H.weight)
    c.h = min(max_step, FIRST_STEP_RATIO / rate)  # a body at rest gives no bound by its slope
    if 16.0 * slope * rate * c.h * c.h > 1.0:
        c.h = 0.25 * np.sqrt(1.0 / (slope * rate))
    c.h = max(c.h, 4.0 * 2.3e-16 * abs(c.t))
    c.hold = 0.0
    c.k, c.kold, c.ns, c.phase1, c.start, c.placed = 1, 0, 0, 1, 0, 0


@inlined
def coefficients(c: Any) -> None:
    """Block 1 of STEP: coefficients of the formulas for step ``c.h`` at order ``c.k``; those that stay are kept."""
    k, h, psi, alpha, beta, sig = c.k, c.h, c.psi, c.alpha, c.beta, c.sig
    if h != c.hold:
        c.ns = 0
    if c.ns <= c.kold:
        c.ns += 1
    ns = c.ns
    if k < ns:
        return
    c.g[1], c.g[2], sig[1] = 1.0, 0.5, 1.0
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
    predictor(c)


@inlined
def predictor(c: Any) -> None:
    """The g of block 1: integrals of the divided-difference basis, by recurrence over v and w."""
    k, ns, alpha, v, w, g = c.k, c.ns, c.alpha, c.v, c.w, c.g
    if ns <= 1:
        for iq in range(1, k + 1):
            v[iq] = 1.0 / (iq * (iq + 1))
            w[iq] = v[iq]
    else:
        if k > c.kold:
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
def predict(c: Any, H: Any) -> None:
    """Block 2, first half: the predicted state ``H.p`` and differences as of t + h without the new y'."""
    k, ns, h, phi = c.k, c.ns, c.h, H.phi
    for i in range(H.y.shape[0]):
        for j in range(ns + 1, k + 1):
            phi[i, j] *= c.beta[j]
        phi[i, k + 2] = phi[i, k + 1]
        phi[i, k + 1] = 0.0
        total, above = 0.0, 0.0
        for j in range(k, 0, -1):
            total += c.g[j] * phi[i, j]
            above += phi[i, j]
            phi[i, j] = above
        H.p[i] = H.y[i] + h * total


@inlined
def estimate(c: Any, H: Any) -> float:
    """Block 2, second half: return the weighted error at order k; note those of orders k, k-1, k-2 and the
    next order.
    """
    k, h, sig = c.k, c.h, c.sig
    two_below, one_below, here = 0.0, 0.0, 0.0
    for i in range(H.y.shape[0]):
        difference, weight = H.yp[i] - H.phi[i, 1], H.weight[i]
        if k > 2:
            two_below += ((H.phi[i, k - 1] + difference) * weight) ** 2
        if k > 1:
            one_below += ((H.phi[i, k] + difference) * weight) ** 2
        here += (difference * weight) ** 2
    scaled = h * np.sqrt(here)
    c.erk = scaled * sig[k + 1] * GAMMA_STAR[k]
    c.knew = k
    if k > 1:
        c.erkm1 = h * sig[k] * GAMMA_STAR[k - 1] * np.sqrt(one_below)
        if k == 2 and c.erkm1 <= 0.5 * c.erk:
            c.knew = 1
    if k > 2:
        c.erkm2 = h * sig[k - 1] * GAMMA_STAR[k - 2] * np.sqrt(two_below)
        if max(c.erkm1, c.erkm2) <= c.erk:
            c.knew = k - 1
    return scaled * (c.g[k] - c.g[k + 1])


@inlined
def unwind(c: Any, H: Any) -> None:
    """Block 3, first half: take :func:`predict` and :func:`coefficients` back after a failed step."""
    c.phase1 = 0
    for i in range(H.y.shape[0]):
        for j in range(1, c.k + 1):
            H.phi[i, j] = (H.phi[i, j] - H.phi[i, j + 1]) / c.beta[j]
    for j in range(2, c.k + 1):
        c.psi[j - 1] = c.psi[j] - c.h


@inlined
def correct(c: Any, H: Any) -> None:
    """Block 4: the corrected state, one order higher, in ``H.trial``."""
    factor = c.h * c.g[c.k + 1]
    for i in range(H.y.shape[0]):
        H.trial[i] = H.p[i] + factor * (H.yp[i] - H.phi[i, 1])
        H.yp_p[i] = H.yp[i]


@inlined
def correct_work(c: Any, H: Any, power: float) -> None:
    """The corrected work from W' where the step ends, after :func:`correct`."""
    last = H.y.shape[0] - 1
    H.yp[last] = power
    H.trial[last] = H.p[last] + c.h * c.g[c.k + 1] * (power - H.phi[last, 1])


@inlined
def book_step(c: Any, H: Any) -> None:
    """Book the work of a step, its error and what else the energy may stray; see :mod:`solvers.energy_account`."""
    last = H.y.shape[0] - 1
    c.work_total_variation += abs(H.trial[last] - H.y[last])
    part = c.g[c.k] - c.g[c.k + 1]
    if c.corner_rejections > 0.0:  # the difference of two orders is small, though the power is wrong by its correction
        part = max(part, 1.0 / WORK_ERROR_SAFETY)
    add_energy_error_bound(c, c.h * part * (H.yp[last] - H.phi[last, 1]), c.h)


@inlined
def accept(c: Any, H: Any, max_order: int, max_step: float) -> None:
    """Rest of block 4: take over ``H.trial`` and its y' = ``H.yp``; choose the next order and step."""
    k, phi = c.k, H.phi
    watch_stability(c, H)
    book_step(c, H)
    c.t += c.h
    c.kold, c.hold = k, c.h
    for i in range(H.y.shape[0]):
        H.y[i] = H.trial[i]
        difference = H.yp[i] - phi[i, 1]
        phi[i, k + 1] = difference
        phi[i, k + 2] = difference - phi[i, k + 2]
        for j in range(1, k + 1):
            phi[i, j] += difference
    choose_order(c, H, max_order)
    choose_step(c, max_step)


@inlined
def watch_stability(c: Any, H: Any) -> None:
    """Count the steps whose length stability sets, and not accuracy.

    rho = |y'_c - y'_p| / |y_c - y_p|, from the predicted to the corrected state, comes near the largest eigenvalue
    if its mode dominates their difference. h rho varies from step to step. If most of ``STABILITY_STEPS`` steps are
    above ``STABILITY_BOUND``, stability sets their length: medians were 0.3 to 1 on stiff motions, 0.06 to 0.13 on
    those that accuracy limits.
    """
    change, rate = 0.0, 0.0
    for i in range(H.y.shape[0]):
        change += ((H.trial[i] - H.p[i]) * H.weight[i]) ** 2
        rate += ((H.yp[i] - H.yp_p[i]) * H.weight[i]) ** 2
    if rate * c.h * c.h > STABILITY_BOUND * STABILITY_BOUND * change:
        c.long = min(c.long + 1, 2 * STABILITY_STEPS)
    else:
        c.long = max(c.long - 1, 0)
    if c.long >= STABILITY_STEPS:
        c.limited += 1


@inlined
def choose_order(c: Any, H: Any, max_order: int) -> None:
    """Next order: lower where errors fall with lower order, higher in phase 1 or where the higher order is better."""
    k = c.k
    if c.knew < k or k >= max_order:
        c.phase1 = 0
    if c.phase1 == 1:
        c.k, c.erk = k + 1, 0.0
        return
    if c.knew < k:
        c.k, c.erk = c.knew, c.erkm1
        return
    if k >= c.ns:  # differences of order k + 1 need k + 1 equal steps
        return
    above = 0.0
    for i in range(H.y.shape[0]):
        above += (H.phi[i, k + 2] * H.weight[i]) ** 2
    above = c.h * GAMMA_STAR[k + 1] * np.sqrt(above)
    if k > 1 and c.erkm1 <= min(c.erk, above):
        c.k, c.erk = k - 1, c.erkm1
    elif k < max_order and above < (c.erk if k > 1 else 0.5 * c.erk):
        c.k, c.erk = k + 1, above


@inlined
def choose_step(c: Any, max_step: float) -> None:
    """Next step: doubled, kept, or cut to between a half and nine tenths, never more than ``max_step``."""
    h = c.h
    if c.phase1 == 1 or 0.5 >= c.erk * (2 << c.k):  # 2^(k + 1)
        c.h = 2.0 * h
    elif 0.5 < c.erk:
        c.h = h * max(0.5, min(0.9, (0.5 / c.erk) ** (1.0 / (c.k + 1))))
    c.h = min(c.h, max_step)


@inlined
def interpolate(c: Any, H: Any, t: float, y: Any) -> None:
    """State at t in the last step, in ``y`` (size,): subroutine INTRP."""
    hi, g, w = t - c.t, c.g_out, c.w_out
    last = c.kold + 1
    for i in range(1, last + 1):
        w[i] = 1.0 / i
    g[1] = 1.0
    term = 0.0
    for j in range(2, last + 1):
        before = c.psi[j - 1]
        gamma, eta = (hi + term) / before, hi / before
        for i in range(1, last + 2 - j):
            w[i] = gamma * w[i] - eta * w[i + 1]
        g[j] = w[1]
        term = before
    for i in range(y.shape[0]):
        total = 0.0
        for j in range(last, 0, -1):
            total += g[j] * H.phi[i, j]
        y[i] = H.y[i] + hi * total


def counts(c: Any) -> dict[str, Any]:
    """Return what a record of CONTROL has counted, by the names of :class:`solvers.options.Statistics`."""
    return {
        "steps": int(c["steps"]),
        "rejected": int(c["rejected"]),
        "rhs_evals": int(c["evaluations"]),
        "restarts": max(0, int(c["starts"]) - 1),
        "order": int(c["kold"]),
        "step_size": float(c["hold"]),
        "stability_limited": int(c["limited"]),
    }

"""Order and step size of the multistep method: what STEP of Shampine and Gordon does with the errors of three orders.

Blocks 3 and 4 of subroutine STEP in *Computer Solution of Ordinary Differential Equations* (1975), chapter 10, whose
names these are. Steps are doubled or halved where possible, since the formulas of equal steps are cheaper.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from solvers.compiled.kernel import inlined

if TYPE_CHECKING:
    from solvers.steppers.adams.formulas import History

STABILITY_BOUND, STABILITY_STEPS = 0.25, 50  # see count_stability_limited
GAMMA_STAR = np.array(
    [1.0, 0.5, 0.0833, 0.0417, 0.0264, 0.0188, 0.0143, 0.0114, 0.00936, 0.00789, 0.00679, 0.00592, 0.00524, 0.00468]
)  # |coefficient| of the error of the fixed-step formulas, gstr of STEP


@inlined
def shorten_step(cuts: int, control: Any) -> None:
    """Block 3 of STEP, second half: halve the step; after three failures fall back to order one."""
    shrink = 0.5
    if cuts > 3 and 0.5 < 0.25 * control.erk:
        shrink = np.sqrt(0.5 / control.erk)
    control.h *= shrink
    if cuts >= 3:
        control.k = 1
    elif control.erk > 0.0:
        control.k = control.knew


@inlined
def count_stability_limited(control: Any, history: History) -> None:
    """Count the steps whose length stability sets, and not accuracy.

    rho = |y'_c - y'_p| / |y_c - y_p|, from the predicted to the corrected state, comes near the largest eigenvalue
    if its mode dominates their difference. h rho varies from step to step. If most of ``STABILITY_STEPS`` steps are
    above ``STABILITY_BOUND``, stability sets their length: medians were 0.3 to 1 on stiff motions, 0.06 to 0.13 on
    those that accuracy limits.
    """
    change, rate = 0.0, 0.0
    for i in range(history.y.shape[0]):
        change += ((history.trial[i] - history.p[i]) * history.weight[i]) ** 2
        rate += ((history.yp[i] - history.yp_p[i]) * history.weight[i]) ** 2
    if rate * control.h * control.h > STABILITY_BOUND * STABILITY_BOUND * change:
        control.limited_streak = min(control.limited_streak + 1, 2 * STABILITY_STEPS)
    else:
        control.limited_streak = max(control.limited_streak - 1, 0)
    if control.limited_streak >= STABILITY_STEPS:
        control.stability_limited += 1


@inlined
def choose_order(control: Any, history: History, max_order: int) -> None:
    """Next order: lower where errors fall with lower order, higher in phase 1 or where the higher order is better."""
    k = control.k
    if control.knew < k or k >= max_order:
        control.phase1 = 0
    if control.phase1 == 1:
        control.k, control.erk = k + 1, 0.0
        return
    if control.knew < k:
        control.k, control.erk = control.knew, control.erkm1
        return
    if k >= control.ns:  # differences of order k + 1 need k + 1 equal steps
        return
    above = 0.0
    for i in range(history.y.shape[0]):
        above += (history.phi[i, k + 2] * history.weight[i]) ** 2
    above = control.h * GAMMA_STAR[k + 1] * np.sqrt(above)
    if k > 1 and control.erkm1 <= min(control.erk, above):
        control.k, control.erk = k - 1, control.erkm1
    elif k < max_order and above < (control.erk if k > 1 else 0.5 * control.erk):
        control.k, control.erk = k + 1, above


@inlined
def choose_step(control: Any, max_step: float) -> None:
    """Next step: doubled, kept, or cut to between a half and nine tenths, never more than ``max_step``."""
    h = control.h
    if control.phase1 == 1 or 0.5 >= control.erk * (2 << control.k):  # 2^(k + 1)
        control.h = 2.0 * h
    elif 0.5 < control.erk:
        control.h = h * max(0.5, min(0.9, (0.5 / control.erk) ** (1.0 / (control.k + 1))))
    control.h = min(control.h, max_step)

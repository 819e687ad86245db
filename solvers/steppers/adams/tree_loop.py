"""Adams PECE on a large tree: the compiled step loop over its recursions.

State y = (q, v), y' by the articulated-body recursion. The formulas, their error and order control, and the rule that a
step may pass the requested time, are those of :mod:`.loop`; there is nothing to close. Quaternions are brought
back to unit length after each step, by a change of the size of the tolerance.

Explicit steps are bounded by stability: on a mesh of plates the fastest mode turns some thousand times while the
slowest moves. The error control keeps the step there, because an unstable step fails its test;
:attr:`solvers.options.Statistics.stability_limited` is their number.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import inlined, kernel, records
from solvers.energy_account import count_rejected_step, energy_check_scheduled, fill_account_row, update_energy_bound
from solvers.inertia import INERTIA, clear_growth, tolerance_factor, update_tree_growth
from solvers.outcome import COLLAPSED, MAX_STEPS, NO_MASS, NOT_FINITE, OK
from solvers.positions import Positions, position_sizes
from solvers.stepper import is_discontinuity, min_step_length, start_rate
from solvers.steppers.step_control import FIRST_STEP_RATIO, MIN_STEP_RATIO
from solvers.system import Array

from .formulas import (
    accept,
    begin,
    coefficients,
    correct,
    correct_work,
    estimate,
    interpolate,
    join,
    predict,
    set_units,
    split,
)
from .loop import cut
from .one_step import NODES, STAGES, change_step, error_of_step, keep_stage, stage, stop_at, take_step

SETTINGS = np.dtype(
    [
        ("rtol", "f8"), ("atol", "f8"), ("max_step", "f8"), ("max_order", "i8"), ("max_steps", "i8"),
        ("rate", "f8"),  # of the motion, 1/s
        ("energy_check", "i8"), ("works", "i8"),  # 1: book energy and work; 1: something does work
    ],
    align=True,
)  # fmt: skip
# Absolute tolerance of a rate to that of its coordinate, in units of the motion's rate. A tighter one than IDA's costs
# nothing if stability limits the step, and a looser one lets the fastest modes grow.
RATE_TOLERANCE_RATIO = 1.5


class TreeEquations(NamedTuple):
    """What the loop calls."""

    forward: Any
    inverse: Any
    retract: Any
    power: Any
    evaluate_energy_bound: Any
    inertia_parts: Any
    data: Any


class Scratch(NamedTuple):
    """Units, a state, its rates, and what inverse dynamics takes besides; but for units and :meth:`memory` nothing
    outlives a call.
    """

    positions: Any  # solvers.positions.Positions
    size: Array  # (n,)   units of the coordinates
    size_q: Array  # (nq,)  units of the positions
    pace: Array  # (n,)   1/s, that of the motion, as the tolerances of rates take it
    q: Array  # (nq,)
    v: Array  # (n,)
    a: Array  # (n,)
    qdot: Array  # (nq,)
    zero: Array  # (n,)
    lam: Array  # (0,)
    parts: Array  # (1 + n,) see solvers.system.TreeSystem.inertia_parts
    inertia: NDArray[Any]  # (1,) record of solvers.inertia.INERTIA

    @staticmethod
    def allocate(nq: int, n: int, positions: Positions) -> Scratch:
        """Return zeroed arrays."""
        sizes = n, nq, n, nq, n, n, nq, n, 0, 1 + n
        return Scratch._make((positions, *(np.zeros(size) for size in sizes), records(1, INERTIA)))

    def memory(self) -> list[NDArray[Any]]:
        """Return what a motion cannot go on without."""
        return [self.inertia]


@inlined
def accelerate(eqs: Any, t: float, q: Any, v: Any, qdot: Any, a: Any) -> int:
    """qdot (nq,) = N v and a (n,) = v' at (t, q, v)."""
    if eqs.forward(t, q, v, eqs.data, qdot, a) != 0:
        return NO_MASS
    for i in range(a.shape[0]):
        if not np.isfinite(a[i]):
            return NOT_FINITE
    return OK


@inlined
def differentiate(eqs: Any, t: float, c: Any, H: Any, s: Any) -> int:
    """y' in ``H.yp`` at (s.q, s.v)."""
    c.evaluations += 1
    code = accelerate(eqs, t, s.q, s.v, s.qdot, s.a)
    if code == OK:
        join(s.qdot, s.a, H.yp)
    return code


@inlined
def weigh(o: Any, H: Any, s: Any) -> None:
    """Error weights at y, such that in meshes the norm is a root mean square: they have many coordinates of a kind."""
    size = H.y.shape[0] - 1
    scale = tolerance_factor(o.rtol, 1.0, s) if s.inertia[0].watched == 1 else np.sqrt(1.0 * size)
    for i in range(size):
        H.weight[i] = 1.0 / (scale * (o.rtol * abs(H.y[i]) + o.atol * H.unit[i]))


@inlined
def power(eqs: Any, t: float, o: Any, s: Any) -> float:
    """W' at the state evaluated last."""
    return eqs.power(t, s.q, s.v, s.a, s.lam, eqs.data) if o.works == 1 else 0.0


@kernel
def book(eqs: Any, t: float, c: Any, o: Any, scales: Any, s: Any) -> None:
    """Book the energy at (s.q, s.v), at the cost of an inverse dynamics; see :mod:`solvers.energy_account`."""
    if o.energy_check == 1 and energy_check_scheduled(c):
        eqs.inverse(t, s.q, s.v, s.zero, s.lam, eqs.data, s.qdot, s.a)
        update_energy_bound(eqs.evaluate_energy_bound, eqs.data, c, scales)
    if s.inertia[0].watched == 1:
        eqs.inertia_parts(eqs.data, s.parts)
        update_tree_growth(t, s.parts, s.v, s)


@kernel
def prepare(eqs: Any, c: Any, o: Any, H: Any, s: Any, scales: Any) -> int:
    """Take y' at y, in ``H.yp`` and as the first stage."""
    split(H.y, s.q, s.v)
    code = differentiate(eqs, c.t, c, H, s)
    if code == OK:
        c.starts += 1
        H.yp[H.y.shape[0] - 1] = power(eqs, c.t, o, s)
        book(eqs, c.t, c, o, scales, s)
        keep_stage(H, 0)
        c.h = c.single if c.single > 0.0 else FIRST_STEP_RATIO / o.rate
        c.renew = 0
    return code


@kernel
def single_step(eqs: Any, c: Any, o: Any, H: Any, s: Any, scales: Any, target: float) -> int:
    """One step by the formulas of :mod:`solvers.steppers.adams.one_step`, not past ``target``; or why there is none."""
    last = H.y.shape[0] - 1
    weigh(o, H, s)
    shortest = False
    while True:
        c.h = min(c.h, o.max_step)
        stop_at(c, target)
        code, error = OK, np.inf
        for i in range(1, STAGES):
            stage(c, H, i)
            split(H.p, s.q, s.v)
            if i == STAGES - 1:
                eqs.retract(s.q, s.zero, eqs.data)
            code = differentiate(eqs, c.t + NODES[i] * c.h, c, H, s)
            if code != OK:
                break
            H.yp[last] = power(eqs, c.t + NODES[i] * c.h, o, s)
            keep_stage(H, i)
        if code == OK:
            error = error_of_step(c, H)
            if error <= 1.0 or shortest:
                H.trial[last] = H.p[last]
                join(s.q, s.v, H.trial)
                book(eqs, c.t + c.h, c, o, scales, s)
                take_step(c, H, target, error)
                return OK
        count_rejected_step(c, code == OK)
        change_step(c, error)
        smallest = min_step_length(MIN_STEP_RATIO, o.rate, o.max_step, c.t)
        if not c.h > smallest:
            if shortest or code != OK or not is_discontinuity(o.max_step, c.t):
                c.single = 0.0
                return COLLAPSED if code == OK else code
            c.h, shortest = smallest, True


@kernel
def step(eqs: Any, c: Any, o: Any, H: Any, s: Any, scales: Any) -> int:
    """One accepted step, however often it has to be cut; or the code of what made it too small."""
    weigh(o, H, s)
    cuts, shortest = 0, False
    while True:
        coefficients(c)
        predict(c, H)
        split(H.p, s.q, s.v)
        c.erk = 0.0
        code = differentiate(eqs, c.t + c.h, c, H, s)
        if code == OK and (estimate(c, H) <= 1.0 or shortest):
            correct(c, H)
            split(H.trial, s.q, s.v)
            eqs.retract(s.q, s.zero, eqs.data)
            code = differentiate(eqs, c.t + c.h, c, H, s)
            if code == OK:
                join(s.q, s.v, H.trial)
                correct_work(c, H, power(eqs, c.t + c.h, o, s))
                book(eqs, c.t + c.h, c, o, scales, s)
                accept(c, H, o.max_order, o.max_step)
                return OK
        cuts += 1
        count_rejected_step(c, code == OK)
        cut(cuts, c, H)
        smallest = min_step_length(MIN_STEP_RATIO, o.rate, o.max_step, c.t)
        if not c.h > smallest:
            if shortest or code != OK or not is_discontinuity(o.max_step, c.t):
                return COLLAPSED if code == OK else code
            c.h, c.k, shortest = smallest, 1, True


@kernel
def advance(
    eqs: Any, settings: Any, H: Any, s: Any, scales: Any, target: float, q: Any, v: Any, energy_account: Any
) -> int:
    """Step until ``target`` is passed; put the state there into (q, v), or the last good one on failure, and what is
    booked into ``energy_account`` (ROW,).
    """
    c, o = H.control[0], settings[0]
    code, taken = OK, 0
    while c.t < target:
        if taken >= o.max_steps:
            code = MAX_STEPS
            break
        if c.start == 1 and (c.renew == 1 or c.placed == 0):
            code = prepare(eqs, c, o, H, s, scales)
            if code != OK:
                break
        if c.start == 1 and c.singles > 0:
            code = single_step(eqs, c, o, H, s, scales, target)
        else:
            if c.start == 1:
                weigh(o, H, s)
                begin(c, H, o.max_step, o.rate)
            code = step(eqs, c, o, H, s, scales)
        if code != OK:
            break
        taken += 1
        c.steps += 1
    split(H.y, q, v)
    done = H.y[H.y.shape[0] - 1]
    if code == OK and target < c.t:
        interpolate(c, H, target, H.trial)
        split(H.trial, q, v)
        done = H.trial[H.y.shape[0] - 1]
        eqs.retract(q, s.zero, eqs.data)
    fill_account_row(c, done, energy_account)
    return code


@kernel
def set_up(g: Any, t: float, known: float, duration: float) -> None:
    """Find units and the rate of the motion at the reported state, of time t (s); ``known`` (1/s) is what is known of
    the rate beforehand, ``duration`` (s) that of the run.
    """
    o, H, s = g.settings[0], g.memory, g.work
    if known > 0.0:
        o.rate = start_rate(known, duration, s.size, g.v[:0], s.a[:0])
    else:
        if evaluate(g, t, s.a) != OK:
            for k in range(s.a.shape[0]):
                s.a[k] = 0.0
        o.rate = start_rate(known, duration, s.size, g.v, s.a)
    position_sizes(s.positions, s.size, s.size_q)
    for k in range(s.pace.shape[0]):
        s.pace[k] = RATE_TOLERANCE_RATIO * o.rate
    g.scales.mean_count[0] = 1 if s.inertia[0].watched == 1 else H.y.shape[0] - 1
    set_units(H, o.atol, s, g.scales)
    clear_growth(s)


@kernel
def evaluate(g: Any, t: float, a: Any) -> int:
    """Accelerations a (n,) at the reported state, of time t (s)."""
    return accelerate(g.eqs, t, g.q, g.v, g.work.qdot, a)


@kernel
def advance_reported(g: Any, target: float) -> int:
    """:func:`advance` for the reported state."""
    return advance(g.eqs, g.settings, g.memory, g.work, g.scales, target, g.q, g.v, g.energy_account)

"""Adams PECE on a large tree ('adams' where the system is a :class:`solvers.system.TreeSystem`).

State y = (q, v), y' by the articulated-body recursion. The formulas, their error and order control, and the rule that a
step may pass the time asked for, are those of :mod:`.loop`; there is nothing to close. Quaternions are brought
back to unit length after each step, by a change of the size of the tolerance.

Explicit steps are bounded by stability: on a mesh of plates the fastest mode turns some thousand times while the
slowest moves. The error control keeps the step there, because an unstable step fails its test;
:attr:`solvers.options.Statistics.stability_limited` tells how many.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.held import hold
from solvers.compiled.kernel import inlined, kernel, records
from solvers.ledger import Scales, due, look, report
from solvers.options import Options, Statistics
from solvers.outcome import COLLAPSED, MAX_STEPS, NO_MASS, NOT_FINITE, OK, Code
from solvers.projection.saddle import Accelerations, rate_of_motion
from solvers.stepper import require_placed, require_resolved
from solvers.system import Array, TreeSystem, audit_callbacks

from .explicit import ExplicitStepper
from .formulas import (
    HIGHEST,
    History,
    accept,
    begin,
    coefficients,
    correct,
    correct_work,
    counts,
    estimate,
    interpolate,
    join,
    predict,
    split,
)
from .loop import FIRST_SINGLE, SMALLEST_STEP, cut
from .one_step import NODES, STAGES, change_step, error_of_step, keep_stage, stage, stop_at, take_step

SETTINGS = np.dtype(
    [
        ("rtol", "f8"), ("max_step", "f8"), ("max_order", "i8"), ("max_steps", "i8"),
        ("rate", "f8"),  # of the motion, 1/s
        ("audit", "i8"), ("works", "i8"),  # 1: book energy and work; 1: something does work
    ],
    align=True,
)  # fmt: skip
RATE = 1.5  # absolute tolerance of a rate to that of its coordinate, in units of the motion's rate; tighter than IDA's
# costs nothing where stability limits the step, and looser lets the fastest modes grow


class TreeEquations(NamedTuple):
    """What the loop calls."""

    forward: Any
    inverse: Any
    retract: Any
    power: Any
    exposure: Any
    data: Any


class Scratch(NamedTuple):
    """A state, its rates, and what inverse dynamics takes besides."""

    q: Array  # (nq,)
    v: Array  # (n,)
    a: Array  # (n,)
    qdot: Array  # (nq,)
    zero: Array  # (n,)
    lam: Array  # (0,)

    @staticmethod
    def allocate(nq: int, n: int) -> Scratch:
        """Return zeroed arrays."""
        return Scratch(*(np.zeros(k) for k in (nq, n, n, nq, n, 0)))


@inlined
def differentiate(eqs: Any, t: float, c: Any, H: Any, s: Any) -> int:
    """y' in ``H.yp`` at (s.q, s.v)."""
    c.evaluations += 1
    if eqs.forward(t, s.q, s.v, eqs.data, s.qdot, s.a) != 0:
        return NO_MASS
    for i in range(s.a.shape[0]):
        if not np.isfinite(s.a[i]):
            return NOT_FINITE
    join(s.qdot, s.a, H.yp)
    return OK


@inlined
def weigh(o: Any, H: Any, atol: Any) -> None:
    """Error weights at y, such that the norm is a root mean square."""
    count = np.sqrt(1.0 * atol.shape[0])
    for i in range(atol.shape[0]):
        H.weight[i] = 1.0 / (count * (o.rtol * abs(H.y[i]) + atol[i]))


@inlined
def power(eqs: Any, t: float, o: Any, s: Any) -> float:
    """W' at the state evaluated last."""
    return eqs.power(t, s.q, s.v, s.a, s.lam, eqs.data) if o.works == 1 else 0.0


@kernel
def book(eqs: Any, t: float, c: Any, o: Any, scales: Any, s: Any) -> None:
    """Book the energy at (s.q, s.v), at the cost of an inverse dynamics; see :mod:`solvers.ledger`."""
    if o.audit == 1 and due(c):
        eqs.inverse(t, s.q, s.v, s.zero, s.lam, eqs.data, s.qdot, s.a)
        look(eqs.exposure, eqs.data, c, scales)


@kernel
def prepare(eqs: Any, c: Any, o: Any, H: Any, atol: Any, s: Any, scales: Any) -> int:
    """Take y' at y, in ``H.yp`` and as the first stage."""
    split(H.y, s.q, s.v)
    code = differentiate(eqs, c.t, c, H, s)
    if code == OK:
        c.starts += 1
        H.yp[H.y.shape[0] - 1] = power(eqs, c.t, o, s)
        book(eqs, c.t, c, o, scales, s)
        keep_stage(H, 0)
        c.h = c.single if c.single > 0.0 else FIRST_SINGLE / o.rate
        c.renew = 0
    return code


@kernel
def single_step(eqs: Any, c: Any, o: Any, H: Any, atol: Any, s: Any, scales: Any, target: float) -> int:
    """One step by the formulas of :mod:`solvers.steppers.adams.one_step`, not past ``target``; or why there is none."""
    last = H.y.shape[0] - 1
    weigh(o, H, atol)
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
            if error <= 1.0:
                H.trial[last] = H.p[last]
                join(s.q, s.v, H.trial)
                book(eqs, c.t + c.h, c, o, scales, s)
                take_step(c, H, target, error)
                return OK
        c.rejected += 1
        change_step(c, error)
        if not c.h > SMALLEST_STEP * max(1.0 / o.rate, abs(c.t)):
            c.single = 0.0
            return COLLAPSED if code == OK else code


@kernel
def step(eqs: Any, c: Any, o: Any, H: Any, atol: Any, s: Any, scales: Any) -> int:
    """One accepted step, however often it has to be cut; or the code of what made it too small."""
    weigh(o, H, atol)
    cuts = 0
    while True:
        coefficients(c)
        predict(c, H)
        split(H.p, s.q, s.v)
        c.erk = 0.0
        code = differentiate(eqs, c.t + c.h, c, H, s)
        if code == OK and estimate(c, H) <= 1.0:
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
        c.rejected += 1
        cut(cuts, c, H)
        if not c.h > SMALLEST_STEP * max(1.0 / o.rate, abs(c.t)):
            return COLLAPSED if code == OK else code


@kernel
def advance(
    eqs: Any, settings: Any, H: Any, atol: Any, s: Any, scales: Any, target: float, q: Any, v: Any, ledger: Any
) -> int:
    """Step until ``target`` is passed; put the state there into (q, v), or the last good one on failure, and what is
    booked into ``ledger`` (5,).
    """
    c, o = H.control[0], settings[0]
    code, taken = OK, 0
    while c.t < target:
        if taken >= o.max_steps:
            code = MAX_STEPS
            break
        if c.start == 1 and (c.renew == 1 or c.placed == 0):
            code = prepare(eqs, c, o, H, atol, s, scales)
            if code != OK:
                break
        if c.start == 1 and c.singles > 0:
            code = single_step(eqs, c, o, H, atol, s, scales, target)
        else:
            if c.start == 1:
                weigh(o, H, atol)
                begin(c, H, o.max_step, o.rate)
            code = step(eqs, c, o, H, atol, s, scales)
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
    report(c, done, ledger)
    return code


class TreeAdamsStepper(ExplicitStepper):
    """Adams PECE on a large tree."""

    others = ("ida",)

    def __init__(self, system: TreeSystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        self.system = system
        o = self.options
        self._motion = Accelerations(system)
        rate = rate_of_motion(self._motion, self._t, self._q, self._v)
        require_resolved(self._t, rate, o.rtol)
        self._history = History.allocate(system.nq, system.n, 0)
        self._control = self._history.control[0]
        self._scratch = Scratch.allocate(system.nq, system.n)
        sizes = o.absolute * system.size
        rates = RATE * rate * sizes
        require_placed(self._q, system.position_sizes(system.size), o.rtol)
        self._atol = np.concatenate((system.position_sizes(sizes), rates))
        self._settings = records(1, SETTINGS)
        self._settings["rate"] = rate
        for key in ("rtol", "max_step", "max_steps"):
            self._settings[key] = getattr(o, key)
        self._settings["audit"] = o.audit
        self._settings["max_order"] = HIGHEST if o.max_order is None else o.max_order
        callbacks = system.forward, system.inverse, system.retract, *audit_callbacks(system)
        self._eqs = hold(TreeEquations(*callbacks, system.held_data))
        self._scales = hold(Scales.of(o.rtol, sizes, rates, len(self._atol)))
        self._held, self._stage = hold(self._history), hold(self._scratch)
        self.restart()

    def _advance(self, t: float) -> Code:
        own = self._eqs, self._settings, self._held, self._atol, self._stage, self._scales
        code = Code(advance(*own, t, self._q, self._v, self._ledger))
        self._t = t if code is Code.OK else float(self._control["t"])
        return code

    def _evaluate(self) -> tuple[Code, Array, Array]:
        code = self._motion.solve(self._t, self._q, self._v)
        return code, self._motion.a.copy(), self._motion.lam

    @property
    def _watched(self) -> bool:
        return self.options.audit

    def arrays(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.stepper.Stepper.arrays`."""
        return [self.clock, self._q, self._v, self._ledger, *self._history]

    @property
    def statistics(self) -> Statistics:
        """What the run has cost so far."""
        return Statistics(**counts(self._control))

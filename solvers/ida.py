"""SUNDIALS IDA on the stabilised equations of constrained motion ('ida'): variable-order BDF on :mod:`solvers.ggl`.

After each step the way is looked over (:mod:`solvers.singular`). A step that may have jumped to another branch is taken
back: IDA starts anew where it began and does not step so far. A crossing is jumped over. Beside a near miss positions
must be known better than its gap, or the other branch is as near: D goes but for redundant rows, and d as far as
rounding lets it.

Multipliers carry no error control: they may be unbounded where the motion is smooth. Reported states are IDA's,
interpolated, then closed onto the constraints; reported accelerations are computed there
(:meth:`solvers.stepper.Stepper.accelerations`), not read from the BDF. IDA's history cannot be saved: a restored run
restarts at order one, so it agrees with the saved one to the tolerance, not bit for bit.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from sksundae.ida import IDAJacTimes, IDAPrecond

from .ggl import LAMBDA, MU, Unknowns, assemble, beside, multiply, residual, set_up, solve, weak_residual
from .held import hold
from .ida_driver import BAD, BEGUN, MATRICES, REFUSED, RESIDUALS, STANDSTILL, STEPS, STEPS_A_CALL, IDADriver, reported
from .kernel import kernel, records
from .ledger import BOOK, WORK, Scales, catch_up
from .outcome import Code
from .partition import close_report
from .quiet import IDA
from .singular import MISS, note, passed, step_bound
from .stepper import DenseStepper, Options, Statistics
from .system import Array, System
from .workspace import factor

FINEST = 1e-9  # a tighter rtol is run as this one: below it roundoff in J grows faster than the BDF error falls
# IDA bounds the error of a step and the errors add up. At order 5 a step is as rtol^(1/6) and so the sum as the step's
# error^(5/6): for a motion's error in proportion to rtol IDA is given TIGHTER rtol^POWER, and atol in proportion.
TIGHTER, POWER = 3.0, 1.2
UNCONTROLLED = 1e20  # absolute tolerance of the multipliers, in their units
BELOW = 0.2  # part of a near miss's gap that the residual of a step beside it must stay below
LESS = 1e-4  # of D beside a near miss, where redundant rows are all that needs it
NOISE = 3e-16  # relative rounding of a residual
STOOD = 10  # returns of IDA without a step, of which one is meant
SHORTER = 0.25  # of a step that was taken back may be gone at once


@kernel
def power(eqs: Any, t: float, q: Any, v: Any, a: Any, lam: Any) -> float:
    """W' where the equations were evaluated last."""
    return float(eqs.power(t, q, v, a, lam, eqs.data))


@kernel
def book(eqs: Any, t: float, q: Any, v: Any, c: Any, counts: Any, scales: Any) -> None:
    """Book the energy at (q, v); see :mod:`solvers.ledger`."""
    eqs.dynamics(t, q, v, eqs.data, eqs.terms)
    catch_up(eqs.exposure, eqs.data, c[0], counts[BEGUN], scales)


@kernel
def look_over(eqs: Any, t: float, y: Any, taken: float, rank: int, u: Any, work: Any) -> float:
    """Longest next step after one of IDA's to (t, y), s; negative where the step may have jumped to another branch."""
    for i in range(u.q.shape[0]):
        u.q[i] = y[i]
    for i in range(u.v.shape[0]):
        u.v[i] = y[u.q.shape[0] + i]
    eqs.position(t, u.q, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    if not passed(eqs, t, u.q, rank, work):
        return -1.0
    note(eqs, t, u.q, taken, taken, rank, work)
    u.at[0] = np.nan  # the terms have moved
    bound = step_bound(t, u.q, u.v, taken, eqs.terms, work)
    u.d[0], u.d[1] = u.usual[0], u.usual[1]
    if work.critical[0].kind == MISS:
        u.d[0] = LESS * u.usual[0] if rank < eqs.terms.J.shape[0] else 0.0
        u.d[1] *= min(1.0, bound * work.rate[0] / MU)
        if not abs(weak_residual(eqs.terms, work)) <= BELOW * abs(work.critical[0].gap):
            return -1.0
    return bound


class IDAStepper(IDADriver, DenseStepper):
    """SUNDIALS IDA; see :mod:`solvers.ida`. For stiff models; order at most 5."""

    def __init__(self, system: System, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        self._rtol = max(FINEST, self.options.rtol) if system.m else self.options.rtol
        self._unknowns = Unknowns.allocate(system.nq, system.n, system.m)
        self._held = hold(self._unknowns)
        self._counts = self._unknowns.counts
        self._begun, self._pending = np.zeros(1), True
        self._book, self._works = records(1, BOOK), False
        self._ida = self._new_ida()
        self._passed = self._begun_at = self._t  # s, where IDA itself stands, and where its history begins
        self._taken = 0.0  # s, its last step
        self._good = self._t, self._q, self._v, 0.0  # time, state and work after IDA's last step
        self._reach = np.inf  # s, longest next step

    def _new_ida(self) -> IDA:
        s, o, u, work, eqs = self.system, self.options, self._held, self._work, self._eqs
        controlled, motion = s.nq + s.n, s.nq + s.n + 2 * s.m
        works = self._works = o.audit and s.works()
        size = motion + works  # W enters nothing, and its own equation needs no derivative but that by W'

        def resfn(t: float, y: Array, yp: Array, res: Array) -> None:
            residual(eqs, t, y[:motion], yp[:motion], res[:motion], u, work)
            beside(eqs, t, yp, u, work, works, res)

        def setup(t: float, y: Array, yp: Array, res: Array, cj: float) -> None:
            set_up(eqs, t, y[:motion], yp[:motion], u, work)
            self._look(t, y[: s.nq], y[s.nq : controlled])
            self._unknowns.at[0] = np.nan

        def precondition(
            t: float, y: Array, yp: Array, res: Array, right: Array, left: Array, cj: float, delta: float
        ) -> None:
            if works:
                left[motion] = right[motion] / (1.0 if self._unknowns.asked[0] else cj)
            solve(eqs, t, y[:motion], yp[:motion], right[:motion], left[:motion], cj, u, work)

        def times(t: float, y: Array, yp: Array, res: Array, vector: Array, product: Array, cj: float) -> None:
            product[motion:] = vector[motion:]
            multiply(vector[:motion], product[:motion], u)

        def dense(t: float, y: Array, yp: Array, res: Array, cj: float, matrix: Array) -> None:
            set_up(eqs, t, y[:motion], yp[:motion], u, work)
            self._look(t, y[: s.nq], y[s.nq : controlled])
            assemble(eqs, u, work, cj)
            matrix[:] = self._unknowns.matrix

        fresh = {"linsolver": "gmres", "precond": IDAPrecond(setup, precondition), "jactimes": IDAJacTimes(None, times)}
        rtol = TIGHTER * self._rtol**POWER
        self._unknowns.noise[0] = NOISE / rtol
        tightened = rtol if o.atol is None else o.atol * rtol / self._rtol
        place = tightened * s.size
        self._scales = hold(Scales.of(rtol, place, self._units.pace * place, size))
        atol = UNCONTROLLED * np.append(self._scaling()[0], 1.0)[:size]
        atol[:controlled] = tightened * np.concatenate((self._units.size_q, self._units.pace * s.size))
        return IDA(
            resfn,
            # old factors serve where nothing is near singular, and no work wants the last digits of a Newton step
            **(fresh if s.m or works else {"jacfn": dense}),
            rtol=rtol,
            atol=atol,
            algebraic_idx=np.arange(controlled, motion) if s.m else None,
            max_step=0.0 if np.isinf(o.max_step) else o.max_step,
            max_order=5 if o.max_order is None else min(5, o.max_order),
            max_num_steps=min(STEPS_A_CALL, o.max_steps),
            max_conv_fails=30,
        )

    def _begin(self) -> Code:
        """Initialise IDA at the reported state with consistent derivatives."""
        s, u, w = self.system, self._unknowns, self._units
        code, a, lam = self._evaluate()
        if code is not Code.OK:
            return code
        if s.m:
            u.usual[:] = self._regularisation()
            u.d[:] = u.usual
        zeros = np.zeros(s.m)
        y = np.concatenate((self._q, self._v, lam * w.row, zeros))
        yp = np.concatenate((self._terms.qdot, a, zeros, zeros))
        if self._works != (self.options.audit and s.works()):
            self._ida = self._new_ida()
        if self._works:
            y, yp = np.append(y, self._ledger[WORK]), np.append(yp, power(self._eqs, self._t, self._q, self._v, a, lam))
        self._look(self._t, self._q, self._v)
        self._ida.init_step(self._t, y, yp)
        u.at[:] = np.nan
        u.asked[0] = 0.0
        u.columns[:], u.rows[:] = self._scaling()
        self._pending, self._passed, self._begun_at, self._taken = False, self._t, self._t, 0.0
        self._good = self._t, self._q, self._v, self._ledger[WORK]
        w.course["known"], w.course["ratio"] = 0, 0.0
        self._reach = min(self._reach, look_over(self._eqs, self._t, y, 0.0, self._rank, self._held, self._work))
        self._begun[0] += 1.0
        return Code.OK

    def _scaling(self) -> tuple[Array, Array]:
        """Return the units of unknowns and residuals (N,): pivots are not to depend on metres and kilograms."""
        s, w = self.system, self._units
        rate, one = w.rate[0], np.ones(s.m)
        inertia = self._terms.M * np.outer(s.size, s.size)
        energy = (np.trace(inertia) / max(1, s.n) or 1.0) * rate**2
        columns = w.size_q, s.size * rate, one * energy, one * rate
        rows = w.size_q * rate, energy / s.size, one * rate, one
        return np.concatenate(columns), np.concatenate(rows)

    def _regularisation(self) -> tuple[float, float]:
        """Return what D is on rows without rank, and d. M may be singular across the motion; there J~ stands in."""
        w, terms = self._units, self._terms
        J = terms.J * (self.system.size / w.row[:, None])
        M = terms.M * np.outer(self.system.size, self.system.size)
        square = np.linalg.norm(J, 2) ** 2
        mobile = np.linalg.solve(M + np.trace(M) / (self.system.n * square) * J.T @ J, J.T)
        return LAMBDA * np.trace(J @ mobile) / w.rate[0], self._unknowns.noise[0] * MU * square / w.rate[0]

    def _go(self, t: float) -> Code:
        """Step until ``t`` is passed, and interpolate; take back steps that may have jumped."""
        if self.system.m == 0:
            return super()._go(t)
        taken, stood, bad = 0, 0, self._counts[BAD]
        shortest = STANDSTILL / self._units.rate[0]
        while self._passed < t:
            if taken >= self.options.max_steps:
                return Code.MAX_STEPS
            before = self._passed
            stop = self._stop()
            result = self._ida.step(max(t, stop) if stop else t, method="onestep", tstop=stop)
            if self._reach < max(shortest, STANDSTILL * abs(before)):
                return Code.BRANCHES
            if result.status < 0:
                if self._counts[BAD] > bad or self._begun_at == self._good[0]:
                    return Code.NOT_FINITE if self._counts[BAD] > bad else Code.COLLAPSED
                code = self._resume()  # with a new history
                if code is not Code.OK:
                    return code
                continue
            if float(result.t) <= before:  # it had interpolated, and tells where it stands first; or no step moves t
                stood += 1
                if stood > STOOD:
                    return Code.COLLAPSED
                continue
            taken, stood = taken + 1, 0
            code = self._look_over(float(result.t), result.y)
            if code is not Code.OK:
                return code
        result = self._ida.step(t)
        return self._take(float(result.t), result.y)

    def _stop(self) -> float | None:
        """Where IDA must stop; none where it will not reach that.

        After a step it keeps the step size, doubles or shortens it; a stop it does not reach shortens it too.
        """
        reach = self._reach
        if reach >= 2.0 * self._taken > 0.0 or np.isinf(reach):
            return None
        return self._passed + (self._taken if reach >= self._taken > 0.0 else reach)

    def _look_over(self, t: float, y: Array) -> Code:
        """Accept IDA's step to (t, y), or begin anew where it began."""
        taken = self._taken = t - self._passed
        self._counts[STEPS] += 1.0
        bound = look_over(self._eqs, t, y, taken, self._rank, self._held, self._work)
        if bound >= 0.0:
            s = self.system
            done = float(y[-1]) if self._works else 0.0
            self._passed, self._good = t, (t, y[: s.nq].copy(), y[s.nq : s.nq + s.n].copy(), done)
            self._reach = min(bound, 2.0 * self._reach)
            return Code.OK
        self._counts[REFUSED] += 1.0
        self._reach = SHORTER * taken
        return self._resume()

    def _resume(self) -> Code:
        """Begin anew where IDA's last good step ended."""
        self._t, self._q, self._v, done = self._good
        reported(self._book, done, self._ledger)
        code = Code(close_report(self._eqs, self._t, self._q, self._v, self._rank, self._work))
        return self._begin() if code is Code.OK else code

    def restart(self) -> None:
        """Initialise IDA anew at the reported state before the next step."""
        super().restart()
        self._reach = np.inf

    def _take(self, t: float, y: Array) -> Code:
        q, v = y[: self.system.nq].copy(), y[self.system.nq : self.system.nq + self.system.n].copy()
        code = Code(close_report(self._eqs, t, q, v, self._rank, self._work))
        if code is Code.OK:
            self._t, self._q, self._v = t, q, v
            self._look(t, q, v)
            reported(self._book, float(y[-1]) if self._works else 0.0, self._ledger)
        return code

    def _look(self, t: float, q: Array, v: Array) -> None:
        if self.options.audit:
            book(self._eqs, t, np.array(q), np.array(v), self._book, self._counts, self._scales)

    @property
    def notice(self) -> str:
        """Whether a finer tolerance was asked for than is run."""
        if self._rtol == self.options.rtol:
            return ""
        return (
            f"'ida' runs a loop at a tolerance of {self._rtol:g}, not {self.options.rtol:g}: rounding allows no finer"
        )

    @property
    def statistics(self) -> Statistics:
        """What the run has cost so far; without constraints steps are not available."""
        residuals, matrices = self._counts[RESIDUALS], self._counts[MATRICES]
        steps, refused = self._counts[STEPS], self._counts[REFUSED]
        columns = self.system.nq + 2 * self.system.n + 1
        return Statistics(
            steps=int(steps),
            rejected=int(refused),
            refused=int(refused),
            rhs_evals=int(residuals + columns * matrices),
            restarts=max(0, int(self._begun[0]) - 1),
        )

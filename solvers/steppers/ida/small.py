"""SUNDIALS IDA on the stabilized equations of constrained motion ('ida'): variable-order BDF on :mod:`.ggl`.

After each step the way is looked over (:mod:`solvers.projection.singular`). A step that may have jumped to another
branch is taken back: IDA starts anew where it began and does not step so far. A crossing is jumped over. Beside a near
miss positions must be known better than its gap, or the other branch is as near: D goes but for redundant rows, and d
as far as rounding lets it.

Where a motion is slow within what D rounds off, as where it turns back in a singular position, D takes from it what it
should keep: the run stops when that is more than the tolerance forgives.

Multipliers carry no error control: they may be unbounded where the motion is smooth. Reported states are IDA's,
interpolated, then closed onto the constraints; reported accelerations are computed there
(:meth:`solvers.stepper.Stepper.accelerations`), not read from the BDF. IDA's history cannot be saved: a restored run
restarts at order one, so it agrees with the saved one to the tolerance, not bit for bit.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from sksundae.ida import IDAJacTimes, IDAPrecond

from solvers.compiled.held import hold
from solvers.compiled.kernel import kernel
from solvers.ledger import WORK, Scales, add_step, begin_work, due, look
from solvers.linalg.dense import ratio
from solvers.options import Options, Statistics
from solvers.outcome import Code
from solvers.projection.projection import close_report
from solvers.projection.singular import MISS, SINGULAR, note, passed, step_bound
from solvers.projection.workspace import factor
from solvers.steppers.dense import DenseStepper
from solvers.system import Array, System

from .driver import MATRICES, REFUSED, RESIDUALS, STANDSTILL, STEPS, IDADriver
from .ggl import (
    LAMBDA,
    MU,
    Unknowns,
    assemble,
    multiply,
    residual,
    set_up,
    solve,
    taken_by_filter,
    tie,
    velocity,
    weak_residual,
)
from .quiet import IDA

FINEST = 1e-9  # a tighter rtol is run as this one: below it roundoff in J grows faster than the BDF error falls
# IDA bounds the error of a step and the errors add up. At order 5 a step is as rtol^(1/6) and so the sum as the step's
# error^(5/6): for a motion's error in proportion to rtol IDA is given TIGHTER rtol^POWER, and atol in proportion.
TIGHTER, POWER = 3.0, 1.2
UNCONTROLLED = 1e20  # absolute tolerance of the multipliers, in their units
BELOW = 0.2  # part of a near miss's gap that the residual of a step beside it must stay below
NEARER = 10.0  # times rtol: branches that are no farther apart, in units of size, are one
# Times rtol: speed that D may take from loops in a singular position, in units of theirs. In a period of the motion
# that makes an error of some 60 rtol.
LOSS = 10.0
LESS = 1e-4  # of D beside a near miss, where redundant rows are all that needs it
NOISE = 3e-16  # relative rounding of a residual
STOPS = 12  # times asked for at which steps end after a load has changed at one: another change is likely
HIGH = 3.0  # ramp of the velocities, in units of them and of their absolute tolerance to the relative one
SHORTER = 0.25  # of a step that was taken back may be gone at once


@kernel
def book(eqs: Any, t: float, y: Any, yp: Any, works: bool, u: Any, work: Any, books: Any, scales: Any) -> None:
    """Book a step of IDA's to (t, y, yp); see :mod:`solvers.ledger`."""
    c, nq, n, power = books[0], u.q.shape[0], u.v.shape[0], 0.0
    u.at[0] = np.nan  # the terms move
    for i in range(nq):
        u.q[i] = y[i]
    for i in range(n):
        u.v[i], u.a[i] = velocity(i, t, y, u), yp[nq + i] + u.lift[1, i]
    if works or due(c):
        eqs.dynamics(t, u.q, u.v, eqs.data, eqs.terms)
    if due(c):
        look(eqs.exposure, eqs.data, c, scales)
    if works:
        for row in range(u.lam.shape[0]):
            u.lam[row] = y[nq + n + row] / work.row[row]
        power = eqs.power(t, u.q, u.v, u.a, u.lam, eqs.data)
    add_step(books, t, power)


@kernel
def look_over(eqs: Any, t: float, y: Any, taken: float, rank: int, u: Any, work: Any) -> float:
    """Longest next step after one of IDA's to (t, y), s; negative where the step may have jumped to another branch."""
    for i in range(u.q.shape[0]):
        u.q[i] = y[i]
    for i in range(u.v.shape[0]):
        u.v[i] = velocity(i, t, y, u)
    eqs.position(t, u.q, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    for row in range(u.lam.shape[0]):
        u.lam[row] = y[u.q.shape[0] + u.v.shape[0] + row] / work.row[row]
    if not passed(eqs, t, u.q, u.near[0], rank, work):
        return -1.0
    u.lost[0] += taken_by_filter(taken, eqs.terms, u, work)
    if ratio(work.pivot, rank) >= SINGULAR:
        u.lost[0] = 0.0
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
    """SUNDIALS IDA; see :mod:`solvers.steppers.ida.small`. For stiff models; order at most 5."""

    def __init__(self, system: System, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        self._rtol = max(FINEST, self.options.rtol) if system.m else self.options.rtol
        self._unknowns = Unknowns.allocate(system.nq, system.n, system.m)
        self._held = hold(self._unknowns)
        self._counts = self._unknowns.counts
        self._ida, self._works = self._new_ida(), False
        self._instant = STANDSTILL / self._units.rate[0]
        self._good = self._slopes = np.zeros(0)  # IDA's unknowns after its last step, and their derivatives

    def _new_ida(self) -> IDA:
        s, o, u, work, eqs = self.system, self.options, self._held, self._work, self._eqs
        controlled = s.nq + s.n

        def resfn(t: float, y: Array, yp: Array, res: Array) -> None:
            residual(eqs, t, y, yp, res, u, work)

        def setup(t: float, y: Array, yp: Array, res: Array, cj: float) -> None:
            set_up(eqs, t, y, yp, u, work)

        def precondition(
            t: float, y: Array, yp: Array, res: Array, right: Array, left: Array, cj: float, delta: float
        ) -> None:
            solve(eqs, t, y, yp, right, left, cj, u, work)

        def times(t: float, y: Array, yp: Array, res: Array, vector: Array, product: Array, cj: float) -> None:
            multiply(vector, product, u)

        def dense(t: float, y: Array, yp: Array, res: Array, cj: float, matrix: Array) -> None:
            set_up(eqs, t, y, yp, u, work)
            assemble(eqs, u, work, cj)
            matrix[:] = self._unknowns.matrix

        fresh = {"linsolver": "gmres", "precond": IDAPrecond(setup, precondition), "jactimes": IDAJacTimes(None, times)}
        rtol = TIGHTER * self._rtol**POWER
        self._unknowns.noise[0], self._unknowns.near[0] = NOISE / rtol, NEARER * self._rtol
        tightened = rtol if o.atol is None else o.atol * rtol / self._rtol
        place, atol = tightened * s.size, UNCONTROLLED * self._scaling()[0]
        atol[:controlled] = tightened * np.concatenate((self._units.size_q, self._units.pace * s.size))
        self._scales = hold(Scales.of(rtol, place, self._units.pace * place, len(atol)))
        return IDA(
            resfn,
            **(fresh if s.m else {"jacfn": dense}),  # old factors serve where nothing is near singular
            rtol=rtol,
            atol=atol,
            algebraic_idx=np.arange(controlled, len(atol)) if s.m else None,
            max_step=0.0 if np.isinf(o.max_step) else o.max_step,
            max_order=5 if o.max_order is None else min(5, o.max_order),
            max_conv_fails=30,
        )

    def _begin(self) -> Code:
        """Initialize IDA at the reported state with consistent derivatives."""
        s, u, w = self.system, self._unknowns, self._units
        code, a, lam = self._evaluate()
        if code is not Code.OK:
            return code
        if s.m:
            u.usual[:] = self._regularization()
            u.d[:] = u.usual
        zeros = np.zeros(s.m)
        y = np.concatenate((self._q, self._v, lam * w.row, zeros))
        yp = np.concatenate((self._terms.qdot, a, zeros, zeros))
        u.at[:], u.lift[:] = np.nan, 0.0
        self._ida.init_step(self._t, y, yp)
        u.asked[0], self._works = 0.0, s.works()
        u.columns[:], u.rows[:] = self._scaling()
        self._begun_here()
        self._good, self._slopes = y, yp
        w.course["ratio"] = 0.0  # what is known of the branch holds
        if s.m:
            bound = look_over(self._eqs, self._t, y, 0.0, self._rank, self._held, self._work)
            self._reach = min(self._reach, bound)
        self._note(self._t, y, yp)
        return Code.OK

    def _scaling(self) -> tuple[Array, Array]:
        """Return the units of unknowns and residuals (N,): pivots are not to depend on meters and kilograms."""
        s, w = self.system, self._units
        rate, one = w.rate[0], np.ones(s.m)
        inertia = self._terms.M * np.outer(s.size, s.size)
        energy = (np.trace(inertia) / max(1, s.n) or 1.0) * rate**2
        columns = w.size_q, s.size * rate, one * energy, one * rate
        rows = w.size_q * rate, energy / s.size, one * rate, one
        return np.concatenate(columns), np.concatenate(rows)

    def _regularization(self) -> tuple[float, float]:
        """Return what D is on rows without rank, and d. M may be singular across the motion; there J~ stands in."""
        w, terms = self._units, self._terms
        J = terms.J * (self.system.size / w.row[:, None])
        M = terms.M * np.outer(self.system.size, self.system.size)
        square = np.linalg.norm(J, 2) ** 2
        mobile = np.linalg.solve(M + np.trace(M) / (self.system.n * square) * J.T @ J, J.T)
        return LAMBDA * np.trace(J @ mobile) / w.rate[0], self._unknowns.noise[0] * MU * square / w.rate[0]

    def _look_over(self, t: float, y: Array, yp: Array) -> Code:
        """Accept IDA's step to (t, y), or begin anew where it began."""
        s = self.system
        self._counts[STEPS] += 1.0
        if s.m:
            bound = look_over(self._eqs, t, y, self._taken, self._rank, self._held, self._work)
            if bound < 0.0:
                self._counts[REFUSED] += 1.0
                self._reach = SHORTER * self._taken
                return self._resume()
            self._reach = min(bound, 2.0 * self._reach)
            if self._unknowns.lost[0] > LOSS * self._rtol:
                return Code.BRANCHES
        self._passed, self._good, self._slopes = t, y, yp
        self._note(t, y, yp)
        return Code.OK

    def _note(self, t: float, y: Array, yp: Array) -> None:
        if self.options.audit:
            book(self._eqs, t, y, yp, self._works, self._held, self._work, self._book, self._scales)

    def renew(self) -> None:
        """Go on with IDA's history where its last step ends at the reported time; let the next ones end where asked."""
        keeps = not self._pending and self._passed == self._t and self.status.ok
        if not (keeps and self._ramp_is_low(self._t) and self._tied()):
            self.restart()
        self._stops = STOPS

    def _ramp_is_low(self, t: float) -> bool:
        """Whether IDA's unknowns are of the size of the velocities until t (s): relative tolerances are of them."""
        u = self._unknowns
        ramp = u.lift[0] + (t - u.since[0]) * u.lift[1]
        return bool(np.all(np.abs(ramp) <= HIGH * (np.abs(self._v) + self._units.pace * self.system.size)))

    def _advance(self, t: float) -> Code:
        if self._unknowns.lift[1].any() and not self._ramp_is_low(t):
            self.restart()
        return super()._advance(t)

    def _tied(self) -> bool:
        """Let IDA's history go on to today's accelerations, and the books begin another piece; False: they are none."""
        code, a, lam = self._evaluate()
        if code is not Code.OK:
            return False
        tie(self._t, a, self._slopes, self._held)
        self._unknowns.at[:], self._works = np.nan, self.system.works()
        begin_work(self._book, self._ledger[WORK])
        here, first = self._good.copy(), self.system.nq + self.system.n
        here[first : first + self.system.m] = lam * self._units.row
        self._note(self._t, here, self._slopes)
        return True

    def _resume(self) -> Code:
        code = self._take(self._passed, self._good)
        if code is not Code.OK:
            return code
        self._tell()
        return self._begin()

    def _arrays(self) -> list[NDArray[Any]]:
        return [*super()._arrays(), *self._units.memory()]

    def restore(self, data: bytes) -> None:
        """Take over a reported state and the units it was integrated in; the history starts anew."""
        super().restore(data)
        self._ida, self._instant = self._new_ida(), STANDSTILL / self._units.rate[0]

    def _take(self, t: float, y: Array) -> Code:
        u, nq = self._unknowns, self.system.nq
        q, v = y[:nq].copy(), y[nq : nq + self.system.n] + u.lift[0] + (t - u.since[0]) * u.lift[1]
        code = Code(close_report(self._eqs, t, q, v, self._rank, self._work))
        if code is Code.OK:
            self._t, self._q, self._v = t, q, v
        return code

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
        """What the run has cost so far."""
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

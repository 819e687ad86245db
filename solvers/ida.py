"""SUNDIALS IDA on the stabilised, regularised equations of constrained motion ('ida').

Unknowns y = (q, v, lambda, mu), variable-order BDF. The form is Gear, Gupta and Leimkuhler's with a Tikhonov term::

    q' - N(q) (v - J^T mu) + k (q - unit(q)) = 0      M v' + h + J^T lambda = 0
    J v - nu - d lambda = 0                           Phi - d mu = 0

with d = 0.01 rtol, in units of the squared constraint Jacobian (and of its inverse mass for lambda). Without
d the iteration matrix is singular where J loses rank: the matrix kept from before such a position diverges
after it and the step is cut ever closer to it. With d the vanishing direction is left to the predictor, which
knows the tangent. The bias is |J v - nu| = d |lambda|, far below the tolerance, and redundant constraints are
admitted as well. The regularisation bounds what can be reached: with constraints, an rtol below FINEST is run as
FINEST.

Multipliers carry no error control: they may be unbounded where the motion is smooth. unit(q) is q with its
quaternions normalised; the last term of the first equation holds their length and vanishes with it.

Reported states are IDA's, interpolated, then closed onto the constraints; reported accelerations are computed
there (:meth:`solvers.stepper.Stepper.accelerations`), not read from the BDF. IDA's history cannot be saved: a
restored run restarts at order one, so it agrees with the saved one to the tolerance, not bit for bit.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .held import hold
from .kernel import kernel
from .partition import close_report
from .quiet import IDA
from .stepper import Code, DenseStepper, Options, Statistics, Stepper
from .system import Array, System

TIKHONOV = 0.01  # d relative to rtol; a tenth of it takes 60 times the residuals at 1e-10
FINEST = 5e-10  # a tighter rtol is run as this one: below it roundoff in J grows faster than the BDF error falls
# IDA bounds the error of a step and the errors add up. At order 5 a step is as rtol^(1/6) and so the sum as the step's
# error^(5/6): for a motion's error in proportion to rtol IDA is given TIGHTER rtol^POWER.
TIGHTER, POWER = 3.0, 1.2
UNCONTROLLED = 1e8  # absolute tolerance of the multipliers
LENGTH_RATE = 10.0  # 1/s, k
STEPS_A_CALL = 5000  # then progress is looked at
STANDSTILL = 1e-10  # s relative to max(1, |t|): less progress in STEPS_A_CALL steps is a collapse
TOO_MUCH_WORK = -1  # IDA's status for STEPS_A_CALL steps taken


class Unknowns(NamedTuple):
    """Writable copies of what IDA passes, and scratch of the residual."""

    y: Array  # (nq + n + 2 m,)  q, v, lambda, mu
    yp: Array  # (nq + n + 2 m,)
    res: Array  # (nq + n + 2 m,)  residual at a neighbour
    q: Array  # (nq,)
    v: Array  # (n,)
    drift: Array  # (n,)   v - J^T mu
    qdot: Array  # (nq,)  N (v - J^T mu)
    unit: Array  # (nq,)  q with unit quaternions
    zero: Array  # (n,)
    d: Array  # (2,)   Tikhonov terms of lambda and of mu
    counts: Array  # (3,)   residuals, Jacobians, residuals that were not finite

    @staticmethod
    def allocate(nq: int, n: int, m: int) -> Unknowns:
        """Return zeroed arrays for ``nq`` positions, ``n`` velocities and ``m`` constraints."""
        size = nq + n + 2 * m
        return Unknowns(*(np.zeros(k) for k in (size, size, size, nq, n, n, nq, nq, n, 2, 3)))


@kernel
def balance(eqs: Any, t: float, u: Any, res: Any) -> None:
    """Residual (size,) at (u.y, u.yp), module docstring; leaves ``terms`` at (q, v)."""
    terms, nq = eqs.terms, u.q.shape[0]
    m, n = terms.J.shape
    lam, mu = nq + n, nq + n + m
    for i in range(nq):
        u.q[i] = u.y[i]
        u.unit[i] = u.y[i]
    for i in range(n):
        u.v[i] = u.y[nq + i]
    drift_rate(eqs, t, u)
    eqs.dynamics(t, u.q, u.v, eqs.data, terms)
    if nq == n:
        for i in range(n):
            u.qdot[i] = terms.qdot[i]
            for row in range(m):
                u.qdot[i] -= terms.J[row, i] * u.y[mu + row]
    for i in range(nq):
        res[i] = u.yp[i] - u.qdot[i] + LENGTH_RATE * (u.q[i] - u.unit[i])
    for i in range(n):
        res[nq + i] = terms.h[i]
        for j in range(n):
            res[nq + i] += terms.M[i, j] * u.yp[nq + j]
        for row in range(m):
            res[nq + i] += terms.J[row, i] * u.y[lam + row]
    for row in range(m):
        res[lam + row] = -terms.nu[row] - u.d[0] * u.y[lam + row]
        for j in range(n):
            res[lam + row] += terms.J[row, j] * u.v[j]
        res[mu + row] = terms.Phi[row] - u.d[1] * u.y[mu + row]


@kernel
def drift_rate(eqs: Any, t: float, u: Any) -> None:
    """Where q holds quaternions: N (v - J^T mu) by a second evaluation, and the unit quaternions. N = 1 needs none."""
    terms, nq = eqs.terms, u.q.shape[0]
    m, n = terms.J.shape
    if nq == n:
        return
    eqs.position(t, u.q, eqs.data, terms)
    for i in range(n):
        u.drift[i] = u.v[i]
        for row in range(m):
            u.drift[i] -= terms.J[row, i] * u.y[nq + n + m + row]
    eqs.dynamics(t, u.q, u.drift, eqs.data, terms)
    for i in range(nq):
        u.qdot[i] = terms.qdot[i]
    eqs.retract(u.unit, u.zero, eqs.data)


@kernel
def load(y: Any, yp: Any, u: Any) -> None:
    """Copy IDA's read-only arrays."""
    for i in range(y.shape[0]):
        u.y[i] = y[i]
        u.yp[i] = yp[i]


@kernel
def residual(eqs: Any, t: float, y: Any, yp: Any, res: Any, u: Any) -> None:
    """IDA's residual function; what is not finite IDA takes as a sign to cut the step."""
    load(y, yp, u)
    balance(eqs, t, u, res)
    u.counts[0] += 1.0
    for i in range(res.shape[0]):
        if not np.isfinite(res[i]):
            u.counts[2] += 1.0
            return


@kernel
def jacobian(eqs: Any, t: float, y: Any, yp: Any, res: Any, cj: float, JJ: Any, u: Any) -> None:
    """d res / d y + cj d res / d y': differences in y, all columns in one call; the part of y' is known."""
    nq, n = u.q.shape[0], u.v.shape[0]
    load(y, yp, u)
    u.counts[1] += 1.0
    for j in range(y.shape[0]):
        step = 1.5e-8 * max(1.0, abs(y[j])) if j < nq + n else 1.0  # linear in the multipliers
        u.y[j] = y[j] + step
        balance(eqs, t, u, u.res)
        for i in range(y.shape[0]):
            JJ[i, j] = (u.res[i] - res[i]) / step
        u.y[j] = y[j]
    eqs.dynamics(t, u.q, u.v, eqs.data, eqs.terms)
    for i in range(nq):
        JJ[i, i] += cj
    for i in range(n):
        for j in range(n):
            JJ[nq + i, nq + j] += cj * eqs.terms.M[i, j]


class IDADriver(Stepper):
    """Calls IDA and takes its results: what every stepper around it shares.

    A stepper gives ``_ida``, ``_begin`` and ``_take``, and counts residuals, Jacobians and residuals that were not
    finite in ``_counts``.
    """

    _ida: IDA
    _counts: Array  # (3,)
    _begun: Array  # (1,) how often IDA has been initialised
    _pending: bool  # IDA is to be initialised at the reported state

    @abstractmethod
    def _begin(self) -> Code:
        """Initialise IDA at the reported state."""

    @abstractmethod
    def _take(self, t: float, y: Array) -> Code:
        """Make IDA's y at t the reported state."""

    def _advance(self, t: float) -> tuple[Code, float]:
        if self._pending:
            code = self._begin()
            if code is not Code.OK:
                return code, self._t
        code = self._go(t)
        if code not in (Code.OK, Code.MAX_STEPS):
            self._pending = True
        return code, self._t

    def _go(self, t: float) -> Code:
        """Call IDA until ``t``; it must not be trusted to notice that it stands still."""
        taken, bad = 0, self._counts[2]
        while True:
            before = self._t
            result = self._ida.step(t)
            if result.status < 0 and result.status != TOO_MUCH_WORK:
                return Code.NOT_FINITE if self._counts[2] > bad else Code.COLLAPSED
            code = self._take(float(result.t), result.y)
            if code is not Code.OK:
                return code
            if result.status >= 0:
                return Code.OK
            taken += STEPS_A_CALL
            if self._t - before <= STANDSTILL * max(1.0, abs(self._t)):
                return Code.NOT_FINITE if self._counts[2] > bad else Code.COLLAPSED
            if taken >= self.options.max_steps:
                return Code.MAX_STEPS

    def restart(self) -> None:
        """Initialise IDA anew at the reported state before the next step."""
        self._pending = True

    def _arrays(self) -> list[NDArray[Any]]:
        return [self._reported, self._q, self._v, self._counts, self._begun]

    def restore(self, data: bytes) -> None:
        """Take over a reported state; the history starts anew."""
        super().restore(data)
        self._pending = True


class IDAStepper(IDADriver, DenseStepper):
    """SUNDIALS IDA; see :mod:`solvers.ida`. For stiff models; order at most 5."""

    def __init__(self, system: System, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        self._rtol = max(FINEST, self.options.rtol) if system.m else self.options.rtol
        self._unknowns = Unknowns.allocate(system.nq, system.n, system.m)
        self._counts = self._unknowns.counts
        self._begun, self._pending = np.zeros(1), True
        self._ida = self._new_ida()

    def _new_ida(self) -> IDA:
        s, o, u, eqs = self.system, self.options, hold(self._unknowns), self._eqs

        def resfn(t: float, y: Array, yp: Array, res: Array) -> None:
            residual(eqs, t, y, yp, res, u)

        def jacfn(t: float, y: Array, yp: Array, res: Array, cj: float, JJ: Array) -> None:
            jacobian(eqs, t, y, yp, res, cj, JJ, u)

        controlled, size = s.nq + s.n, s.nq + s.n + 2 * s.m
        rtol = TIGHTER * self._rtol**POWER
        atol = np.full(size, rtol if o.atol is None else o.atol * rtol / self._rtol)
        atol[controlled:] = UNCONTROLLED
        return IDA(
            resfn,
            jacfn=jacfn,
            rtol=rtol,
            atol=atol,
            algebraic_idx=np.arange(controlled, size) if s.m else None,
            max_step=0.0 if np.isinf(o.max_step) else o.max_step,
            max_order=5 if o.max_order is None else min(5, o.max_order),
            max_num_steps=min(STEPS_A_CALL, o.max_steps),
            max_conv_fails=30,
        )

    def _begin(self) -> Code:
        """Initialise IDA at the reported state with consistent derivatives."""
        s, u = self.system, self._unknowns
        code, a, lam = self._evaluate()
        if code is not Code.OK:
            return code
        J, scale = self._terms.J, np.trace(self._terms.M) / s.n
        square = np.linalg.norm(J, 2) ** 2 if s.m else 1.0
        u.d[:] = TIKHONOV * self._rtol * square / np.array([scale, 1.0])
        zeros = np.zeros(s.m)
        y = np.concatenate((self._q, self._v, lam, zeros))
        yp = np.concatenate((self._terms.qdot, a, zeros, zeros))
        self._ida.init_step(self._t, y, yp)
        self._pending = False
        self._begun[0] += 1.0
        return Code.OK

    def _take(self, t: float, y: Array) -> Code:
        q, v = y[: self.system.nq].copy(), y[self.system.nq : self.system.nq + self.system.n].copy()
        code = Code(close_report(self._eqs, t, q, v, self._rank, self._work))
        if code is Code.OK:
            self._t, self._q, self._v = t, q, v
        return code

    @property
    def statistics(self) -> Statistics:
        """What the run has cost so far; IDA's steps, order and step size are not available."""
        columns = self._unknowns.y.size
        residuals, jacobians = self._unknowns.counts[0], self._unknowns.counts[1]
        return Statistics(
            rhs_evals=int(residuals + columns * jacobians),
            restarts=max(0, int(self._begun[0]) - 1),
        )

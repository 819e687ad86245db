"""SUNDIALS IDA on a large tree ('ida' where the system is a :class:`solvers.system.TreeSystem`).

Unknowns y = (q, v, lambda, mu), the last two where there are cut joints; residual by inverse dynamics, in the form of
:mod:`.ggl`::

    q' - N(q) (v - J^T mu) + k (q - unit(q)) = 0      M v' + h + J^T lambda = 0
    J v - nu - d0 lambda = 0                          Phi - d1 mu = 0

d0 and d1 are TIKHONOV rtol times the inverse of each constraint's effective mass, and times its J J^T. The reaction of
a node's support would throw the node alone at hundreds of g: with a D as large as :mod:`.ggl` has, it damps the
motion.

Newton's linear systems go to GMRES, whose preconditioner is the structured tangent (all but exact, so one or two
iterations do). With g the first residual as a motion, c = IDA's cj and T = c^2 M + c D + K,

    T dtheta = r2 + c M (g - J^T dmu) - J^T dlambda,    dv = c dtheta - g + J^T dmu,    dq = N dtheta.

D g is left out of the right-hand side: it only matters to the preconditioner. With X = T^-1 c M J^T, A = T^-1 J^T and
theta0 = T^-1 (r2 + c M g) the constraints, the third less c times the fourth, leave 2 m equations::

    [ J J^T + c d1      -d0  ] [ dmu     ]   [ r3 + J g - c r4 ]
    [ -(J X + d1)      -J A  ] [ dlambda ] = [ r4 - J theta0   ]

**Order** 2 unless more is asked for: BDF of orders 3 to 5 are unstable on undamped modes above their region, and a
sheet has thousands; their step count then hardly depends on the tolerance. **Absolute tolerances** are relative to the
size of each coordinate (an angle of a sheet's joint is curvature times cell, and the errors of a chain of joints add
up), those of rates RATE times that in the time of the motion; multipliers carry no error control. Reported states are
closed onto the constraints.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from sksundae.ida import IDAPrecond

from solvers.compiled.held import hold
from solvers.compiled.kernel import kernel
from solvers.ledger import Scales, add_step, due, look
from solvers.linalg.blocks import one_thread
from solvers.options import Options, Statistics
from solvers.outcome import Code
from solvers.projection.saddle import Accelerations, close, inverse_squares, rate_of_motion
from solvers.stepper import require_placed, require_resolved
from solvers.system import LARGEST_DENSE, Array, TreeSystem, audit_callbacks

from .driver import BAD, MATRICES, RESIDUALS, STANDSTILL, STEPS, IDADriver
from .ggl import LENGTH_RATE
from .quiet import IDA

UNCONTROLLED = 1e8  # absolute tolerance of the multipliers
RATE = 150.0  # absolute tolerance of a rate to that of its coordinate, in units of the motion's rate
ORDER = 2
KRYLOV = 5
TIKHONOV = 1e-6


class Scratch(NamedTuple):
    """Writable copies of what IDA passes, and scratch."""

    q: Array  # (nq,)
    v: Array  # (n,)
    a: Array  # (n,)
    qdot: Array  # (nq,)
    unit: Array  # (nq,) q with unit quaternions
    zero: Array  # (n,)
    tau: Array  # (n,)
    lam: Array  # (m,)

    @staticmethod
    def allocate(nq: int, n: int, m: int) -> Scratch:
        """Return zeroed arrays."""
        return Scratch(*(np.zeros(k) for k in (nq, n, n, nq, nq, n, n, m)))


@kernel
def residual(
    inverse: Any, retract: Any, t: float, y: Any, yp: Any, res: Any, length_rate: float, data: Any, s: Any
) -> bool:
    """Fill the rows of q and v of ``res`` at mu = 0; False where they are not finite."""
    nq, n = s.q.shape[0], s.v.shape[0]
    for i in range(nq):
        s.q[i] = y[i]
        s.unit[i] = y[i]
    for i in range(n):
        s.v[i] = y[nq + i]
        s.a[i] = yp[nq + i]
    for i in range(s.lam.shape[0]):
        s.lam[i] = y[nq + n + i]
    inverse(t, s.q, s.v, s.a, s.lam, data, s.qdot, s.tau)
    retract(s.unit, s.zero, data)
    finite = True
    for i in range(nq):
        res[i] = yp[i] - s.qdot[i] + length_rate * (s.q[i] - s.unit[i])
    for i in range(n):
        res[nq + i] = s.tau[i]
        finite = finite and np.isfinite(s.tau[i])
    return finite


@kernel
def book(
    inverse: Any, power: Any, exposure: Any, t: float, y: Any, yp: Any, works: bool, data: Any, s: Any, books: Any,
    scales: Any,
) -> None:  # fmt: skip
    """Book a step of IDA's to (t, y, yp); see :mod:`solvers.ledger`."""
    c, nq, n, done = books[0], s.q.shape[0], s.v.shape[0], 0.0
    for i in range(nq):
        s.q[i] = y[i]
    for i in range(n):
        s.v[i] = y[nq + i]
        s.a[i] = yp[nq + i]
    if due(c):
        for i in range(s.lam.shape[0]):
            s.lam[i] = 0.0
        inverse(t, s.q, s.v, s.zero, s.lam, data, s.qdot, s.tau)
        look(exposure, data, c, scales)
    if works:
        for i in range(s.lam.shape[0]):
            s.lam[i] = y[nq + n + i]
        inverse(t, s.q, s.v, s.a, s.lam, data, s.qdot, s.tau)
        done = power(t, s.q, s.v, s.a, s.lam, data)
    add_step(books, t, done)


class TreeIDAStepper(IDADriver):
    """IDA on a large tree."""

    def __init__(self, system: TreeSystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        dense = ("adams", "hybrid") if system.n <= LARGEST_DENSE else ()
        self.others = dense if system.m else ("adams",)
        super().__init__(system, t0, q0, v0, options)
        self.system = system
        nq, n, m = system.nq, system.n, system.m
        ends = np.cumsum((nq, n, m, m))
        self._v_at, self._lam_at, self._mu_at = (slice(*pair) for pair in pairwise(map(int, ends)))
        self._scratch = Scratch.allocate(nq, n, m)
        self._held = hold(self._scratch)
        self._terms, self._motion = system.allocate_terms(), Accelerations(system)
        self._rate = rate_of_motion(self._motion, self._t, self._q, self._v)
        require_resolved(self._t, self._rate, self.options.rtol)
        require_placed(self._q, system.position_sizes(system.size), self.options.rtol)
        self._instant, self._length_rate = STANDSTILL / self._rate, LENGTH_RATE * self._rate
        self._d = np.zeros((2, m))
        self._cj, self._A, self._reduced = 1.0, np.zeros((n, m)), np.zeros((2 * m, 2 * m))
        self._power, self._exposure = audit_callbacks(system)
        self._ida, self._works = self._new_ida(), False
        self.status = self._status(close(system, self._t, self._q, self._v))

    def _new_ida(self) -> IDA:
        s, o = self.system, self.options
        sizes = o.absolute * s.size
        rates = RATE * self._rate * sizes
        atol = np.concatenate((s.position_sizes(sizes), rates, np.full(2 * s.m, UNCONTROLLED)))
        self._scales = hold(Scales.of(o.rtol, sizes, rates, len(atol)))
        return IDA(
            self._residual,
            rtol=o.rtol,
            atol=atol,
            algebraic_idx=np.arange(s.nq + s.n, s.nq + s.n + 2 * s.m) if s.m else None,
            linsolver="gmres",
            krylov_dim=KRYLOV,
            precond=IDAPrecond(self._set_up, self._precondition),
            max_step=0.0 if np.isinf(o.max_step) else o.max_step,
            max_order=ORDER if o.max_order is None else min(5, o.max_order),
            max_conv_fails=30,
        )

    def _residual(self, t: float, y: Array, yp: Array, res: Array) -> None:
        s = self.system
        self._counts[RESIDUALS] += 1.0
        if s.m:
            s.fill_position(t, np.array(y[: s.nq]), self._terms)
        if not residual(s.inverse, s.retract, t, y, yp, res, self._length_rate, s.held_data, self._held):
            self._counts[BAD] += 1.0
        if s.m:
            T, lam, mu = self._terms, y[self._lam_at], y[self._mu_at]
            res[: s.nq] += s.as_positions(y[: s.nq], mu @ T.J)
            res[self._lam_at] = T.J @ y[self._v_at] - T.nu - self._d[0] * lam
            res[self._mu_at] = T.Phi - self._d[1] * mu

    def _set_up(self, t: float, y: Array, yp: Array, res: Array, cj: float) -> None:
        self._counts[MATRICES] += 1.0
        self._residual(t, y, yp, np.empty_like(res))
        s, self._cj = self.system, cj
        if s.tangent.factor(cj, cj * cj) and s.m:
            self._reduce(cj)

    def _look_over(self, t: float, y: Array, yp: Array) -> Code:
        self._counts[STEPS] += 1.0
        self._passed = t
        self._note(t, y, yp)
        return Code.OK

    def _note(self, t: float, y: Array, yp: Array) -> None:
        if self.options.audit:
            s = self.system
            callbacks = s.inverse, self._power, self._exposure
            book(*callbacks, t, y, yp, self._works, s.held_data, self._held, self._book, self._scales)

    def _reduce(self, cj: float) -> None:
        """Factor the equations of the constraints."""
        s = self.system
        J, m = self._terms.J, s.m
        inertia = np.array([s.tangent.inertia(row) for row in J])
        both = s.tangent.solve(np.vstack((J, cj * inertia)).T)  # (n, 2 m)
        self._A, X = both[:, :m], both[:, m:]
        d0, d1 = np.diag(self._d[0]), np.diag(self._d[1])
        self._reduced = np.linalg.inv(np.block([[J @ J.T + cj * d1, -d0], [-J @ X - d1, -J @ self._A]]))
        self._J, self._X = J.copy(), X

    def _precondition(
        self, t: float, y: Array, yp: Array, res: Array, r: Array, z: Array, cj: float, delta: float
    ) -> None:
        s, c = self.system, self._cj
        g = s.as_motion(y[: s.nq], r[: s.nq])
        turn = s.tangent.solve(r[self._v_at] + c * s.tangent.inertia(g))
        if s.m:
            r3, r4 = r[self._lam_at], r[self._mu_at]
            both = self._reduced @ np.concatenate((r3 + self._J @ g - c * r4, r4 - self._J @ turn))
            z[self._lam_at], z[self._mu_at] = both[s.m :], both[: s.m]
            turn -= self._X @ both[: s.m] + self._A @ both[s.m :]
            g = g - both[: s.m] @ self._J
        z[: s.nq] = s.as_positions(y[: s.nq], turn)
        for i, _ in s.quaternions:  # their length
            e = y[i : i + 4]
            z[i : i + 4] += e * (e @ r[i : i + 4]) / (c + self._length_rate)
        z[self._v_at] = c * turn - g

    def _advance(self, t: float) -> Code:
        with one_thread():
            return super()._advance(t)

    def _begin(self) -> Code:
        motion, m = self._motion, self.system.m
        code = motion.solve(self._t, self._q, self._v)
        if code is Code.OK:
            J, zeros = motion.terms.J, np.zeros(m)
            self._d[0] = TIKHONOV * self.options.rtol / motion.masses
            self._d[1] = TIKHONOV * self.options.rtol / inverse_squares(np.einsum("ij,ij->i", J, J))
            y = np.concatenate((self._q, self._v, motion.lam, zeros))
            yp = np.concatenate((motion.qdot, motion.a, zeros, zeros))
            self._ida.init_step(self._t, y, yp)
            self._works = self.system.works()
            self._begun_here()
            self._note(self._t, y, yp)
        return code

    def _take(self, t: float, y: Array) -> Code:
        q, v = y[: self.system.nq].copy(), y[self._v_at].copy()
        code = close(self.system, t, q, v)
        if code is Code.OK:
            self._t, self._q, self._v = t, q, v
        return code

    def _evaluate(self) -> tuple[Code, Array, Array]:
        code = self._motion.solve(self._t, self._q, self._v)
        return code, self._motion.a.copy(), self._motion.lam.copy()

    @property
    def statistics(self) -> Statistics:
        """What the run has cost so far; IDA's order and step size are not available."""
        return Statistics(
            steps=int(self._counts[STEPS]),
            rhs_evals=int(self._counts[RESIDUALS]),
            restarts=max(0, int(self._begun[0]) - 1),
        )

"""SUNDIALS IDA on the stabilised equations of constrained motion ('ida').

Unknowns y = (q, v, lambda, mu), variable-order BDF. The form is Gear, Gupta and Leimkuhler's::

    q' - N(q) (v - S J~^T mu) + k (q - unit(q)) = 0      M v' + h + J~^T S^-1 lambda = 0
    R^-1 (J v - nu) - D lambda = 0                       R^-1 Phi - d mu = 0

in units of coordinates and rows, S and R, J~ = R^-1 J S (:mod:`solvers.workspace`); lambda is in units of R. Two small
terms make it regular where J~ loses rank:

- d = MU u / rtol |J~|^2 / rate. mu vanishes on the solution, so d has no bias; residuals of positions just return
  within d / sigma^2. It bounds what rounding in Phi does to v along a vanishing direction, u / (sigma^2 + d c_j) and
  not u / sigma^2: to the tolerance, where steps are shorter than MU / rate. It must not be larger: what it leaves of
  Phi at a crossing turns v by Phi / sigma^2.
- D = LAMBDA a (1 + A / (FILTER tr A))^-2 / rate with A = J~ J~^T and a = tr J~ M~^-1 J~^T. lambda does not vanish on
  the solution, it may even be unbounded, and D |lambda|^2 is a loss of power. D is of the size of a on rows without
  rank only, redundant ones and those that vanish at a crossing, and nothing on others, however near.

Such small terms need a Newton matrix that is no older than the iterate in J and M: with a matrix kept from before a
singular position the iteration contracts as the change of sigma to sqrt(sigma^2 + d c_j) and diverges. So J and M are
taken where the residual has just been evaluated, and only K, the derivative of the rest, is kept. IDA's own direct
solvers keep their factors; what serves is its iterative one with an exact preconditioner. The product of matrix and
vector is declared to be the vector, which the preconditioner then takes as solved: one iteration is exact.

After each step the way is looked over (:mod:`solvers.singular`). A step that may have jumped to another branch is taken
back: IDA starts anew where it began and does not step so far. Beside a near miss positions must be known better than
its gap, or the other branch is as near: D goes but for redundant rows, and d as far as rounding lets it.

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
from sksundae.ida import IDAJacTimes, IDAPrecond

from .dense import factor_lu, solve_lu
from .held import hold
from .kernel import inlined, kernel, records
from .ledger import BOOK, WORK, Scales, catch_up, report
from .partition import close_report
from .quiet import IDA
from .singular import MISS, note, passed, step_bound
from .stepper import Code, DenseStepper, Options, Statistics, Stepper
from .system import Array, System
from .workspace import factor

LAMBDA, FILTER, MU = 1e-10, 1e-13, 1e-2  # see above
FINEST = 5e-10  # a tighter rtol is run as this one: below it roundoff in J grows faster than the BDF error falls
# IDA bounds the error of a step and the errors add up. At order 5 a step is as rtol^(1/6) and so the sum as the step's
# error^(5/6): for a motion's error in proportion to rtol IDA is given TIGHTER rtol^POWER, and atol in proportion.
TIGHTER, POWER = 3.0, 1.2
UNCONTROLLED = 1e20  # absolute tolerance of the multipliers, in their units
LENGTH_RATE = 10.0  # k, in units of the motion's rate
STEPS_A_CALL = 5000  # then progress is looked at
STANDSTILL = 1e-10  # relative to t or one over the rate: less progress in STEPS_A_CALL steps is a collapse
COUNTS = 7  # see Unknowns.counts
BEGUN, LATEST, STEPS, REFUSED = 3, 4, 5, 6  # places in them
TOO_MUCH_WORK = -1  # IDA's status for STEPS_A_CALL steps taken
BELOW = 0.2  # part of a near miss's gap that the residual of a step beside it must stay below
LESS = 1e-4  # of D beside a near miss, where redundant rows are all that needs it
NOISE = 3e-16  # relative rounding of a residual
SHORTER = 0.25  # of a step that was taken back may be gone at once


class Unknowns(NamedTuple):
    """Writable copies of what IDA passes, and scratch of residual and solution; N = nq + n + 2 m."""

    y: Array  # (N,)    q, v, lambda, mu
    yp: Array  # (N,)
    res: Array  # (N,)    residual
    beside: Array  # (N,)    residual at a neighbour
    q: Array  # (nq,)
    v: Array  # (n,)
    drift: Array  # (n,)    v - S J~^T mu
    qdot: Array  # (nq,)   N (v - S J~^T mu)
    unit: Array  # (nq,)   q with unit quaternions
    zero: Array  # (n,)
    d: Array  # (2,)    LAMBDA a / rate, d
    usual: Array  # (2,)    these two away from near misses
    noise: Array  # (1,)    rounding to IDA's relative tolerance
    F: Array  # (m, m)  FILTER tr A + A, its factors
    Dlam: Array  # (m,)    D lambda
    lam: Array  # (m,)    lambda in its own units
    D: Array  # (m, m)  D
    at: Array  # (N,)    where terms were evaluated last
    solved: Array  # (N,)    where the matrix was factored last
    key: Array  # (3,)    t of ``at``; t and c_j of ``solved``
    K: Array  # (N, nq + n)  derivative of the residual by q and v
    N: Array  # (nq, n)  N(q) where K was taken
    matrix: Array  # (N, N)  the Newton matrix in units of rows and columns, its factors
    rows: Array  # (N,)    unit of every residual
    columns: Array  # (N,)    unit of every unknown
    order: NDArray[np.int64]  # (N,) int64
    right: Array  # (N,)
    left: Array  # (N,)
    product: Array  # (N,)    the vector whose product was asked for
    asked: Array  # (1,)    whether it was
    counts: Array  # (COUNTS,)  residuals, matrices K, residuals that were not finite, steps begun, latest time; where
    #                steps are looked over, steps and those taken back

    @staticmethod
    def allocate(nq: int, n: int, m: int) -> Unknowns:
        """Return zeroed arrays for ``nq`` positions, ``n`` velocities and ``m`` constraints."""
        N, z = nq + n + 2 * m, np.zeros
        return Unknowns(
            z(N), z(N), z(N), z(N), z(nq), z(n), z(n), z(nq), z(nq), z(n), z(2), z(2), z(1), z((m, m)), z(m), z(m),
            z((m, m)), np.full(N, np.nan), np.full(N, np.nan), z(3), z((N, nq + n)), z((nq, n)), z((N, N)),
            z(N), z(N), np.zeros(N, np.int64), z(N), z(N), z(N), z(1), z(COUNTS),
        )  # fmt: skip


@kernel
def balance(eqs: Any, t: float, u: Any, work: Any, res: Any) -> None:
    """Residual (N,) at (u.y, u.yp), module docstring; leaves ``terms`` at (q, v)."""
    terms, nq = eqs.terms, u.q.shape[0]
    m, n = terms.J.shape
    lam, mu = nq + n, nq + n + m
    for i in range(nq):
        u.q[i] = u.y[i]
        u.unit[i] = u.y[i]
    for i in range(n):
        u.v[i] = u.y[nq + i]
    drift_rate(eqs, t, u, work)
    eqs.dynamics(t, u.q, u.v, eqs.data, terms)
    if nq == n:
        drift(terms, u, work)
        for i in range(n):
            u.qdot[i] = terms.qdot[i] + u.drift[i] - u.v[i]
    for i in range(nq):
        res[i] = u.yp[i] - u.qdot[i] + LENGTH_RATE * work.rate[0] * (u.q[i] - u.unit[i])
    for i in range(n):
        res[nq + i] = terms.h[i]
        for j in range(n):
            res[nq + i] += terms.M[i, j] * u.yp[nq + j]
        for row in range(m):
            res[nq + i] += terms.J[row, i] * u.y[lam + row] / work.row[row]
    filter_multipliers(u, work, terms)
    for row in range(m):
        res[lam + row] = -terms.nu[row]
        for j in range(n):
            res[lam + row] += terms.J[row, j] * u.v[j]
        res[lam + row] = res[lam + row] / work.row[row] - u.Dlam[row]
        res[mu + row] = terms.Phi[row] / work.row[row] - u.d[1] * u.y[mu + row]


@inlined
def drift(terms: Any, u: Any, work: Any) -> None:
    """v - S J~^T mu from ``terms``."""
    m, n = terms.J.shape
    for i in range(n):
        u.drift[i] = u.v[i]
        for row in range(m):
            u.drift[i] -= work.size[i] ** 2 * terms.J[row, i] / work.row[row] * u.y[u.y.shape[0] - m + row]


@kernel
def drift_rate(eqs: Any, t: float, u: Any, work: Any) -> None:
    """Where q holds quaternions: N (v - S J~^T mu) by a second evaluation, and the unit quaternions."""
    if u.q.shape[0] == u.v.shape[0]:
        return
    eqs.position(t, u.q, eqs.data, eqs.terms)
    drift(eqs.terms, u, work)
    eqs.dynamics(t, u.q, u.drift, eqs.data, eqs.terms)
    for i in range(u.q.shape[0]):
        u.qdot[i] = eqs.terms.qdot[i]
    eqs.retract(u.unit, u.zero, eqs.data)


@kernel
def filter_matrix(u: Any, work: Any, terms: Any) -> float:
    """u.F = FILTER tr A + A; return FILTER tr A."""
    m, n = terms.J.shape
    trace = 0.0
    for i in range(m):
        for j in range(i + 1):
            u.F[i, j] = 0.0
            for k in range(n):
                u.F[i, j] += terms.J[i, k] * terms.J[j, k] * work.size[k] ** 2
            u.F[i, j] /= work.row[i] * work.row[j]
            u.F[j, i] = u.F[i, j]
        trace += u.F[i, i]
    for i in range(m):
        u.F[i, i] += FILTER * trace
    return FILTER * trace


@kernel
def filter_multipliers(u: Any, work: Any, terms: Any) -> None:
    """u.Dlam = D lambda."""
    m = terms.J.shape[0]
    if m == 0:
        return
    size = filter_matrix(u, work, terms)
    factor_lu(u.F, m, work.order)
    for i in range(m):
        work.b[i] = u.y[u.y.shape[0] - 2 * m + i]
    solve_lu(u.F, m, work.order, work.b, work.x)
    solve_lu(u.F, m, work.order, work.x, u.Dlam)
    for i in range(m):
        u.Dlam[i] *= u.d[0] * size * size


@kernel
def load(t: float, y: Any, yp: Any, u: Any) -> None:
    """Copy IDA's read-only arrays."""
    u.key[0] = t
    for i in range(y.shape[0]):
        u.y[i] = y[i]
        u.yp[i] = yp[i]
        u.at[i] = y[i]


@kernel
def count(counts: Any, t: float) -> None:
    """Count a step as begun: IDA evaluates at a new time for each that it tries."""
    if t != counts[LATEST]:
        counts[LATEST] = t
        counts[BEGUN] += 1.0


@kernel
def residual(eqs: Any, t: float, y: Any, yp: Any, res: Any, u: Any, work: Any) -> None:
    """IDA's residual function; what is not finite IDA takes as a sign to cut the step."""
    load(t, y, yp, u)
    balance(eqs, t, u, work, res)
    u.counts[0] += 1.0
    count(u.counts, t)
    for i in range(res.shape[0]):
        if not np.isfinite(res[i]):
            u.counts[2] += 1.0
            return


@kernel
def set_up(eqs: Any, t: float, y: Any, yp: Any, u: Any, work: Any) -> None:
    """u.K: differences in q and v, all columns in one call; u.N. The part of y' is known."""
    nq, n = u.q.shape[0], u.v.shape[0]
    load(t, y, yp, u)
    u.counts[1] += 1.0
    balance(eqs, t, u, work, u.res)
    for j in range(nq + n):
        natural = work.size_q[j] if j < nq else work.size[j - nq] * work.rate[0]
        step = 1.5e-8 * max(natural, abs(y[j]))
        u.y[j] = y[j] + step
        balance(eqs, t, u, work, u.beside)
        for i in range(y.shape[0]):
            u.K[i, j] = (u.beside[i] - u.res[i]) / step
        u.y[j] = y[j]
    for j in range(n):
        for i in range(n):
            u.v[i] = 1.0 if i == j else 0.0
        eqs.dynamics(t, u.q, u.v, eqs.data, eqs.terms)
        for i in range(nq):
            u.N[i, j] = eqs.terms.qdot[i]
    balance(eqs, t, u, work, u.res)
    u.key[2] = np.nan  # no factors


@kernel
def assemble(eqs: Any, u: Any, work: Any, cj: float) -> None:
    """u.matrix: d res / d y + cj d res / d y', from K and what ``terms`` hold."""
    terms, nq = eqs.terms, u.q.shape[0]
    m, n = terms.J.shape
    lam, mu, N = nq + n, nq + n + m, u.y.shape[0]
    A = u.matrix
    for i in range(N):
        for j in range(N):
            A[i, j] = u.K[i, j] if j < lam else 0.0
    for i in range(nq):
        A[i, i] += cj
    for i in range(n):
        for j in range(n):
            A[nq + i, nq + j] += cj * terms.M[i, j]
    filter_block(u, work, terms)
    for row in range(m):
        for i in range(n):
            entry = terms.J[row, i] / work.row[row]
            A[nq + i, lam + row] = entry
            A[lam + row, nq + i] = entry
            if nq == n:
                A[i, mu + row] = work.size[i] ** 2 * entry
                A[mu + row, i] = entry
            else:
                for k in range(nq):
                    A[k, mu + row] += u.N[k, i] * work.size[i] ** 2 * entry
        for other in range(m):
            A[lam + row, lam + other] = -u.D[row, other]
        A[mu + row, mu + row] = -u.d[1]


@kernel
def filter_block(u: Any, work: Any, terms: Any) -> None:
    """u.D = D, column by column."""
    m = terms.J.shape[0]
    if m == 0:
        return
    size = filter_matrix(u, work, terms)
    factor_lu(u.F, m, work.order)
    for k in range(m):
        for i in range(m):
            work.b[i] = u.d[0] * size * size if i == k else 0.0
        solve_lu(u.F, m, work.order, work.b, work.x)
        solve_lu(u.F, m, work.order, work.x, work.b)
        for i in range(m):
            u.D[i, k] = work.b[i]


@kernel
def solve(eqs: Any, t: float, y: Any, yp: Any, right: Any, left: Any, cj: float, u: Any, work: Any) -> None:
    """The preconditioner: left = matrix^-1 right with J and M of this iterate, or the vector asked for before."""
    N = y.shape[0]
    if u.asked[0] == 1.0:
        u.asked[0] = 0.0
        for i in range(N):
            left[i] = u.product[i]
        return
    here, fresh = u.key[0] == t, u.key[1] == t and u.key[2] == cj
    for i in range(N):
        here = here and u.at[i] == y[i]
        fresh = fresh and u.solved[i] == y[i]
    if not fresh:
        if not here:
            load(t, y, yp, u)
            balance(eqs, t, u, work, u.res)
        assemble(eqs, u, work, cj)
        for i in range(N):
            for j in range(N):
                u.matrix[i, j] *= u.columns[j] / u.rows[i]
        factor_lu(u.matrix, N, u.order)
        u.key[1], u.key[2] = t, cj
        for i in range(N):
            u.solved[i] = y[i]
    for i in range(N):
        u.right[i] = right[i] / u.rows[i]
    solve_lu(u.matrix, N, u.order, u.right, u.left)
    for i in range(N):
        left[i] = u.left[i] * u.columns[i]


@kernel
def multiply(vector: Any, product: Any, u: Any) -> None:
    """The product of matrix and vector, for the preconditioner to undo."""
    u.asked[0] = 1.0
    for i in range(vector.shape[0]):
        u.product[i] = vector[i]
        product[i] = vector[i]


@kernel
def beside(eqs: Any, t: float, yp: Any, u: Any, work: Any, works: bool, res: Any) -> None:
    """After :func:`residual`: the residual W' - power of the work, the last unknown."""
    nq, n, m, last = u.q.shape[0], u.v.shape[0], eqs.terms.J.shape[0], yp.shape[0] - 1
    if works:
        for i in range(m):
            u.lam[i] = u.y[nq + n + i] / work.row[i]
        res[last] = yp[last] - eqs.power(t, u.q, u.v, u.yp[nq : nq + n], u.lam, eqs.data)


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
def reported(c: Any, work: float, row: Any) -> None:
    """Put what is booked into ``row``, W having moved to ``work``."""
    c[0].through += abs(work - row[0])
    report(c[0], work, row)


@inlined
def weak_residual(terms: Any, work: Any) -> float:
    """u . Phi~, u the forces that balance in the critical point."""
    total = 0.0
    for i in range(terms.Phi.shape[0]):
        total += work.u[i] * terms.Phi[i] / work.row[i]
    return total


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


class IDADriver(Stepper):
    """Calls IDA and takes its results: what every stepper around it shares.

    A stepper gives ``_ida``, ``_begin`` and ``_take``, and counts residuals, Jacobians and residuals that were not
    finite in ``_counts``.
    """

    _ida: IDA
    _counts: Array  # (3,)
    _begun: Array  # (1,) how often IDA has been initialised
    _pending: bool  # IDA is to be initialised at the reported state
    _book: NDArray[Any]  # (1,) record of ledger.BOOK

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
        return [self._reported, self._q, self._v, self._counts, self._begun, self._ledger, self._book]

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

        rtol = TIGHTER * self._rtol**POWER
        self._unknowns.noise[0] = NOISE / rtol
        tightened = rtol if o.atol is None else o.atol * rtol / self._rtol
        place = tightened * s.size
        self._scales = hold(Scales.of(rtol, place, self._units.pace * place, size))
        atol = UNCONTROLLED * np.append(self._scaling()[0], 1.0)[:size]
        atol[:controlled] = tightened * np.concatenate((self._units.size_q, self._units.pace * s.size))
        return IDA(
            resfn,
            linsolver="gmres",
            precond=IDAPrecond(setup, precondition),
            jactimes=IDAJacTimes(None, times),
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
        taken, bad = 0, self._counts[2]
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
                if self._counts[2] > bad or self._begun_at == self._good[0]:
                    return Code.NOT_FINITE if self._counts[2] > bad else Code.COLLAPSED
                code = self._resume()  # with a new history
                if code is not Code.OK:
                    return code
                continue
            if float(result.t) <= before:
                continue  # it had interpolated, and tells where it stands first
            taken += 1
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
        residuals, matrices = self._counts[:2]
        steps, refused = self._counts[STEPS], self._counts[REFUSED]
        columns = self.system.nq + 2 * self.system.n + 1
        return Statistics(
            steps=int(steps),
            rejected=int(refused),
            refused=int(refused),
            rhs_evals=int(residuals + columns * matrices),
            restarts=max(0, int(self._begun[0]) - 1),
        )

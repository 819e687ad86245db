"""SUNDIALS IDA on the stabilized equations of constrained motion ('ida'): variable-order BDF on :mod:`.ggl`.

After each step jumps between branches are detected (:mod:`solvers.projection.singular`). A step that may have jumped to
another branch is rejected: IDA restarts from its beginning with a shorter step. A crossing is jumped over. Near a near
miss positions must be more accurate than its gap, or the other branch is as near: D is removed except for redundant
rows, and d as far as rounding lets it.

If a motion is so slow that D affects it, as where it reverses in a singular configuration, D takes from it what it
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

from solvers.codes import coded
from solvers.compiled.tuple_pointer import pin
from solvers.energy_account import WORK, EnergyScales, restart_work
from solvers.inertia import describe_large_growth, update_growth
from solvers.options import Options
from solvers.outcome import Code
from solvers.projection.reported import project_reported_state
from solvers.steppers.dense import DenseStepper
from solvers.steppers.step_control import TRUNCATED_STEPS
from solvers.system import Array, System

from .binding import BoundIDA
from .dense_callbacks import (
    DENSE_CALLBACKS,
    ITERATIVE_CALLBACKS,
    RTOL_EXPONENT,
    Given,
    accept,
    book,
    call_accept,
    look_over,
)
from .driver import IDADriver
from .ggl import (
    LAMBDA,
    MU,
    Unknowns,
    assemble,
    multiply,
    residual,
    set_up,
    solve,
    tie,
)
from .loop import JACOBIANS, MAX_CONVERGENCE_FAILURES, RESIDUALS, STANDSTILL_RATIO
from .sundials import DirectIDA, serves

MIN_RTOL = 1e-9  # a tighter rtol is run as this one: below it roundoff in J grows faster than the BDF error falls
# IDA bounds the error of a step and the errors add up. At order 5 a step is as rtol^(1/6) and so the sum as the step's
# error^(5/6): for a motion's error in proportion to rtol IDA is given RTOL_FACTOR rtol^RTOL_EXPONENT, and atol in
# proportion.
RTOL_FACTOR = 3.0
MAX_ORDER = 5  # of BDF
MULTIPLIER_TOLERANCE = 1e20  # absolute tolerance of the multipliers, in their units
BRANCH_DISTANCE_RATIO = 10.0  # times rtol: branches that are no farther apart, in units of size, are one
# Times rtol: speed that D may take from loops in a singular configuration, in units of theirs. In a period of the
# motion that makes an error of some 60 rtol.
SPEED_LOSS_RATIO = 10.0
# Rate of the friction by redundant constraint equations, in units of rtol and the rate of the motion.
REDUNDANCY_FRICTION = 1e-3
RESIDUAL_ROUNDING = 3e-16  # relative rounding of a residual
MAX_SHIFT_RATIO = 3.0  # ramp of the velocities, in units of them and of their absolute tolerance to the relative one


class IDAStepper(IDADriver, DenseStepper):
    """SUNDIALS IDA; see :mod:`solvers.steppers.ida.dense`. For stiff models; order at most 5."""

    def __init__(self, system: System, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        self._rtol = max(MIN_RTOL, self.options.rtol) if system.m else self.options.rtol
        self._unknowns = Unknowns.allocate(system.nq, system.n, system.m)
        self._held = pin(self._unknowns)
        self._counts = self._unknowns.counts
        self._good, self._atol = np.zeros((2, len(self._unknowns.y))), np.zeros(len(self._unknowns.y))
        self._place, self._pace = np.zeros(system.n), np.zeros(system.n)  # absolute tolerances, to the books
        self._tight = RTOL_FACTOR * self._rtol**RTOL_EXPONENT
        self._set_tolerances()
        self._ida = self._new_ida()

    def _set_tolerances(self) -> None:
        """Take tolerances in today's units, where IDA and the books have them."""
        s, u, units, controlled = self.system, self._unknowns, self._units, self.system.nq + self.system.n
        u.noise[0], u.near[0] = RESIDUAL_ROUNDING / self._tight, BRANCH_DISTANCE_RATIO * self._rtol
        tightened = self._tight if self.options.atol is None else self.options.atol * self._tight / self._rtol
        self._atol[:] = MULTIPLIER_TOLERANCE * self._scaling()[0]
        self._atol[:controlled] = tightened * np.concatenate((units.size_q, units.pace * s.size))
        self._place[:] = tightened * s.size
        self._pace[:] = units.pace * self._place
        self._c["instant"] = STANDSTILL_RATIO / units.rate[0]

    def _new_ida(self) -> DirectIDA | BoundIDA:
        o, count = self.options, len(self._atol)
        tighter = self._tight / self._rtol
        self._scales = pin(EnergyScales.of(self._tight, self._place, self._pace, count, (tighter, tighter)))
        given = Given(
            self._eqs, self._held, self._work, self._rank, count, self._book, self._scales, self._counts, self._course,
            self._good, np.array([SPEED_LOSS_RATIO * self._rtol]), self._tight, self._atol,
        )  # fmt: skip
        order = o.max_order or MAX_ORDER
        options: dict[str, Any] = {"rtol": self._tight, "atol": self._atol, "max_order": order}
        if serves():
            callbacks = ITERATIVE_CALLBACKS if self.system.m else DENSE_CALLBACKS
            return DirectIDA(callbacks, call_accept, pin(given), max_step=o.max_step, **options)
        return self._bound_ida(pin(given), options)

    def _bound_ida(self, given: Any, options: dict[str, Any]) -> BoundIDA:
        """Return IDA with the same kernels for callbacks, by way of Python."""
        s, u, work, eqs = self.system, self._held, self._work, self._eqs

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
        max_step = 0.0 if np.isinf(self.options.max_step) else self.options.max_step
        return BoundIDA(
            resfn, lambda t, y, slopes, _: accept(t, y, slopes, given), self._counts, self._course,
            **(fresh if s.m else {"jacfn": dense}), max_step=max_step,
            max_conv_fails=MAX_CONVERGENCE_FAILURES, **options,
        )  # fmt: skip

    def _begin(self) -> Code:
        """Initialize IDA at the reported state with consistent derivatives."""
        s, u, w = self.system, self._unknowns, self._units
        code, a, lam = self._evaluate()
        if code is not Code.OK:
            return code
        update_growth(self._t, self._terms.M, self._v, self._work)
        if s.m:
            u.usual[:], u.redundant[:] = self._regularization()
            u.d[:] = u.usual
        zeros = np.zeros(s.m)
        y = np.concatenate((self._q, self._v, lam * w.row, zeros))
        yp = np.concatenate((self._terms.qdot, a, zeros, zeros))
        u.at[:], u.lift[:] = np.nan, 0.0
        u.asked[0] = 0.0
        u.columns[:], u.rows[:] = self._scaling()
        self._begin_with(y, yp)
        self._good[:] = y, yp
        w.branch_history["pivot_ratio"] = 0.0  # what is known of the branch holds
        if s.m:
            bound = look_over(self._eqs, self._t, y, 0.0, self._rank, self._held, self._work)
            self._c["reach"] = min(self._c["reach"], bound)
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

    def _regularization(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return D on rows without rank and d, then the coefficients of redundant equations in these two.

        M may be singular across the motion; there J~ stands in.
        """
        w, terms = self._units, self._terms
        J = terms.J * (self.system.size / w.row[:, None])
        M = terms.M * np.outer(self.system.size, self.system.size)
        square = np.linalg.norm(J, 2) ** 2
        mobile = np.linalg.solve(M + np.trace(M) / (self.system.n * square) * J.T @ J, J.T)
        lam, mu = np.trace(J @ mobile) / w.rate[0], square / w.rate[0]
        share = self._tight**2 / (REDUNDANCY_FRICTION * self._rtol)
        return (LAMBDA * lam, self._unknowns.noise[0] * MU * mu), (share * lam, share * mu)

    def _note(self, t: float, y: Array, yp: Array) -> None:
        if self.options.energy_check:
            book(self._eqs, t, y, yp, self._works(), self._held, self._work, self._book, self._scales)

    def _works(self) -> bool:
        return self.system.works()

    def continue_after_event(self) -> None:
        """Go on with IDA's history where its last step ends at the reported time; let the next ones end where asked."""
        keeps = not self._pending and self._c["passed"] == self._t and self.status.ok
        if not (keeps and self._ramp_is_low(self._t) and self._tied()):
            self.restart()
        self._c["stops"] = TRUNCATED_STEPS

    def _ramp_is_low(self, t: float) -> bool:
        """Whether IDA's unknowns are of the size of the velocities until t (s): relative tolerances are of them."""
        u = self._unknowns
        ramp = u.lift[0] + (t - u.since[0]) * u.lift[1]
        return bool(np.all(np.abs(ramp) <= MAX_SHIFT_RATIO * (np.abs(self._v) + self._units.pace * self.system.size)))

    def _advance(self, t: float) -> Code:
        if self._unknowns.lift[1].any() and not self._ramp_is_low(t):
            self.restart()
        return super()._advance(t)

    def _tied(self) -> bool:
        """Let IDA's history go on to today's accelerations, and the books begin another piece; False: they are none."""
        code, a, lam = self._evaluate()
        if code is not Code.OK:
            return False
        here, slopes = self._good.copy()
        tie(self._t, a, slopes, self._held)
        self._unknowns.at[:], self._c["works"] = np.nan, int(self._works())
        restart_work(self._book, self._energy_account[WORK])
        first = self.system.nq + self.system.n
        here[first : first + self.system.m] = lam * self._units.row
        self._note(self._t, here, slopes)
        return True

    def _resume(self) -> Code:
        code = self._take(float(self._c["passed"]), self._good[0])
        if code is not Code.OK:
            return code
        self._tell()
        book = self._book[0]
        passage = book["open_passage_energy"], book["kinetic_max_since_passage"]
        code = self._begin()
        book["open_passage_energy"], book["kinetic_max_since_passage"] = passage  # the motion is the same
        return code

    def arrays(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.stepper.Stepper.arrays`."""
        return [*super().arrays(), *self._units.memory()]

    def restore(self, data: bytes) -> None:
        """Set a reported state and the units of its integration; the history restarts."""
        super().restore(data)
        self._set_tolerances()

    def _take(self, t: float, y: Array) -> Code:
        u, nq = self._unknowns, self.system.nq
        q, v = y[:nq].copy(), y[nq : nq + self.system.n] + u.lift[0] + (t - u.since[0]) * u.lift[1]
        code = Code(project_reported_state(self._eqs, t, q, v, self._rank, self._work))
        if code is Code.OK:
            self._t, self._q, self._v = t, q, v
        return code

    def _growth(self) -> tuple[float, float]:
        return DenseStepper._growth(self)

    @property
    def warning(self) -> str:
        """Whether the tolerance is larger than requested, or than the mass matrix requires."""
        large = describe_large_growth(self._units.inertia) if isinstance(self._ida, BoundIDA) else ""
        if large:
            text = f"{large}, and 'ida' without the C functions of SUNDIALS 7 cannot compensate that. Use 'adams'"
            return coded("ill-conditioned-mass", text)
        if self._rtol == self.options.rtol:
            return ""
        return coded(
            "limited-tolerance",
            f"'ida' uses a tolerance of {self._rtol:g} instead of {self.options.rtol:g}, because rounding errors of "
            "closed loops allow no smaller one. Use 'adams' if this is too large",
        )

    def _evaluations(self) -> int:
        columns = self.system.nq + 2 * self.system.n + 1
        return int(self._counts[RESIDUALS] + columns * self._counts[JACOBIANS])

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

from solvers.compiled.tuple_pointer import pin
from solvers.diagnostics import Diagnostic
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
    UserData,
    accept_step,
    call_accept,
    check_step,
    record_energy,
)
from .driver import IDADriver
from .ggl import (
    MULTIPLIER_REGULARIZATION,
    POSITION_REGULARIZATION,
    Unknowns,
    apply_preconditioner,
    assemble_matrix,
    matvec_passthrough,
    residual,
    set_up_preconditioner,
    update_velocity_shift,
)
from .loop import JACOBIANS, MAX_CONVERGENCE_FAILURES, MAX_ORDER, RESIDUALS, STANDSTILL_RATIO
from .sundials import DirectIDA, is_library_supported

MIN_RTOL = 1e-9  # a tighter rtol is run as this one: below it roundoff in J grows faster than the BDF error falls
# IDA bounds the error of a step and the errors add up. At order 5 a step is as rtol^(1/6) and so the sum as the step's
# error^(5/6): for a motion's error in proportion to rtol IDA is given RTOL_FACTOR rtol^RTOL_EXPONENT, and atol in
# proportion.
RTOL_FACTOR = 3.0
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
        self._pinned = pin(self._unknowns)
        self._counts = self._unknowns.counts
        self._last_accepted, self._atol = np.zeros((2, len(self._unknowns.y))), np.zeros(len(self._unknowns.y))
        self._position_tolerances, self._velocity_tolerances = (
            np.zeros(system.n),
            np.zeros(system.n),
        )  # absolute tolerances, to the books
        self._error_rtol = RTOL_FACTOR * self._rtol**RTOL_EXPONENT
        self._set_tolerances()
        self._ida = self._make_ida()

    def _set_tolerances(self) -> None:
        """Set the tolerances of IDA and of the energy account in the present units."""
        system, unknowns, units, controlled = (
            self.system,
            self._unknowns,
            self._workspace,
            self.system.nq + self.system.n,
        )
        unknowns.rounding[0], unknowns.branch_distance[0] = (
            RESIDUAL_ROUNDING / self._error_rtol,
            BRANCH_DISTANCE_RATIO * self._rtol,
        )
        tightened = self._error_rtol if self.options.atol is None else self.options.atol * self._error_rtol / self._rtol
        self._atol[:] = MULTIPLIER_TOLERANCE * self._scaling()[0]
        self._atol[:controlled] = tightened * np.concatenate((units.size_q, units.coordinate_rates * system.size))
        self._position_tolerances[:] = tightened * system.size
        self._velocity_tolerances[:] = units.coordinate_rates * self._position_tolerances
        self._progress["min_step"] = STANDSTILL_RATIO / units.rate[0]

    def _make_ida(self) -> DirectIDA | BoundIDA:
        options, count = self.options, len(self._atol)
        tighter = self._error_rtol / self._rtol
        self._scales = pin(
            EnergyScales.of(
                self._error_rtol, self._position_tolerances, self._velocity_tolerances, count, (tighter, tighter)
            )
        )
        user_data = UserData(
            self._eqs, self._pinned, self._work, self._rank, count, self._energy_record, self._scales, self._counts,
            self._progress_array, self._last_accepted, np.array([SPEED_LOSS_RATIO * self._rtol]), self._error_rtol,
            self._atol,
        )  # fmt: skip
        order = options.max_order or MAX_ORDER
        ida_options: dict[str, Any] = {"rtol": self._error_rtol, "atol": self._atol, "max_order": order}
        if is_library_supported():
            callbacks = ITERATIVE_CALLBACKS if self.system.m else DENSE_CALLBACKS
            return DirectIDA(callbacks, call_accept, pin(user_data), max_step=options.max_step, **ida_options)
        return self._bound_ida(pin(user_data), ida_options)

    def _bound_ida(self, user_data: Any, ida_options: dict[str, Any]) -> BoundIDA:
        """Return IDA with the same kernels for callbacks, called through Python."""
        system, unknowns, work, eqs = self.system, self._pinned, self._work, self._eqs

        def resfn(t: float, y: Array, yp: Array, res: Array) -> None:
            residual(eqs, t, y, yp, res, unknowns, work)

        def setup(t: float, y: Array, yp: Array, res: Array, cj: float) -> None:
            set_up_preconditioner(eqs, t, y, yp, unknowns, work)

        def precondition(
            t: float, y: Array, yp: Array, res: Array, right: Array, left: Array, cj: float, delta: float
        ) -> None:
            apply_preconditioner(eqs, t, y, yp, right, left, cj, unknowns, work)

        def times(t: float, y: Array, yp: Array, res: Array, vector: Array, product: Array, cj: float) -> None:
            matvec_passthrough(vector, product, unknowns)

        def dense(t: float, y: Array, yp: Array, res: Array, cj: float, matrix: Array) -> None:
            set_up_preconditioner(eqs, t, y, yp, unknowns, work)
            assemble_matrix(eqs, unknowns, work, cj)
            matrix[:] = self._unknowns.matrix

        fresh = {"linsolver": "gmres", "precond": IDAPrecond(setup, precondition), "jactimes": IDAJacTimes(None, times)}
        max_step = 0.0 if np.isinf(self.options.max_step) else self.options.max_step
        return BoundIDA(
            resfn, lambda t, y, slopes, _: accept_step(t, y, slopes, user_data), self._counts, self._progress_array,
            **(fresh if system.m else {"jacfn": dense}), max_step=max_step,
            max_conv_fails=MAX_CONVERGENCE_FAILURES, **ida_options,
        )  # fmt: skip

    def _begin(self) -> Code:
        """Initialize IDA at the reported state with consistent derivatives."""
        system, unknowns, workspace = self.system, self._unknowns, self._workspace
        code, a, lam = self.evaluate()
        if code is not Code.OK:
            return code
        update_growth(self._t, self._terms.M, self._v, self._work)
        if system.m:
            unknowns.d_default[:], unknowns.d_redundant[:] = self._regularization()
            unknowns.d[:] = unknowns.d_default
        zeros = np.zeros(system.m)
        y = np.concatenate((self._q, self._v, lam * workspace.row, zeros))
        yp = np.concatenate((self._terms.qdot, a, zeros, zeros))
        unknowns.evaluated_at[:], unknowns.velocity_shift[:] = np.nan, 0.0
        unknowns.is_pending[0] = 0.0
        unknowns.columns[:], unknowns.rows[:] = self._scaling()
        self._begin_with(y, yp)
        self._last_accepted[:] = y, yp
        workspace.branch_history["pivot_ratio"] = 0.0  # what is known of the branch holds
        if system.m:
            bound = check_step(self._eqs, self._t, y, 0.0, self._rank, self._pinned, self._work)
            self._progress["max_next_step"] = min(self._progress["max_next_step"], bound)
        self._record_energy(self._t, y, yp)
        return Code.OK

    def _scaling(self) -> tuple[Array, Array]:
        """Return the units of unknowns and residuals (N,): pivots are not to depend on meters and kilograms."""
        system, workspace = self.system, self._workspace
        rate, one = workspace.rate[0], np.ones(system.m)
        inertia = self._terms.M * np.outer(system.size, system.size)
        energy = (np.trace(inertia) / max(1, system.n) or 1.0) * rate**2
        columns = workspace.size_q, system.size * rate, one * energy, one * rate
        rows = workspace.size_q * rate, energy / system.size, one * rate, one
        return np.concatenate(columns), np.concatenate(rows)

    def _regularization(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return D on rows without rank and d, then the coefficients of redundant equations in these two.

        M may be singular across the motion; there J~ stands in.
        """
        workspace, terms = self._workspace, self._terms
        J = terms.J * (self.system.size / workspace.row[:, None])
        M = terms.M * np.outer(self.system.size, self.system.size)
        square = np.linalg.norm(J, 2) ** 2
        mobile = np.linalg.solve(M + np.trace(M) / (self.system.n * square) * J.T @ J, J.T)
        lam, mu = np.trace(J @ mobile) / workspace.rate[0], square / workspace.rate[0]
        share = self._error_rtol**2 / (REDUNDANCY_FRICTION * self._rtol)
        return (MULTIPLIER_REGULARIZATION * lam, self._unknowns.rounding[0] * POSITION_REGULARIZATION * mu), (
            share * lam,
            share * mu,
        )

    def _record_energy(self, t: float, y: Array, yp: Array) -> None:
        if self.options.energy_check:
            record_energy(
                self._eqs, t, y, yp, self._has_work(), self._pinned, self._work, self._energy_record, self._scales
            )

    def _has_work(self) -> bool:
        return self.system.works()

    def continue_after_event(self) -> None:
        """Continue IDA's history if its last step ends at the reported time; the next steps end at the targets."""
        keeps = not self._pending and self._progress["t_reached"] == self._t and self.status.ok
        if not (keeps and self._is_shift_small(self._t) and self._update_velocity_shift()):
            self.restart()
        self._progress["truncated_steps"] = TRUNCATED_STEPS

    def _is_shift_small(self, t: float) -> bool:
        """Whether IDA's unknowns are of the size of the velocities until t (s): relative tolerances are of them."""
        unknowns = self._unknowns
        ramp = unknowns.velocity_shift[0] + (t - unknowns.shift_start[0]) * unknowns.velocity_shift[1]
        return bool(
            np.all(
                np.abs(ramp)
                <= MAX_SHIFT_RATIO * (np.abs(self._v) + self._workspace.coordinate_rates * self.system.size)
            )
        )

    def advance_to(self, t: float) -> Code:
        """As :meth:`solvers.stepper.Stepper.advance_to`."""
        if self._unknowns.velocity_shift[1].any() and not self._is_shift_small(t):
            self.restart()
        return super().advance_to(t)

    def _update_velocity_shift(self) -> bool:
        """Continue IDA's history with the present accelerations, if there are any, and begin a new interval of work."""
        code, a, lam = self.evaluate()
        if code is not Code.OK:
            return False
        here, slopes = self._last_accepted.copy()
        update_velocity_shift(self._t, a, slopes, self._pinned)
        self._unknowns.evaluated_at[:], self._progress["works"] = np.nan, int(self._has_work())
        restart_work(self._energy_record, self._energy_account[WORK])
        first = self.system.nq + self.system.n
        here[first : first + self.system.m] = lam * self._workspace.row
        self._record_energy(self._t, here, slopes)
        return True

    def _resume(self) -> Code:
        code = self._report_unknowns(float(self._progress["t_reached"]), self._last_accepted[0])
        if code is not Code.OK:
            return code
        self._report_energy()
        record_energy = self._energy_record[0]
        passage = record_energy["open_passage_energy"], record_energy["kinetic_max_since_passage"]
        code = self._begin()
        record_energy["open_passage_energy"], record_energy["kinetic_max_since_passage"] = (
            passage  # the motion is the same
        )
        return code

    def arrays(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.stepper.Stepper.arrays`."""
        return [*super().arrays(), *self._workspace.memory()]

    def restore(self, data: bytes) -> None:
        """Set a reported state and the units of its integration; the history restarts."""
        super().restore(data)
        self._set_tolerances()

    def _report_unknowns(self, t: float, y: Array) -> Code:
        unknowns, nq = self._unknowns, self.system.nq
        q, v = (
            y[:nq].copy(),
            y[nq : nq + self.system.n]
            + unknowns.velocity_shift[0]
            + (t - unknowns.shift_start[0]) * unknowns.velocity_shift[1],
        )
        code = Code(project_reported_state(self._eqs, t, q, v, self._rank, self._work))
        if code is Code.OK:
            self._t, self._q, self._v = t, q, v
        return code

    def _growth(self) -> tuple[float, float]:
        return DenseStepper._growth(self)

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Whether the tolerance is larger than requested, or than the mass matrix requires."""
        large = describe_large_growth(self._workspace.inertia) if isinstance(self._ida, BoundIDA) else ""
        if large:
            text = f"{large}, and 'ida' without the C functions of SUNDIALS 7 cannot compensate that"
            since = float(self._workspace.inertia[0]["large_since"])
            return (Diagnostic.warning("ill-conditioned-mass", text, "Use 'adams'", subject="ida", time=since),)
        if self._rtol == self.options.rtol:
            return ()
        return (
            Diagnostic.warning(
                "limited-tolerance",
                f"'ida' uses a tolerance of {self._rtol:g} instead of {self.options.rtol:g}, because rounding errors "
                "of closed loops allow no smaller one",
                "Use 'adams' if this is too large",
                subject="ida",
            ),
        )

    def _evaluations(self) -> int:
        columns = self.system.nq + 2 * self.system.n + 1
        return int(self._counts[RESIDUALS] + columns * self._counts[JACOBIANS])

"""One-step methods in Python: the loop over the steps, and the solver whose formulas the user writes.

    y' = f(t, y),    y = (q, v, W)

Positions q (nq), velocities v (n) and the work W are integrated by the same formulas. The accelerations in f are
tangent to the constraints, so that the stages of a step need not be closed. The end of every step is projected onto
them, and no step is accepted that may have jumped to another branch (:mod:`solvers.projection.singular`). Steps end at
the requested time, where inputs may change: a step requires nothing of the step before it.

If the formulas have no error estimate, the step is repeated in two halves: with y1 the result of one step and y2 that
of two halves, (y2 - y1) / (2^p - 1) is the error of y2 for formulas of order p (Hairer, Norsett, Wanner, *Solving
Ordinary Differential Equations I*, 1993, section II.4, eq. 4.4).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import records
from solvers.compiled.tuple_pointer import pin
from solvers.energy_account import (
    ACCOUNT_FIELDS,
    WORK,
    energy_check_scheduled,
    fill_account_row,
    reset_check_schedule,
)
from solvers.options import Options, Statistics
from solvers.outcome import Code
from solvers.resolution import start_rate
from solvers.system import AnySystem, Array

from .formulation import formulate, record_work
from .python_loop import PythonLoopStepper
from .step_control import (
    FIRST_STEP_RATIO,
    MIN_RECORDED_ERROR,
    MIN_STEP_CHANGE,
    end_of_step,
    retry_step,
    step_factor,
    truncated_step,
)

Derivative = Callable[[float, Array], Array]  # (t, y) -> y'

MAX_STEP_CHANGE = 5.0  # next step in units of this one, at most
MAX_ORDER = 20  # highest order of formulas that is accepted
CONTROL = np.dtype(
    [
        *ACCOUNT_FIELDS,
        ("t", "f8"), ("h", "f8"), ("hold", "f8"),  # s: time reached, next step, last step
        ("work", "f8"),  # J, at the time reached
        ("last_error", "f8"), ("last_error_step", "f8"),  # of the last accepted step, and its size, s; 0: none
        ("start", "i8"),  # 1: the motion starts or continues after a change
        ("steps", "i8"), ("rejected", "i8"), ("refused", "i8"), ("evaluations", "i8"), ("starts", "i8"),
    ],
    align=True,
)  # fmt: skip


class StageFailure(Exception):
    """The equations have no solution at a stage; the step is repeated with another length."""

    def __init__(self, code: Code) -> None:
        super().__init__(code)
        self.code = code


class OneStepSolver(PythonLoopStepper):
    """A solver by a one-step method, whose formulas a subclass has in :meth:`step`; the rest is here.

    It integrates small and large models, with closed loops or without, with control of the step size, events, energy
    check and saved states. An exception in :meth:`step` ends the run with an error that names the solver.

    Attributes
    ----------
    order
        Order of the formulas, for the control of the step size: a whole number from 1 to 20.
    error_order
        Order of the estimated error: it is proportional to the step size to the power of ``error_order`` + 1. By
        default ``order``; of a pair of formulas that of the less accurate ones. A number above 0, at most 20.
    name
        Name of the solver; by default that of the class in lower case. Of an installed solver that of its entry point.
    is_explicit
        Whether the formulas are explicit, so that stiff models are refused.
    """

    order: ClassVar[int]
    error_order: ClassVar[float | None] = None
    name: ClassVar[str] = ""
    is_explicit: ClassVar[bool] = True
    fallback_solvers = ("adams", "ida")

    def __init__(self, system: AnySystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        self.system, options = system, self.options
        self.formulation = formulate(system, self._t, self._q, self._v, options)
        self.starts_singular = self.formulation.starts_singular
        self.status = self._status(self.formulation.status)
        self._record = records(1, CONTROL)
        self._control = self._record[0]
        self._scales = self.formulation.energy_scales(options)
        self._pinned_scales = pin(self._scales)
        units = np.concatenate((self.formulation.position_units, self.formulation.rate_units))
        self._absolute_tolerances = options.absolute * units
        self._max_step, self._has_work = options.max_step, False
        self._is_finite = True  # what the formulas returned last
        self.restart()

    @abstractmethod
    def step(self, f: Derivative, t: float, y: Array, h: float) -> Array | tuple[Array, Array]:
        """Return y at t + h.

        Parameters
        ----------
        f
            Function f(t, y) that returns y' as a new array.
        t
            Time at which the step begins, s.
        y
            Positions, velocities and work there (nq + n + 1,), not to be changed.
        h
            Step size, s.

        Returns
        -------
        ndarray or tuple
            y at the end of the step, or a tuple of this and its estimated error, real numbers each. Without an
            estimate the step is repeated in two halves. The arrays are copied: the solver may use them again.
        """

    def _prepare(self) -> Code:
        """Evaluate the state at which the motion starts or continues after a change."""
        control, form, t = self._control, self.formulation, float(self._control["t"])
        code = form.project(t, self._q, self._v)
        code = form.evaluate(t, self._q, self._v) if code is Code.OK else code
        if code is Code.OK:
            self._record_energy(t)
            if not control["h"] > 0.0:
                form.record_step(t, self._q, self._v, 0.0, 0.0)
                moving = self.system.n_velocities
                rate = start_rate(form.rate, np.inf, self.system.size, self._v[:moving], form.a)
                control["h"] = FIRST_STEP_RATIO / rate
            control["start"] = 0
            control["starts"] += 1
        return code

    def advance_to(self, t: float) -> Code:
        """As :meth:`solvers.stepper.Stepper.advance_to`; the last good state is reported if the formulas raise, too."""
        try:
            return super().advance_to(t)
        except Exception:
            self._report(t, Code.COLLAPSED)
            raise

    def _report(self, t: float, code: Code) -> Code:
        """Report where the last step ended: steps end at the requested times."""
        self._t = float(self._control["t"])
        fill_account_row(self._control, float(self._control["work"]), self._energy_account)
        return code

    def _record_energy(self, t: float) -> None:
        is_scheduled = self.options.energy_check and energy_check_scheduled(self._control)
        self.formulation.record_energy(t, self._q, self._v, self._record, self._pinned_scales, bool(is_scheduled))

    def _take_step(self, target: float) -> Code:
        """Attempt steps, shorter after each rejection, until one is accepted; or return why the last was rejected."""
        control, options, is_forced = self._control, self.options, False
        t, y = float(control["t"]), np.concatenate((self._q, self._v, [float(control["work"])]))
        scale = self.formulation.tolerance_scale(options.rtol, 1.0)
        tolerances = scale * (options.rtol * np.abs(y[:-1]) + self._absolute_tolerances)
        while True:
            control["h"] = min(control["h"], self._max_step)
            attempted = h = truncated_step(t, float(control["h"]), target)
            after = end_of_step(t, h, target)
            code, end, errors = self._attempt(t, y, h, after)
            error = float(np.linalg.norm(errors[:-1] / tolerances)) if code is Code.OK else np.inf
            if code is Code.OK and (error <= 1.0 or is_forced):
                self._accept(after, h, y, end, error, float(errors[-1]))
                return Code.OK
            control["rejected"] += 1
            control["corner_rejections"] += code is Code.OK
            control["h"] = h * (self._step_factor(h, error) if np.isfinite(error) else MIN_STEP_CHANGE)
            may_force = code is Code.OK and not is_forced
            h, forces = retry_step(float(control["h"]), self.formulation.rate, self._max_step, t, may_force)
            if h == 0.0:
                if not self._is_finite:
                    raise ArithmeticError(
                        f"step() of {type(self).__name__} returned a value that is not finite, with all step sizes "
                        f"down to {attempted:.3g} s"
                    )
                return Code.COLLAPSED if code is Code.OK else code
            control["h"], is_forced = h, is_forced or forces

    def _attempt(self, t: float, y: Array, h: float, after: float) -> tuple[Code, Array, Array]:
        """Return code, y at the end of a step of h, and its error; the state there is projected and evaluated."""
        form, nq, n = self.formulation, self.system.nq, self.system.n
        self._is_finite = True
        try:
            end, errors = self._step_with_error(t, y, h)
        except StageFailure as failure:
            return failure.code, y, y
        self._is_finite = bool(np.isfinite(end).all() and np.isfinite(errors).all())
        if not self._is_finite:
            return Code.NOT_FINITE, y, y
        q, v = end[:nq].copy(), end[nq : nq + n].copy()
        code = form.project(after, q, v)
        if code is Code.OK and not form.is_on_branch(after, q):
            self._control["refused"] += 1
            code = Code.BRANCHES
        code = form.evaluate(after, q, v) if code is Code.OK else code
        self._control["evaluations"] += 1
        return code, np.concatenate((q, v, end[-1:])), errors

    def _step_with_error(self, t: float, y: Array, h: float) -> tuple[Array, Array]:
        """Return y at the end of a step of h and its error, by the formulas or by two steps of half the length."""
        found = self.step(self._derivative, t, y, h)
        if isinstance(found, tuple):
            end, errors = found
            return self._checked(end), self._checked(errors)
        whole = self._checked(found)
        middle = self._checked(self.step(self._derivative, t, y, 0.5 * h))
        end = self._checked(self.step(self._derivative, t + 0.5 * h, middle, 0.5 * h))
        return end, (end - whole) / (2.0**self.order - 1.0)

    def _checked(self, found: Any, action: str = "step() of {} returns") -> Array:
        """Return a copy of an array that the formulas give, in which they may go on to write; raise for a wrong one."""
        size = self.system.nq + self.system.n + 1
        array = np.asarray(found)
        if array.shape != (size,) or array.dtype.kind not in "fiu":
            raise ValueError(
                f"{action.format(type(self).__name__)} an array of the shape {array.shape} and the type {array.dtype}; "
                f"allowed: that of y, ({size},), of real numbers"
            )
        return np.array(array, float)

    def _derivative(self, t: float, y: Array) -> Array:
        """Return y' (nq + n + 1,) at a state that need not be on the constraints."""
        form, nq, n = self.formulation, self.system.nq, self.system.n
        given = self._checked(y, "{} calls f(t, y) with")
        q, v = given[:nq].copy(), given[nq : nq + n].copy()
        code = form.evaluate_stage(t, q, v)
        self._control["evaluations"] += 1
        if code is not Code.OK:
            raise StageFailure(code)
        power = form.power(t, q, v) if self._has_work else 0.0
        return np.concatenate((form.qdot, form.a, [power]))

    def _accept(self, after: float, h: float, y: Array, end: Array, error: float, work_error: float) -> None:
        """Make the end of a step of h, evaluated last, the reported state; the next step is as its error allows."""
        control, nq, n = self._control, self.system.nq, self.system.n
        is_whole, longer = h >= control["h"], h * self._step_factor(h, error)
        control["t"], control["hold"], control["work"] = after, h, end[-1]
        self._q[:], self._v[:] = end[:nq], end[nq : nq + n]
        self._record_energy(after)
        record_work(self._record, float(end[-1] - y[-1]), work_error, h)
        control["h"] = longer if is_whole else max(control["h"], longer)
        limit = self.formulation.record_step(after, self._q, self._v, h, float(control["h"]))
        control["h"] = min(control["h"], limit)
        control["last_error"], control["last_error_step"] = max(error, MIN_RECORDED_ERROR), h
        control["steps"] += 1

    def _step_factor(self, h: float, error: float) -> float:
        """Return the factor of the next step after one of h, from this error and, if it was accepted, the last one."""
        control, order = self._control, self.order if self.error_order is None else self.error_order
        exponent = 1.0 / (order + 1.0)
        last_step = float(control["last_error_step"]) if error <= 1.0 else 0.0
        return float(step_factor(h, error, float(control["last_error"]), last_step, exponent, MAX_STEP_CHANGE))

    def evaluate(self) -> tuple[Code, Array, Array]:
        """As :meth:`solvers.stepper.Stepper.evaluate`."""
        form = self.formulation
        code = form.evaluate(self._t, self._q, self._v)
        return code, form.a.copy(), form.lam.copy()

    def _undetermined(self) -> bool:
        return self.formulation.has_unresolved_forces(self.options.rtol)

    def restart(self) -> None:
        """Restart at the reported state with a new step size."""
        self._control["h"] = 0.0
        self.continue_after_event()

    def continue_after_event(self) -> None:
        """Continue at the reported state with the present step size: the method has no history."""
        control = self._control
        control["t"], control["work"], control["start"] = self._t, self._energy_account[WORK], 1
        control["last_error_step"] = 0.0
        self._has_work = bool(self.options.energy_check and self.system.works())
        reset_check_schedule(self._record)

    @property
    def freedom(self) -> int:
        """Largest number of degrees of freedom; zero if drives prescribe the motion."""
        return self.formulation.freedom

    def arrays(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.stepper.Stepper.arrays`."""
        own = [self._record, self.clock, self._q, self._v, self._energy_account, self._scales.bound_results]
        return [*own, *self.formulation.memory()]

    def restore(self, data: bytes) -> None:
        """Restore the state in which ``data`` was saved, bit for bit."""
        super().restore(data)
        self._has_work = bool(self.options.energy_check and self.system.works())

    @property
    def statistics(self) -> Statistics:
        """Counters of the run so far."""
        control, growth = self._control, self.formulation.growth()[0]
        return Statistics(
            steps=int(control["steps"]),
            rejected=int(control["rejected"]),
            rhs_evals=int(control["evaluations"]),
            restarts=max(0, int(control["starts"]) - 1),
            order=self.order,
            step_size=float(control["hold"]),
            refused=int(control["refused"]),
            rate_growth=float(growth["largest"]),
            rate_growth_at=float(growth["at"]),
        )

"""ESDIRK3(2) on a large tree: 'esdirk'; the method is in :mod:`.formulas`.

For meshes of elements, whose fastest modes an explicit method must follow and this one damps. Newton's matrix is the
structured tangent, factored where the steps change or where corrections fall slowly, and kept over steps, times at
output and, where forces are smooth, jumps of the loads. It is taken as symmetric, which halves what a correction reads,
but where there is friction; loads that follow the bodies cost some more of them. Corrections are accelerated, which
makes up for most of what has changed since: a factorization costs as much as twenty of them. Cut joints are held by the
accelerations of every stage, with the tree's saddle system; where a step ends it is brought onto them.

Positions alone are controlled: their error is filtered by (c^2 M + c D + K)^-1 c^2 M, which leaves out of it what the
method damps. A step is kept as long as the last one unless it must be shorter or may be twice as long, since another
length needs other factors.

A step may pass the requested time, and is interpolated. After a jump of the loads the next ones end there: what a step
needs of the one before it are its accelerations alone.

**Which solver for which size.** In small mechanisms, by their matrices, Radau IIA needs less CPU time for the same
error. A compiled trial of this method on the loop of 'radau', with its Newton matrices, had an evaluation count per
step of 0.7 to 1 times that of 'radau', but errors of order 3: 1.3 to 1.8 times the CPU time of 'radau' at an error of
1e-3, 2 to 4 times at 1e-5 (four-bar, with and without a singular configuration, governor, triple pendulum and chain of
40 links with stiff joints). Radau IIA on trees would need T for a complex c in addition, at four times the work of a
real factorization, and five real solutions for a correction of its three stages, where this method needs three. At the
errors of meshes, 1e-3 to 1e-4, that costs more than the two to four times fewer steps save.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.tuple_pointer import pin, unpin
from solvers.diagnostics import Diagnostic
from solvers.energy_account import WORK, EnergyScales, fill_account_row, reset_check_schedule
from solvers.inertia import Growth, describe_large_growth, tolerance_factor
from solvers.options import Options, Statistics
from solvers.outcome import Code
from solvers.projection.saddle import Accelerations, Saddle, count_freedom, motion_rate, project
from solvers.stepper import require_resolution, start_rate
from solvers.steppers.python_loop import PythonLoopStepper
from solvers.steppers.step_control import (
    FIRST_STEP_RATIO,
    MIN_RECORDED_ERROR,
    TRUNCATED_STEPS,
    end_of_step,
    retry_step,
    step_factor,
    truncated_step,
)
from solvers.steppers.tree import TreeEquations
from solvers.system import MAX_SOLVER_DENSE_COORDINATES, Array, TreeSystem

from .formulas import (
    GAMMA,
    MAX_STAGE_CORRECTIONS,
    N_STAGES,
    C,
    Memory,
    Stage,
    accept_step,
    correct_stage,
    estimate_error,
    evaluate_start,
    interpolate,
    measure_correction,
    predict_residual,
    predict_stage,
    record_energy,
    residual,
    store_stage,
    update_inertia_growth,
)

ESDIRK_RATE_TOLERANCE_RATIO = 150.0  # tolerance of a rate in tolerances of its coordinate times the rate of the motion
# Of the tolerance, to which the estimated error of a step is held: the error of the motion adds up to more.
ERROR_TOLERANCE_RATIO = 0.2
# What Newton may leave of a stage, in these tolerances: STAGE_TOLERANCE, or DRIFT_FACTOR (h rate)^2. It has one sign in
# many steps, and the rate that it leaves behind, larger by 1 / (h gamma), adds up to a drift.
STAGE_TOLERANCE, DRIFT_FACTOR = 0.05, 6.0
ROUNDING_OF_CORRECTIONS = 1e-12  # in units of size
MIN_SQUARED_MOTION = 1e-16  # square of rate times step: in shorter steps all corrections but one are rounding errors
MIN_RTOL = 1e-10  # below it steps are so short that rounding errors add up to more than the tolerance
PROJECTION_ITERATIONS = 2  # of the projection onto the constraints with the factors of the stages
MAX_CONTRACTION = 0.7  # above this rate of convergence factors are renewed
MAX_REFACTORIZATIONS = 8  # within a stage
# After a failure of Newton at a step size this many steps are not longer than this part of it.
RETRY_STEPS, RETRY_STEP_RATIO = 8, 0.6
FIRST_CONTRACTION, MIN_CONTRACTION = 0.5, 0.1  # rate of convergence before the second correction; the least assumed
NEGLIGIBLE_CORRECTION = 0.02  # of the tolerance of a stage: a correction that need not decrease
FACTOR_REUSE_TOLERANCE = 1e-3  # part by which 1 / (h gamma) may be off that of the factors
ESDIRK_EXPONENT = 1.0 / 3.0  # of the estimate, of order 2
MIN_STEP_INCREASE, MAX_STEP_CHANGE = 2.0, 4.0  # next step in units of this one, if it is longer


class TreeESDIRKStepper(PythonLoopStepper):
    """ESDIRK3(2) on a large tree."""

    def __init__(self, system: TreeSystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        dense = ("adams", "hybrid") if system.n <= MAX_SOLVER_DENSE_COORDINATES else ()
        self.fallback_solvers = (*dense, "ida") if system.m else ("adams", "ida")
        super().__init__(system, t0, q0, v0, options)
        self._requested_rtol = self.options.rtol
        if self._requested_rtol < MIN_RTOL:
            self.options = replace(self.options, rtol=MIN_RTOL)
        self.system, options = system, self.options
        self._motion, self._saddle = Accelerations(system), Saddle(system)
        self._memory, self._stage = Memory.allocate(system.nq, system.n, system.m), Stage.of(system)
        self._control = self._memory.control[0]
        self._pinned = pin(self._memory), pin(self._stage)
        self._eqs = TreeEquations.of(system)
        self._rate = motion_rate(self._motion, self._t, self._q, self._v, options.duration)
        sizes = system.position_sizes(system.size)
        require_resolution(self._t, self._rate, self._q, sizes, options.rtol, system.coordinate_names)
        self._absolute_tolerances = options.absolute * system.size
        self._growth_data = Growth.of(system, self._rate)
        self._pinned_growth = pin(self._growth_data)
        rates = ESDIRK_RATE_TOLERANCE_RATIO * self._rate * self._absolute_tolerances
        self._scales = pin(
            EnergyScales.of_mesh(options.rtol, self._absolute_tolerances, rates, system.n, ESDIRK_RATE_TOLERANCE_RATIO)
        )
        self._has_work, self._max_step = 0, np.inf
        self._factor_count = -1  # how often the tangent had been factored when these factors were made
        self.status = self._status(project(system, self._t, self._q, self._v))
        self.restart()

    def _report(self, t: float, code: Code) -> Code:
        """Make the motion at t the reported state, or on failure where the last step ended."""
        control, memory = self._control, self._memory
        at, q, v, work = float(control["t"]), memory.q.copy(), memory.v.copy(), float(control["work"])
        if code is Code.OK and t < at:
            work = interpolate(t, *self._pinned, q, v)
            code = project(self.system, t, q, v)
            if code is not Code.OK:
                return code
            at = t
        if at >= self._t:
            self._t, self._q[:], self._v[:] = at, q, v
            fill_account_row(control, work, self._energy_account)
        return code

    def _prepare(self) -> Code:
        """Take accelerations where the next step begins."""
        control, memory = self._control, self._memory
        code = self._motion.solve(float(control["t"]), memory.q, memory.v)
        if code is Code.OK:
            memory.A[0], memory.lam[:] = self._motion.a, self._motion.lam
            evaluate_start(self._eqs, float(control["t"]), self._has_work, *self._pinned)
            if self.system.can_compute_rate_growth:
                update_inertia_growth(self._eqs, *self._pinned, self._pinned_growth)
            self._record_energy()
            control["start"] = 0
            control["starts"] += 1
            if not control["h"] > 0.0:
                control["h"] = FIRST_STEP_RATIO / start_rate(
                    self._rate, np.inf, self.system.size, memory.v, memory.A[0]
                )
        return code

    def _record_energy(self) -> None:
        if self.options.energy_check:
            record_energy(self._eqs, *self._pinned, self._scales)

    def _take_step(self, target: float) -> Code:
        """Attempt steps, shorter after each rejection, until one is accepted; or return the last rejection."""
        control, memory, stage = self._control, self._memory, self._stage
        stage.tol[:] = ERROR_TOLERANCE_RATIO * self._absolute_tolerances
        stage.tol[stage.in_v] += ERROR_TOLERANCE_RATIO * self.options.rtol * np.abs(memory.q[stage.in_q])
        stage.tol[:] *= tolerance_factor(self.options.rtol, 1.3, self._pinned_growth)
        while True:
            control["h"] = min(control["h"], self._max_step)
            t, h, is_truncated = float(control["t"]), float(control["h"]), bool(control["truncated_steps"])
            h = truncated_step(t, h, target) if is_truncated else h
            after = end_of_step(t, h, target) if is_truncated else t + h
            code, error = self._try_step(h, after)
            if code is Code.OK and error <= 1.0:
                break
            control["rejected"] += 1
            if code is Code.OK:
                control["h"] = h * step_factor(h, error, 0.0, 0.0, ESDIRK_EXPONENT, MAX_STEP_CHANGE)
            else:
                control["h"], control["failed_step"], control["retry_steps"] = 0.5 * h, h, RETRY_STEPS
            if retry_step(float(control["h"]), self._rate, self._max_step, t, False)[0] == 0.0:
                return Code.COLLAPSED if code is Code.OK else code
        whole, longer = h >= control["h"], self._next_step_size(h, error)
        control["last_error"], control["last_error_step"] = max(error, MIN_RECORDED_ERROR), h
        accept_step(h, after, *self._pinned)
        if self.system.can_compute_rate_growth:
            update_inertia_growth(self._eqs, *self._pinned, self._pinned_growth)
        self._record_energy()
        control["h"] = longer if whole else max(control["h"], longer)
        control["truncated_steps"] = max(0, control["truncated_steps"] - 1)
        return Code.OK

    def _next_step_size(self, h: float, error: float) -> float:
        """Return the next step after one of h from its error and that of the step before."""
        control = self._control
        last_error, last_step = float(control["last_error"]), float(control["last_error_step"])
        factor = step_factor(h, error, last_error, last_step, ESDIRK_EXPONENT, MAX_STEP_CHANGE)
        if control["retry_steps"] > 0:
            control["retry_steps"] -= 1
            factor = min(factor, max(1.0, RETRY_STEP_RATIO * control["failed_step"] / h))
        return h if 1.0 <= factor < MIN_STEP_INCREASE else h * factor

    def _try_step(self, h: float, after: float) -> tuple[Code, float]:
        """Solve the stages of a step of h; return its error in tolerances."""
        t, memory, stage, pinned = float(self._control["t"]), self._memory, self._stage, self._pinned
        c = 1.0 / (GAMMA * h)
        rounding, motion = ROUNDING_OF_CORRECTIONS / float(np.max(stage.tol / self.system.size)), (self._rate * h) ** 2
        tolerance = min(STAGE_TOLERANCE, DRIFT_FACTOR * motion) if motion > MIN_SQUARED_MOTION else rounding
        if not self._ensure_factors(c):
            return Code.COLLAPSED, np.inf
        stage.q[:], stage.v[:], stage.lam[:] = memory.q, memory.v, memory.lam
        for i in range(1, N_STAGES):
            at = t + C[i] * h if i < N_STAGES - 1 else after
            predict_stage(self._eqs, i, h, *pinned)
            if i == 1 and self.system.nonsmooth_reason and not self.system.m:
                self._control["evaluations"] += 2
                predict_residual(self._eqs, at, c, *pinned)
                self.system.apply(stage.q, -self._saddle.solve(stage.tau, stage.no_multipliers)[0])
            code = self._solve_stage(at, c, tolerance, rounding)
            if code is not Code.OK:
                return code, np.inf
            store_stage(self._eqs, i, at, c, self._has_work, *pinned)
        code = self._close(after)
        estimate_error(h, *pinned)
        error, _ = self._saddle.solve(c**2 * self.system.tangent.inertia(stage.dq), stage.no_multipliers)
        return code, measure_correction(error, pinned[1])

    def _close(self, t: float) -> Code:
        """Bring the end of a step onto the constraints.

        First the way that reactions move it: what Newton leaves of the multipliers is all gone then, where the shortest
        way would turn a part of it into motion.
        """
        system, stage, saddle = self.system, self._stage, self._saddle
        if system.m:
            for _ in range(PROJECTION_ITERATIONS):
                system.fill_position(t, stage.q, saddle.terms)
                system.apply(stage.q, -saddle.solve(stage.zero, saddle.terms.Phi)[0])
            system.fill_position(t, stage.q, saddle.terms)
            for _ in range(PROJECTION_ITERATIONS):
                stage.v[:] -= saddle.solve(stage.zero, saddle.terms.J @ stage.v - saddle.terms.nu)[0]
        return project(system, t, stage.q, stage.v)

    def _solve_stage(self, t: float, c: float, tolerance: float, rounding: float) -> Code:
        """Solve the stage that has been begun, to ``tolerance`` tolerances.

        If corrections decrease slowly, factors are renewed on the way; if they grow, at the first guess. Corrections
        below ``rounding`` tolerances that do not decrease are rounding errors.
        """
        stage, pinned, contraction, before = self._stage, self._pinned[1], FIRST_CONTRACTION, 0.0
        first, n_refactored, fresh = 0, 0, np.inf
        guess, reactions = stage.q.copy(), stage.lam.copy()
        for k in range(MAX_STAGE_CORRECTIONS):
            refactors = k - first > 1 and contraction > MAX_CONTRACTION
            if refactors and not n_refactored and contraction > 1.0:
                stage.q[:], stage.lam[:] = guess, reactions
            self._control["evaluations"] += 1
            if not residual(self._eqs, t, c, pinned):
                return Code.NOT_FINITE
            gap = self._acceleration_residual(t, c)
            if refactors:
                if n_refactored == MAX_REFACTORIZATIONS:
                    break
                n_refactored, first = n_refactored + 1, k
                self._set_factor_point(t, c, stage.q, stage.v, stage.a, stage.lam)
                if not self._factor():
                    break
            size = correct_stage(self._eqs, k - first, *self._saddle.solve(stage.tau, gap), pinned)
            if not np.isfinite(size):
                return Code.NOT_FINITE
            if refactors:
                if n_refactored > 1 and size > fresh:  # Newton's own corrections grow: what is far will not come nearer
                    break
                fresh = size
            contraction = max(MIN_CONTRACTION, size / before) if k > first else contraction
            if size <= NEGLIGIBLE_CORRECTION * tolerance or contraction * size <= tolerance * (1.0 - contraction):
                return Code.OK
            if k > first and size <= rounding and contraction > MAX_CONTRACTION:
                return Code.OK
            before = size
        return Code.COLLAPSED

    def _acceleration_residual(self, t: float, c: float) -> Array:
        """Return how far the stage's accelerations are off the constraints' (m,), as a change of the positions.

        Position constraints in the stages would take the order to one.
        """
        stage, terms = self._stage, self._saddle.terms
        if not self.system.m:
            return stage.no_multipliers
        self.system.fill(t, stage.q, stage.v, terms)
        return np.asarray((terms.J @ stage.a - terms.gamma) / c**2)

    def _set_factor_point(self, t: float, c: float, q: Array, v: Array, a: Array, lam: Array) -> None:
        """Note where factors are to be taken, and for which 1 / (h gamma) = ``c``."""
        self._control["factored_c"], self._control["factored_at"] = c, t
        self._memory.factored_state[:] = np.concatenate((q, v, a, lam))

    def _ensure_factors(self, c: float) -> bool:
        """Have factors for 1 / (h gamma) = ``c``, those there are if they are not far off; False: singular."""
        control, memory = self._control, self._memory
        if abs(control["factored_c"] - c) > FACTOR_REUSE_TOLERANCE * c:
            self._set_factor_point(float(control["t"]), c, memory.q, memory.v, memory.A[0], memory.lam)
        elif self._factor_count == self.system.tangent.factored:
            return True
        return self._factor()

    def _factor(self) -> bool:
        """Factor T where it has been placed; False where it is singular."""
        control, memory, saddle = self._control, self._memory, self._saddle
        q, v, a, lam = np.split(memory.factored_state, np.cumsum((len(memory.q), len(memory.v), len(memory.v))))
        saddle.set_penalties(float(control["factored_at"]), q)
        saddle.residual(float(control["factored_at"]), q, v, a, lam)
        good = saddle.factor(
            float(control["factored_c"]), float(control["factored_c"]) ** 2, symmetric=self.system.tangent.symmetric
        )
        self._factor_count = self.system.tangent.factored
        if not good:
            control["factored_c"] = 0.0
        return good

    @property
    def freedom(self) -> int:
        """In how many ways the constraints let the mechanism move at most."""
        return count_freedom(self.system, self._t, self._q)

    def evaluate(self) -> tuple[Code, Array, Array]:
        """As :meth:`solvers.stepper.Stepper.evaluate`."""
        code = self._motion.solve(self._t, self._q, self._v)
        return code, self._motion.a.copy(), self._motion.lam.copy()

    def restart(self) -> None:
        """Restart at the reported state, without its history."""
        self._control["h"], self._control["factored_c"] = 0.0, 0.0
        self._begin(0)

    def continue_after_event(self) -> None:
        """Continue in steps that end at the requested time, at which the next change may occur."""
        if (
            self.system.nonsmooth_reason
        ):  # friction in T goes with what is given; a restored run would have other factors
            self._control["factored_c"] = 0.0
        self._begin(TRUNCATED_STEPS)

    def _begin(self, truncated_steps: int) -> None:
        control, memory = self._control, self._memory
        control["t"], control["start"], control["work"] = self._t, 1, self._energy_account[WORK]
        control["truncated_steps"], control["last_error_step"], control["retry_steps"] = truncated_steps, 0.0, 0
        self._has_work = int(self.options.energy_check and self.system.works())
        reset_check_schedule(memory.control)
        memory.q[:], memory.v[:] = self._q, self._v

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Whether the tolerance is larger than requested, or errors may be far above it: the order is low for a nearly
        singular mass matrix.
        """
        found = []
        if self._requested_rtol != self.options.rtol:
            text = (
                f"'esdirk' uses a tolerance of {self.options.rtol:g} instead of {self._requested_rtol:g}, because its "
                "steps would be so short that rounding errors add up"
            )
            remedy = "Use 'adams' or 'ida' if this is too large"
            found.append(Diagnostic.warning("limited-tolerance", text, remedy, subject="esdirk"))
        if large := describe_large_growth(self._growth_data.inertia):
            text = f"{large}, and errors of 'esdirk' (order 3) may be 100 times the tolerance"
            remedy, since = "Use 'adams' or 'ida'", float(self._growth_data.inertia[0]["large_since"])
            found.append(Diagnostic.warning("ill-conditioned-mass", text, remedy, subject="esdirk", time=since))
        return tuple(found)

    def arrays(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.stepper.Stepper.arrays`."""
        seen = unpin(self._scales).bound_results
        return [*self._memory, self.clock, self._q, self._v, self._energy_account, seen, self._growth_data.inertia]

    def restore(self, data: bytes) -> None:
        """Return to the state in which ``data`` was saved; factors are recomputed from their data."""
        super().restore(data)
        self._has_work, self._factor_count = int(self.options.energy_check and self.system.works()), -1

    @property
    def statistics(self) -> Statistics:
        """What the run has cost so far."""
        control = self._control
        return Statistics(
            steps=int(control["steps"]),
            rejected=int(control["rejected"]),
            rhs_evals=int(control["evaluations"]),
            restarts=max(0, int(control["starts"]) - 1),
            order=3,
            step_size=float(control["hold"]),
            coarser=self.options.rtol / self._requested_rtol,
            rate_growth=float(self._growth_data.inertia["largest"][0]),
            rate_growth_at=float(self._growth_data.inertia["at"][0]),
        )

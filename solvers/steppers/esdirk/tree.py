"""ESDIRK3(2) on a large tree: 'esdirk'; the method is in :mod:`.formulas`.

For meshes of plates and beams, whose fastest modes an explicit method must follow and this one damps. Newton's matrix
is the structured tangent, factored where the steps change or where corrections fall slowly, and kept over steps, times
at output and, without contact, jumps of the loads. It is taken as symmetric, which halves what a correction reads, but
where there is friction; loads that follow the bodies cost some more of them. Corrections are accelerated, which makes
up for most of what has changed since: a factorization costs as much as twenty of them. Cut joints are held by the
accelerations of every stage, with the tree's saddle system; where a step ends it is brought onto them.

Positions alone are controlled: their error is filtered by (c^2 M + c D + K)^-1 c^2 M, which leaves out of it what the
method damps. A step is kept as long as the last one unless it must be shorter or may be twice as long, since another
length needs other factors.

A step may pass the requested time, and is interpolated. After a jump of the loads the next ones end there: what a step
needs of the one before it are its accelerations alone.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.codes import coded
from solvers.compiled.tuple_pointer import pin, unpin
from solvers.energy_account import WORK, EnergyScales, fill_account_row, reset_check_schedule
from solvers.inertia import Growth, describe_large_growth, tolerance_factor
from solvers.linalg.blocks import one_thread
from solvers.options import Options, Statistics
from solvers.outcome import Code
from solvers.projection.saddle import Accelerations, Saddle, count_freedom, motion_rate, project
from solvers.stepper import (
    Stepper,
    min_step_length,
    require_resolved_position,
    require_resolved_time,
    start_rate,
    validated_vector,
)
from solvers.steppers.step_control import (
    FIRST_STEP_RATIO,
    MIN_CONTROLLED_ERROR,
    MIN_STEP_CHANGE,
    MIN_STEP_RATIO,
    STEP_SAFETY_FACTOR,
    TARGET_TOLERANCE,
    TRUNCATED_STEPS,
)
from solvers.system import MAX_DENSE_COORDINATES, Array, TreeSystem, energy_callbacks

from .formulas import (
    GAMMA,
    MAX_CORRECTIONS,
    STAGES,
    C,
    Memory,
    Stage,
    accept,
    begin_motion,
    begin_stage,
    correct,
    end_stage,
    error_of_step,
    foresee,
    interpolate,
    look_around,
    residual,
    size_of,
    watch_inertia,
)

RATE_TOLERANCE_RATIO = 150.0  # tolerance of a rate in tolerances of its coordinate times the rate of the motion
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
MIN_STEP_INCREASE, MAX_STEP_CHANGE = 2.0, 4.0  # next step in units of this one, if it is longer


class Callbacks(NamedTuple):
    """What the kernels call."""

    inverse: Any
    retract: Any
    power: Any
    evaluate_energy_bound: Any
    inertia_parts: Any
    data: Any


class TreeESDIRKStepper(Stepper):
    """ESDIRK3(2) on a large tree."""

    def __init__(self, system: TreeSystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        dense = ("adams", "hybrid") if system.n <= MAX_DENSE_COORDINATES else ()
        self.fallback_solvers = (*dense, "ida") if system.m else ("adams", "ida")
        super().__init__(system, t0, q0, v0, options)
        self._requested = self.options.rtol
        if self._requested < MIN_RTOL:
            self.options = replace(self.options, rtol=MIN_RTOL)
        self.system, o = system, self.options
        self._motion, self._saddle = Accelerations(system), Saddle(system)
        self._memory, self._stage = Memory.allocate(system.nq, system.n, system.m), Stage.of(system)
        self._c = self._memory.control[0]
        self._held = pin(self._memory), pin(self._stage)
        callbacks = system.inverse, system.retract, *energy_callbacks(system), system.parts_callback
        self._eqs = pin(Callbacks(*callbacks, system.pinned_data))
        self._rate = motion_rate(self._motion, self._t, self._q, self._v, o.duration)
        require_resolved_time(self._t, self._rate, o.rtol)
        require_resolved_position(self._q, system.position_sizes(system.size), o.rtol, system.coordinate_names)
        self._absolute = o.absolute * system.size
        self._growth = Growth.of(system, self._rate)
        self._held_growth = pin(self._growth)
        rates = RATE_TOLERANCE_RATIO * self._rate * self._absolute
        self._scales = pin(EnergyScales.of_mesh(o.rtol, self._absolute, rates, system.n, RATE_TOLERANCE_RATIO))
        self._works, self._longest = 0, np.inf
        self._mine = -1  # how often the tangent had been factored when these factors were made
        self.status = self._status(project(system, self._t, self._q, self._v))
        self.restart()

    def _advance(self, t: float) -> Code:
        code, taken = Code.OK, 0
        with one_thread():
            while code is Code.OK and self._c["t"] < t:
                if taken >= self.options.max_steps:
                    code = Code.MAX_STEPS
                    break
                code = self._prepare() if self._c["start"] else Code.OK
                code = self._step(t) if code is Code.OK else code
                taken += 1
            return self._report(t, code)

    def _report(self, t: float, code: Code) -> Code:
        """Make the motion at t the reported state, or on failure where the last step ended."""
        c, M = self._c, self._memory
        at, q, v, work = float(c["t"]), M.q.copy(), M.v.copy(), float(c["work"])
        if code is Code.OK and t < at:
            work = interpolate(t, *self._held, q, v)
            code = project(self.system, t, q, v)
            if code is not Code.OK:
                return code
            at = t
        if at >= self._t:
            self._t, self._q[:], self._v[:] = at, q, v
            fill_account_row(c, work, self._energy_account)
        return code

    def _prepare(self) -> Code:
        """Take accelerations where the next step begins."""
        c, M = self._c, self._memory
        code = self._motion.solve(float(c["t"]), M.q, M.v)
        if code is Code.OK:
            M.A[0], M.lam[:] = self._motion.a, self._motion.lam
            begin_motion(self._eqs, float(c["t"]), self._works, *self._held)
            if self.system.can_compute_rate_growth:
                watch_inertia(self._eqs, *self._held, self._held_growth)
            self._look()
            c["start"] = 0
            c["starts"] += 1
            if not c["h"] > 0.0:
                c["h"] = FIRST_STEP_RATIO / start_rate(self._rate, np.inf, self.system.size, M.v, M.A[0])
        return code

    def _look(self) -> None:
        if self.options.energy_check:
            look_around(self._eqs, *self._held, self._scales)

    def _step(self, target: float) -> Code:
        """One accepted step, however often it has to be cut; or what made it too small."""
        c, M, s = self._c, self._memory, self._stage
        s.tol[:] = ERROR_TOLERANCE_RATIO * self._absolute
        s.tol[s.in_v] += ERROR_TOLERANCE_RATIO * self.options.rtol * np.abs(M.q[s.in_q])
        s.tol[:] *= tolerance_factor(self.options.rtol, 1.3, self._held_growth)
        while True:
            c["h"] = min(c["h"], self._longest)
            h = self._stop_at(target) if c["ends"] else float(c["h"])
            ends = bool(c["ends"]) and abs(target - c["t"] - h) <= TARGET_TOLERANCE * h
            after = target if ends else float(c["t"]) + h
            code, error = self._try(h, after)
            if code is Code.OK and error <= 1.0:
                break
            c["rejected"] += 1
            if code is Code.OK:
                c["h"] = h * max(MIN_STEP_CHANGE, STEP_SAFETY_FACTOR * error ** (-1.0 / 3.0))
            else:
                c["h"], c["hard"], c["wait"] = 0.5 * h, h, RETRY_STEPS
            if not c["h"] > min_step_length(MIN_STEP_RATIO, self._rate, self._longest, float(c["t"])):
                return Code.COLLAPSED if code is Code.OK else code
        whole, longer = h >= c["h"], self._longer(h, max(error, MIN_CONTROLLED_ERROR))
        c["error"], c["before"] = max(error, 1e-2), h
        accept(h, after, *self._held)
        if self.system.can_compute_rate_growth:
            watch_inertia(self._eqs, *self._held, self._held_growth)
        self._look()
        c["h"] = longer if whole else max(c["h"], longer)
        c["ends"] = max(0, c["ends"] - 1)
        return Code.OK

    def _longer(self, h: float, error: float) -> float:
        """Return the length of the step after one of h, with a look at how the error has changed (Gustafsson)."""
        c = self._c
        factor = STEP_SAFETY_FACTOR * error ** (-1.0 / 3.0)
        if c["wait"] > 0:
            c["wait"] -= 1
            factor = min(factor, max(1.0, RETRY_STEP_RATIO * c["hard"] / h))
        if c["before"] > 0.0:
            factor = min(factor, STEP_SAFETY_FACTOR * h / c["before"] * (c["error"] / error**2) ** (1.0 / 3.0))
        return h if 1.0 <= factor < MIN_STEP_INCREASE else h * float(min(MAX_STEP_CHANGE, max(MIN_STEP_CHANGE, factor)))

    def _stop_at(self, target: float) -> float:
        """Return the length of a step that is to end at ``target``, or half way where another would be shorter."""
        left, h = target - float(self._c["t"]), float(self._c["h"])
        if left * (1.0 - TARGET_TOLERANCE) <= h:
            return left
        return 0.5 * left if left < 2.0 * h else h

    def _try(self, h: float, after: float) -> tuple[Code, float]:
        """Solve the stages of a step of h; return its error in tolerances."""
        t, M, s, held = float(self._c["t"]), self._memory, self._stage, self._held
        rate = 1.0 / (GAMMA * h)
        finest, motion = ROUNDING_OF_CORRECTIONS / float(np.max(s.tol / self.system.size)), (self._rate * h) ** 2
        exact = min(STAGE_TOLERANCE, DRIFT_FACTOR * motion) if motion > MIN_SQUARED_MOTION else finest
        if not self._factors_for(rate):
            return Code.COLLAPSED, np.inf
        s.q[:], s.v[:], s.lam[:] = M.q, M.v, M.lam
        for i in range(1, STAGES):
            at = t + C[i] * h if i < STAGES - 1 else after
            begin_stage(self._eqs, i, h, *held)
            if i == 1 and self.system.nonsmooth_reason and not self.system.m:
                self._c["evaluations"] += 2
                foresee(self._eqs, at, rate, *held)
                self.system.apply(s.q, -self._saddle.solve(s.tau, s.none)[0])
            code = self._solve_stage(at, rate, exact, finest)
            if code is not Code.OK:
                return code, np.inf
            end_stage(self._eqs, i, at, rate, self._works, *held)
        code = self._close(after)
        error_of_step(h, *held)
        error, _ = self._saddle.solve(rate**2 * self.system.tangent.inertia(s.turn), s.none)
        return code, size_of(error, held[1])

    def _close(self, t: float) -> Code:
        """Bring the end of a step onto the constraints.

        First the way that reactions move it: what Newton leaves of the multipliers is all gone then, where the shortest
        way would turn a part of it into motion.
        """
        system, s, saddle = self.system, self._stage, self._saddle
        if system.m:
            for _ in range(PROJECTION_ITERATIONS):
                system.fill_position(t, s.q, saddle.terms)
                system.apply(s.q, -saddle.solve(s.zero, saddle.terms.Phi)[0])
            system.fill_position(t, s.q, saddle.terms)
            for _ in range(PROJECTION_ITERATIONS):
                s.v[:] -= saddle.solve(s.zero, saddle.terms.J @ s.v - saddle.terms.nu)[0]
        return project(system, t, s.q, s.v)

    def _solve_stage(self, t: float, rate: float, exact: float, finest: float) -> Code:
        """Solve the stage that has been begun, to ``exact`` tolerances.

        If corrections decrease slowly, factors are renewed on the way; if they grow, at the first guess. Corrections
        below ``finest`` tolerances that do not decrease are rounding errors.
        """
        s, held, slow, before, begun, renewed, fresh = self._stage, self._held[1], FIRST_CONTRACTION, 0.0, 0, 0, np.inf
        guess, reactions = s.q.copy(), s.lam.copy()
        for k in range(MAX_CORRECTIONS):
            anew = k - begun > 1 and slow > MAX_CONTRACTION
            if anew and not renewed and slow > 1.0:
                s.q[:], s.lam[:] = guess, reactions
            self._c["evaluations"] += 1
            if not residual(self._eqs, t, rate, held):
                return Code.NOT_FINITE
            gap = self._gap(t, rate)
            if anew:
                if renewed == MAX_REFACTORIZATIONS:
                    break
                renewed, begun = renewed + 1, k
                self._place_factors(t, rate, s.q, s.v, s.a, s.lam)
                if not self._factor():
                    break
            size = correct(self._eqs, k - begun, *self._saddle.solve(s.tau, gap), held)
            if not np.isfinite(size):
                return Code.NOT_FINITE
            if anew:
                if renewed > 1 and size > fresh:  # Newton's own corrections grow: what is far will not come nearer
                    break
                fresh = size
            slow = max(MIN_CONTRACTION, size / before) if k > begun else slow
            if size <= NEGLIGIBLE_CORRECTION * exact or slow * size <= exact * (1.0 - slow):
                return Code.OK
            if k > begun and size <= finest and slow > MAX_CONTRACTION:
                return Code.OK
            before = size
        return Code.COLLAPSED

    def _gap(self, t: float, rate: float) -> Array:
        """Return how far the stage's accelerations are off the constraints' (m,), as a change of the positions.

        Position constraints in the stages would take the order to one.
        """
        s, terms = self._stage, self._saddle.terms
        if not self.system.m:
            return s.none
        self.system.fill(t, s.q, s.v, terms)
        return np.asarray((terms.J @ s.a - terms.gamma) / rate**2)

    def _place_factors(self, t: float, rate: float, q: Array, v: Array, a: Array, lam: Array) -> None:
        """Note where factors are to be taken, and for which 1 / (h gamma) = ``rate``."""
        self._c["c"], self._c["at"] = rate, t
        self._memory.factors[:] = np.concatenate((q, v, a, lam))

    def _factors_for(self, rate: float) -> bool:
        """Have factors for 1 / (h gamma) = ``rate``, those there are if they are not far off; False: singular."""
        c, M = self._c, self._memory
        if abs(c["c"] - rate) > FACTOR_REUSE_TOLERANCE * rate:
            self._place_factors(float(c["t"]), rate, M.q, M.v, M.A[0], M.lam)
        elif self._mine == self.system.tangent.factored:
            return True
        return self._factor()

    def _factor(self) -> bool:
        """Factor T where it has been placed; False where it is singular."""
        c, M, saddle = self._c, self._memory, self._saddle
        q, v, a, lam = np.split(M.factors, np.cumsum((len(M.q), len(M.v), len(M.v))))
        saddle.set_penalties(float(c["at"]), q)
        saddle.residual(float(c["at"]), q, v, a, lam)
        good = saddle.factor(float(c["c"]), float(c["c"]) ** 2, symmetric=self.system.tangent.symmetric)
        self._mine = self.system.tangent.factored
        if not good:
            c["c"] = 0.0
        return good

    @property
    def freedom(self) -> int:
        """In how many ways the constraints let the mechanism move at most."""
        return count_freedom(self.system, self._t, self._q)

    def _evaluate(self) -> tuple[Code, Array, Array]:
        code = self._motion.solve(self._t, self._q, self._v)
        return code, self._motion.a.copy(), self._motion.lam.copy()

    def _limit(self, longest: float) -> None:
        self._longest = longest

    def restart(self) -> None:
        """Restart at the reported state, without its history."""
        self._c["h"], self._c["c"] = 0.0, 0.0
        self._begin(0)

    def continue_after_event(self) -> None:
        """Continue in steps that end at the requested time, at which the next change may occur."""
        # friction in T goes with what is given; a restored run would have other factors
        if self.system.nonsmooth_reason:
            self._c["c"] = 0.0
        self._begin(TRUNCATED_STEPS)

    def _begin(self, ends: int) -> None:
        c, M = self._c, self._memory
        c["t"], c["start"], c["ends"], c["before"], c["work"] = self._t, 1, ends, 0.0, self._energy_account[WORK]
        c["wait"] = 0
        self._works = int(self.options.energy_check and self.system.works())
        reset_check_schedule(M.control)
        M.q[:], M.v[:] = self._q, self._v

    def jump(self, dv: Array) -> None:
        """Add dv (n,) to the reported velocities, and go on as after :meth:`continue_after_event`."""
        self._v += validated_vector("dv", dv, self.system.n)
        self.continue_after_event()

    @property
    def warning(self) -> str:
        """Whether the tolerance is larger than requested, or errors may be far above it: the order is low for a nearly
        singular mass matrix.
        """
        large = describe_large_growth(self._growth.inertia)
        if large:
            text = f"{large}, and errors of 'esdirk' (order 3) may be 100 times the tolerance. Use 'adams' or 'ida'"
            return coded("ill-conditioned-mass", text)
        if self._requested == self.options.rtol:
            return ""
        return coded(
            "limited-tolerance",
            f"'esdirk' uses a tolerance of {self.options.rtol:g} instead of {self._requested:g}, because its steps "
            "would be so short that rounding errors add up. Use 'adams' or 'ida' if this is too large",
        )

    def arrays(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.stepper.Stepper.arrays`."""
        seen = unpin(self._scales).bound_results
        return [*self._memory, self.clock, self._q, self._v, self._energy_account, seen, self._growth.inertia]

    def restore(self, data: bytes) -> None:
        """Return to the state in which ``data`` was saved; factors are recomputed from their data."""
        super().restore(data)
        self._works, self._mine = int(self.options.energy_check and self.system.works()), -1

    @property
    def statistics(self) -> Statistics:
        """What the run has cost so far."""
        c = self._c
        return Statistics(
            steps=int(c["steps"]),
            rejected=int(c["rejected"]),
            rhs_evals=int(c["evaluations"]),
            restarts=max(0, int(c["starts"]) - 1),
            order=3,
            step_size=float(c["hold"]),
            coarser=self.options.rtol / self._requested,
            rate_growth=float(self._growth.inertia["largest"][0]),
            rate_growth_at=float(self._growth.inertia["at"][0]),
        )

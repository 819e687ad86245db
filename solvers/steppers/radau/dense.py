"""The stepper on Radau IIA: 'radau'."""

from __future__ import annotations

from typing import Any, ClassVar

from numpy.typing import NDArray

from solvers.compiled.kernel import records
from solvers.energy_account import WORK
from solvers.options import Options, Statistics
from solvers.stepper import validated_vector
from solvers.steppers.compiled_loop import CompiledLoopStepper
from solvers.steppers.step_control import TRUNCATED_STEPS
from solvers.system import Array, System

from . import loop
from .formulas import Memory


class RadauStepper(CompiledLoopStepper):
    """Radau IIA of order 5; see :mod:`.loop`. For stiff models, and for loads that change at every requested time."""

    fallback_solvers: tuple[str, ...] = ("adams", "ida")
    loop: ClassVar = loop

    def __init__(self, system: System, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        self._memory = Memory.allocate(system.nq, system.n)
        self._control = self._memory.control[0]
        self._settings = records(1, loop.SETTINGS)
        loop.set_options(self.options.record(), self._settings)
        self._set_up(self._memory)

    def limit_step(self, longest: float) -> None:
        """As :meth:`solvers.stepper.Stepper.limit_step`."""
        self._settings["max_step"] = longest

    def restart(self) -> None:
        """Restart at the reported state, without its history."""
        self._begin(0, False)
        self._control["has_derivatives"] = 0

    def continue_after_event(self) -> None:
        """Continue in steps that end at the requested time, at which the next change may occur."""
        self._begin(TRUNCATED_STEPS, self.status.ok)

    def _begin(self, truncated_steps: int, keeps_position: bool) -> None:
        self._settings["works"] = self.options.energy_check and self.system.works()
        loop.restart_at_state(
            self._pinned, self._t, self._q, self._v, float(self._energy_account[WORK]), truncated_steps, keeps_position
        )

    def jump(self, dv: Array) -> None:
        """Add dv (n,) to the reported velocities, and continue as after :meth:`continue_after_event`."""
        self._v += validated_vector("dv", dv, self.system.n)
        self.continue_after_event()

    def arrays(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.stepper.Stepper.arrays`."""
        seen = self._scales.bound_results
        return [*self._memory, self.clock, self._q, self._v, self._energy_account, seen, *self._workspace.memory()]

    @property
    def statistics(self) -> Statistics:
        """What the run has cost so far."""
        control = self._control
        return Statistics(
            steps=int(control["steps"]),
            rejected=int(control["rejected"]),
            rhs_evals=int(control["evaluations"]),
            restarts=max(0, int(control["starts"]) - 1),
            order=5,
            step_size=float(control["hold"]),
            rate_growth=self._growth()[0],
            rate_growth_at=self._growth()[1],
            refused=int(control["refused"]),
            coarser=max(1.0, float(control["max_near_miss_factor"])),
        )

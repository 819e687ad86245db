"""Common part of all steppers on Adams formulas: start, continuation after a change, and end of a history."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

from numpy.typing import NDArray

from solvers.energy_account import WORK
from solvers.stepper import Stepper, validated_vector
from solvers.steppers.step_control import TRUNCATED_STEPS
from solvers.system import Array

from .formulas import restart_history
from .jumps import limit_steps


class ExplicitStepper(Stepper):
    """A stepper on Adams formulas, and on one-step formulas where a history would not last."""

    system: Any
    _pinned: Any  # the history
    _control: Any  # its record
    _settings: NDArray[Any]

    @property
    @abstractmethod
    def _needs_work(self) -> bool:
        """Whether work is to be recorded."""

    def limit_step(self, longest: float) -> None:
        """As :meth:`solvers.stepper.Stepper.limit_step`."""
        limit_steps(self._pinned, self._settings, self._t, self._q, self._v, float(self._energy_account[WORK]), longest)

    def restart(self) -> None:
        """Begin a new history at the reported state with the next step."""
        self._begin(0, 0, False)

    def continue_after_event(self) -> None:
        """Continue in steps that need no history and end at the requested time, at which the next change may occur."""
        self._begin(TRUNCATED_STEPS, 1, self.status.ok)

    def _begin(self, rk_steps: int, needs_derivative: int, keeps_position: bool) -> None:
        self._settings["works"] = self._needs_work and self.system.works()
        restart_history(
            self._pinned,
            self._t,
            self._q,
            self._v,
            float(self._energy_account[WORK]),
            rk_steps,
            needs_derivative,
            keeps_position,
        )

    def jump(self, dv: Array) -> None:
        """Add dv (n,) to the reported velocities, and continue as after :meth:`continue_after_event`."""
        self._v += validated_vector("dv", dv, self.system.n)
        self.continue_after_event()

"""Common part of all steppers on Adams formulas: start, continuation after a change, and end of a history."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

from numpy.typing import NDArray

from solvers.energy_account import WORK
from solvers.stepper import Stepper, validated_vector
from solvers.steppers.step_control import TRUNCATED_STEPS
from solvers.system import Array

from .formulas import begin_anew
from .jumps import limit_steps


class ExplicitStepper(Stepper):
    """A stepper on Adams formulas, and on one-step formulas where a history would not last."""

    system: Any
    _held: Any  # the history
    _control: Any  # its record
    _settings: NDArray[Any]

    @property
    @abstractmethod
    def _watched(self) -> bool:
        """Whether work is to be booked."""

    def _limit(self, longest: float) -> None:
        limit_steps(self._held, self._settings, self._t, self._q, self._v, float(self._energy_account[WORK]), longest)

    def restart(self) -> None:
        """Begin a new history at the reported state with the next step."""
        self._begin(0, 0, False)

    def continue_after_event(self) -> None:
        """Continue in steps that need no history and end at the requested time, at which the next change may occur."""
        self._begin(TRUNCATED_STEPS, 1, self.status.ok)

    def _begin(self, singles: int, renew: int, kept: bool) -> None:
        self._settings["works"] = self._watched and self.system.works()
        begin_anew(self._held, self._t, self._q, self._v, float(self._energy_account[WORK]), singles, renew, kept)

    def jump(self, dv: Array) -> None:
        """Add dv (n,) to the reported velocities, and go on as after :meth:`continue_after_event`."""
        self._v += validated_vector("dv", dv, self.system.n)
        self.continue_after_event()

"""The loop over the steps in Python: for methods whose steps take long, and for those that users write."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

from solvers.linalg.threads import one_thread
from solvers.outcome import Code
from solvers.stepper import Stepper, validated_vector
from solvers.system import Array


class PythonLoopStepper(Stepper):
    """A stepper that takes one step after the other in Python.

    ``_control`` is a record with the time reached ``t`` (s) and ``start``, which is 1 if the next step begins a motion
    or follows a change.
    """

    _control: Any
    _max_step: float

    @abstractmethod
    def _prepare(self) -> Code:
        """Evaluate what the next step requires after a start or a change."""

    @abstractmethod
    def _take_step(self, target: float) -> Code:
        """Attempt steps, shorter after each rejection, until one is accepted; or return why the last was rejected."""

    @abstractmethod
    def _report(self, t: float, code: Code) -> Code:
        """Make the motion at t the reported state, or on failure where the last step ended."""

    def advance_to(self, t: float) -> Code:
        """As :meth:`solvers.stepper.Stepper.advance_to`."""
        code, taken = Code.OK, 0
        with one_thread():
            while code is Code.OK and self._control["t"] < t:
                if taken >= self.max_steps:
                    code = Code.MAX_STEPS
                    break
                code = self._prepare() if self._control["start"] else Code.OK
                code = self._take_step(t) if code is Code.OK else code
                taken += 1
            return self._report(t, code)

    @property
    def own_time(self) -> float:
        """As :attr:`solvers.stepper.Stepper.own_time`."""
        return float(self._control["t"])

    def limit_step(self, longest: float) -> None:
        """As :meth:`solvers.stepper.Stepper.limit_step`."""
        self._max_step = longest

    def jump(self, dv: Array) -> None:
        """Add dv (n,) to the reported velocities, and continue as after :meth:`continue_after_event`."""
        self._v += validated_vector("dv", dv, len(self._v))
        self.continue_after_event()

"""What steppers on a system's matrices share whose step loop is one kernel."""

from __future__ import annotations

from types import ModuleType
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.codes import coded
from solvers.compiled.tuple_pointer import pin
from solvers.energy_account import EnergyScales
from solvers.outcome import CODES, Code
from solvers.stepper import Samples
from solvers.system import Array

from .dense import DenseStepper


class Integration(NamedTuple):
    """All that a loop integrates with, in one tuple: its kernels get one address and not every array at each call."""

    eqs: Any
    settings: NDArray[Any]
    memory: Any
    work: Any
    scales: Any
    q: Array  # the reported state
    v: Array
    energy_account: Array


class CompiledLoopStepper(DenseStepper):
    """A stepper whose ``loop`` has the kernels ``advance_reported`` and ``sample``, its control record and settings.

    Attributes
    ----------
    integration
        What they take, held: a record of :class:`Integration`.
    """

    loop: ClassVar[ModuleType]

    _control: Any  # the loop's record
    _settings: NDArray[Any]

    def _set_up(self, memory: Any) -> None:
        """Set up the loop with its memory, a tuple of arrays, and begin."""
        self._pinned, n = pin(memory), self.system.n
        self._scales = EnergyScales.of(self.options.rtol, np.zeros(n), np.zeros(n))
        own = self._eqs, self._settings, self._pinned, self._work, pin(self._scales)
        self.integration = pin(Integration(*own, self._q, self._v, self._energy_account))
        self.loop.set_up(self.integration, self._rank, self.options.absolute)
        self.restart()

    def advance_to(self, t: float) -> Code:
        """As :meth:`solvers.stepper.Stepper.advance_to`."""
        code = CODES[self.loop.advance_reported(self.integration, t)]
        self._t = t if code is Code.OK else float(self._control["t"])
        return code

    def _sample(self, times: Array, out: Samples, outputs: Array) -> int:
        self._control["undetermined"] = 0
        code, done = self.loop.sample(self.integration, times, *out, outputs)
        last = min(done, len(times) - 1)
        self._t = min(float(times[last]), float(self._control["t"]))
        self._q[:], self._v[:], self._energy_account[:] = out.q[last], out.v[last], out.energy_account[last]
        self.status = self._status(CODES[code])
        if self._control["undetermined"]:
            self.undetermined_at = float(self._control["undetermined_at"])
        return int(done)

    @property
    def warning(self) -> str:
        """Whether the tolerance was larger than requested near a near miss."""
        control = self._control
        if not control["max_near_miss_factor"] > 1.0:
            return ""
        used = control["max_near_miss_factor"] * self.options.rtol
        return coded(
            "limited-tolerance",
            f"the tolerance was {used:.0e} instead of {self.options.rtol:g} near a singular configuration that the "
            f"loop misses by {control['min_gap']:.0e} of its size, because rounding errors allow no smaller one there. "
            "Change the lengths of the loop if the error is too large",
        )

"""What steppers on a system's matrices share whose step loop is one kernel."""

from __future__ import annotations

from abc import abstractmethod
from types import ModuleType
from typing import Any, ClassVar

from numpy.typing import NDArray

from solvers.outcome import Code
from solvers.stepper import Samples
from solvers.system import Array

from .dense import DenseStepper


class ClosedStepper(DenseStepper):
    """A stepper whose ``loop`` has the kernels ``advance`` and ``sample``, its control record and its settings."""

    loop: ClassVar[ModuleType]

    _settings: NDArray[Any]
    _held: Any  # what the loop remembers
    _scales: Any

    @property
    @abstractmethod
    def _control(self) -> NDArray[Any]:
        """The loop's record (1,)."""

    def _advance(self, t: float) -> Code:
        own = self._eqs, self._settings, self._held, self._work, self._scales
        code = Code(self.loop.advance(*own, t, self._q, self._v, self._ledger))
        self._t = t if code is Code.OK else float(self._control["t"][0])
        return code

    def _sample(self, times: Array, out: Samples) -> int:
        own = self._eqs, self._settings, self._held, self._work, self._scales
        self._control["undetermined"] = 0
        code, done = self.loop.sample(*own, times, *out)
        last = min(done, len(times) - 1)
        self._t = min(float(times[last]), float(self._control["t"][0]))
        self._q[:], self._v[:], self._ledger[:] = out.q[last], out.v[last], out.ledger[last]
        self.status = self._status(Code(code))
        if self._control["undetermined"][0]:
            self.undetermined_at = float(self._control["undetermined_at"][0])
        return int(done)

    @property
    def notice(self) -> str:
        """Whether the tolerance was coarser than asked for beside a near miss."""
        c = self._control[0]
        if not c["coarsest"] > 1.0:
            return ""
        return (
            f"the tolerance was {c['coarsest'] * self.options.rtol:.0e}, not {self.options.rtol:g}, beside a singular "
            f"position that the loop misses by {c['narrowest']:.0e} of its size: rounding allows no finer"
        )

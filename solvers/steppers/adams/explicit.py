"""What all steppers on Adams formulas share: how a history begins, goes on after a change, and ends."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

from numpy.typing import NDArray

from solvers.ledger import WORK, look_anew
from solvers.stepper import Stepper, sized
from solvers.system import Array

from .formulas import History

SINGLES = 12  # single steps after a change of the equations before a history is begun


class ExplicitStepper(Stepper):
    """A stepper on Adams formulas, and on one-step formulas where a history would not last."""

    system: Any
    _history: History
    _settings: NDArray[Any]

    @property
    def _control(self) -> NDArray[Any]:
        return self._history.control

    @property
    @abstractmethod
    def _watched(self) -> bool:
        """Whether work is to be booked."""

    def _limit(self, longest: float) -> None:
        if longest != self._settings["max_step"][0]:
            self._settings["max_step"] = longest
            self._control["h"] = min(self._control["h"][0], longest)

    def restart(self) -> None:
        """Begin a new history at the reported state with the next step."""
        self._begin(0, 0, 0)

    def _begin(self, singles: int, renew: int, placed: int) -> None:
        c, y, nq = self._control, self._history.y, len(self._q)
        c["t"], c["start"], c["singles"], c["renew"], c["placed"] = self._t, 1, singles, renew, placed
        self._book_works()
        look_anew(c)
        y[:nq], y[nq:-1], y[-1] = self._q, self._v, self._ledger[WORK]

    def renew(self) -> None:
        """Go on in steps that need no history and end at the time asked for: the next change may come there."""
        c = self._control
        placed = c["placed"][0] if c["t"][0] == self._t and self.status.ok else 0
        self._begin(SINGLES, 1, placed)

    def jump(self, dv: Array) -> None:
        """Add dv (n,) to the reported velocities, and go on as after :meth:`renew`."""
        self._v += sized("dv", dv, self.system.n)
        self.renew()

    def _book_works(self) -> None:
        self._settings["works"] = self._watched and self.system.works()

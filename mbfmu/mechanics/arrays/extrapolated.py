"""Loads that a host sets, between the communication points at which it does.

What is held lags by half a step. A load may go on instead as from the last point to this one, which is right but for
the square of the step; where it jumps, it does so once more within the step that follows.
"""

from __future__ import annotations

from math import nan
from typing import Any


class Extrapolated:
    """An input that goes on from its value at a point as it came there from the point before.

    Parameters
    ----------
    signal
        Record of the polynomial that is evaluated.
    """

    def __init__(self, signal: Any) -> None:
        self._signal = signal
        self._value = float(signal["c"][0])  # what the host has set
        self._point, self._before = nan, (nan, nan)  # s, of the last point; time and value of the one before

    @property
    def settled(self) -> bool:
        """Whether it stays as it is until it is set."""
        return bool(self._signal["c"][1] == 0.0)

    def start(self, value: float) -> None:
        """Have a value at the start; nothing is known of the time before."""
        self._value, self._point, self._before = value, nan, (nan, nan)

    def give(self, t: float, value: float) -> None:
        """Take the value at the point t, s."""
        if t != self._point:
            self._before, self._point = (self._point, self._value), t
        self._value = value
        self._write(0.0)

    def depart(self, t: float, end: float) -> bool:
        """Begin a step from t to ``end``, s; whether it goes on otherwise than it did.

        It changes by no more than it last did, however long the step.
        """
        went_on = not self.settled
        if t != self._point:
            self.give(t, self._value)  # the host has said nothing: it is what it was
        before, value = self._before
        change = self._value - value
        self._write(change / max(t - before, end - t) if change and t > before else 0.0)
        return went_on or not self.settled

    def pass_by(self, t: float) -> None:
        """Note a point, t (s), at which it stayed as it is."""
        if self.settled and not t <= self._point:
            self.give(t, self._value)

    def _write(self, slope: float) -> None:
        self._signal["t0"], self._signal["c"][0], self._signal["c"][1] = self._point, self._value, slope

    def state(self) -> list[float]:
        """Return what is remembered, to be given to :meth:`restore`."""
        return [self._value, self._point, *self._before]

    def restore(self, state: list[float]) -> None:
        """Remember what was remembered when ``state`` was taken."""
        self._value, self._point, *before = state
        self._before = before[0], before[1]

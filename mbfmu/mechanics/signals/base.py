"""What every signal says of itself: a known function of time that drives a joint or scales a load.

Its kernels:

    evaluate(signal, t, arrays)       returns the value at time t (s) and its first two derivatives; t is always real
    longest_step(signal, t, arrays)   returns the longest step from t on that cannot miss how it varies, and until when
                                      it is the longest, s: a step that begins before that time may end so much later
                                      than it; None: it varies with nothing but what a host sets, or any step sees it

A solver that looks at a sine once a period, or passes a run-up in one step, sees nothing to be wrong about.

A signal of others evaluates them by their numbers, :func:`mbfmu.mechanics.dispatch.signal`. They are signals of the
mechanism too, and speak of steps for themselves.

Solvers and steady states ask a signal about itself as it is in use, see :class:`InUse`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from mbfmu.mechanics.kind import Kind


class InUse(NamedTuple):
    """A signal of a mechanism, with its record there, which a host may have changed since it was filled."""

    signal: Signal
    record: Any
    all: list[InUse]  # by number

    def part(self, field: str) -> InUse:
        """Return the signal whose number the record has in a field."""
        return self.all[int(self.record[field].real)]

    def pace(self, size: float) -> float:
        """See :meth:`Signal.pace`."""
        return self.signal.pace(self, size)

    def steady(self) -> tuple[float, bool]:
        """See :meth:`Signal.steady`."""
        return self.signal.steady(self)


@dataclass(frozen=True)
class Signal(Kind):
    """A function of time; the base gives what holds for one of which no more is known.

    One that varies by itself has a kernel ``longest_step(signal, t, arrays)`` beside ``evaluate``: it returns the
    longest step from t on that cannot miss how it varies, and until when it is the longest, s.
    """

    kernels: ClassVar = {"evaluate": "time, arrays -> three", "longest_step": "time, arrays -> two"}
    evaluate: ClassVar[Any]
    longest_step: ClassVar[Any] = None
    drives: ClassVar[bool] = True  # it has no jumps, nor has its rate: a joint can follow it

    def pace(self, own: InUse, size: float) -> float:
        """Return a time (s) in which it changes by about ``size``; zero: it never changes."""
        return 0.0

    def steady(self, own: InUse) -> tuple[float, bool]:
        """Return the constant speed it has from its start on, and whether it has one."""
        return 0.0, False

    def run_on(self, own: InUse) -> None:
        """Let it be from now on what it becomes in the end, if it becomes anything."""

    def moving(self, own: InUse) -> list[InUse]:
        """Return the signals whose speeds make up its own, in an order of their own: itself, or what it is a sum of."""
        return [own]

    def run_at(self, own: InUse, speed: float) -> None:
        """Let it go at another constant speed; asked only of one that has one."""

    def variables(self) -> list[tuple[str, str, str, float]]:
        """Return name, unit, description and start of what a host sets; entry k is coefficient k of the record."""
        return []

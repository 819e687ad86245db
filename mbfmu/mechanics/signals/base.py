"""Interface of signals: known functions of time that drive a joint or scale a load.

Its kernels:

    evaluate(signal, t, arrays)       returns the value at time t (s) and its first two derivatives; t is always real
    longest_step(signal, t, arrays)   returns the longest step from t on that cannot miss how it varies, and until when
                                      it is the longest, s: a step that begins before that time may end so much later
                                      than it; None: it varies with inputs only, or any step resolves it

A solver that evaluates a sine once per period, or passes a run-up in one step, cannot detect its error.

A signal of others evaluates them by their numbers, :func:`mbfmu.mechanics.dispatch.signal`. They are signals of the
mechanism too, and speak of steps for themselves.

Solvers and steady states ask a signal about itself as it is in use, see :class:`InUse`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from mbfmu.mechanics.kind import ElementType


class InUse(NamedTuple):
    """A signal of a mechanism, with its record there, which a host may have changed since it was filled."""

    signal: Signal
    record: Any
    all: list[InUse]  # by number
    number: int

    def part(self, field: str) -> InUse:
        """Return the signal whose number the record has in a field."""
        return self.all[int(self.record[field].real)]

    def time_scale(self, size: float) -> float:
        """See :meth:`Signal.time_scale`."""
        return self.signal.time_scale(self, size)

    def steady(self) -> tuple[float, bool]:
        """See :meth:`Signal.steady`."""
        return self.signal.steady(self)

    @property
    def is_constant(self) -> bool:
        """Whether its value never changes."""
        return self.steady() == (0.0, True)

    def members(self) -> list[InUse]:
        """Return the signal itself, or the signals that it is computed from."""
        operands = self.signal.operands(self)
        return [member for operand in operands for member in operand.members()] if operands else [self]


@dataclass(frozen=True)
class Signal(ElementType):
    """Base class of functions of time, with default properties.

    One that varies with time has a kernel ``longest_step(signal, t, arrays)`` in addition to ``evaluate``: it returns
    the longest step from t on that resolves it, and the time until which this is valid, s.
    """

    kernels: ClassVar = {"evaluate": "time, arrays -> three", "longest_step": "time, arrays -> two"}
    evaluate: ClassVar[Any]
    longest_step: ClassVar[Any] = None
    drives: ClassVar[bool] = True  # it has no jumps, nor has its rate: a joint can follow it

    def time_scale(self, own: InUse, size: float) -> float:
        """Return a time (s) in which it changes by about ``size``; zero: it never changes."""
        return 0.0

    def steady(self, own: InUse) -> tuple[float, bool]:
        """Return its constant speed from the start on, and whether it has one."""
        return 0.0, False

    def run_on(self, own: InUse) -> None:
        """Set it to its final state, if it has one."""

    def hold(self, own: InUse, value: float) -> None:
        """Set it to the constant ``value``, which is its value at t = 0; without this method it keeps changing."""

    def operands(self, own: InUse) -> list[InUse]:
        """Return the signals that it is computed from; none: it is a function of time."""
        return []

    def moving(self, own: InUse) -> list[InUse]:
        """Return the signals whose speeds add up to its speed, in a fixed order: itself, or the terms of its sum."""
        return [own]

    def run_at(self, own: InUse, speed: float) -> None:
        """Set another constant speed; only for a signal that has one."""

    def variables(self) -> list[tuple[str, str, str, float]]:
        """Return name, unit, description and start of its inputs; entry k is coefficient k of the record."""
        return []

"""A step, and a ramp."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import finite, not_negative
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, f8

from .base import InUse, Signal

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays

MAX_RISE_STEP_RATIO = 0.3  # longest step, in durations of the rise
JUMP_TIME_TOLERANCE = 1e-9  # part of the time of a jump: what comes so soon after it may be missed


class StepRecord(Record):
    """Parameters of :class:`Step`."""

    height: f8
    begin: f8  # s
    duration: f8  # s
    offset: f8


@kernel
def smooth(signal: StepRecord, t: float, arrays: Arrays) -> tuple[float, float, float]:
    """See :mod:`.base`. h x^3 (10 - 15 x + 6 x^2) with x from 0 to 1: neither rate nor acceleration jump."""
    h, duration, s = signal.height, signal.duration, t - signal.begin
    if s.real < 0.0:
        return signal.offset, 0.0 * h, 0.0 * h
    if s.real >= duration.real:
        return signal.offset + h, 0.0 * h, 0.0 * h
    x = s / duration
    return (
        signal.offset + h * x * x * x * (10.0 - 15.0 * x + 6.0 * x * x),
        30.0 * h / duration * x * x * (1.0 - x) * (1.0 - x),
        60.0 * h / (duration * duration) * x * (1.0 - x) * (1.0 - 2.0 * x),
    )


@kernel
def straight(signal: StepRecord, t: float, arrays: Arrays) -> tuple[float, float, float]:
    """See :mod:`.base`."""
    h, duration, s = signal.height, signal.duration, t - signal.begin
    if s.real < 0.0:
        return signal.offset, 0.0 * h, 0.0 * h
    if s.real >= duration.real:
        return signal.offset + h, 0.0 * h, 0.0 * h
    return signal.offset + h * s / duration, h / duration, 0.0 * h


@kernel
def longest_step(signal: StepRecord, t: float, arrays: Arrays) -> tuple[float, float]:
    """See :mod:`.base`. Part of the rise, and before it half the way there."""
    begin, duration = signal.begin, signal.duration
    if signal.height == 0.0 or t >= begin + duration:
        return np.inf, np.inf
    half = 0.5 * (begin - t)
    shortest = max(MAX_RISE_STEP_RATIO * duration, JUMP_TIME_TOLERANCE * (abs(begin) if begin != 0.0 else 1.0))
    return (half, t + half) if half > shortest else (shortest, begin + max(duration, shortest))


@dataclass(frozen=True, kw_only=True)
class Step(Signal):
    """Step: smooth rise from one value to another, or a jump.

    With a duration it is smooth and can drive a joint.

    Parameters
    ----------
    height
        Difference of final and initial value, in the unit of the driven quantity.
    begin
        Time at which the rise begins, s.
    duration
        Duration of the rise, s; 0: a jump.
    offset
        Initial value, in the unit of the driven quantity.
    """

    record = StepRecord
    evaluate, longest_step = smooth, longest_step

    height: float
    begin: float = 0.0
    duration: float = 0.0
    offset: float = 0.0

    def fill(self, record: Any, site: Attachment) -> None:
        """Check and write the parameters."""
        what = f"of a {type(self).__name__}"
        for key in ("height", "begin", "offset"):
            finite(f"{key} {what}", getattr(self, key))
        not_negative(f"duration {what}", self.duration)
        super().fill(record, site)

    @property
    def drives(self) -> bool:  # type: ignore[override]
        """Whether it has a duration; an invalid duration is reported by ``fill``."""
        return self.duration != 0.0

    def time_scale(self, own: InUse, size: float) -> float:
        """Return the part of the rise that changes it by ``size``, at most all."""
        height, duration = abs(float(own.record["height"])), float(own.record["duration"])
        return duration * min(1.0, size / height) if height else 0.0

    def steady(self, own: InUse) -> tuple[float, bool]:
        """Return that it is at rest, if it has no height."""
        return 0.0, not own.record["height"]

    def run_on(self, own: InUse) -> None:
        """Set it to its final value."""
        self.hold(own, (own.record["offset"] + own.record["height"]).real)

    def hold(self, own: InUse, value: float) -> None:
        """Set it to a constant value."""
        own.record["offset"], own.record["height"] = value, 0.0


@dataclass(frozen=True, kw_only=True)
class Ramp(Step):
    """Ramp: linear rise, with the parameters of :class:`Step`.

    Its rate is discontinuous, so it can be used for loads only; for joints use a :class:`Step` with a duration, or a
    ``RunUp``.
    """

    evaluate = straight
    drives = False

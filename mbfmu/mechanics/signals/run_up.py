"""A run-up from rest to a constant speed, with an acceleration without jumps.

The speed is speed (x - sin(2 pi x) / (2 pi)), x = t / duration, and then stays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import finite, positive
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, f8, i8

from .base import InUse, Signal

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays

MAX_RUN_UP_STEP_RATIO = 0.3  # longest step, in durations


class RunUpRecord(Record):
    """Parameters of :class:`RunUp`."""

    start: f8
    speed: f8
    duration: f8
    over: i8  # 1: at full speed from the beginning


@kernel
def evaluate(signal: RunUpRecord, t: float, arrays: Arrays) -> tuple[float, float, float]:
    """See :mod:`.base`."""
    speed = signal.speed
    if signal.over == 1:
        return signal.start + t * speed, speed, 0.0 * speed
    duration = signal.duration
    taken = min(max(t, 0.0), duration.real)
    late, part = max(t, taken) - taken, taken / duration
    turns = (np.cos(2.0 * np.pi * taken / duration) - 1.0) / (2.0 * np.pi) ** 2
    return (
        signal.start + speed * (0.5 * taken * taken / duration + duration * turns + late),
        speed * (part - np.sin(2.0 * np.pi * part) / (2.0 * np.pi)),
        speed / duration * (1.0 - np.cos(2.0 * np.pi * taken / duration)),
    )


@kernel
def longest_step(signal: RunUpRecord, t: float, arrays: Arrays) -> tuple[float, float]:
    """See :mod:`.base`. Part of the run-up, and before it half the way there."""
    end = signal.duration
    if signal.over == 1 or not abs(signal.speed) * end > 0.0:
        return np.inf, np.inf
    shortest = MAX_RUN_UP_STEP_RATIO * end
    if t < -shortest:
        return -0.5 * t, 0.5 * t
    return (shortest, end) if t < end else (np.inf, np.inf)


@dataclass(frozen=True, kw_only=True)
class RunUp(Signal):
    """Run-up of a driven joint from rest to constant speed.

    Parameters
    ----------
    speed
        Final speed, rad/s or m/s.
    duration
        Duration of the run-up, s.
    start
        Position of the coordinate at t = 0, rad or m.
    """

    record = RunUpRecord
    evaluate, longest_step = evaluate, longest_step

    speed: float
    duration: float
    start: float = 0.0

    def fill(self, record: Any, site: Attachment) -> None:
        """Check and write the parameters."""
        for key in ("speed", "start"):
            finite(f"{key} of a RunUp", getattr(self, key))
        positive("duration of a RunUp", self.duration)
        super().fill(record, site)

    def time_scale(self, own: InUse, size: float) -> float:
        """Return the time of the run-up and of ``size`` at full speed."""
        speed = abs(float(own.record["speed"]))
        if not speed:
            return 0.0
        return size / speed if own.record["over"] else float(own.record["duration"]) + size / speed

    def steady(self, own: InUse) -> tuple[float, bool]:
        """Return the full speed, once it is reached."""
        return (float(own.record["speed"]), True) if own.record["over"] else (0.0, not own.record["speed"])

    def run_on(self, own: InUse) -> None:
        """Set it to its full speed."""
        own.record["over"] = 1

    def hold(self, own: InUse, value: float) -> None:
        """Set it to a constant position."""
        own.record["start"], own.record["speed"] = value, 0.0

    def run_at(self, own: InUse, speed: float) -> None:
        """Set the full speed."""
        own.record["speed"] = speed

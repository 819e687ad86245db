"""A sine."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import finite
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, f8

from .base import InUse, Signal

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays

MAX_PERIOD_STEP_RATIO = 0.3  # longest step, in periods


class HarmonicRecord(Record):
    """Parameters of :class:`Harmonic`."""

    middle: f8
    amplitude: f8
    frequency: f8  # rad/s
    phase: f8  # rad


@kernel
def evaluate(signal: HarmonicRecord, t: float, arrays: Arrays) -> tuple[float, float, float]:
    """See :mod:`.base`."""
    w, phase = signal.frequency, signal.frequency * t + signal.phase
    return (
        signal.middle + signal.amplitude * np.sin(phase),
        signal.amplitude * w * np.cos(phase),
        -signal.amplitude * w * w * np.sin(phase),
    )


@kernel
def longest_step(signal: HarmonicRecord, t: float, arrays: Arrays) -> tuple[float, float]:
    """See :mod:`.base`. Part of a period."""
    w = abs(signal.frequency)
    return (MAX_PERIOD_STEP_RATIO * (2.0 * pi / w) if abs(signal.amplitude) * w > 0.0 else np.inf), np.inf


@dataclass(frozen=True, kw_only=True)
class Harmonic(Signal):
    """Harmonic: mean + amplitude sin(2 pi frequency t + phase).

    Parameters
    ----------
    amplitude, mean
        Amplitude and mean value, in the unit of the driven quantity.
    frequency
        Frequency, Hz.
    phase
        Phase at t = 0, rad.
    """

    record = HarmonicRecord
    evaluate, longest_step = evaluate, longest_step

    amplitude: float
    frequency: float
    phase: float = 0.0
    mean: float = 0.0

    def fill(self, record: Any, site: Attachment) -> None:
        """Check and write the parameters."""
        for key in ("amplitude", "frequency", "phase", "mean"):
            finite(f"{key} of a Harmonic", getattr(self, key))
        super().fill(record, site)
        record["middle"], record["frequency"] = self.mean, 2.0 * pi * self.frequency

    def time_scale(self, own: InUse, size: float) -> float:
        """Return the time of a radian."""
        w = abs(float(own.record["frequency"]))
        return 1.0 / w if abs(float(own.record["amplitude"])) * w else 0.0

    def steady(self, own: InUse) -> tuple[float, bool]:
        """Return that it is at rest, if its amplitude or its frequency is zero."""
        return 0.0, not own.record["amplitude"] * own.record["frequency"]

    def hold(self, own: InUse, value: float) -> None:
        """Set it to a constant value."""
        own.record["middle"], own.record["amplitude"] = value, 0.0

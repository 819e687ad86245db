"""Signals, known functions of time: one file a kind."""

from __future__ import annotations

from .base import Signal
from .harmonic import Harmonic
from .polynomial import Coefficients, Input, Polynomial, SpeedInput
from .run_up import RunUp


def as_signal(value: float | Signal) -> Signal:
    """Take a number for a constant."""
    return Polynomial((float(value),)) if isinstance(value, int | float) else value


__all__ = ["Coefficients", "Harmonic", "Input", "Polynomial", "RunUp", "Signal", "SpeedInput", "as_signal"]

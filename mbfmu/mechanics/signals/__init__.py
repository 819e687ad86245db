"""Signals, known functions of time: one file a kind."""

from __future__ import annotations

from .base import InUse, Signal
from .combined import Product, Sum
from .function import Function
from .harmonic import Harmonic
from .noise import Noise
from .polynomial import Coefficients, Input, Polynomial, SpeedInput
from .run_up import RunUp
from .step import Ramp, Step
from .table import Table

__all__ = [
    "Coefficients",
    "Function",
    "Harmonic",
    "InUse",
    "Input",
    "Noise",
    "Polynomial",
    "Product",
    "Ramp",
    "RunUp",
    "Signal",
    "SpeedInput",
    "Step",
    "Sum",
    "Table",
]

"""Spatial linkages with redundant constraint equations, by name."""

from __future__ import annotations

from collections.abc import Callable

from mbfmu.verification.mechanisms.case import Case
from mbfmu.verification.mechanisms.spatial import bennett, sarrus

OVERCONSTRAINED: dict[str, Callable[..., Case]] = {  # every one with ``scale``
    "bennett": bennett,
    "bennett, turning": lambda **k: bennett(rate=3.0, **k),
    "sarrus": lambda **k: sarrus(start=60.0, stop_time=0.3, **k),
    "sarrus, folded flat": sarrus,
    "sarrus, straight": lambda **k: sarrus(start=-30.0, stop_time=2.0, **k),
}

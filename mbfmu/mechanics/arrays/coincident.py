"""Forces between two points that coincide, so that they have no direction."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.builder.handles import BETWEEN_POINTS
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.loads import LineForce, Load, Spring
from mbfmu.util.diagnostics import Diagnostic

COINCIDENT_POINT_TOLERANCE = 1e-14  # distance relative to the length of the mechanism


def find_coincident(mechanism: Mechanism, bodies: NDArray[Any], length: float) -> list[Diagnostic]:
    """Return a warning for every force without direction where ``bodies`` are; ``length`` is in m."""
    found = []
    for acting in mechanism.loads():
        load = acting.load
        if not isinstance(load, BETWEEN_POINTS) or not (omitted := _omitted(load)):
            continue
        ends = [
            bodies["r"][body.index] + bodies["A"][body.index] @ np.asarray(point, float)
            for body, point in zip(acting.bodies, load.points(), strict=True)
        ]
        if np.linalg.norm(ends[1] - ends[0]) <= COINCIDENT_POINT_TOLERANCE * length:
            found.append(
                Diagnostic.warning(
                    "coincident-ends",
                    f"the ends of {acting.what} coincide at the start{omitted} has no direction there and is omitted",
                    "Choose start positions with a distance between the ends",
                    subject=acting.what.partition("'")[2].rstrip("'"),
                )
            )
    return found


def _omitted(load: Load) -> str:
    """Return which force of a load is omitted where its ends coincide, and why; empty: it has none there."""
    if isinstance(load, LineForce):
        return ": its force"
    what = "free length" if isinstance(load, Spring) else "lower limit"
    unloaded = load.free if isinstance(load, Spring) else (getattr(load, "lower", None) or 0.0)
    return f", but its {what} is {unloaded:g} m: its elastic force" if unloaded else ""

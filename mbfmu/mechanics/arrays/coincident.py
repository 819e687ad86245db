"""Springs and stops whose ends coincide, so that their elastic force has no direction."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.codes import coded
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.loads import DistanceStop, Spring

COINCIDENT = 1e-14  # distance relative to the length of the mechanism


def find_coincident(mechanism: Mechanism, bodies: NDArray[Any], length: float) -> list[str]:
    """Return a warning for every elastic force without direction where ``bodies`` are; ``length`` is in m."""
    found = []
    for acting in mechanism.loads():
        load = acting.load
        if not isinstance(load, Spring | DistanceStop):
            continue
        unloaded = load.free if isinstance(load, Spring) else (load.lower or 0.0)
        if not unloaded:
            continue
        ends = [
            bodies["r"][body.index] + bodies["A"][body.index] @ np.asarray(point, float)
            for body, point in zip(acting.bodies, load.points(), strict=True)
        ]
        if np.linalg.norm(ends[1] - ends[0]) <= COINCIDENT * length:
            what = "free length" if isinstance(load, Spring) else "lower limit"
            found.append(
                coded(
                    "coincident-ends",
                    f"the ends of {acting.what} coincide at the start, but its {what} is {unloaded:g} m: its elastic "
                    "force has no direction there and is omitted; choose start positions with a distance between the "
                    "ends",
                )
            )
    return found

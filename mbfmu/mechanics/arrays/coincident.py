"""Forces between two points that coincide, so that they have no direction."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.builder.handles import BETWEEN_POINTS
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.loads import LineForce, LineFriction, Load, Rope, Spring
from mbfmu.util.diagnostics import Diagnostic

WITH_DIRECTION = (*BETWEEN_POINTS, Rope)  # loads that act along lines between points
COINCIDENT_POINT_TOLERANCE = 1e-14  # distance relative to the length of the mechanism


def find_coincident(mechanism: Mechanism, bodies: NDArray[Any], length: float) -> list[Diagnostic]:
    """Return a warning for every force without direction where ``bodies`` are; ``length`` is in m."""
    found = []
    for acting in mechanism.loads():
        if isinstance(acting.load, Rope):
            path, omitted, ends = acting.load.path, ": its pull between them", "two neighboring points"
        elif isinstance(acting.load, BETWEEN_POINTS) and (omitted := _omitted(acting.load)):
            path, ends = tuple(enumerate(acting.load.points())), "the ends"
        else:
            continue
        indices = [acting.bodies[k].index for k, _ in path]
        places = [
            bodies["r"][i] + bodies["A"][i] @ np.asarray(point, float)
            for i, (_, point) in zip(indices, path, strict=True)
        ]
        pairs = zip(pairwise(places), pairwise(indices), strict=True)
        if min(np.linalg.norm(b - a) for (a, b), (i, j) in pairs if i != j) <= COINCIDENT_POINT_TOLERANCE * length:
            found.append(
                Diagnostic.warning(
                    "coincident-ends",
                    f"{ends} of {acting.what} coincide at the start{omitted} has no direction there and is omitted",
                    "Choose start positions with a distance between the ends",
                    subject=acting.what.partition("'")[2].rstrip("'"),
                )
            )
    return found


def _omitted(load: Load) -> str:
    """Return which force of a load is omitted where its ends coincide, and why; empty: it has none there."""
    if isinstance(load, LineForce | LineFriction):
        return ": its force"
    what = "free length" if isinstance(load, Spring) else "lower limit"
    unloaded = load.free if isinstance(load, Spring) else (getattr(load, "lower", None) or 0.0)
    size = f"{unloaded:g} m" if isinstance(unloaded, int | float) else "a signal"
    return f", but its {what} is {size}: its elastic force" if unloaded else ""

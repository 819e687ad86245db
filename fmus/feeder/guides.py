"""Guides on both sides of a path, and the one of a chute behind it."""

from __future__ import annotations

from math import cos, isclose, sin

from mbfmu.sheets import Drum, Guide, Surface, Trough

from .path import Arc, Path, Straight

# m, half the thickness of a guide: a sheet that buckles must not come out on its other side
PLATE_HALF_THICKNESS = 5e-3


def guide_surface(part: Straight | Arc, hand: float, offset: float, width: float) -> Surface:
    """Return the guide on one side of a part of a path, ``offset`` from it: 1 above, -1 below."""
    if isinstance(part, Straight):
        ends = []
        for s in (0.0, part.length):
            (x, y), angle = part.at(s)
            ends.append(
                (
                    x - hand * (offset + PLATE_HALF_THICKNESS) * sin(angle),
                    y + hand * (offset + PLATE_HALF_THICKNESS) * cos(angle),
                    0.0,
                )
            )
        return Guide(start=ends[0], end=ends[1], radius=PLATE_HALF_THICKNESS, width=width)
    center = (*part.center, 0.0)
    if isclose(part.side, hand):
        return Drum(radius=part.radius - offset, length=width, at=center)
    return Trough(
        radius=part.radius + offset, length=width, angle=abs(part.turn), towards=(*part.towards, 0.0), at=center
    )


def chute(route: Path, angle: float, length: float, offset: float, width: float) -> Guide:
    """Return the guide behind a path, askew: below the sheet where it rises and above where it falls."""
    (x, y), _ = route.at(route.length)
    hand = -1.0 if angle >= 0.0 else 1.0
    y += hand * (offset + PLATE_HALF_THICKNESS)
    end = (x + length * cos(angle), y + length * sin(angle), 0.0)
    return Guide(start=(x, y, 0.0), end=end, radius=PLATE_HALF_THICKNESS, width=width)

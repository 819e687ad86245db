"""The way of a sheet through a feeder: straight lines and arcs in the x-y plane, each going on where the last one ends.

The length s along it is zero at the first line of nips, where the path is at the origin and goes along x; the part
before is straight. A frame at s is a point and the angle of the path from x towards y.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin

Point = tuple[float, float]
Frame = tuple[Point, float]


@dataclass(frozen=True)
class Straight:
    """A straight part, ``length`` m long, from ``start`` on."""

    start: Frame
    length: float

    def at(self, distance: float) -> Frame:
        """Return the frame ``distance`` m behind the start."""
        (x, y), angle = self.start
        return (x + distance * cos(angle), y + distance * sin(angle)), angle


@dataclass(frozen=True)
class Arc:
    """An arc of ``radius`` m that turns by ``turn`` rad, upwards if that is positive."""

    start: Frame
    radius: float
    turn: float

    @property
    def side(self) -> float:
        """1 if the center is to the left of the path, above one along x, else -1."""
        return 1.0 if self.turn > 0.0 else -1.0

    @property
    def length(self) -> float:
        """m."""
        return self.radius * abs(self.turn)

    @property
    def center(self) -> Point:
        """Of the arc, m."""
        (x, y), angle = self.start
        return x - self.side * self.radius * sin(angle), y + self.side * self.radius * cos(angle)

    @property
    def towards(self) -> Point:
        """Unit vector from the center to the middle of the arc."""
        angle = self.start[1] + 0.5 * self.turn
        return self.side * sin(angle), -self.side * cos(angle)

    def at(self, distance: float) -> Frame:
        """Return the frame ``distance`` m behind the start."""
        x, y = self.center
        angle = self.start[1] + self.side * distance / self.radius
        return (x + self.side * self.radius * sin(angle), y - self.side * self.radius * cos(angle)), angle


@dataclass(frozen=True)
class Path:
    """Parts one behind the other, and how long the path is before s = 0."""

    parts: tuple[Straight | Arc, ...]
    before: float

    @property
    def length(self) -> float:
        """What is behind s = 0, m."""
        return sum(part.length for part in self.parts) - self.before

    def at(self, distance: float) -> Frame:
        """Return the frame at s; the last part has no end."""
        left = distance + self.before
        for part in self.parts[:-1]:
            if left < part.length:
                return part.at(left)
            left -= part.length
        return self.parts[-1].at(left)


def lay_out(before: float, pieces: Sequence[float | tuple[float, float]]) -> Path:
    """Return the path of these pieces behind s = 0: lengths of straight ones, and (radius, turn) of arcs."""
    frame: Frame = ((-before, 0.0), 0.0)
    parts: list[Straight | Arc] = []
    for piece in (before + _first(pieces), *pieces[1:]):
        parts.append(Arc(frame, *piece) if isinstance(piece, tuple) else Straight(frame, piece))
        frame = parts[-1].at(parts[-1].length)
    return Path(tuple(parts), before)


def _first(pieces: Sequence[float | tuple[float, float]]) -> float:
    """Return the length of the first piece, which is straight."""
    assert isinstance(pieces[0], float)
    return pieces[0]

"""Given force between two points, along the line that joins them: an actuator such as a cylinder or a cable."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.dispatch import signal_value
from mbfmu.mechanics.kind import Attachment
from solvers.compiled.kernel import kernel
from solvers.compiled.record import i8

from .base import Force, PointPairRecord, Points, fill_points
from .spring import connecting_line, pull_together

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State


class LineForceRecord(PointPairRecord):
    """Parameters of :class:`LineForce`."""

    signal: i8


@kernel
def apply(force: LineForceRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`. Points that coincide have no line of action: there is no force."""
    A, B = state.bodies[force.a], state.bodies[force.b]
    line = connecting_line(force, A, B)
    _, _, _, length, _ = line
    pull_together(A, B, line, -signal_value(force.signal, t, arrays) if length != 0.0 else 0.0 * length)


@kernel
def power(force: LineForceRecord, t: float, arrays: Arrays, state: State) -> float:
    """Force times rate of the distance."""
    _, _, _, length, rate = connecting_line(force, state.bodies[force.a], state.bodies[force.b])
    return signal_value(force.signal, t, arrays) * rate if length != 0.0 else 0.0 * length


@dataclass(frozen=True, kw_only=True)
class LineForce(Force):
    """Force between a point of body a and a point of body b, along the line that joins them.

    Its generalized force on a coordinate q is the force times the derivative of the distance of the points by q.

    Parameters
    ----------
    magnitude
        Force, N: number, signal or input. A positive force pushes the points apart, as the pressure in a
        cylinder does; a negative one pulls them together, as a cable does.
    at_a, at_b
        Points in the frames of bodies a and b, m.

    Notes
    -----
    Points that coincide have no line of action, and the force is omitted; a message reports this if it occurs at the
    start. Outputs of distance and rate: ``ForceHandle.length`` and ``ForceHandle.length_rate``.
    """

    record = LineForceRecord
    apply = apply
    power = power

    magnitude: Any
    at_a: Any = (0.0, 0.0, 0.0)
    at_b: Any = (0.0, 0.0, 0.0)

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the two points and the signal."""
        fill_points(self, record, site)
        record["signal"] = site.signal(self.magnitude, f"magnitude of {site.name}")

    def points(self) -> Points:
        """Return its two points."""
        return self.at_a, self.at_b

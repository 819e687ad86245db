"""Stops of the distance between two points, see :mod:`.stops`: a rope that is taut, a buffer that is pressed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import not_negative
from solvers.compiled.kernel import kernel

from .base import Force, PointPairRecord, Points, fill_points
from .spring import connecting_line, pull_together
from .stops import (
    LimitRecord,
    MovingLimitRecord,
    Stop,
    dissipated_power,
    is_signal,
    moving_stop_force,
    stop_energy,
    stop_force,
)

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State


class DistanceStopRecord(LimitRecord, PointPairRecord):
    """Parameters of :class:`DistanceStop`."""


@kernel
def apply(force: DistanceStopRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`. Points that coincide have no line of action and exert nothing."""
    A, B = state.bodies[force.a], state.bodies[force.b]
    line = connecting_line(force, A, B)
    _, _, _, length, rate = line
    pull_together(A, B, line, -stop_force(force, length, rate) if length != 0.0 else 0.0 * length)


@kernel
def potential(force: DistanceStopRecord, arrays: Arrays, state: State) -> float:
    """k x^2 / 2."""
    _, _, _, length, _ = connecting_line(force, state.bodies[force.a], state.bodies[force.b])
    return stop_energy(force, length)


@kernel
def power(force: DistanceStopRecord, t: float, arrays: Arrays, state: State) -> float:
    """-(f - k x) x'."""
    _, _, _, length, rate = connecting_line(force, state.bodies[force.a], state.bodies[force.b])
    return dissipated_power(force, length, rate) if length != 0.0 else 0.0 * length


class MovingDistanceStopRecord(MovingLimitRecord, PointPairRecord):
    """Parameters of :class:`DistanceStop` of which a limit is a signal."""


@kernel
def apply_moving(force: MovingDistanceStopRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`. Points that coincide have no line of action and exert nothing."""
    A, B = state.bodies[force.a], state.bodies[force.b]
    line = connecting_line(force, A, B)
    _, _, _, length, rate = line
    pull_together(A, B, line, -moving_stop_force(force, length, rate, t, arrays) if length != 0.0 else 0.0 * length)


@kernel
def power_moving(force: MovingDistanceStopRecord, t: float, arrays: Arrays, state: State) -> float:
    """Force times rate of the distance."""
    _, _, _, length, rate = connecting_line(force, state.bodies[force.a], state.bodies[force.b])
    return moving_stop_force(force, length, rate, t, arrays) * rate if length != 0.0 else 0.0 * length


class MovingDistanceStop(Force):
    """Record and kernels of a :class:`DistanceStop` of which a limit is a signal."""

    record = MovingDistanceStopRecord
    apply = apply_moving
    power = power_moving


@dataclass(frozen=True, kw_only=True)
class DistanceStop(Stop):
    """End stops of the distance between a point of body a and a point of body b.

    Parameters
    ----------
    at_a, at_b
        Points in the frames of bodies a and b, m.
    lower, upper
        Limits of the distance, m; upper alone is a rope of that length, lower alone a buffer. None: no limit on that
        side. A limit may be a signal, an input, or an expression of time, as of a rope on a winch: the work of the stop
        is computed then, its energy is not.
    stiffness
        Stiffness, N/m.
    damping
        Damping c (Hunt and Crossley), s/m; see :class:`.JointStop`.
    """

    record = DistanceStopRecord
    apply = apply
    potential = potential
    power = power
    moving = MovingDistanceStop
    variants = (MovingDistanceStop,)

    at_a: Any = (0.0, 0.0, 0.0)
    at_b: Any = (0.0, 0.0, 0.0)

    def check(self, what: str) -> None:
        """Refuse limits without a distance between them, and a negative distance."""
        super().check(what)
        for key, limit in self.limits().items():
            if not is_signal(limit):
                not_negative(f"{key} of {what}", limit)

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the two points too."""
        super().fill(record, site)
        fill_points(self, record, site)

    def points(self) -> Points:
        """Return its two points."""
        return self.at_a, self.at_b

    def extent(self) -> float:
        """Return its longer limit, if it is constant."""
        return 0.0 if self.is_moving else max(self.lower or 0.0, self.upper or 0.0)

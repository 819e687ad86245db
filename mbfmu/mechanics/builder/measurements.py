"""Measurements between bodies: angles, distances, relative positions and velocities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbfmu.mechanics.axes import ORIGIN, unit_axis
from mbfmu.mechanics.checks import Vector, rotation, vector
from mbfmu.mechanics.flexible import Beam
from mbfmu.mechanics.joints import Revolute, Section
from mbfmu.mechanics.sensors import (
    AngleBetween,
    Distance,
    DistanceRate,
    RelativePosition,
    RelativeVelocity,
    Sensor,
    Turn,
    axis_index,
)
from mbfmu.util.errors import UserError

from .bodies import Body
from .members import Members


class Measurements(Members):
    """Base of :class:`.Mechanism`: sensors of quantities between two bodies."""

    def turn(self, body: Body) -> Sensor:
        """Absolute angle (rad) of a body that is connected to the ground by parallel revolutes; counts full turns.

        Parameters
        ----------
        body
            Body of this mechanism.

        Raises
        ------
        UserError
            A joint between the body and the ground is not a parallel revolute joint or a beam.
        """
        return Turn(unit="rad", item=self._planar(body))

    def turn_rate(self, body: Body) -> Sensor:
        """Rate of :meth:`turn`, rad/s.

        Parameters
        ----------
        body
            As for :meth:`turn`.
        """
        return Turn(unit="rad/s", item=self._planar(body), component=1)

    def distance(self, a: Body, b: Body, *, at_a: Vector = ORIGIN, at_b: Vector = ORIGIN) -> Sensor:
        """Distance between a point of body a and one of body b (m, body frames), m.

        Parameters
        ----------
        a, b
            Bodies of this mechanism or its ground.
        at_a, at_b
            Points in the frames of the bodies (3,), m; their origins by default.
        """
        return Distance(unit="m", bodies=(a, b), **_points("the distance", a, at_a, b, at_b))

    def distance_rate(self, a: Body, b: Body, *, at_a: Vector = ORIGIN, at_b: Vector = ORIGIN) -> Sensor:
        """Rate of :meth:`distance`, m/s; zero where the points coincide.

        Parameters
        ----------
        a, b, at_a, at_b
            As for :meth:`distance`.
        """
        return DistanceRate(unit="m/s", bodies=(a, b), **_points("the distance", a, at_a, b, at_b))

    def angle_between(self, a: Body, axis_a: str | Sequence[float], b: Body, axis_b: str | Sequence[float]) -> Sensor:
        """Angle between an axis of body a and one of body b, from 0 to pi, rad; it has a kink at both.

        Parameters
        ----------
        a, b
            Bodies of this mechanism or its ground.
        axis_a, axis_b
            Axes in the frames of the bodies: ``"x"``, ``"y"``, ``"z"``, or a vector (3,).
        """
        what = f"the angle between {_named(a)} and {_named(b)}"
        axes: dict[str, Any] = {
            "at_a": unit_axis(axis_a, f"axis_a of {what}"),
            "at_b": unit_axis(axis_b, f"axis_b of {what}"),
        }
        return AngleBetween(bodies=(a, b), **axes)

    def relative_position(self, b: Body, a: Body, axis: str, *, at_b: Vector = ORIGIN, at_a: Vector = ORIGIN) -> Sensor:
        """Component along an axis of body a of the vector from a point of a to one of b (m, body frames), m.

        Parameters
        ----------
        b, a
            Bodies of this mechanism or its ground: the position of b relative to a.
        axis
            Axis of body a: ``"x"``, ``"y"`` or ``"z"``.
        at_b, at_a
            Points in the frames of the bodies (3,), m; their origins by default.
        """
        component = axis_index(axis, f"of {_named(b)} relative to {_named(a)}")
        points = _points("the way", a, at_a, b, at_b)
        return RelativePosition(unit="m", bodies=(a, b), component=component, **points)

    def relative_velocity(self, b: Body, a: Body, axis: str, *, at_b: Vector = ORIGIN, at_a: Vector = ORIGIN) -> Sensor:
        """Rate of :meth:`relative_position`, the velocity relative to body a, m/s.

        Parameters
        ----------
        b, a, axis, at_b, at_a
            As for :meth:`relative_position`.
        """
        component = axis_index(axis, f"of {_named(b)} relative to {_named(a)}")
        points = _points("the way", a, at_a, b, at_b)
        return RelativeVelocity(unit="m/s", bodies=(a, b), component=component, **points)

    def _planar(self, body: Body) -> Body:
        here, axis = body, None
        while here.index > 0:
            joint = here.joint
            own = joint.direction if isinstance(joint, Revolute) else np.array((0.0, 0.0, 1.0))
            axis, turned = own if axis is None else axis, rotation("rotation", joint.rotation) @ own
            planar = isinstance(joint, Revolute) or (isinstance(joint, Section) and isinstance(joint.elastic, Beam))
            if not planar or abs(abs(turned @ axis) - 1.0) > 1e-12:
                raise UserError(
                    f"turn of body {body.name!r} requires parallel revolute joints (or beams) from the ground "
                    "to the body; use a "
                    "sensor of its orientation, such as direction()"
                )
            here = self.bodies[here.parent]
        return body


def _named(body: Any) -> str:
    """Return what messages call a body; it need not be one."""
    return repr(getattr(body, "name", body))


def _points(what: str, a: Body, at_a: Vector, b: Body, at_b: Vector) -> dict[str, Any]:
    """Return the two points of a sensor between bodies, checked."""
    between = f"{what} between {_named(a)} and {_named(b)}"
    return {"at_a": vector(f"at_a of {between}", at_a), "at_b": vector(f"at_b of {between}", at_b)}

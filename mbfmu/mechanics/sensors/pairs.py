"""How two bodies are to each other: distance, angle between axes, where one is seen from the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mbfmu.mechanics.kind import Site
from mbfmu.mechanics.spatial import angle_of, arm
from solvers.compiled.kernel import kernel

from .base import Sensor


@kernel
def _way(A: Any, B: Any, Pa: Any, Pb: Any) -> Any:
    """From a's point to b's, from a's origin to b's point, and from b's origin there, global axes."""
    ax, ay, az = arm(A, Pa)
    bx, by, bz = arm(B, Pb)
    x, y, z = B.r[0] + bx - A.r[0], B.r[1] + by - A.r[1], B.r[2] + bz - A.r[2]
    return (x - ax, y - ay, z - az), (x, y, z), (bx, by, bz)


@kernel
def _way_rate(A: Any, B: Any, Pa: Any, Pb: Any) -> Any:
    """Velocity of b's point as one on body a sees it, global axes."""
    _, (x, y, z), (bx, by, bz) = _way(A, B, Pa, Pb)
    a, b = A.Y, B.Y
    return (
        b[0] + b[4] * bz - b[5] * by - a[0] - (a[4] * z - a[5] * y),
        b[1] + b[5] * bx - b[3] * bz - a[1] - (a[5] * x - a[3] * z),
        b[2] + b[3] * by - b[4] * bx - a[2] - (a[3] * y - a[4] * x),
    )


@kernel
def distance(sensor: Any, lam: Any, arrays: Any, state: Any) -> float:
    """See :mod:`.base`."""
    (x, y, z), _, _ = _way(state.bodies[sensor.a], state.bodies[sensor.b], sensor.Pa, sensor.Pb)
    return np.sqrt(x * x + y * y + z * z)


@kernel
def distance_rate(sensor: Any, lam: Any, arrays: Any, state: Any) -> float:
    """See :mod:`.base`. What a sees: turning of the way changes no length. Points that coincide: zero."""
    A, B = state.bodies[sensor.a], state.bodies[sensor.b]
    (x, y, z), _, _ = _way(A, B, sensor.Pa, sensor.Pb)
    vx, vy, vz = _way_rate(A, B, sensor.Pa, sensor.Pb)
    length = np.sqrt(x * x + y * y + z * z)
    return (x * vx + y * vy + z * vz) / length if length.real > 0.0 else length


@kernel
def angle(sensor: Any, lam: Any, arrays: Any, state: Any) -> float:
    """See :mod:`.base`. By the lengths of both products: no cosine alone tells small angles."""
    nx, ny, nz = arm(state.bodies[sensor.a], sensor.Pa)
    mx, my, mz = arm(state.bodies[sensor.b], sensor.Pb)
    x, y, z = ny * mz - nz * my, nz * mx - nx * mz, nx * my - ny * mx
    return angle_of(np.sqrt(x * x + y * y + z * z), nx * mx + ny * my + nz * mz)


@kernel
def place(sensor: Any, lam: Any, arrays: Any, state: Any) -> float:
    """See :mod:`.base`."""
    A, k = state.bodies[sensor.a], sensor.component
    (x, y, z), _, _ = _way(A, state.bodies[sensor.b], sensor.Pa, sensor.Pb)
    return A.A[0, k] * x + A.A[1, k] * y + A.A[2, k] * z


@kernel
def place_rate(sensor: Any, lam: Any, arrays: Any, state: Any) -> float:
    """See :mod:`.base`."""
    A, k = state.bodies[sensor.a], sensor.component
    x, y, z = _way_rate(A, state.bodies[sensor.b], sensor.Pa, sensor.Pb)
    return A.A[0, k] * x + A.A[1, k] * y + A.A[2, k] * z


@dataclass(frozen=True, kw_only=True)
class Distance(Sensor):
    """Distance between ``at_a`` on the first and ``at_b`` on the second of ``bodies`` (m, body axes)."""

    record = np.dtype(
        [
            ("a", np.int64),
            ("b", np.int64),
            ("component", np.int64),
            ("Pa", np.float64, (3,)),  # points, m, or unit vectors, body axes
            ("Pb", np.float64, (3,)),
        ],
        align=True,
    )
    read = distance

    at_a: Any = (0.0, 0.0, 0.0)
    at_b: Any = (0.0, 0.0, 0.0)

    def fill(self, record: Any, site: Site) -> None:
        """Write which bodies, where on them, and the component."""
        record["a"], record["b"] = site.bodies
        record["Pa"], record["Pb"], record["component"] = self.at_a, self.at_b, self.component


@dataclass(frozen=True, kw_only=True)
class DistanceRate(Distance):
    """Its rate."""

    read = distance_rate


@dataclass(frozen=True, kw_only=True)
class AngleBetween(Distance):
    """Angle between unit vectors ``at_a`` and ``at_b`` of the two bodies, from 0 to pi."""

    unit: str = "rad"
    read = angle


@dataclass(frozen=True, kw_only=True)
class RelativePosition(Distance):
    """Component of the way from a's point to b's along an axis of a."""

    read = place


@dataclass(frozen=True, kw_only=True)
class RelativeVelocity(Distance):
    """Its rate: the velocity of b's point as one on body a sees it."""

    read = place_rate

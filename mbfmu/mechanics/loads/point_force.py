"""A given force at a point of a body, its direction fixed in space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mbfmu.mechanics.checks import vector
from mbfmu.mechanics.dispatch import signal_value
from mbfmu.mechanics.joints.base import unit_axis
from mbfmu.mechanics.kind import Site
from mbfmu.mechanics.spatial import add_force, arm
from solvers.kernel import kernel

from .base import Force, Points


@kernel
def apply(force: Any, t: float, arrays: Any, state: Any) -> None:
    """See :mod:`.base`."""
    body = state.bodies[force.a]
    f = signal_value(force.signal, t, arrays)
    x, y, z = arm(body, force.Pa)
    add_force(body.F, x, y, z, f * force.axis[0], f * force.axis[1], f * force.axis[2])


@kernel
def power(force: Any, t: float, arrays: Any, state: Any) -> float:
    """Force times velocity of its point."""
    body, axis = state.bodies[force.a], force.axis
    x, y, z = arm(body, force.Pa)
    Y = body.Y
    speed = axis[0] * (Y[0] + Y[4] * z - Y[5] * y) + axis[1] * (Y[1] + Y[5] * x - Y[3] * z)
    speed += axis[2] * (Y[2] + Y[3] * y - Y[4] * x)
    return signal_value(force.signal, t, arrays) * speed


@dataclass(frozen=True, kw_only=True)
class PointForce(Force):
    """Force of ``magnitude`` (N: number, signal or input) along ``axis`` (global) at ``at_a`` (m, body frame)."""

    record = np.dtype(
        [
            ("a", np.int64),
            ("signal", np.int64),
            ("Pa", np.float64, (3,)),  # body axes, m
            ("axis", np.float64, (3,)),
        ],
        align=True,
    )
    apply = apply
    power = power

    magnitude: Any
    axis: Any = "y"
    at_a: Any = (0.0, 0.0, 0.0)

    def fill(self, record: Any, site: Site) -> None:
        """Write where it acts, along what, and by what signal."""
        record["a"], record["signal"] = site.bodies[0], site.signal(self.magnitude, f"magnitude of {site.name}")
        record["Pa"], record["axis"] = vector(f"at_a of {site.name}", self.at_a), unit_axis(self.axis)

    def points(self) -> Points:
        """Return its point, and the ground's origin."""
        return (self.at_a, (0.0, 0.0, 0.0))

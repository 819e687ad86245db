"""A given torque on a body, its direction fixed in space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mbfmu.mechanics.dispatch import signal_value
from mbfmu.mechanics.joints.base import unit_axis
from mbfmu.mechanics.kind import Site
from solvers.kernel import kernel

from .base import Force


@kernel
def apply(force: Any, t: float, arrays: Any, state: Any) -> None:
    """See :mod:`.base`."""
    torque = signal_value(force.signal, t, arrays)
    for k in range(3):
        state.bodies[force.a].F[3 + k] += torque * force.axis[k]


@kernel
def power(force: Any, t: float, arrays: Any, state: Any) -> float:
    """Torque times angular velocity about its axis."""
    Y, axis = state.bodies[force.a].Y, force.axis
    return signal_value(force.signal, t, arrays) * (axis[0] * Y[3] + axis[1] * Y[4] + axis[2] * Y[5])


@dataclass(frozen=True, kw_only=True)
class Torque(Force):
    """Torque of ``magnitude`` (N m: number, signal or input) about ``axis`` (global)."""

    record = np.dtype([("a", np.int64), ("signal", np.int64), ("axis", np.float64, (3,))], align=True)
    apply = apply
    power = power

    magnitude: Any
    axis: Any = "z"

    def fill(self, record: Any, site: Site) -> None:
        """Write where it acts, about what, and by what signal."""
        record["a"], record["signal"] = site.bodies[0], site.signal(self.magnitude, f"magnitude of {site.name}")
        record["axis"] = unit_axis(self.axis)

"""A given force or torque along the coordinate of a joint, a motor between parent and child."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mbfmu.mechanics.dispatch import signal_value
from mbfmu.mechanics.kind import Site
from solvers.kernel import kernel

from .base import Force


@kernel
def apply(force: Any, t: float, arrays: Any, state: Any) -> None:
    """See :mod:`.base`."""
    state.Q[force.v] += signal_value(force.signal, t, arrays)


@kernel
def power(force: Any, t: float, arrays: Any, state: Any) -> float:
    """Force times rate of the coordinate."""
    return signal_value(force.signal, t, arrays) * state.v[force.v]


@dataclass(frozen=True, kw_only=True)
class JointForce(Force):
    """Torque (N m) or force (N) on a joint's coordinate: a number, a signal or an input."""

    record = np.dtype([("v", np.int64), ("signal", np.int64)])
    on_joint = True
    apply = apply
    power = power

    magnitude: Any

    def fill(self, record: Any, site: Site) -> None:
        """Write where it acts, and by what signal."""
        record["v"], record["signal"] = site.v, site.signal(self.magnitude, f"magnitude of {site.name}")

"""Stops of a joint of one coordinate, see :mod:`.stops`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mbfmu.mechanics.kind import Site
from solvers.compiled.kernel import kernel

from .base import Force
from .stops import LIMITS, check_limits, fill_limits, lost, push, stored


@kernel
def apply(force: Any, t: float, arrays: Any, state: Any) -> None:
    """See :mod:`.base`."""
    state.Q[force.v] += push(force, state.q[force.q], state.v[force.v])


@kernel
def potential(force: Any, arrays: Any, state: Any) -> float:
    """k x^2 / 2."""
    return stored(force, state.q[force.q])


@kernel
def power(force: Any, t: float, arrays: Any, state: Any) -> float:
    """-(f - k x) x'."""
    return lost(force, state.q[force.q], state.v[force.v])


@dataclass(frozen=True, kw_only=True)
class JointStop(Force):
    """Limits of the joint coordinate of a body.

    Parameters
    ----------
    lower, upper
        Where the stops begin, rad or m; None: there is none on that side.
    stiffness
        N m/rad in a revolute, N/m in a translational joint.
    damping
        Share of the elastic force that is added per rate of penetration, s/rad or s/m. From a speed v, slow for 1 / c,
        the joint comes back with about v (1 - 2 c v / 3).
    """

    record = np.dtype([("q", np.int64), ("v", np.int64), *LIMITS], align=True)
    on_joint = True
    apply = apply
    potential = potential
    power = power

    lower: float | None = None
    upper: float | None = None
    stiffness: float
    damping: float = 0.0

    def check(self, what: str) -> None:
        """Refuse limits without a distance between them."""
        check_limits(what, self)

    def fill(self, record: Any, site: Site) -> None:
        """Write where it acts, between what, and how much."""
        record["q"], record["v"] = site.q, site.v
        fill_limits(record, self)

    @property
    def works(self) -> bool:
        """Whether it is damped."""
        return bool(self.damping)

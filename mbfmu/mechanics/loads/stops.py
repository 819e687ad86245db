"""What stops have in common: beyond a limit a spring pushes back, harder on the way in than on the way out.

With the penetration x > 0 and its rate x' a stop pushes with

    f = k x (1 + c x'),    none where that would pull, x' < -1 / c:

the damping begins with the penetration (Hunt and Crossley 1975), so that the force has no jump. k x^2 / 2 is stored.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import finite, not_negative
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, f8

from .base import Force


class LimitRecord(Record):
    """Parameters of a stop."""

    lower: f8  # rad or m; infinite: none
    upper: f8
    stiffness: f8  # N m/rad or N/m
    damping: f8  # s/rad or s/m


@kernel
def penetration(force: LimitRecord, q: float, v: float) -> tuple[float, float, float]:
    """x, x' and which way the stop pushes along q, v being its rate; x is zero between the limits."""
    if q.real < force.lower.real:
        return force.lower - q, -v, 1.0
    if q.real > force.upper.real:
        return q - force.upper, v, -1.0
    return 0.0 * q, v, 0.0


@kernel
def stop_force(force: LimitRecord, q: float, v: float) -> float:
    """Force of a stop along q."""
    x, rate, way = penetration(force, q, v)
    share = 1.0 + force.damping * rate
    return way * force.stiffness * x * (share if share.real > 0.0 else 0.0 * share)


@kernel
def stop_energy(force: LimitRecord, q: float) -> float:
    """k x^2 / 2."""
    x, _, _ = penetration(force, q, 0.0 * q)
    return 0.5 * force.stiffness * x * x


@kernel
def dissipated_power(force: LimitRecord, q: float, v: float) -> float:
    """Power of what is not stored, -(f - k x) x', never positive."""
    x, _, way = penetration(force, q, v)
    return (stop_force(force, q, v) - way * force.stiffness * x) * v


@dataclass(frozen=True, kw_only=True)
class Stop(Force):
    """Base class of stops: limits, stiffness and damping."""

    lower: float | None = None
    upper: float | None = None
    stiffness: float
    damping: float = 0.0

    def check(self, what: str) -> None:
        """Refuse values that are no numbers, limits without a distance between them, and stops without a limit."""
        not_negative(f"stiffness of {what}", self.stiffness)
        not_negative(f"damping of {what}", self.damping)
        limits = {"lower": self.lower, "upper": self.upper}
        given = [finite(f"{key} of {what}", limit) for key, limit in limits.items() if limit is not None]
        if not given:
            raise UserError(f"{what} has neither lower nor upper; a stop needs one of them")
        if len(given) == 2 and given[0] >= given[1]:
            raise UserError(f"lower of {what} is {self.lower!r}, upper {self.upper!r}; allowed: lower less than upper")

    def fill(self, record: Any, site: Attachment) -> None:
        """Write between what it leaves free, and how it pushes."""
        record["lower"] = -np.inf if self.lower is None else self.lower
        record["upper"] = np.inf if self.upper is None else self.upper
        record["stiffness"], record["damping"] = self.stiffness, self.damping

    @property
    def is_nonconservative(self) -> bool:
        """Whether it is damped."""
        return bool(self.damping)

"""What stops have in common: beyond a limit a spring pushes back, harder on the way in than on the way out.

With the penetration x > 0 and its rate x' a stop pushes with

    f = k x (1 + c x'),    none where that would pull, x' < -1 / c:

the damping begins with the penetration (Hunt and Crossley 1975), so that the force has no jump. k x^2 / 2 is stored.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from mbfmu.mechanics.numbers import finite, not_negative
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, f8


class LimitRecord(Record):
    """Parameters of a stop."""

    lower: f8  # rad or m; infinite: none
    upper: f8
    stiffness: f8  # N m/rad or N/m
    damping: f8  # s/rad or s/m


class Limits(Protocol):
    """Parameters of a stop."""

    @property
    def lower(self) -> float | None:
        """Where it begins, rad or m."""

    @property
    def upper(self) -> float | None:
        """Where it begins on the other side."""

    @property
    def stiffness(self) -> float:
        """N m/rad or N/m."""

    @property
    def damping(self) -> float:
        """s/rad or s/m."""


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


def check_limits(what: str, stop: Limits) -> None:
    """Refuse values that are no numbers, limits without a distance between them, and stops without a limit."""
    not_negative(f"stiffness of {what}", stop.stiffness)
    not_negative(f"damping of {what}", stop.damping)
    limits = {"lower": stop.lower, "upper": stop.upper}
    given = [finite(f"{key} of {what}", limit) for key, limit in limits.items() if limit is not None]
    if not given:
        raise UserError(f"{what} has neither lower nor upper; a stop needs one of them")
    if len(given) == 2 and given[0] >= given[1]:
        raise UserError(f"lower of {what} is {stop.lower!r}, upper {stop.upper!r}; allowed: lower less than upper")


def fill_limits(record: Any, stop: Limits) -> None:
    """Write between what it leaves free, and how it pushes."""
    record["lower"] = -np.inf if stop.lower is None else stop.lower
    record["upper"] = np.inf if stop.upper is None else stop.upper
    record["stiffness"], record["damping"] = stop.stiffness, stop.damping

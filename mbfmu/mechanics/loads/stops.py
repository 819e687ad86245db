"""What stops have in common: beyond a limit a spring pushes back, harder on the way in than on the way out.

With the penetration x > 0 and its rate x' a stop pushes with

    f = k x (1 + c x'),    none where that would pull, x' < -1 / c:

the damping begins with the penetration (Hunt and Crossley 1975), so that the force has no jump. k x^2 / 2 is stored.

A limit that is a signal moves: x' is the rate relative to it. The energy that such a stop stores is in no potential,
and its work is computed instead.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from mbfmu.mechanics.dispatch import signal
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import finite, not_negative
from mbfmu.mechanics.signals import Signal
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, f8, i8

from .base import Force

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays

NO_LIMIT = -1  # in place of a signal


class LimitRecord(Record):
    """Parameters of a stop."""

    lower: f8  # rad or m; infinite: none
    upper: f8
    stiffness: f8  # N m/rad or N/m
    damping: f8  # s/rad or s/m


class MovingLimitRecord(LimitRecord):
    """Parameters of a stop whose limits are signals."""

    lower_signal: i8  # numbers of signals, or NO_LIMIT
    upper_signal: i8


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
def moving_stop_force(force: MovingLimitRecord, q: float, v: float, t: float, arrays: Arrays) -> float:
    """Force along q of a stop whose limits move."""
    x, rate, way = 0.0 * q, 0.0 * v, 0.0
    if force.lower_signal != NO_LIMIT:
        limit, limit_rate, _ = signal(force.lower_signal, t, arrays)
        if q.real < limit.real:
            x, rate, way = limit - q, limit_rate - v, 1.0
    if force.upper_signal != NO_LIMIT:
        limit, limit_rate, _ = signal(force.upper_signal, t, arrays)
        if q.real > limit.real:
            x, rate, way = q - limit, v - limit_rate, -1.0
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


def is_signal(limit: Any) -> bool:
    """Whether a limit is a signal, an input, or a function or expression of time."""
    return isinstance(limit, Signal | str) or callable(limit)


@dataclass(frozen=True, kw_only=True)
class Stop(Force):
    """Base class of stops: limits, stiffness and damping.

    ``moving`` has the kernels of a stop of which a limit is a signal; its record is a MovingLimitRecord.
    """

    moving: ClassVar[type[Force]]

    lower: Any = None
    upper: Any = None
    stiffness: float
    damping: float = 0.0

    def __post_init__(self) -> None:
        """Take the kernels of limits that are signals."""
        if self.is_moving:
            self.become(self.moving)

    @property
    def is_moving(self) -> bool:
        """Whether a limit is a signal."""
        return is_signal(self.lower) or is_signal(self.upper)

    def limits(self) -> dict[str, Any]:
        """Return the limits that are given, by their names."""
        return {key: limit for key, limit in (("lower", self.lower), ("upper", self.upper)) if limit is not None}

    def check(self, what: str) -> None:
        """Refuse values that are no numbers, limits without a distance between them, and stops without a limit."""
        not_negative(f"stiffness of {what}", self.stiffness)
        not_negative(f"damping of {what}", self.damping)
        if not self.limits():
            raise UserError(f"{what} has neither lower nor upper; a stop needs one of them")
        constant = {key: limit for key, limit in self.limits().items() if not is_signal(limit)}
        given = [finite(f"{key} of {what}", limit) for key, limit in constant.items()]
        if len(given) == 2 and given[0] >= given[1]:
            raise UserError(f"lower of {what} is {self.lower!r}, upper {self.upper!r}; allowed: lower less than upper")

    def fill(self, record: Any, site: Attachment) -> None:
        """Write between what it leaves free, and how it pushes."""
        record["stiffness"], record["damping"] = self.stiffness, self.damping
        for key, limit, infinite in (("lower", self.lower, -np.inf), ("upper", self.upper, np.inf)):
            if self.is_moving:
                number = NO_LIMIT if limit is None else site.signal(limit, f"{key} of {site.name}")
                record[f"{key}_signal"] = number
            record[key] = infinite if limit is None or self.is_moving else limit

    @property
    def is_nonconservative(self) -> bool:
        """Whether it is damped, or a limit is a signal."""
        return bool(self.damping) or self.is_moving

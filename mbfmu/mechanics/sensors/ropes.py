"""Tension and length of ropes, which the motion of their bodies determines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.loads.rope import RopeRecord, path_length, rope_tension
from solvers.compiled.kernel import kernel

from .base import Sensor

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from solvers.compiled.record import Reals


@kernel
def tension(sensor: RopeRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    return rope_tension(sensor, arrays, state)


@kernel
def length(sensor: RopeRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    found, _ = path_length(sensor, arrays, state)
    return found


@kernel
def length_rate(sensor: RopeRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    _, found = path_length(sensor, arrays, state)
    return found


@dataclass(frozen=True, kw_only=True)
class RopeTension(Sensor):
    """Tension of the rope ``item``, whose bodies are ``bodies``."""

    record = RopeRecord
    is_kinematic = True
    read = tension

    def fill(self, record: Any, site: Attachment) -> None:
        """Write what the rope has."""
        self.item.load.fill(record, site)


@dataclass(frozen=True, kw_only=True)
class RopeLength(RopeTension):
    """Length of its path."""

    read = length

    def rate_sensor(self) -> Sensor | None:
        """See :class:`.Sensor`."""
        return RopeLengthRate(unit="m/s", item=self.item, bodies=self.bodies)


@dataclass(frozen=True, kw_only=True)
class RopeLengthRate(RopeTension):
    """Rate of the length of its path."""

    read = length_rate

"""First-order states and their rates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.kind import Attachment
from solvers.compiled.kernel import kernel

from .base import Follows, Sensor

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from mbfmu.mechanics.sensors.base import QuantityRecord
    from solvers.compiled.record import Reals


@kernel
def value(sensor: QuantityRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    return state.v[sensor.index]


@kernel
def rate(sensor: QuantityRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    return state.a[sensor.index]


@dataclass(frozen=True, kw_only=True)
class StateValue(Sensor):
    """Value of a first-order state; its item is the state."""

    read = value
    is_kinematic = True

    def fill(self, record: Any, site: Attachment) -> None:
        """Write where it is in State.v."""
        record["index"] = site.state_place(self.item)


@dataclass(frozen=True, kw_only=True)
class StateRate(StateValue):
    """Rate z' of a first-order state."""

    read = rate
    is_kinematic = False
    follows = Follows.LOADS

"""First-order states and their rates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mbfmu.mechanics.kind import Attachment

from .base import Follows, Sensor
from .coordinates import acceleration, velocity


@dataclass(frozen=True, kw_only=True)
class StateValue(Sensor):
    """Value of a first-order state; its item is the state."""

    read = velocity  # states are entries of State.v
    is_kinematic = True

    def fill(self, record: Any, site: Attachment) -> None:
        """Write where it is in State.v."""
        record["index"] = site.state_place(self.item)


@dataclass(frozen=True, kw_only=True)
class StateRate(StateValue):
    """Rate z' of a first-order state."""

    read = acceleration
    is_kinematic = False
    follows = Follows.LOADS

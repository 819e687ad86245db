"""What a sheet feels where it meets surfaces and nips: its loads are evaluated once more, on their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbfmu.mechanics.contact.meeting import ALL, OWN
from mbfmu.mechanics.dispatch import apply_load
from mbfmu.mechanics.kind import Site
from solvers.compiled.kernel import kernel

from .base import Follows, Sensor


@kernel
def sum_over(first: int, count: int, silent: int, arrays: Any, state: Any) -> None:
    """``State.meeting.told`` <- values of ``count`` loads from ``first`` on, ``silent`` as there."""
    here, damped = state.meeting[0], state.damped[0]
    for k in range(here.told.shape[0]):
        here.told[k] = 0.0
    here.silent = silent
    for e in range(first, first + count):
        apply_load(arrays.loads[e], state.time[0].real, arrays, state)
    here.silent, state.damped[0] = 0, damped


@kernel
def read(sensor: Any, lam: Any, arrays: Any, state: Any) -> float:
    """See :mod:`.base`: a sum over loads, or the ratio of two."""
    here = state.meeting[0]
    sum_over(sensor.index, sensor.count, ALL, arrays, state)
    found = sensor.scale * here.told[sensor.component]
    if sensor.over < 0:
        return found
    share = here.told[sensor.over]
    return found / share if share.real > 0.0 else 0.0 * found


@kernel
def pressed(sensor: Any, lam: Any, arrays: Any, state: Any) -> float:
    """See :mod:`.base`: the sizes of the forces of single contacts on their cells, added."""
    told, total = state.meeting[0].told, 0.0
    for e in range(sensor.first, sensor.first + sensor.count):
        sum_over(int(arrays.numbers[e].real), 1, OWN, arrays, state)
        total = total + np.sqrt(told[0] * told[0] + told[1] * told[1] + told[2] * told[2])
    return sensor.scale * total


@dataclass(frozen=True, kw_only=True)
class Met(Sensor):
    """Sum of ``component`` of the contacts, times ``scale``, divided by the sum of ``over`` if that is not negative."""

    record = np.dtype(
        [("index", np.int64), ("component", np.int64), ("count", np.int64), ("over", np.int64), ("scale", np.float64)]
    )
    read = read
    follows = Follows.FORCES

    count: int
    over: int = -1
    scale: float = 1.0

    def loads(self) -> Sequence[int]:
        """Return the numbers of the loads of the contact."""
        return range(self.item.index, self.item.index + self.count)

    def fill(self, record: Any, site: Site) -> None:
        """Write the loads too."""
        super().fill(record, site)
        record["count"], record["over"], record["scale"] = self.count, self.over, self.scale


@dataclass(frozen=True, kw_only=True)
class Pressed(Sensor):
    """Sizes of the forces of single contacts, added, times ``scale``; ``own``: their numbers in Mechanism.others."""

    record = np.dtype([("first", np.int64), ("count", np.int64), ("scale", np.float64)])
    read = pressed
    follows = Follows.FORCES

    own: Sequence[int]
    scale: float

    def loads(self) -> Sequence[int]:
        """Return the numbers of the loads of the contacts."""
        before = self.item.index - self.item.first
        return [before + k for k in self.own]

    def fill(self, record: Any, site: Site) -> None:
        """Write the numbers of the loads."""
        record["first"], record["count"] = site.numbers(self.loads()), len(self.own)
        record["scale"] = self.scale

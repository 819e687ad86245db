"""What a sheet feels where it meets surfaces and nips: its loads are evaluated once more, on their own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mbfmu.mechanics.dispatch import apply_load
from mbfmu.mechanics.kind import Site
from solvers.compiled.kernel import kernel

from .base import Follows, Sensor


@kernel
def sum_over(first: int, count: int, arrays: Any, state: Any) -> None:
    """State.meeting.told <- what ``count`` loads from ``first`` on tell."""
    here = state.meeting[0]
    for k in range(here.told.shape[0]):
        here.told[k] = 0.0
    here.silent = 1
    for e in range(first, first + count):
        apply_load(arrays.loads[e], state.time[0].real, arrays, state)
    here.silent = 0


@kernel
def read(sensor: Any, lam: Any, arrays: Any, state: Any) -> float:
    """See :mod:`.base`: a sum over loads, or the ratio of two; component -1: the size of the force, sums 0 to 2."""
    here = state.meeting[0]
    sum_over(sensor.index, sensor.count, arrays, state)
    if sensor.component < 0:
        x, y, z = here.told[0], here.told[1], here.told[2]
        return sensor.scale * np.sqrt(x * x + y * y + z * z)
    found = sensor.scale * here.told[sensor.component]
    if sensor.over < 0:
        return found
    share = here.told[sensor.over]
    return found / share if share.real > 0.0 else 0.0 * found


@dataclass(frozen=True, kw_only=True)
class Met(Sensor):
    """Sum ``component`` of what contacts tell, times ``scale``, in parts of sum ``over`` if that is not negative.

    Component -1 is the size of the force that sums 0 to 2 are.
    """

    record = np.dtype(
        [("index", np.int64), ("component", np.int64), ("count", np.int64), ("over", np.int64), ("scale", np.float64)]
    )
    read = read
    follows = Follows.FORCES

    count: int
    over: int = -1
    scale: float = 1.0

    def fill(self, record: Any, site: Site) -> None:
        """Write the loads too."""
        super().fill(record, site)
        record["count"], record["over"], record["scale"] = self.count, self.over, self.scale

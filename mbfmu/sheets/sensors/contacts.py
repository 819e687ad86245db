"""What a sheet feels where it meets surfaces and nips: its loads are evaluated once more, on their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.dispatch import apply_load
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.sensors.base import Follows, QuantityRecord, Sensor
from mbfmu.sheets.contact.scratch import ALL_POINTS, CONTACT_SCRATCH, OWN_SHARE, contact_scratch
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, f8, i8

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from mbfmu.sheets.contact.scratch import ContactScratch
    from solvers.compiled.record import Reals


class ContactSumRecord(QuantityRecord):
    """Parameters of :class:`ContactSum`."""

    count: i8
    over: i8
    scratch: i8
    scale: f8


class ContactForceSumRecord(Record):
    """Parameters of :class:`ContactForceSum`."""

    first: i8
    count: i8
    scratch: i8
    scale: f8


@kernel
def sum_contact_results(
    first: int, count: int, accumulate_only: int, arrays: Arrays, state: State, here: ContactScratch
) -> None:
    """``here.result`` <- values of ``count`` loads from ``first`` on; ``here`` is their scratch memory."""
    power = state.cached_power[0]
    for k in range(here.result.shape[0]):
        here.result[k] = 0.0
    here.accumulate_only = accumulate_only
    for e in range(first, first + count):
        apply_load(arrays.loads[e], state.time[0].real, arrays, state)
    here.accumulate_only, state.cached_power[0] = 0, power


@kernel
def read_sum(sensor: ContactSumRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`: a sum over loads, or the ratio of two."""
    here = contact_scratch(sensor, state)
    sum_contact_results(sensor.index, sensor.count, ALL_POINTS, arrays, state, here)
    found = sensor.scale * here.result[sensor.component]
    if sensor.over < 0:
        return found
    share = here.result[sensor.over]
    return found / share if share.real > 0.0 else 0.0 * found


@kernel
def read_force_sum(sensor: ContactForceSumRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`: the sizes of the forces of single contacts on their cells, added."""
    here, total = contact_scratch(sensor, state), 0.0
    result = here.result
    for e in range(sensor.first, sensor.first + sensor.count):
        sum_contact_results(int(arrays.numbers[e].real), 1, OWN_SHARE, arrays, state, here)
        total = total + np.sqrt(result[0] * result[0] + result[1] * result[1] + result[2] * result[2])
    return sensor.scale * total


@dataclass(frozen=True, kw_only=True)
class ContactSum(Sensor):
    """Sum of ``component`` of the contacts, times ``scale``, divided by the sum of ``over`` if that is not negative."""

    record = ContactSumRecord
    read = read_sum
    follows = Follows.FORCES

    count: int
    over: int = -1
    scale: float = 1.0

    def loads(self) -> Sequence[int]:
        """Return the numbers of the loads of the contact."""
        return range(self.item.index, self.item.index + self.count)

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the scratch memory too."""
        super().fill(record, site)
        record["scratch"] = site.scratch(CONTACT_SCRATCH)


@dataclass(frozen=True, kw_only=True)
class ContactForceSum(Sensor):
    """Sizes of the forces of single contacts, added, times ``scale``; ``own``: their numbers in Mechanism.others."""

    record = ContactForceSumRecord
    read = read_force_sum
    follows = Follows.FORCES

    own: Sequence[int]
    scale: float

    def loads(self) -> Sequence[int]:
        """Return the numbers of the loads of the contacts."""
        before = self.item.index - self.item.first
        return [before + k for k in self.own]

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the numbers of the loads."""
        record["first"], record["count"] = site.numbers(self.loads()), len(self.own)
        record["scratch"], record["scale"] = site.scratch(CONTACT_SCRATCH), self.scale

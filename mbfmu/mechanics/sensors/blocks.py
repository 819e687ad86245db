"""Outputs of blocks: sensors, and quantities of laws and of other blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.loads.linear_block import LinearBlockRecord, limited_output, unlimited_output
from mbfmu.mechanics.quantities import Quantity
from mbfmu.mechanics.quantity_kinds import BLOCK, SIGNAL
from solvers.compiled.kernel import kernel
from solvers.compiled.record import i8

from .base import Follows, Sensor

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from solvers.compiled.record import Reals


class BlockOutputRecord(LinearBlockRecord):
    """Parameters of :class:`BlockOutput`."""

    output: i8


@kernel
def value(block: BlockOutputRecord, t: float, arrays: Arrays, state: State) -> float:
    """Return the output at time t, for laws and for blocks."""
    return limited_output(block, block.output, unlimited_output(block, block.output, t, arrays, state), arrays)


@kernel
def read(block: BlockOutputRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    return value(block, state.time[0].real, arrays, state)


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockOutput(Sensor):
    """Output number ``component`` of a block; its item is the handle of the block.

    It has a second kernel ``value(sensor, t, arrays, state)``: laws are evaluated at times at which ``State.time`` may
    be another one.
    """

    kernels: ClassVar = {**Sensor.kernels, "value": "time, arrays, state -> number"}
    record = BlockOutputRecord
    read = read
    value = value
    is_block_output: ClassVar[bool] = True

    def fill(self, record: Any, site: Attachment) -> None:
        """Write what the block has, and the number of the output."""
        block, places = self.item.block, [site.state_place(state) for state in self.item.states]
        block.write(record, site, places[0] if places else 0)
        record["output"] = self.component

    @property
    def direct_inputs(self) -> list[Quantity]:
        """Inputs of the block that change the output at once."""
        block = self.item.block
        return [block.inputs[k] for k in np.flatnonzero(block.D[self.component])]

    @property
    def is_kinematic(self) -> bool:  # type: ignore[override]
        """Whether it does not contain signals."""
        return all(
            quantity.source.is_kinematic
            if quantity.kind == BLOCK
            else quantity.kind != SIGNAL or isinstance(quantity.source, int | float)
            for quantity in self.direct_inputs
        )

    @property
    def follows(self) -> Follows:  # type: ignore[override]
        """What it changes with at once."""
        return Follows.MOTION if self.is_kinematic else Follows.LOADS

    def loads(self) -> Sequence[int]:
        """Return the numbers of its block and of those that it depends on at once."""
        found = [self.item.index]
        for quantity in self.direct_inputs:
            if quantity.kind == BLOCK:
                found += quantity.source.loads()
        return found

"""Interface of sensors: quantities of a mechanism that are outputs of a model.

Its kernel ``read(sensor, lam, arrays, state)`` returns it where the state holds a solution of the equations of motion
with the multipliers ``lam`` (m,): positions, velocities, accelerations, joint wrenches, the effort of drives, and the
energies, State.energy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar

from mbfmu.mechanics.kind import Attachment, ElementType, RecordType
from mbfmu.util.errors import UserError
from solvers.compiled.record import Record, i8


class Follows(IntEnum):
    """What a quantity changes with at once, when a host changes an input at a communication point."""

    MOTION = 0  # positions and rates: nothing, they take a step
    GRAVITY = 1  # potential energy: with gravity
    LOADS = 2  # accelerations: with every load
    FORCES = 3  # as LOADS, for a force, a moment or a generalized force


class QuantityRecord(Record):
    """Parameters of :class:`Sensor`."""

    index: i8  # of the body, the coordinate, the cut joint or the force
    component: i8


@dataclass(frozen=True, kw_only=True)
class Sensor(ElementType):
    """Quantity of a mechanism; created by the methods of ``Body``, ``CutHandle``, ``ForceHandle`` and
    ``Mechanism``.

    Parameters
    ----------
    unit
        Unit of the quantity.
    item
        Body, cut joint or force to which it belongs, if any.
    component
        Number of the component, if there are several.
    bodies
        Bodies that ``fill`` uses, if they are not the one body that is the item.
    stiff
        It is of something so stiff that small errors of positions are large errors of its value.
    """

    kernels: ClassVar = {"read": "lam, arrays, state -> number"}
    read: ClassVar[Any]
    follows: ClassVar[Follows] = Follows.MOTION
    is_kinematic: ClassVar[bool] = False  # positions, velocities and states alone determine it: laws may use it
    reads_energy: ClassVar[bool] = False  # State.energy, which costs a pass over all bodies and loads
    record: ClassVar[RecordType] = QuantityRecord

    unit: str
    item: Any = None
    component: int = 0
    bodies: tuple[Any, ...] = ()
    stiff: bool = False

    def loads(self) -> Sequence[int] | None:
        """Return the numbers of the loads on which the quantity depends at a given motion; None: all."""
        return None

    def rate_sensor(self) -> Sensor | None:
        """Return the sensor of the rate of this quantity, if it is one of positions and there is one; else None."""
        return None

    def fill(self, record: Any, site: Attachment) -> None:
        """Write which body, cut joint or force too."""
        super().fill(record, site)
        record["index"] = 0 if self.item is None else self.item.index


def axis_index(axis: str, of: str) -> int:
    """Return 0, 1, 2 for 'x', 'y', 'z'; ``of`` names the owner in messages."""
    if axis not in ("x", "y", "z"):
        raise UserError(f"component {of} is {axis!r}; allowed: 'x', 'y', 'z'")
    return "xyz".index(axis)

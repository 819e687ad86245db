"""What joints, cut joints and couplings transmit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from solvers.compiled.kernel import kernel

from .base import Follows, Sensor

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from mbfmu.mechanics.sensors.base import QuantityRecord
    from solvers.compiled.record import Reals


@kernel
def joint_wrench(sensor: QuantityRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    return state.bodies[sensor.index].W[sensor.component]


@kernel
def row_force(sensor: Any, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    row = arrays.kept[arrays.cuts[sensor.index].row + sensor.component]
    return -lam[row]


@kernel
def cut_force(sensor: QuantityRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`. -lambda G summed over the rows; component 0 to 2: on body b, 3 to 5: on body a."""
    cut, k, total = arrays.cuts[sensor.index], sensor.component, 0.0 * arrays.world[0].gravity[0]
    for r in range(cut.row, cut.end):
        if arrays.kept[r] >= 0:
            total -= state.rows[r].lam * (state.rows[r].Gb[k] if k < 3 else state.rows[r].Ga[k - 3])
    return total


@kernel
def coupling_effort(sensor: Any, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`. Component 0: along the first coordinate, 1: along the second."""
    force = -lam[arrays.kept[arrays.couplings[sensor.index].row]]
    return force if sensor.component == 0 else -force * state.coupled[sensor.index].slope


@dataclass(frozen=True, kw_only=True)
class JointForce(Sensor):
    """Component of the wrench a tree joint transmits to the body, about its origin, global axes."""

    read = joint_wrench
    follows = Follows.FORCES


@dataclass(frozen=True, kw_only=True)
class RowForce(Sensor):
    """Force or moment of one constraint equation of a cut joint on its body b."""

    read = row_force
    follows = Follows.FORCES


@dataclass(frozen=True, kw_only=True)
class CutForce(Sensor):
    """Global component of the force a cut joint exerts on body b, from component 3 on on body a."""

    read = cut_force
    follows = Follows.FORCES


@dataclass(frozen=True, kw_only=True)
class CouplingEffort(Sensor):
    """What a coupling exerts along the coordinate of its body a, with component 1 along that of b."""

    read = coupling_effort
    follows = Follows.FORCES

"""How a flexible body is bent at a section."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from solvers.compiled.kernel import kernel

from .base import Sensor

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from mbfmu.mechanics.sensors.base import QuantityRecord
    from solvers.compiled.record import Reals


@kernel
def deflection(sensor: QuantityRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    body = arrays.bodies[sensor.index]
    node, total = arrays.nodes[body.node], 0.0 * state.q[body.qi]
    for k in range(body.nv):
        total += node.phi[k] * state.q[body.qi + k]
    return total


@kernel
def bending_moment(sensor: QuantityRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    body = arrays.bodies[sensor.index]
    node, total = arrays.nodes[body.node], 0.0 * state.q[body.qi]
    for k in range(body.nv):
        total += node.moment[k] * state.q[body.qi + k]
    return total


@dataclass(frozen=True, kw_only=True)
class Deflection(Sensor):
    """Along y of the body's frame, m."""

    read = deflection
    is_kinematic = True


@dataclass(frozen=True, kw_only=True)
class BendingMoment(Sensor):
    """E I w'' about z, N m."""

    read = bending_moment

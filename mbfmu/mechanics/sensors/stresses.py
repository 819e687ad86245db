"""Stress at a node of a body of finite elements: a linear function of the amplitudes of its modes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.kind import Attachment
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, i8

from .base import Sensor

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from solvers.compiled.record import Reals


class StressRecord(Record):
    """Parameters of :class:`NodeStress`."""

    index: i8  # body of the modes
    component: i8
    first: i8  # of the stresses by unit amplitudes in Arrays.numbers, Pa/m: xx, yy, zz, xy, xz, yz of every mode


@kernel
def component_of(sensor: StressRecord, component: int, arrays: Arrays, state: State) -> float:
    """Component of the stress tensor, Pa."""
    body = arrays.bodies[sensor.index]
    total = 0.0 * state.q[body.qi]
    for k in range(body.nv):
        total += arrays.numbers[sensor.first + 6 * k + component] * state.q[body.qi + k]
    return total


@kernel
def node_stress(sensor: StressRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    return component_of(sensor, sensor.component, arrays, state)


@kernel
def von_mises_stress(sensor: StressRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    xx, yy, zz = (
        component_of(sensor, 0, arrays, state),
        component_of(sensor, 1, arrays, state),
        component_of(sensor, 2, arrays, state),
    )
    xy, xz, yz = (
        component_of(sensor, 3, arrays, state),
        component_of(sensor, 4, arrays, state),
        component_of(sensor, 5, arrays, state),
    )
    squares = 0.5 * ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) + 3.0 * (xy * xy + xz * xz + yz * yz)
    return np.sqrt(squares)


@dataclass(frozen=True, kw_only=True)
class NodeStress(Sensor):
    """Component of the stress at a node; ``weights`` (6, modes) are the stresses by unit amplitudes, Pa/m."""

    record = StressRecord
    is_kinematic = True
    read = node_stress
    weights: Any

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the body, the component, and the stresses of the modes."""
        super().fill(record, site)
        record["first"] = site.numbers(np.ravel(np.asarray(self.weights, float).T))


@dataclass(frozen=True, kw_only=True)
class VonMisesStress(NodeStress):
    """Equivalent stress of von Mises at a node."""

    read = von_mises_stress

"""What joints, cut joints and couplings transmit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.spatial import arm
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Vec3, i8

from .base import Follows, QuantityRecord, Sensor

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from solvers.compiled.record import Reals


class DeclaredJointRecord(QuantityRecord):
    """Parameters of :class:`DeclaredJointForce`."""

    cut: i8  # number of the cut joint; -1: the joint is in the tree
    sign: i8  # 1: on the child or on body b, -1: on the other body
    body: i8  # on which it acts
    point: Vec3  # reference point of the moment, body axes, m


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
def required_friction(sensor: QuantityRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`. The first row is the normal one."""
    cut, square = arrays.cuts[sensor.index], 0.0 * arrays.world[0].gravity[0]
    normal = 1.0 * square
    for r in range(cut.row, cut.end):
        if arrays.kept[r] >= 0:
            force = lam[arrays.kept[r]]
            if r == cut.row:
                normal = -force
            else:
                square += force * force
    if square.real == 0.0 and square.imag == 0.0:
        return square
    return np.sqrt(square) / normal


@kernel
def coupling_effort(sensor: Any, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`. Component 0: along the first coordinate, 1: along the second."""
    force = -lam[arrays.kept[arrays.couplings[sensor.index].row]]
    return force if sensor.component == 0 else -force * state.coupled[sensor.index].slope


@kernel
def declared_joint_wrench(sensor: DeclaredJointRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`. Of a tree joint the wrench that the child receives, or its reaction; of a cut joint
    -lambda G summed over the rows. A wrench about the origin of the body has the moment M - P x F about the point P.
    """
    here, k = state.bodies[sensor.body], sensor.component
    zero = 0.0 * arrays.world[0].gravity[0]
    fx, fy, fz, mx, my, mz = zero, zero, zero, zero, zero, zero
    if sensor.cut >= 0:
        cut = arrays.cuts[sensor.cut]
        for r in range(cut.row, cut.end):
            if arrays.kept[r] >= 0:
                row = state.rows[r]
                G = row.Gb if sensor.sign == 1 else row.Ga
                fx -= row.lam * G[0]
                fy -= row.lam * G[1]
                fz -= row.lam * G[2]
                mx -= row.lam * G[3]
                my -= row.lam * G[4]
                mz -= row.lam * G[5]
    else:
        child = state.bodies[sensor.index]
        W, sign = child.W, float(sensor.sign)
        x, y, z = child.r[0] - here.r[0], child.r[1] - here.r[1], child.r[2] - here.r[2]
        fx, fy, fz = sign * W[0], sign * W[1], sign * W[2]
        mx = sign * W[3] + y * fz - z * fy
        my = sign * W[4] + z * fx - x * fz
        mz = sign * W[5] + x * fy - y * fx
    px, py, pz = arm(here, sensor.point)
    if k < 3:
        return (fx, fy, fz)[k]
    return (mx - (py * fz - pz * fy), my - (pz * fx - px * fz), mz - (px * fy - py * fx))[k - 3]


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
class RequiredFriction(Sensor):
    """Coefficient of friction that a rolling wheel requires: its friction force over its normal force."""

    read = required_friction
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


@dataclass(frozen=True, kw_only=True)
class DeclaredJointForce(Sensor):
    """Global component of the force of a joint between two bodies on one of them, from component 3 on of its moment.

    The joint is in the tree or a cut joint: its handle, the item, states it when the mechanism is compiled.
    """

    record = DeclaredJointRecord
    read = declared_joint_wrench
    follows = Follows.FORCES

    on: str = "b"

    def fill(self, record: Any, site: Attachment) -> None:
        """Write where the joint is in the mechanism."""
        place = self.item.place(self.on)
        record["index"], record["cut"], record["component"] = place.child, place.cut, self.component
        record["sign"], record["body"], record["point"] = place.sign, place.body, place.point

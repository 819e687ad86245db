"""What can be read off a mechanism: outputs of a model, as records the compiled observer evaluates."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from mbfmu.errors import UserError
from solvers.kernel import kernel

from .cuts.base import arm, centripetal
from .energy import driven_action, kinetic_energy, potential_energy


class Kind(IntEnum):
    """The quantities; ``index`` and ``component`` of a sensor record mean what the comment says."""

    COORDINATE = 0  # index: of q
    RATE = 1  # index: of v
    ACCELERATION = 2  # index: of v
    POINT_POSITION = 3  # index: body, component: global axis
    POINT_VELOCITY = 4
    POINT_ACCELERATION = 5
    CUT_FORCE = 6  # index: constraint row; force or moment on body b along the row
    JOINT_FORCE = 7  # index: body, component: of the wrench the joint transmits to it, about its origin
    EFFORT = 8  # index: of v; force or torque of a driven coordinate
    KINETIC = 9
    POTENTIAL = 10
    ENERGY = 11
    POSITION_RESIDUAL = 12
    VELOCITY_RESIDUAL = 13
    TURN = 14  # index: body; sum of the joint angles from the ground to it
    TURN_RATE = 15
    JACOBI = 16  # energy less the action of the drives
    DEFLECTION = 17  # index: body, a section of an elastic body
    BENDING_MOMENT = 18
    CUT_JOINT_FORCE = 19  # index: cut, component: global axis; force on body b, from 3 on on body a


# What a load changes at once, and what gravity does: all else follows from positions and rates, which take a step.
FORCES = {Kind.CUT_FORCE, Kind.JOINT_FORCE, Kind.EFFORT, Kind.CUT_JOINT_FORCE}
AT_ONCE = {Kind.ACCELERATION, Kind.POINT_ACCELERATION} | FORCES
WEIGHED = AT_ONCE | {Kind.POTENTIAL, Kind.ENERGY, Kind.JACOBI}


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """A quantity of a mechanism; made by the methods of ``Body``, ``CutHandle`` and ``Mechanism``."""

    kind: Kind
    unit: str
    item: Any = None  # the body or cut it belongs to
    component: int = 0
    point: Any = (0.0, 0.0, 0.0)  # body axes, m


def axis_index(axis: str) -> int:
    """Return 0, 1, 2 for 'x', 'y', 'z'."""
    if axis not in ("x", "y", "z"):
        raise UserError(f"component is {axis!r}; allowed: 'x', 'y', 'z'")
    return "xyz".index(axis)


@kernel
def point_value(sensor: Any, arrays: Any, state: Any) -> float:
    """Position, velocity or acceleration component of a body-fixed point, global axes."""
    here = state.bodies[sensor.index]
    k = sensor.component
    x, y, z = arm(here, sensor.point)
    p = (x, y, z)
    if sensor.kind == 3:
        return here.r[k] + p[k]
    i, j = (k + 1) % 3, (k + 2) % 3
    if sensor.kind == 4:
        return here.Y[k] + here.Y[3 + i] * p[j] - here.Y[3 + j] * p[i]
    along = here.dY[k] + here.dY[3 + i] * p[j] - here.dY[3 + j] * p[i]
    return along + centripetal(here, x, y, z, k) + arrays.world[0].gravity[k]


@kernel
def bending(moment: bool, body: Any, arrays: Any, state: Any) -> float:
    """Deflection of a section of an elastic body, or its bending moment."""
    node, total = arrays.nodes[body.node], 0.0 * state.q[body.qi]
    for k in range(body.nv):
        total += (node.moment[k] if moment else node.phi[k]) * state.q[body.qi + k]
    return total


@kernel
def cut_force(i: int, k: int, arrays: Any, state: Any) -> float:
    """Global component k of the force of cut joint i on its body b, or k - 3 on a: -lambda G summed over its rows."""
    end = arrays.cuts[i + 1].row if i + 1 < arrays.cuts.shape[0] else state.rows.shape[0]
    total = 0.0 * arrays.world[0].gravity[0]
    for r in range(arrays.cuts[i].row, end):
        if arrays.kept[r] >= 0:
            total -= state.rows[r].lam * (state.rows[r].Gb[k] if k < 3 else state.rows[r].Ga[k - 3])
    return total


@kernel
def largest_residual(velocity: bool, arrays: Any, state: Any) -> float:
    """Largest |Phi| or |Phi'| of the kept rows."""
    worst = 0.0
    for i in range(arrays.cuts.shape[0]):
        cut = arrays.cuts[i]
        end = arrays.cuts[i + 1].row if i + 1 < arrays.cuts.shape[0] else state.rows.shape[0]
        for r in range(cut.row, end):
            if arrays.kept[r] < 0:
                continue
            row = state.rows[r]
            residual = row.Phi
            if velocity:
                residual = 0.0
                for k in range(6):
                    residual += row.Ga[k] * state.bodies[cut.a].Y[k] + row.Gb[k] * state.bodies[cut.b].Y[k]
            worst = max(worst, abs(residual))
    return worst


@kernel
def turn(rate: bool, i: int, arrays: Any, state: Any) -> float:
    """Absolute angle (or its rate) of body i in a chain of parallel revolutes and sections; counts whole turns."""
    total = 0.0 * arrays.world[0].gravity[0]
    while i > 0:
        body = arrays.bodies[i]
        if body.node >= 0:
            for k in range(body.nv):
                slope = arrays.nodes[body.node].slope[k]
                total += slope * (state.v[body.vi + k] if rate else state.q[body.qi + k])
        elif body.nv == 1:
            total += state.v[body.vi] if rate else state.q[body.qi]
        i = body.parent
    return total


@kernel
def read(sensors: Any, lam: Any, arrays: Any, state: Any, out: Any) -> None:
    """Evaluate every sensor into ``out``; State holds the solution of the equations of motion."""
    energies = False
    for i in range(sensors.shape[0]):
        kind = sensors[i].kind
        energies = energies or 9 <= kind <= 11 or kind == 16
    nothing = 0.0 * arrays.world[0].gravity[0]  # of the kind of number at work, real or complex
    kinetic, stored = nothing, nothing
    if energies:
        kinetic, stored = kinetic_energy(arrays, state), potential_energy(arrays, state)
    for i in range(sensors.shape[0]):
        sensor = sensors[i]
        kind, j = sensor.kind, sensor.index
        if kind == 0:
            out[i] = state.q[j]
        elif kind == 1:
            out[i] = state.v[j]
        elif kind == 2:
            out[i] = state.a[j]
        elif kind <= 5:
            out[i] = point_value(sensor, arrays, state)
        elif kind == 6:
            out[i] = -lam[j]
        elif kind == 7:
            out[i] = state.bodies[j].W[sensor.component]
        elif kind == 8:
            out[i] = state.tau[j]
        elif kind == 9:
            out[i] = kinetic
        elif kind == 10:
            out[i] = stored
        elif kind == 11:
            out[i] = kinetic + stored
        elif kind <= 13:
            out[i] = largest_residual(kind == 13, arrays, state)
        elif kind <= 15:
            out[i] = turn(kind == 15, j, arrays, state)
        elif kind == 16:
            out[i] = kinetic + stored - driven_action(arrays, state)
        elif kind <= 18:
            out[i] = bending(kind == 18, arrays.bodies[j], arrays, state)
        else:
            out[i] = cut_force(j, sensor.component, arrays, state)

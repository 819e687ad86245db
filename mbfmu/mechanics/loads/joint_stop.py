"""Stops of a joint of one coordinate, see :mod:`.stops`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.kind import Attachment
from solvers.compiled.kernel import kernel
from solvers.compiled.record import i8

from .base import Force
from .stops import (
    LimitRecord,
    MovingLimitRecord,
    Stop,
    dissipated_power,
    moving_stop_force,
    stop_energy,
    stop_force,
)

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State


class JointStopRecord(LimitRecord):
    """Parameters of :class:`JointStop`."""

    q: i8
    v: i8


@kernel
def apply(force: JointStopRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    state.Q[force.v] += stop_force(force, state.q[force.q], state.v[force.v])


@kernel
def potential(force: JointStopRecord, arrays: Arrays, state: State) -> float:
    """k x^2 / 2."""
    return stop_energy(force, state.q[force.q])


@kernel
def power(force: JointStopRecord, t: float, arrays: Arrays, state: State) -> float:
    """-(f - k x) x'."""
    return dissipated_power(force, state.q[force.q], state.v[force.v])


class MovingJointStopRecord(MovingLimitRecord):
    """Parameters of :class:`JointStop` of which a limit is a signal."""

    q: i8
    v: i8


@kernel
def apply_moving(force: MovingJointStopRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    state.Q[force.v] += moving_stop_force(force, state.q[force.q], state.v[force.v], t, arrays)


@kernel
def power_moving(force: MovingJointStopRecord, t: float, arrays: Arrays, state: State) -> float:
    """Force times rate of the coordinate."""
    return moving_stop_force(force, state.q[force.q], state.v[force.v], t, arrays) * state.v[force.v]


class MovingJointStop(Force):
    """Record and kernels of a :class:`JointStop` of which a limit is a signal."""

    record = MovingJointStopRecord
    apply = apply_moving
    power = power_moving


@dataclass(frozen=True, kw_only=True)
class JointStop(Stop):
    """End stops of the joint coordinate of a body.

    Parameters
    ----------
    lower, upper
        Limits of the coordinate, rad or m; None: no limit on that side. A limit may be a signal, an input, or an
        expression of time: the work of the stop is computed then, its energy is not.
    stiffness
        Stiffness, N m/rad for an angle, N/m for a displacement.
    damping
        Damping c of the force k x (1 + c x') (Hunt and Crossley), s/rad or s/m. After an impact at a velocity
        v much smaller than 1 / c, the rebound velocity is about v (1 - 2 c v / 3).
    """

    record = JointStopRecord
    on_joint = True
    apply = apply
    potential = potential
    power = power
    moving = MovingJointStop
    variants = (MovingJointStop,)

    def fill(self, record: Any, site: Attachment) -> None:
        """Write its coordinate too."""
        super().fill(record, site)
        record["q"], record["v"] = site.q, site.v

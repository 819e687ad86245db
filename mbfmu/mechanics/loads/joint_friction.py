"""Dry friction on the coordinate of a joint, with stick: an elasto-plastic bristle.

The state z is the force of the bristle over the Coulomb force F = coulomb N, with the normal force N. With the slip v,
the deflection d at z = 1, and g(v) = 1 + (static / coulomb - 1) exp(-(v / stribeck)^2):

    u     = |z| / g(v)
    alpha = 0 if v z <= 0 or u <= beta;  1 if u >= 1;  s^2 (3 - 2 s) with s = (u - beta) / (1 - beta) between
    z'    = v (1 - alpha u) / d
    force = -F (z + tau z' / (1 + (tau v / d)^2)) - viscous v,        tau = 2 xi (m d / F)^(1/2)

(Dupont, Hayward, Armstrong and Altpeter 2002, Single state elastoplastic friction models). Below beta times the
breakaway force x - d z is constant: the joint returns to its place when the load is removed, and does not creep. Three
things differ from the source. The bristle is scaled by the normal force, so that a joint slides when the normal force
is zero. beta refers to g(v). The damping of the bristle fades with the slip, so that it does not increase the force of
a joint that slides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.dispatch import signal_value
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import not_negative, positive
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, f8, i8

from .base import FirstOrderState, Force

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State

CREEP_LIMIT = 0.9  # beta: part of the breakaway force below which nothing creeps
BRISTLE_DAMPING_RATIO = 0.7  # xi
RELATIVE_DEFLECTION = 1e-5  # default of the deflection, relative to the size of the coordinate


class JointFrictionRecord(Record):
    """Parameters of :class:`JointFriction`."""

    v: i8
    state: i8  # place of z
    normal: i8  # signal
    coulomb: f8  # N or N m, per unit of the normal force
    static: f8
    stribeck: f8  # rad/s or m/s
    viscous: f8  # N m s/rad or N s/m
    deflection: f8  # rad or m; 0: the estimated one
    estimated_deflection: f8
    estimated_inertia: f8  # kg m^2 or kg, that the bristle moves


@kernel
def slip_state(force: JointFrictionRecord, normal: float, v: float, z: float) -> tuple[float, float]:
    """Friction force against the slip v (N or N m), and z' (1/s)."""
    d = force.deflection if force.deflection.real > 0.0 else force.estimated_deflection
    g = 1.0 + 0.0 * v
    if force.static.real > force.coulomb.real:
        s = v / force.stribeck
        g += (force.static / force.coulomb - 1.0) * np.exp(-s * s)
    u = (z if z.real >= 0.0 else -z) / g
    yielding = 0.0 * u
    if v.real * z.real > 0.0 and u.real > CREEP_LIMIT:
        if u.real >= 1.0:
            yielding = 1.0 * u
        else:
            s = (u - CREEP_LIMIT) / (1.0 - CREEP_LIMIT)
            yielding = s * s * (3.0 - 2.0 * s) * u
    rate = v * (1.0 - yielding) / d
    resistance, coulomb = force.viscous * v, force.coulomb * normal
    if coulomb.real > 0.0:
        tau = 2.0 * BRISTLE_DAMPING_RATIO * np.sqrt(force.estimated_inertia * d / coulomb)
        fading = tau * v / d
        resistance += coulomb * (z + tau * rate / (1.0 + fading * fading))
    return resistance, rate


@kernel
def apply(force: JointFrictionRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    resistance, rate = slip_state(force, signal_value(force.normal, t, arrays), state.v[force.v], state.v[force.state])
    state.Q[force.v] -= resistance
    state.Q[force.state] += rate


@kernel
def power(force: JointFrictionRecord, t: float, arrays: Arrays, state: State) -> float:
    """Force times slip: heat, and what the bristle stores."""
    v = state.v[force.v]
    resistance, _ = slip_state(force, signal_value(force.normal, t, arrays), v, state.v[force.state])
    return -resistance * v


@dataclass(frozen=True, kw_only=True)
class JointFriction(Force):
    """Dry friction on a joint coordinate, with stick: Coulomb, Stribeck and viscous friction.

    The joint sticks if the load is smaller than the breakaway force ``static * normal_force``: it is then held by an
    elastic bristle, whose largest deflection before sliding is about ``deflection``. It does not creep under a load
    that stays below 0.9 times the breakaway force. With an input as the normal force it is a brake or a clutch.

    Parameters
    ----------
    coulomb
        Friction of sliding per unit of the normal force: the force in N or the torque in N m if the normal force is not
        given. With a normal force in N it is the coefficient of friction of a displacement, and of an angle this
        coefficient times the radius, m.
    static
        Friction at breakaway, as ``coulomb`` and at least as large; None: the same.
    stribeck
        Velocity vs, rad/s or m/s, of the decrease from ``static`` to ``coulomb`` as exp(-(v / vs)^2). Required if
        ``static`` is larger than ``coulomb``. It must be much larger than sqrt(F d / m), the velocity of the vibration
        of the bristle: friction force F, deflection d, moved mass or inertia m.
    viscous
        Coefficient of viscous friction, N m s/rad or N s/m. It is independent of the normal force.
    normal_force
        Normal force: number, signal or input. Negative values count as zero.
    deflection
        Deflection of the bristle at the force ``coulomb``, rad or m: the displacement before sliding. None: 1e-5 of the
        size of the coordinate (1 rad, or the length of the mechanism, or ``nominal`` of the joint). Positions where the
        joint stops have errors of several deflections.
    """

    record = JointFrictionRecord
    on_joint = True
    apply = apply
    power = power
    stick_reason = "joints with friction stick, and their bristles vibrate fast then"

    coulomb: float
    static: float | None = None
    stribeck: float | None = None
    viscous: float = 0.0
    normal_force: Any = 1.0
    deflection: float | None = None

    def check(self, what: str) -> None:
        """Refuse values that are no friction."""
        coulomb = positive(f"coulomb of {what}", self.coulomb)
        not_negative(f"viscous of {what}", self.viscous)
        if self.deflection is not None:
            positive(f"deflection of {what}", self.deflection)
        if self.stribeck is not None:
            positive(f"stribeck of {what}", self.stribeck)
        if self.static is not None and positive(f"static of {what}", self.static) < coulomb:
            raise UserError(f"static of {what} is {self.static!r}; allowed: at least coulomb, {self.coulomb!r}")
        if self.static is not None and self.static > coulomb and self.stribeck is None:
            raise UserError(
                f"stribeck of {what} is not given; give the velocity at which static friction decreases to coulomb"
            )

    @property
    def states(self) -> tuple[FirstOrderState, ...]:
        """Return the force of the bristle over the Coulomb force."""
        return (FirstOrderState(name="bristle", is_held_at_rest=True),)

    def fill(self, record: Any, site: Attachment) -> None:
        """Write where it acts too."""
        record["v"], record["state"] = site.v, site.first_state
        record["normal"] = site.signal(self.normal_force, f"normal_force of {site.name}")
        record["coulomb"], record["viscous"] = self.coulomb, self.viscous
        record["static"] = self.coulomb if self.static is None else self.static
        record["stribeck"] = np.inf if self.stribeck is None else self.stribeck
        record["deflection"] = self.deflection or 0.0

    def fill_estimates(self, record: Any, inertia: float, size: float) -> None:
        """Write the inertia, which damps the bristle, and the default of the deflection."""
        record["estimated_inertia"], record["estimated_deflection"] = inertia, RELATIVE_DEFLECTION * size

    def resolved_displacement(self, record: Any) -> float:
        """Return the deflection of the bristle, rad or m."""
        return float(record["deflection"] or record["estimated_deflection"])

"""Friction of a joint in proportion to the force and the moment that the joint transmits, see :mod:`.reaction`.

The friction follows from the loads of the bearings, and these from the accelerations, which depend on the friction. The
kernel ``apply`` therefore writes the bearings and the state of the bristle into a record of ``State.bearings``, and
:mod:`mbfmu.mechanics.recursions.reaction_friction` determines the friction of all such joints together.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import kernel
from solvers.compiled.record import f8, i8

from .base import Force
from .bristle import BRISTLE_DAMPING_RATIO, CombinedRecord, deflection_of
from .slip import slip_factors

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State


class ReactionFrictionRecord(CombinedRecord):
    """Parameters of a friction whose normal force is a :class:`.Reaction`."""

    bearing: i8  # number of the record in State.bearings; one for each coordinate, in succession
    body: i8  # whose tree joint it is
    bearing_type: i8  # see :mod:`.reaction`
    is_on_b: i8  # 1: the bearings are fixed in body b of the joint
    radius: f8  # m
    thrust_radius: f8
    inverse_length: f8  # 1/m; 0: moments exert no normal force
    inverse_width: f8
    preload: f8  # N


@kernel
def apply(force: ReactionFrictionRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`. The friction that was determined last, the viscous part, and the rates of the bristle."""
    square, factor = slip_factors(force, state)
    d = deflection_of(force)
    damping = 2.0 * BRISTLE_DAMPING_RATIO * np.sqrt(force.estimated_inertia * d)
    for k in range(force.count):
        v, z = force.arms[k] * state.v[force.v + k], state.v[force.state + k]
        rate, here = (v - factor * z) / d, state.bearings[force.bearing + k]
        here.body, here.v, here.bearing_type, here.is_on_b = force.body, force.v + k, force.bearing_type, force.is_on_b
        here.radius, here.thrust_radius, here.preload = force.radius, force.thrust_radius, force.preload
        here.inverse_length, here.inverse_width = force.inverse_length, force.inverse_width
        here.arm, here.coulomb, here.z, here.rate, here.damping = force.arms[k], force.coulomb, z, rate, damping
        here.fading = (damping / d) * (damping / d) * square
        state.Q[force.v + k] -= here.resistance + force.arms[k] * force.viscous * v
        state.Q[force.state + k] += rate


@kernel
def power(force: ReactionFrictionRecord, t: float, arrays: Arrays, state: State) -> float:
    """Heat, and what the bristle stores."""
    total = 0.0 * state.v[force.v]
    for k in range(force.count):
        v, arm = state.v[force.v + k], force.arms[k]
        total -= (state.bearings[force.bearing + k].resistance + arm * arm * force.viscous * v) * v
    return total


class ReactionFriction(Force):
    """Record and kernels of a :class:`.BristleFriction` whose normal force is a :class:`.Reaction`."""

    record = ReactionFrictionRecord
    apply = apply
    power = power

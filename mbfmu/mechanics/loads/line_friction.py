"""Dry friction with stick along the line between two points, see :mod:`.bristle`: the seal of a cylinder.

The slip is the rate of the distance of the points. The bristle is damped by the mass that moves along the line,
1 / (j M^-1 j), with the derivatives j of the distance by the coordinates at the start.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.kind import Attachment
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import inlined, jit_uncached, kernel

from .base import PointPairRecord, Points, fill_points
from .bristle import BristleFriction, BristleRecord, signal_of_normal
from .given import LINE_QUANTITIES
from .slip import slip_state
from .spring import line_of, pull_together, value_on_line

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State


class LineFrictionRecord(BristleRecord, PointPairRecord):
    """Parameters of :class:`LineFriction`."""


@inlined
def resist(force: Any, line: Any, normal: Any, state: State) -> None:
    """Add the friction under a normal force, N, and the rate of its bristle. Points that coincide have no line of
    action: there is no friction.
    """
    _, _, _, length, slip = line
    if length != 0.0:
        resistance, rate = slip_state(force, normal, slip, state.v[force.state])
        pull_together(state.bodies[force.a], state.bodies[force.b], line, resistance)
        state.Q[force.state] += rate


@inlined
def power_of_slip(force: Any, line: Any, normal: Any, state: State) -> Any:
    """Force times slip: heat, and what the bristle stores."""
    _, _, _, length, slip = line
    resistance, _ = slip_state(force, normal, slip, state.v[force.state])
    return -resistance * slip if length != 0.0 else 0.0 * length


@kernel
def apply(force: LineFrictionRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    resist(force, line_of(force, state), signal_of_normal(force, t, arrays, state), state)


@kernel
def power(force: LineFrictionRecord, t: float, arrays: Arrays, state: State) -> float:
    """Force times slip."""
    return power_of_slip(force, line_of(force, state), signal_of_normal(force, t, arrays, state), state)


@cache
def kernels_of_normal(normal: Any) -> tuple[Any, Any]:
    """Return ``apply`` and ``power`` with the normal force that the kernel ``normal`` computes."""
    evaluate = value_on_line(normal)

    def apply(force: Any, t: float, arrays: Arrays, state: State) -> None:
        line = line_of(force, state)
        resist(force, line, evaluate(force, t, arrays, state, line), state)

    def power(force: Any, t: float, arrays: Arrays, state: State) -> Any:
        line = line_of(force, state)
        return power_of_slip(force, line, evaluate(force, t, arrays, state, line), state)

    return jit_uncached(apply), jit_uncached(power)


@dataclass(frozen=True, kw_only=True)
class LineFriction(BristleFriction):
    """Dry friction with stick along the line between a point of body a and a point of body b, as of a cylinder's seal.

    It acts against the rate of the distance of the points, as :class:`.JointFriction` against that of a coordinate,
    and holds the distance if the load is smaller than the breakaway force.

    Parameters
    ----------
    coulomb
        Friction of sliding, N. With a ``normal_force`` it is the coefficient of friction.
    static
        Friction at breakaway, as ``coulomb`` and at least as large; None: the same.
    stribeck
        Velocity vs, m/s, of the decrease from ``static`` to ``coulomb`` as exp(-(v / vs)^2), see
        :class:`.JointFriction`. Required if ``static`` is larger than ``coulomb``.
    viscous
        Coefficient of viscous friction, N s/m. It is independent of the normal force.
    normal_force
        Normal force, N: number, signal or input. With ``uses`` also a function or an expression of the time t, of the
        distance x of the points, of its rate v and of the names there. Negative values count as zero.
    uses
        Other quantities in the normal force, by their names, see :class:`.JointForce`.
    deflection
        Deflection of the bristle at the force ``coulomb``, m. None: 1e-5 of the change of the distance at the start if
        the coordinate that changes it most changes by its nominal value.
    at_a, at_b
        Points in the frames of bodies a and b, m. They must not pass one another: points that coincide have no line of
        action, and the friction is omitted there.
    """

    record = LineFrictionRecord
    on_joint = False
    stick_reason = "the bristles of friction between points are stiff"
    apply = apply
    power = power
    kernels_of_normal = kernels_of_normal
    law_quantities = LINE_QUANTITIES

    at_a: Any = (0.0, 0.0, 0.0)
    at_b: Any = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Refuse a normal force that is the reaction of a joint."""
        if self.follows_reaction:
            raise UserError(
                "normal_force of a LineFriction is a Reaction, which is that of a joint; allowed: a number, a signal, "
                "an input, or a law with `uses`. For the reaction of a joint use JointFriction"
            )
        super().__post_init__()

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the two points too."""
        super().fill(record, site)
        fill_points(self, record, site)

    def slip(self, record: Any, bodies: Any) -> float:
        """Return the rate of the distance, m/s."""
        A, B = bodies[record["a"]], bodies[record["b"]]
        at_a, at_b = A["A"] @ record["Pa"], B["A"] @ record["Pb"]
        line = B["r"] + at_b - A["r"] - at_a
        rate = B["Y"][:3] + np.cross(B["Y"][3:], at_b) - A["Y"][:3] - np.cross(A["Y"][3:], at_a)
        length = float(np.linalg.norm(line))
        return float(line @ rate) / length if length else 0.0

    def points(self) -> Points:
        """Return its two points."""
        return self.at_a, self.at_b

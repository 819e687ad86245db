"""Spring-damper between two points: F = k (l - l0) + c l' along the line that joins them.

Points that coincide have no line. With a relative velocity u they come from there, and go on, along u: l' e is u in the
limit from either side, in space as on a line, so that the damper exerts c u. The limits of the elastic force, k l0
along u and against it, cancel; where l0 is zero both are zero. The elastic force is therefore left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics import law
from mbfmu.mechanics.dispatch import signal_value
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.spatial import add_force, arm
from solvers.compiled.kernel import inlined, jit_uncached, kernel
from solvers.compiled.record import i8

from .base import Force, PointPairRecord, Points, fill_points
from .elastic import ElasticForce, ElasticRecord, elastic_energy, elastic_force

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State


class SpringRecord(ElasticRecord, PointPairRecord):
    """Parameters of :class:`Spring`."""


@kernel
def connecting_line(force: PointPairRecord, A: MotionRecord, B: MotionRecord) -> Any:
    """Direction from a to b, or of the velocity where points coincide, arms of the points, length and its rate."""
    ax, ay, az = arm(A, force.Pa)
    bx, by, bz = arm(B, force.Pb)
    dx, dy, dz = B.r[0] + bx - A.r[0] - ax, B.r[1] + by - A.r[1] - ay, B.r[2] + bz - A.r[2] - az
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    Ya, Yb = A.Y, B.Y
    ux = Yb[0] + Yb[4] * bz - Yb[5] * by - (Ya[0] + Ya[4] * az - Ya[5] * ay)
    uy = Yb[1] + Yb[5] * bx - Yb[3] * bz - (Ya[1] + Ya[5] * ax - Ya[3] * az)
    uz = Yb[2] + Yb[3] * by - Yb[4] * bx - (Ya[2] + Ya[3] * ay - Ya[4] * ax)
    if length == 0.0:
        rate = np.sqrt(ux * ux + uy * uy + uz * uz)
        if rate != 0.0:
            dx, dy, dz = ux / rate, uy / rate, uz / rate
        return (dx, dy, dz), (ax, ay, az), (bx, by, bz), length, rate
    dx, dy, dz = dx / length, dy / length, dz / length
    rate = dx * ux + dy * uy + dz * uz
    return (dx, dy, dz), (ax, ay, az), (bx, by, bz), length, rate


@inlined
def line_of(force: Any, state: State) -> Any:
    """:func:`connecting_line` of the points of a force."""
    return connecting_line(force, state.bodies[force.a], state.bodies[force.b])


@cache
def value_on_line(value: Any) -> Any:
    """Return what evaluates a law of the distance and its rate, which the kernel ``value`` computes, on a line of
    :func:`connecting_line`; zero for points that coincide, where the law may not be defined.
    """

    def evaluate(force: Any, t: float, arrays: Arrays, state: State, line: Any) -> Any:
        _, _, _, length, rate = line
        return value(force, t, arrays, state, length, rate) if length != 0.0 else 0.0 * length

    return jit_uncached(evaluate)


@kernel
def pull_together(A: MotionRecord, B: MotionRecord, line: Any, f: float) -> None:
    """Let a force f pull two points together along the line that joins them; see :func:`connecting_line`."""
    (dx, dy, dz), (ax, ay, az), (bx, by, bz), _, _ = line
    add_force(A.F, ax, ay, az, f * dx, f * dy, f * dz)
    add_force(B.F, bx, by, bz, -f * dx, -f * dy, -f * dz)


@kernel
def apply(force: SpringRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    A, B = state.bodies[force.a], state.bodies[force.b]
    line = connecting_line(force, A, B)
    _, _, _, length, rate = line
    f = force.damping * rate
    if length != 0.0:
        f += elastic_force(force, length - force.free, arrays)
    pull_together(A, B, line, f)


@kernel
def potential(force: SpringRecord, arrays: Arrays, state: State) -> float:
    """Energy of the stretch."""
    _, _, _, length, _ = connecting_line(force, state.bodies[force.a], state.bodies[force.b])
    return elastic_energy(force, length - force.free, arrays)


@kernel
def power(force: SpringRecord, t: float, arrays: Arrays, state: State) -> float:
    """-c l'^2."""
    _, _, _, _, rate = connecting_line(force, state.bodies[force.a], state.bodies[force.b])
    return -force.damping * rate * rate


class MovingSpringRecord(SpringRecord):
    """Parameters of :class:`Spring` whose free length is a signal."""

    signal: i8


@kernel
def moving_force(force: MovingSpringRecord, line: Any, t: float, arrays: Arrays) -> float:
    """Force that pulls the points together; see :func:`connecting_line`."""
    _, _, _, length, rate = line
    f = force.damping * rate
    if length != 0.0:
        f += elastic_force(force, length - signal_value(force.signal, t, arrays), arrays)
    return f


@kernel
def apply_moving(force: MovingSpringRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    A, B = state.bodies[force.a], state.bodies[force.b]
    line = connecting_line(force, A, B)
    pull_together(A, B, line, moving_force(force, line, t, arrays))


@kernel
def power_moving(force: MovingSpringRecord, t: float, arrays: Arrays, state: State) -> float:
    """Force times rate of the distance."""
    line = connecting_line(force, state.bodies[force.a], state.bodies[force.b])
    _, _, _, _, rate = line
    return -moving_force(force, line, t, arrays) * rate


class MovingSpring(Force):
    """Record and kernels of a :class:`Spring` whose free length is a signal."""

    record = MovingSpringRecord
    apply = apply_moving
    power = power_moving


@cache
def kernels_of(f: Any) -> tuple[Any, Any]:
    """Return ``apply`` and ``power`` of a spring whose force is a function."""
    at = law.at

    def apply(force: SpringRecord, t: float, arrays: Arrays, state: State) -> None:
        A, B = state.bodies[force.a], state.bodies[force.b]
        line = connecting_line(force, A, B)
        _, _, _, length, rate = line
        f_x = force.damping * rate
        if length != 0.0:
            f_x += at(f, t, length - force.free, rate)
        pull_together(A, B, line, f_x)

    def power(force: SpringRecord, t: float, arrays: Arrays, state: State) -> float:
        _, _, _, length, rate = connecting_line(force, state.bodies[force.a], state.bodies[force.b])
        f_x = force.damping * rate
        if length != 0.0:
            f_x += at(f, t, length - force.free, rate)
        return -f_x * rate

    return jit_uncached(apply), jit_uncached(power)


@cache
def kernels_of_quantities(value: Any) -> tuple[Any, Any]:
    """Return ``apply`` and ``power`` of a spring or a damper whose law the kernel ``value`` evaluates."""

    def pull(force: Any, line: Any, t: float, arrays: Arrays, state: State) -> Any:
        _, _, _, length, rate = line
        f = force.damping * rate
        if length != 0.0:
            f += value(force, t, arrays, state, length - force.free, rate)
        return f

    pull = jit_uncached(pull)

    def apply(force: Any, t: float, arrays: Arrays, state: State) -> None:
        A, B = state.bodies[force.a], state.bodies[force.b]
        line = connecting_line(force, A, B)
        pull_together(A, B, line, pull(force, line, t, arrays, state))

    def power(force: Any, t: float, arrays: Arrays, state: State) -> Any:
        line = connecting_line(force, state.bodies[force.a], state.bodies[force.b])
        _, _, _, _, rate = line
        return -pull(force, line, t, arrays, state) * rate

    return jit_uncached(apply), jit_uncached(power)


@dataclass(frozen=True, kw_only=True)
class Spring(ElasticForce):
    """Translational spring-damper between a point of body a and a point of body b.

    Parameters
    ----------
    stiffness
        Stiffness, N/m. A ``Table``, a function ``lambda x: ...`` or an expression ``"3 * x**3"`` gives the force (N)
        over the elongation x (m) instead; for functions and expressions work is computed, energy is not. With ``uses``
        also of the time t (s), the rate v of the elongation (m/s) and the names there:
        ``"k * x * (1 + 0.2 * pressure)"``.
    damping
        Damping, N s/m.
    at_a, at_b
        End points in the frames of bodies a and b, m.
    free
        Free length, m: a number, or a signal or an input, as of a muscle or of a drive with a given stiffness. The work
        of a spring with a signal is computed, its energy is not. If the ends coincide, the damper acts along their
        relative velocity, and the elastic force has no direction and is omitted; a message reports this if it occurs at
        the start and ``free`` is not zero.
    uses
        Other quantities in a function or expression, by their names, see :class:`.JointForce`.
    """

    record = SpringRecord
    drawn = "coil"
    apply = apply
    potential = potential
    power = power
    kernels_of_law = kernels_of
    kernels_of_quantities = kernels_of_quantities
    moving = MovingSpring
    variants = (MovingSpring,)

    at_a: Any = (0.0, 0.0, 0.0)
    at_b: Any = (0.0, 0.0, 0.0)

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the two points too."""
        super().fill(record, site)
        fill_points(self, record, site)

    def points(self) -> Points:
        """Return its two points."""
        return self.at_a, self.at_b

    def extent(self) -> float:
        """Return its free length, if it is constant."""
        return 0.0 if self._is_moving() else abs(self.free)

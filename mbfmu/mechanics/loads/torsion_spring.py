"""Torsional spring-damper between two bodies about an axis n fixed in body a: k (phi - phi0) + c phi'.

phi is the turn about n that is left of the attitude of b in a once n has been taken the shortest way to where it is in
b, m (swing and twist). With e, n an orthonormal frame of a, and f, m the one of b that lies on it at phi = 0,

    phi = atan2(e2.f1 - e1.f2, e1.f1 + e2.f2),    phi' = (w_b - w_a).g,    g = (n + m) / (1 + n.m),

so that a torque along g does the work. Where a hinge joins the bodies m is n, and phi its angle, from -pi to pi.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from mbfmu.mechanics import law
from mbfmu.mechanics.axes import along, unit_axis
from mbfmu.mechanics.checks import rotation
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.spatial import angle_of, arm
from solvers.compiled.kernel import jit_uncached, kernel
from solvers.compiled.record import Mat3, i8

from .elastic import ElasticForce, ElasticRecord, elastic_energy, elastic_force
from .given import LawRecord

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State


class TorsionSpringRecord(ElasticRecord):
    """Parameters of :class:`TorsionSpring`."""

    a: i8
    b: i8
    Ea: Mat3  # rows e1, e2, n, axes of a
    Eb: Mat3  # rows f1, f2, m, axes of b


@kernel
def _twist(force: TorsionSpringRecord, A: MotionRecord, B: MotionRecord) -> Any:
    """phi, phi' and g, global axes; all zero where m is opposite to n, which has no shortest way."""
    ex, ey, ez = arm(A, force.Ea[0])
    hx, hy, hz = arm(A, force.Ea[1])
    nx, ny, nz = arm(A, force.Ea[2])
    fx, fy, fz = arm(B, force.Eb[0])
    jx, jy, jz = arm(B, force.Eb[1])
    mx, my, mz = arm(B, force.Eb[2])
    share = 1.0 + nx * mx + ny * my + nz * mz
    if share.real <= 0.0:
        return 0.0 * share, 0.0 * share, (0.0 * share, 0.0 * share, 0.0 * share)
    sine = hx * fx + hy * fy + hz * fz - (ex * jx + ey * jy + ez * jz)
    cosine = ex * fx + ey * fy + ez * fz + hx * jx + hy * jy + hz * jz
    gx, gy, gz = (nx + mx) / share, (ny + my) / share, (nz + mz) / share
    rate = gx * (B.Y[3] - A.Y[3]) + gy * (B.Y[4] - A.Y[4]) + gz * (B.Y[5] - A.Y[5])
    return angle_of(sine, cosine), rate, (gx, gy, gz)


@kernel
def apply_torque(A: MotionRecord, B: MotionRecord, torque: float, g: Any) -> None:
    """Let a torque act along g on a, and against it on b."""
    gx, gy, gz = g
    A.F[3] += torque * gx
    A.F[4] += torque * gy
    A.F[5] += torque * gz
    B.F[3] -= torque * gx
    B.F[4] -= torque * gy
    B.F[5] -= torque * gz


@kernel
def apply(force: TorsionSpringRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    A, B = state.bodies[force.a], state.bodies[force.b]
    phi, rate, g = _twist(force, A, B)
    apply_torque(A, B, elastic_force(force, phi - force.free, arrays) + force.damping * rate, g)


@kernel
def potential(force: TorsionSpringRecord, arrays: Arrays, state: State) -> float:
    """Energy of the turn from phi0."""
    phi, _, _ = _twist(force, state.bodies[force.a], state.bodies[force.b])
    return elastic_energy(force, phi - force.free, arrays)


@kernel
def power(force: TorsionSpringRecord, t: float, arrays: Arrays, state: State) -> float:
    """-c phi'^2."""
    _, rate, _ = _twist(force, state.bodies[force.a], state.bodies[force.b])
    return -force.damping * rate * rate


@cache
def kernels_of(f: Any) -> tuple[Any, Any]:
    """Return ``apply`` and ``power`` of a spring whose torque is a function."""
    at = law.at

    def apply(force: Any, t: float, arrays: Arrays, state: State) -> None:
        A, B = state.bodies[force.a], state.bodies[force.b]
        phi, rate, g = _twist(force, A, B)
        apply_torque(A, B, at(f, t, phi - force.free, rate) + force.damping * rate, g)

    def power(force: Any, t: float, arrays: Arrays, state: State) -> Any:
        phi, rate, _ = _twist(force, state.bodies[force.a], state.bodies[force.b])
        return -(at(f, t, phi - force.free, rate) + force.damping * rate) * rate

    return jit_uncached(apply), jit_uncached(power)


class TorsionLawRecord(LawRecord, TorsionSpringRecord):
    """Parameters of :class:`TorsionSpring` with a law of other quantities."""


@cache
def kernels_of_quantities(value: Any) -> tuple[Any, Any]:
    """Return ``apply`` and ``power`` of a spring whose law the kernel ``value`` evaluates."""

    def apply(force: Any, t: float, arrays: Arrays, state: State) -> None:
        A, B = state.bodies[force.a], state.bodies[force.b]
        phi, rate, g = _twist(force, A, B)
        apply_torque(A, B, value(force, t, arrays, state, phi - force.free, rate) + force.damping * rate, g)

    def power(force: Any, t: float, arrays: Arrays, state: State) -> Any:
        phi, rate, _ = _twist(force, state.bodies[force.a], state.bodies[force.b])
        return -(value(force, t, arrays, state, phi - force.free, rate) + force.damping * rate) * rate

    return jit_uncached(apply), jit_uncached(power)


@dataclass(frozen=True, kw_only=True)
class TorsionSpring(ElasticForce):
    """Torsional spring-damper between bodies a and b about an axis of body a.

    The angle is that of a hinge about the axis, from -pi to pi, where angle and torque are discontinuous; for larger
    rotations use a :class:`.JointSpring`. If b is tilted relative to a, it is the twist without the tilt;
    it is zero, and so is the torque, if the axis in b has the opposite direction.

    Parameters
    ----------
    axis
        Axis in the frame of body a.
    stiffness, damping
        Stiffness, N m/rad, and damping, N m s/rad; a ``Table`` in place of a stiffness gives the torque over the
        rotation x from ``free``, as does a function ``lambda x: ...`` or an expression: the work of such a function is
        computed, its energy is not. With ``uses`` also of the time t (s), the rate v of the rotation and the
        names there.
    free
        Unloaded angle of b in a, rad.
    uses
        Other quantities in a function or expression, by their names, see :class:`.JointForce`.
    rotation
        3x3 axes of b in a at the angle zero, such as the ``rotation`` of a joint; None: parallel.
    """

    record = TorsionSpringRecord
    apply = apply
    potential = potential
    power = power
    kernels_of_law = kernels_of
    kernels_of_quantities = kernels_of_quantities
    quantity_record = TorsionLawRecord

    axis: Any = "z"
    rotation: Any = None

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the two frames too."""
        super().fill(record, site)
        record["a"], record["b"] = site.bodies
        frame = along(unit_axis(self.axis, f"axis of {site.name}"))
        record["Ea"], record["Eb"] = frame.T, frame.T @ rotation(f"rotation of {site.name}", self.rotation)

"""Torsional spring-damper between two bodies about an axis n fixed in body a: k (phi - phi0) + c phi'.

phi is the turn about n that is left of the attitude of b in a once n has been taken the shortest way to where it is in
b, m (swing and twist). With e, n an orthonormal frame of a, and f, m the one of b that lies on it at phi = 0,

    phi = atan2(e2.f1 - e1.f2, e1.f1 + e2.f2),    phi' = (w_b - w_a).g,    g = (n + m) / (1 + n.m),

so that a torque along g does the work. Where a hinge joins the bodies m is n, and phi its angle, from -pi to pi.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mbfmu.mechanics.axes import along, unit_axis
from mbfmu.mechanics.checks import rotation
from mbfmu.mechanics.kind import Site
from mbfmu.mechanics.numbers import finite
from mbfmu.mechanics.spatial import angle_of, arm
from solvers.compiled.kernel import kernel

from .base import Force


@kernel
def _twist(force: Any, A: Any, B: Any) -> Any:
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
def apply(force: Any, t: float, arrays: Any, state: Any) -> None:
    """See :mod:`.base`."""
    A, B = state.bodies[force.a], state.bodies[force.b]
    phi, rate, (gx, gy, gz) = _twist(force, A, B)
    torque = force.stiffness * (phi - force.free) + force.damping * rate
    A.F[3] += torque * gx
    A.F[4] += torque * gy
    A.F[5] += torque * gz
    B.F[3] -= torque * gx
    B.F[4] -= torque * gy
    B.F[5] -= torque * gz


@kernel
def potential(force: Any, arrays: Any, state: Any) -> float:
    """k (phi - phi0)^2 / 2."""
    phi, _, _ = _twist(force, state.bodies[force.a], state.bodies[force.b])
    return 0.5 * force.stiffness * (phi - force.free) * (phi - force.free)


@kernel
def power(force: Any, t: float, arrays: Any, state: Any) -> float:
    """-c phi'^2."""
    _, rate, _ = _twist(force, state.bodies[force.a], state.bodies[force.b])
    return -force.damping * rate * rate


@dataclass(frozen=True, kw_only=True)
class TorsionSpring(Force):
    """Torsional spring-damper between bodies a and b about an axis of body a.

    The angle is that of a hinge about the axis, from -pi to pi, where it jumps and the torque with it; what turns
    further wants a :class:`.JointSpring`. Where b is tilted from a it is the twist that is left without the tilt, and
    there is none, and no torque, where b has the axis upside down.

    Parameters
    ----------
    axis
        In the frame of body a.
    stiffness, damping
        N m/rad and N m s/rad.
    free
        Unloaded angle of b in a, rad.
    rotation
        3x3 axes of b in a where the angle is zero, such as the ``rotation`` of a joint; None: parallel.
    """

    record = np.dtype(
        [
            ("a", np.int64),
            ("b", np.int64),
            ("Ea", np.float64, (3, 3)),  # rows e1, e2, n, axes of a
            ("Eb", np.float64, (3, 3)),  # rows f1, f2, m, axes of b
            ("stiffness", np.float64),
            ("damping", np.float64),
            ("free", np.float64),
        ],
        align=True,
    )
    apply = apply
    potential = potential
    power = power

    axis: Any = "z"
    stiffness: float = 0.0
    damping: float = 0.0
    free: float = 0.0
    rotation: Any = None

    def check(self, what: str) -> None:
        """Refuse what is no number."""
        for key in ("stiffness", "damping", "free"):
            finite(f"{key} of {what}", getattr(self, key))

    def fill(self, record: Any, site: Site) -> None:
        """Write the two frames, and how much."""
        record["a"], record["b"] = site.bodies
        frame = along(unit_axis(self.axis))
        record["Ea"], record["Eb"] = frame.T, frame.T @ rotation(f"rotation of {site.name}", self.rotation)
        record["stiffness"], record["damping"], record["free"] = self.stiffness, self.damping, self.free

    @property
    def works(self) -> bool:
        """Whether it is damped."""
        return bool(self.damping)

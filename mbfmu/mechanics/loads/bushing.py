"""Bushing between two bodies: what it resists along and about the axes of a frame in body a.

d is the way from the point of a to that of b in the axes of the frame E in a, e = (w, v) the unit quaternion of the
attitude of the frame in b, E^T E_b, and p = 2 v its turn: along its axis, twice the sine of half its angle.

    U = sum k_i d_i^2 / 2 + sum kappa_i p_i^2 / 2,    force k_i d_i + c_i d_i', moment kappa_i p_i + gamma_i p_i' along
    p_i,

and p' = w u + u x v with the angular velocity u of b in a. Moments are thus the gradient of U however far b turns, and
the same of e and -e: there is no attitude at which anything jumps. The force acts on both bodies at the point of b.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.checks import rotation
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import array_of
from mbfmu.mechanics.spatial import add_force, arm, point_offset, point_offset_rate, quaternion_of
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Mat3, Record, Vec3, Vec6, i8

from .base import Force, Points, fill_points

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State
    from solvers.compiled.record import Reals


class BushingRecord(Record):
    """Parameters of :class:`Bushing`."""

    a: i8
    b: i8
    Pa: Vec3  # body axes, m
    Pb: Vec3
    Ea: Mat3  # rows: x, y, z of the frame in body axes
    Eb: Mat3
    stiffness: Vec6  # along x, y, z, about x, y, z
    damping: Vec6


@kernel
def _axes(body: MotionRecord, E: Reals) -> Any:
    """Axes of a frame E, rows in body axes, in global ones."""
    return arm(body, E[0]), arm(body, E[1]), arm(body, E[2])


@kernel
def _dot(a: Any, b: Any) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def _attitude(force: BushingRecord, A: MotionRecord, B: MotionRecord) -> Any:
    """Quaternion of the frame in b, in the one in a."""
    fx, fy, fz = _axes(B, force.Eb)
    ex, ey, ez = _axes(A, force.Ea)
    return quaternion_of(
        (_dot(ex, fx), _dot(ex, fy), _dot(ex, fz)),
        (_dot(ey, fx), _dot(ey, fy), _dot(ey, fz)),
        (_dot(ez, fx), _dot(ez, fy), _dot(ez, fz)),
    )


@kernel
def _stretch(force: BushingRecord, A: MotionRecord, B: MotionRecord) -> tuple[float, float, float, float, float, float]:
    """(d, p)."""
    d, _, _ = point_offset(A, B, force.Pa, force.Pb)
    ex, ey, ez = _axes(A, force.Ea)
    _, x, y, z = _attitude(force, A, B)
    return _dot(ex, d), _dot(ey, d), _dot(ez, d), 2.0 * x, 2.0 * y, 2.0 * z


@kernel
def _stretch_rate(
    force: BushingRecord, A: MotionRecord, B: MotionRecord
) -> tuple[float, float, float, float, float, float]:
    """(d, p)', seen from the frame."""
    rise = point_offset_rate(A, B, force.Pa, force.Pb)
    ex, ey, ez = _axes(A, force.Ea)
    Ya, Yb = A.Y, B.Y
    spin = (Yb[3] - Ya[3], Yb[4] - Ya[4], Yb[5] - Ya[5])
    ux, uy, uz = _dot(ex, spin), _dot(ey, spin), _dot(ez, spin)
    w, vx, vy, vz = _attitude(force, A, B)
    return (
        _dot(ex, rise),
        _dot(ey, rise),
        _dot(ez, rise),
        w * ux + uy * vz - uz * vy,
        w * uy + uz * vx - ux * vz,
        w * uz + ux * vy - uy * vx,
    )


@kernel
def apply(force: BushingRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    A, B = state.bodies[force.a], state.bodies[force.b]
    k, c = force.stiffness, force.damping
    s, rate = _stretch(force, A, B), _stretch_rate(force, A, B)
    px, py, pz = k[0] * s[0] + c[0] * rate[0], k[1] * s[1] + c[1] * rate[1], k[2] * s[2] + c[2] * rate[2]
    mx, my, mz = k[3] * s[3] + c[3] * rate[3], k[4] * s[4] + c[4] * rate[4], k[5] * s[5] + c[5] * rate[5]
    w, vx, vy, vz = _attitude(force, A, B)
    # on a, in its frame: what u does to p, transposed
    nx, ny, nz = w * mx + vy * mz - vz * my, w * my + vz * mx - vx * mz, w * mz + vx * my - vy * mx
    ex, ey, ez = _axes(A, force.Ea)
    gx = ex[0] * px + ey[0] * py + ez[0] * pz
    gy = ex[1] * px + ey[1] * py + ez[1] * pz
    gz = ex[2] * px + ey[2] * py + ez[2] * pz
    _, (x, y, z), (bx, by, bz) = point_offset(A, B, force.Pa, force.Pb)
    add_force(A.F, x, y, z, gx, gy, gz)
    add_force(B.F, bx, by, bz, -gx, -gy, -gz)
    for i in range(3):
        moment = ex[i] * nx + ey[i] * ny + ez[i] * nz
        A.F[3 + i] += moment
        B.F[3 + i] -= moment


@kernel
def potential(force: BushingRecord, arrays: Arrays, state: State) -> float:
    """U."""
    s, k = _stretch(force, state.bodies[force.a], state.bodies[force.b]), force.stiffness
    total = 0.0 * s[0]
    for i in range(6):
        total += 0.5 * k[i] * s[i] * s[i]
    return total


@kernel
def power(force: BushingRecord, t: float, arrays: Arrays, state: State) -> float:
    """-sum c_i d_i'^2 - sum gamma_i p_i'^2."""
    rate, c = _stretch_rate(force, state.bodies[force.a], state.bodies[force.b]), force.damping
    total = 0.0 * rate[0]
    for i in range(6):
        total -= c[i] * rate[i] * rate[i]
    return total


@dataclass(frozen=True, kw_only=True)
class Bushing(Force):
    """Bushing: springs and dampers along and about the axes of a frame in body a, between points of bodies a and b.

    It is unloaded if the points and the frames coincide. The moment has a potential at any rotation and is
    proportional to the
    sine of the rotation angle: it is largest at 90 degrees and zero at 180 degrees.

    Parameters
    ----------
    stiffness, damping
        Translational stiffness, N/m, and damping, N s/m, along x, y, z of the frame; a single number applies to all.
    rotational_stiffness, rotational_damping
        Rotational stiffness, N m/rad, and damping, N m s/rad, about x, y, z of the frame.
    at_a, at_b
        Points in the frames of the bodies, m.
    rotation_a, rotation_b
        3x3 axes of the frame in the two bodies; identity by default.
    """

    record = BushingRecord
    apply = apply
    potential = potential
    power = power

    stiffness: Any = 0.0
    damping: Any = 0.0
    rotational_stiffness: Any = 0.0
    rotational_damping: Any = 0.0
    at_a: Any = (0.0, 0.0, 0.0)
    at_b: Any = (0.0, 0.0, 0.0)
    rotation_a: Any = None
    rotation_b: Any = None

    def check(self, what: str) -> None:
        """Refuse what is no stiffness."""
        for key in ("stiffness", "damping", "rotational_stiffness", "rotational_damping"):
            _along_axes(f"{key} of {what}", getattr(self, key))

    def fill(self, record: Any, site: Attachment) -> None:
        """Write points, frames, stiffness and damping."""
        name = site.name
        fill_points(self, record, site)
        record["Ea"] = rotation(f"rotation_a of {name}", self.rotation_a).T
        record["Eb"] = rotation(f"rotation_b of {name}", self.rotation_b).T
        for key in ("stiffness", "damping"):
            onward, about = getattr(self, key), getattr(self, f"rotational_{key}")
            record[key] = [*_along_axes(f"{key} of {name}", onward), *_along_axes(f"rotational_{key} of {name}", about)]

    @property
    def is_nonconservative(self) -> bool:
        """Whether it is damped."""
        return bool(np.any(self.damping) or np.any(self.rotational_damping))

    def points(self) -> Points:
        """Return its two points."""
        return self.at_a, self.at_b


def _along_axes(what: str, value: Any) -> NDArray[np.float64]:
    """Return one number, or three, as three; none of them negative."""
    array = array_of(what, value)
    if array.shape not in ((), (3,)) or not np.all(np.isfinite(array)) or np.any(array < 0.0):
        raise UserError(f"{what} is {value!r}; allowed: one number or three, finite and not negative")
    return np.broadcast_to(array, (3,))

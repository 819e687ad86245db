"""Beam between two bodies: what an element of a chain of nodal bodies resists.

The beam is straight where body b lies at ``length`` along the x axis of body a, its axes parallel. d is the
displacement of b from there in a's axes, phi the axial vector of (R - R^T) / 2, R = A_a^T A_b: the turn of b where that
is small;

    U = (d, phi)^T K (d, phi) / 2,    force and moment  K ((d, phi) + beta (d, phi)'),

K the stiffness of a cantilever of this length, clamped at a. dR = [w x] R gives d phi = (tr R 1 - R) w / 2. Nothing is
linearized in how the bodies move, but between the two of an element displacement and turn should be small.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.loads.base import Force
from mbfmu.mechanics.numbers import not_negative, positive
from mbfmu.mechanics.spatial import add_force
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Reals, Record, f8, i8

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State


class BeamElementRecord(Record):
    """Parameters of :class:`BeamElement`."""

    a: i8
    b: i8
    length: f8
    damping: f8
    stiffness: Annotated[Reals, (4,)]  # stretching, N, torsion, bending along y and z, N m^2


@kernel
def _turn(A: Reals, B: Reals, i: int, j: int) -> float:
    """R[i, j] of R = A^T B."""
    return A[0, i] * B[0, j] + A[1, i] * B[1, j] + A[2, i] * B[2, j]


@kernel
def _along(A: Reals, i: int, x: float, y: float, z: float) -> float:
    """Component i of a vector in the axes A."""
    return A[0, i] * x + A[1, i] * y + A[2, i] * z


@kernel
def _stretch(
    force: BeamElementRecord, a: MotionRecord, b: MotionRecord
) -> tuple[float, float, float, float, float, float]:
    """(d, phi)."""
    x, y, z = b.r[0] - a.r[0], b.r[1] - a.r[1], b.r[2] - a.r[2]
    A, B = a.A, b.A
    return (
        _along(A, 0, x, y, z) - force.length,
        _along(A, 1, x, y, z),
        _along(A, 2, x, y, z),
        0.5 * (_turn(A, B, 2, 1) - _turn(A, B, 1, 2)),
        0.5 * (_turn(A, B, 0, 2) - _turn(A, B, 2, 0)),
        0.5 * (_turn(A, B, 1, 0) - _turn(A, B, 0, 1)),
    )


@kernel
def _resist(
    force: BeamElementRecord, dx: float, dy: float, dz: float, px: float, py: float, pz: float
) -> tuple[float, ...]:
    """K (d, phi): stretching, torsion, and bending along y and along z."""
    k, h = force.stiffness, force.length
    bend_y, bend_z = k[2] / h**3, k[3] / h**3
    return (
        k[0] / h * dx,
        bend_y * (12.0 * dy - 6.0 * h * pz),
        bend_z * (12.0 * dz + 6.0 * h * py),
        k[1] / h * px,
        bend_z * (6.0 * h * dz + 4.0 * h * h * py),
        bend_y * (-6.0 * h * dy + 4.0 * h * h * pz),
    )


@kernel
def _stretch_rate(a: MotionRecord, b: MotionRecord) -> tuple[float, float, float, float, float, float]:
    """(d, phi)', in a's axes."""
    A, B = a.A, b.A
    x, y, z = b.r[0] - a.r[0], b.r[1] - a.r[1], b.r[2] - a.r[2]
    wx, wy, wz = a.Y[3], a.Y[4], a.Y[5]
    vx, vy, vz = (
        b.Y[0] - a.Y[0] - (wy * z - wz * y),
        b.Y[1] - a.Y[1] - (wz * x - wx * z),
        b.Y[2] - a.Y[2] - (wx * y - wy * x),
    )
    ux, uy, uz = b.Y[3] - wx, b.Y[4] - wy, b.Y[5] - wz
    sx, sy, sz = _along(A, 0, ux, uy, uz), _along(A, 1, ux, uy, uz), _along(A, 2, ux, uy, uz)
    trace = _turn(A, B, 0, 0) + _turn(A, B, 1, 1) + _turn(A, B, 2, 2)
    return (
        _along(A, 0, vx, vy, vz),
        _along(A, 1, vx, vy, vz),
        _along(A, 2, vx, vy, vz),
        0.5 * (trace * sx - _turn(A, B, 0, 0) * sx - _turn(A, B, 0, 1) * sy - _turn(A, B, 0, 2) * sz),
        0.5 * (trace * sy - _turn(A, B, 1, 0) * sx - _turn(A, B, 1, 1) * sy - _turn(A, B, 1, 2) * sz),
        0.5 * (trace * sz - _turn(A, B, 2, 0) * sx - _turn(A, B, 2, 1) * sy - _turn(A, B, 2, 2) * sz),
    )


@kernel
def apply(force: BeamElementRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`mbfmu.mechanics.loads.base`."""
    a, b = state.bodies[force.a], state.bodies[force.b]
    A, B = a.A, b.A
    dx, dy, dz, px, py, pz = _stretch(force, a, b)
    ux, uy, uz, sx, sy, sz = _stretch_rate(a, b)
    beta = force.damping
    fx, fy, fz, mx, my, mz = _resist(
        force, dx + beta * ux, dy + beta * uy, dz + beta * uz, px + beta * sx, py + beta * sy, pz + beta * sz
    )
    x, y, z = b.r[0] - a.r[0], b.r[1] - a.r[1], b.r[2] - a.r[2]
    trace = _turn(A, B, 0, 0) + _turn(A, B, 1, 1) + _turn(A, B, 2, 2)
    # moment on b: (tr R 1 - R^T) m / 2 with reversed sign
    nx = 0.5 * (trace * mx - _turn(A, B, 0, 0) * mx - _turn(A, B, 1, 0) * my - _turn(A, B, 2, 0) * mz)
    ny = 0.5 * (trace * my - _turn(A, B, 0, 1) * mx - _turn(A, B, 1, 1) * my - _turn(A, B, 2, 1) * mz)
    nz = 0.5 * (trace * mz - _turn(A, B, 0, 2) * mx - _turn(A, B, 1, 2) * my - _turn(A, B, 2, 2) * mz)
    gx = A[0, 0] * fx + A[0, 1] * fy + A[0, 2] * fz
    gy = A[1, 0] * fx + A[1, 1] * fy + A[1, 2] * fz
    gz = A[2, 0] * fx + A[2, 1] * fy + A[2, 2] * fz
    add_force(b.F, 0.0, 0.0, 0.0, -gx, -gy, -gz)
    add_force(a.F, x, y, z, gx, gy, gz)
    for k in range(3):
        n = A[k, 0] * nx + A[k, 1] * ny + A[k, 2] * nz
        b.F[3 + k] -= n
        a.F[3 + k] += n


@kernel
def potential(force: BeamElementRecord, arrays: Arrays, state: State) -> float:
    """U."""
    dx, dy, dz, px, py, pz = _stretch(force, state.bodies[force.a], state.bodies[force.b])
    fx, fy, fz, mx, my, mz = _resist(force, dx, dy, dz, px, py, pz)
    return 0.5 * (fx * dx + fy * dy + fz * dz + mx * px + my * py + mz * pz)


@kernel
def power(force: BeamElementRecord, t: float, arrays: Arrays, state: State) -> float:
    """-beta (d, phi)'^T K (d, phi)'."""
    ux, uy, uz, sx, sy, sz = _stretch_rate(state.bodies[force.a], state.bodies[force.b])
    fx, fy, fz, mx, my, mz = _resist(force, ux, uy, uz, sx, sy, sz)
    return -force.damping * (fx * ux + fy * uy + fz * uz + mx * sx + my * sy + mz * sz)


@dataclass(frozen=True, kw_only=True)
class BeamElement(Force):
    """Straight uniform beam element from body a along its x axis to body b.

    Parameters
    ----------
    length
        Length, m.
    axial, torsion
        Axial stiffness E A, N, and torsional stiffness G I_t, N m^2.
    bending_y, bending_z
        Bending stiffness E I for deflections along y and along z, N m^2.
    damping
        Damping time of the material, s.
    """

    record = BeamElementRecord
    apply = apply
    potential = potential
    power = power

    length: float
    axial: float
    torsion: float = 0.0
    bending_y: float = 0.0
    bending_z: float = 0.0
    damping: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no beam, naming it."""
        positive("length of a beam element", self.length)
        for name in ("axial", "torsion", "bending_y", "bending_z", "damping"):
            not_negative(f"{name} of a beam element", getattr(self, name))

    def fill(self, record: Any, site: Attachment) -> None:
        """Write its bodies and stiffnesses."""
        super().fill(record, site)
        record["a"], record["b"] = site.bodies
        record["stiffness"] = self.axial, self.torsion, self.bending_y, self.bending_z

    @property
    def is_nonconservative(self) -> bool:
        """Whether it is damped."""
        return bool(self.damping)

    def extent(self) -> float:
        """Return its length."""
        return self.length

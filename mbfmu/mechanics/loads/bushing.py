"""Bushing between two bodies: what it resists along and about the axes of a frame in body a.

d is the way from the point of a to that of b in the axes of the frame E in a, e = (w, v) the unit quaternion of the
attitude of the frame in b, E^T E_b, and p = 2 v its turn: along its axis, twice the sine of half its angle.

    U = sum k_i d_i^2 / 2 + sum kappa_i p_i^2 / 2,    force k_i d_i + c_i d_i', moment kappa_i p_i + gamma_i p_i' along
    p_i,

and p' = w u + u x v with the angular velocity u of b in a. Moments are thus the gradient of U however far b turns, and
the same of e and -e: there is no attitude at which anything jumps. The force acts on both bodies at the point of b.

With matrices K, C of 6 x 6 and a preload f, s = (d, p) and e with w >= 0:

    U = s^T K s / 2 - f^T s,    force and moment K s + C s' - f.

What is linear in p changes its sign with e: at half a turn, w = 0, such a bushing jumps.
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
from solvers.compiled.record import Mat3, Mat6, Record, Vec3, Vec6, i8

from .base import Force, Points, fill_points

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State
    from solvers.compiled.record import Reals


class FramePairRecord(Record):
    """Parameters of a force between frames of two bodies."""

    a: i8
    b: i8
    Pa: Vec3  # body axes, m
    Pb: Vec3
    Ea: Mat3  # rows: x, y, z of the frame in body axes
    Eb: Mat3


class BushingRecord(FramePairRecord):
    """Parameters of :class:`Bushing`."""

    stiffness: Vec6  # along x, y, z, about x, y, z
    damping: Vec6


class CoupledBushingRecord(FramePairRecord):
    """Parameters of :class:`Bushing` with matrices or a preload."""

    stiffness: Mat6
    damping: Mat6
    preload: Vec6


@kernel
def _axes(body: MotionRecord, E: Reals) -> Any:
    """Axes of a frame E, rows in body axes, in global ones."""
    return arm(body, E[0]), arm(body, E[1]), arm(body, E[2])


@kernel
def _dot(a: Any, b: Any) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def _attitude(force: FramePairRecord, A: MotionRecord, B: MotionRecord) -> Any:
    """Quaternion of the frame in b, in the one in a."""
    fx, fy, fz = _axes(B, force.Eb)
    ex, ey, ez = _axes(A, force.Ea)
    return quaternion_of(
        (_dot(ex, fx), _dot(ex, fy), _dot(ex, fz)),
        (_dot(ey, fx), _dot(ey, fy), _dot(ey, fz)),
        (_dot(ez, fx), _dot(ez, fy), _dot(ez, fz)),
    )


@kernel
def _half_turn_attitude(force: FramePairRecord, A: MotionRecord, B: MotionRecord) -> Any:
    """The one with w >= 0."""
    w, x, y, z = _attitude(force, A, B)
    if w.real < 0.0:
        return -w, -x, -y, -z
    return w, x, y, z


@kernel
def _stretch(force: FramePairRecord, A: MotionRecord, B: MotionRecord, attitude: Any) -> Any:
    """(d, p)."""
    d, _, _ = point_offset(A, B, force.Pa, force.Pb)
    ex, ey, ez = _axes(A, force.Ea)
    _, x, y, z = attitude
    return _dot(ex, d), _dot(ey, d), _dot(ez, d), 2.0 * x, 2.0 * y, 2.0 * z


@kernel
def _stretch_rate(force: FramePairRecord, A: MotionRecord, B: MotionRecord, attitude: Any) -> Any:
    """(d, p)', seen from the frame."""
    rise = point_offset_rate(A, B, force.Pa, force.Pb)
    ex, ey, ez = _axes(A, force.Ea)
    Ya, Yb = A.Y, B.Y
    spin = (Yb[3] - Ya[3], Yb[4] - Ya[4], Yb[5] - Ya[5])
    ux, uy, uz = _dot(ex, spin), _dot(ey, spin), _dot(ez, spin)
    w, vx, vy, vz = attitude
    return (
        _dot(ex, rise),
        _dot(ey, rise),
        _dot(ez, rise),
        w * ux + uy * vz - uz * vy,
        w * uy + uz * vx - ux * vz,
        w * uz + ux * vy - uy * vx,
    )


@kernel
def _exert(force: FramePairRecord, A: MotionRecord, B: MotionRecord, attitude: Any, load: Any) -> None:
    """Load both bodies with what resists (d, p), the forces and moments ``load`` along them."""
    px, py, pz, mx, my, mz = load
    w, vx, vy, vz = attitude
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
def apply(force: BushingRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    A, B = state.bodies[force.a], state.bodies[force.b]
    attitude = _attitude(force, A, B)
    k, c = force.stiffness, force.damping
    s, rate = _stretch(force, A, B, attitude), _stretch_rate(force, A, B, attitude)
    px, py, pz = k[0] * s[0] + c[0] * rate[0], k[1] * s[1] + c[1] * rate[1], k[2] * s[2] + c[2] * rate[2]
    mx, my, mz = k[3] * s[3] + c[3] * rate[3], k[4] * s[4] + c[4] * rate[4], k[5] * s[5] + c[5] * rate[5]
    _exert(force, A, B, attitude, (px, py, pz, mx, my, mz))


@kernel
def potential(force: BushingRecord, arrays: Arrays, state: State) -> float:
    """U."""
    A, B, k = state.bodies[force.a], state.bodies[force.b], force.stiffness
    s = _stretch(force, A, B, _attitude(force, A, B))
    total = 0.0 * s[0]
    for i in range(6):
        total += 0.5 * k[i] * s[i] * s[i]
    return total


@kernel
def power(force: BushingRecord, t: float, arrays: Arrays, state: State) -> float:
    """-sum c_i d_i'^2 - sum gamma_i p_i'^2."""
    A, B, c = state.bodies[force.a], state.bodies[force.b], force.damping
    rate = _stretch_rate(force, A, B, _attitude(force, A, B))
    total = 0.0 * rate[0]
    for i in range(6):
        total -= c[i] * rate[i] * rate[i]
    return total


@kernel
def _row(M: Reals, i: int, x: Any) -> float:
    """(M x)_i."""
    total = 0.0 * x[0]
    for j in range(6):
        total += M[i, j] * x[j]
    return total


@kernel
def _coupled(force: CoupledBushingRecord, i: int, stretch: Any, rate: Any) -> float:
    """(K s + C s' - f)_i."""
    return _row(force.stiffness, i, stretch) + _row(force.damping, i, rate) - force.preload[i]


@kernel
def apply_coupled(force: CoupledBushingRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    A, B = state.bodies[force.a], state.bodies[force.b]
    attitude = _half_turn_attitude(force, A, B)
    s, rate = _stretch(force, A, B, attitude), _stretch_rate(force, A, B, attitude)
    px, py, pz = _coupled(force, 0, s, rate), _coupled(force, 1, s, rate), _coupled(force, 2, s, rate)
    mx, my, mz = _coupled(force, 3, s, rate), _coupled(force, 4, s, rate), _coupled(force, 5, s, rate)
    _exert(force, A, B, attitude, (px, py, pz, mx, my, mz))


@kernel
def potential_coupled(force: CoupledBushingRecord, arrays: Arrays, state: State) -> float:
    """s^T K s / 2 - f^T s."""
    A, B = state.bodies[force.a], state.bodies[force.b]
    s = _stretch(force, A, B, _half_turn_attitude(force, A, B))
    total = 0.0 * s[0]
    for i in range(6):
        total += s[i] * (0.5 * _row(force.stiffness, i, s) - force.preload[i])
    return total


@kernel
def power_coupled(force: CoupledBushingRecord, t: float, arrays: Arrays, state: State) -> float:
    """-s'^T C s'."""
    A, B = state.bodies[force.a], state.bodies[force.b]
    rate = _stretch_rate(force, A, B, _half_turn_attitude(force, A, B))
    total = 0.0 * rate[0]
    for i in range(6):
        total -= rate[i] * _row(force.damping, i, rate)
    return total


@dataclass(frozen=True, kw_only=True)
class Bushing(Force):
    """Bushing: springs and dampers along and about the axes of a frame in body a, between points of bodies a and b.

    Without a preload it is unloaded if the points and the frames coincide. The moment has a potential at any rotation
    and is proportional to the sine of the rotation angle: it is largest at 90 degrees and zero at 180 degrees.

    Parameters
    ----------
    stiffness, damping
        Translational stiffness, N/m, and damping, N s/m, along x, y, z of the frame; a single number applies to all.
        Or a symmetric 6 x 6 matrix without negative eigenvalues for displacements along and rotations about x, y, z:
        N/m, N/rad and N m/m, N m/rad. Rotations are the components of the rotation axis times 2 sin(angle / 2).
    rotational_stiffness, rotational_damping
        Rotational stiffness, N m/rad, and damping, N m s/rad, about x, y, z of the frame; not with a matrix.
    preload
        Force (N) and moment (N m) on body b along and about x, y, z of the frame if the points and the frames
        coincide: six numbers. The force on body a is opposite.
    at_a, at_b
        Points in the frames of the bodies, m.
    rotation_a, rotation_b
        3x3 axes of the frame in the two bodies; identity by default.

    Notes
    -----
    With a preloaded moment, or with a matrix that couples displacements and rotations, force and moment are
    discontinuous at a rotation of 180 degrees.
    """

    record = BushingRecord
    apply = apply
    potential = potential
    power = power

    stiffness: Any = 0.0
    damping: Any = 0.0
    rotational_stiffness: Any = 0.0
    rotational_damping: Any = 0.0
    preload: Any = None
    at_a: Any = (0.0, 0.0, 0.0)
    at_b: Any = (0.0, 0.0, 0.0)
    rotation_a: Any = None
    rotation_b: Any = None

    def __post_init__(self) -> None:
        """Take the kernels of matrices and preloads."""
        if self._is_coupled():
            object.__setattr__(self, "record", CoupledBushingRecord)
            for name, function in COUPLED.items():
                object.__setattr__(self, name, function)

    def _is_coupled(self) -> bool:
        return self.preload is not None or _is_matrix(self.stiffness) or _is_matrix(self.damping)

    def check(self, what: str) -> None:
        """Refuse what is no stiffness, and what is no preload."""
        for key in ("stiffness", "damping"):
            self._values(key, what)
        self._preload(what)

    def _values(self, key: str, what: str) -> NDArray[np.float64]:
        """Return the stiffness or damping along and about the axes (6,), or a matrix (6, 6)."""
        onward, about = getattr(self, key), getattr(self, f"rotational_{key}")
        if not _is_matrix(onward):
            parts = _along_axes(f"{key} of {what}", onward), _along_axes(f"rotational_{key} of {what}", about)
            return np.concatenate(parts)
        if np.any(about):
            raise UserError(
                f"{what} has a matrix as {key}, and rotational_{key} {about!r}; leave out rotational_{key}, which the "
                "matrix contains"
            )
        return _symmetric(f"{key} of {what}", onward)

    def _preload(self, what: str) -> NDArray[np.float64]:
        """Return the preload (6,)."""
        if self.preload is None:
            return np.zeros(6)
        array = array_of(f"preload of {what}", self.preload)
        if array.shape != (6,) or not np.all(np.isfinite(array)):
            raise UserError(
                f"preload of {what} is {self.preload!r}; allowed: six finite numbers, three forces and three moments"
            )
        return array

    def fill(self, record: Any, site: Attachment) -> None:
        """Write points, frames, stiffness, damping and preload."""
        name = site.name
        fill_points(self, record, site)
        record["Ea"] = rotation(f"rotation_a of {name}", self.rotation_a).T
        record["Eb"] = rotation(f"rotation_b of {name}", self.rotation_b).T
        for key in ("stiffness", "damping"):
            values = self._values(key, name)
            record[key] = np.diag(values) if self._is_coupled() and values.ndim == 1 else values
        if self._is_coupled():
            record["preload"] = self._preload(name)

    @property
    def is_nonconservative(self) -> bool:
        """Whether it is damped."""
        return bool(np.any(self.damping) or np.any(self.rotational_damping))

    def points(self) -> Points:
        """Return its two points."""
        return self.at_a, self.at_b


COUPLED = {"apply": apply_coupled, "potential": potential_coupled, "power": power_coupled}
MAX_NEGATIVE_EIGENVALUE = 1e-9  # relative to the diagonal of the matrix


def _is_matrix(value: Any) -> bool:
    try:
        return np.ndim(value) == 2
    except ValueError:  # rows of different lengths
        return False


def _symmetric(what: str, value: Any) -> NDArray[np.float64]:
    """Return a symmetric matrix (6, 6) without negative eigenvalues."""
    M = array_of(what, value)
    allowed = "allowed: a symmetric 6 x 6 matrix of finite numbers without negative eigenvalues"
    if M.shape != (6, 6) or not np.all(np.isfinite(M)) or np.any(np.diag(M) < 0.0):
        raise UserError(f"{what} is {value!r}; {allowed}")
    unit = np.sqrt(np.where(np.diag(M) > 0.0, np.diag(M), 1.0))
    scaled = M / np.outer(unit, unit)  # without units
    if np.abs(scaled - scaled.T).max() > MAX_NEGATIVE_EIGENVALUE:
        raise UserError(f"{what} is {value!r}, which is not symmetric; {allowed}")
    least = float(np.linalg.eigvalsh(scaled)[0])
    if least < -MAX_NEGATIVE_EIGENVALUE or np.any(M[np.diag(M) == 0.0]):
        raise UserError(f"{what} is {value!r}, which drives some displacements away from zero; {allowed}")
    return 0.5 * (M + M.T)


def _along_axes(what: str, value: Any) -> NDArray[np.float64]:
    """Return one number, or three, as three; none of them negative."""
    array = array_of(what, value)
    if array.shape not in ((), (3,)) or not np.all(np.isfinite(array)) or np.any(array < 0.0):
        raise UserError(f"{what} is {value!r}; allowed: one number or three, finite and not negative")
    return np.broadcast_to(array, (3,))

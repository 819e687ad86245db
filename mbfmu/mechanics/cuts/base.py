"""Interface of cut joints.

A cut joint ties point P of body a to point Q of body b. Its kernel ``evaluate(cut, A, B, row, arrays, state)``, A and B
being the motions of the two bodies, writes its rows from ``state.rows[row]`` on: the residual Phi and the wrenches Ga,
Gb (about the two origins, global axes) and the velocity products ``bias`` such that

    Phi' = Ga . Y_a + Gb . Y_b,      Phi'' = Ga . Y'_a + Gb . Y'_b + bias.

The kernel ``monitor(cut, A, B, arrays)`` of a wheel on a profile returns where it touches the profile, where the
profile is deepest inside the wheel, and how deep; None: a type of cut joints has no such limits.

A nonholonomic row, such as that of a wheel which does not slip, restricts velocities only. Its Phi is zero, and Phi' is
what the wrenches say.

The multiplier lambda of a row is the force or moment with which body b must be pushed along Gb with reversed sign:
the cut joint loads the bodies with -lambda Ga and -lambda Gb. Trivially satisfied equations (out of the plane of a
planar loop, say) are dropped when it is compiled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from mbfmu.mechanics.axes import plane_axes, unit_axis
from mbfmu.mechanics.checks import Matrix, rotation, vector
from mbfmu.mechanics.kind import Attachment, ElementType, RecordType
from mbfmu.mechanics.spatial import arm, centripetal
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Mat3, Record, Vec3

if TYPE_CHECKING:
    from mbfmu.mechanics.records import MotionRecord, RowRecord, State

FRAME_ORDERS = {"x": "yzx", "y": "zxy", "z": "xyz"}  # axes of a frame in a right-handed order, by the last one


class CutJointRecord(Record):
    """Parameters of :class:`CutJoint`."""

    Pa: Vec3  # point on body a, body axes, m
    Pb: Vec3
    Ra: Mat3  # axes of the cut frame in body a; columns x, y, z
    Rb: Mat3


@dataclass(frozen=True, kw_only=True)
class CutJoint(ElementType):
    """Base class of loop-closing joints (cut joints).

    Parameters
    ----------
    at_a, at_b
        Points of the joint in the frames of bodies a and b, m.
    rotation_a, rotation_b
        Axes of the cut frame in the two bodies, as columns of a 3x3 matrix or as a SciPy ``Rotation``; identity by
        default. Constraint equations are named by the axes in
        body a.
    """

    at_a: Any = (0.0, 0.0, 0.0)
    at_b: Any = (0.0, 0.0, 0.0)
    rotation_a: Any = None
    rotation_b: Any = None

    record: ClassVar[RecordType] = CutJointRecord
    kernels: ClassVar = {
        "evaluate": "motion, motion, index, arrays, state",
        "monitor": "motion, motion, arrays -> three",
    }
    evaluate: ClassVar[Any]
    monitor: ClassVar[Any] = None
    rows: ClassVar[tuple[str, ...]]  # suffix of each row's name
    units: ClassVar[tuple[str, ...]]  # of each row's multiplier: N or N m
    nonholonomic: ClassVar[tuple[str, ...]] = ()  # rows that restrict velocities only: their residual is zero
    drawings: ClassVar = ("pin", "ball", "rod", "wheel")
    drawn: ClassVar[str] = "pin"  # how pictures show it: one of these
    planes: ClassVar[str] = (
        ""  # bodies, "a" or "ab", on which any point of a plane normal to z of the frame may be given
    )
    parallel: ClassVar[str] = ""  # axes of the two frames that are parallel when it is closed: "", "z" or "xyz"

    @property
    def letters(self) -> str:
        """Names of the x, y and z axes of :meth:`frames`."""
        return "xyz"

    def frames(self, what: str = "a cut joint") -> tuple[Matrix, Matrix]:
        """Return the axes of the cut frames as columns in bodies a and b, as kernels have them."""
        Ra, Rb = rotation(f"rotation_a of {what}", self.rotation_a), rotation(f"rotation_b of {what}", self.rotation_b)
        return Ra, Rb

    def fill(self, record: Any, site: Attachment) -> None:
        """Write points and axes."""
        super().fill(record, site)
        for on in "ab":
            vector(f"at_{on} of {site.name}", getattr(self, f"at_{on}"))
            record[f"P{on}"] = self.nearest(on)  # avoids cancellation on planes far away
        record["Ra"], record["Rb"] = self.frames(site.name)

    def nearest(self, on: str, point: Any = (0.0, 0.0, 0.0)) -> Matrix:
        """Return the point of this cut joint on body ``on``, ``"a"`` or ``"b"``, m, body axes; of a plane the one that
        is nearest to ``point``. Lengths of the mechanism thus do not depend on which point of the plane is given.
        """
        own = np.asarray(getattr(self, f"at_{on}"), float)
        if on not in self.planes:
            return own
        normal = self.frames()["ab".index(on)][:, 2]
        return np.asarray(point, float) + ((own - point) @ normal) * normal

    def extent(self) -> float:
        """Return the distance between the two points that it maintains, m."""
        return 0.0


@dataclass(frozen=True, kw_only=True)
class AxisCut(CutJoint):
    """A cut joint with an axis: kernels have the cut frames turned so that it is their z.

    Parameters
    ----------
    axis
        ``"x"``, ``"y"`` or ``"z"``: that axis of both cut frames; rows are named by the axes of the frame in body a. Or
        three numbers, its components in both: rows are then named by n, the axis, s, the frame's x projected into the
        plane normal to n (its y where n is x), and t = n x s.
    """

    axis: Any = "z"

    named: ClassVar[tuple[str, ...]]  # rows of the kernel, by the axes of its frames

    @property
    def letters(self) -> str:
        """Names of the x, y and z axes of :meth:`frames`."""
        return FRAME_ORDERS[self.axis] if isinstance(self.axis, str) else "stn"

    @property
    def rows(self) -> tuple[str, ...]:  # type: ignore[override]
        """Suffix of each row's name."""
        names = dict(zip("xyz", self.letters, strict=True))
        return tuple("".join(names[axis] for axis in row) for row in self.named)

    def check(self, what: str) -> None:
        """Refuse what is no axis."""
        unit_axis(self.axis, f"axis of {what}")

    def frames(self, what: str = "a cut joint") -> tuple[Matrix, Matrix]:
        """Return the axes of the cut frames as columns in bodies a and b, as kernels have them."""
        Ra, Rb = super().frames(what)
        return with_axis_last(Ra, self.axis, what), with_axis_last(Rb, self.axis, what)


def with_axis_last(R: Matrix, axis: Any, what: str) -> Matrix:
    """Return the axes R of a frame, as columns, rotated so that the last one is an axis of the frame."""
    if isinstance(axis, str):
        return R[:, ["xyz".index(letter) for letter in FRAME_ORDERS[axis]]]
    normal = unit_axis(axis, f"axis of {what}")
    return R @ np.column_stack((*plane_axes(normal), normal))


@kernel
def constrain_point(cut: CutJointRecord, A: MotionRecord, B: MotionRecord, row: int, state: State) -> None:
    """Three rows: Q stays on P along each axis of the cut frame in body a."""
    motion = relative_motion(cut, A, B)
    for k in range(3):
        constrain_along(cut, k, A, motion, state.rows[row + k])


@kernel
def relative_motion(cut: CutJointRecord, A: MotionRecord, B: MotionRecord) -> Any:
    """The arms of Q from b's and from a's origin, the way d from P to Q, d', and d'' without angular accelerations."""
    ax, ay, az = arm(A, cut.Pa)
    bx, by, bz = arm(B, cut.Pb)
    a, b = A.Y, B.Y
    dx, dy, dz = B.r[0] + bx - A.r[0] - ax, B.r[1] + by - A.r[1] - ay, B.r[2] + bz - A.r[2] - az
    ux = b[0] + b[4] * bz - b[5] * by - (a[0] + a[4] * az - a[5] * ay)
    uy = b[1] + b[5] * bx - b[3] * bz - (a[1] + a[5] * ax - a[3] * az)
    uz = b[2] + b[3] * by - b[4] * bx - (a[2] + a[3] * ay - a[4] * ax)
    ex = centripetal(B, bx, by, bz, 0) - centripetal(A, ax, ay, az, 0)
    ey = centripetal(B, bx, by, bz, 1) - centripetal(A, ax, ay, az, 1)
    ez = centripetal(B, bx, by, bz, 2) - centripetal(A, ax, ay, az, 2)
    return (bx, by, bz), (ax + dx, ay + dy, az + dz), (dx, dy, dz), (ux, uy, uz), (ex, ey, ez)


@kernel
def constrain_along(cut: CutJointRecord, k: int, A: MotionRecord, motion: Any, row: RowRecord) -> None:
    """One row: Phi = n.d, n axis k of the cut frame in body a, d from P on a to Q on b; ``motion`` is
    what :func:`relative_motion` returns.

    Phi' = n.d' + (w_a x n).d,     Phi'' = n.d'' + (w'_a x n).d + (w_a x (w_a x n)).d + 2 (w_a x n).d'

    n is fixed in body a and not in the ground, so that the properties of a row in one orientation of the mechanism
    (that it is trivially satisfied, the size of its multiplier) apply in all.
    """
    nx, ny, nz = arm(A, cut.Ra[:, k])
    (bx, by, bz), (x, y, z), (dx, dy, dz), (ux, uy, uz), (ex, ey, ez) = motion
    w = A.Y
    mx, my, mz = w[4] * nz - w[5] * ny, w[5] * nx - w[3] * nz, w[3] * ny - w[4] * nx  # n turns at m = w_a x n
    row.Phi = nx * dx + ny * dy + nz * dz
    row.bias = (
        nx * ex
        + ny * ey
        + nz * ez
        + (w[4] * mz - w[5] * my) * dx
        + (w[5] * mx - w[3] * mz) * dy
        + (w[3] * my - w[4] * mx) * dz
        + 2.0 * (mx * ux + my * uy + mz * uz)
    )
    row.Gb[0], row.Gb[1], row.Gb[2] = nx, ny, nz
    row.Gb[3], row.Gb[4], row.Gb[5] = by * nz - bz * ny, bz * nx - bx * nz, bx * ny - by * nx
    # the reaction acts on body a where Q is
    row.Ga[0], row.Ga[1], row.Ga[2] = -nx, -ny, -nz
    row.Ga[3], row.Ga[4], row.Ga[5] = z * ny - y * nz, x * nz - z * nx, y * nx - x * ny


@kernel
def constrain_perpendicular(
    cut: CutJointRecord, i: int, j: int, A: MotionRecord, B: MotionRecord, row: RowRecord
) -> None:
    """One row: axis i of the cut frame in body a stays perpendicular to axis j of that in body b.

    Phi = p.s, Phi' = (w_a - w_b).(p x s), and with p' = w_a x p, s' = w_b x s:
    Phi'' = (w'_a - w'_b).(p x s) + (w_a - w_b).(p' x s + p x s').
    """
    px, py, pz = arm(A, cut.Ra[:, i])
    sx, sy, sz = arm(B, cut.Rb[:, j])
    a, b = A.Y, B.Y
    dpx, dpy, dpz = a[4] * pz - a[5] * py, a[5] * px - a[3] * pz, a[3] * py - a[4] * px
    dsx, dsy, dsz = b[4] * sz - b[5] * sy, b[5] * sx - b[3] * sz, b[3] * sy - b[4] * sx
    for k in range(3):
        row.Ga[k], row.Gb[k] = 0.0, 0.0
    row.Ga[3], row.Ga[4], row.Ga[5] = py * sz - pz * sy, pz * sx - px * sz, px * sy - py * sx
    for k in range(3, 6):
        row.Gb[k] = -row.Ga[k]
    row.Phi = px * sx + py * sy + pz * sz
    row.bias = (
        (a[3] - b[3]) * (dpy * sz - dpz * sy + py * dsz - pz * dsy)
        + (a[4] - b[4]) * (dpz * sx - dpx * sz + pz * dsx - px * dsz)
        + (a[5] - b[5]) * (dpx * sy - dpy * sx + px * dsy - py * dsx)
    )

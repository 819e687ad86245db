"""Vectors, rotations and the shift of a motion or wrench between two origins, as kernels."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from solvers.compiled.kernel import kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.records import MotionRecord
    from solvers.compiled.record import Reals

Vec = Any  # a float array seen from a kernel


@kernel
def cross(a: Vec, b: Vec, out: Vec) -> None:
    """out = a x b; ``out`` may not alias."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@kernel
def rotate(A: Vec, x: Vec, out: Vec) -> None:
    """out = A x; ``out`` may not alias."""
    for i in range(3):
        out[i] = A[i, 0] * x[0] + A[i, 1] * x[1] + A[i, 2] * x[2]


@kernel
def rotate_row(A: Vec, X: Vec, i: int, Y: Vec, j: int) -> None:
    """Y[j] = A X[i] for rows that hold a linear and an angular part."""
    for k in range(3):
        Y[j, k] = A[k, 0] * X[i, 0] + A[k, 1] * X[i, 1] + A[k, 2] * X[i, 2]
        Y[j, 3 + k] = A[k, 0] * X[i, 3] + A[k, 1] * X[i, 4] + A[k, 2] * X[i, 5]


@kernel
def multiply(A: Vec, B: Vec, out: Vec) -> None:
    """out = A B, 3x3; ``out`` may not alias."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@kernel
def dot6(a: Vec, b: Vec) -> float:
    """Power of wrench a on motion b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4] + a[5] * b[5]


@kernel
def row_dot6(S: Vec, i: int, f: Vec) -> float:
    """Power of wrench f on the motion S[i]."""
    return S[i, 0] * f[0] + S[i, 1] * f[1] + S[i, 2] * f[2] + S[i, 3] * f[3] + S[i, 4] * f[4] + S[i, 5] * f[5]


@kernel
def add_wrench(W: Vec, x: float, y: float, z: float, f: Vec) -> None:
    """Add to W the force f[0:3] and moment f[3:6] that act at the offset (x, y, z) from W's origin."""
    W[0] += f[0]
    W[1] += f[1]
    W[2] += f[2]
    W[3] += f[3] + y * f[2] - z * f[1]
    W[4] += f[4] + z * f[0] - x * f[2]
    W[5] += f[5] + x * f[1] - y * f[0]


@kernel
def shift_motion(here: MotionRecord, parent: MotionRecord, Yj: Vec, Y: Vec) -> None:
    """Y += what taking the parent's motion Yj at another origin adds: w_j x (r - r_j)."""
    x, y, z = here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2]
    wx, wy, wz = Yj[3], Yj[4], Yj[5]
    Y[0] += wy * z - wz * y
    Y[1] += wz * x - wx * z
    Y[2] += wx * y - wy * x


@kernel
def shift_wrench(here: MotionRecord, parent: MotionRecord, f: Vec) -> None:
    """Refer the wrench f at a body's origin to its parent's."""
    x, y, z = here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2]
    f[3] += y * f[2] - z * f[1]
    f[4] += z * f[0] - x * f[2]
    f[5] += x * f[1] - y * f[0]


@kernel
def add_force(W: Vec, x: float, y: float, z: float, fx: float, fy: float, fz: float) -> None:
    """Add to W a force that acts at the offset (x, y, z) from W's origin."""
    W[0] += fx
    W[1] += fy
    W[2] += fz
    W[3] += y * fz - z * fy
    W[4] += z * fx - x * fz
    W[5] += x * fy - y * fx


@kernel
def arm(here: MotionRecord, p: Reals) -> tuple[float, float, float]:
    """Offset A p of a body-fixed point from its body's origin, global axes."""
    A = here.A
    return (
        A[0, 0] * p[0] + A[0, 1] * p[1] + A[0, 2] * p[2],
        A[1, 0] * p[0] + A[1, 1] * p[1] + A[1, 2] * p[2],
        A[2, 0] * p[0] + A[2, 1] * p[1] + A[2, 2] * p[2],
    )


@kernel
def point_offset(A: MotionRecord, B: MotionRecord, Pa: Reals, Pb: Reals) -> Any:
    """From a's point to b's, from a's origin to b's point, and from b's origin there, global axes."""
    ax, ay, az = arm(A, Pa)
    bx, by, bz = arm(B, Pb)
    x, y, z = B.r[0] + bx - A.r[0], B.r[1] + by - A.r[1], B.r[2] + bz - A.r[2]
    return (x - ax, y - ay, z - az), (x, y, z), (bx, by, bz)


@kernel
def point_offset_rate(A: MotionRecord, B: MotionRecord, Pa: Reals, Pb: Reals) -> Any:
    """Velocity of b's point relative to body a, global axes."""
    _, (x, y, z), (bx, by, bz) = point_offset(A, B, Pa, Pb)
    a, b = A.Y, B.Y
    return (
        b[0] + b[4] * bz - b[5] * by - a[0] - (a[4] * z - a[5] * y),
        b[1] + b[5] * bx - b[3] * bz - a[1] - (a[5] * x - a[3] * z),
        b[2] + b[3] * by - b[4] * bx - a[2] - (a[3] * y - a[4] * x),
    )


@kernel
def centripetal(here: MotionRecord, x: float, y: float, z: float, k: int) -> float:
    """Component k of w x (w x p) = w (w.p) - p w.w."""
    w = here.Y
    return w[3 + k] * (w[3] * x + w[4] * y + w[5] * z) - (x, y, z)[k] * (w[3] * w[3] + w[4] * w[4] + w[5] * w[5])


@kernel
def rotated(n: Vec, c: float, s: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """The vector (x, y, z) turned about the unit vector n by the angle of cosine c and sine s: Rodrigues' formula."""
    d = (1.0 - c) * (n[0] * x + n[1] * y + n[2] * z)
    return (
        c * x + s * (n[1] * z - n[2] * y) + d * n[0],
        c * y + s * (n[2] * x - n[0] * z) + d * n[1],
        c * z + s * (n[0] * y - n[1] * x) + d * n[2],
    )


@kernel
def axis_matrix(n: Vec, c: float, s: float, R: Vec) -> None:
    """R = c I + s skew(n) + (1 - c) n n^T: rotation about the unit vector n by the angle of cosine c and sine s."""
    for i in range(3):
        for j in range(3):
            R[i, j] = (1.0 - c) * n[i] * n[j]
        R[i, i] += c
    R[0, 1] -= s * n[2]
    R[0, 2] += s * n[1]
    R[1, 0] += s * n[2]
    R[1, 2] -= s * n[0]
    R[2, 0] -= s * n[1]
    R[2, 1] += s * n[0]


@kernel
def quaternion_matrix(e: Vec, i: int, R: Vec) -> None:
    """R = rotation matrix of the quaternion e[i:i+4] (scalar first), taken at unit length."""
    w, x, y, z = e[i], e[i + 1], e[i + 2], e[i + 3]
    s = 2.0 / (w * w + x * x + y * y + z * z)
    R[0, 0] = 1.0 - s * (y * y + z * z)
    R[0, 1] = s * (x * y - w * z)
    R[0, 2] = s * (x * z + w * y)
    R[1, 0] = s * (x * y + w * z)
    R[1, 1] = 1.0 - s * (x * x + z * z)
    R[1, 2] = s * (y * z - w * x)
    R[2, 0] = s * (x * z - w * y)
    R[2, 1] = s * (y * z + w * x)
    R[2, 2] = 1.0 - s * (x * x + y * y)


@kernel
def quaternion_rate(e: Vec, i: int, w: Vec, j: int, rate: Vec) -> None:
    """rate[i:i+4] = e (0, w[j:j+3]) / 2 for an angular velocity in body axes."""
    rate[i] = 0.5 * (-e[i + 1] * w[j] - e[i + 2] * w[j + 1] - e[i + 3] * w[j + 2])
    rate[i + 1] = 0.5 * (e[i] * w[j] + e[i + 2] * w[j + 2] - e[i + 3] * w[j + 1])
    rate[i + 2] = 0.5 * (e[i] * w[j + 1] + e[i + 3] * w[j] - e[i + 1] * w[j + 2])
    rate[i + 3] = 0.5 * (e[i] * w[j + 2] + e[i + 1] * w[j + 1] - e[i + 2] * w[j])


@kernel
def angle_of(s: float, c: float) -> float:
    """Angle whose sine and cosine are as s to c, from -pi to pi; zero where both are.

    No branch of an arcus is analytic all around: the real angle is taken, and to first order what is left of it.
    """
    about = math.atan2(s.real, c.real)
    x, y = math.cos(about), math.sin(about)
    across, onward = s * x - c * y, c * x + s * y
    return about + across / onward if onward.real > 0.0 else about + across


@kernel
def quaternion_of(X: Any, Y: Any, Z: Any) -> Any:
    """Unit quaternion, scalar first, of the rotation matrix with these rows; e or -e, so that the largest is positive.

    4 e_k e_l are sums of its entries; that of the largest component is no root of what cancels (Shepperd 1978).
    """
    x, y, z = X[0], Y[1], Z[2]
    trace = x + y + z
    if trace.real >= max(x.real, y.real, z.real):
        e = (1.0 + trace, Z[1] - Y[2], X[2] - Z[0], Y[0] - X[1])
        square = e[0]
    elif x.real >= max(y.real, z.real):
        e = (Z[1] - Y[2], 1.0 + 2.0 * x - trace, X[1] + Y[0], X[2] + Z[0])
        square = e[1]
    elif y.real >= z.real:
        e = (X[2] - Z[0], X[1] + Y[0], 1.0 + 2.0 * y - trace, Y[2] + Z[1])
        square = e[2]
    else:
        e = (Y[0] - X[1], X[2] + Z[0], Y[2] + Z[1], 1.0 + 2.0 * z - trace)
        square = e[3]
    size = 2.0 * np.sqrt(square)
    return e[0] / size, e[1] / size, e[2] / size, e[3] / size


@kernel
def to_body_axis(A: Vec, x: Vec, i: int) -> tuple[float, float, float]:
    """A^T x[i:i+3]: a vector of global axes in the body's."""
    return (
        A[0, 0] * x[i] + A[1, 0] * x[i + 1] + A[2, 0] * x[i + 2],
        A[0, 1] * x[i] + A[1, 1] * x[i + 1] + A[2, 1] * x[i + 2],
        A[0, 2] * x[i] + A[1, 2] * x[i + 1] + A[2, 2] * x[i + 2],
    )


@kernel
def add_from_body_axes(A: Vec, x: float, y: float, z: float, out: Vec, i: int) -> None:
    """out[i:i+3] += A (x, y, z)."""
    for k in range(3):
        out[i + k] += A[k, 0] * x + A[k, 1] * y + A[k, 2] * z

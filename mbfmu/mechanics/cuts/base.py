"""What every cut joint says of itself.

A cut joint ties point P of body a to point Q of body b. Its kernel ``close(cut, A, B, rows)`` writes its rows from
``cut.row`` on: the residual Phi and the wrenches Ga, Gb (about the two origins, global axes) and the velocity products
``bias`` such that

    Phi' = Ga . Y_a + Gb . Y_b,      Phi'' = Ga . Y'_a + Gb . Y'_b + bias.

The multiplier lambda of a row is the force or moment with which body b must be pushed along Gb with reversed sign:
the cut joint loads the bodies with -lambda Ga and -lambda Gb. Rows that are void in a mechanism (out of the plane of a
planar loop, say) are dropped when it is compiled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from solvers.kernel import kernel


@dataclass(frozen=True, kw_only=True)
class Cut:
    """A joint that closes a loop.

    Parameters
    ----------
    at_a, at_b
        The point in the frames of bodies a and b, m.
    rotation_a, rotation_b
        3x3 axes of the cut frame in the two bodies; identity by default.
    """

    at_a: Any = (0.0, 0.0, 0.0)
    at_b: Any = (0.0, 0.0, 0.0)
    rotation_a: Any = None
    rotation_b: Any = None

    rows: ClassVar[tuple[str, ...]]  # suffix of each row's name
    units: ClassVar[tuple[str, ...]]  # of each row's multiplier: N or N m
    close: ClassVar[Any]


@kernel
def coincide(cut: Any, A: Any, B: Any, rows: Any) -> None:
    """Three rows: Phi = r_Q - r_P along the global axes."""
    for k in range(3):
        row = rows[cut.row + k]
        pa, pb = row.Ga, row.Gb
        for i in range(3):
            pa[i], pb[i] = 0.0, 0.0
        pa[k], pb[k] = -1.0, 1.0
    for k in range(3):
        row = rows[cut.row + k]
        x, y, z = arm(A, cut.Pa)
        _moment(x, y, z, row.Ga)
        bias_a = centripetal(A, x, y, z, k)
        Phi = -(A.r[k] + (x, y, z)[k])
        x, y, z = arm(B, cut.Pb)
        _moment(x, y, z, row.Gb)
        row.Phi = Phi + B.r[k] + (x, y, z)[k]
        row.bias = centripetal(B, x, y, z, k) - bias_a


@kernel
def arm(here: Any, p: Any) -> tuple[float, float, float]:
    """Offset A p of a body-fixed point from its body's origin, global axes."""
    A = here.A
    return (
        A[0, 0] * p[0] + A[0, 1] * p[1] + A[0, 2] * p[2],
        A[1, 0] * p[0] + A[1, 1] * p[1] + A[1, 2] * p[2],
        A[2, 0] * p[0] + A[2, 1] * p[1] + A[2, 2] * p[2],
    )


@kernel
def centripetal(here: Any, x: float, y: float, z: float, k: int) -> float:
    """Component k of w x (w x p) = w (w.p) - p w.w."""
    w = here.Y
    return w[3 + k] * (w[3] * x + w[4] * y + w[5] * z) - (x, y, z)[k] * (w[3] * w[3] + w[4] * w[4] + w[5] * w[5])


@kernel
def _moment(x: float, y: float, z: float, G: Any) -> None:
    """Complete the wrench of a force that acts at the offset (x, y, z)."""
    G[3] = y * G[2] - z * G[1]
    G[4] = z * G[0] - x * G[2]
    G[5] = x * G[1] - y * G[0]


@kernel
def perpendicular(cut: Any, i: int, j: int, A: Any, B: Any, row: Any) -> None:
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

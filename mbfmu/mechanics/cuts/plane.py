"""In a plane: a point of body b stays in the x-y plane of the cut frame in body a."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from solvers.kernel import kernel

from .base import Cut, arm, centripetal


@kernel
def close(cut: Any, A: Any, B: Any, rows: Any) -> None:
    """See :mod:`.base`."""
    in_plane(cut, A, B, rows[cut.row])


@kernel
def in_plane(cut: Any, A: Any, B: Any, row: Any) -> None:
    """One row: Phi = n.d, n the z axis of the cut frame in body a, d from P on a to Q on b.

    Phi' = n.d' + (w_a x n).d,     Phi'' = n.d'' + (w'_a x n).d + (w_a x (w_a x n)).d + 2 (w_a x n).d'
    """
    nx, ny, nz = arm(A, cut.Ra[:, 2])
    ax, ay, az = arm(A, cut.Pa)
    bx, by, bz = arm(B, cut.Pb)
    a, b = A.Y, B.Y
    dx, dy, dz = B.r[0] + bx - A.r[0] - ax, B.r[1] + by - A.r[1] - ay, B.r[2] + bz - A.r[2] - az
    ux = b[0] + b[4] * bz - b[5] * by - (a[0] + a[4] * az - a[5] * ay)
    uy = b[1] + b[5] * bx - b[3] * bz - (a[1] + a[5] * ax - a[3] * az)
    uz = b[2] + b[3] * by - b[4] * bx - (a[2] + a[3] * ay - a[4] * ax)
    # n turns at m = w_a x n
    mx, my, mz = a[4] * nz - a[5] * ny, a[5] * nx - a[3] * nz, a[3] * ny - a[4] * nx
    row.Phi = nx * dx + ny * dy + nz * dz
    row.bias = (
        nx * (centripetal(B, bx, by, bz, 0) - centripetal(A, ax, ay, az, 0))
        + ny * (centripetal(B, bx, by, bz, 1) - centripetal(A, ax, ay, az, 1))
        + nz * (centripetal(B, bx, by, bz, 2) - centripetal(A, ax, ay, az, 2))
        + (a[4] * mz - a[5] * my) * dx
        + (a[5] * mx - a[3] * mz) * dy
        + (a[3] * my - a[4] * mx) * dz
        + 2.0 * (mx * ux + my * uy + mz * uz)
    )
    row.Gb[0], row.Gb[1], row.Gb[2] = nx, ny, nz
    row.Gb[3], row.Gb[4], row.Gb[5] = by * nz - bz * ny, bz * nx - bx * nz, bx * ny - by * nx
    # the reaction acts on body a where Q is
    x, y, z = ax + dx, ay + dy, az + dz
    row.Ga[0], row.Ga[1], row.Ga[2] = -nx, -ny, -nz
    row.Ga[3], row.Ga[4], row.Ga[5] = z * ny - y * nz, x * nz - z * nx, y * nx - x * ny


@dataclass(frozen=True, kw_only=True)
class PlaneCut(Cut):
    """Holds a point of body b in the x-y plane of the cut frame in body a."""

    rows = ("z",)
    units = ("N",)
    close = close

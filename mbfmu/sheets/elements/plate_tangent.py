"""Exact tangents of a plate element: how its wrenches change with the motions of its bodies.

A motion of a body is (dr, phi) in global axes, phi a small rotation of its present orientation: the directions of its
velocity Y. The tangent is 24 x 24, six rows and columns a body, and holds minus the derivative of the wrenches that
:func:`.plate_energy.apply` adds, by the positions and c1 times that by the velocities. By the positions it is that of
the elastic wrenches. Small rotations do not commute, so it is symmetric only if the wrenches are zero.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from solvers.compiled.kernel import kernel

from .plate_energy import (
    add_arcs,
    by_slopes,
    clear_stress,
    differentiate,
    gradient,
    plate_scratch,
    resist,
    shape,
    strain,
    stress,
)

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State
    from mbfmu.sheets.elements.plate_energy import PlateRecord, PlateScratch
    from solvers.compiled.record import Reals, Table


@kernel
def tangent(plate: PlateRecord, c1: float, arrays: Arrays, state: State, perturbed: State, K: Reals) -> float:
    """See :mod:`mbfmu.mechanics.loads.base`."""
    stiffness(
        plate, 1.0 + c1 * plate.damping if plate.damped == 1 else 1.0, state.bodies, plate_scratch(plate, state), K
    )
    return 1.0


@kernel
def stiffness(plate: PlateRecord, part: float, bodies: Table[MotionRecord], here: PlateScratch, K: Reals) -> None:
    """K (24, 24) += - d(wrenches) / d(motions) at the present positions; ``here`` is scratch.

    ``part`` = 1 + c1 beta has the damping in it: its stresses go with the rates of the strains as the elastic ones do
    with the strains, and are handed to the bodies in the same way.
    """
    shape(plate, bodies, here)
    strain(plate, here)
    clear_stress(here)
    resist(plate, here)
    gradient(plate, here)
    E, m, n, dm, dn, omega = here.E, here.m, here.n, here.dm, here.dn, here.omega
    for column in range(24):
        direction(here, column // 6, column % 6)
        differentiate(plate, here)
        change_of_gradient(plate, part, here)
        for j in range(4):
            rotated_column(m, omega, j, dm)
        for j in range(3):
            rotated_column(n, omega, j, dn)
        spread(E, dm, dn, 1.0, column, K)


@kernel
def direction(here: PlateScratch, i: int, k: int) -> None:
    """dg and phi for a unit motion of body i: k = 0, 1, 2 along the global axes, 3, 4, 5 about them."""
    E, dg, phi = here.E, here.dg, here.phi
    for j in range(3):
        dg[0, j], dg[1, j], dg[2, j] = 0.0, 0.0, 0.0
        for other in range(4):
            phi[other, j] = 0.0
        if k < 3:
            dg[0, j] = 0.5 * E[j, k] if 1 <= i <= 2 else -0.5 * E[j, k]
            dg[1, j] = 0.5 * E[j, k] if i >= 2 else -0.5 * E[j, k]
            dg[2, j] = 0.25 * E[j, k] if i % 2 == 0 else -0.25 * E[j, k]
        else:
            phi[i, j] = E[j, k - 3]


@kernel
def change_of_gradient(plate: PlateRecord, part: float, here: PlateScratch) -> None:
    """Differentials dm, dn of the gradient's components in element axes, after :func:`.plate_energy.differentiate`.

    Stresses change by ``part`` of what the strains' differentials say.
    """
    a, b, s, ds, df = plate.a, plate.b, here.stress, here.dstress, here.df
    t, turn, omega, dg, dn = here.t, here.turn, here.omega, here.dg, here.dn
    g1, gx, gz = here.g1x, here.g2x, here.g2z
    for i in range(12):
        ds[i] = 0.0
    stress(plate, here.dstrain, part, ds)
    if plate.membrane == 1:
        add_arcs(plate, s, here.dstrain, ds)
        add_arcs(plate, ds, here.strain, ds)
    by_slopes(ds, df)
    # components of g1, g2, t change by d() - omega x ()
    dg1, dgx, dgz = dg[0, 0], dg[1, 0] - omega[1] * gz, dg[1, 2] + omega[1] * gx
    dtx = dg[2, 0] - omega[1] * t[2] + omega[2] * t[1]
    dtz = dg[2, 2] - omega[0] * t[1] + omega[1] * t[0]
    by_tau = s[8] - 2.0 * s[6] / a - 2.0 * s[7] / b
    change = ds[8] - 2.0 * ds[6] / a - 2.0 * ds[7] / b
    ox, oy, oz = change * t[2] + by_tau * dtz, 0.0 * change, -change * t[0] - by_tau * dtx
    for i in range(4):
        change_of_moment(here, i)
        ox, oy, oz = ox - here.dm[i, 0], oy - here.dm[i, 1], oz - here.dm[i, 2]
    lever = turn[2] + turn[0] * gx / gz
    dlever = oz + (ox * gx + turn[0] * (dgx - gx * dgz / gz)) / gz
    dn[0, 0], dn[0, 1], dn[0, 2] = 0.0, (dlever - lever * dg1 / g1) / g1, -(oy - turn[1] * dg1 / g1) / g1
    dn[1, 0], dn[1, 1], dn[1, 2] = 0.0, -(ox - turn[0] * dgz / gz) / gz, 0.0
    dn[2, 0], dn[2, 1], dn[2, 2] = 0.0, change, 0.0
    if plate.membrane == 1:
        aa, bb, ab = a * a, b * b, a * b
        dn[0, 0] += (ds[9] * g1 + s[9] * dg1) / aa + (ds[11] * gx + s[11] * dgx) / ab
        dn[0, 2] += (ds[11] * gz + s[11] * dgz) / ab
        dn[1, 0] += (ds[10] * gx + s[10] * dgx) / bb + (ds[11] * g1 + s[11] * dg1) / ab
        dn[1, 2] += (ds[10] * gz + s[10] * dgz) / bb


@kernel
def change_of_moment(here: PlateScratch, i: int) -> None:
    """dm[i] of m = d x p, p = (-F f_x, -F' (d_x f_x + d_z f_z), -F f_z) the gradient by the normal d of body i."""
    d, dd, f, df, dm = here.d, here.dd, here.f, here.df, here.dm
    F, F1 = here.F[i], here.dF[i]
    dF, dF1 = F1 * dd[i, 1], here.ddF[i] * dd[i, 1]
    product = d[i, 0] * f[i, 0] + d[i, 2] * f[i, 1]
    px, py, pz = -F * f[i, 0], -F1 * product, -F * f[i, 1]
    dpx, dpz = -dF * f[i, 0] - F * df[i, 0], -dF * f[i, 1] - F * df[i, 1]
    dpy = -dF1 * product - F1 * (dd[i, 0] * f[i, 0] + d[i, 0] * df[i, 0] + dd[i, 2] * f[i, 1] + d[i, 2] * df[i, 1])
    dm[i, 0] = dd[i, 1] * pz - dd[i, 2] * py + d[i, 1] * dpz - d[i, 2] * dpy
    dm[i, 1] = dd[i, 2] * px - dd[i, 0] * pz + d[i, 2] * dpx - d[i, 0] * dpz
    dm[i, 2] = dd[i, 0] * py - dd[i, 1] * px + d[i, 0] * dpy - d[i, 1] * dpx


@kernel
def rotated_column(x: Reals, omega: Reals, j: int, dx: Reals) -> None:
    """dx[j] += omega x x[j]: from the change of components to the change of the vector."""
    dx[j, 0] += omega[1] * x[j, 2] - omega[2] * x[j, 1]
    dx[j, 1] += omega[2] * x[j, 0] - omega[0] * x[j, 2]
    dx[j, 2] += omega[0] * x[j, 1] - omega[1] * x[j, 0]


@kernel
def spread(E: Reals, m: Reals, n: Reals, part: float, column: int, K: Reals) -> None:
    """Add ``part`` of a column of a tangent: the gradient by rotations m and by g1, g2, t, handed to the bodies."""
    for k in range(3):
        x = 0.5 * (E[0, k] * n[0, 0] + E[1, k] * n[0, 1] + E[2, k] * n[0, 2])
        z = 0.5 * (E[0, k] * n[1, 0] + E[1, k] * n[1, 1] + E[2, k] * n[1, 2])
        twist = 0.25 * (E[0, k] * n[2, 0] + E[1, k] * n[2, 1] + E[2, k] * n[2, 2])
        K[k, column] += part * (twist - x - z)
        K[6 + k, column] += part * (x - z - twist)
        K[12 + k, column] += part * (x + z + twist)
        K[18 + k, column] += part * (z - x - twist)
        for i in range(4):
            K[6 * i + 3 + k, column] += part * (E[0, k] * m[i, 0] + E[1, k] * m[i, 1] + E[2, k] * m[i, 2])

"""Exact tangents of a plate element: how its wrenches change with the motions of its bodies.

A motion of a body is (dr, phi) in global axes, phi a small rotation of its present orientation: the directions of its
velocity Y. Both tangents are 24 x 24, six rows and columns a body, and hold minus the derivative of the wrenches that
:func:`.plate_energy.apply` adds: by the positions (stiffness) and by the velocities (damping). The stiffness is that of
the elastic wrenches. Small rotations do not commute, so it is symmetric only where the wrenches vanish.
"""

from __future__ import annotations

from typing import Any

from solvers.compiled.kernel import kernel

from .plate_energy import add_arcs, by_slopes, clear_stress, differentiate, gradient, shape, strain, stress


@kernel
def tangent(plate: Any, c1: float, arrays: Any, state: Any, K: Any) -> None:
    """See :mod:`mbfmu.mechanics.loads.base`."""
    here, change = state.element[0], state.changes[0]
    shape(plate, state.bodies, here)
    strain(plate, here)
    unit_motions(here, change)
    differentiate(plate, here, change)
    stiffness(plate, here, change, K)
    if plate.damped == 1 and c1 != 0.0:
        damping(plate, c1, here, change, K)


@kernel
def stiffness(plate: Any, here: Any, change: Any, K: Any) -> None:
    """K (24, 24) += - d(elastic wrenches) / d(motions), after :func:`.plate_energy.differentiate`."""
    clear_stress(here)
    stress(plate, here.strain, 1.0, here.stress)
    gradient(plate, here)
    change_of_gradient(plate, here, change)
    for j in range(4):
        turned(here.m[j], change.omega, change.m[j])
    for j in range(3):
        turned(here.n[j], change.omega, change.n[j])
    spread(here.E, change, 1.0, K)


@kernel
def damping(plate: Any, c1: float, here: Any, change: Any, K: Any) -> None:
    """K (24, 24) += - c1 d(damping wrenches) / d(velocities), likewise."""
    for column in range(24):
        clear_stress(here)
        stress(plate, change.strain[:, column], plate.damping, here.stress)
        gradient(plate, here)
        for k in range(3):
            for i in range(4):
                change.m[i, k, column] = here.m[i, k]
            for i in range(3):
                change.n[i, k, column] = here.n[i, k]
    spread(here.E, change, c1, K)


@kernel
def unit_motions(here: Any, change: Any) -> None:
    """Differentials of g1, g2, t and phi for the unit motions of the bodies, six each: along the global axes, and about
    them.
    """
    E, g, phi = here.E, change.g, change.phi
    for j in range(3):
        for c in range(24):
            for i in range(3):
                g[i, j, c] = 0.0
            for i in range(4):
                phi[i, j, c] = 0.0
        for i in range(4):
            for k in range(3):
                g[0, j, 6 * i + k] = 0.5 * E[j, k] if 1 <= i <= 2 else -0.5 * E[j, k]
                g[1, j, 6 * i + k] = 0.5 * E[j, k] if i >= 2 else -0.5 * E[j, k]
                g[2, j, 6 * i + k] = 0.25 * E[j, k] if i % 2 == 0 else -0.25 * E[j, k]
                phi[i, j, 6 * i + 3 + k] = E[j, k]


@kernel
def change_of_gradient(plate: Any, here: Any, change: Any) -> None:
    """Differentials of the gradient's components in element axes, after :func:`.plate_energy.differentiate`."""
    for c in range(24):
        ds = change.stress[:, c]
        for i in range(12):
            ds[i] = 0.0
        stress(plate, change.strain[:, c], 1.0, ds)
        if plate.membrane == 1:
            add_arcs(plate, here.stress, change.strain[:, c], ds)
            add_arcs(plate, ds, here.strain, ds)
        by_slopes(ds, change.f[:, :, c])
    for i in range(4):
        change_of_moment(i, here, change)
    change_of_levers(plate, here, change)
    if plate.membrane == 1:
        change_of_pull(plate, here, change)


@kernel
def change_of_moment(i: int, here: Any, change: Any) -> None:
    """change.m[i] of m = d x p, p = (-F f_x, -F' (d_x f_x + d_z f_z), -F f_z) the gradient by the normal d."""
    x, y, z, fx, fz = here.d[i, 0], here.d[i, 1], here.d[i, 2], here.f[i, 0], here.f[i, 1]
    F, F1, F2, product = here.F[i], here.dF[i], here.ddF[i], x * fx + z * fz
    px, py, pz = -F * fx, -F1 * product, -F * fz
    dd, df, dm = change.d[i], change.f[i], change.m[i]
    for c in range(24):
        dx, dy, dz, dfx, dfz = dd[0, c], dd[1, c], dd[2, c], df[0, c], df[1, c]
        dpx, dpz = -F1 * dy * fx - F * dfx, -F1 * dy * fz - F * dfz
        dpy = -F2 * dy * product - F1 * (dx * fx + x * dfx + dz * fz + z * dfz)
        dm[0, c] = dy * pz - dz * py + y * dpz - z * dpy
        dm[1, c] = dz * px - dx * pz + z * dpx - x * dpz
        dm[2, c] = dx * py - dy * px + x * dpy - y * dpx


@kernel
def change_of_levers(plate: Any, here: Any, change: Any) -> None:
    """change.n of what turns the element axes and of tau; the components of g1, g2, t change by d() - omega x ()."""
    a, b, s, ds, dn, dm = plate.a, plate.b, here.stress, change.stress, change.n, change.m
    g1, gx, gz, tx, ty, tz = here.g1x, here.g2x, here.g2z, here.t[0], here.t[1], here.t[2]
    turnx, turny, lever = here.turn[0], here.turn[1], here.turn[2] + here.turn[0] * here.g2x / here.g2z
    by_tau, g, omega = s[8] - 2.0 * s[6] / a - 2.0 * s[7] / b, change.g, change.omega
    for c in range(24):
        dg1, dgx, dgz = g[0, 0, c], g[1, 0, c] - omega[1, c] * gz, g[1, 2, c] + omega[1, c] * gx
        dtx = g[2, 0, c] - omega[1, c] * tz + omega[2, c] * ty
        dtz = g[2, 2, c] - omega[0, c] * ty + omega[1, c] * tx
        twist = ds[8, c] - 2.0 * ds[6, c] / a - 2.0 * ds[7, c] / b
        ox = twist * tz + by_tau * dtz - dm[0, 0, c] - dm[1, 0, c] - dm[2, 0, c] - dm[3, 0, c]
        oy = -dm[0, 1, c] - dm[1, 1, c] - dm[2, 1, c] - dm[3, 1, c]
        oz = -twist * tx - by_tau * dtx - dm[0, 2, c] - dm[1, 2, c] - dm[2, 2, c] - dm[3, 2, c]
        dlever = oz + (ox * gx + turnx * (dgx - gx * dgz / gz)) / gz
        dn[0, 0, c], dn[0, 1, c], dn[0, 2, c] = 0.0, (dlever - lever * dg1 / g1) / g1, -(oy - turny * dg1 / g1) / g1
        dn[1, 0, c], dn[1, 1, c], dn[1, 2, c] = 0.0, -(ox - turnx * dgz / gz) / gz, 0.0
        dn[2, 0, c], dn[2, 1, c], dn[2, 2, c] = 0.0, twist, 0.0


@kernel
def change_of_pull(plate: Any, here: Any, change: Any) -> None:
    """Add to change.n what the membrane stresses pull along g1 and g2."""
    aa, bb, ab = plate.a * plate.a, plate.b * plate.b, plate.a * plate.b
    s9, s10, s11, g1, gx, gz = here.stress[9], here.stress[10], here.stress[11], here.g1x, here.g2x, here.g2z
    g, omega, ds, dn = change.g, change.omega, change.stress, change.n
    for c in range(24):
        dg1, dgx, dgz = g[0, 0, c], g[1, 0, c] - omega[1, c] * gz, g[1, 2, c] + omega[1, c] * gx
        dn[0, 0, c] += (ds[9, c] * g1 + s9 * dg1) / aa + (ds[11, c] * gx + s11 * dgx) / ab
        dn[0, 2, c] += (ds[11, c] * gz + s11 * dgz) / ab
        dn[1, 0, c] += (ds[10, c] * gx + s10 * dgx) / bb + (ds[11, c] * g1 + s11 * dg1) / ab
        dn[1, 2, c] += (ds[10, c] * gz + s10 * dgz) / bb


@kernel
def turned(x: Any, omega: Any, dx: Any) -> None:
    """dx += omega x x: from the change of components to the change of the vector."""
    x0, x1, x2 = x[0], x[1], x[2]
    for c in range(24):
        dx[0, c] += omega[1, c] * x2 - omega[2, c] * x1
        dx[1, c] += omega[2, c] * x0 - omega[0, c] * x2
        dx[2, c] += omega[0, c] * x1 - omega[1, c] * x0


@kernel
def spread(E: Any, change: Any, part: float, K: Any) -> None:
    """K += ``part`` of the changes of the gradient, by rotations and by g1, g2, t, handed to the bodies."""
    m, n = change.m, change.n
    for k in range(3):
        e0, e1, e2 = part * E[0, k], part * E[1, k], part * E[2, k]
        for c in range(24):
            x = 0.5 * (e0 * n[0, 0, c] + e1 * n[0, 1, c] + e2 * n[0, 2, c])
            z = 0.5 * (e0 * n[1, 0, c] + e1 * n[1, 1, c] + e2 * n[1, 2, c])
            twist = 0.25 * (e0 * n[2, 0, c] + e1 * n[2, 1, c] + e2 * n[2, 2, c])
            K[k, c] += twist - x - z
            K[6 + k, c] += x - z - twist
            K[12 + k, c] += x + z + twist
            K[18 + k, c] += z - x - twist
        for i in range(4):
            for c in range(24):
                K[6 * i + 3 + k, c] += e0 * m[i, 0, c] + e1 * m[i, 1, c] + e2 * m[i, 2, c]

"""Exact tangents of a shell element: how its wrenches change with the motions of its bodies.

As those of a plate (:mod:`.plate_tangent`): 24 x 24, minus the derivative of the wrenches by the positions and by the
velocities, motions of a body being those of its origin and small rotations, all in global axes. A column is one motion:
what d changes by, the forces K d' of that, and what the present forces change by because their levers do. A body that
turns leaves the element's axes where they are, so half of the columns take a fraction of the work.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from solvers.compiled.kernel import kernel

from .plate_tangent import rotated_column
from .shell_energy import (
    assemble,
    clear_vector,
    deform,
    differentiate,
    gradient,
    resist,
    shell_scratch,
    use_extrapolated,
)

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from mbfmu.sheets.elements.shell_energy import ShellRecord, ShellScratch
    from solvers.compiled.record import Reals


@kernel
def tangent(shell: ShellRecord, c1: float, arrays: Arrays, state: State, perturbed: State, K: Reals) -> float:
    """See :mod:`mbfmu.mechanics.loads.base`."""
    here = shell_scratch(shell, state)
    deform(shell, state.bodies, here)
    if shell.is_extrapolated == 1:
        use_extrapolated(shell, here)
    clear_vector(here.f)
    resist(shell, here.d, 1.0, here.f)
    gradient(shell, here)
    for column in range(24):
        shifts = direction(shell, here, column // 6, column % 6)
        clear_vector(here.df)
        if shifts:
            resist(shell, here.rate, 1.0, here.df)
            change_by_shift(shell, here)
            for i in range(4):
                rotated_column(here.n, here.omega, i, here.dn)
                rotated_column(here.m, here.omega, i, here.dm)
        else:
            resist_turn(shell, here, column // 6, 1.0, here.df)
            change_by_turn(shell, here, column // 6)
        spread(here.E, here.dn, here.dm, 1.0, column, K)
    if shell.damped == 1 and c1 != 0.0:
        for column in range(24):
            clear_vector(here.f)
            if direction(shell, here, column // 6, column % 6):
                resist(shell, here.rate, shell.damping, here.f)
            else:
                resist_turn(shell, here, column // 6, shell.damping, here.f)
            gradient(shell, here)
            spread(here.E, here.n, here.m, c1, column, K)
    return 1.0


@kernel
def direction(shell: ShellRecord, here: ShellScratch, i: int, k: int) -> bool:
    """What a unit motion of body i changes d by, and the spin omega of the element: k = 0, 1, 2 along the global axes,
    3, 4, 5 about them. False where corner i alone turns: then the element's axes stay.
    """
    for other in range(4):
        for j in range(3):
            here.dr[other, j], here.phi[other, j] = 0.0, 0.0
    if k < 3:
        for j in range(3):
            here.dr[i, j] = here.E[j, k]
        differentiate(shell, here)
        return True
    clear_vector(here.rate)
    for j in range(3):
        here.phi[i, j], here.omega[j] = here.E[j, k - 3], 0.0
    for j in range(3):
        for l in range(3):
            here.rate[i, 3 + j] += here.H[i, j, l] * here.phi[i, l]
    return False


@kernel
def resist_turn(shell: ShellRecord, here: ShellScratch, i: int, part: float, f: Reals) -> None:
    """f (4, 6) += part K d' where d' is a turn of corner i: three columns of K."""
    turn = here.rate[i]
    for j in range(4):
        for k in range(3):
            plane, bent = shell.plane[3 * j + k], shell.bent[3 * j + k]
            f[j, 2 * k] += part * (plane[3 * i + 2] * turn[4])
            f[j, 2 * k + 1] += part * (bent[3 * i + 1] * turn[3] + bent[3 * i + 2] * turn[5])


@kernel
def change_by_shift(shell: ShellRecord, here: ShellScratch) -> None:
    """Differentials dn, dm of the gradient in element axes where a corner moves, from df."""
    x, X, f, df, dx, o, lift = here.x, shell.X, here.f, here.df, here.rate, here.o, here.lift
    ox, oy, oz, dspread = 0.0, 0.0, 0.0, 0.0
    for i in range(4):
        change_of_moment(here, i)
        dspread += X[i, 0] * dx[i, 0] + X[i, 2] * dx[i, 2]
        ox -= dx[i, 1] * f[i, 2] - dx[i, 2] * f[i, 1] + x[i, 1] * df[i, 2] - x[i, 2] * df[i, 1] + here.dm[i, 0]
        oy -= dx[i, 2] * f[i, 0] - dx[i, 0] * f[i, 2] + x[i, 2] * df[i, 0] - x[i, 0] * df[i, 2] + here.dm[i, 1]
        oz -= dx[i, 0] * f[i, 1] - dx[i, 1] * f[i, 0] + x[i, 0] * df[i, 1] - x[i, 1] * df[i, 0] + here.dm[i, 2]
    oy = (oy - o[1] * dspread) / here.spread
    for i in range(4):
        ox += X[i, 0] * (oy * x[i, 1] + o[1] * dx[i, 1])
        oz += X[i, 2] * (oy * x[i, 1] + o[1] * dx[i, 1])
    px, pz, qx, qz = x[2, 0] - x[0, 0], x[2, 2] - x[0, 2], x[3, 0] - x[1, 0], x[3, 2] - x[1, 2]
    dpx, dpz, dqx, dqz = dx[2, 0] - dx[0, 0], dx[2, 2] - dx[0, 2], dx[3, 0] - dx[1, 0], dx[3, 2] - dx[1, 2]
    cross, change = pz * qx - px * qz, dpz * qx + pz * dqx - dpx * qz - px * dqz
    p = -(qz * oz + qx * ox + dqz * o[2] + dqx * o[0] + lift[0] * change) / cross
    q = (pz * oz + px * ox + dpz * o[2] + dpx * o[0] - lift[1] * change) / cross
    assemble(X, df, (ox, oy, oz), (p, q), here.dn)


@kernel
def change_by_turn(shell: ShellRecord, here: ShellScratch, corner: int) -> None:
    """The same where a corner turns: the others and their levers stay, and so do the element's axes."""
    x, X, df, H = here.x, shell.X, here.df, here.H
    ox, oy, oz = 0.0, 0.0, 0.0
    for i in range(4):
        dm = here.dm[i]
        if i == corner:
            change_of_moment(here, i)
        else:
            for k in range(3):
                dm[k] = H[i, 0, k] * df[i, 3] + H[i, 1, k] * df[i, 4] + H[i, 2, k] * df[i, 5]
        ox -= x[i, 1] * df[i, 2] - x[i, 2] * df[i, 1] + dm[0]
        oy -= x[i, 2] * df[i, 0] - x[i, 0] * df[i, 2] + dm[1]
        oz -= x[i, 0] * df[i, 1] - x[i, 1] * df[i, 0] + dm[2]
    oy /= here.spread
    for i in range(4):
        ox += X[i, 0] * (oy * x[i, 1])
        oz += X[i, 2] * (oy * x[i, 1])
    px, pz, qx, qz = x[2, 0] - x[0, 0], x[2, 2] - x[0, 2], x[3, 0] - x[1, 0], x[3, 2] - x[1, 2]
    cross = pz * qx - px * qz
    p, q = -(qz * oz + qx * ox) / cross, (pz * oz + px * ox) / cross
    assemble(X, df, (ox, oy, oz), (p, q), here.dn)


@kernel
def change_of_moment(here: ShellScratch, i: int) -> None:
    """dm[i] of m = H^T f = F (tr R f - R^T f) / 2 - F' a (a . f), f by the turn of corner i."""
    R, a, F, f, df, H, dm = here.R[i], here.sine[i], here.F[i], here.f[i], here.df[i], here.H[i], here.dm[i]
    phi, omega = here.phi[i], here.omega
    s0, s1, s2 = phi[0] - omega[0], phi[1] - omega[1], phi[2] - omega[2]
    f0, f1, f2 = f[3], f[4], f[5]
    trace, by = R[0, 0] + R[1, 1] + R[2, 2], a[0] * f0 + a[1] * f1 + a[2] * f2
    dc = -(a[0] * s0 + a[1] * s1 + a[2] * s2)
    da0 = 0.5 * (trace * s0 - R[0, 0] * s0 - R[0, 1] * s1 - R[0, 2] * s2)
    da1 = 0.5 * (trace * s1 - R[1, 0] * s0 - R[1, 1] * s1 - R[1, 2] * s2)
    da2 = 0.5 * (trace * s2 - R[2, 0] * s0 - R[2, 1] * s1 - R[2, 2] * s2)
    change = F[1] * (da0 * f0 + da1 * f1 + da2 * f2) + F[2] * dc * by
    # of tr R f - R^T f: by F as it is, and R^T f by the spin
    u0 = 0.5 * F[1] * dc * f0 - 0.5 * F[0] * (s1 * f2 - s2 * f1)
    u1 = 0.5 * F[1] * dc * f1 - 0.5 * F[0] * (s2 * f0 - s0 * f2)
    u2 = 0.5 * F[1] * dc * f2 - 0.5 * F[0] * (s0 * f1 - s1 * f0)
    grown = 0.5 * F[1] * dc * trace + F[0] * dc
    for k in range(3):
        dm[k] = H[0, k] * df[3] + H[1, k] * df[4] + H[2, k] * df[5] + grown * f[3 + k] - change * a[k]
        dm[k] -= R[0, k] * u0 + R[1, k] * u1 + R[2, k] * u2
    dm[0] -= F[1] * by * da0
    dm[1] -= F[1] * by * da1
    dm[2] -= F[1] * by * da2


@kernel
def spread(E: Reals, n: Reals, m: Reals, part: float, column: int, K: Reals) -> None:
    """Add ``part`` of a column of a tangent, in global axes."""
    for i in range(4):
        for k in range(3):
            K[6 * i + k, column] += part * (E[0, k] * n[i, 0] + E[1, k] * n[i, 1] + E[2, k] * n[i, 2])
            K[6 * i + 3 + k, column] += part * (E[0, k] * m[i, 0] + E[1, k] * m[i, 1] + E[2, k] * m[i, 2])

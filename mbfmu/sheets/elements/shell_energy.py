"""A flat quadrilateral of a thin shell between four bodies that are free in all six motions: its energy and forces.

Element axes E (rows) go with the corners (corotational: Rankin and Nour-Omid 1988; Felippa and Haugen 2005): e_y is
normal to both diagonals, and in the plane E turns the natural corners X_i onto the present ones as well as it can. What
is left is small where cells are: displacements and turns of the corners,

    u_i = E (r_i - mean r) - X_i,    theta_i = axis and angle of R_i = E A_i B_i,

B_i the natural attitude, inverse. The energy d^T K d / 2 of d = (u, theta) with the stiffness K of a flat shell is the
same however the element moves as a rigid body. With the spin omega of E, in its axes, phi_i the rotations of the bodies
and s_i = phi_i - omega,

    du_i = E (dr_i - mean dr) - omega x x_i,    x_i = u_i + X_i
    dtheta_i = H_i s_i,    H = F (tr R 1 - R) / 2 - F' a a^T,

a = sin(theta) times the axis, c = cos(theta), F = theta / sin(theta) and F' its derivative by c; dR = [s x] R gives
da = (tr R 1 - R) s / 2 and dc = -a . s. omega follows from what defines E: the diagonals p, q keep no component along
y, and sum X_i x x_i none about it. Forces are the exact gradient; damping is stress = K (d + beta d').
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from mbfmu.mechanics.dispatch import scratch_record
from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.record import Integers, Mat3, Reals, Record, Vec3, f8, i8

from .plate_energy import slope_factor

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State
    from solvers.compiled.record import Table


class ShellRecord(Record):
    """A shell element."""

    node: Annotated[Integers, (4,)]  # bodies at the corners
    scratch: i8  # place of the scratch memory
    damped: i8  # 1: has material damping
    damping: f8  # beta, s
    X: Annotated[Reals, (4, 3)]  # natural corners in natural element axes, m
    B: Annotated[Reals, (4, 3, 3)]  # natural element axes in the bodies' axes
    plane: Annotated[Reals, (12, 12)]  # stiffness over (x, z, turn about y) of every corner
    bent: Annotated[Reals, (12, 12)]  # ... over (y, turn about x, about z)
    is_extrapolated: i8  # 1: forces by the extrapolated deformation, in the tangent of statics
    extrapolated: Annotated[Reals, (4, 6)]  # displacements and turns


class ShellScratch(Record):
    """An element at work, everything in element axes."""

    E: Mat3  # rows: element axes in global axes
    x: Annotated[Reals, (4, 3)]  # corners about their mean, m
    spread: f8  # sum of X_i . x_i in the plane
    R: Annotated[Reals, (4, 3, 3)]  # turns of the corners
    sine: Annotated[Reals, (4, 3)]  # a = sin(theta) times the axis of each
    F: Annotated[Reals, (4, 3)]  # F = theta / sin(theta) and its first two derivatives by cos(theta)
    H: Annotated[Reals, (4, 3, 3)]  # of turns by spins
    d: Annotated[Reals, (4, 6)]  # displacements and turns
    dr: Annotated[Reals, (4, 3)]  # motions of the corners
    phi: Annotated[Reals, (4, 3)]  # ... rotations of their bodies
    omega: Vec3  # ... spin of the element axes
    rate: Annotated[Reals, (4, 6)]  # ... what d changes by
    f: Annotated[Reals, (4, 6)]  # K d
    n: Annotated[Reals, (4, 3)]  # gradient by the motions of the corners
    m: Annotated[Reals, (4, 3)]  # ... by the rotations of the bodies
    o: Vec3  # ... by omega; the second by the turn in the plane
    lift: Annotated[Reals, (2,)]  # ... by what the diagonals lose along y
    df: Annotated[Reals, (4, 6)]  # changes of f, n, m
    dn: Annotated[Reals, (4, 3)]
    dm: Annotated[Reals, (4, 3)]


SHELL_SCRATCH = ShellScratch.dtype


@inlined
def shell_scratch(item: ShellRecord, state: State) -> Any:
    """Scratch memory of an element or a sensor of it."""
    return scratch_record(item.scratch, SHELL_SCRATCH, state)


@kernel
def deform(shell: ShellRecord, bodies: Table[MotionRecord], here: ShellScratch) -> None:
    """Element axes E, corners x, deformations d and what turns do to spins, H, from positions and orientations."""
    E, x, X, d = here.E, here.x, shell.X, here.d
    n1, n2, n3, n4 = bodies[shell.node[0]], bodies[shell.node[1]], bodies[shell.node[2]], bodies[shell.node[3]]
    r1, r2, r3, r4 = n1.r, n2.r, n3.r, n4.r
    px, py, pz = r3[0] - r1[0], r3[1] - r1[1], r3[2] - r1[2]
    qx, qy, qz = r4[0] - r2[0], r4[1] - r2[1], r4[2] - r2[2]
    nx, ny, nz = qy * pz - qz * py, qz * px - qx * pz, qx * py - qy * px
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / length, ny / length, nz / length
    ux, uy, uz = px - qx, py - qy, pz - qz  # twice the mean edge along x, normal to n as p and q are
    length = np.sqrt(ux * ux + uy * uy + uz * uz)
    ux, uy, uz = ux / length, uy / length, uz / length
    wx, wy, wz = uy * nz - uz * ny, uz * nx - ux * nz, ux * ny - uy * nx
    cx = 0.25 * (r1[0] + r2[0] + r3[0] + r4[0])
    cy = 0.25 * (r1[1] + r2[1] + r3[1] + r4[1])
    cz = 0.25 * (r1[2] + r2[2] + r3[2] + r4[2])
    cosine, sine = 0.0 * cx, 0.0 * cx
    for i in range(4):
        r = bodies[shell.node[i]].r
        a = (r[0] - cx) * ux + (r[1] - cy) * uy + (r[2] - cz) * uz
        b = (r[0] - cx) * wx + (r[1] - cy) * wy + (r[2] - cz) * wz
        cosine += X[i, 0] * a + X[i, 2] * b
        sine += X[i, 0] * b - X[i, 2] * a
    here.spread = np.sqrt(cosine * cosine + sine * sine)
    cosine, sine = cosine / here.spread, sine / here.spread
    E[0, 0], E[0, 1], E[0, 2] = cosine * ux + sine * wx, cosine * uy + sine * wy, cosine * uz + sine * wz
    E[1, 0], E[1, 1], E[1, 2] = nx, ny, nz
    E[2, 0], E[2, 1], E[2, 2] = cosine * wx - sine * ux, cosine * wy - sine * uy, cosine * wz - sine * uz
    for i in range(4):
        body = bodies[shell.node[i]]
        r, A, B, R = body.r, body.A, shell.B[i], here.R[i]
        for k in range(3):
            x[i, k] = E[k, 0] * (r[0] - cx) + E[k, 1] * (r[1] - cy) + E[k, 2] * (r[2] - cz)
            d[i, k] = x[i, k] - X[i, k]
            a0 = E[k, 0] * A[0, 0] + E[k, 1] * A[1, 0] + E[k, 2] * A[2, 0]
            a1 = E[k, 0] * A[0, 1] + E[k, 1] * A[1, 1] + E[k, 2] * A[2, 1]
            a2 = E[k, 0] * A[0, 2] + E[k, 1] * A[1, 2] + E[k, 2] * A[2, 2]
            for j in range(3):
                R[k, j] = a0 * B[0, j] + a1 * B[1, j] + a2 * B[2, j]
        rotate_corner(here, i)


@kernel
def rotate_corner(here: ShellScratch, i: int) -> None:
    """d[i, 3:6] = axis and angle of R[i], and H[i] of its change by a spin."""
    R, d, H, a, F = here.R[i], here.d[i], here.H[i], here.sine[i], here.F[i]
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    F[0], F[1], F[2] = slope_factor(0.5 * (trace - 1.0))
    a[0], a[1], a[2] = 0.5 * (R[2, 1] - R[1, 2]), 0.5 * (R[0, 2] - R[2, 0]), 0.5 * (R[1, 0] - R[0, 1])
    for k in range(3):
        d[3 + k] = F[0] * a[k]
        for j in range(3):
            H[k, j] = -0.5 * F[0] * R[k, j] - F[1] * a[k] * a[j]
        H[k, k] += 0.5 * F[0] * trace


@kernel
def update_rates(shell: ShellRecord, bodies: Table[MotionRecord], here: ShellScratch) -> None:
    """Motions dr of the corners and rotations phi of the bodies, as they are from the velocities."""
    E = here.E
    for i in range(4):
        Y = bodies[shell.node[i]].Y
        for k in range(3):
            here.dr[i, k] = E[k, 0] * Y[0] + E[k, 1] * Y[1] + E[k, 2] * Y[2]
            here.phi[i, k] = E[k, 0] * Y[3] + E[k, 1] * Y[4] + E[k, 2] * Y[5]


@kernel
def differentiate(shell: ShellRecord, here: ShellScratch) -> None:
    """Spin omega and differentials of the deformations, rate, from dr and phi."""
    x, X, dr, rate, H = here.x, shell.X, here.dr, here.rate, here.H
    p, q = dr[2, 1] - dr[0, 1], dr[3, 1] - dr[1, 1]
    px, pz, qx, qz = x[2, 0] - x[0, 0], x[2, 2] - x[0, 2], x[3, 0] - x[1, 0], x[3, 2] - x[1, 2]
    cross = pz * qx - px * qz
    oz, ox = (pz * q - qz * p) / cross, (px * q - qx * p) / cross
    oy = 0.0 * ox
    for k in range(3):
        mean = 0.25 * (dr[0, k] + dr[1, k] + dr[2, k] + dr[3, k])
        for i in range(4):
            rate[i, k] = dr[i, k] - mean
    for i in range(4):
        oy += X[i, 2] * (rate[i, 0] + oz * x[i, 1]) - X[i, 0] * (rate[i, 2] - ox * x[i, 1])
    oy /= here.spread
    here.omega[0], here.omega[1], here.omega[2] = ox, oy, oz
    for i in range(4):
        rate[i, 0] -= oy * x[i, 2] - oz * x[i, 1]
        rate[i, 1] -= oz * x[i, 0] - ox * x[i, 2]
        rate[i, 2] -= ox * x[i, 1] - oy * x[i, 0]
        sx, sy, sz = here.phi[i, 0] - ox, here.phi[i, 1] - oy, here.phi[i, 2] - oz
        for k in range(3):
            rate[i, 3 + k] = H[i, k, 0] * sx + H[i, k, 1] * sy + H[i, k, 2] * sz


@kernel
def resist(shell: ShellRecord, d: Reals, part: float, f: Reals) -> None:
    """f (4, 6) += part K d."""
    for i in range(4):
        for k in range(3):
            plane, bent = shell.plane[3 * i + k], shell.bent[3 * i + k]
            in_plane, out = 0.0 * d[0, 0], 0.0 * d[0, 0]
            for j in range(4):
                in_plane += plane[3 * j] * d[j, 0] + plane[3 * j + 1] * d[j, 2] + plane[3 * j + 2] * d[j, 4]
                out += bent[3 * j] * d[j, 1] + bent[3 * j + 1] * d[j, 3] + bent[3 * j + 2] * d[j, 5]
            f[i, 2 * k] += part * in_plane
            f[i, 2 * k + 1] += part * out


@kernel
def gradient(shell: ShellRecord, here: ShellScratch) -> None:
    """n by the motions of the corners and m by the rotations of the bodies, from f."""
    x, X, f, n, m, H, o, lift = here.x, shell.X, here.f, here.n, here.m, here.H, here.o, here.lift
    ox, oy, oz = 0.0 * here.spread, 0.0 * here.spread, 0.0 * here.spread
    for i in range(4):
        for k in range(3):
            m[i, k] = H[i, 0, k] * f[i, 3] + H[i, 1, k] * f[i, 4] + H[i, 2, k] * f[i, 5]
        ox -= x[i, 1] * f[i, 2] - x[i, 2] * f[i, 1] + m[i, 0]
        oy -= x[i, 2] * f[i, 0] - x[i, 0] * f[i, 2] + m[i, 1]
        oz -= x[i, 0] * f[i, 1] - x[i, 1] * f[i, 0] + m[i, 2]
    oy /= here.spread
    for i in range(4):
        ox += oy * X[i, 0] * x[i, 1]
        oz += oy * X[i, 2] * x[i, 1]
    o[0], o[1], o[2] = ox, oy, oz
    px, pz, qx, qz = x[2, 0] - x[0, 0], x[2, 2] - x[0, 2], x[3, 0] - x[1, 0], x[3, 2] - x[1, 2]
    cross = pz * qx - px * qz
    lift[0], lift[1] = -(qz * oz + qx * ox) / cross, (pz * oz + px * ox) / cross
    assemble(X, f, o, lift, n)


@kernel
def assemble(X: Reals, f: Reals, o: Any, lift: Any, n: Reals) -> None:
    """n by the motions of the corners from f by those about their mean, o by turns in the plane, lift by diagonals."""
    for k in range(3):
        mean = 0.25 * (f[0, k] + f[1, k] + f[2, k] + f[3, k])
        for i in range(4):
            n[i, k] = f[i, k] - mean
    for i in range(4):
        n[i, 0] += o[1] * X[i, 2]
        n[i, 2] -= o[1] * X[i, 0]
    n[0, 1] -= lift[0]
    n[1, 1] -= lift[1]
    n[2, 1] += lift[0]
    n[3, 1] += lift[1]


@kernel
def load(shell: ShellRecord, here: ShellScratch, bodies: Table[MotionRecord]) -> None:
    """Add minus the gradient to the applied wrenches F of the four bodies."""
    E, n, m = here.E, here.n, here.m
    for i in range(4):
        F = bodies[shell.node[i]].F
        for k in range(3):
            F[k] -= E[0, k] * n[i, 0] + E[1, k] * n[i, 1] + E[2, k] * n[i, 2]
            F[3 + k] -= E[0, k] * m[i, 0] + E[1, k] * m[i, 1] + E[2, k] * m[i, 2]


@kernel
def strain_work(f: Reals, d: Reals) -> Any:
    """f . d."""
    total = 0.0 * d[0, 0]
    for i in range(4):
        for k in range(6):
            total += f[i, k] * d[i, k]
    return total


@kernel
def clear_vector(f: Reals) -> None:
    """f = 0."""
    for i in range(4):
        for k in range(6):
            f[i, k] = 0.0


@kernel
def use_extrapolated(shell: ShellRecord, here: ShellScratch) -> None:
    """d <- the extrapolated deformation."""
    for i in range(4):
        for k in range(6):
            here.d[i, k] = shell.extrapolated[i, k]


@kernel
def apply(shell: ShellRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`mbfmu.mechanics.loads.base`. The power of the damping, -beta d'^T K d', is a by-product."""
    bodies, here = state.bodies, shell_scratch(shell, state)
    deform(shell, bodies, here)
    clear_vector(here.f)
    if shell.damped == 1:
        update_rates(shell, bodies, here)
        differentiate(shell, here)
        resist(shell, here.rate, shell.damping, here.f)
        state.cached_power[0] -= strain_work(here.f, here.rate)
    if shell.is_extrapolated == 1:
        use_extrapolated(shell, here)
    resist(shell, here.d, 1.0, here.f)
    gradient(shell, here)
    load(shell, here, bodies)


@kernel
def potential(shell: ShellRecord, arrays: Arrays, state: State) -> float:
    """Elastic energy, J."""
    here = shell_scratch(shell, state)
    deform(shell, state.bodies, here)
    clear_vector(here.f)
    resist(shell, here.d, 1.0, here.f)
    return 0.5 * strain_work(here.f, here.d)

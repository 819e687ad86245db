"""A body of any shape by its modes in space, as kernels: how its interfaces move and what its inertia does.

In the body's frame E the point at x goes to x + u + d, with the modes phi_k, the amplitudes p_k, and

    u = sum phi_k p_k,      d = -1/2 sum g_kl p_k p_l,

where the displacements d of second order are the geometric stiffening (optional; ``shortens`` is 0 without): a load F
does the work F.d, so that p^T K[F] p / 2 is its potential, K[F] the geometric stiffness of the stresses of F. Beams
(:mod:`.planar`) are a case of this with u along y and d along x.

**Inertia.** Kinetic energy with the terms of p and p' kept to second order, v and w the velocity of E in its axes:

    T = m v.v / 2 + v.(w x S) + w.J w / 2 + sum p'_k (S_k.v + h_k.w + mu_k p'_k / 2)
    S = S_0 + sum S1_k p_k - 1/2 sum G_kl p_k p_l,               S_k = dS/dp_k
    J = J_0 + sum J1_k p_k + 1/2 sum J2_kl p_k p_l               J_k = dJ/dp_k
    h_k = h1_k + sum C_kl p_l - sum H_kl p_l                     C_kl = -C_lk = int phi_l x phi_k,  H_kl = H_lk

(the modes are orthogonal; :mod:`.invariants` has the integrals). With r'', w' of the frame, accelerations less gravity,
and s = sum S_k p'_k, Lagrange's and Boltzmann's equations read

    f     = m r'' + w' x S + w x (w x S) + 2 w x s + sum S_k p''_k - sum G_kl p'_k p'_l
    n     = S x r'' + J w' + w x J w + J. w + sum (h_k p''_k + w x h_k p'_k) - sum H_kl p'_k p'_l
    tau_k = S_k.r'' + h_k.w' + mu_k p''_k + 2 w.sum C_kl p'_l - w.J_k w / 2 + kappa_k p_k + delta_k p'_k

**Interfaces.** The frame of an interface at t moves to t + phi.p - p^T Gt p / 2 and rotates by the vector
theta = psi.p - p^T Gr p / 2, as the rotation of Cayley with the Gibbs vector theta / 2:

    R = 1 + c (theta x + theta x theta x / 2),  w_rel = c (theta' + theta x theta' / 2),  c = 1 / (1 + theta.theta / 4)

**Data** in Arrays.numbers, from ``at``: m, S_0, J_0 (xx, yy, zz, xy, xz, yz); for every mode S1_k, h1_k, J1_k, mu_k,
kappa_k, delta_k; matrices (modes, modes) of J2 (six), C (three), and with geometric stiffening G and H (three each). Of
an interface: t; for every mode phi_k, psi_k; with geometric stiffening the matrices Gt and Gr (three each).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbfmu.mechanics.spatial import add_from_body_axes, to_body_axis
from solvers.compiled.kernel import kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.records import BodyRecord, MotionRecord, State
    from solvers.compiled.record import Reals

    from .records import FlexibleRecord, NodeRecord

RIGID_NUMBERS, MODE_NUMBERS, INTERFACE_NUMBERS = 10, 15, 6  # of a body, and of a mode in a body and at an interface
SHORTENING = 9  # first of the matrices of geometric stiffening, after J2 and C
Six = tuple[float, float, float, float, float, float]


@kernel
def dot(numbers: Reals, first: int, n: int, x: Reals, i: int) -> float:
    """Sum of n numbers times the entries of x from i on."""
    total = 0.0 * x[i]
    for l in range(n):
        total += numbers[first + l] * x[i + l]
    return total


@kernel
def place_section(
    body: BodyRecord, node: NodeRecord, parent: MotionRecord, here: MotionRecord, state: State, numbers: Reals
) -> None:
    """Position r, A of an interface and its rows of the motion subspaces; ``parent`` is the body's frame E."""
    n, qi, q, C, A, at = body.nv, body.qi, state.q, parent.A, here.A, node.at
    zero = 0.0 * q[qi]
    x, y, z = numbers[at] + zero, numbers[at + 1] + zero, numbers[at + 2] + zero
    tx, ty, tz = zero, zero, zero
    for k in range(n):
        p = q[qi + k]
        dx, dy, dz, rx, ry, rz = shape_of(node, k, n, q, qi, 0.5, numbers)
        x += p * dx
        y += p * dy
        z += p * dz
        tx += p * rx
        ty += p * ry
        tz += p * rz
    c = 1.0 / (1.0 + 0.25 * (tx * tx + ty * ty + tz * tz))
    xx, yy, zz = 0.5 * c * tx * tx, 0.5 * c * ty * ty, 0.5 * c * tz * tz
    xy, xz, yz = 0.5 * c * tx * ty, 0.5 * c * tx * tz, 0.5 * c * ty * tz
    for i in range(3):
        here.r[i] = parent.r[i] + C[i, 0] * x + C[i, 1] * y + C[i, 2] * z
        A[i, 0] = C[i, 0] * (1.0 - yy - zz) + C[i, 1] * (xy + c * tz) + C[i, 2] * (xz - c * ty)
        A[i, 1] = C[i, 0] * (xy - c * tz) + C[i, 1] * (1.0 - xx - zz) + C[i, 2] * (yz + c * tx)
        A[i, 2] = C[i, 0] * (xz + c * ty) + C[i, 1] * (yz - c * tx) + C[i, 2] * (1.0 - xx - yy)
    for k in range(n):
        dx, dy, dz, rx, ry, rz = shape_of(node, k, n, q, qi, 1.0, numbers)
        wx = c * (rx + 0.5 * (ty * rz - tz * ry))
        wy = c * (ry + 0.5 * (tz * rx - tx * rz))
        wz = c * (rz + 0.5 * (tx * ry - ty * rx))
        for i in range(3):
            state.S[body.si + k, i] = C[i, 0] * dx + C[i, 1] * dy + C[i, 2] * dz
            state.S[body.si + k, 3 + i] = C[i, 0] * wx + C[i, 1] * wy + C[i, 2] * wz


@kernel
def shape_of(node: NodeRecord, k: int, n: int, p: Reals, i: int, part: float, numbers: Reals) -> Six:
    """phi_k and psi_k of an interface less ``part`` times (Gt p)_k and (Gr p)_k: with 1 the derivatives of t and theta
    by p_k, with 1/2 the terms whose sum with p_k they are.
    """
    own, row = node.at + 3 + INTERFACE_NUMBERS * k, node.at + 3 + INTERFACE_NUMBERS * n + k * n
    zero = 0.0 * p[i]
    dx, dy, dz = numbers[own] + zero, numbers[own + 1] + zero, numbers[own + 2] + zero
    rx, ry, rz = numbers[own + 3] + zero, numbers[own + 4] + zero, numbers[own + 5] + zero
    if node.shortens > 0:
        size = n * n
        dx -= part * dot(numbers, row, n, p, i)
        dy -= part * dot(numbers, row + size, n, p, i)
        dz -= part * dot(numbers, row + 2 * size, n, p, i)
        rx -= part * dot(numbers, row + 3 * size, n, p, i)
        ry -= part * dot(numbers, row + 4 * size, n, p, i)
        rz -= part * dot(numbers, row + 5 * size, n, p, i)
    return dx, dy, dz, rx, ry, rz


@kernel
def add_section_bias(
    body: BodyRecord, node: NodeRecord, frame: MotionRecord, state: State, numbers: Reals, beta: Reals
) -> None:
    """Add to the velocity products of an interface what the changing of its subspace adds."""
    n, qi, vi, q, v = body.nv, body.qi, body.vi, state.q, state.v
    zero = 0.0 * q[qi]
    tx, ty, tz, ux, uy, uz = zero, zero, zero, zero, zero, zero  # theta and its rate
    ax, ay, az, bx, by, bz = zero, zero, zero, zero, zero, zero  # accelerations at p'' = 0
    for k in range(n):
        p, rate = q[qi + k], v[vi + k]
        _, _, _, rx, ry, rz = shape_of(node, k, n, q, qi, 0.5, numbers)
        tx += p * rx
        ty += p * ry
        tz += p * rz
        _, _, _, rx, ry, rz = shape_of(node, k, n, q, qi, 1.0, numbers)
        ux += rate * rx
        uy += rate * ry
        uz += rate * rz
        if node.shortens > 0:
            row, size = node.at + 3 + INTERFACE_NUMBERS * n + k * n, n * n
            ax -= rate * dot(numbers, row, n, v, vi)
            ay -= rate * dot(numbers, row + size, n, v, vi)
            az -= rate * dot(numbers, row + 2 * size, n, v, vi)
            bx -= rate * dot(numbers, row + 3 * size, n, v, vi)
            by -= rate * dot(numbers, row + 4 * size, n, v, vi)
            bz -= rate * dot(numbers, row + 5 * size, n, v, vi)
    c = 1.0 / (1.0 + 0.25 * (tx * tx + ty * ty + tz * tz))
    slower = -0.5 * c * c * (tx * ux + ty * uy + tz * uz)  # c'
    wx = c * (bx + 0.5 * (ty * bz - tz * by)) + slower * (ux + 0.5 * (ty * uz - tz * uy))
    wy = c * (by + 0.5 * (tz * bx - tx * bz)) + slower * (uy + 0.5 * (tz * ux - tx * uz))
    wz = c * (bz + 0.5 * (tx * by - ty * bx)) + slower * (uz + 0.5 * (tx * uy - ty * ux))
    add_from_body_axes(frame.A, ax, ay, az, beta, 0)
    add_from_body_axes(frame.A, wx, wy, wz, beta, 3)


@kernel
def mode_numbers(flexible: FlexibleRecord, k: int) -> int:
    """Place of the numbers of a mode."""
    return flexible.at + RIGID_NUMBERS + MODE_NUMBERS * k


@kernel
def matrix_row(flexible: FlexibleRecord, matrix: int, k: int) -> int:
    """Place of row k of a matrix."""
    n = flexible.modes
    return flexible.at + RIGID_NUMBERS + MODE_NUMBERS * n + (matrix * n + k) * n


@kernel
def modal_mass(flexible: FlexibleRecord, k: int, numbers: Reals) -> float:
    """mu_k."""
    return numbers[mode_numbers(flexible, k) + 12]


@kernel
def first_moment(flexible: FlexibleRecord, q: Reals, numbers: Reals) -> tuple[float, float, float]:
    """S."""
    at, zero = flexible.at, 0.0 * q[flexible.qi]
    sx, sy, sz = numbers[at + 1] + zero, numbers[at + 2] + zero, numbers[at + 3] + zero
    for k in range(flexible.modes):
        p = q[flexible.qi + k]
        dx, dy, dz = moment_rate(flexible, k, q, 0.5, numbers)
        sx += p * dx
        sy += p * dy
        sz += p * dz
    return sx, sy, sz


@kernel
def moment_rate(flexible: FlexibleRecord, k: int, q: Reals, part: float, numbers: Reals) -> tuple[float, float, float]:
    """S1_k less ``part`` times (G p)_k: with 1 it is S_k."""
    n, qi, own = flexible.modes, flexible.qi, mode_numbers(flexible, k)
    zero = 0.0 * q[qi]
    dx, dy, dz = numbers[own] + zero, numbers[own + 1] + zero, numbers[own + 2] + zero
    if flexible.shortens > 0:
        dx -= part * dot(numbers, matrix_row(flexible, SHORTENING, k), n, q, qi)
        dy -= part * dot(numbers, matrix_row(flexible, SHORTENING + 1, k), n, q, qi)
        dz -= part * dot(numbers, matrix_row(flexible, SHORTENING + 2, k), n, q, qi)
    return dx, dy, dz


@kernel
def angular_rate(flexible: FlexibleRecord, k: int, q: Reals, numbers: Reals) -> tuple[float, float, float]:
    """h_k."""
    n, qi, own = flexible.modes, flexible.qi, mode_numbers(flexible, k) + 3
    hx = numbers[own] + dot(numbers, matrix_row(flexible, 6, k), n, q, qi)
    hy = numbers[own + 1] + dot(numbers, matrix_row(flexible, 7, k), n, q, qi)
    hz = numbers[own + 2] + dot(numbers, matrix_row(flexible, 8, k), n, q, qi)
    if flexible.shortens > 0:
        hx -= dot(numbers, matrix_row(flexible, SHORTENING + 3, k), n, q, qi)
        hy -= dot(numbers, matrix_row(flexible, SHORTENING + 4, k), n, q, qi)
        hz -= dot(numbers, matrix_row(flexible, SHORTENING + 5, k), n, q, qi)
    return hx, hy, hz


@kernel
def inertia_rate(flexible: FlexibleRecord, k: int, q: Reals, part: float, numbers: Reals) -> Six:
    """J1_k and ``part`` times sum J2_kl p_l: with 1 it is J_k."""
    n, qi, own = flexible.modes, flexible.qi, mode_numbers(flexible, k) + 6
    return (
        numbers[own] + part * dot(numbers, matrix_row(flexible, 0, k), n, q, qi),
        numbers[own + 1] + part * dot(numbers, matrix_row(flexible, 1, k), n, q, qi),
        numbers[own + 2] + part * dot(numbers, matrix_row(flexible, 2, k), n, q, qi),
        numbers[own + 3] + part * dot(numbers, matrix_row(flexible, 3, k), n, q, qi),
        numbers[own + 4] + part * dot(numbers, matrix_row(flexible, 4, k), n, q, qi),
        numbers[own + 5] + part * dot(numbers, matrix_row(flexible, 5, k), n, q, qi),
    )


@kernel
def inertia_tensor(flexible: FlexibleRecord, q: Reals, numbers: Reals) -> Six:
    """J (xx, yy, zz, xy, xz, yz)."""
    at, zero = flexible.at + 4, 0.0 * q[flexible.qi]
    xx, yy, zz = numbers[at] + zero, numbers[at + 1] + zero, numbers[at + 2] + zero
    xy, xz, yz = numbers[at + 3] + zero, numbers[at + 4] + zero, numbers[at + 5] + zero
    for k in range(flexible.modes):
        p = q[flexible.qi + k]
        dxx, dyy, dzz, dxy, dxz, dyz = inertia_rate(flexible, k, q, 0.5, numbers)
        xx += p * dxx
        yy += p * dyy
        zz += p * dzz
        xy += p * dxy
        xz += p * dxz
        yz += p * dyz
    return xx, yy, zz, xy, xz, yz


@kernel
def composite(flexible: FlexibleRecord, here: MotionRecord, q: Reals, numbers: Reals) -> None:
    """Mass, first moment and inertia about the origin of the deformed body, global axes."""
    A = here.A
    sx, sy, sz = first_moment(flexible, q, numbers)
    xx, yy, zz, xy, xz, yz = inertia_tensor(flexible, q, numbers)
    here.mass = numbers[flexible.at]
    for i in range(3):
        here.mc[i] = A[i, 0] * sx + A[i, 1] * sy + A[i, 2] * sz
        for j in range(3):
            here.J[i, j] = (
                A[i, 0] * (xx * A[j, 0] + xy * A[j, 1] + xz * A[j, 2])
                + A[i, 1] * (xy * A[j, 0] + yy * A[j, 1] + yz * A[j, 2])
                + A[i, 2] * (xz * A[j, 0] + yz * A[j, 1] + zz * A[j, 2])
            )


@kernel
def coupling(flexible: FlexibleRecord, k: int, here: MotionRecord, q: Reals, numbers: Reals, out: Reals) -> None:
    """out = momentum wrench of p'_k = 1 about the origin, global axes: (S_k, h_k)."""
    for i in range(6):
        out[i] = 0.0
    sx, sy, sz = moment_rate(flexible, k, q, 1.0, numbers)
    hx, hy, hz = angular_rate(flexible, k, q, numbers)
    add_from_body_axes(here.A, sx, sy, sz, out, 0)
    add_from_body_axes(here.A, hx, hy, hz, out, 3)


@kernel
def inertia(flexible: FlexibleRecord, here: MotionRecord, state: State, numbers: Reals) -> None:
    """Add f and n to the wrench W of the frame and the tau_k to State.tau (module docstring)."""
    A, q, v, a, n, qi, vi = here.A, state.q, state.v, state.a, flexible.modes, flexible.qi, flexible.vi
    ax, ay, az = to_body_axis(A, here.dY, 0)
    bx, by, bz = to_body_axis(A, here.dY, 3)
    wx, wy, wz = to_body_axis(A, here.Y, 3)
    m, zero = numbers[flexible.at], 0.0 * q[qi]
    sx, sy, sz = first_moment(flexible, q, numbers)
    xx, yy, zz, xy, xz, yz = inertia_tensor(flexible, q, numbers)
    ux, uy, uz = zero, zero, zero  # s, the rate of S
    dxx, dyy, dzz, dxy, dxz, dyz = zero, zero, zero, zero, zero, zero  # rate of J
    ex, ey, ez = zero, zero, zero  # sum h_k p'_k
    fx, fy, fz, nx, ny, nz = zero, zero, zero, zero, zero, zero
    for k in range(n):
        rate, growth = v[vi + k], a[vi + k]
        kx, ky, kz = moment_rate(flexible, k, q, 1.0, numbers)
        hx, hy, hz = angular_rate(flexible, k, q, numbers)
        jxx, jyy, jzz, jxy, jxz, jyz = inertia_rate(flexible, k, q, 1.0, numbers)
        ux += kx * rate
        uy += ky * rate
        uz += kz * rate
        ex += hx * rate
        ey += hy * rate
        ez += hz * rate
        dxx += jxx * rate
        dyy += jyy * rate
        dzz += jzz * rate
        dxy += jxy * rate
        dxz += jxz * rate
        dyz += jyz * rate
        fx += kx * growth
        fy += ky * growth
        fz += kz * growth
        nx += hx * growth
        ny += hy * growth
        nz += hz * growth
        if flexible.shortens > 0:
            fx -= rate * dot(numbers, matrix_row(flexible, SHORTENING, k), n, v, vi)
            fy -= rate * dot(numbers, matrix_row(flexible, SHORTENING + 1, k), n, v, vi)
            fz -= rate * dot(numbers, matrix_row(flexible, SHORTENING + 2, k), n, v, vi)
            nx -= rate * dot(numbers, matrix_row(flexible, SHORTENING + 3, k), n, v, vi)
            ny -= rate * dot(numbers, matrix_row(flexible, SHORTENING + 4, k), n, v, vi)
            nz -= rate * dot(numbers, matrix_row(flexible, SHORTENING + 5, k), n, v, vi)
        gx = dot(numbers, matrix_row(flexible, 6, k), n, v, vi)
        gy = dot(numbers, matrix_row(flexible, 7, k), n, v, vi)
        gz = dot(numbers, matrix_row(flexible, 8, k), n, v, vi)
        state.tau[vi + k] += (
            modal_mass(flexible, k, numbers) * growth
            + (kx * ax + ky * ay + kz * az)
            + (hx * bx + hy * by + hz * bz)
            + 2.0 * (wx * gx + wy * gy + wz * gz)
            - 0.5 * (jxx * wx * wx + jyy * wy * wy + jzz * wz * wz)
            - (jxy * wx * wy + jxz * wx * wz + jyz * wy * wz)
        )
    # w x S + 2 s, then f
    px, py, pz = wy * sz - wz * sy + 2.0 * ux, wz * sx - wx * sz + 2.0 * uy, wx * sy - wy * sx + 2.0 * uz
    fx += m * ax + by * sz - bz * sy + wy * pz - wz * py
    fy += m * ay + bz * sx - bx * sz + wz * px - wx * pz
    fz += m * az + bx * sy - by * sx + wx * py - wy * px
    # J w + sum h_k p'_k, then n
    lx = xx * wx + xy * wy + xz * wz + ex
    ly = xy * wx + yy * wy + yz * wz + ey
    lz = xz * wx + yz * wy + zz * wz + ez
    nx += sy * az - sz * ay + xx * bx + xy * by + xz * bz + dxx * wx + dxy * wy + dxz * wz + wy * lz - wz * ly
    ny += sz * ax - sx * az + xy * bx + yy * by + yz * bz + dxy * wx + dyy * wy + dyz * wz + wz * lx - wx * lz
    nz += sx * ay - sy * ax + xz * bx + yz * by + zz * bz + dxz * wx + dyz * wy + dzz * wz + wx * ly - wy * lx
    add_from_body_axes(A, fx, fy, fz, here.W, 0)
    add_from_body_axes(A, nx, ny, nz, here.W, 3)


@kernel
def momentum(flexible: FlexibleRecord, here: MotionRecord, state: State, numbers: Reals, out: Reals) -> None:
    """out += momentum and angular momentum about the frame's origin, global axes."""
    A, q, v, vi = here.A, state.q, state.v, flexible.vi
    vx, vy, vz = to_body_axis(A, here.Y, 0)
    wx, wy, wz = to_body_axis(A, here.Y, 3)
    m = numbers[flexible.at]
    sx, sy, sz = first_moment(flexible, q, numbers)
    xx, yy, zz, xy, xz, yz = inertia_tensor(flexible, q, numbers)
    px, py, pz = m * vx + wy * sz - wz * sy, m * vy + wz * sx - wx * sz, m * vz + wx * sy - wy * sx
    lx = sy * vz - sz * vy + xx * wx + xy * wy + xz * wz
    ly = sz * vx - sx * vz + xy * wx + yy * wy + yz * wz
    lz = sx * vy - sy * vx + xz * wx + yz * wy + zz * wz
    for k in range(flexible.modes):
        rate = v[vi + k]
        kx, ky, kz = moment_rate(flexible, k, q, 1.0, numbers)
        hx, hy, hz = angular_rate(flexible, k, q, numbers)
        px += kx * rate
        py += ky * rate
        pz += kz * rate
        lx += hx * rate
        ly += hy * rate
        lz += hz * rate
    add_from_body_axes(A, px, py, pz, out, 0)
    add_from_body_axes(A, lx, ly, lz, out, 3)


@kernel
def modal_momentum(flexible: FlexibleRecord, k: int, here: MotionRecord, state: State, numbers: Reals) -> float:
    """dT/dp'_k."""
    vx, vy, vz = to_body_axis(here.A, here.Y, 0)
    wx, wy, wz = to_body_axis(here.A, here.Y, 3)
    kx, ky, kz = moment_rate(flexible, k, state.q, 1.0, numbers)
    hx, hy, hz = angular_rate(flexible, k, state.q, numbers)
    own = modal_mass(flexible, k, numbers) * state.v[flexible.vi + k]
    return kx * vx + ky * vy + kz * vz + hx * wx + hy * wy + hz * wz + own


@kernel
def apply_elastic_forces(flexible: FlexibleRecord, state: State, numbers: Reals) -> None:
    """Modal stiffness and damping among the forces along the coordinates."""
    for k in range(flexible.modes):
        own = mode_numbers(flexible, k)
        p, rate = state.q[flexible.qi + k], state.v[flexible.vi + k]
        state.Q[flexible.vi + k] -= numbers[own + 13] * p + numbers[own + 14] * rate


@kernel
def potential(flexible: FlexibleRecord, state: State, numbers: Reals) -> float:
    """Strain energy, J."""
    total = 0.0 * state.q[flexible.qi]
    for k in range(flexible.modes):
        total += 0.5 * numbers[mode_numbers(flexible, k) + 13] * state.q[flexible.qi + k] ** 2
    return total


@kernel
def power(flexible: FlexibleRecord, state: State, numbers: Reals) -> float:
    """-sum delta_k p'_k^2, W."""
    total = 0.0 * state.v[flexible.vi]
    for k in range(flexible.modes):
        total -= numbers[mode_numbers(flexible, k) + 14] * state.v[flexible.vi + k] ** 2
    return total


@kernel
def gravity_potential(
    flexible: FlexibleRecord, here: MotionRecord, state: State, gravity: Reals, numbers: Reals
) -> float:
    """Energy in the gravity field, zero at the global origin, J."""
    sx, sy, sz = first_moment(flexible, state.q, numbers)
    total = 0.0 * sx
    for i in range(3):
        arm = here.A[i, 0] * sx + here.A[i, 1] * sy + here.A[i, 2] * sz
        total -= gravity[i] * (numbers[flexible.at] * here.r[i] + arm)
    return total

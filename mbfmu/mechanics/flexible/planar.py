"""A slender body that bends in a plane, as kernels: how its points move and what its inertia does.

In the body's frame E a point of the axis at x goes to (x - s, w, 0), with the modes phi_k and the amplitudes p_k,

    w(x) = phi(x).p,      s(x) = p^T G(x) p / 2,   G(x) = int_0^x phi'^T phi' dx,

and a cross-section turns about z by phi'(x).p. s is the shortening by bending, which lets axial forces stiffen or
soften the bending (geometric stiffening): an optional effect, without which it is zero (``shortens`` is 0). Other
bodies are connected to a *node* of it, which is a body of the tree whose joint has the amplitudes as coordinates; all
nodes share them. The first node is the frame itself, phi = 0, and has the inertia.

The nodes are not where the mass is: integrals of the shapes, taken once, make the dynamics cost what the modes cost and
not what the elements cost, and are exact where lumped masses would be of second order.

**Inertia.** Kinetic energy of the axis' mass, with the terms of p and p' kept to second order. With rho the mass a
length and int over it, everything is in

    m = int rho,  X = (int rho x,  int rho x^2),  a_k = int rho phi_k,  c_k = int rho x phi_k,  mu_k = int rho phi_k^2,
    g0 = int rho G,  g1 = int rho x G

(the modes are orthogonal in rho), in E axes:

    first moment    S = (X_1 - p^T g0 p / 2,  a.p,  0)
    second moments  P_xx = X_2 - p^T g1 p,  P_xy = c.p,  P_yy = sum mu_k p_k^2,   J = tr P 1 - P
    momentum of p'  S_k = dS/dp_k along the axes, h_k = (0, 0, c_k) about the origin.

With r'', w' of the frame (accelerations less gravity), s = sum S_k p'_k, Lagrange's and Boltzmann's equations read

    f     = m r'' + w' x S + w x (w x S) + 2 w x s + sum S_k p''_k + s_p,      s_p = (-p'^T g0 p', 0, 0)
    n     = S x r'' + J w' + w x J w + J. w + h.p'' + w x h.p'
    tau_k = S_k.r'' + h_k.w' + mu_k p''_k - w.(dJ/dp_k) w / 2 + kappa_k (p_k + beta p'_k),

J. by p', kappa_k the modal stiffness, beta the damping time of the material.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbfmu.mechanics.spatial import add_from_body_axes, to_body_axis
from solvers.compiled.kernel import kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.records import BodyRecord, MotionRecord, State
    from solvers.compiled.record import Reals

    from .records import FlexibleRecord, NodeRecord


@kernel
def quadratic(G: Reals, size: int, x: Reals, i: int, y: Reals, j: int) -> float:
    """x^T G y over the entries of x from i and of y from j on."""
    total = 0.0 * x[i]
    for k in range(size):
        for l in range(size):
            total += x[i + k] * G[k, l] * y[j + l]
    return total


@kernel
def row_times(G: Reals, k: int, size: int, x: Reals, i: int) -> float:
    """(G x)_k over the entries of x from i on."""
    total = 0.0 * x[i]
    for l in range(size):
        total += G[k, l] * x[i + l]
    return total


@kernel
def place_section(body: BodyRecord, node: NodeRecord, parent: MotionRecord, here: MotionRecord, state: State) -> None:
    """Position r, A of a node and its rows of the motion subspaces; ``parent`` is the body's frame E."""
    qi, C, A = body.qi, parent.A, here.A
    w, turn = 0.0 * state.q[qi], 0.0 * state.q[qi]
    for k in range(body.nv):
        w += node.phi[k] * state.q[qi + k]
        turn += node.slope[k] * state.q[qi + k]
    x = node.x - 0.5 * quadratic(node.G, node.shortens, state.q, qi, state.q, qi)
    c, s = np.cos(turn), np.sin(turn)
    for i in range(3):
        here.r[i] = parent.r[i] + C[i, 0] * x + C[i, 1] * w
        A[i, 0], A[i, 1], A[i, 2] = c * C[i, 0] + s * C[i, 1], c * C[i, 1] - s * C[i, 0], C[i, 2]
    for k in range(body.nv):
        back = 0.0 * w
        if node.shortens > 0:
            back = row_times(node.G, k, node.shortens, state.q, qi)
        for i in range(3):
            state.S[body.si + k, i] = C[i, 1] * node.phi[k] - C[i, 0] * back
            state.S[body.si + k, 3 + i] = C[i, 2] * node.slope[k]


@kernel
def add_section_bias(body: BodyRecord, node: NodeRecord, frame: MotionRecord, state: State, beta: Reals) -> None:
    """Add to a node's velocity products what the changing of its subspace adds, -p'^T G p' along the axis."""
    back = quadratic(node.G, node.shortens, state.v, body.vi, state.v, body.vi)
    for i in range(3):
        beta[i] -= frame.A[i, 0] * back


@kernel
def moments(flexible: FlexibleRecord, q: Reals) -> tuple[float, float, float, float, float]:
    """S_x, S_y, P_xx, P_xy, P_yy."""
    qi, shortens = flexible.qi, flexible.shortens
    sx = flexible.X1 - 0.5 * quadratic(flexible.g0, shortens, q, qi, q, qi)
    pxx = flexible.X2 - quadratic(flexible.g1, shortens, q, qi, q, qi)
    sy, pxy, pyy = 0.0 * sx, 0.0 * sx, 0.0 * sx
    for k in range(flexible.modes):
        p = q[qi + k]
        sy += flexible.a[k] * p
        pxy += flexible.c[k] * p
        pyy += flexible.mu[k] * p * p
    return sx, sy, pxx, pxy, pyy


@kernel
def shift_rate(flexible: FlexibleRecord, k: int, q: Reals) -> float:
    """x component of S_k, -(g0 p)_k."""
    if flexible.shortens == 0:
        return 0.0 * q[flexible.qi]
    return -row_times(flexible.g0, k, flexible.shortens, q, flexible.qi)


@kernel
def composite(flexible: FlexibleRecord, here: MotionRecord, q: Reals) -> None:
    """Mass, first moment and second moment about the origin of the bent body, global axes."""
    A = here.A
    sx, sy, pxx, pxy, pyy = moments(flexible, q)
    here.mass = flexible.mass
    for i in range(3):
        here.mc[i] = A[i, 0] * sx + A[i, 1] * sy
        for j in range(3):
            here.J[i, j] = (
                pyy * A[i, 0] * A[j, 0]
                + pxx * A[i, 1] * A[j, 1]
                + (pxx + pyy) * A[i, 2] * A[j, 2]
                - pxy * (A[i, 0] * A[j, 1] + A[i, 1] * A[j, 0])
            )


@kernel
def coupling(flexible: FlexibleRecord, k: int, here: MotionRecord, q: Reals, out: Reals) -> None:
    """out = momentum wrench of p'_k = 1 about the origin, global axes: (S_k, h_k)."""
    for i in range(6):
        out[i] = 0.0
    add_from_body_axes(here.A, shift_rate(flexible, k, q), flexible.a[k], 0.0, out, 0)
    add_from_body_axes(here.A, 0.0, 0.0, flexible.c[k], out, 3)


@kernel
def inertia(flexible: FlexibleRecord, here: MotionRecord, state: State) -> None:
    """Add f and n to the wrench W of the frame and the tau_k to State.tau (module docstring)."""
    A, q, v, a, qi, vi = here.A, state.q, state.v, state.a, flexible.qi, flexible.vi
    ax, ay, az = to_body_axis(A, here.dY, 0)
    bx, by, bz = to_body_axis(A, here.dY, 3)
    wx, wy, wz = to_body_axis(A, here.Y, 3)
    sx, sy, pxx, pxy, pyy = moments(flexible, q)
    # rates by p' and what p'' moves
    dsx, dsy, dpxy, dpyy = 0.0 * sx, 0.0 * sx, 0.0 * sx, 0.0 * sx
    ux = -quadratic(flexible.g0, flexible.shortens, v, vi, v, vi)
    uy, hz = 0.0 * sx, 0.0 * sx
    dpxx = -2.0 * quadratic(flexible.g1, flexible.shortens, q, qi, v, vi)
    for k in range(flexible.modes):
        back = shift_rate(flexible, k, q)
        dsx += back * v[vi + k]
        dsy += flexible.a[k] * v[vi + k]
        dpxy += flexible.c[k] * v[vi + k]
        dpyy += 2.0 * flexible.mu[k] * q[qi + k] * v[vi + k]
        ux += back * a[vi + k]
        uy += flexible.a[k] * a[vi + k]
        hz += flexible.c[k] * a[vi + k]
        tau = flexible.mu[k] * (a[vi + k] - q[qi + k] * (wx * wx + wz * wz)) + flexible.c[k] * (bz + wx * wy)
        tau += back * ax + flexible.a[k] * ay
        if flexible.shortens > 0:
            tau += row_times(flexible.g1, k, flexible.shortens, q, qi) * (wy * wy + wz * wz)
        state.tau[vi + k] += tau
    # w x S, then f
    m = flexible.mass
    px, py, pz = -wz * sy, wz * sx, wx * sy - wy * sx
    fx = m * ax - bz * sy + wy * pz - wz * py - 2.0 * wz * dsy + ux
    fy = m * ay + bz * sx + wz * px - wx * pz + 2.0 * wz * dsx + uy
    fz = m * az + bx * sy - by * sx + wx * py - wy * px + 2.0 * (wx * dsy - wy * dsx)
    # J w, then n; h = (0, 0, dpxy)
    jx, jy, jz = pyy * wx - pxy * wy, pxx * wy - pxy * wx, (pxx + pyy) * wz
    nx = sy * az + pyy * bx - pxy * by + wy * jz - wz * jy + dpyy * wx - dpxy * wy + wy * dpxy
    ny = -sx * az + pxx * by - pxy * bx + wz * jx - wx * jz + dpxx * wy - dpxy * wx - wx * dpxy
    nz = sx * ay - sy * ax + (pxx + pyy) * bz + wx * jy - wy * jx + (dpxx + dpyy) * wz + hz
    add_from_body_axes(A, fx, fy, fz, here.W, 0)
    add_from_body_axes(A, nx, ny, nz, here.W, 3)


@kernel
def momentum(flexible: FlexibleRecord, here: MotionRecord, state: State, out: Reals) -> None:
    """out += momentum and angular momentum about the frame's origin, global axes."""
    A, v, vi = here.A, state.v, flexible.vi
    vx, vy, vz = to_body_axis(A, here.Y, 0)
    wx, wy, wz = to_body_axis(A, here.Y, 3)
    sx, sy, pxx, pxy, pyy = moments(flexible, state.q)
    dx, dy, h = 0.0 * sx, 0.0 * sx, 0.0 * sx
    for k in range(flexible.modes):
        dx += shift_rate(flexible, k, state.q) * v[vi + k]
        dy += flexible.a[k] * v[vi + k]
        h += flexible.c[k] * v[vi + k]
    m = flexible.mass
    add_from_body_axes(A, m * vx - wz * sy + dx, m * vy + wz * sx + dy, m * vz + wx * sy - wy * sx, out, 0)
    add_from_body_axes(
        A,
        sy * vz + pyy * wx - pxy * wy,
        -sx * vz + pxx * wy - pxy * wx,
        sx * vy - sy * vx + (pxx + pyy) * wz + h,
        out,
        3,
    )


@kernel
def modal_momentum(flexible: FlexibleRecord, k: int, here: MotionRecord, state: State) -> float:
    """dT/dp'_k."""
    _, _, wz = to_body_axis(here.A, here.Y, 3)
    vx, vy, _ = to_body_axis(here.A, here.Y, 0)
    back = shift_rate(flexible, k, state.q)
    return back * vx + flexible.a[k] * vy + flexible.c[k] * wz + flexible.mu[k] * state.v[flexible.vi + k]


@kernel
def apply_elastic_forces(flexible: FlexibleRecord, state: State) -> None:
    """Modal stiffness and damping among the forces along the coordinates."""
    for k in range(flexible.modes):
        p, rate = state.q[flexible.qi + k], state.v[flexible.vi + k]
        state.Q[flexible.vi + k] -= flexible.kappa[k] * (p + flexible.beta * rate)


@kernel
def potential(flexible: FlexibleRecord, state: State) -> float:
    """Strain energy, J."""
    total = 0.0 * state.q[flexible.qi]
    for k in range(flexible.modes):
        total += 0.5 * flexible.kappa[k] * state.q[flexible.qi + k] ** 2
    return total


@kernel
def power(flexible: FlexibleRecord, state: State) -> float:
    """-beta sum kappa_k p'_k^2, W."""
    total = 0.0 * state.v[flexible.vi]
    for k in range(flexible.modes):
        total -= flexible.beta * flexible.kappa[k] * state.v[flexible.vi + k] ** 2
    return total


@kernel
def gravity_potential(flexible: FlexibleRecord, here: MotionRecord, state: State, g: Reals) -> float:
    """Energy in the gravity field g, zero at the global origin, J."""
    sx, sy, _, _, _ = moments(flexible, state.q)
    total = 0.0 * sx
    for i in range(3):
        total -= g[i] * (flexible.mass * here.r[i] + here.A[i, 0] * sx + here.A[i, 1] * sy)
    return total

"""Where a wheel touches a cylindrical surface of body a, z = h(x), and how this place moves.

The frame of the profile has its origin in the point P of body a, the direction of x along the profile, y along the
generators of the surface, and z where the wheel is. With sigma = sqrt(1 + h'^2) and the curvature kappa, positive
in a trough, the point S = (x, h), the tangent tau and the normal n of the profile are::

    tau = (1, h') / sigma,    n = (-h', 1) / sigma,    kappa = h'' / sigma^3,    dn/dx = -kappa sigma tau

The wheel has the center Q, the axle e, the radius r = R - c of the circle in the middle of its torus and the crown
radius c (:mod:`.rolling_rows`). With p = n.e, q = tau.e, the component e_y along the generators and s^2 = q^2 + e_y^2,
its lowest point for the normal n is C = Q + r u - c n, where tau.u = p q / s and n.u = -s. It touches the profile at
the x for which C is above S along n::

    f(x) = tau.(C - S) = tau.(Q - S) + r p q / s = 0
    f'   = -sigma (1 - kappa (Phi + rho)),    rho = c + r e_y^2 / s^3

rho is the radius of curvature of the wheel's outline, seen along the generators: R for an upright wheel, c for one that
rolls along the generators. The wheel touches the profile at one place only if kappa rho < 1 everywhere. Then,
with the x of C,

    F(x) = x - x_C(x),    F' = 1 - kappa rho

increases, so that the place at which C is vertically above S is unique. It is between Q_x - R and Q_x + R. Newton's
method with bisection finds it. From there Newton's method finds the zero of f, which is the same if the wheel touches
the profile. The rate of this place is x' = -f_t / f', with f_t at constant x, and

    n' = w_a x n - kappa sigma x' tau

A wheel that is farther from the profile than its radius is at the start of an assembly. Along n other places may be as
near, so that Phi is the vertical distance from S at the zero of F, and the surface counts as a horizontal plane.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbfmu.mechanics import law
from mbfmu.mechanics.curve import curve
from mbfmu.mechanics.spatial import arm
from mbfmu.mechanics.wheels import add3, cross3, dot3
from solvers.compiled.kernel import jit_uncached, kernel
from solvers.compiled.record import f8, i8

from .rolling_rows import RollingWheelRecord, heading_rates, roll

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State

BRACKETING, PROJECTING, POLISHING, FOUND, FAR = range(5)  # phases of the search of the place, with its results
MAX_PLACE_NEWTON_STEPS, MAX_SEARCH_STEPS = 20, 100  # then bisection; then the search ends
BRACKET_RATIO, PROJECTION_RATIO = 1e-6, 1e-9  # last step of a phase, relative to the radius of the wheel
OUTLINE_POINTS = 180  # of a wheel that are compared with its profile


class RollingProfileRecord(RollingWheelRecord):
    """Parameters of a :class:`.RollingWheel` on a profile; its x and z are the first and the last axis of Ra."""

    first: i8  # of the numbers of a table, and how many rows it has; none: the profile is a function
    count: i8
    lower: f8  # m, of x: the profile continues straight beyond
    upper: f8
    width: f8  # m, over which a function changes


@kernel
def straight(cut: RollingProfileRecord, x: Any) -> Any:
    """The x of the interval that is nearest to x, and the distance of x from there."""
    if x.real < cut.lower.real:
        return cut.lower + 0.0 * x, x - cut.lower
    if x.real > cut.upper.real:
        return cut.upper + 0.0 * x, x - cut.upper
    return x, 0.0 * x


@kernel
def extended(h: Any, dh: Any, ddh: Any, beyond: Any) -> Any:
    """Height and its derivatives at a distance beyond the end with these."""
    return (h, dh, ddh) if beyond.real == 0.0 else (h + dh * beyond, dh, 0.0 * ddh)


@kernel
def locate(cut: RollingProfileRecord, A: MotionRecord, B: MotionRecord) -> Any:
    """x and z of the wheel's center, and e_x, e_y^2 and e_z of its axle, in the frame of the profile."""
    e, center, origin = arm(B, cut.Rb[:, 2]), arm(B, cut.Pb), arm(A, cut.Pa)
    apart = B.r[0] - A.r[0], B.r[1] - A.r[1], B.r[2] - A.r[2]
    way = add3(add3(center, 1.0, apart), -1.0, origin)
    x, y, z = arm(A, cut.Ra[:, 0]), arm(A, cut.Ra[:, 1]), arm(A, cut.Ra[:, 2])
    side = dot3(e, y)
    return dot3(way, x), dot3(way, z), dot3(e, x), side * side, dot3(e, z)


@kernel
def begin(cut: RollingProfileRecord, wheel: Any) -> Any:
    """The search of the place before its first step: phase, number of steps, x, interval of x, x of the bracketing."""
    X, R = wheel[0], (cut.radius + cut.crown).real
    return BRACKETING, 0, X, X.real - R, X.real + R, X


@kernel
def inclined(wheel: Any, dh: Any) -> Any:
    """sigma, p, q and s of a wheel where the profile has the slope dh."""
    _, _, ex, side, ez = wheel
    sigma = np.sqrt(1.0 + dh * dh)
    p, q = (ez - dh * ex) / sigma, (ex + dh * ez) / sigma
    return sigma, p, q, np.sqrt(q * q + side)


@kernel
def narrow(cut: RollingProfileRecord, wheel: Any, h: Any, dh: Any, ddh: Any, search: Any) -> Any:
    """The search after one step more, from the height of the profile at its x and the two derivatives there."""
    phase, steps, x, low, high, first = search
    X, Z, ex, side, _ = wheel
    r, c = cut.radius, cut.crown
    size = (r + c).real
    sigma, p, q, s = inclined(wheel, dh)
    kappa = ddh / (sigma * sigma * sigma)
    steps += 1
    if phase == BRACKETING:
        nx = -dh / sigma
        F = x - X + r * (nx - p * ex) / s + c * nx
        slope = 1.0 - kappa * (c + r * side / (s * s * s))
        if F.real > 0.0:
            high = x.real
        else:
            low = x.real
        new = x - F / slope
        if steps > MAX_PLACE_NEWTON_STEPS or not (slope.real > 0.0 and low <= new.real <= high):
            new = 0.5 * (low + high) + 0.0 * x
        if not abs((new - x).real) > BRACKET_RATIO * size:
            return PROJECTING, steps, new, low, high, new
        return (phase if steps < MAX_SEARCH_STEPS else FAR), steps, new, low, high, new
    f = ((X - x) + dh * (Z - h)) / sigma + r * p * q / s
    distance = ((Z - h) - dh * (X - x)) / sigma - r * s  # Phi + c
    bend = 1.0 - kappa * (distance + r * side / (s * s * s))
    step = f / (sigma * bend)
    new = x + step
    is_near = abs((distance - c).real) < size and abs((new - first).real) < size and bend.real > 0.0
    if not is_near or steps >= MAX_SEARCH_STEPS:
        return FAR, steps, first, low, high, first
    if phase == POLISHING:
        return FOUND, steps, new, low, high, first
    return (POLISHING if abs(step.real) <= PROJECTION_RATIO * size else phase), steps, new, low, high, first


@kernel
def roll_far(
    cut: RollingProfileRecord, A: MotionRecord, B: MotionRecord, wheel: Any, x: Any, profile: Any, row: int,
    state: State,
) -> None:  # fmt: skip
    """Rows of a wheel far from its profile, whose lowest point is above or below that of the profile at x."""
    h, dh, _ = profile
    _, Z, _, _, ez = wheel
    r = cut.radius
    n = arm(A, cut.Ra[:, 2])
    sigma, p, _, s = inclined(wheel, dh)
    lowest = Z - r * (1.0 / sigma - p * ez) / s - cut.crown / sigma
    e = arm(B, cut.Rb[:, 2])
    across = cross3(e, n)
    height = lowest - h + r * np.sqrt(dot3(across, across)) + cut.crown
    above = height * n[0], height * n[1], height * n[2]
    roll(cut, A, B, n, cross3((A.Y[3], A.Y[4], A.Y[5]), n), above, row, state)


@kernel
def roll_at(
    cut: RollingProfileRecord, A: MotionRecord, B: MotionRecord, wheel: Any, x: Any, profile: Any, row: int,
    state: State,
) -> None:  # fmt: skip
    """Rows of a wheel that touches its profile at x, where ``profile`` is the height with its two derivatives."""
    h, dh, ddh = profile
    r = cut.radius
    va, wa = (A.Y[0], A.Y[1], A.Y[2]), (A.Y[3], A.Y[4], A.Y[5])
    vb, wb = (B.Y[0], B.Y[1], B.Y[2]), (B.Y[3], B.Y[4], B.Y[5])
    along, up = arm(A, cut.Ra[:, 0]), arm(A, cut.Ra[:, 2])
    sigma, _, _, s = inclined(wheel, dh)
    tau = add3(along, dh, up)
    tau = tau[0] / sigma, tau[1] / sigma, tau[2] / sigma
    n = add3(up, -dh, along)
    n = n[0] / sigma, n[1] / sigma, n[2] / sigma
    kappa = ddh / (sigma * sigma * sigma)
    e, center = arm(B, cut.Rb[:, 2]), arm(B, cut.Pb)
    apart = B.r[0] - A.r[0], B.r[1] - A.r[1], B.r[2] - A.r[2]
    place = add3(add3(arm(A, cut.Pa), x, along), h, up)  # S - O_a
    above = add3(add3(center, 1.0, apart), -1.0, place)  # Q - S
    turned = cross3(wa, n)  # n' at constant x
    _, _, u, _, du = heading_rates(e, n, cross3(wb, e), turned)
    way = add3(above, r, u)  # tau.way = f
    moving = add3(add3(cross3(wb, center), r, du), -1.0, cross3(wa, place))
    moving = add3(add3(moving, 1.0, vb), -1.0, va)
    rate = dot3(tau, moving) - dot3(tau, cross3(wa, way))
    bend = 1.0 - kappa * (dot3(n, way) + r * wheel[3] / (s * s * s))
    dn = add3(turned, -kappa * rate / bend, tau)  # sigma x' = rate / bend
    roll(cut, A, B, n, dn, above, row, state)


@kernel
def fill_rows(
    cut: RollingProfileRecord, A: MotionRecord, B: MotionRecord, wheel: Any, search: Any, profile: Any, row: int,
    state: State,
) -> None:  # fmt: skip
    """Rows of a wheel with the result of the search of its place, and the height of the profile there."""
    if search[0] == FAR:
        roll_far(cut, A, B, wheel, search[2], profile, row, state)
    else:
        roll_at(cut, A, B, wheel, search[2], profile, row, state)


@kernel
def outline(cut: RollingProfileRecord, wheel: Any, part: int) -> Any:
    """x and z of one of OUTLINE_POINTS points of the lower outline of the wheel, seen along the generators."""
    X, Z, ex, side, ez = wheel
    angle = np.pi * ((part + 0.5) / OUTLINE_POINTS - 0.5)
    nx, nz = np.sin(angle), np.cos(angle)
    p, q = ez * nz + ex * nx, ex * nz - ez * nx
    s = np.sqrt(q * q + side)
    r, c = cut.radius, cut.crown
    return X - r * (nx - p * ex) / s - c * nx, Z - r * (nz - p * ez) / s - c * nz


@kernel
def deeper(at: Any, profile: Any, found: Any) -> Any:
    """The place of ``found`` and the depth of the profile there in the wheel, or those at the point ``at``, if deeper;
    the height of the profile there and its slope are ``profile``.
    """
    h, dh = profile
    depth = (h - at[1]) / np.sqrt(1.0 + dh * dh)
    return (at[0], depth) if depth > found[1] else found


@kernel
def height_of_table(cut: RollingProfileRecord, x: Any, arrays: Arrays) -> Any:
    """Height and its two derivatives."""
    place, beyond = straight(cut, x)
    h, dh, ddh, _ = curve(arrays.numbers, cut.first, cut.count, place)
    return extended(h, dh, ddh, beyond)


@kernel
def evaluate_on_table(
    cut: RollingProfileRecord, A: MotionRecord, B: MotionRecord, row: int, arrays: Arrays, state: State
) -> None:
    """See :mod:`.base`."""
    wheel = locate(cut, A, B)
    search = begin(cut, wheel)
    h, dh, ddh = height_of_table(cut, search[2], arrays)
    while search[0] < FOUND:
        search = narrow(cut, wheel, h, dh, ddh, search)
        h, dh, ddh = height_of_table(cut, search[2], arrays)
    fill_rows(cut, A, B, wheel, search, (h, dh, ddh), row, state)


@kernel
def monitor_on_table(cut: RollingProfileRecord, A: MotionRecord, B: MotionRecord, arrays: Arrays) -> Any:
    """See :mod:`.base`."""
    wheel = locate(cut, A, B)
    search = begin(cut, wheel)
    while search[0] < FOUND:
        h, dh, ddh = height_of_table(cut, search[2], arrays)
        search = narrow(cut, wheel, h, dh, ddh, search)
    found = wheel[0], -np.inf
    for part in range(OUTLINE_POINTS):
        at = outline(cut, wheel, part)
        h, dh, _ = height_of_table(cut, at[0], arrays)
        found = deeper(at, (h, dh), found)
    return search[2], found[0], found[1]


class FunctionKernels(NamedTuple):
    """Kernels of a profile that is a function f(x)."""

    evaluate: Any
    monitor: Any


@cache
def kernels_of_function(f: Any) -> FunctionKernels:
    """Return the kernels of a profile that is a function f(x)."""
    derivatives = law.derivatives

    def height(cut: Any, x: Any) -> Any:
        place, beyond = straight(cut, x)
        h, dh, ddh = derivatives(f, place, cut.width.real)
        return extended(h, dh, ddh, beyond)

    height = jit_uncached(height)

    def evaluate(cut: Any, A: Any, B: Any, row: int, arrays: Any, state: Any) -> None:
        wheel = locate(cut, A, B)
        search = begin(cut, wheel)
        h, dh, ddh = height(cut, search[2])
        while search[0] < FOUND:
            search = narrow(cut, wheel, h, dh, ddh, search)
            h, dh, ddh = height(cut, search[2])
        fill_rows(cut, A, B, wheel, search, (h, dh, ddh), row, state)

    def monitor(cut: Any, A: Any, B: Any, arrays: Any) -> Any:
        wheel = locate(cut, A, B)
        search = begin(cut, wheel)
        while search[0] < FOUND:
            h, dh, ddh = height(cut, search[2])
            search = narrow(cut, wheel, h, dh, ddh, search)
        found = wheel[0], -np.inf
        for part in range(OUTLINE_POINTS):
            at = outline(cut, wheel, part)
            h, dh, _ = height(cut, at[0])
            found = deeper(at, (h, dh), found)
        return search[2], found[0], found[1]

    return FunctionKernels(jit_uncached(evaluate), jit_uncached(monitor))

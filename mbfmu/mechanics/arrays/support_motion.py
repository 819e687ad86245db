"""The motion of a support between the points at which a host prescribes it.

A host sets inputs at communication points; what it sets is meant for the point it stands at, as FMI has it. The
coordinate x of a support never jumps: it is somewhere, x_n, and over the step of length h that follows it goes to where
the host's motion u will be by extrapolation. With the rate v given, and s the time into the step::

    x = x_n + v s + a s^2 / 2 + e (3 (s/h)^2 - 2 (s/h)^3),     e = u_n - x_n
    a_1 = (v_n - v_(n-1)) / H,     a_2 = 2 ((u_n - u_(n-1)) / H - v_(n-1)) / H
    a = minmod(4 a_1 - 3 a_2, 2 a_1, 2 a_2)

H is the step before; 4 a_1 - 3 a_2 is u'' now, of the cubic through both points. The error of x is O(h^3) and that of
x' O(h^2) at the end. The next e corrects it by a motion that begins and ends at rest; in between the error of x'' is
O(h). Where u jumps in position or in rate a_1 and a_2 have nothing in common, and minmod (the smallest of numbers of
one sign, else zero; a limiter after van Leer 1977) leaves out what would overshoot. Where the host gives the mean rate
of the step to come a_2 and a are zero, and x is u interpolated linearly.

Where the host gives the acceleration too it is a, and x has a term j s^3 / 6::

    j = minmod(2 j_1, 2 j_2, (j_1 + j_2) / 2)
    j_1 = (a_n - a_(n-1)) / H,     j_2 = 2 ((v_n - v_(n-1)) / H - a_(n-1)) / H

Then the error of x'', and of the force of the support, is O(h^2) at the end of a step.

Without a rate that of the step is what two differences of u agree in, and what has been missed::

    x = x_n + (r + (u_n - x_n) / h) s,     r = minmod((u_n - u_(n-1)) / H, the same a step before)

A speed that is given alone is v, and a is the acceleration that the host gives with it, or zero.

Kernels take a support, the segment it is on, and the polynomial of its drive, which is where the support is and how
fast it goes. Where the rate jumps between two segments the mechanism gets an impulse, see :mod:`.input_kernels`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.record import Reals, Record, f8, i8

if TYPE_CHECKING:
    from mbfmu.mechanics.signals.polynomial import PolynomialRecord

SPEED_ROUNDING = 1e-15  # relative rounding error of a speed that continues with its acceleration
MAX_EXTRAPOLATION_ERROR_RATIO = 1.5  # error of an extrapolated position to the changes of the rate times the step


class SupportRecord(Record):
    """A joint whose motion an input gives."""

    polynomial: i8  # number of the drive's polynomial
    speed: i8  # 1: the host sets the speed alone, see mbfmu.mechanics.signals.SpeedInput
    position: f8  # u, as the host has given it last, m or rad
    rate: f8  # v, its coefficients
    acceleration: f8  # its coefficients, m/s^2 or rad/s^2
    accelerated: i8  # 1: the host gives accelerations
    given: i8  # 1: a position, or a speed that accelerates, was given since the last point
    rated: i8  # 1: the host gives rates
    departs: i8  # 1: another segment is about to begin,
    jump: f8  # ... where the rate jumps by so much, m/s or rad/s
    size: f8  # unit of the coordinate, m or rad


class SegmentRecord(Record):
    """The motion of a support within one communication step."""

    begin: f8  # s
    end: f8  # s
    path: Annotated[Reals, (4,)]  # coefficients of x in time since the beginning
    goal: f8  # x at the end
    position: f8  # u at the beginning
    rate: f8  # v at the beginning, as the host gave it
    acceleration: f8  # its coefficients
    average: f8  # rate of u over the segment before
    change: f8  # of v since the beginning of the segment before, without sign
    jumps: i8  # 1: u is farther off than the changes of the given rates explain


@inlined
def minmod(a: float, b: float, c: float) -> float:
    """Return the smallest of numbers of one sign; zero where their signs differ."""
    return max(0.0, min(a, b, c)) + min(0.0, max(a, b, c))


@kernel
def start_motion(support: SupportRecord, segment: SegmentRecord, polynomial: PolynomialRecord) -> None:
    """Begin with the polynomial, without a history."""
    x, v = polynomial.c[0], polynomial.c[1]
    support.position, support.rate, support.given, support.departs = x, v, 0, 0
    support.rated = 1 if v != 0.0 else 0
    support.acceleration, segment.acceleration = 2.0 * polynomial.c[2], 2.0 * polynomial.c[2]
    if polynomial.c[2] != 0.0:
        support.accelerated = 1
    segment.begin, segment.end, segment.goal = -np.inf, np.nan, x
    segment.position, segment.rate, segment.average, segment.jumps, segment.change = x, v, 0.0, 0, 0.0
    path = segment.path
    path[0], path[1], path[2], path[3] = x, v, polynomial.c[2], 0.0


@kernel
def set_motion_input(coefficient: int, value: float, support: SupportRecord) -> None:
    """Take a position (coefficient 0), a rate (1) or an acceleration (2) for the point the host stands at."""
    if coefficient == 0:
        support.position, support.given = value, 1
    elif coefficient == 2:
        support.acceleration, support.accelerated = value, 1
    else:
        support.rate = value
        if value != 0.0:
            support.rated = 1


@kernel
def set_motion_rate(rate: float, support: SupportRecord) -> None:
    """Take the time derivative of the position, or of the speed, that was set, if it is no input itself; not a number:
    it is not given.
    """
    is_given = not np.isnan(rate)
    value = rate if is_given else 0.0
    if support.speed == 0:
        support.rate, support.rated = value, 1 if is_given else 0
    elif value != 0.0 or support.acceleration != 0.0:
        support.acceleration, support.given = value, 1


@inlined
def position_and_rate(t: float, segment: SegmentRecord, polynomial: PolynomialRecord) -> tuple[float, float]:
    """Return both at t, before any jump."""
    s, c = t - polynomial.t0, polynomial.c
    x = segment.goal if t == segment.end else c[0] + s * (c[1] + s * (c[2] + s * c[3]))
    return x, c[1] + s * (2.0 * c[2] + s * 3.0 * c[3])


@kernel
def plan_motion(
    t: float,
    end: float,
    support: SupportRecord,
    segment: SegmentRecord,
    polynomial: PolynomialRecord,
    ahead: SegmentRecord,
) -> None:
    """Find the segment ``ahead`` from t to ``end`` (s), and whether the support departs for it.

    It does not in the middle of a segment, nor if it continues unchanged, which is recorded.
    """
    support.departs, support.jump = 0, 0.0
    unchanged = support.rate == segment.rate and support.acceleration == segment.acceleration
    if support.given == 0 and unchanged and t < segment.end and end <= segment.end:
        return
    x, v = position_and_rate(t, segment, polynomial)
    if support.speed == 1 and support.acceleration != 0.0:
        rounding = SPEED_ROUNDING * (abs(v) + abs(support.acceleration) * (end - t))
        if support.given == 0 or abs(support.rate - v) <= rounding:
            support.rate = v  # it continues without a jump
    continue_motion(t, end, x, support, segment, ahead)
    path, c = ahead.path, polynomial.c
    same = path[0] == x and path[1] == v and path[2] == c[2] and path[3] == 0.0 and c[3] == 0.0
    if same and (path[2] == 0.0 or support.speed == 1):
        adopt_segment(ahead, support, segment)
    else:
        support.departs, support.jump = 1, path[1] - v


@kernel
def continue_motion(
    t: float, end: float, x: float, support: SupportRecord, last: SegmentRecord, ahead: SegmentRecord
) -> None:
    """Find the segment ``ahead`` from x at t to ``end``, see the module's docstring; ``last`` is the one before."""
    h, v, before = end - t, support.rate, t - last.begin
    u = support.position if support.given == 1 or support.rated == 0 else x
    path = ahead.path
    path[0], path[1], path[2], path[3] = x, v, 0.0, 0.0
    ahead.begin, ahead.end, ahead.rate, ahead.jumps = t, end, v, 0
    ahead.acceleration, ahead.change = support.acceleration, abs(v - last.rate)
    if support.speed == 1:
        path[2] = 0.5 * support.acceleration
        ahead.goal, ahead.position, ahead.average = x + h * (v + h * path[2]), x, 0.0
        return
    average = (u - last.position) / before if before > 0.0 else last.average
    ahead.position, ahead.average = u, average
    if support.rated == 0 and support.accelerated == 0:
        r = minmod(average, last.average, last.average)
        path[1] = r + (u - x) / h
        ahead.goal = u + r * h
        return
    a, j = support.acceleration, 0.0
    if support.accelerated == 1:
        if 0.0 < before < np.inf:
            j1 = (a - last.acceleration) / before
            j2 = 2.0 * ((v - last.rate) / before - last.acceleration) / before
            j = minmod(2.0 * j1, 2.0 * j2, 0.5 * (j1 + j2))
    elif before > 0.0:
        a1, a2 = (v - last.rate) / before, 2.0 * (average - last.rate) / before
        a = minmod(4.0 * a1 - 3.0 * a2, 2.0 * a1, 2.0 * a2)
    e = u - x
    path[2], path[3] = 0.5 * a + 3.0 * e / (h * h), j / 6.0 - 2.0 * e / (h * h * h)
    ahead.goal = u + h * (v + h * (0.5 * a + j * h / 6.0))
    longest = max(h, before) if before < np.inf else h
    explained = MAX_EXTRAPOLATION_ERROR_RATIO * longest * (ahead.change + last.change)
    ahead.jumps = 1 if abs(e) > explained else 0


@inlined
def adopt_segment(ahead: SegmentRecord, support: SupportRecord, segment: SegmentRecord) -> None:
    """Note that a segment has begun."""
    segment.begin, segment.end, segment.goal = ahead.begin, ahead.end, ahead.goal
    segment.position, segment.rate, segment.average = ahead.position, ahead.rate, ahead.average
    segment.acceleration, segment.change = ahead.acceleration, ahead.change
    segment.jumps = ahead.jumps
    for k in range(4):
        segment.path[k] = ahead.path[k]
    support.position, support.given = ahead.position, 0


@inlined
def follow_path(t: float, path: Reals, polynomial: PolynomialRecord) -> None:
    """Let the polynomial be that of ``path`` (4,) about t."""
    polynomial.t0 = t
    for k in range(4):
        polynomial.c[k] = path[k]


@kernel
def perturb_motion(t: float, acceleration: float, segment: SegmentRecord, polynomial: PolynomialRecord) -> None:
    """Let the polynomial have an acceleration at t, and the position and rate it has there."""
    x, v = position_and_rate(t, segment, polynomial)
    c = polynomial.c
    polynomial.t0, c[0], c[1], c[2], c[3] = t, x, v, 0.5 * acceleration, 0.0


@kernel
def motion_finished(support: SupportRecord, segment: SegmentRecord) -> bool:
    """Whether the motion continues unchanged until the importing tool sets another."""
    path = segment.path
    arrived = path[1] == 0.0 and segment.goal == support.position
    if not arrived and support.speed == 0 and support.rated == 0:
        return False
    still = path[2] == 0.0 and path[3] == 0.0 and support.acceleration == segment.acceleration
    return still and support.given == 0 and support.rate == segment.rate

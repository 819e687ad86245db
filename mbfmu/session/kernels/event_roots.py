"""Extrema and roots of a sensor between points of a step: kernels of :mod:`.event_search`.

The rows of ``points`` that they use are those of :mod:`.event_points`.
"""

from __future__ import annotations

import numpy as np

from solvers.compiled.kernel import kernel

from .event_points import BEGIN, EXTREMA, HERE, RIGHT, TIME, VALUES, A, B, C, EventSearch, copy_point

MAX_ROOT_ITERATIONS = 100  # of the search for a root; bisection alone needs 60
MIN_BRACKET_RATIO = 1e-3  # of the values of a bracket, else bisection: the first may be the crossing before
MAX_EXTREMUM_ITERATIONS, MAX_MINIMUM_ITERATIONS = 6, 20  # by values; by values and rates
MAX_EXTREMUM_RATIO = 0.3  # of the values of three points: a parabola with a larger least value does not reach zero


@kernel
def first_extremum(search: EventSearch) -> int:
    """Take the earliest extremum between LEFT and RIGHT off the list and return its row; -1: there is none."""
    found, count = -1, search.sides.shape[0]
    for k in range(2 * count):
        row = EXTREMA + k
        if search.has_extremum[k] == 1 and (found < 0 or search.points[row, TIME] < search.points[found, TIME]):
            found = row
    if found >= 0:
        search.has_extremum[found - EXTREMA] = 0
    return found


@kernel
def begin_extremum(search: EventSearch, first: int, second: int, third: int) -> None:
    """Begin the search for an extremum with two points, or three that ascend."""
    search.control[0].iterations = 0
    copy_point(search, first, A)
    copy_point(search, second, B)
    copy_point(search, third, C)


@kernel
def next_minimum_time(search: EventSearch, k: int) -> float:
    """Time between A and B at which sensor k may have another sign than in both, by its rates, s; nan: none.

    There is a minimum between them if the rates are of different signs; it is not below the intersection of the
    tangents, if the curve is convex. The intersection, which finds the tip of a distance, and the minimum of the
    cubic through values and rates (Nocedal and Wright, *Numerical Optimization*, 2006, eq. 3.59) are tried by turns.
    """
    control, points, count = search.control[0], search.points, search.sides.shape[0]
    value, rate = VALUES + k, VALUES + count + k
    side = np.sign(points[B, value])
    ga, gb, h = side * points[A, value], side * points[B, value], points[B, TIME] - points[A, TIME]
    ra, rb = side * points[A, rate], side * points[B, rate]
    if control.iterations >= MAX_MINIMUM_ITERATIONS or not (min(ga, gb) >= 0.0 and ra < 0.0 < rb):
        return np.nan
    x = (gb - ga - rb * h) / ((ra - rb) * h)
    if ga + ra * x * h > 0.0:
        return np.nan
    if control.iterations % 2 == 1:
        d = ra + rb - 3.0 * (gb - ga) / h
        e = np.sqrt(d * d - ra * rb)
        x = 1.0 - (rb + e - d) / (rb - ra + 2.0 * e)
    if not min(x, 1.0 - x) * h > control.min_width:
        return np.nan
    return float(points[A, TIME] + x * h)


@kernel
def take_minimum(search: EventSearch, k: int) -> bool:
    """Replace A or B by HERE, so that the minimum remains between them; True: HERE has another sign than both."""
    points, count = search.points, search.sides.shape[0]
    side = np.sign(points[B, VALUES + k])
    if not side * points[HERE, VALUES + k] > 0.0:
        return True
    search.control[0].iterations += 1
    copy_point(search, HERE, A if side * points[HERE, VALUES + count + k] < 0.0 else B)
    return False


@kernel
def next_vertex_time(search: EventSearch, k: int) -> float:
    """Time between A and C at which sensor k may have another sign than in A, B and C, by a parabola, s; nan: none."""
    control, points = search.control[0], search.points
    t0, t1, t2 = points[A, TIME], points[B, TIME], points[C, TIME]
    side = np.sign(points[B, VALUES + k])
    g0, g1, g2 = side * points[A, VALUES + k], side * points[B, VALUES + k], side * points[C, VALUES + k]
    if control.iterations >= MAX_EXTREMUM_ITERATIONS or not min(g0, g1, g2) > 0.0:
        return np.nan
    left, right = (g1 - g0) / (t1 - t0), (g2 - g1) / (t2 - t1)
    bend = (right - left) / (t2 - t0)
    if not bend > 0.0:
        return np.nan
    t = 0.5 * (t0 + t1 - left / bend)
    least = g0 + left * (t - t0) + bend * (t - t0) * (t - t1)
    spread = max(g0, g1, g2) - min(g0, g1, g2, least)
    if not max(t0, points[BEGIN, TIME]) < t < t2 or least > MAX_EXTREMUM_RATIO * spread:
        return np.nan
    if min(abs(t - t0), abs(t - t1), abs(t - t2)) <= control.min_width:
        return np.nan
    return float(t)


@kernel
def take_vertex(search: EventSearch, k: int) -> bool:
    """Let HERE be one of A, B and C in place of the farthest of them; True: it has another sign than all of them."""
    points = search.points
    side, t = np.sign(points[B, VALUES + k]), points[HERE, TIME]
    if not side * points[HERE, VALUES + k] > 0.0:
        return True
    search.control[0].iterations += 1
    drops_first = t - points[A, TIME] > points[C, TIME] - t
    if t < points[B, TIME]:
        if drops_first:
            copy_point(search, HERE, A)
        else:
            copy_point(search, B, C)
            copy_point(search, HERE, B)
    elif drops_first:
        copy_point(search, B, A)
        copy_point(search, HERE, B)
    else:
        copy_point(search, HERE, C)
    return False


@kernel
def keep_extremum(search: EventSearch, k: int, place: int) -> None:
    """Put HERE on the list of extrema of sensor k: at ``place`` of its three rows, or in the next interval if it is
    there.
    """
    count = search.sides.shape[0]
    own = 2 if search.points[HERE, TIME] > search.points[RIGHT, TIME] else place
    search.has_extremum[own * count + k] = 1
    copy_point(search, HERE, EXTREMA + own * count + k)


@kernel
def begin_root(search: EventSearch, k: int, row: int, after: int) -> bool:
    """Begin the search for the crossing of sensor k between two points; False: it is at any time between them."""
    control, points = search.control[0], search.points
    copy_point(search, row, A)
    copy_point(search, after, B)
    control.low, control.high = points[A, VALUES + k], points[B, VALUES + k]
    control.iterations, control.kept = 0, 0
    return bool(np.sign(control.low) != np.sign(control.high))


@kernel
def next_root_time(search: EventSearch) -> float:
    """Next time between A and B, s; nan: the bracket is narrow enough."""
    control, a, b = search.control[0], search.points[A, TIME], search.points[B, TIME]
    if control.iterations >= MAX_ROOT_ITERATIONS or b - a <= control.min_width:
        return np.nan
    halves = control.iterations % 3 == 2 or abs(control.low) < MIN_BRACKET_RATIO * abs(control.high)
    t = 0.5 * (a + b) if halves else b - control.high * (b - a) / (control.high - control.low)
    margin = 0.5 * control.min_width  # so that the bracket closes from both sides
    return float(min(max(t, a + margin), b - margin))


@kernel
def take_root(search: EventSearch, k: int) -> None:
    """Replace an end of the bracket of sensor k by HERE."""
    control, value, at_end = search.control[0], search.points[HERE, VALUES + k], search.points[B, VALUES + k]
    control.iterations += 1
    if np.sign(value) == np.sign(at_end):
        copy_point(search, HERE, B)
        control.high = value
        control.low *= 0.5 if control.kept == 1 else 1.0
        control.kept = 1
    else:
        copy_point(search, HERE, A)
        control.low = value
        control.high *= 0.5 if control.kept == -1 else 1.0
        control.kept = -1


@kernel
def note_bracket(search: EventSearch, k: int) -> None:
    """Note the bracket of the crossing of sensor k."""
    search.brackets[k, 0], search.brackets[k, 1] = search.points[A, TIME], search.points[B, TIME]

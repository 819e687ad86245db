"""Deflection of a bristle that is drawn along an arc in the plane of the surface.

A bristle of the deflection d is an anchor that a point draws behind it. While |e| < d, e' = v; at |e| = d only the
part of v perpendicular to e changes it. Along a straight line the anchor moves on a tractrix. In a step the point moves
along a curve, whose chord and end velocity are given. The curve is taken to be an arc of a circle, whose direction
changes in proportion to the path, from the angle -tau to tau relative to the chord. The angle delta of the bristle from
this direction, over the path s in deflections, and the turn k = 2 tau / L per path for a chord L, satisfy

    d delta / d s = -sin delta - k.

With delta = 2 arctan(y / x) this is linear,

    d (x, y) / d s = M (x, y),    M = 1/2 ((1, k), (-k, -1)),    M^2 = w^2 I,    w = sqrt(1 - k^2) / 2,

so that exp(M s) = cosh(w s) I + sinh(w s) / w M. The error of the direction is of the second order in the step, also if
the path is much longer than d.

``sin tau`` is used for tau: both agree to second order, and the sine is continuous where the velocity reverses.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers.compiled.kernel import inlined, kernel

MIN_END_SPEED_RATIO = 0.1  # of the mean speed: the direction of a slower end velocity counts in proportion to it
EDGE_ROUNDING = 1e-12  # of 1 - |e|^2 of a bristle that is fully deflected
MIN_SERIES_ARGUMENT = 1e-7  # of |w s|^2, below which sinh(w s) / w is evaluated by its series
MAX_TANH_ARGUMENT = 30.0  # beyond which tanh is 1; its complex function overflows


@kernel
def draw_bristle(e: Any, moved: Any, velocity: Any, taken: float) -> Any:
    """Deflection over d at the end of a path.

    Parameters
    ----------
    e, moved
        Deflection at its beginning, of magnitude 1 at most, and chord of the path, both over d. Like all vectors here
        they are pairs of components in the plane of the surface, real or complex.
    velocity
        Of the point at the end of the path, over d, 1/s.
    taken
        Time in which the point moved, s.
    """
    x, y = e[0] + moved[0], e[1] + moved[1]
    square, way = x * x + y * y, moved[0] * moved[0] + moved[1] * moved[1]
    if square.real <= 1.0:
        return x, y
    if way.real == 0.0 or taken <= 0.0:
        size = np.sqrt(square)
        return x / size, y / size
    chord = np.sqrt(way)
    along, across = moved[0] / chord, moved[1] / chord
    ahead, aside = e[0] * along + e[1] * across, e[1] * along - e[0] * across
    turn = turn_of_path(along, across, chord, velocity, taken)
    rest = 1.0 - ahead * ahead - aside * aside  # the part of the chord before |e| = d
    if rest.real <= EDGE_ROUNDING:
        edge = ahead if ahead.real >= 0.0 else -ahead
    else:
        edge = np.sqrt(rest + ahead * ahead)
    free = edge - ahead
    ahead, aside = draw_along_arc(edge, aside, chord - free, free, turn, chord)
    return ahead * along - aside * across, aside * along + ahead * across


@inlined
def turn_of_path(along: Any, across: Any, chord: Any, velocity: Any, taken: float) -> Any:
    """Sine of the angle from the chord, whose direction is (along, across), to the velocity at the end of the path."""
    sideways, speed = velocity[1] * along - velocity[0] * across, velocity[0] ** 2 + velocity[1] ** 2
    least = MIN_END_SPEED_RATIO * chord / taken
    if speed.real > (least * least).real:
        return sideways / np.sqrt(speed)
    return sideways / least


@inlined
def draw_along_arc(x: Any, y: Any, path: Any, before: Any, turn: Any, chord: Any) -> Any:
    """Unit vector (x, y) of a bristle after ``path`` along an arc that turns by 2 ``turn`` on the length ``chord``, of
    which ``before`` has passed; lengths over d, components along the chord and across.
    """
    k = 2.0 * turn / chord
    first = k * before - turn
    c, s = np.cos(first), np.sin(first)
    x, y = x * c + y * s, y * c - x * s
    if x.real >= 0.0:  # half of the angle, up to a factor
        a, b = 1.0 + x, y
    else:
        a, b = y, 1.0 - x
    cosine, sine = exponential_parts(0.25 * (1.0 - k * k), path)
    sine *= 0.5
    a, b = a * (cosine + sine) + b * k * sine, b * (cosine - sine) - a * k * sine
    size = a * a + b * b
    x, y = (a * a - b * b) / size, 2.0 * a * b / size
    c, s = np.cos(turn), np.sin(turn)
    return x * c - y * s, y * c + x * s


@inlined
def exponential_parts(square: Any, path: Any) -> Any:
    """Return cosh(w s) and sinh(w s) / w for w^2 = ``square`` and the path s, up to a common factor."""
    argument = square * path * path
    if abs(argument.real) < MIN_SERIES_ARGUMENT:
        return 1.0 + argument / 2.0, path * (1.0 + argument / 6.0)
    if square.real > 0.0:
        w = np.sqrt(square)
        if (w * path).real > MAX_TANH_ARGUMENT:
            return 1.0 + 0.0 * w, 1.0 / w
        return 1.0 + 0.0 * w, np.tanh(w * path) / w
    w = np.sqrt(-square)
    return np.cos(w * path), np.sin(w * path) / w

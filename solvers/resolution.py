"""What floating-point numbers resolve: times, positions, and rates of a motion as the measure of both."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .compiled.kernel import inlined, kernel
from .diagnostics import Diagnostic
from .system import Array

if TYPE_CHECKING:
    from solvers.compiled.record import Reals

MAX_SPACING_IN_TOLERANCES = 0.1  # largest spacing of floating-point numbers at an initial position
SPACING_FACTOR = 2.0**-53 * (1.0 + 2.0**-52)  # of a number, which it is less than one step away from
UNRESOLVED_TIME, RESOLVED = -2, -1  # results of find_unresolved
DISCONTINUITY_STEP_RATIO = 1e-8  # of the time: signals shorten steps so much only at jumps
MIN_RATE_PER_DURATION = 0.1  # least rate of a motion, in units of one over the duration of the run


@inlined
def spacing(x: float) -> float:
    """How far the next floating-point number is from x."""
    return (abs(x) + SPACING_FACTOR * abs(x)) - abs(x)


@kernel
def find_unresolved(t: float, rate: float, q: Reals, size: Any, rtol: float) -> int:
    """Return UNRESOLVED_TIME if the floating-point numbers near t (s) are too far apart for a motion of ``rate`` (1/s),
    else the position of q (nq,) that they resolve worst to the tolerance, in units of ``size``; RESOLVED: none is.
    """
    if not spacing(t) * rate <= rtol:
        return UNRESOLVED_TIME
    worst, most = RESOLVED, MAX_SPACING_IN_TOLERANCES * rtol
    for k in range(q.shape[0]):
        apart = spacing(q[k]) / size[k]
        if not apart <= most:
            worst, most = k, apart
    return worst


class ResolutionError(ValueError):
    """Floating-point numbers do not resolve the start of a run: its time, or a position."""

    def __init__(self, diagnostic: Diagnostic, of_time: bool) -> None:
        super().__init__(diagnostic)
        self.of_time = of_time


def require_resolution(t0: float, rate: float, q: Array, size: Array, rtol: float, names: tuple[str, ...] = ()) -> None:
    """Raise ResolutionError if floating-point numbers do not resolve the start time ``t0`` (s) and positions q (nq,).

    See :func:`find_unresolved`; ``names`` are those of the coordinates.
    """
    k = find_unresolved(t0, rate, q, size, rtol)
    if k == UNRESOLVED_TIME:
        raise ResolutionError(
            Diagnostic.error(
                "clock-resolution",
                f"t0 is {t0:g} s, where the spacing of floating-point numbers is {spacing(t0):.1e} s; in that time the "
                f"motion changes by more than the tolerance of {rtol:g}",
                "Use a start time nearer to zero",
                time=t0,
            ),
            of_time=True,
        )
    if k != RESOLVED:
        name = f"coordinate {names[k]!r}" if len(names) == len(q) else f"position {k}"
        raise ResolutionError(
            Diagnostic.error(
                "clock-resolution",
                f"{name} starts at {q[k]:g}, where the spacing of floating-point numbers is "
                f"{spacing(q[k]):.1e}; this is too coarse for a tolerance of {rtol:g}",
                "Start nearer to zero (an angle minus a multiple of 2 pi is the same position)",
                subject=names[k] if len(names) == len(q) else "",
            ),
            of_time=False,
        )


@inlined
def coordinate_rate(size: float, v: float, a: float) -> float:
    """Characteristic rate of a coordinate of this size at velocity v and acceleration a, 1/s."""
    return max(abs(v / size), np.sqrt(abs(a / size)))


@kernel
def start_rate(known: float, duration: float, size: Array, v: Array, a: Array) -> float:
    """Rate of a motion that starts with rates v and accelerations a (n,), in units ``size``, 1/s.

    It is the largest of ``known`` (1/s, of gravity and drives), the rates of all coordinates, and MIN_RATE_PER_DURATION
    over the ``duration`` of the run (s). The last bounds it: of a start at rest, accelerations are rounding errors, and
    a motion that is slower than that moves by less than its own unit in the whole run.
    """
    rate = max(known, MIN_RATE_PER_DURATION / duration)
    for k in range(v.shape[0]):
        rate = max(rate, coordinate_rate(size[k], v[k], a[k]))
    return rate


@inlined
def min_step_length(part: float, rate: float, max_step: float, t: float) -> float:
    """Length of a step that is too short at time t, s: ``part`` of t, or of the time in which the motion of ``rate``
    (1/s) or what varies with time (``max_step``, s) changes.
    """
    return part * max(min(1.0 / rate, max_step), abs(t))


@inlined
def is_discontinuity(longest: float, t: float) -> bool:
    """Whether no signal allows a longer step at time t, s, because of a jump: steps that end beyond it are accepted
    with any error if they are as short as :func:`min_step_length`.
    """
    return longest <= DISCONTINUITY_STEP_RATIO * abs(t)

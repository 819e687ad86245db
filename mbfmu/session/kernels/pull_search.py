"""Location of the first time at which a stop that holds its sensor would pull, in the steps of any solver.

The least force of the stops that hold is evaluated at points of every step, and at the lowest point of the parabola
through three of them. The time at which it becomes negative is located by the Illinois variant of the rule of false
position (Dowell and Jarratt, *BIT* 11, 1971, 168-174).

As in :mod:`.event_search` the functions run over a run of any solver: compiled in native FMUs, interpreted in Python.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from solvers.compiled.kernel import kernel
from solvers.outcome import MAX_STEPS, OK
from solvers.resolution import spacing

from .event_points import (
    MAX_MOTION,
    MAX_POINTS_PER_STEP,
    POINTS_PER_STEP,
    TIME_ACCURACY_RATIO,
    EventSearch,
    clear_found,
    code_of,
    is_any_found,
    is_time,
    limit_next_step,
    longest_gap,
    note_code,
)

if TYPE_CHECKING:
    from solvers.compiled.record import Reals

    from .event_search import Search, StepActions

F = TypeVar("F", bound=Callable[..., Any])

MAX_ROOT_ITERATIONS = 100  # bisection alone needs 60


@kernel
def count_intervals(search: EventSearch, duration: float, v: Reals) -> int:
    """Number of intervals into which a step that lasts ``duration``, s, is divided, at velocities v (n,) at its end."""
    speed = 0.0
    for i in range(search.size.shape[0]):
        speed = max(speed, abs(v[i]) / search.size[i])
    wanted = max(float(POINTS_PER_STEP), duration * speed / MAX_MOTION, duration / search.control[0].within)
    return int(np.ceil(min(wanted, float(MAX_POINTS_PER_STEP))))


@kernel
def lowest_time(t0: float, f0: float, t1: float, f1: float, t2: float, f2: float) -> float:
    """Time of the lowest point of the parabola through three points (time, value); nan: it is positive there, not
    between them, or a point is not known.
    """
    if not (min(f0, f1, f2) >= 0.0 and t0 < t1 < t2):
        return np.nan
    left, right = (f1 - f0) / (t1 - t0), (f2 - f1) / (t2 - t1)
    bend = (right - left) / (t2 - t0)
    if not bend > 0.0:
        return np.nan
    t = 0.5 * (t0 + t1 - left / bend)
    least = f0 + left * (t - t0) + bend * (t - t0) * (t - t1)
    is_low = t0 < t < t2 and t != t1 and least < 0.3 * max(f0, f1, f2)
    return float(t) if is_low else np.nan


@kernel
def bracket_width(begin: float, end: float, t: float, rtol: float) -> float:
    """Width, s, of a bracket that ends at t, s, in the step from ``begin`` to ``end``, s, that is located."""
    return float(max(4.0 * spacing(t), TIME_ACCURACY_RATIO * rtol * (end - begin)))


@kernel
def next_pull_time(t0: float, f0: float, t1: float, f1: float, width: float) -> float:
    """Next time in a bracket of the rule of false position, s, at least half of the width from its ends."""
    t = t0 + (t1 - t0) * f0 / (f0 - f1)
    return float(min(max(t, t0 + 0.5 * width), t1 - 0.5 * width))


@kernel
def keep_sides(search: EventSearch) -> None:
    """Keep the sides and bands of the sensors at the begin of a step."""
    for k in range(search.sides.shape[0]):
        search.first_sides[k], search.first_bands[k] = search.sides[k], search.bands[k]


@kernel
def return_sides(search: EventSearch) -> None:
    """Let sides and bands be those at the begin of the step; the step ends before the crossings that were found."""
    for k in range(search.sides.shape[0]):
        search.sides[k], search.bands[k] = search.first_sides[k], search.first_bands[k]
    clear_found(search)


def _unchanged(function: F) -> F:
    return function


def pull_search_of(
    actions: StepActions, search: Search, least: Callable[..., float], compiled: Callable[[F], F] = _unchanged
) -> Callable[..., int]:
    """Return the search for the first time at which a stop would pull.

    Parameters
    ----------
    actions, search
        Actions of a solver, and its search for the crossings of sensors.
    least
        (run) -> N or N m: the least force of a stop that holds at the reported state.
    compiled
        Compiles a function that others call.

    Returns
    -------
    callable
        (run, end) -> code: advance to the first crossing, the first time at which a stop would pull, or to ``end``, s.
    """
    _, report, return_to_end, is_dense, tolerance, max_steps = actions
    begin_search: Any = compiled(search.begin)  # type: ignore[arg-type]
    step: Any = compiled(search.step)  # type: ignore[arg-type]

    def least_at(run: Any, t: float) -> float:
        if run.clock[0] != t:
            note_code(run.search, report(run, t))
        return least(run)

    at: Any = compiled(least_at)  # type: ignore[arg-type]

    def report_last_end(run: Any, t: float) -> None:
        """Let the reported state be that of t, s, again, up to which the last step was examined."""
        if run.clock[0] == t:
            return
        if is_any_found(run.search):
            note_code(run.search, report(run, t))
        else:
            note_code(run.search, return_to_end(run, t))

    report_again: Any = compiled(report_last_end)  # type: ignore[arg-type]

    def locate_between(run: Any, t0: float, f0: float, t1: float, f1: float, width: float) -> float:
        if f0 < 0.0:  # it pulls from the begin of the step on
            return t0
        kept, count = 0, 0
        while t1 - t0 > width and count < MAX_ROOT_ITERATIONS:
            count += 1
            t = next_pull_time(t0, f0, t1, f1, width)
            f = at(run, t)
            if f < 0.0:
                t1, f1, f0 = t, f, 0.5 * f0 if kept == 1 else f0
                kept = 1
            else:
                t0, f0, f1 = t, f, 0.5 * f1 if kept == -1 else f1
                kept = -1
        return t1

    locate: Any = compiled(locate_between)  # type: ignore[arg-type]

    def find_first_pull(run: Any, begin: float, force: float, ahead: float) -> float:
        """Return the first time of the step from ``begin``, s, to the reported state at which the least force is
        negative, nan if there is none; it is ``force`` at the begin and ``ahead`` at the end.
        """
        end = run.clock[0]
        count = count_intervals(run.search, end - begin, run.v)
        ta, fa, tb, fb = float("nan"), 0.0, begin, force
        for i in range(1, count + 1):
            tc = end if i == count else begin + (end - begin) * i / count
            fc = ahead if i == count else at(run, tc)
            if fc < 0.0:
                return float(locate(run, tb, fb, tc, fc, bracket_width(begin, end, tc, tolerance(run))))
            t = lowest_time(ta, fa, tb, fb, tc, fc)
            if is_time(t):
                f = at(run, t)
                if f < 0.0:
                    first, value = (tb, fb) if t > tb else (ta, fa)
                    return float(locate(run, first, value, t, f, bracket_width(begin, end, t, tolerance(run))))
                if t > tb:
                    tb, fb = t, f
            ta, fa, tb, fb = tb, fb, tc, fc
        report_again(run, end)
        return float("nan")

    find_pull: Any = compiled(find_first_pull)  # type: ignore[arg-type]

    def advance(run: Any, end: float) -> int:
        begin_search(run)
        taken, force = 0, least(run)
        while run.clock[0] < end and not is_any_found(run.search):
            if taken >= max_steps(run):
                return MAX_STEPS
            begin = run.clock[0]
            keep_sides(run.search)
            target = end if is_dense(run) else min(end, begin + longest_gap(run.search))
            code: int = step(run, target, limit_next_step(run.search))
            if code != OK:
                return code
            ahead = least(run)
            t = find_pull(run, begin, force, ahead)
            if is_time(t):
                if run.clock[0] != t:
                    note_code(run.search, report(run, t))
                return_sides(run.search)
            code = code_of(run.search)
            if code != OK or is_time(t):
                return code
            force = ahead
            taken += 1
        return OK

    return advance

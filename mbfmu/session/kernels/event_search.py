"""Location of events: the first time at which a sensor crosses a value, in the steps of any solver.

After every step the sensors are evaluated at points of the solver's dense output, between which no coordinate moves
far, and where the values between the points may have an extremum, by their rates or by their values. A change of sign
is located by the Illinois variant of the rule of false position (Dowell and Jarratt, *BIT* 11, 1971, 168-174). The time
that is reported is the end of the bracket at which the sign has changed, so that the motion continues on the other
side. At a stop it is the other end: there the motion returns to the side that it comes from, and a value beyond the
stop is a crossing at any time.

A step without dense output is repeated from its beginning to the time that is examined.

As in :mod:`.sequence` the functions run over a *run* of any solver. In native FMUs they are compiled together with the
actions of the solver; in Python they are interpreted, and call actions and kernels only.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, TypeVar

from solvers.outcome import MAX_STEPS, OK

from .event_points import (
    BEGIN,
    END,
    FIRST,
    HERE,
    LEFT,
    NEXT,
    RIGHT,
    begin_search,
    begin_step,
    choose_crossing,
    clear_found,
    code_of,
    copy_point,
    count_sensors,
    end_step,
    fill_point,
    has_any_crossed,
    has_crossed,
    has_earlier_point,
    is_any_found,
    is_rate_known,
    is_time,
    limit_next_step,
    longest_gap,
    mark_crossed,
    note_code,
    note_sides,
    point_time,
    shift_points,
    time_of,
)
from .event_roots import (
    begin_extremum,
    begin_root,
    first_extremum,
    keep_extremum,
    next_minimum_time,
    next_root_time,
    next_vertex_time,
    note_bracket,
    take_minimum,
    take_root,
    take_vertex,
)
from .sequence import Run

F = TypeVar("F", bound=Callable[..., Any])


class SearchedRun(Run, Protocol):
    """What the functions read of a run in addition."""

    search: Any  # .event_points.EventSearch, pinned


class StepActions(NamedTuple):
    """What a solver does in the search for events. Codes are those of :mod:`solvers.outcome`."""

    # (run, end, longest) -> code: advance by at most one step of at most ``longest`` (s) towards ``end`` (s), and keep
    # what reports within it need
    take_step: Callable[..., int]
    report: Callable[..., int]  # (run, t) -> code: let the reported state be that of a time t (s) of the last step
    return_to_end: Callable[..., int]  # (run, t) -> code: let it be that of the end of this step, t (s), again
    is_dense: Callable[..., bool]  # (run): whether ``report`` needs no steps
    tolerance: Callable[..., float]  # (run): relative tolerance
    max_steps: Callable[..., int]  # (run): largest number of steps to one time


class Search(NamedTuple):
    """The search for events. All functions take a run first; the sensors that cross are marked in its search."""

    begin: Callable[..., Any]  # (run): note the sides at the reported state, at which nothing is a crossing
    step: Callable[..., int]  # (run, end, longest) -> code: as ``advance``, by at most one step
    advance: Callable[..., int]  # (run, end) -> code: advance to the first crossing before or at ``end``, s, or to it
    has_found: Callable[..., bool]  # (run): whether the last advance has ended at a crossing
    find_jumped: Callable[..., bool]  # (run): whether a jump of the reported state since ``begin`` is a crossing


def _unchanged(function: F) -> F:
    return function


def search_of(actions: StepActions, compiled: Callable[[F], F] = _unchanged) -> Search:
    """Return the search for events in runs of a solver; ``compiled`` compiles a function that others call."""
    take_step, report, return_to_end, is_dense, tolerance, max_steps = actions

    def evaluate_reported(run: Any, row: int) -> None:
        fill_point(run.search, run.session, run.clock[0], run.q, run.v, row)

    evaluate: Any = compiled(evaluate_reported)  # type: ignore[arg-type]

    def evaluate_at(run: Any, t: float) -> None:
        if run.clock[0] != t:
            note_code(run.search, report(run, t))
        evaluate(run, HERE)

    at: Any = compiled(evaluate_at)  # type: ignore[arg-type]

    def find_minimum_between(run: Any, k: int) -> None:
        begin_extremum(run.search, LEFT, RIGHT, RIGHT)
        t = next_minimum_time(run.search, k)
        while is_time(t):
            at(run, t)
            if take_minimum(run.search, k):
                keep_extremum(run.search, k, 1)
                return
            t = next_minimum_time(run.search, k)

    find_minimum: Any = compiled(find_minimum_between)  # type: ignore[arg-type]

    def find_vertex_between(run: Any, k: int, first: int, second: int, third: int, place: int) -> None:
        begin_extremum(run.search, first, second, third)
        t = next_vertex_time(run.search, k)
        while is_time(t):
            at(run, t)
            if take_vertex(run.search, k):
                keep_extremum(run.search, k, place)
                return
            t = next_vertex_time(run.search, k)

    find_vertex: Any = compiled(find_vertex_between)  # type: ignore[arg-type]

    def locate_crossing(run: Any, k: int, before: int, after: int) -> None:
        if begin_root(run.search, k, before, after):
            t = next_root_time(run.search)
            while is_time(t):
                at(run, t)
                take_root(run.search, k)
                t = next_root_time(run.search)
        note_bracket(run.search, k)

    locate: Any = compiled(locate_crossing)  # type: ignore[arg-type]

    def examine_interval(run: Any, before: int, after: int) -> bool:
        """Whether a sensor crosses its value between two points; it is the reported state then."""
        search = run.search
        if not has_any_crossed(search, after):
            note_sides(search, after)
            return False
        for k in range(count_sensors(search)):
            if has_crossed(search, after, k):
                locate(run, k, before, after)
        at(run, choose_crossing(search, after))
        return bool(mark_crossed(search))

    examine: Any = compiled(examine_interval)  # type: ignore[arg-type]

    def find_extrema_between(run: Any, is_first: bool, is_last: bool) -> None:
        """Put the extrema between LEFT and RIGHT on the list."""
        search = run.search
        for k in range(count_sensors(search)):
            if is_rate_known(search, k):
                find_minimum(run, k)
                continue
            if is_first and has_earlier_point(search):
                find_vertex(run, k, FIRST, LEFT, RIGHT, 0)
            if not is_last:
                find_vertex(run, k, LEFT, RIGHT, NEXT, 1)

    find_extrema: Any = compiled(find_extrema_between)  # type: ignore[arg-type]

    def examine_last_step(run: Any) -> bool:
        """Whether a sensor crosses its value in the step from BEGIN to END; the first crossing is the reported state
        then, else the end is.
        """
        search = run.search
        count = begin_step(search, tolerance(run), is_dense(run))
        end = time_of(search, END)
        for i in range(count):
            for ahead in range(i + 1, i + 3):  # RIGHT in the first interval only, then NEXT
                if ahead > count or (ahead == i + 1 and i > 0):
                    continue
                if ahead < count:
                    at(run, point_time(search, ahead, count))
                copy_point(search, HERE if ahead < count else END, RIGHT if ahead == i + 1 else NEXT)
            find_extrema(run, i == 0, i == count - 1)
            before, row = LEFT, first_extremum(search)
            while row >= 0:
                if examine(run, before, row):
                    return True
                before, row = row, first_extremum(search)
            if examine(run, before, RIGHT):
                return True
            shift_points(search)
        if run.clock[0] != end:
            note_code(search, return_to_end(run, end))
        return False

    examine_step: Any = compiled(examine_last_step)  # type: ignore[arg-type]

    def begin_at_state(run: Any) -> int:
        evaluate(run, BEGIN)
        begin_search(run.search)
        return OK

    begin: Any = compiled(begin_at_state)  # type: ignore[arg-type]

    def step_once(run: Any, end: float, longest: float) -> int:
        code: int = take_step(run, end, longest)
        if code != OK:
            return code
        evaluate(run, END)
        if not examine_step(run):
            end_step(run.search)
        found: int = code_of(run.search)
        return found

    step: Any = compiled(step_once)  # type: ignore[arg-type]

    def has_found(run: Any) -> bool:
        return bool(is_any_found(run.search))

    is_found: Any = compiled(has_found)  # type: ignore[arg-type]

    def advance(run: Any, end: float) -> int:
        begin(run)
        taken = 0
        while run.clock[0] < end and not is_found(run):
            if taken >= max_steps(run):
                return MAX_STEPS
            target = end if is_dense(run) else min(end, run.clock[0] + longest_gap(run.search))
            code: int = step(run, target, limit_next_step(run.search))
            if code != OK:
                return code
            taken += 1
        return OK

    def find_jumped(run: Any) -> bool:
        evaluate(run, HERE)
        clear_found(run.search)
        return bool(mark_crossed(run.search))

    return Search(begin_at_state, step_once, advance, has_found, find_jumped)

"""Sensors of events at points of a step, and the choice of the next point: kernels of :mod:`.event_search`.

A point is a row of ``points``: its time, the largest rate of a coordinate in its unit, the sensors minus the values
that they may cross (k,), and the rates of the sensors (k,), nan where they are not known.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.recursions.dynamics import watch_sensors
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, f8, i8
from solvers.outcome import OK
from solvers.resolution import spacing
from solvers.system import Array

if TYPE_CHECKING:
    from solvers.compiled.record import Reals, Table

    from .points import Session

POINTS_PER_STEP = 4  # evaluations of the sensors in a step with dense output, its end included
MAX_MOTION = 0.25  # of a coordinate between two evaluations, in its unit
MAX_POINTS_PER_STEP = 1000  # even if coordinates move further between them
TIME_ACCURACY_RATIO = 1e-3  # of a located time, in units of the tolerance times the step

TIME, SPEED, VALUES = 0, 1, 2  # places in a point
# Rows of ``points``. A step goes from BEGIN to END; EARLIER is the point before it; FIRST, LEFT, RIGHT and NEXT are
# successive points in it; HERE is the point that was evaluated last. Of the search for an extremum A, B and C are the
# points that remain; of that for a root A and B are the bracket. From EXTREMA on there are three rows for each sensor:
# its extremum between LEFT and RIGHT by the points before, by the next one, and between RIGHT and NEXT.
EARLIER, BEGIN, END, FIRST, LEFT, RIGHT, NEXT, HERE, A, B, C, EXTREMA = range(12)


class SearchControlRecord(Record):
    """State of the search in a step."""

    within: f8  # s, longest time between two evaluations
    limit: f8  # s, longest step, and number of the next steps for which it holds
    limited: i8
    has_earlier: i8  # 1: the point EARLIER is known
    min_width: f8  # s, of a bracket
    iterations: i8
    kept: i8  # which end of the bracket the last iteration has kept: -1, 1, or 0 for none
    low: f8  # values at the ends of the bracket for the rule of false position
    high: f8
    code: i8  # result of the last report of a state


class EventSearch(NamedTuple):
    """What the search for the crossings of k sensors reads and changes."""

    control: Table[SearchControlRecord]  # (1,)
    parts: NDArray[np.int64]  # numbers of the parts that are the sensors (k,), then of those that are rates
    rate_places: NDArray[np.int64]  # (k,) places of the rates among these; -1: the rate is not known
    crossed: Array  # (k,) values that the sensors may cross
    directions: NDArray[np.int64]  # (k,) sign of the rate at a crossing; 0: any
    stops: NDArray[np.int64]  # (k,) 1: the value is a stop, which is hit in its direction
    size: Array  # (n,) unit of each free coordinate
    sides: NDArray[np.int64]  # (k,) sign before the next crossing; 0: not known. At a stop it is constant
    bands: Array  # (k,) distance of the sensor from its value up to which its side is not known
    first_sides: NDArray[np.int64]  # (k,) sides and bands at the begin of the last step, if stops hold sensors
    first_bands: Array
    found: NDArray[np.int64]  # (k,) 1: a crossing is at the reported state
    has_extremum: NDArray[np.int64]  # (3 k,) whether the rows from EXTREMA on are known
    brackets: Array  # (k, 2) times before and after the crossing of each sensor
    values: Array  # scratch: the parts
    points: Array  # (rows, 2 + 2 k)

    @staticmethod
    def allocate(
        parts: NDArray[np.int64], rate_places: NDArray[np.int64], directions: NDArray[np.int64],
        stops: NDArray[np.int64], size: Array,
    ) -> EventSearch:  # fmt: skip
        """Return a search that has not begun, for values of zero."""
        k, i = len(directions), np.int64
        control = SearchControlRecord.zeros(1)
        control["within"], control["limit"] = np.inf, np.inf
        sides = np.where(stops == 1, -directions, 0).astype(i)
        given = parts, rate_places, np.zeros(k), directions, stops, size, sides, np.zeros(k)
        before, found = (np.zeros(k, i), np.zeros(k)), (np.zeros(k, i), np.zeros(3 * k, i))
        scratch = np.zeros((k, 2)), np.zeros(len(parts)), np.zeros((EXTREMA + 3 * k, VALUES + 2 * k))
        return EventSearch._make((control, *given, *before, *found, *scratch))

    def memory(self) -> list[NDArray[Any]]:
        """Return the arrays to save between steps."""
        return [self.control, self.crossed, self.sides, self.bands]


def place_of_indicators(search: EventSearch) -> int:
    """Return where the sensors minus their values at HERE are in ``points``, bytes."""
    return int(search.points.itemsize * (HERE * search.points.shape[1] + VALUES))


@kernel
def fill_point(search: EventSearch, session: Session, t: float, q: Reals, v: Reals, row: int) -> None:
    """Evaluate a point at the state (q, v) of time t, s."""
    count, speed = search.crossed.shape[0], 0.0
    watch_sensors(t, q, v, search.parts, session.data, search.values)
    for i in range(search.size.shape[0]):
        speed = max(speed, abs(v[i]) / search.size[i])
    point = search.points[row]
    point[TIME], point[SPEED] = t, speed
    for k in range(count):
        point[VALUES + k] = search.values[k] - search.crossed[k]
        place = search.rate_places[k]
        point[VALUES + count + k] = search.values[place] if place >= 0 else np.nan


@kernel
def is_time(t: float) -> bool:
    """Whether a time is given: not nan."""
    return not np.isnan(t)


@kernel
def copy_point(search: EventSearch, row: int, target: int) -> None:
    """Copy a point to another row."""
    for i in range(search.points.shape[1]):
        search.points[target, i] = search.points[row, i]


@kernel
def time_of(search: EventSearch, row: int) -> float:
    """Time of a point, s."""
    return float(search.points[row, TIME])


@kernel
def side_of(search: EventSearch, row: int, k: int) -> int:
    """Sign of sensor k minus its value at a point; 0: it is not known."""
    value = search.points[row, VALUES + k]
    if abs(value) <= search.bands[k]:
        return 0
    return (1 if value > 0.0 else 0) - (1 if value < 0.0 else 0)


@kernel
def note_sides(search: EventSearch, row: int) -> None:
    """Take the sides of the sensors from a point at which none of them crosses its value."""
    for k in range(search.sides.shape[0]):
        side = side_of(search, row, k)
        if side != 0:
            search.bands[k] = 0.0
            if search.stops[k] == 0:
                search.sides[k] = side


@kernel
def has_crossed(search: EventSearch, row: int, k: int) -> bool:
    """Whether sensor k has crossed its value in its direction at a point."""
    side, direction = side_of(search, row, k), search.directions[k]
    return side != 0 and side == -search.sides[k] and direction * side >= 0


@kernel
def has_any_crossed(search: EventSearch, row: int) -> bool:
    """Whether any sensor has crossed its value at a point."""
    for k in range(search.sides.shape[0]):
        if has_crossed(search, row, k):
            return True
    return False


@kernel
def begin_step(search: EventSearch, rtol: float, is_dense: bool) -> int:
    """Begin with the points of the step from BEGIN to END; return the number of intervals between them."""
    control, points = search.control[0], search.points
    begin, end = points[BEGIN, TIME], points[END, TIME]
    duration = end - begin
    control.min_width = max(4.0 * spacing(end), TIME_ACCURACY_RATIO * rtol * duration)
    control.code = OK
    count = duration * max(points[BEGIN, SPEED], points[END, SPEED]) / MAX_MOTION
    if is_dense:
        count = max(count, float(POINTS_PER_STEP), duration / control.within)
    count = min(count, float(MAX_POINTS_PER_STEP), duration / (4.0 * spacing(end)))
    for k in range(search.has_extremum.shape[0]):
        search.has_extremum[k] = 0
    copy_point(search, EARLIER, FIRST)
    copy_point(search, BEGIN, LEFT)
    return int(np.ceil(max(1.0, count)))


@kernel
def point_time(search: EventSearch, i: int, count: int) -> float:
    """Time of point i of those that divide the step into ``count`` intervals, s."""
    begin, end = search.points[BEGIN, TIME], search.points[END, TIME]
    return float(begin + (end - begin) * i / count)


@kernel
def shift_points(search: EventSearch) -> None:
    """Go on to the next interval of the step."""
    count = search.sides.shape[0]
    copy_point(search, LEFT, FIRST)
    copy_point(search, RIGHT, LEFT)
    copy_point(search, NEXT, RIGHT)
    for k in range(count):
        search.has_extremum[k] = search.has_extremum[2 * count + k]
        search.has_extremum[count + k] = search.has_extremum[2 * count + k] = 0
        copy_point(search, EXTREMA + 2 * count + k, EXTREMA + k)


@kernel
def is_rate_known(search: EventSearch, k: int) -> bool:
    """Whether the rate of sensor k is known."""
    return bool(search.rate_places[k] >= 0)


@kernel
def choose_crossing(search: EventSearch, row: int) -> float:
    """Return the time of the first crossing of those at a point, s, and mark the stops that are hit before it.

    A stop is hit before its value is passed, others after it.
    """
    first, hit = np.inf, np.inf
    for k in range(search.sides.shape[0]):
        search.found[k] = 0
        if has_crossed(search, row, k):
            first = min(first, search.brackets[k, 1])
    for k in range(search.sides.shape[0]):
        if has_crossed(search, row, k) and search.stops[k] == 1 and search.brackets[k, 0] < first:
            search.found[k], hit = 1, min(hit, search.brackets[k, 0])
    return float(min(first, hit))


@kernel
def is_any_found(search: EventSearch) -> bool:
    """Whether a crossing is at the reported state."""
    for k in range(search.found.shape[0]):
        if search.found[k] == 1:
            return True
    return False


@kernel
def mark_crossed(search: EventSearch) -> bool:
    """Mark the sensors that have crossed their values at HERE, but for stops; unless stops are hit there.

    Return whether any sensor is marked.
    """
    if is_any_found(search):
        return True
    for k in range(search.found.shape[0]):
        search.found[k] = 1 if search.stops[k] == 0 and has_crossed(search, HERE, k) else 0
    note_sides(search, HERE)
    return is_any_found(search)


@kernel
def count_sensors(search: EventSearch) -> int:
    """Number of sensors."""
    return int(search.sides.shape[0])


@kernel
def clear_found(search: EventSearch) -> None:
    """Let no crossing be at the reported state."""
    for k in range(search.found.shape[0]):
        search.found[k] = 0


@kernel
def note_code(search: EventSearch, code: int) -> None:
    """Note the result of the report of a state."""
    if code != OK:
        search.control[0].code = code


@kernel
def code_of(search: EventSearch) -> int:
    """Result of the reports of states in the last step: the last that failed."""
    return int(search.control[0].code)


@kernel
def end_step(search: EventSearch) -> None:
    """Let the end of the step be the begin of the next one."""
    copy_point(search, BEGIN, EARLIER)
    copy_point(search, END, BEGIN)
    search.control[0].has_earlier = 1


@kernel
def has_earlier_point(search: EventSearch) -> bool:
    """Whether the point before the step is known."""
    return bool(search.control[0].has_earlier == 1)


@kernel
def begin_search(search: EventSearch) -> None:
    """Begin at the point BEGIN, at which nothing is a crossing."""
    search.control[0].has_earlier = 0
    note_sides(search, BEGIN)
    clear_found(search)


@kernel
def limit_next_step(search: EventSearch) -> float:
    """Longest next step, s."""
    control = search.control[0]
    if control.limited <= 0:
        return np.inf
    control.limited -= 1
    return float(control.limit)


@kernel
def longest_gap(search: EventSearch) -> float:
    """Longest time between two evaluations of a sensor, s."""
    return float(search.control[0].within)

"""Parts of a table over a coordinate that are narrow, so that one step of a solver may pass them.

A corner is a point at which the slope of the secants changes. A narrow part begins and ends at corners, and the
distances to the corners before and after it are at least ``MIN_DISTANCE_RATIO`` times its width. Before the first and
after the last corner the distance is the width of the whole table, or infinite if the curve has one constant value
beyond both ends, as a force that acts within the table only. Neither changes with the units of abscissa and ordinate.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.mechanics.signals import Table

MIN_STEPS_AFTER_RESTART = 8  # to the next event at which the solver restarts
MAX_PLACES = 60  # in a narrow part
MAX_TABLE_DEVIATION_RATIO = (
    0.02  # of lines through the ends of equal steps between places, relative to the range of the part
)
MIN_DISTANCE_RATIO = 20.0  # of the distance to other corners, relative to the width of a narrow part
SLOPE_ROUNDING_RATIO = 1e-9  # of differences of slopes that are rounding errors, relative to the largest slope


def corners_of(table: Table) -> Any:
    """Return the abscissas (k,) at which the slope of the secants changes."""
    x, slopes = np.asarray(table.x, float), np.diff(table.y) / np.diff(table.x)
    beyond = slopes[[0, -1]] if table.beyond == "linear" else np.zeros(2)
    all_slopes = np.concatenate((beyond[:1], slopes, beyond[1:]))
    changes = np.abs(np.diff(all_slopes)) > SLOPE_ROUNDING_RATIO * np.abs(slopes).max()
    return x[changes]


def narrow_parts(table: Table) -> list[tuple[float, float]]:
    """Return first and last abscissa of each narrow part; those of a periodic table are not known."""
    if table.beyond == "periodic":
        return []
    corners, rows = corners_of(table), table.rows("a table")
    if len(corners) < 2:
        return []
    y = np.asarray(table.y, float)
    is_flat = table.beyond == "hold" or not rows[[0, -1], 2].any()
    outside = np.inf if is_flat and y[0] == y[-1] else float(np.max(table.x) - np.min(table.x))
    gaps = np.diff(corners)
    distances = np.concatenate(([outside], gaps, [outside]))
    found, ends = [], {k: k for k in range(len(corners))}  # the other end of the part that begins or ends at a corner
    for k in np.argsort(gaps, kind="stable").tolist():
        first, last = ends[k], ends[k + 1]
        ends[first], ends[last] = last, first
        width = corners[last] - corners[first]
        if min(distances[first], distances[last + 1]) >= MIN_DISTANCE_RATIO * width:
            found.append((float(corners[first]), float(corners[last])))
    return sorted(found)


def places_of(table: Table) -> list[float]:
    """Return the abscissas at which its narrow parts begin and end, and corners inside.

    These are all corners of lines, if there are at most ``MAX_PLACES``; otherwise those without which the steps from
    place to place may pass a part of the curve.
    """
    places, corners = set[float](), corners_of(table)
    parts = narrow_parts(table)
    for begin, end in parts:
        inside = corners[(begin <= corners) & (corners <= end)]
        places |= {begin, end} | set(inside.tolist() if table.kind == "linear" and len(inside) <= MAX_PLACES else ())
    for begin, end in parts:
        inside = corners[(begin <= corners) & (corners <= end)]
        places |= refine_places(table, inside, {place for place in places if begin <= place <= end})
    return sorted(places)


def refine_places(table: Table, corners: Any, places: set[float]) -> set[float]:
    """Return ``places`` and the ``corners`` (k,) at which lines through equal steps deviate most from the curve."""
    values, found = values_of(table, corners), set(places)
    allowed = MAX_TABLE_DEVIATION_RATIO * float(np.ptp(values))
    while len(found) < min(MAX_PLACES, len(corners)):
        ends = np.array(sorted(found))
        parts = np.arange(MIN_STEPS_AFTER_RESTART * (len(ends) - 1) + 1) / MIN_STEPS_AFTER_RESTART
        steps = np.interp(parts, np.arange(len(ends)), ends)
        deviations = np.where(np.isin(corners, ends), 0.0, np.interp(corners, steps, values_of(table, steps)) - values)
        largest = int(np.argmax(np.abs(deviations)))
        if abs(deviations[largest]) <= allowed:
            break
        found.add(float(corners[largest]))
    return found


def values_of(table: Table, x: Any) -> Any:
    """Return the values (k,) of a table at abscissas (k,) between its first and its last point."""
    rows = table.rows("a table")
    at = rows[np.searchsorted(rows[:, 0], x, side="right") - 1]
    s = x - at[:, 0]
    return at[:, 1] + s * (at[:, 2] + s * (at[:, 3] + s * at[:, 4]))

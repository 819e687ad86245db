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

MAX_CORNERS = 10  # of a narrow part, at all of which the solver restarts
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
    """Return the abscissas at which its narrow parts begin and end and, if it is made of lines, their corners inside
    unless there are more than ``MAX_CORNERS``.
    """
    found, corners = set[float](), corners_of(table)
    for begin, end in narrow_parts(table):
        inside = corners[(begin <= corners) & (corners <= end)]
        found |= {begin, end} | set(inside.tolist() if table.kind == "linear" and len(inside) <= MAX_CORNERS else ())
    return sorted(found)

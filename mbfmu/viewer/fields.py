"""Fields over surfaces: what colors their cells, and the colors.

The colors are Moreland's for signed quantities on surfaces that are lit: from gray at zero to blue and to red, which
differ for the color-blind too, alike in lightness on both sides, and never so dark that light and shadow are lost. The
limits are alike on both sides and those of the whole run: a color means one value at all times. Where a few values, as
those of an impact, are so large that all others would be gray, the limits suit the others.

K. Moreland, Diverging Color Maps for Scientific Visualization, 2009.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .hulls import largest_values
from .motion import Motion

Array = NDArray[np.float64]

COLOR_STOPS = ("#3b4cc0", "#6282ea", "#8db0fe", "#b8d0f9", "#dddddd", "#f5c4ad", "#f49a7b", "#de604d", "#b40426")
# percent of what is not zero, and times what these reach, above which limits leave it out
COLOR_LIMIT_PERCENTILE, MAX_PEAK_RATIO = 95, 10.0


@dataclass(frozen=True, kw_only=True)
class Field:
    """What colors the cells of a surface.

    Attributes
    ----------
    title
        Name and unit, and the largest size if the colors leave it out.
    low, limit
        Ends of the bar of colors, which go from minus the limit to it; ``low`` is zero where no value is below.
    columns
        Of every cell's output among those of the motion, row after row.
    """

    title: str
    low: float
    limit: float
    columns: tuple[int, ...]


def fields(motion: Motion, *others: Motion) -> list[Field | None]:
    """Return the fields of a motion's surfaces, None for one without; their limits suit other motions too."""
    found: dict[tuple[str, str], list[Array]] = {}
    for run in (motion, *others):
        for name, unit, columns in filter(None, fields_of(run)):
            found.setdefault((name, unit), []).append(run.values[:, columns].ravel())
    return [
        field_with(name, unit, columns, np.concatenate(found[name, unit])) if columns else None
        for name, unit, columns in (own or ("", "", ()) for own in fields_of(motion))
    ]


def hull_fields(motion: Motion, *others: Motion) -> list[Field]:
    """Return the fields of a motion's hulls; their limits suit other motions too."""
    limits: dict[str, float] = {}
    for run in (motion, *others):
        for hull in run.picture.hulls:
            size = largest_values(hull, run.p[:, hull.modes].astype(float))
            limits[hull.title] = max(limits.get(hull.title, 0.0), size)
    return [Field(title=hull.title, low=0.0, limit=limits[hull.title], columns=()) for hull in motion.picture.hulls]


def field_with(name: str, unit: str, columns: tuple[int, ...], values: Array) -> Field:
    """Return the field with these values in all its cells at all times."""
    finite = values[np.isfinite(values)]
    sizes = np.abs(finite[finite != 0.0])
    largest = float(sizes.max(initial=0.0))
    usual = float(np.percentile(sizes, COLOR_LIMIT_PERCENTILE)) if len(sizes) else 0.0
    limit, beyond = (usual, f", up to {largest:.3g}") if largest > MAX_PEAK_RATIO * usual else (largest, "")
    title = f"{name}{'' if unit == '1' else f' [{unit}]'}{beyond}"
    return Field(title=title, low=-limit if (finite < 0.0).any() else 0.0, limit=limit, columns=columns)


def fields_of(motion: Motion) -> list[tuple[str, str, tuple[int, ...]] | None]:
    """Return the name, the unit and the columns of every surface's field."""
    place = {name: k for k, (name, _) in enumerate(motion.outputs)}
    found: list[tuple[str, str, tuple[int, ...]] | None] = []
    for skin in motion.picture.skins:
        columns = tuple(place[name] for name in skin.outputs)
        found.append((skin.field, motion.outputs[columns[0]][1], columns) if columns else None)
    return found


def colored(values: Array, limit: float) -> Array:
    """Return the colors (..., 3), red, green and blue from 0 to 1, of values (...); NaN where one is not finite."""
    parts = np.where(np.isfinite(values), values, np.nan) / (limit or 1.0)
    stops = np.array([[int(stop[k : k + 2], 16) / 255.0 for k in (1, 3, 5)] for stop in COLOR_STOPS])
    places = np.linspace(-1.0, 1.0, len(COLOR_STOPS))
    return np.stack([np.interp(parts, places, stops[:, k]) for k in range(3)], axis=-1)

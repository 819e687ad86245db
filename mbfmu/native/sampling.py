"""Numbers of a mechanism at several values of one parameter."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbfmu.util.errors import UserError
from solvers.system import Array

if TYPE_CHECKING:
    from .parameter_dependence import ParameterDependence

MAX_CHOICES_ASIDE = 4  # whole numbers to either side of the value of a parameter that are tried
MAX_RANGE_TRIES = 5  # to find an end where the build does not refuse, nearer to the center each time


def sample_choices(search: ParameterDependence, name: str) -> tuple[list[float], list[Array]]:
    """Return the values of a parameter that is a whole number or a Boolean, its own first, and the numbers there.

    Values beyond one for which the build refuses, or for which the structure differs, are left out. Raises
    UserError if no other value is left.
    """
    own, declared, refused = int(search.center[name]), search.declared[name], None
    least, most = (0, 1) if isinstance(declared.default, bool) else (declared.min, declared.max)
    values, rows = [own], [search.reader.read(search.at_center())]
    for step in (-1, 1):
        for aside in range(1, MAX_CHOICES_ASIDE + 1):
            try:
                if least <= own + step * aside <= most:
                    rows.append(search.reader.read(search.at_center() | {name: float(own + step * aside)}))
                    values.append(own + step * aside)
            except UserError as error:
                refused = error
                break
    if refused and len(values) == 1:
        raise refused
    search.discrete[name] = tuple(sorted(values))
    search.ends[name] = [float(min(values)), float(max(values))]
    return list(map(float, values)), rows


def sample_range(search: ParameterDependence, name: str) -> tuple[list[float], list[Array]]:
    """Return values of a parameter, its center and both ends, and the numbers there.

    Ends at which the build refuses are moved inward. Raises UserError where the parameter cannot be moved at all.
    """
    points, rows = [search.center[name]], [search.reader.read(search.at_center())]
    for side in (0, 1):
        for left in reversed(range(MAX_RANGE_TRIES)):
            x = search.ends[name][side]
            try:
                rows.append(search.reader.read(search.at_center() | {name: x}))
                points.append(x)
                break
            except UserError:
                if not left:
                    raise
                search.ends[name][side] = search.center[name] + 0.4 * (x - search.center[name])
                search.may_extend[name][side] = False
    for row in rows:
        search.lengths = search.lengths[search.equal_to_length(row)[search.lengths]]
    return points, rows

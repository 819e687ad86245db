"""Tables whose points come from a file or from a scene: they know their unit, and may leave their kind to their use."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

from mbfmu.util.errors import UserError
from mbfmu.util.units import read_unit

from .table import Table

KIND_BY_USE = ""  # straight lines for loads, a spline for what drives a joint


@dataclass(frozen=True, eq=False)
class MeasuredTable(Table):
    """A table in SI units with the unit and the source of its points.

    Parameters
    ----------
    x, y, beyond
        See :class:`.Table`.
    kind
        See :class:`.Table`; :data:`KIND_BY_USE`: ``spline`` if it drives a joint, otherwise ``linear``.
    source
        Description of the place of the points for messages, such as "column 'height' of file 'road.csv'"; may be empty.
    unit
        Unit of the points before they were converted; empty: none is stated.
    """

    source: str = ""
    unit: str = ""

    def rows(self, what: str) -> Any:
        """Return the rows of the curve; without a kind those of straight lines."""
        return replace(self, kind="linear").rows(what) if self.kind == KIND_BY_USE else super().rows(what)

    def for_use(self, *, drive: bool) -> Self:
        """Return the table with the kind that a load or a driven joint requires."""
        return replace(self, kind="spline" if drive else "linear") if self.kind == KIND_BY_USE else self

    def check_unit(self, what: str, unit: str) -> None:
        """Refuse a unit of the points that is of another quantity than that of an input; raises UserError."""
        if self.unit and read_unit(self.unit).exponents != read_unit(unit).exponents:
            raise UserError(
                f"{what} has the unit {unit}, but {self.source} has the unit {self.unit}; allowed: a unit of the same "
                f"quantity, such as {unit}. Correct the unit in the file, or use another column"
            )

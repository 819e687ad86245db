"""Columns of CSV and Parquet files as tables: measured roads, drive cycles, loads."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.signals import Table
from mbfmu.mechanics.signals.measured import MeasuredTable
from mbfmu.util.errors import UserError, suggest
from mbfmu.util.extras import import_optional
from mbfmu.util.units import Unit, read_unit

Array = NDArray[np.float64]

PARQUET_SUFFIXES = (".parquet", ".pq")
HEADER_EXAMPLE = "time [s],road.height [mm]"
MIN_ROWS = 2
PARENTHESIZED_UNIT = re.compile(r"\(([^()]*[^()\d\s][^()]*)\)$")  # not an index, as in stress(12)


class Column(NamedTuple):
    """Times and values of one column, in SI units."""

    times: Array  # s
    values: Array
    unit: str  # as in the header; empty: it has none
    source: str  # name of the column and of the file, for messages


def read_table(path: Path | str, column: str = "", *, kind: str = "spline", beyond: str = "linear") -> Table:
    """Return a table of a column of a CSV or Parquet file over the times in the first column of the file.

    The first line of a CSV file contains the names of the columns, separated by commas, for example
    ``time [s],road.height [mm]``. A unit in brackets is optional: times and values are converted from it to SI units.
    Without a unit they are in SI units. Files of ``mbfmu run`` (``outputs.csv``) have this form. A Parquet file has the
    same names, and requires pyarrow (``pip install 'mbfmu[study]'``).

    Parameters
    ----------
    path
        Path of the file. The suffix is ``.parquet`` or ``.pq`` for Parquet; all other files are read as CSV in UTF-8.
    column
        Name of the column, without the unit. It may be omitted if the file has one column in addition to the times.
    kind, beyond
        Interpolation and continuation beyond both ends, see :class:`.Table`.

    Returns
    -------
    Table
        Signal over time, in SI units.

    Raises
    ------
    UserError
        The file cannot be read, the column does not exist, a unit is unknown, a value is not a finite number, or the
        times do not increase. The message contains the line of the file. A table whose unit is of another quantity than
        that of the input that it replaces is refused by the functions that receive it.
    """
    found = read_column(path, column)
    table = MeasuredTable(found.times, found.values, kind, beyond, found.source, found.unit)
    table.rows(found.source)  # refuses kind and beyond
    return table


def read_column(path: Path | str, column: str = "", default: str = "") -> Column:
    """Return a column of a file; see :func:`read_table`. ``default`` is read if none of several columns is given."""
    path = Path(path)
    what = f"file {str(path)!r}"
    file = (_ParquetFile if path.suffix.lower() in PARQUET_SUFFIXES else _CsvFile)(path, what)
    names, units = _names_and_units(file.header, what)
    if len(names) < MIN_ROWS:
        raise UserError(f"{what} has the columns {names}; allowed: times in the first column, and one column or more")
    if not column and len(names) > MIN_ROWS:
        if default not in names[1:]:
            missing = f"no column {default!r}, but " if default else ""
            example = f", as in {path.name}:{names[1]}" if default else ""
            listed = ", ".join(map(repr, names[1:]))
            raise UserError(f"{what} has {missing}the columns {listed}; give the name of one of them{example}")
        column = default
    if column and column not in names[1:]:
        raise UserError(f"{what} has no column {column!r}{suggest(column, names[1:])}")
    place = names.index(column, 1) if column else 1
    scales = [read_unit_of(units[k], f"column {names[k]!r} of {what}") for k in (0, place)]
    if scales[0] is not None and scales[0].exponents != {"s": 1}:
        raise UserError(f"{what}: the unit of the first column, {names[0]!r}, is {units[0]!r}; allowed: a unit of time")
    raw = file.columns(0, place)
    if len(raw) < MIN_ROWS:
        raise UserError(f"{what} has {len(raw)} rows of numbers; allowed: at least two")
    wrong = np.argwhere(~np.isfinite(raw))
    if len(wrong):
        row, k = wrong[0]
        name = names[(0, place)[k]]
        raise UserError(f"{what}, {file.place_of(row)}: column {name!r} is {raw[row, k]}; allowed: finite numbers")
    late = np.flatnonzero(np.diff(raw[:, 0]) <= 0.0)
    if len(late):
        row = int(late[0]) + 1
        raise UserError(
            f"{what}, {file.place_of(row)}: the time is {raw[row, 0]:.9g} after {raw[row - 1, 0]:.9g}; allowed: times "
            "that increase from row to row. Write a jump as two times with a short distance"
        )
    times, values = (raw[:, k] * (scale.factor if scale else 1.0) for k, scale in enumerate(scales))
    return Column(times, values, units[place], f"column {names[place]!r} of {what}")


def read_unit_of(text: str, what: str) -> Unit | None:
    """Return the unit in a header; None if there is none."""
    if not text:
        return None
    try:
        return read_unit(text)
    except UserError as error:
        raise UserError(f"{what}: {error}") from error


def _names_and_units(header: Sequence[str], what: str) -> tuple[list[str], list[str]]:
    """Return names and units of columns such as ``height [mm]``."""
    names, units = [], []
    for cell in header:
        if match := PARENTHESIZED_UNIT.search(cell.strip()):
            raise UserError(
                f"{what}: the name of a column is {cell.strip()!r}; allowed: units in square brackets, such as "
                f"'road.height [mm]'. Write [{match[1]}] if this is a unit, or rename the column"
            )
        name, bracket, unit = cell.strip().partition("[")
        if bracket and not unit.endswith("]"):
            raise UserError(f"{what}: the name of a column is {cell!r}; allowed: such as 'road.height [mm]'")
        names.append(name.strip())
        units.append(unit.removesuffix("]").strip())
    for name in names:
        if not name or names.count(name) > 1:
            raise UserError(f"{what} has the columns {names}; allowed: a different name for each column")
    return names, units


class _CsvFile:
    """A text file with a header; lines that are empty are left out."""

    def __init__(self, path: Path, what: str) -> None:
        self.what = what
        try:
            text = path.read_bytes().decode("utf-8-sig")
        except OSError as error:
            raise UserError(f"{what} cannot be read: {error.strerror}", "file-access") from error
        except UnicodeDecodeError as error:
            raise UserError(f"{what} is not text in UTF-8: {error}; save it as CSV in UTF-8") from error
        lines = text.splitlines()
        filled = [number for number, line in enumerate(lines, 1) if line.strip()]
        if not filled:
            raise UserError(
                f"{what} is empty; allowed: a line of names such as {HEADER_EXAMPLE!r}, and rows of numbers"
            )
        self._numbers, self._lines = filled[1:], [lines[number - 1] for number in filled[1:]]
        first = lines[filled[0] - 1]
        if "," not in first and (";" in first or "\t" in first):
            mark = "semicolons" if ";" in first else "tabs"
            raise UserError(f"{what} is separated by {mark}; allowed: commas, and points in decimal fractions")
        self.header = next(csv.reader([first]))
        if any(map(_is_number, self.header)):
            raise UserError(
                f"{what}: the first line is {first[:80]!r}; allowed: names of the columns, such as {HEADER_EXAMPLE!r}"
            )

    def place_of(self, row: int) -> str:
        """Return where a row of numbers is."""
        return f"line {self._numbers[row]}"

    def columns(self, *places: int) -> Array:
        """Return columns (rows, columns); UserError for a cell that is not a number."""
        commas = len(self.header) - 1
        if any(line.count(",") != commas for line in self._lines):
            self._check_cells(())
        if not self._lines:
            return np.zeros((0, len(places)))
        text = io.StringIO("\n".join(self._lines))
        try:
            return np.loadtxt(text, delimiter=",", quotechar='"', comments=None, usecols=places, ndmin=2)
        except ValueError as error:
            self._check_cells(places)
            raise UserError(f"{self.what} cannot be read: {error}") from error

    def _check_cells(self, places: Sequence[int]) -> None:
        """Refuse the first line with another number of cells than the header, or no number in one of these columns."""
        for row, cells in enumerate(csv.reader(self._lines)):
            where = f"{self.what}, {self.place_of(row)}"
            if len(cells) != len(self.header):
                hint = ". Fractions must have points, not commas" if len(cells) > len(self.header) else ""
                raise UserError(
                    f"{where}: the line has {len(cells)} cells; allowed: {len(self.header)}, as the first line{hint}"
                )
            for k in places:
                if not _is_number(cells[k]):
                    raise UserError(f"{where}: column {self.header[k].strip()!r} is {cells[k]!r}; allowed: a number")


class _ParquetFile:
    """A Parquet file, whose columns have the same names as those of a text file."""

    def __init__(self, path: Path, what: str) -> None:
        self._parquet, self._path, self.what = import_optional("pyarrow.parquet", "study"), path, what
        if not path.is_file():
            raise UserError(f"{what} cannot be read: there is no such file", "file-access")
        try:
            self.header: list[str] = self._parquet.read_schema(path).names
        except Exception as error:  # pyarrow has many kinds
            raise UserError(f"{what} is not a Parquet file: {error}") from error

    @staticmethod
    def place_of(row: int) -> str:
        """Return where a row of numbers is."""
        return f"row {row + 1}"

    def columns(self, *places: int) -> Array:
        """Return columns (rows, columns); UserError for one that does not contain numbers."""
        names = [self.header[k] for k in places]
        table = self._parquet.read_table(self._path, columns=names)
        try:
            return np.column_stack([table.column(name).to_numpy().astype(float) for name in names])
        except (TypeError, ValueError) as error:
            raise UserError(f"{self.what}: columns {names} do not contain numbers only: {error}") from error


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True

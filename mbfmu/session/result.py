"""Result of a run: outputs over time, statistics of the solver, and diagnostics."""

from __future__ import annotations

import csv
import json
from dataclasses import asdict, dataclass, fields
from html import escape
from pathlib import Path
from typing import Any, Self

from mbfmu.mechanics import Variable
from mbfmu.modeling.settings import Settings
from mbfmu.util.array_files import read_arrays, write_arrays
from mbfmu.util.diagnostics import Diagnosed, Diagnostic, from_saved, render
from mbfmu.util.errors import UserError, suggest
from mbfmu.util.extras import import_optional
from mbfmu.util.files import replacing
from mbfmu.util.text_table import format_tolerance
from solvers import Statistics
from solvers.system import Array

from .event_record import EventRecord

RESULT_FORMAT = 2  # of a saved result; format 1, until version 0.2, had texts in place of diagnostics


@dataclass
class Result(Diagnosed):
    """Result of a run: outputs over time, statistics of the solver, and diagnostics.

    ``result["crank.angle"]`` is one output over ``result.t``.

    Attributes
    ----------
    t
        Times (k,), s.
    values
        Outputs (k, n), one column per variable.
    variables
        Name, unit and description of each column of ``values``.
    statistics
        Counts of steps, evaluations and other work of the solver.
    wall_time
        Time between the first and the last output, s.
    name
        Name of the model or of the scene.
    settings
        Settings of the integration; None: unknown.
    diagnostics
        Notes, warnings and errors of the run.
    inputs
        One message per given input: how it was interpolated.
    events
        Events that have occurred, with name, time, direction and values of the sensor before and after the actions; see
        :class:`.EventRecord`.
    """

    t: Array
    values: Array
    variables: tuple[Variable, ...]
    statistics: Statistics
    wall_time: float
    name: str = ""
    settings: Settings | None = None
    diagnostics: tuple[Diagnostic, ...] = ()
    inputs: tuple[str, ...] = ()
    events: tuple[EventRecord, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(v.name for v in self.variables)

    @property
    def title(self) -> str:
        """Model or scene, solver and tolerance in one line."""
        how = f"{self.settings.solver}, tolerance {format_tolerance(self.settings.tolerance)}" if self.settings else ""
        return ", ".join(filter(None, (self.name, how)))

    def __getitem__(self, name: str) -> Array:
        """Return one output over time."""
        return self.values[:, self.column(name)]

    def column(self, name: str) -> int:
        """Return the number of the column of ``values`` that contains an output.

        Parameters
        ----------
        name
            Name of the output.

        Returns
        -------
        int
            Number of the column, from 0.

        Raises
        ------
        UserError
            There is no such output; the message contains similar names.
        """
        if name not in self.names:
            raise UserError(f"no output {name!r}{suggest(str(name), self.names)}")
        return self.names.index(name)

    def unit(self, name: str) -> str:
        """Return the unit of an output.

        Parameters
        ----------
        name
            Name of the output.

        Returns
        -------
        str
            Unit in the notation of FMI, such as ``rad/s``.
        """
        return self.variables[self.column(name)].unit

    def as_dict(self) -> dict[str, Array]:
        """Return a dictionary of all outputs: arrays (k,) by name."""
        return {name: self.values[:, i] for i, name in enumerate(self.names)}

    # ---- for other tools ----------------------------------------------------------------------------------------

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame with one column per output; index: time in s; units in ``attrs["units"]``."""
        pandas = import_optional("pandas")
        frame = pandas.DataFrame(self.values, index=pandas.Index(self.t, name="time"), columns=list(self.names))
        frame.attrs["units"] = {v.name: v.unit for v in self.variables}
        return frame

    def to_xarray(self) -> Any:
        """Return an xarray Dataset with one variable per output over ``time`` in s, with unit and description."""
        xarray = import_optional("xarray")
        outputs = {
            v.name: ("time", self.values[:, i], {"units": v.unit, "long_name": v.description})
            for i, v in enumerate(self.variables)
        }
        return xarray.Dataset(outputs, coords={"time": ("time", self.t, {"units": "s"})}, attrs={"title": self.title})

    def plot(self, *names: str) -> Any:
        """Return a matplotlib figure of outputs over time with one panel per unit.

        Parameters
        ----------
        *names
            Names of outputs, or patterns: ``plot("coupler.*")`` draws the outputs whose names begin with
            ``coupler.``, and ``plot("*")`` all. Without names the first twelve outputs of each unit are drawn, but no
            residuals and no energy error. These have logarithmic axes.

        Raises
        ------
        UserError
            A name is not an output, and no output matches it as a pattern.
        """
        import matplotlib.pyplot as plt

        from mbfmu.plotting.time_series import draw, size

        figure = plt.figure(figsize=size(self, names), layout="constrained")
        draw(figure, self, names)
        return figure

    def _repr_html_(self) -> str:
        """Return a table for a notebook: every output with its unit, first, last, smallest and largest value."""
        head = "<tr><th>output</th><th>unit</th><th>start</th><th>end</th><th>least</th><th>most</th></tr>"
        rows = [
            f"<tr><td>{escape(v.name)}</td><td>{escape(v.unit)}</td>"
            + "".join(f"<td>{x:.6g}</td>" for x in (own[0], own[-1], own.min(), own.max()))
            + "</tr>"
            for v, own in zip(self.variables, self.values.T, strict=True)
        ]
        notes = map(escape, (*render(self.diagnostics), *self.inputs))
        said = "".join(f"<p>{note}</p>" for note in notes)
        return f"<b>{escape(self._line())}</b>{said}<table>{head}{''.join(rows)}</table>"

    def __repr__(self) -> str:
        """Return the run in one line."""
        return f"<Result of {self._line()}>"

    def _line(self) -> str:
        span = f"{len(self.t)} times from {self.t[0]:g} to {self.t[-1]:g} s, {len(self.variables)} outputs"
        return ": ".join(filter(None, (self.title, span))) + (", ended early" if self.failed else "")

    # ---- files --------------------------------------------------------------------------------------------------

    def write_csv(self, path: Path | str) -> None:
        """Write time and outputs as comma-separated values; the header contains names and units.

        Parameters
        ----------
        path
            Path of the file.

        Raises
        ------
        UserError
            The file cannot be written.
        """
        with replacing(path) as unfinished, unfinished.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["time [s]", *(f"{v.name} [{v.unit}]" for v in self.variables)])
            for t, row in zip(self.t, self.values, strict=True):
                writer.writerow([repr(float(t)), *(repr(float(x)) for x in row)])

    def save(self, path: Path | str) -> None:
        """Write the whole result to a file, for :meth:`load`.

        Parameters
        ----------
        path
            Path of the file, with the suffix ``.npz``.

        Raises
        ------
        UserError
            The file cannot be written.
        """
        header = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("t", "values")}
        header |= {"variables": [asdict(v) for v in self.variables], "statistics": asdict(self.statistics)}
        header["diagnostics"] = [asdict(diagnostic) for diagnostic in self.diagnostics]
        header["settings"] = asdict(self.settings) if self.settings else None
        told = json.dumps({"format": RESULT_FORMAT} | header)
        write_arrays(path, {"t": self.t, "values": self.values, "told": told})

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Return the result in a file that :meth:`save` has written.

        Parameters
        ----------
        path
            Path of the file.

        Returns
        -------
        Result
            The result, equal to the saved one.

        Raises
        ------
        UserError
            The file is not a saved result.
        """
        try:
            file = read_arrays(path)
            header = json.loads(str(file["told"]))
            t, values = file["t"], file["values"]
            if (version := header.pop("format")) not in (1, RESULT_FORMAT):
                raise ValueError("another format")
            header["diagnostics"] = _read_texts(header) if version == 1 else from_saved(header["diagnostics"])
            header["variables"] = tuple(Variable(**v) for v in header["variables"])
            header["statistics"] = Statistics(**header["statistics"])
            header["settings"] = Settings(**header["settings"]) if header["settings"] else None
            if (
                t.ndim != 1
                or values.shape != (len(t), len(header["variables"]))
                or t.dtype.kind + values.dtype.kind != "ff"
            ):
                raise ValueError(f"times {t.shape} and values {values.shape} do not belong together")
            header["inputs"] = tuple(header.get("inputs", ()))
            header["events"] = tuple(EventRecord(*event) for event in header.get("events", ()))
            return cls(t, values, **header)
        except Exception as error:  # a file of another kind fails in any of these
            raise UserError(f"{str(path)!r} is not a saved result: {error}") from error


def _read_texts(header: dict[str, Any]) -> tuple[Diagnostic, ...]:
    """Return the texts of a result of format 1 as diagnostics, and remove them from its header."""
    failure, verdict, coarse = (header.pop(name, "") for name in ("failure", "verdict", "coarse"))
    found = from_saved((*header.pop("remarks", ()), verdict, coarse))
    return (*found, *([Diagnostic.parse(failure, "error", "invalid-value")] if failure else []))

"""A native run, without an FMU: a model's outputs over time."""

from __future__ import annotations

import csv
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mbfmu.errors import UserError
from mbfmu.mechanics import Variable
from mbfmu.mechanics.numbers import array_of, finite
from mbfmu.model import Model, suggest
from mbfmu.simulation import Array, Settings, Simulation, together
from solvers import Statistics

MOST = 1e7  # communication points
ROWS = 100  # outputs recorded between two reports of progress


@dataclass
class Result:
    """Outputs over time, and how the run went."""

    times: Array  # (k,) s
    values: Array  # (k, outputs)
    variables: tuple[Variable, ...]
    statistics: Statistics
    wall_time: float  # s, between the first and the last output
    failure: str = ""  # why the run ended early and what to try; empty: it did not
    verdict: str = ""  # when and how the energy balance was lost; empty: it was not
    coarse: str = ""  # where cells bend too far for their grid; empty: nowhere, or the run ended early
    remarks: tuple[str, ...] = ()  # what is unusual and stops nothing, in sentences

    @property
    def warning(self) -> str:
        """Why it is not to be trusted though it ran; empty: nothing speaks against it."""
        return together(self.verdict, self.coarse)

    def __getitem__(self, name: str) -> Array:
        """Return one output over time."""
        names = [v.name for v in self.variables]
        if name not in names:
            raise UserError(f"no output {name!r}{suggest(name, names)}")
        return self.values[:, names.index(name)]

    def as_dict(self) -> dict[str, Array]:
        """Return every output over time, by name."""
        return {v.name: self.values[:, i] for i, v in enumerate(self.variables)}

    def write_csv(self, path: Path) -> None:
        """Write time and outputs; the header names each with its unit."""
        with path.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["time [s]", *(f"{v.name} [{v.unit}]" for v in self.variables)])
            for t, row in zip(self.times, self.values, strict=True):
                writer.writerow([repr(float(t)), *(repr(float(x)) for x in row)])


def communication_points(stop_time: float, interval: float) -> Array:
    """Return 0, interval, 2 interval, ... and the stop time, s; UserError where there are none or too many."""
    stop_time, interval = finite("stop time", stop_time), finite("interval", interval)
    if not (stop_time > 0.0 and interval > 0.0 and stop_time / interval <= MOST):
        raise UserError(
            f"points every {interval!r} s until {stop_time!r} s; allowed: times greater than zero, {MOST:g} points"
        )
    count = int(np.ceil(stop_time / interval - 1e-9))
    times: Array = np.minimum(interval * np.arange(count + 1), stop_time)
    return times


def run(
    model: Model,
    settings: Settings,
    times: Array,
    progress: Callable[[float], None] | None = None,
    watch: Callable[[Simulation], None] | None = None,
    warn: Callable[[str], None] | None = None,
) -> Result:
    """Run a model natively, without an FMU, and record its outputs at ``times``; stops at a failure.

    ``watch`` is shown the simulation whenever its outputs have been read: its bodies are in place then. ``warn`` is
    told at once when the energy balance is lost; the run goes on.

    Raises
    ------
    UserError
        Times that do not ascend, and what :class:`Simulation` raises.
    """
    times = array_of("times", times)
    if times.ndim != 1 or not len(times) or not np.isfinite(times).all() or np.any(np.diff(times) <= 0.0):
        raise UserError(f"times are {times!r}; they must be finite numbers in one row, each later than the one before")
    simulation = Simulation(model, settings, float(times[0]))
    values = np.zeros((len(times), len(simulation.variables)))
    values[0] = simulation.outputs()
    if watch is not None:
        watch(simulation)
    begin, done, failure, told = time.perf_counter(), 1, "", ""
    while done < len(times) and not failure:
        rows = slice(done, done + (ROWS if watch is None else 1))
        done += simulation.record(times[rows], values[rows])
        if warn is not None and simulation.verdict != told:
            told = simulation.verdict
            warn(told)
        failure = simulation.failure
        if failure:
            break
        if watch is not None:
            watch(simulation)
        if progress is not None:
            progress(float(times[done - 1]))
    wall = time.perf_counter() - begin
    coarse = "" if failure else simulation.coarse
    found = times[:done], values[:done], simulation.variables, simulation.statistics
    return Result(*found, wall, failure, simulation.verdict, coarse, tuple(simulation.remarks))

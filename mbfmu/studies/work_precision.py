"""Pictures of a comparison: error against time, and the energy balance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from mbfmu.plotting.figures import SOLVER_COLORS, finish, subplots
from mbfmu.studies.compare import Comparison, Row, error_of_complete
from mbfmu.studies.comparison_report import label, listed
from mbfmu.studies.resolution import resolution_text
from mbfmu.util.text_table import format_tolerance

MARKERS = "os^DvP*X"  # by resolution, coarse to fine
NEAR_UNCERTAINTY_FACTOR = 100.0  # times: the uncertainty of the reference is drawn if errors come this near
MAX_LABELED_ERROR_RATIO = 0.9  # largest error of the next labeled run of the Pareto front, relative to the last one
CAPTION_WIDTH = 90  # letters of a line below the picture
OTHER_COLOR = "#606060"  # of what has no color
HULL_COLOR = "#b8b8b8"


def plot_work_precision(found: Comparison, title: str, path: Path) -> None:
    """Draw error against CPU time, log-log: a line for each solver at each resolution, and the Pareto front.

    Points are labeled by their tolerance, at several resolutions those of the Pareto front alone. Runs that are
    inaccurate or on a wrong branch are faint crosses. Runs that ended early have no error and are listed below.
    """
    figure, ax = subplots(size=(7.4, 5.8))
    best = found.best()
    steps = list(dict.fromkeys(resolution_text(row.resolution) for row in found.rows))
    solvers = list(dict.fromkeys(row.solver for row in found.rows))
    ended = [row for row in found.rows if row.error]  # one that is the reference itself has none
    _hull(ax, best)
    for k, solver in enumerate(solvers):
        for step, marker in zip(steps, MARKERS * len(steps), strict=False):
            own = [row for row in ended if row.solver == solver and resolution_text(row.resolution) == step]
            _line(ax, [row for row in own if row.trusted], marker, k)
            _crosses(ax, [row for row in own if not row.trusted])
        ax.plot([], [], "-", color=SOLVER_COLORS.get(solver, OTHER_COLOR), label=solver)
    if len(steps) > 1:
        for step, marker in zip(steps, MARKERS * len(steps), strict=False):
            ax.plot([], [], marker, color=OTHER_COLOR, label=step)
    if any(not row.trusted for row in ended):
        ax.plot([], [], "x", color=OTHER_COLOR, label="inaccurate or on a wrong branch")
    for row in ended if len(steps) == 1 else [*separated_errors(best), *_unconnected_runs(ended, best)]:
        _name(ax, row, above=solvers.index(row.solver) % 2 == 0 or len(steps) > 1)
    _doubt(ax, found, ended)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda seconds, _: f"{1e3 * seconds:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_xlabel(f"CPU time of the integration alone [ms]{_not_drawn(found.rows)}")
    ax.set_ylabel(_measure(found))
    ax.set_title(title)
    ax.margins(x=0.09, y=0.07)
    ax.grid(alpha=0.3, which="both")
    if not ended:
        ax.text(0.5, 0.5, "no run reached its end", transform=ax.transAxes, ha="center")
    figure.legend(loc="outside lower center", ncols=3 if len(steps) > 1 else 4, fontsize=9, frameon=False)
    finish(figure, path)


def separated_errors(best: Sequence[Row]) -> list[Row]:
    """Return the runs of the Pareto front whose error is clearly below that of the run before."""
    found: list[Row] = []
    for row in best:
        if not found or height(row) < MAX_LABELED_ERROR_RATIO * height(found[-1]):
            found.append(row)
    return found


def _unconnected_runs(rows: Sequence[Row], best: Sequence[Row]) -> list[Row]:
    """Return the runs outside the Pareto front that no line connects to another tolerance, and inaccurate ones."""
    lines = Counter((row.solver, resolution_text(row.resolution)) for row in rows if row.trusted)
    single = [row for row in rows if not row.trusted or lines[row.solver, resolution_text(row.resolution)] == 1]
    return [row for row in single if row not in best]


def height(row: Row) -> float:
    """Return the error of a row that reached its end, as it is drawn."""
    return error_of_complete(row.error)


def _hull(ax: Any, best: Sequence[Row]) -> None:
    """Draw what the best choice gives for a time: it stays till the next one is as cheap."""
    if best:
        at, errors = [row.cpu_s for row in best], [height(row) for row in best]
        style = {"color": HULL_COLOR, "lw": 6.0, "alpha": 0.6, "zorder": 1.0, "solid_joinstyle": "round"}
        ax.plot(at, errors, drawstyle="steps-post", label="Pareto front", **style)


def _line(ax: Any, rows: Sequence[Row], marker: str, k: int) -> None:
    """Draw the rows of one solver at one resolution; the k-th solver is thinner than those it may hide."""
    ordered = sorted(rows, key=lambda row: -row.rtol)
    at, errors = [row.cpu_s for row in ordered], [height(row) for row in ordered]
    style = {"color": SOLVER_COLORS.get(ordered[0].solver, OTHER_COLOR) if ordered else OTHER_COLOR, "zorder": 3.0 + k}
    ax.plot(at, errors, "-", marker=marker, ms=8.0 * 0.85**k, lw=2.2 * 0.8**k, **style)


def _crosses(ax: Any, rows: Sequence[Row]) -> None:
    for row in rows:
        style = {"color": SOLVER_COLORS.get(row.solver, OTHER_COLOR), "alpha": 0.5, "zorder": 9.0}
        ax.plot(row.cpu_s, height(row), "x", ms=8.0, mew=1.5, **style)


def _name(ax: Any, row: Row, *, above: bool) -> None:
    """Write the tolerance next to a point: away from the line, which falls to the right."""
    side = 1 if above else -1
    place = {"ha": "left" if above else "right", "va": "bottom" if above else "top"}
    at = {"xytext": (5 * side, 4 * side), "textcoords": "offset points"}
    ax.annotate(format_tolerance(row.rtol), (row.cpu_s, height(row)), fontsize=7, zorder=10.0, **at, **place)


def _doubt(ax: Any, found: Comparison, ended: Sequence[Row]) -> None:
    """Shade the uncertainty of the reference if errors come near."""
    doubt, _ = found.reference.doubt
    if any(height(row) < NEAR_UNCERTAINTY_FACTOR * doubt for row in ended):
        least = min(doubt, *(height(row) for row in ended))
        shade = {"color": "#808080", "alpha": 0.12, "lw": 0.0, "zorder": 0.5}
        ax.axhspan(0.5 * least, doubt, label="uncertainty of the reference", **shade)


def _not_drawn(rows: Sequence[Row]) -> str:
    failed = [f"{row.solver} {label(row)}" for row in rows if row.error is None]
    return "\n" + fill(f"not drawn, ended early: {listed(failed)}", CAPTION_WIDTH) if failed else ""


def _measure(found: Comparison) -> str:
    """Return what the error is of."""
    names = list(found.reference.units)
    if len(names) > 1:
        return "largest error of an output, relative to its range"
    scale, unit = found.reference.motion.scale[names[0]], found.reference.units[names[0]]
    return f"largest error of {names[0]}, relative to its range {scale:.3g} {unit}"


def plot_energy(found: Comparison, title: str, path: Path) -> None:
    """Draw the energy's energy_error against time, one line a solver, from the first output after the start on."""
    figure, ax = subplots(size=(8.0, 4.5))
    for solver, (times, energy_error) in found.energies.items():
        if np.isfinite(energy_error).any():
            shown = np.maximum(np.abs(energy_error[1:]), 1e-14)
            ax.semilogy(times[1:], shown, lw=1.0, color=SOLVER_COLORS.get(solver, OTHER_COLOR), label=solver)
    if not ax.lines:
        ax.text(0.5, 0.5, "the energy balance was not checked", transform=ax.transAxes, ha="center")
    else:
        ax.legend()
    ax.set_xlabel("time [s]")
    ax.set_ylabel("|energy - energy at the start - work| [J]")
    ax.set_title(f"{title}, tolerance {format_tolerance(found.tolerance)}")
    ax.grid(alpha=0.3)
    finish(figure, path)

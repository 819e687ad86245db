"""Outputs over time as curves: a panel for each quantity, residuals on a separate axis."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.util.errors import UserError, suggest

from .figures import finish, new_figure

if TYPE_CHECKING:
    from mbfmu.session.result import Result

QUANTITIES = {
    "m": "position",
    "m/s": "velocity",
    "m/s2": "acceleration",
    "rad": "angle",
    "rad/s": "angular velocity",
    "rad/s2": "angular acceleration",
    "N": "force",
    "N.m": "moment",
    "J": "energy",
    "W": "power",
    "1": "number",
}
ENERGY_ERROR_NAME = "energy_error"
RESIDUAL_NAME_ENDINGS = ("residual", ENERGY_ERROR_NAME)  # endings of the names of errors, whose exact value is zero
# endings of the names that are left out unless they are requested
CHECK_NAME_ENDINGS = (*RESIDUAL_NAME_ENDINGS, "energy_throughput")
MAX_CURVES = 12  # in a panel
PANEL_HEIGHT = 1.55  # inches
MAX_PANELS = 6  # in a figure for which no names are given
# inches: of the axis labels, of the lines of the title and of the time axis, between panels
LEFT_MARGIN, LINE_HEIGHT, PANEL_GAP = 1.15, 0.19, 0.12
LEGEND_MARGIN, LEGEND_CHARACTER = 0.45, 0.062  # inches, of the lines of a legend, and of a character of its text
OVERLAP_FRACTION = 0.01  # of the height of a panel: curves nearer than this hide each other
DASHES = ("-", (0, (6, 3)), (0, (2, 2)), (0, (8, 2, 2, 2)))
COLOR_COUNT = 10  # before they are repeated with other dashes
LINE_WIDTHS = (1.0, 3.0)  # points; of a curve, and of one under others that are dashed
MIN_RELATIVE_SPAN = 1e-6  # of the size of its values: a panel is not lower, or it would show their rounding
LOG_AXIS_RATIO = 1e-9  # of its largest value: how far down a logarithmic panel goes
FAILURE_COLOR = "#c62828"
GRID_ALPHA = 0.3


def matching(known: Sequence[str], asked: Sequence[str]) -> list[str]:
    """Return the requested names in their order, each once; ``*`` and ``?`` match any letters.

    Raises
    ------
    UserError
        One of them is no output, and no pattern that any output fits.
    """
    found: dict[str, None] = {}
    for name in asked:
        pattern = name.replace("[", "[[]")  # brackets are parts of names
        fitting = [name] if name in known else [other for other in known if fnmatchcase(other, pattern)]
        if not fitting:
            raise UserError(f"no output {name!r}{suggest(name, known)}")
        found |= dict.fromkeys(fitting)
    return list(found)


def errors_of(result: Result) -> list[str]:
    """Return the names of the outputs that are errors: residuals of the constraints, and the energy error if known."""
    names = [name for name in reversed(result.names) if name.endswith(RESIDUAL_NAME_ENDINGS)]
    return [name for name in names if np.isfinite(result[name]).any()]


def panels(result: Result, names: Sequence[str]) -> dict[tuple[str, str], list[int]]:
    """Return the columns of every panel, by quantity and unit; without names those of the outputs that are no checks.

    If the model has no other outputs the checks are drawn.
    """
    shown = matching(result.names, names) or [name for name in result.names if not name.endswith(CHECK_NAME_ENDINGS)]
    found: dict[tuple[str, str], list[int]] = {}
    for i in map(result.column, shown or result.names):
        variable = result.variables[i]
        if not np.isfinite(result.values[:, i]).any():
            continue  # it is not known in this run
        quantity = "residual" if variable.name.endswith(RESIDUAL_NAME_ENDINGS) else QUANTITIES.get(variable.unit, "")
        quantity = "energy error" if variable.name == ENERGY_ERROR_NAME else quantity
        found.setdefault((quantity, variable.unit), []).append(i)
    return found


def size(result: Result, names: Sequence[str]) -> tuple[float, float]:
    """Return width and height of the figure, inches."""
    count = len(panels(result, names))
    return 9.0, 1.0 + 0.5 * bool(status_label(result)) + PANEL_HEIGHT * max(
        1, count if names else min(count, MAX_PANELS)
    )


def draw(figure: Any, result: Result, names: Sequence[str] = ()) -> None:
    """Draw these outputs, or the first of each unit, into a figure of :func:`size`.

    The title contains model, scene, solver and tolerance, and the reason if a run may be wrong.
    """
    every = panels(result, names)
    groups = dict(list(every.items())[: None if names else MAX_PANELS])
    marker = "o" if len(result.t) == 1 else None  # a point has no line
    axes = figure.subplots(max(1, len(groups)), 1, sharex=True, squeeze=False)[:, 0]
    for ax, ((quantity, unit), columns) in zip(axes, groups.items(), strict=False):
        shown = columns if names else columns[:MAX_CURVES]
        curves = result.values[:, shown]
        if quantity in ("residual", "energy error"):
            logarithmic(ax, curves)
            curves = np.where(curves == 0.0, np.nan, np.abs(curves))
        elif (span := extent(curves)) != (np.nanmin(curves), np.nanmax(curves)):
            ax.set_ylim(span)
        for i, curve, style in zip(shown, curves.T, styles(curves), strict=True):
            ax.plot(result.t, curve, **style, marker=marker, label=result.variables[i].name)
        ax.set_ylabel(f"{quantity} [{unit}]" if quantity else f"[{unit}]")
        ax.grid(alpha=GRID_ALPHA)
        left = len(columns) - len(shown)
        ax.legend(
            fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, title_fontsize=7,
            title=f"{left} more not shown" if left else None,
        )  # fmt: skip
    if result.failed:
        for ax in axes:
            ax.axvline(result.t[-1], color=FAILURE_COLOR, lw=1.5)
    units = [key[1] for key in every if key not in groups]
    axes[-1].set_xlabel(f"time [s]\nnot shown: outputs in {', '.join(units)}" if units else "time [s]")
    set_title(figure, result)


def status_label(result: Result) -> str:
    """Return in capitals how a run failed; empty: it did not."""
    if result.failed:
        return f"FAILED at {result.t[-1]:.6g} s"
    return "INACCURATE: the energy error is larger than the tolerance explains" if result.inaccurate else ""


def set_title(figure: Any, result: Result) -> None:
    """Write the title; in red with the reason if the run failed or is inaccurate."""
    wrong = status_label(result)
    if not wrong:
        figure.suptitle(result.title)
        return
    reason = result.problems[0].text
    figure.suptitle(f"{result.title}\n{wrong}\n{fill(reason, 110)}", color=FAILURE_COLOR, fontsize=10)


def logarithmic(ax: Any, curves: Any) -> None:
    """Make an axis logarithmic, down to values that are visible next to the largest one."""
    ax.set_yscale("log", subs=[])  # without ticks between powers of ten, which take longer than the curves
    ax.yaxis.set_major_formatter("{x:.0e}")  # as do powers in the notation of formulas
    largest = float(np.nanmax(np.abs(curves)))
    if 0.0 < largest < np.inf:
        smallest = float(np.nanmin(np.abs(curves)[curves != 0.0]))
        ax.set_ylim(max(0.5 * smallest, LOG_AXIS_RATIO * largest), 2.0 * largest)


def extent(curves: Any) -> tuple[float, float]:
    """Return the lowest and the highest value, not so near to each other that only their rounding is between them."""
    known = curves[np.isfinite(curves)]
    if not known.size:
        return 0.0, 0.0
    low, high = float(known.min()), float(known.max())
    largest = max(abs(low), abs(high))
    margin = 0.05 * largest if high - low < MIN_RELATIVE_SPAN * largest else 0.0
    return low - margin, high + margin


def styles(curves: Any) -> list[dict[str, Any]]:
    """Return how each curve (k, curves) is drawn: one that lies on others is dashed, and those beneath are wide."""
    low, high = extent(curves)
    found: list[int] = []
    beneath: set[int] = set()
    for i in range(curves.shape[1]):
        hidden = [
            j for j in range(i) if np.nanmax(np.abs(curves[:, i] - curves[:, j])) <= OVERLAP_FRACTION * (high - low)
        ]
        taken = [found[j] for j in hidden]
        dashes = range(1, len(DASHES)) if hidden else [i // COLOR_COUNT % len(DASHES)]
        found.append(min(dashes, key=taken.count))
        beneath.update(j for j in hidden if found[j] == 0)
    return [
        {
            "color": f"C{i % COLOR_COUNT}",
            "ls": DASHES[k],
            "lw": LINE_WIDTHS[i in beneath],
            "alpha": 0.5 if i in beneath else 1.0,
        }
        for i, k in enumerate(found)
    ]


def arrange(figure: Any) -> None:
    """Place the panels of :func:`draw` by the lengths of their texts: matplotlib's layout takes as long as drawing."""
    (width, height), axes = figure.get_size_inches(), figure.axes
    labels = [text.get_text() for ax in axes if ax.get_legend() for text in ax.get_legend().get_texts()]
    right = LEGEND_MARGIN + LEGEND_CHARACTER * max(map(len, labels), default=0)
    title, below = (text.count("\n") + 1.5 for text in (figure.get_suptitle(), axes[-1].get_xlabel()))
    top, bottom = height - LINE_HEIGHT * title, LINE_HEIGHT * (below + 1.0)
    for text in figure.texts:  # the title
        text.set_y(1.0 - 0.25 * LINE_HEIGHT / height)
    each = (top - bottom - PANEL_GAP * (len(axes) - 1)) / len(axes)
    figure.subplots_adjust(
        left=LEFT_MARGIN / width, right=max(0.5, 1.0 - right / width),
        top=top / height, bottom=bottom / height, hspace=PANEL_GAP / each,
    )  # fmt: skip


def replace_upper_time_axes(figure: Any) -> None:
    """Replace the ticks of the time axes above the lowest by one set of grid lines: a tick takes as long as a curve."""
    from matplotlib import rcParams

    *upper, lowest = figure.axes
    begin, end = lowest.get_xlim()
    ticks = [tick for tick in lowest.get_xticks() if begin <= tick <= end]
    width, color = rcParams["grid.linewidth"], rcParams["grid.color"]
    for ax in upper:
        ax.xaxis.set_visible(False)
        ax.vlines(
            ticks, 0.0, 1.0, transform=ax.get_xaxis_transform(), colors=color, linewidths=width, alpha=GRID_ALPHA,
            zorder=0.9,
        )  # fmt: skip


def plot_result(result: Result, path: Path, names: Sequence[str] = ()) -> None:
    """Draw outputs over time as :meth:`mbfmu.Result.plot` does."""
    figure = new_figure(size(result, names), is_arranged=False)
    draw(figure, result, names)
    arrange(figure)
    replace_upper_time_axes(figure)
    finish(figure, path)

"""Pictures of a study: measures over what varies, their distributions, and what matters."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mbfmu.plotting.figures import finish, new_figure

from .definition import Definition
from .sensitivity import sobol_indices, tornado
from .study import Study
from .variation import Listed
from .worker import STATUS_FAILED, STATUS_SUSPECT

BLUE, RED, ORANGE, GRAY = "#4269d0", "#ff725c", "#efb118", "#9498a0"
QUANTILES = (0.05, 0.5, 0.95)
MAX_STUDY_PANELS = 12  # panels of a picture
MANY_DOTS_RUNS = 2000  # runs above which dots are thin


def draw(study: Study, definition: Definition, folder: Path) -> list[Path]:
    """Write the pictures that suit a study into a folder; return their paths."""
    found = []
    for measure in study.measures:
        for kind, figure in _figures(study, definition, measure):
            found.append(folder / f"{measure}-{kind}.png")
            finish(figure, found[-1])
    return found


def _figures(study: Study, definition: Definition, measure: str) -> Iterator[tuple[str, Any]]:
    method = definition.sampling.method
    finite = np.isfinite(_numbers(study, measure))
    if not finite.any():
        return
    if method == "tornado" and not definition.aim:
        yield "tornado", _tornado(study, measure)
        return
    names = [name for name in study.varied if _is_number(study, name)]
    grids = [name for name in names if isinstance(definition.vary[name], Listed)]
    if len(grids) == 2 == len(study.varied) and not definition.sampling.together:
        yield "contour", _contour(study, measure, grids)
    elif names:
        yield "over", _scatter(study, measure, names[:MAX_STUDY_PANELS])
    if any(not isinstance(own, Listed) for own in definition.vary.values()) and not definition.aim:
        yield "distribution", _histogram(study, measure)
    if method == "sensitivity" and not definition.aim and finite.all():
        yield "sensitivity", _indices(study, measure, definition.sampling.count)


def _numbers(study: Study, name: str) -> Any:
    return np.array([row[name] if row[name] is not None else np.nan for row in study.rows], float)


def _is_number(study: Study, name: str) -> bool:
    return all(isinstance(row[name], int | float) for row in study.rows)


def _label(study: Study, name: str) -> str:
    unit = study.units.get(name, "")
    return f"{name} [{unit}]" if unit not in ("", "1") else name


def _scatter(study: Study, measure: str, names: list[str]) -> Any:
    """Draw a measure over everything that varies, a panel each; failed runs are ticks at the bottom."""
    columns = min(len(names), 3)
    rows = -(-len(names) // columns)
    figure = new_figure((1.2 + 3.6 * columns, 0.6 + 3.0 * rows))
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False)
    y, status = _numbers(study, measure), np.array([row["status"] for row in study.rows])
    size = 14.0 if len(y) < MANY_DOTS_RUNS else 3.0
    for ax, name in zip(panels.flat, names, strict=False):
        x, failed, suspect = _numbers(study, name), status == STATUS_FAILED, status == STATUS_SUSPECT
        ax.scatter(x, y, s=size, color=BLUE, alpha=0.6, linewidths=0, rasterized=True)
        ax.scatter(x[suspect], y[suspect], s=2.0 * size, color=ORANGE, linewidths=0, label=f"{suspect.sum()} suspect")
        ax.plot(x[failed], np.full(failed.sum(), 0.02), "|", color=RED, transform=ax.get_xaxis_transform(),
                label=f"{failed.sum()} failed")  # fmt: skip
        ax.set_xlabel(_label(study, name))
        ax.locator_params(axis="x", nbins=5)
        ax.ticklabel_format(axis="x", scilimits=(-3, 4))
    for ax in panels.flat[len(names) :]:
        ax.set_axis_off()
    for ax in panels[:, 0]:
        ax.set_ylabel(_label(study, measure))
    if np.any(status != "ok"):
        shown = [h for h, n in ((0, np.sum(status == STATUS_SUSPECT)), (1, np.sum(status == STATUS_FAILED))) if n]
        handles, labels = panels[0, 0].get_legend_handles_labels()
        panels[0, 0].legend([handles[k] for k in shown], [labels[k] for k in shown], fontsize=8)
    figure.suptitle(f"{study.name}: {len(study.rows)} runs", fontsize=10)
    return figure


def _contour(study: Study, measure: str, names: list[str]) -> Any:
    """Draw a measure over a grid of two lists."""
    x, y = (np.unique(_numbers(study, name)) for name in names)
    z = np.full((len(y), len(x)), np.nan)
    i, j = (np.searchsorted(axis, _numbers(study, name)) for axis, name in zip((x, y), names, strict=True))
    z[j, i] = _numbers(study, measure)
    figure = new_figure((6.4, 4.8))
    ax = figure.subplots()
    if min(z.shape) > 1 and np.nanmax(z) > np.nanmin(z):
        filled: Any = ax.contourf(x, y, z, levels=14, cmap="viridis")
        ax.contour(x, y, z, levels=14, colors="white", linewidths=0.3)
    else:
        filled = ax.pcolormesh(x, y, z, cmap="viridis")
    ax.plot(*np.meshgrid(x, y), ".", color="black", ms=1.5, alpha=0.4)
    failed = np.array([row["status"] == STATUS_FAILED for row in study.rows])
    if failed.any():
        ax.plot(x[i[failed]], y[j[failed]], "x", color=RED, ms=5.0, label=f"{failed.sum()} failed")
        ax.legend(fontsize=8)
    figure.colorbar(filled, label=_label(study, measure))
    ax.set(xlabel=_label(study, names[0]), ylabel=_label(study, names[1]))
    ax.set_title(f"{study.name}: {len(study.rows)} runs", fontsize=10)
    return figure


def _histogram(study: Study, measure: str) -> Any:
    """Draw how a measure is distributed, with quantiles."""
    y = _numbers(study, measure)
    y = y[np.isfinite(y)]
    figure = new_figure((6.4, 4.0))
    ax = figure.subplots()
    ax.hist(y, bins=min(60, max(8, round(len(y) ** 0.5))), color=BLUE, alpha=0.7)
    for part, at in zip(QUANTILES, np.quantile(y, QUANTILES), strict=True):
        ax.axvline(at, color=RED if part == 0.5 else GRAY, lw=1.2)
        ax.text(at, 1.0, f" {100 * part:g} %\n {at:.4g}", transform=ax.get_xaxis_transform(), va="top", fontsize=8)
    failed = study.count(STATUS_FAILED)
    ax.set(xlabel=_label(study, measure), ylabel="runs")
    ax.set_title(f"{study.name}: {len(y)} runs" + (f", {failed} failed" if failed else ""), fontsize=10)
    return figure


def _indices(study: Study, measure: str, count: int) -> Any:
    """Draw Sobol's indices as bars with their confidence intervals."""
    own = sobol_indices(study, measure, count)
    order, at = np.argsort(own.total), np.arange(len(own.names))
    figure = new_figure((6.4, 1.4 + 0.45 * len(at)))
    ax = figure.subplots()
    ax.barh(at + 0.2, own.total[order], 0.36, xerr=own.total_error[order], color=BLUE, label="in all", capsize=2)
    ax.barh(at - 0.2, own.first[order], 0.36, xerr=own.first_error[order], color=ORANGE, label="alone", capsize=2)
    ax.set_yticks(at, [own.names[k] for k in order])
    ax.set_xlabel(f"part of the variance of {measure}")
    ax.legend(fontsize=8, loc="lower right")
    ax.set_title(f"{study.name}: Sobol's indices, {len(study.rows)} runs", fontsize=10)
    return figure


def _tornado(study: Study, measure: str) -> Any:
    """Draw a measure at the ends of each number."""
    own = tornado(study, measure)
    figure = new_figure((6.4, 1.4 + 0.45 * len(own.names)))
    ax = figure.subplots()
    for k, (low, high) in enumerate(own.ends[::-1]):
        ax.barh(k, low - own.middle, left=own.middle, color=ORANGE, label="low end" if k == 0 else None)
        ax.barh(k, high - own.middle, left=own.middle, color=BLUE, label="high end" if k == 0 else None)
    ax.axvline(own.middle, color="black", lw=0.8)
    ax.set_yticks(range(len(own.names)), own.names[::-1])
    ax.set_xlabel(_label(study, measure))
    ax.legend(fontsize=8)
    ax.set_title(f"{study.name}: one at a time, from 5 % to 95 %", fontsize=10)
    return figure

"""Figures that no window shows, and colors of solvers."""

from __future__ import annotations

from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbfmu.util.files import replacing
from solvers.steppers import SOLVER_NAMES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOR_CYCLE = ("#4269d0", "#3ca951", "#efb118", "#ff725c", "#a463f2", "#38b2c4", "#ff8ab7", "#9c6b4e")
SOLVER_COLORS = dict(zip(SOLVER_NAMES, cycle(COLOR_CYCLE), strict=False))  # by solver


def new_figure(size: tuple[float, float], *, is_arranged: bool = True) -> Figure:
    """Return an empty figure of this size (inches), whose parts matplotlib arranges if ``is_arranged``."""
    from matplotlib.figure import Figure  # takes as long to import as the rest: where there are pictures only

    return Figure(figsize=size, layout="constrained" if is_arranged else None)


def subplots(rows: int = 1, columns: int = 1, *, size: tuple[float, float], **options: Any) -> tuple[Any, Any]:
    """Return a figure of this size (inches) that no window shows, and its axes."""
    figure = new_figure(size)
    return figure, figure.subplots(rows, columns, **options)


def panels(count: int) -> tuple[Any, Any]:
    """Return a figure and the axes (count,) of as many panels."""
    columns = min(4, count)
    rows = -(-count // columns)
    figure, axes = subplots(rows, columns, size=(3.0 * columns, 2.6 * rows), squeeze=False)
    for ax in axes.flat[count:]:
        ax.axis("off")
    return figure, axes.flat[:count]


def finish(figure: Any, path: Path) -> None:
    """Arrange the parts of the figure, and write the picture."""
    if layout := figure.get_layout_engine():
        layout.execute(figure)
        figure.set_layout_engine("none")  # arranged, which writing would do twice
    kind = path.suffix[1:] or "png"
    options = {"pil_kwargs": {"compress_level": 1}} if kind == "png" else {}
    with replacing(path) as unfinished:
        figure.savefig(unfinished, dpi=130, format=kind, **options)

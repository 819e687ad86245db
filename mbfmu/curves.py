"""Outputs over time as curves: a panel a quantity, residuals on an axis of their own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from mbfmu.result import Result

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
RESIDUALS = ("residual", "imbalance")  # how names end of what should be nothing
MOST = 12  # curves in a panel
ALIKE = 0.01  # of the height of a panel: curves nearer than this hide each other
DASHES = ("-", (0, (6, 3)), (0, (2, 2)), (0, (8, 2, 2, 2)))


def panels(result: Result, names: Sequence[str]) -> dict[tuple[str, str], list[int]]:
    """Return the columns of every panel, by quantity and unit."""
    found: dict[tuple[str, str], list[int]] = {}
    for i in map(result.column, names or result.names):
        variable = result.variables[i]
        if not np.isfinite(result.values[:, i]).any():
            continue  # it is not known in this run
        residual = variable.name.endswith(RESIDUALS)
        quantity = "residual" if residual else QUANTITIES.get(variable.unit, "")
        found.setdefault((quantity, variable.unit), []).append(i)
    return found


def size(result: Result, names: Sequence[str]) -> tuple[float, float]:
    """Return width and height of the figure, inches."""
    return 9.0, 1.0 + 1.9 * max(1, len(panels(result, names)))


def draw(figure: Any, result: Result, names: Sequence[str] = ()) -> None:
    """Draw these outputs, or all, into a figure of :func:`size`; the title says model, solver and tolerance."""
    groups = panels(result, names)
    axes = figure.subplots(max(1, len(groups)), 1, sharex=True, squeeze=False)[:, 0]
    for ax, ((quantity, unit), columns) in zip(axes, groups.items(), strict=False):
        shown = columns if names else columns[:MOST]
        for i, dashes in zip(shown, styles(result.values[:, shown]), strict=True):
            curve = result.values[:, i]
            if quantity == "residual":
                curve = np.maximum(np.abs(curve), 1e-17)
            ax.plot(result.t, curve, ls=dashes, lw=1.0, label=result.variables[i].name)
        if quantity == "residual":
            ax.set_yscale("log")
        ax.set_ylabel(f"{quantity} [{unit}]" if quantity else f"[{unit}]")
        ax.grid(alpha=0.3)
        left = len(columns) - len(shown)
        ax.legend(
            fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, title_fontsize=7,
            title=f"{left} more are not shown" if left else None,
        )  # fmt: skip
    axes[-1].set_xlabel("time [s]")
    figure.suptitle(result.title + (", ended early" if result.failure else ""))


def styles(curves: Any) -> list[Any]:
    """Return the dashes of each curve (k, curves): those that lie on one before get others than it has."""
    height = float(np.ptp(curves[np.isfinite(curves)])) if np.isfinite(curves).any() else 0.0
    found: list[int] = []
    for i in range(curves.shape[1]):
        hidden = [found[j] for j in range(i) if np.nanmax(np.abs(curves[:, i] - curves[:, j])) <= ALIKE * height]
        found.append(next((k for k in range(len(DASHES)) if k not in hidden), 0))
    return [DASHES[k] for k in found]

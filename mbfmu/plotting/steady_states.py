"""Plots of steady states over a parameter or along a path."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from solvers.statics.spectrum import Stability

from .figures import finish, subplots

if TYPE_CHECKING:
    from mbfmu.steady.path import EquilibriumPath
    from mbfmu.steady.sweep import Branch

STABILITY_STYLES = {  # color, line and marker
    Stability.STABLE: ("#4269d0", "-", "o"),
    Stability.UNDAMPED: ("#6cc5b0", "-", "o"),
    Stability.NEUTRAL: ("#9c6b4e", ":", "s"),
    Stability.UNSTABLE: ("#ff725c", "--", "x"),
    Stability.UNKNOWN: ("#97999d", "-.", "^"),
}


def plot_branches(branches: Sequence[Branch], axis: str, output: str, title: str, path: Path) -> None:
    """Draw an output over a swept parameter: a line style for each kind of stability."""
    figure, ax = subplots(size=(8.0, 5.0))
    labeled: set[str] = set()
    for branch in branches:
        values = np.array(branch.values)
        heights = np.array([state.outputs[output] for state in branch.states])
        found = np.array([state.stability for state in branch.states])
        for label, (color, line, marker) in STABILITY_STYLES.items():
            own = found == label
            if own.any():
                shown = None if label in labeled else label
                labeled.add(label)
                style = {"ls": line, "marker": marker, "ms": 3.0, "lw": 1.2, "color": color, "label": shown}
                ax.plot(values, np.where(own, heights, np.nan), **style)
    unit = next(v.unit for v in branches[0].states[0].compiled.outputs if v.name == output)
    ax.set_xlabel(axis)
    ax.set_ylabel(f"{output} [{unit}]")
    ax.set_title(title)
    ax.grid(alpha=0.3)
    ax.legend()
    finish(figure, path)


def plot_path(path: EquilibriumPath, output: str, title: str, file: Path) -> None:
    """Draw the input of an equilibrium path against an output: unstable parts dashed, singular points marked."""
    figure, ax = subplots(size=(8.0, 5.0))
    marks = {"limit point": ("o", "#efb118"), "bifurcation": ("D", "#a463f2")}
    labeled: set[str] = set()

    def label(text: str) -> str | None:
        new = text not in labeled
        labeled.add(text)
        return text if new else None

    for branch in path.branches:
        x, y = np.array(branch.output(output)), np.array(branch.values)
        worst = list(Stability)
        found = np.array([worst.index(state.stability) for state in branch.states])
        for k in range(len(found) - 1):  # a piece of the line is what the less stable of its ends is
            text = worst[max(found[k], found[k + 1])]
            color, line, _ = STABILITY_STYLES[text]
            ax.plot(x[k : k + 2], y[k : k + 2], ls=line, lw=1.4, color=color, label=label(text))
    for branch in path.branches:
        for kind, (marker, color) in marks.items():
            for state in branch.of_kind(kind):
                at = state.outputs[output], state.value
                ax.plot(*at, marker, ms=6.0, mec="black", mfc=color, label=label(kind), zorder=3)
    ax.set_xlabel(f"{output} [{path.units[output]}]")
    ax.set_ylabel(f"{path.input} [{path.unit}]")
    ax.set_title(title)
    ax.grid(alpha=0.3)
    ax.legend()
    finish(figure, file)

"""Pictures of results."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from numpy.lib.stride_tricks import sliding_window_view

from mbfmu.curves import draw, size
from mbfmu.files import replacing
from mbfmu.viewer.motion import amplitudes
from mbfmu.viewer.picture import PALETTE
from mbfmu.viewer.picture import draw as picture_of
from solvers.statics.spectrum import Stability
from solvers.steppers import NAMES

if TYPE_CHECKING:
    from mbfmu.direct import Result
    from mbfmu.mechanics import Plant
    from mbfmu.steady.modes import ModeShape
    from mbfmu.steady.path import EquilibriumPath
    from mbfmu.steady.sweep import Branch
    from mbfmu.viewer.picture import Bar
    from solvers.system import Array

CYCLE = ("#4269d0", "#3ca951", "#efb118", "#ff725c", "#a463f2", "#38b2c4", "#ff8ab7", "#9c6b4e")
COLORS = dict(zip(NAMES, cycle(CYCLE), strict=False))  # by solver
ROUNDING = 1e-4  # of the largest deflection: less is taken for none
IN_STEP = 0.01  # of the largest displacement: out of step less than this does not show


def subplots(rows: int = 1, columns: int = 1, *, size: tuple[float, float], **options: Any) -> tuple[Any, Any]:
    """Return a figure of this size (inches) that no window shows, and its axes."""
    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, **options)


def plot_result(result: Result, path: Path, names: Sequence[str] = ()) -> None:
    """Draw outputs over time as :meth:`mbfmu.Result.plot` does."""
    figure = Figure(figsize=size(result, names), layout="constrained")
    draw(figure, result, names)
    finish(figure, path)


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
    unit = next(v.unit for v in branches[0].states[0].plant.outputs if v.name == output)
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


def plot_shapes(plant: Plant, q: Array, shapes: Sequence[ModeShape], title: str, path: Path) -> None:
    """Draw the deflection of the first surface along its normal, one panel a mode, over its place in the grid."""
    surface = plant.mechanism.surfaces[0]
    at_rest, normals = poses(plant, q, surface.bodies)
    x, z = distances(at_rest[:, at_rest.shape[1] // 2]), distances(at_rest[at_rest.shape[0] // 2])
    figure, axes = panels(len(shapes))
    for number, (ax, shape) in enumerate(zip(axes, shapes, strict=True), 1):
        moved, step = q.copy(), 1e-6 / max(1e-300, float(np.abs(shape.motion).max()))
        plant.system.apply(moved, step * shape.motion)
        deflection = np.einsum("ijk,ijk->ij", poses(plant, moved, surface.bodies)[0] - at_rest, normals)
        share = deflection.T / (float(np.abs(deflection).max()) or 1.0)
        drawn = ax.pcolormesh(x, z, share, cmap="RdBu", vmin=-1.0, vmax=1.0, shading="gouraud")
        settled = without_rounding(share)
        if settled.min() < 0.0 < settled.max():
            ax.contour(x, z, settled, levels=[0.0], colors="black", linewidths=0.6)
        ax.set_aspect("equal")
        ax.tick_params(labelsize=7)
        ax.set_title(f"{number}: {shape.mode.frequency / (2.0 * np.pi):.4g} Hz", fontsize=10)
    figure.colorbar(drawn, ax=list(axes), label="deflection over the largest", shrink=0.8)
    figure.supxlabel(f"along {surface.name} [m]", fontsize=9)
    figure.supylabel("across it [m]", fontsize=9)
    figure.suptitle(f"{title}\ndeflection along the normal; nodal lines black", fontsize=10)
    finish(figure, path)


def distances(points: Array) -> Array:
    """Return how far points (k, 3) are from the first, along the line through them, m."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate(([0.0], np.cumsum(steps)))


def without_rounding(share: Array) -> Array:
    """Return deflections (k, l), shares of the largest, where those that are rounding are what is around them.

    At a clamped edge rounding alone has a sign, along which a nodal line would go.
    """
    known = np.abs(share) > ROUNDING
    padded = (np.pad(values, 1) for values in (np.where(known, share, 0.0), known))
    total, count = (sliding_window_view(values, (3, 3)).sum(axis=(-2, -1)) for values in padded)
    mean = total / np.maximum(count, 1)
    found: Array = np.where(known, share, np.where(np.abs(mean) > ROUNDING, mean, 0.0))
    return found


def plot_bars(plant: Plant, q: Array, shapes: Sequence[ModeShape], title: str, path: Path) -> None:
    """Draw how elastic bodies move across their axes, one panel a mode, over the place on the axis.

    Displacements are against the largest one of any point of an axis, in any direction. Of points that do not move in
    step the motion a quarter of a period later is dashed.
    """
    bars = picture_of(plant.mechanism, 0.0).bars
    figure, axes = panels(len(shapes))
    for number, (ax, shape) in enumerate(zip(axes, shapes, strict=True), 1):
        motion = shape.motion.astype(complex)
        parts = ([displacements(plant, q, part, bar) for bar in bars] for part in (motion.real, motion.imag))
        moved = [there + 1j * later for there, later in zip(*parts, strict=True)]
        every = np.concatenate(moved).ravel()
        largest = every[np.argmax(np.abs(every))] or 1.0
        for k, (bar, displacement) in enumerate(zip(bars, moved, strict=True)):
            color = PALETTE[k % len(PALETTE)]
            across = displacement[:, 1] / largest
            ax.plot(bar.x, across.real, color=color, label=bar.name)
            if np.abs(across.imag).max() > IN_STEP:
                ax.plot(bar.x, across.imag, "--", color=color)
        ax.set_ylim(-1.1, 1.1)
        ax.tick_params(labelsize=7)
        ax.grid(alpha=0.3)
        hertz, growth = shape.mode.frequency / (2.0 * np.pi), shape.mode.eigenvalue.real
        ax.set_title(f"{number}: {hertz:.4g} Hz" if hertz else f"{number}: {growth:+.4g} 1/s", fontsize=10)
    axes[0].legend(fontsize=8)
    figure.supxlabel("place on the axis [m]", fontsize=9)
    figure.supylabel("displacement across it over the largest", fontsize=9)
    figure.suptitle(title, fontsize=10)
    finish(figure, path)


def displacements(plant: Plant, q: Array, motion: Array, bar: Bar) -> Array:
    """Return how the axis (k, 3) of a bar moves with the coordinates, frame's axes, to first order."""
    step = 1e-6 / max(1e-300, float(np.abs(motion).max()))
    ends = []
    for sign in (-1.0, 1.0):
        moved = q.copy()
        plant.system.apply(moved, sign * step * motion)
        plant.energy(0.0, moved, np.zeros(plant.system.n))  # places the bodies
        frame = plant.data.state.bodies[bar.body]
        ends.append(frame["r"] + bar.axis(amplitudes(plant)[bar.modes], 1.0) @ frame["A"].T)
    plant.energy(0.0, q, np.zeros(plant.system.n))
    there: Array = (ends[1] - ends[0]) @ plant.data.state.bodies[bar.body]["A"] / (2.0 * step)
    return there


def panels(count: int) -> tuple[Any, Any]:
    """Return a figure and the axes (count,) of as many panels."""
    columns = min(4, count)
    rows = -(-count // columns)
    figure, axes = subplots(rows, columns, size=(3.0 * columns, 2.6 * rows), squeeze=False)
    for ax in axes.flat[count:]:
        ax.axis("off")
    return figure, axes.flat[:count]


def poses(plant: Plant, q: Array, bodies: Any) -> tuple[Array, Array]:
    """Return origins and y axes of bodies (..., 3) at positions q (nq,)."""
    r, A = plant.poses(0.0, q)
    return r[bodies], A[bodies][..., 1]


def finish(figure: Any, path: Path) -> None:
    """Write the picture."""
    with replacing(path) as unfinished:
        figure.savefig(unfinished, dpi=130, format=path.suffix[1:] or "png")

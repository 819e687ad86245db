"""Pictures of mode shapes: the mechanism with its displacements, and the deflection of its bars."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from mbfmu.plotting.figures import finish, panels

from .drawing import PALETTE
from .drawing import draw as picture_of
from .motion import amplitudes

if TYPE_CHECKING:
    from mbfmu.mechanics import CompiledMechanism
    from mbfmu.steady.modes import ModeShape
    from solvers.system import Array

    from .picture import Bar

ZERO_DEFLECTION_RATIO = 1e-4  # of the largest deflection: less is taken for none
IN_PHASE_TOLERANCE = 0.01  # of the largest displacement: out of step less than this does not show


def plot_shapes(compiled: CompiledMechanism, q: Array, shapes: Sequence[ModeShape], title: str, path: Path) -> None:
    """Draw the deflection of the first surface along its normal, one panel a mode, over its place in the grid."""
    surface = compiled.mechanism.surfaces[0]
    at_rest, normals = poses(compiled, q, surface.bodies)
    x, z = distances(at_rest[:, at_rest.shape[1] // 2]), distances(at_rest[at_rest.shape[0] // 2])
    figure, axes = panels(len(shapes))
    for number, (ax, shape) in enumerate(zip(axes, shapes, strict=True), 1):
        moved, step = q.copy(), 1e-6 / max(1e-300, float(np.abs(shape.motion).max()))
        compiled.system.apply(moved, step * shape.motion)
        deflection = np.einsum("ijk,ijk->ij", poses(compiled, moved, surface.bodies)[0] - at_rest, normals)
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
    known = np.abs(share) > ZERO_DEFLECTION_RATIO
    padded = (np.pad(values, 1) for values in (np.where(known, share, 0.0), known))
    total, count = (sliding_window_view(values, (3, 3)).sum(axis=(-2, -1)) for values in padded)
    mean = total / np.maximum(count, 1)
    found: Array = np.where(known, share, np.where(np.abs(mean) > ZERO_DEFLECTION_RATIO, mean, 0.0))
    return found


def plot_bars(compiled: CompiledMechanism, q: Array, shapes: Sequence[ModeShape], title: str, path: Path) -> None:
    """Draw how flexible bodies move across their axes, one panel a mode, over the place on the axis.

    Displacements are against the largest one of any point of an axis, in any direction. Of points that do not move in
    step the motion a quarter of a period later is dashed.
    """
    bars = picture_of(compiled.mechanism, 0.0).bars
    figure, axes = panels(len(shapes))
    for number, (ax, shape) in enumerate(zip(axes, shapes, strict=True), 1):
        motion = shape.motion.astype(complex)
        parts = ([displacements(compiled, q, part, bar) for bar in bars] for part in (motion.real, motion.imag))
        moved = [there + 1j * later for there, later in zip(*parts, strict=True)]
        every = np.concatenate(moved).ravel()
        largest = every[np.argmax(np.abs(every))] or 1.0
        for k, (bar, displacement) in enumerate(zip(bars, moved, strict=True)):
            color = PALETTE[k % len(PALETTE)]
            across = displacement[:, 1] / largest
            ax.plot(bar.x, across.real, color=color, label=bar.name)
            if np.abs(across.imag).max() > IN_PHASE_TOLERANCE:
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


def displacements(compiled: CompiledMechanism, q: Array, motion: Array, bar: Bar) -> Array:
    """Return how the axis (k, 3) of a bar moves with the coordinates, frame's axes, to first order."""
    step = 1e-6 / max(1e-300, float(np.abs(motion).max()))
    ends = []
    for sign in (-1.0, 1.0):
        moved = q.copy()
        compiled.system.apply(moved, sign * step * motion)
        compiled.place_bodies(0.0, moved)
        frame = compiled.data.state.bodies[bar.body]
        ends.append(frame["r"] + bar.axis(amplitudes(compiled)[bar.modes], 1.0) @ frame["A"].T)
    compiled.energy(0.0, q, np.zeros(compiled.system.n))
    there: Array = (ends[1] - ends[0]) @ compiled.data.state.bodies[bar.body]["A"] / (2.0 * step)
    return there


def poses(compiled: CompiledMechanism, q: Array, bodies: Any) -> tuple[Array, Array]:
    """Return origins and y axes of bodies (..., 3) at positions q (nq,)."""
    r, A = compiled.poses(0.0, q)
    return r[bodies], A[bodies][..., 1]

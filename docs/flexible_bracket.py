"""Draw the picture of the page on flexible bodies: ``python docs/flexible_bracket.py``."""

from __future__ import annotations

import os
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

DOCS = Path(__file__).parent
SCALE = 10.0


def main() -> None:
    """Run the model of the page and draw it."""
    page = (DOCS / "flexible_bodies.md").read_text()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        sys.path.insert(0, folder)
        for name, block in re.findall(r"```python file=(\S+)\n(.*?)```", page, flags=re.DOTALL):
            Path(name).write_text(block)
        draw()


def draw() -> None:
    """Write the picture of the model in the current folder."""
    import make_mesh
    from bracket import Bracket, bracket

    import mbfmu as mb

    body, amplitudes = bracket(4), list[Any]()
    result = mb.simulate(
        Bracket(), watch=lambda simulation: amplitudes.append(simulation.compiled.data.state.q[: body.modes].copy())
    )
    largest = int(np.argmax(np.abs(result["pad.y"] - np.mean(result["pad.y"]))))
    mesh = make_mesh.mesh
    vertices = body.nodes[: mesh.p.shape[1]]
    moved = body.displaced(amplitudes[largest], SCALE)[: len(vertices)]
    figure = plt.figure(figsize=(9.0, 3.6))
    ax = figure.add_subplot(1, 2, 1, projection="3d")
    for positions, style in ((vertices, {"color": "0.75", "lw": 0.6}), (moved, {"color": "#4269d0", "lw": 0.9})):
        for i, j in mesh.edges.T:
            x, y, z = 1e3 * positions[[i, j]].T
            ax.plot(x, z, y, **style)
    ax.set(
        xlabel="x [mm]",
        ylabel="z [mm]",
        zlabel="y [mm]",
        title=f"t = {result.t[largest]:.3f} s, displacement x {SCALE:g}",
    )
    ax.set_yticks([-20, 20])
    ax.set_box_aspect(np.ptp(vertices, axis=0)[[0, 2, 1]])
    ax.view_init(18, -60)
    ax = figure.add_subplot(1, 2, 2)
    ax.plot(result.t, 1e3 * (result["pad.y"] - result["pad.y"][0]), lw=0.5)
    ax.set(xlabel="time [s]", ylabel="displacement of the pad [mm]")
    ax.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(DOCS / "figures" / "flexible_bracket.png", dpi=110)


if __name__ == "__main__":
    main()

"""Pictures of outputs over time: all texts lie inside the figure, and none on another panel."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import mbfmu as mb
from mbfmu.mechanics import Variable
from mbfmu.plotting.time_series import arrange, draw, errors_of, size
from solvers import Statistics

NAMES = {
    "short": [("x", "m")],
    "long": [("coupler.mode.acceleration[3].of.the.last.beam", "rad/s2"), ("x", "m")],
    "many": [(f"body{k}.force.x", unit) for unit in ("m", "m/s", "m/s2", "rad", "rad/s", "N", "J") for k in range(14)],
    "errors": [("position_residual", "m"), ("energy_error", "J")],
}
REASON = mb.Diagnostic.error("invalid-value", "a reason that is so long that it does not fit into one line. " * 4)


def result(names: list[tuple[str, str]], *, times: int = 50, failed: bool = False) -> mb.Result:
    t = np.linspace(0.0, 2.0, times)
    values = np.array([10.0 ** (k % 7 - 3) * np.sin((1 + k) * t + 0.1) for k in range(len(names))]).T
    variables = tuple(Variable(name, unit, "") for name, unit in names)
    return mb.Result(t, values, variables, Statistics(), 0.1, name="model/scene", diagnostics=(REASON,) * failed)


@pytest.mark.parametrize("failed", [False, True])
@pytest.mark.parametrize("times", [1, 50])
@pytest.mark.parametrize("kind", NAMES)
def test_labels_of_curves_are_inside_the_figure_and_outside_the_panels(kind: str, times: int, failed: bool):
    shown = result(NAMES[kind], times=times, failed=failed)
    asked = errors_of(shown) if kind == "errors" else []
    figure = Figure(figsize=size(shown, asked))
    draw(figure, shown, asked)
    arrange(figure)
    renderer = FigureCanvasAgg(figure).get_renderer()
    width, height = figure.bbox.width, figure.bbox.height
    top = max(ax.get_window_extent(renderer).y1 for ax in figure.axes)
    title = figure.texts[0].get_window_extent(renderer)
    assert top <= title.y0 < title.y1 <= height
    for ax, below in zip(figure.axes, [*figure.axes[1:], None], strict=True):
        panel, legend = ax.get_window_extent(renderer), ax.get_legend().get_window_extent(renderer)
        assert panel.x1 <= legend.x0 < legend.x1 <= width
        assert ax.yaxis.get_tightbbox(renderer).x0 >= 0.0
        if below is not None:
            assert below.get_window_extent(renderer).y1 < panel.y0
    assert figure.axes[-1].xaxis.get_tightbbox(renderer).y0 >= 0.0

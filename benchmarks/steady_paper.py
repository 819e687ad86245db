"""Figs. 5, 6 and 9 of Choi, Park and Yoo redone, and why their commercial program diverged.

``python benchmarks/steady_paper.py``

Writes the pictures into ``fmus/pendulum/figures`` and ``fmus/governor/figures``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from mbfmu.modeling import Model
from mbfmu.plotting.figures import finish, subplots
from mbfmu.session.run import communication_points, run
from mbfmu.session.simulation import Settings
from mbfmu.steady.equilibrium import equilibrium

SETTINGS = Settings(solver="ida", tolerance=1e-8)
PENDULUM, GOVERNOR = Path("fmus/pendulum/figures"), Path("fmus/governor/figures")


def settle(model: Model, output: str, label: str, end: float, interval: float, path: Path) -> None:
    """Draw an output with and without damping over the steady state that Newton gives."""
    damped = model.with_values(model.settling)
    target = equilibrium(damped).outputs[output]
    times = communication_points(end, interval)
    figure, ax = subplots(size=(8.0, 3.6))
    for own, text, color in ((model, "undamped", "#b0b0b0"), (damped, damping_in_words(model), "#4269d0")):
        ax.plot(times, run(own, SETTINGS, times)[output], lw=1.0, color=color, label=text)
    ax.axhline(target, color="#ff725c", ls="--", lw=1.2, label=f"steady state: {target:.6g}")
    ax.set_xlabel("time [s]")
    ax.set_ylabel(label)
    ax.grid(alpha=0.3)
    above(ax)
    finish(figure, path)


def above(ax: Axes) -> None:
    """Put the legend over the picture, off the curves."""
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False, fontsize=8)


def damping_in_words(model: Model) -> str:
    """Return the damping a model settles with, units included."""
    units = {p.name: p.unit for p in model.parameters()}
    return ", ".join(f"{k.replace('_', ' ')} {v:g} {units[k]}" for k, v in model.settling.items())


def trapezoidal(model: SwingPendulum, h: float, end: float, *, lagged: bool) -> NDArray[np.float64]:
    """Return rows (t, theta, d) by the implicit trapezoidal rule; ``lagged``: velocities in forces are the last step's.

    So did programs whose velocity-dependent terms are explicit: the Coriolis and centrifugal forces of a step act
    where the motion was a step ago.
    """
    q, v = np.array([model.start_angle, model.start_distance]), np.zeros(2)
    a = acceleration(model, q, v)
    rows = [(0.0, *q)]
    for k in range(round(end / h)):
        q_new, v_new, old = q + h * v, v.copy(), v
        for _ in range(50):
            a_new = acceleration(model, q_new, old if lagged else v_new)
            before, q_new, v_new = q_new, q + h * v + 0.25 * h * h * (a + a_new), v + 0.5 * h * (a + a_new)
            if np.abs(q_new - before).max() < 1e-14:
                break
        q, v, a = q_new, v_new, a_new
        rows.append(((k + 1) * h, *q))
        if not abs(q[0]) < 1.0:
            break
    return np.array(rows)


def acceleration(model: SwingPendulum, q: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (theta'', d'')."""
    return np.array(model.minimal(0.0, [*q, *v])[2:])


def divergence(path: Path) -> None:
    """Draw the slider's distance with the velocity terms implicit and explicit."""
    model = SwingPendulum()
    figure, ax = subplots(size=(8.0, 3.6))
    for h, color in ((5e-4, "#efb118"), (1e-3, "#ff725c"), (2e-3, "#9c2c1c")):
        rows = trapezoidal(model, h, 5.0, lagged=True)
        ax.plot(rows[:, 0], rows[:, 2], lw=0.6, color=color, label=f"explicit velocity terms, {1e3 * h:g} ms")
    rows = trapezoidal(model, 1e-3, 5.0, lagged=False)
    ax.plot(rows[:, 0], rows[:, 2], lw=0.4, color="#4269d0", label="implicit, 1 ms")
    ax.set_ylim(0.6, 1.5)
    ax.set_xlabel("time [s]")
    ax.set_ylabel("slider from the crank's tip [m]")
    ax.grid(alpha=0.3)
    above(ax)
    finish(figure, path)


def main() -> None:
    """Draw everything."""
    for folder in (PENDULUM, GOVERNOR):
        folder.mkdir(exist_ok=True)
    settle(SwingPendulum(), "rod.angle", r"$\theta$ [rad]", 2.0, 0.001, PENDULUM / "fig5_angle.png")
    settle(SwingPendulum(), "slider.distance", "d [m]", 0.5, 0.0002, PENDULUM / "fig6_distance.png")
    settle(Governor(), "collar.distance", "collar below the pivot [m]", 10.0, 0.01, GOVERNOR / "fig9_collar.png")
    divergence(PENDULUM / "explicit_coriolis.png")


if __name__ == "__main__":
    main()

"""Study of linkages in tolerance: make it, then hold those that come nearest to one line against SciPy.

    python examples/studies/linkages.py [FOLDER] [LINKAGES]

SciPy integrates three bars between two pivots in absolute angles, with multipliers, at 1e-11: nothing of mbfmu. A
linkage is lost in silence where a run that calls itself well ends at another angle.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

import mbfmu as mb

STUDY = Path(__file__).with_name("linkages.toml")
CHECKED = 40  # of the nearest, and as many at random
LOST = 0.05  # rad at the end, from the reference
NAMES = ("ground_length", "crank_length", "coupler_length", "rocker_length")
MASSES = np.array([8.019, 24.057, 8.019])
GRAVITY, STOP = 9.81, 10.0
Array = NDArray[np.float64]


def reference(ground: float, crank: float, coupler: float, rocker: float) -> float:
    """Return the crank's angle at the end, rad. Angles are from the horizontal, that of the rocker from its pivot."""
    lengths = np.array([crank, coupler, rocker])
    signs = np.array([1.0, 1.0, -1.0])  # the loop: crank + coupler - rocker = ground
    inertia = np.diag(MASSES * lengths**2 / 3.0)
    inertia[0, 0] += MASSES[1] * crank**2

    def slopes(_: float, y: Array) -> Array:
        angles, rates = y[:3], y[3:]
        sines, cosines = np.sin(angles), np.cos(angles)
        mass, coupled = inertia.copy(), 0.5 * MASSES[1] * crank * coupler
        mass[0, 1] = mass[1, 0] = coupled * np.cos(angles[0] - angles[1])
        turning = coupled * np.sin(angles[0] - angles[1])
        force = -GRAVITY * cosines * lengths * (0.5 * MASSES + [MASSES[1], 0.0, 0.0])
        force += turning * np.array([-(rates[1] ** 2), rates[0] ** 2, 0.0])
        jacobian = np.array([-lengths * sines, lengths * cosines]) * signs
        gamma = np.array([lengths * cosines, lengths * sines]) * signs @ rates**2
        whole = np.block([[mass, jacobian.T], [jacobian, np.zeros((2, 2))]])
        return np.concatenate([rates, np.linalg.solve(whole, np.concatenate([force, gamma]))[:3]])

    def open_by(others: Array) -> list[float]:
        angles = np.array([np.radians(10.0), *others])
        return [signs * lengths @ np.cos(angles) - ground, signs * lengths @ np.sin(angles)]

    start = fsolve(open_by, [0.0, np.radians(10.0)], xtol=1e-14)
    found = solve_ivp(slopes, (0.0, STOP), [np.radians(10.0), *start, 0.0, 0.0, 0.0], "DOP853", rtol=1e-11, atol=1e-11)
    return float(found.y[0, -1])


def main() -> None:
    """Make the study, check it, draw it."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "results/linkages")
    count = {"count": int(sys.argv[2])} if len(sys.argv) > 2 else {}
    told = folder.exists() and any(folder.iterdir())
    study = mb.study(STUDY, folder=folder, resume=told, **count)
    print(f"{study!r}; {study.wall_time:.0f} s, of the runs {study.summed_time:.0f} s of CPU time")
    frame = study.to_dataframe()
    linkages = frame.groupby(list(NAMES), sort=False)
    nearest = linkages["nearest"].min().sort_values()
    chance = np.random.default_rng(0).permutation(len(nearest))[:CHECKED]
    checked = dict.fromkeys([*nearest.index[:CHECKED], *nearest.index[chance]])
    lost: dict[str, list[float]] = {solver: [] for solver in frame["solver"].unique()}
    errors = []
    for lengths in checked:
        truth = reference(*lengths)
        for _, row in linkages.get_group(lengths).iterrows():
            off = abs(row["angle"] - truth)
            errors.append(off)
            if row["status"] == "ok" and not off < LOST:
                lost[row["solver"]].append(float(row["nearest"]))
    for solver, rows in frame.groupby("solver"):
        statuses = rows["status"].value_counts().to_dict()
        print(f"{solver}: {statuses}; lost in silence {len(lost[solver])} of {len(checked)} that were checked")
    print(f"errors of the checked at the end: median {np.median(errors):.1e}, largest {np.max(errors):.1e} rad")
    draw(frame, folder / "linkages.png")


def draw(frame: Any, path: Path) -> None:
    """Draw how near linkages come to one line, and what became of them."""
    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    ax = figure.subplots()
    edges = np.geomspace(frame["nearest"].min(), frame["nearest"].max(), 40)
    for status, color in (("ok", "#4269d0"), ("suspect", "#efb118"), ("failed", "#ff725c")):
        values = frame.loc[frame["status"] == status, "nearest"].dropna()
        if len(values):
            ax.hist(values, edges, color=color, alpha=0.7, label=f"{status}: {len(values)}")
    ax.set(xscale="log", xlabel="coupler and rocker, nearest to one line [rad]", ylabel="runs")
    ax.legend()
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    main()

"""Fig. 5 of Bae and Cho redone: ``python benchmarks/sheet_paper.py``.

The sheet released flat on the paper's four grids, with material damping until it hangs still. Writes the picture into
``fmus/sheet/figures``.
"""

from __future__ import annotations

from pathlib import Path

from fmus.sheet import Sheet
from mbfmu.plotting.figures import finish, subplots
from mbfmu.session.run import communication_points, run
from mbfmu.session.simulation import Settings
from mbfmu.steady.equilibrium import equilibrium

FIGURES = Path("fmus/sheet/figures")
GRIDS = {(7, 5): "#efb118", (15, 11): "#ff725c", (33, 23): "#3ca951", (51, 35): "#4269d0"}
SHELL = -0.10822  # m, tip at rest by two shell codes


def damped(path: Path) -> None:
    """Draw the tip of every grid over the rest position of the shell codes, and print where each comes to rest."""
    times = communication_points(5.0, 0.01)
    figure, (whole, end) = subplots(1, 2, size=(9.0, 3.6), gridspec_kw={"width_ratios": (2.2, 1.0)})
    for (nx, nz), color in GRIDS.items():
        model = Sheet(nx=nx, nz=nz, damping=Sheet.settling["damping"])
        result = run(model, Settings(tolerance=1e-5 if nx < 33 else 1e-4), times)
        if result.failure:
            raise SystemExit(f"{nx} x {nz}: {result.failure}")
        tip, rest = 1e3 * result["tip.y"], 1e3 * equilibrium(model).outputs["tip.y"]
        for ax in (whole, end):
            ax.plot(times, tip, lw=1.1, color=color, label=f"{nx} x {nz}")
        print(f"{nx} x {nz}: tip {tip[-1]:.3f} mm after {times[-1]:g} s, at rest {rest:.3f} mm")
    for ax in (whole, end):
        ax.axhline(1e3 * SHELL, color="#303030", ls="--", lw=1.0, label="shell codes, at rest")
        ax.set_xlabel("time [s]")
        ax.grid(alpha=0.3)
    whole.set_xlim(0.0, 2.0)
    whole.set_ylabel("tip y [mm]")
    end.set_xlim(4.5, 5.0)
    end.set_ylim(1e3 * SHELL - 0.3, 1e3 * SHELL + 0.3)
    end.yaxis.get_major_formatter().set_useOffset(False)
    handles, labels = whole.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=5, frameon=False, fontsize=8)
    finish(figure, path)


def main() -> None:
    """Draw the figure."""
    FIGURES.mkdir(exist_ok=True)
    damped(FIGURES / "fig5_tip.png")


if __name__ == "__main__":
    main()

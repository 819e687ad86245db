"""What the feeder costs and finds: ``python benchmarks/feeder.py [scenes] [accuracy] [host]``; compile time apart.

* ``scenes``: those that ship, and a sheet in two nips that touches nothing, or a table; by ``esdirk`` and by ``ida``.
* ``accuracy``: the S against solver and tolerance, creep of the rollers and grid: where the leading edge is at the end,
  against the last of each kind.
* ``host``: what a step of 1 ms of the FMU takes while the sheet passes the S, and how much slower than time that is.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fmus.feeder import Feeder
from mbfmu.fmi import Fmu, export
from mbfmu.modeling.scene import load_scene
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.sheets import Wall, add_contact
from mbfmu.util.text_table import format_table

FREE: dict[str, Any] = {"path": "straight", "nips": 1, "guides": False, "gravity_y": 0.0, "speed": 0.3, "lead": 0.1}
BOTH = "esdirk", "ida"
PASSED = 0.25  # s, when the leading edge is out of the S and in the second line
EDGE = [f"lead.{axis}" for axis in "xyz"]

Row = tuple[str, ...]


def timed(model: Any, stop: float, tolerance: float = 1e-4, solver: str = "esdirk") -> tuple[Simulation, float]:
    """Return a run, and its CPU time, s."""
    settings = Settings(solver=solver, tolerance=tolerance)
    Simulation(model, settings).advance(1e-6)  # compiles
    run = Simulation(model, settings)
    begin = time.process_time()
    status = run.advance(stop)
    if not status.ok:
        raise RuntimeError(status.message)
    return run, time.process_time() - begin


def told(run: Simulation) -> dict[str, float]:
    """Return all outputs where a run stands."""
    return dict(zip((variable.name for variable in run.variables), run.outputs().tolist(), strict=True))


def found(run: Simulation) -> str:
    """Return what is seen where a scene ends."""
    end = told(run)
    slips = ", ".join(f"{1e3 * value:.2f}" for name, value in end.items() if name.endswith("left.slip"))
    parts = [f"lead {1e3 * end['lead.x']:.3f} mm", f"skew {end['sheet.skew']:.4f} rad", f"slips {slips} mm/s"]
    if "stop.force.x" in end:
        parts.append(f"wall {end['stop.force.x']:.2f} N")
    return ", ".join((*parts, f"energy error {1e3 * end['energy_error']:.3f} mJ"))


def cost(name: str, model: Any, stop: float) -> Iterator[Row]:
    """Yield rows of the scenes."""
    for solver in BOTH:
        run, cpu = timed(model, stop, solver=solver)
        yield name, f"{stop:g}", solver, f"{cpu:.1f}", str(run.statistics.steps), found(run)


def scenes() -> Iterator[Row]:
    """What ships, and simpler ones."""
    for name in ("feeder", "feeder/skew", "feeder/jam", "feeder/two_speeds"):
        scene = load_scene(name)
        yield from cost(name, scene.model, scene.stop_time)
    for part in (0.0, 0.01):
        model = Feeder(**FREE, speed_difference=part)
        yield from cost(f"free, {part:.0%} apart", model, 1.0)
        m = replace(model, gravity_y=-9.81, mu_guide=0.2).build()
        add_contact(m, "table", m.meshes[0], Wall(at=(0.0, -1e-4, 0.0)), friction=0.2)
        yield from cost(f"on a table, {part:.0%} apart", m, 1.0)


def accuracy() -> Iterator[Row]:
    """Off by what, against the last of each kind."""
    grids = (15, 11), (22, 16), (29, 21)
    kinds: dict[str, list[tuple[str, dict[str, Any], str, float]]] = {
        "tolerance": [
            (f"{solver} {x:g}", {}, solver, x)
            for solver, tolerances in (("ida", (3e-4, 1e-4, 1e-5, 1e-6)), ("esdirk", (1e-3, 3e-4, 1e-4, 1e-5)))
            for x in tolerances
        ],
        "creep": [(f"{x:g}", {"creep": x}, "esdirk", 1e-4) for x in (5e-2, 2e-2, 5e-3, 2e-3)],
        "grid": [(f"{solver} {nx} x {nz}", {"nx": nx, "nz": nz}, solver, 1e-4) for solver in BOTH for nx, nz in grids],
    }
    for kind, cases in kinds.items():
        rows, ends = [], []
        for name, given, solver, tolerance in cases:
            run, cpu = timed(Feeder(**given), PASSED, tolerance, solver)
            end = told(run)
            ends.append(np.array([end[key] for key in EDGE]))
            rows.append((f"{kind} {name}", f"{cpu:.1f}", str(run.statistics.steps)))
        for row, end in zip(rows, ends, strict=True):
            yield (*row, f"{1e3 * np.linalg.norm(end - ends[-1]):.4f} mm")


def host() -> Iterator[Row]:
    """Steps of 1 ms."""
    with tempfile.TemporaryDirectory() as folder:
        for name, model in (("S", Feeder()), ("straight", Feeder(path="straight"))):
            with Fmu(export(model, Path(folder) / f"{name}.fmu", native=False)) as fmu:
                fmu.step(1e-3)
                times = []
                for _ in range(300):
                    begin = time.process_time()
                    fmu.step(1e-3)
                    times.append(time.process_time() - begin)
            q = 1e3 * np.quantile(times, (0.1, 0.5, 0.9))
            yield name, *(f"{x:.1f} ms" for x in q), f"{np.mean(times) / 1e-3:.0f} x"


def main() -> None:
    """Print the requested tables."""
    tables: dict[str, tuple[Row, Any]] = {
        "scenes": (("scene", "simulated [s]", "solver", "CPU [s]", "steps", "found"), scenes),
        "accuracy": (("S, 0.25 s", "CPU [s]", "steps", "edge is off by"), accuracy),
        "host": (("path", "a tenth is faster", "median", "a tenth is slower", "slower than time"), host),
    }
    for name in sys.argv[1:] or tables:
        head, rows = tables[name]
        print(format_table(head, list(rows())), "\n", flush=True)


if __name__ == "__main__":
    main()

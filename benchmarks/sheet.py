"""What the sheet costs: ``python benchmarks/sheet.py``. Compile time apart; CPU time of one process.

* one inverse dynamics and one articulated-body evaluation per node from 7 x 5 to 101 x 71 nodes, and how they grow;
* effects that are off, against a build without them;
* statics from flat at full load;
* half a second after release from flat by ``ida`` and ``esdirk``, with its error against the shell code's tip
  (``fmus/sheet/release.csv``).
"""

from __future__ import annotations

import time

import numpy as np
import without_effects

from fmus.sheet import Sheet
from fmus.sheet.model import RELEASE_DATA
from mbfmu.mechanics import CompiledMechanism
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.steady.equilibrium import equilibrium
from mbfmu.studies.effects import time_of_evaluation
from mbfmu.util.text_table import format_table
from solvers import Code
from solvers.projection.saddle import Accelerations

GRIDS = ((7, 5), (15, 11), (33, 23), (51, 35), (101, 71))
RELEASES = (
    ((7, 5), "ida", 1e-5), ((7, 5), "esdirk", 2e-4), ((15, 11), "ida", 1e-5), ((15, 11), "esdirk", 5e-4),
    ((15, 11), "esdirk", 2e-4), ((51, 35), "ida", 1e-4), ((51, 35), "esdirk", 2e-3),
)  # fmt: skip


def evaluations() -> None:
    """Cost per node, and the exponent of its growth with the number of nodes."""
    lines, costs = [], []
    for nx, nz in GRIDS:
        compiled_mechanisms = [
            CompiledMechanism(Sheet(nx=nx, nz=nz, membrane=membrane).build()) for membrane in (False, True)
        ]
        own = [1e6 * time_of_evaluation(compiled) / (nx * nz) for compiled in compiled_mechanisms]
        own.append(1e6 * time_of_forward_dynamics(compiled_mechanisms[0]) / (nx * nz))
        costs.append(own)
        lines.append((f"{nx} x {nz}", *(f"{cost:.3f}" for cost in own)))
    print(format_table(("grid", "inverse, bending [us a node]", "with membrane", "articulated body, bending"), lines))
    nodes = np.log([nx * nz for nx, nz in GRIDS])
    exponents = [1.0 + np.polyfit(nodes, np.log([own[k] for own in costs]), 1)[0] for k in range(3)]
    print(f"growth with the nodes: exponents {', '.join(f'{x:.2f}' for x in exponents)} (at most 1.1)\n")


def time_of_forward_dynamics(compiled: CompiledMechanism) -> float:
    """Return the shortest time of one articulated-body evaluation from Python, s, in a random state near the start."""
    system, random = compiled.system, np.random.default_rng(0)
    q, v = compiled.assembly.start_positions(), 0.1 * random.normal(size=system.n)
    system.apply(q, 0.01 * random.normal(size=system.n) * system.size)
    motion, times = Accelerations(system), []
    for _ in range(50):
        begin = time.perf_counter()
        assert motion.solve(0.0, q, v) is Code.OK
        times.append(time.perf_counter() - begin)
    return min(times)


def statics() -> None:
    """Time of Newton from flat, and the tip."""
    lines = []
    for nx, nz in GRIDS:
        found = equilibrium(Sheet(nx=nx, nz=nz))
        tip = 1e3 * found.outputs["tip.y"]
        lines.append(
            (f"{nx} x {nz}", f"{found.solve_time:.3g}", str(found.iterations), f"{tip:.3f}", f"{tip + 108.22:+.3f}")
        )
    print(format_table(("statics", "time [s]", "factorizations", "tip [mm]", "off by"), lines), "\n")


def releases() -> None:
    """CPU time of half a second, and the largest error as a part of the swing."""
    data = np.genfromtxt(RELEASE_DATA, delimiter=",", names=True)
    lines = []
    for (nx, nz), solver, tolerance in RELEASES:
        model = Sheet(nx=nx, nz=nz)
        simulation = Simulation(model, Settings(solver=solver, tolerance=tolerance))
        tip = [v.name for v in simulation.compiled.outputs].index("tip.y")
        heights, begin = [0.0], time.process_time()
        for t in data["t_s"][1:]:
            assert simulation.advance(float(t)).ok
            heights.append(float(simulation.outputs()[tip]))
        cpu = time.process_time() - begin
        error = np.abs(heights - data["y_shell_m"]).max() / np.ptp(data["y_shell_m"])
        lines.append((f"{nx} x {nz}", solver, f"{tolerance:.0e}", f"{cpu:.2f}", f"{100.0 * error:.2f} %"))
    print(format_table(("release", "solver", "rtol", "CPU [s]", "largest error of the swing"), lines))


def main() -> None:
    """Print every figure."""
    evaluations()
    without_effects.main()
    print()
    statics()
    releases()


if __name__ == "__main__":
    main()

"""Computing time and memory over the size of the model: ``python benchmarks/scale.py [-o FOLDER] [NAME ...]``.

Open chains, chains and loops of elastic beams, loops in a row (benchmark A02 of the IFToMM library), with an explicit
and an implicit solver, ladders, sheets, and sheets in roller nips. The CPU
time of an evaluation of the equations of motion (of a step for sheets) includes all work of the solver, divided by the
number of evaluations. The exponent is that of a power of the number of coordinates, fitted to the models with more than
100.

Prints a table and writes ``scale.png``. The memory of a model is the largest of a process that builds and runs it,
minus that of a process with the smallest model.
"""

from __future__ import annotations

import argparse
import math
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

import mbfmu as mb
from fmus.feeder import Feeder
from fmus.sheet import Sheet
from mbfmu.plotting.figures import finish, subplots
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.text_table import format_table

DOWN = (0.0, -9.81, 0.0)
PARTS = 3  # of a run; the cheapest counts
MIN_FITTED_COORDINATES = 100
KIB_PER_MIB = 1024.0


def chain(links: int) -> mb.Mechanism:
    """Links of 0.1 m suspended from the ground."""
    m = mb.Mechanism(gravity=DOWN)
    link = m.ground
    for k in range(links):
        joint = mb.Revolute(at=(0.1 if k else 0.0, 0.0, 0.0), start=0.3 if k else -1.2)
        link = m.body(f"link{k}", link, joint, **mb.rod(mass=0.1, length=0.1))
    return m


def row(loops: int, *, grounded: bool = False) -> mb.Mechanism:
    """Four-bars side by side, links of 1 m and 1 kg, the top moving at 1 m/s.

    The tree is a chain, with a cut joint at the foot of each column; ``grounded``: columns on the ground, with a cut
    joint at the end of each coupler.
    """
    m = mb.Mechanism(gravity=DOWN)
    angle, top, end = 0.5 * math.pi, (1.0, 0.0, 0.0), (1.0, 0.0, 0.0)
    first = mb.Revolute(start=angle, rate=-1.0, fixed=True)
    column = m.body("column0", m.ground, first, **mb.rod(mass=1.0, length=1.0))
    for i in range(1, loops + 1):
        pin, foot = mb.Revolute(at=top, start=-angle, rate=1.0), (float(i), 0.0, 0.0)
        coupler = m.body(f"coupler{i}", column, pin, **mb.rod(mass=1.0, length=1.0))
        hinge = mb.Revolute(at=foot if grounded else end, start=angle, rate=-1.0)
        if grounded:
            column = m.body(f"column{i}", m.ground, hinge, **mb.rod(mass=1.0, length=1.0))
            m.cut(f"pin{i}", mb.RevoluteCutJoint(at_a=end, at_b=top), coupler, column)
        else:
            column = m.body(f"column{i}", coupler, hinge, **mb.rod(mass=1.0, length=-1.0))
            m.cut(f"foot{i}", mb.RevoluteCutJoint(at_a=(-1.0, 0.0, 0.0), at_b=foot), column, m.ground)
            top = (0.0, 0.0, 0.0)
    return m


def ladder(loops: int) -> mb.Mechanism:
    """Parallelograms below each other, of rungs of 2 m and sides of 1 m."""
    m = mb.Mechanism(gravity=DOWN)
    above, corner, angle = m.ground, (2.0, 0.0, 0.0), -math.pi / 3.0
    for k in range(loops):
        side, rung = mb.rod(mass=0.5, length=1.0), mb.rod(mass=0.8, length=2.0)
        left = m.body(f"left{k}", above, mb.Revolute(start=angle, fixed=True), **side)
        here = m.body(f"rung{k}", left, mb.Revolute(at=(1.0, 0.0, 0.0), start=-angle), **rung)
        right = m.body(f"right{k}", here, mb.Revolute(at=corner, start=angle), **mb.rod(mass=0.5, length=-1.0))
        m.cut(f"pivot{k}", mb.RevoluteCutJoint(at_a=(-1.0, 0.0, 0.0), at_b=corner), right, above)
        above = here
    return m


def beams(count: int, *, held: bool = False) -> mb.Mechanism:
    """Elastic beams of 0.1 m with three modes each, suspended from the ground; ``held``: a rod at every beam, too."""
    m = mb.Mechanism(gravity=DOWN)
    own, place, angle = mb.Beam(length=0.1, mass=0.1, bending_stiffness=0.05, modes=3), m.ground, -1.2
    for k in range(count):
        start = 0.3 if k else angle
        handle = m.flexible_body(f"beam{k}", place, mb.Revolute(start=start), own)
        if held and k:
            joint = mb.Revolute(start=start, at=(0.0, 0.05, 0.0))
            rod = m.body(f"rod{k}", place, joint, **mb.rod(mass=0.1, length=0.1))
            m.cut(f"end{k}", mb.PlaneCutJoint(at_a=(0.1, 0.0, 0.0), at_b=(0.1, 0.05, 0.0), axis="y"), rod, handle.body)
        place = handle.section(own.length)
    return m


def sheet(nodes: int) -> mb.Model:
    """A sheet that is released, with about as many nodes."""
    across = round(math.sqrt(nodes / 1.5))
    return Sheet(nx=round(1.5 * across), nz=across, membrane=True)


def sheet_in_nips(nodes: int) -> mb.Model:
    """A sheet that rollers feed along a straight path, with about as many nodes."""
    across = round(math.sqrt(nodes / 1.5))
    return Feeder(path="straight", nx=round(1.5 * across), nz=across)


class Family(NamedTuple):
    """Models of one kind, of several sizes."""

    make: Callable[[int], mb.Mechanism | mb.Model]
    sizes: tuple[int, ...]
    solver: str
    duration: float  # of a part of the run, s
    per_step: bool = False  # whether the cost is that of a step


FAMILIES = {
    "open chain": Family(chain, (30, 100, 300, 1000, 3000), "adams", 0.05),
    "chain of elastic beams": Family(beams, (20, 75, 250, 750), "adams", 0.02),
    "loops of elastic beams": Family(partial(beams, held=True), (20, 60, 200, 600), "adams", 0.02),
    "loops in a row, serial tree": Family(row, (10, 30, 100, 300, 1000), "adams", 0.2),
    "loops in a row, grounded tree": Family(partial(row, grounded=True), (10, 30, 100, 300, 1000), "adams", 0.2),
    "loops in a row, implicit solver": Family(row, (40, 100, 300, 1000), "esdirk", 0.1),
    "ladder": Family(ladder, (10, 30, 100, 300, 1000), "adams", 0.1),
    "sheet": Family(sheet, (60, 150, 400, 1000, 2500), "esdirk", 0.05, per_step=True),
    "sheet in nips": Family(sheet_in_nips, (60, 150, 400, 1000, 2500), "esdirk", 0.01, per_step=True),
}


class Cost(NamedTuple):
    """What a model of one size costs."""

    coordinates: int
    unit: float  # us, an evaluation or a step
    count: int  # evaluations or steps
    building: float  # s


def measure(family: Family, size: int) -> Cost:
    """Return what a model costs; compilation is excluded."""
    begin = time.process_time()
    settings = Settings(solver=family.solver, tolerance=1e-4 if family.per_step else 1e-6, energy_check=False)
    simulation = Simulation(family.make(size), settings)
    building, units, count = time.process_time() - begin, [], 0
    for k in range(PARTS):
        begin, before = time.process_time(), count
        simulation.advance((k + 1) * family.duration)
        statistics = simulation.statistics
        count = statistics.steps if family.per_step else statistics.rhs_evals
        units.append((time.process_time() - begin) / (count - before))
    return Cost(simulation.compiled.system.n, 1e6 * min(units), count, building)


def exponent(costs: list[Cost]) -> float:
    """Return the power of the number of coordinates by which the cost grows."""
    large = [cost for cost in costs if cost.coordinates > MIN_FITTED_COORDINATES]
    return float(np.polyfit(np.log([c.coordinates for c in large]), np.log([c.unit for c in large]), 1)[0])


def memory(name: str, size: int) -> float:
    """Return the largest memory of a process that builds and runs a model, MiB."""
    command = [sys.executable, __file__, "--alone", str(size), name]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def largest_memory() -> float:
    """Return the largest memory of this process so far, MiB (Linux)."""
    status = Path("/proc/self/status").read_text()
    return float(status.partition("VmHWM:")[2].split()[0]) / KIB_PER_MIB


def draw(found: dict[str, list[Cost]], path: Path) -> None:
    """Draw the costs over the numbers of coordinates."""
    figure, ax = subplots(size=(7.0, 5.0))
    for name, costs in found.items():
        label = f"{name}: exponent {exponent(costs):.2f}"
        ax.loglog([c.coordinates for c in costs], [c.unit for c in costs], "o-", label=label)
    ax.set_xlabel("joint coordinates")
    ax.set_ylabel("CPU time of an evaluation (sheets: of a step) [us]")
    ax.grid(alpha=0.3, which="both")
    ax.legend(fontsize=8)
    finish(figure, path)


def main() -> None:
    """Measure the families that are named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"one of: {', '.join(FAMILIES)}")
    parser.add_argument("-o", "--output", type=Path, default=Path(), metavar="FOLDER")
    parser.add_argument("--alone", type=int, metavar="SIZE", help="print the memory of one model, MiB")
    options = parser.parse_args()
    names = options.names or list(FAMILIES)
    if options.alone:
        measure(FAMILIES[names[0]], options.alone)
        print(largest_memory())
        return
    found, lines = dict[str, list[Cost]](), list[tuple[str, ...]]()
    for name in names:
        family = FAMILIES[name]
        measure(family, family.sizes[0])  # compiles
        found[name] = [measure(family, size) for size in family.sizes]
        least, most = memory(name, family.sizes[0]), memory(name, family.sizes[-1])
        for size, cost in zip(family.sizes, found[name], strict=True):
            last = f"{most - least:.0f}" if size == family.sizes[-1] else ""
            numbers = str(size), str(cost.coordinates), f"{cost.unit:.3g}", str(cost.count), f"{cost.building:.2g}"
            lines.append((name, *numbers, last))
        print(f"{name}: exponent {exponent(found[name]):.2f}", flush=True)
    columns = "model", "size", "coordinates", "us", "evaluations or steps", "building [s]", "memory [MiB]"
    print(format_table(columns, lines))
    draw(found, options.output / "scale.png")


if __name__ == "__main__":
    main()

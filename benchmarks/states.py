"""CPU time per step of large models with first-order states: it is proportional to the number of bodies.

    python benchmarks/states.py

* ``chain``: hanging links with friction in every joint, and a filter that measures the tip and acts on the first joint.
* ``tower``: parallelograms on each other with a filter for each, and a controlled motor (tests/loops/towers.py).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from time import process_time

import numpy as np

import mbfmu as mb
from mbfmu.session.simulation import Settings, Simulation

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "loops"))
from towers import tower

SIZES = (100, 200, 400, 800)
WARM_UP, MEASURED = 1e-3, 0.5  # s of motion; s of motion times size


def chain(links: int) -> mb.Mechanism:
    """A chain that hangs obliquely."""
    m, rng = mb.Mechanism(gravity=(0.0, -9.81, 0.0)), np.random.default_rng(0)
    link, length = m.ground, 10.0 / links
    for k in range(links):
        joint = mb.Revolute(at=(length if k else 0.0, 0.0, 0.0), start=0.01 * rng.uniform(-1.0, 1.0))
        link = m.body(f"link{k}", link, joint, **mb.rod(mass=10.0 / links, length=length))
        m.force(f"friction{k}", mb.JointFriction(coulomb=0.1, deflection=1e-3), link)
    height = m.lag("height", link.position("y"), time_constant=0.01)
    m.force("control", mb.JointForce(m.weighted_sum("torque", [height], [-1.0])), m.bodies[1])
    return m


def time_steps(make: Callable[[int], mb.Mechanism], size: int, solver: str) -> tuple[int, int, float]:
    """Return the numbers of coordinates and states together and of steps, and the CPU time per step, s."""
    simulation = Simulation(make(size), Settings(solver=solver, tolerance=1e-5), duration=1.0)
    simulation.advance(WARM_UP)
    before, start = simulation.statistics.steps, process_time()
    assert simulation.advance(WARM_UP + MEASURED / size).ok
    taken, steps = process_time() - start, simulation.statistics.steps - before
    return simulation.compiled.system.n, steps, taken / steps


def main() -> None:
    """Print one line for each model, solver and size."""
    for name, make, solvers, part in (("chain", chain, ("ida",), 1), ("tower", tower, ("adams", "ida"), 4)):
        for solver in solvers:
            for size in SIZES:
                n, steps, taken = time_steps(make, size // part, solver)
                print(f"{name:6} {solver:7} {size // part:4} n = {n:5} {steps:5} steps {1e3 * taken:8.3f} ms per step")


if __name__ == "__main__":
    main()

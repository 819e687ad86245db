"""CPU time of models with first-order states: a step of large models, and an evaluation of small ones.

    python benchmarks/states.py

* ``chain``: hanging links with friction in every joint, and a filter that measures the tip and acts on the first joint.
* ``tower``: parallelograms on each other with a filter for each, and a controlled motor (tests/loops/towers.py).

The time of a step of these is proportional to the number of bodies. Of ``links`` and ``fourbar``, with dense matrices,
the time of an evaluation of the equations of motion is compared with the same mechanism without the states: friction
in one joint and in every joint, and filters.
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
LINKS = (1, 3, 6, 20)
SMALL_WARM_UP, LEAST_EVALUATIONS, REPEATS = 0.05, 10_000, 5  # s of motion; of the repeats the fastest counts


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


def links(count: int, frictions: int = 0, filters: int = 0) -> mb.Mechanism:
    """A chain that falls from an oblique position, with friction in its first joints and filters of the last angle."""
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    link = m.ground
    for k in range(count):
        joint = mb.Revolute(at=(1.0 if k else 0.0, 0.0, 0.0), start=0.3, rate=0.1)
        link = m.body(f"link{k}", link, joint, **mb.rod(mass=1.0, length=1.0))
        if k < frictions:
            m.force(f"friction{k}", mb.JointFriction(coulomb=0.05 * (count - k), deflection=1e-2), link)
    for k in range(filters):
        m.lag(f"filter{k}", link.angle(), time_constant=0.1)
    return m


def fourbar(frictions: int) -> mb.Mechanism:
    """A four-bar with friction in its first joints."""
    m = mb.Mechanism()
    crank = m.body("crank", m.ground, mb.Revolute(start=1.2, rate=8.0, fixed=True), **mb.rod(mass=1.0, length=0.5))
    coupler = m.body("coupler", crank, mb.Revolute(at=(0.5, 0.0, 0.0), start=-1.2), **mb.rod(mass=2.0, length=1.0))
    rocker = m.body("rocker", m.ground, mb.Revolute(at=(1.1, 0.0, 0.0), start=1.2), **mb.rod(mass=1.0, length=0.8))
    m.cut("pin", mb.RevoluteCutJoint(at_a=(1.0, 0.0, 0.0), at_b=(0.8, 0.0, 0.0)), coupler, rocker)
    for body in (crank, coupler, rocker)[:frictions]:
        m.force(f"{body.name} friction", mb.JointFriction(coulomb=0.02, deflection=1e-2), body)
    return m


def time_evaluations(model: mb.Mechanism, solver: str) -> float:
    """Return the CPU time per evaluation, s, steps included: the least of some runs."""
    best = np.inf
    for _ in range(REPEATS):
        simulation = Simulation(model, Settings(solver=solver, tolerance=1e-6))
        end = SMALL_WARM_UP
        simulation.advance(end)
        before, start = simulation.statistics.rhs_evals, process_time()
        while simulation.statistics.rhs_evals - before < LEAST_EVALUATIONS:
            end *= 2.0
            assert simulation.advance(end).ok
        best = min(best, (process_time() - start) / (simulation.statistics.rhs_evals - before))
    return best


def compare_small() -> None:
    """Print for small models the time of an evaluation without states, and the ratios with them."""
    for solver in ("adams", "radau"):
        for name, plain, others in (
            *((f"links {k}", links(k), (links(k, 1), links(k, k), links(k, 0, 20))) for k in LINKS),
            ("fourbar", fourbar(0), (fourbar(1), fourbar(3))),
        ):
            without = time_evaluations(plain, solver)
            ratios = [time_evaluations(model, solver) / without for model in others]
            cases = zip(("one friction", "all frictions", "20 filters"), ratios, strict=False)
            text = ", ".join(f"{case} {ratio:.2f}" for case, ratio in cases)
            print(f"{name:8} {solver:5} {1e6 * without:6.2f} us per evaluation; times that: {text}", flush=True)


def main() -> None:
    """Print one line for each model, solver and size."""
    compare_small()
    for name, make, solvers, part in (("chain", chain, ("ida",), 1), ("tower", tower, ("adams", "ida"), 4)):
        for solver in solvers:
            for size in SIZES:
                n, steps, taken = time_steps(make, size // part, solver)
                print(f"{name:6} {solver:7} {size // part:4} n = {n:5} {steps:5} steps {1e3 * taken:8.3f} ms per step")


if __name__ == "__main__":
    main()

"""What ``auto`` takes on mechanisms of every kind, against what each solver costs there at equal error.

``python benchmarks/auto.py [NAME ...]`` prints a row for each: what is taken and what taking it costs; the error it
makes (in units of the coordinates, at least the tolerance); and what every solver costs at that error, interpolated
between tolerances, in CPU time, the lowest of three runs in turn. ``python benchmarks/auto.py --scenes [NAME ...]``
does it for ``auto`` and ``ida`` on all that ships, at the tolerance of each scene.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf, log
from typing import Any

import numpy as np
from numpy.typing import NDArray

import mbfmu as mb
from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from fmus.sheet import Sheet
from mbfmu.modeling.registry import find, models
from mbfmu.modeling.scene import load_scene, scenes
from mbfmu.session.solver_selection import select_solver
from solvers.system import MAX_SOLVER_DENSE_COORDINATES

Array = NDArray[np.float64]
Point = tuple[float, float]  # error, CPU time (s)

POINTS = 41  # of time at which errors are taken
LONGEST, LONGEST_OF_REFERENCE = 3.0, 60.0  # s of CPU time, after which a run is given up
QUICK = 0.2  # s; longer runs are not repeated
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)
DOWN = (0.0, -9.81, 0.0)


@dataclass(frozen=True, kw_only=True)
class Case:
    """A mechanism, how long it runs (s), the tolerance, and who gives the reference."""

    make: Callable[[], Any]
    stop_time: float
    tolerance: float = 1e-6  # that ``auto`` picks for
    reference: tuple[str, float] = ("adams", 1e-11)


def rotor(speed: float = 100.0) -> mb.Mechanism:
    """A disc on a stiff, damped shaft that turns at a constant speed."""
    m = mb.Mechanism(gravity=DOWN)
    shaft = m.body("shaft", m.ground, mb.Revolute(rate=speed), **mb.cylinder(mass=1.0, radius=0.1, length=0.2))
    disc = m.body("disc", shaft, mb.Revolute(start=1e-3, fixed=True), **mb.cylinder(mass=5.0, radius=0.3, length=0.1))
    m.force("twist", mb.JointSpring(stiffness=1e6, damping=1e2), disc)
    return m


def damped_flap(decay: float, start: float = 0.0) -> mb.Mechanism:
    """A pendulum with a flap on a spring that is damped so that it creeps back at ``decay`` 1/s and much faster."""
    m = mb.Mechanism(gravity=DOWN)
    arm = m.body("arm", m.ground, mb.Revolute(start=0.5), **mb.rod(mass=1.0, length=1.0))
    flap = m.body("flap", arm, mb.Revolute(at=(1.0, 0.0, 0.0), start=start), **mb.rod(mass=0.1, length=0.2))
    own = 0.1 * 0.2**2 / 3.0  # kg m^2, about its hinge
    m.force("hinge", mb.JointSpring(stiffness=own * decay**2, damping=2.0 * own * decay), flap)
    return m


def springs(ratio: float, count: int = 5) -> mb.Mechanism:
    """Masses in a row on springs, the last of which is ``ratio`` times as stiff, damped by 5 %."""
    m, on = mb.Mechanism(), None
    for k in range(count):
        on = m.body(f"bob{k}", on or m.ground, mb.Translational(axis="x", start=0.1 if k == 0 else 0.0), mass=1.0)
        stiffness = 40.0 * (ratio if k == count - 1 else 1.0)
        m.force(f"spring{k}", mb.JointSpring(stiffness=stiffness, damping=0.1 * stiffness**0.5), on)
    return m


def four_bar_turning() -> mb.Mechanism:
    """A four-bar whose heavy crank turns at 20 rad/s, with a stiff damped flap on its rocker."""
    m = mb.Mechanism()
    crank = m.body("crank", m.ground, mb.Revolute(start=1.0, rate=20.0), mass=50.0, inertia=(5.0, 5.0, 5.0))
    coupler = m.body("coupler", crank, mb.Revolute(at=(0.5, 0.0, 0.0), start=-0.5), **mb.rod(mass=1.0, length=2.0))
    rocker = m.body("rocker", m.ground, mb.Revolute(at=(2.0, 0.0, 0.0), start=1.7), **mb.rod(mass=1.0, length=1.5))
    flap = m.body("flap", rocker, mb.Revolute(at=(1.5, 0.0, 0.0)), **mb.rod(mass=0.1, length=0.2))
    m.force("hinge", mb.JointSpring(stiffness=1e4, damping=3.0), flap)
    m.cut("pin", mb.RevoluteCutJoint(at_a=(2.0, 0.0, 0.0), at_b=(1.5, 0.0, 0.0)), coupler, rocker)
    return m


def watt() -> mb.Mechanism:
    """Watt's linkage that swings under gravity."""
    m = mb.Mechanism(gravity=DOWN)
    left = m.body("left", m.ground, mb.Revolute(start=0.4, fixed=True), **mb.rod(mass=1.0, length=2.0))
    middle = m.body("middle", left, mb.Revolute(at=(2.0, 0.0, 0.0), start=1.2), **mb.rod(mass=0.5, length=1.0))
    pin = mb.Revolute(at=(4.0, 1.0, 0.0), start=3.3)
    right = m.body("right", m.ground, pin, **mb.rod(mass=1.0, length=2.0))
    m.cut("pin", mb.RevoluteCutJoint(at_a=(1.0, 0.0, 0.0), at_b=(2.0, 0.0, 0.0)), middle, right)
    return m


def shaken(stiffness: float) -> mb.Mechanism:
    """A sled that a sine moves, with a bob on a damped spring and a pendulum on it."""
    m = mb.Mechanism(gravity=DOWN)
    drive = mb.Harmonic(amplitude=0.1, frequency=1.0)
    sled = m.body("sled", m.ground, mb.Translational(axis="x", drive=drive), mass=1.0)
    bob = m.body("bob", sled, mb.Translational(axis="x"), mass=1.0)
    m.force("spring", mb.JointSpring(stiffness=stiffness, damping=0.2 * stiffness**0.5), bob)
    m.body("arm", sled, mb.Revolute(start=-1.0), **mb.rod(mass=1.0, length=1.0))
    return m


def bouncing(stiffness: float = 1e5) -> mb.Mechanism:
    """A ball that falls on a stop."""
    m = mb.Mechanism(gravity=DOWN)
    ball = m.body("ball", m.ground, mb.Translational(axis="y", start=0.5), mass=1.0)
    m.force("floor", mb.JointStop(lower=0.0, stiffness=stiffness, damping=0.1), ball)
    return m


def resting_on_stop() -> mb.Mechanism:
    """A pendulum that carries a bob which rests on a stiff damped stop."""
    m = mb.Mechanism(gravity=DOWN)
    arm = m.body("arm", m.ground, mb.Revolute(start=-2.0), **mb.rod(mass=1.0, length=1.0))
    bob = m.body("bob", arm, mb.Translational(axis="x", at=(1.0, 0.0, 0.0), start=0.0), mass=0.2)
    m.force("stop", mb.JointStop(upper=0.0, stiffness=1e6, damping=100.0), bob)
    return m


def chain(count: int, stiff: float = 0.0) -> mb.Mechanism:
    """Links that swing, with stiff damped joints or free ones."""
    m, on = mb.Mechanism(gravity=DOWN), None
    for k in range(count):
        at = (0.0, 0.0, 0.0) if on is None else (0.1, 0.0, 0.0)
        joint = mb.Revolute(at=at, start=0.0)
        body = m.body(f"link{k}", on or m.ground, joint, **mb.rod(mass=0.1, length=0.1))
        if stiff and on:
            m.force(f"bend{k}", mb.JointSpring(stiffness=stiff, damping=1e-2 * stiff), body)
        on = body
    return m


def ladder(loops: int) -> mb.Mechanism:
    """Rungs of 2 m on pairs of rods of 1 m, one pair below the other."""
    m = mb.Mechanism(gravity=DOWN)
    on, sides = m.ground, ((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    for k in range(loops):
        left, right = (
            m.body(f"{side}{k}", on, mb.Revolute(at=at, start=-1.0), **mb.rod(mass=1.0, length=1.0))
            for side, at in zip(("left", "right"), sides, strict=True)
        )
        pin = mb.Revolute(at=(1.0, 0.0, 0.0), start=1.0)
        rung = m.body(f"rung{k}", left, pin, mass=1.0, com=(1.0, 0.0, 0.0), inertia=(0.1, 0.1, 0.1))
        m.cut(f"pin{k}", mb.RevoluteCutJoint(at_a=(2.0, 0.0, 0.0), at_b=(1.0, 0.0, 0.0)), rung, right)
        on, sides = rung, ((0.0, 0.0, 0.0), (2.0, 0.0, 0.0))
    return m


def elastic(faster: float = 1.0, **changed: float) -> Any:
    """The four-bar with an elastic coupler, made stiffer."""
    model: Any = load_scene("fourbar/flexible").model
    return model.with_values({"youngs_modulus": faster * model.youngs_modulus} | changed)


STIFF = ("radau", 1e-10)
CASES: dict[str, Case] = {
    "four-bar": Case(make=FourBar, stop_time=10.0),
    "governor": Case(make=Governor, stop_time=10.0),
    "governor, damped": Case(make=lambda: load_scene("governor/damped").model, stop_time=10.0),
    "pendulum": Case(make=SwingPendulum, stop_time=2.0),
    "pendulum, damped": Case(make=lambda: load_scene("pendulum/damped").model, stop_time=2.0),
    "watt": Case(make=watt, stop_time=10.0),
    "elastic coupler": Case(make=elastic, stop_time=2.0),
    "elastic coupler x1e4, damped": Case(make=lambda: elastic(1e4), stop_time=2.0, reference=STIFF),
    "elastic coupler x1e4, undamped": Case(
        make=lambda: elastic(1e4, coupler_damping=0.0), stop_time=0.5, reference=STIFF
    ),
    "rotor, stiff shaft": Case(make=rotor, stop_time=5.0, reference=STIFF),
    "four-bar turning, stiff flap": Case(make=four_bar_turning, stop_time=5.0, reference=STIFF),
    **{
        f"flap, {d:g} 1/s": Case(make=lambda d=d: damped_flap(d), stop_time=5.0, reference=STIFF)
        for d in (1e1, 1e2, 1e3, 1e4, 1e6)
    },
    "flap, 1e4 1/s, lifted": Case(make=lambda: damped_flap(1e4, start=0.3), stop_time=5.0, reference=STIFF),
    "springs, soft": Case(make=lambda: springs(1.0), stop_time=10.0),
    "springs, one x1e3": Case(make=lambda: springs(1e3), stop_time=10.0, reference=STIFF),
    "springs, one x1e6": Case(make=lambda: springs(1e6), stop_time=10.0, reference=STIFF),
    "shaken, soft": Case(make=lambda: shaken(1e2), stop_time=10.0),
    "shaken, stiff": Case(make=lambda: shaken(1e8), stop_time=10.0, reference=STIFF),
    "bouncing": Case(make=bouncing, stop_time=2.0),
    "resting on a stop": Case(make=resting_on_stop, stop_time=5.0, reference=STIFF),
    "ladder": Case(make=lambda: ladder(6), stop_time=3.0),
    "chain of 110": Case(make=lambda: chain(110), stop_time=0.5),
    "chain of 110, stiff": Case(make=lambda: chain(110, 10.0), stop_time=0.2, reference=("ida", 1e-9)),
    "chain of 30, stiff": Case(make=lambda: chain(30, 100.0), stop_time=0.5, reference=STIFF),
    "sheet": Case(make=lambda: Sheet(nx=7, nz=5), stop_time=0.3, tolerance=1e-4, reference=("adams", 1e-9)),
    "sheet, damped": Case(
        make=lambda: Sheet(nx=7, nz=5, damping=0.01), stop_time=0.1, tolerance=1e-4,
        reference=("adams", 1e-7),
    ),
}  # fmt: skip


def run(case: Case, solver: str, tolerance: float, longest: float = LONGEST) -> tuple[float, Array]:
    """Return the CPU time (s) and the positions (POINTS, nq) of a run; infinite, and nothing, where it ends early."""
    simulation = mb.Simulation(case.make(), mb.Settings(solver=solver, tolerance=tolerance, max_steps=2_000_000))
    stepper, q = simulation.stepper, []
    begin = time.process_time()
    for t in np.linspace(0.0, case.stop_time, POINTS):
        if not stepper.advance(float(t)).ok or time.process_time() - begin > longest:
            return inf, np.zeros(0)
        q.append(stepper.q)
    return time.process_time() - begin, np.array(q)


def families(compiled: Any) -> Sequence[str]:
    """Return the solvers that come into question."""
    s = compiled.system
    if s.has_matrices:
        return ("adams", "hybrid", "radau", "ida") if s.m else ("adams", "radau", "ida")
    return ("adams", "esdirk", "ida") if s.n <= MAX_SOLVER_DENSE_COORDINATES and not s.m else ("ida",)


def cost(points: Sequence[Point], wanted: float) -> float:
    """Return the CPU time (s) at the error ``wanted`` from (error, time), loosest tolerance first."""
    before: Point | None = None
    for error, seconds in points:
        if error <= wanted:
            if before is None or before[0] == inf or not error:
                return seconds
            share = log(wanted / before[0]) / log(error / before[0])
            return float(np.exp(log(before[1]) * (1.0 - share) + log(seconds) * share))
        before = (error, seconds)
    return inf


def sizes(compiled: Any) -> Any:
    """Return the units of positions: those of the coordinates, or 1 where there are quaternions among them."""
    return compiled.system.size if compiled.system.nq == compiled.system.n else 1.0


def exact(case: Case) -> Array:
    """Return the positions of the reference (POINTS, nq)."""
    _, q = run(case, *case.reference, longest=LONGEST_OF_REFERENCE)
    if not len(q):
        raise SystemExit("the reference ends early")
    return q


def lowest(case: Case, solvers: Sequence[str], tolerance: float, right: Array, unit: Any) -> dict[str, Point]:
    """Return error and time (s) of each solver, the lowest of three in turn."""
    found: dict[str, Point] = {}
    for turn in range(3):
        for solver in solvers:
            if turn and found[solver][1] > QUICK:
                continue
            seconds, q = run(case, solver, tolerance)
            error = float(np.abs((q - right) / unit).max()) if len(q) else inf
            found[solver] = (error, min(seconds, found.get(solver, (inf, inf))[1]))
    return found


def taken(case: Case) -> tuple[str, float, Any]:
    """Return what ``auto`` takes, what taking it costs (s), the lowest of three, and the compiled mechanism."""
    settings = mb.Settings(tolerance=case.tolerance)
    simulation = mb.Simulation(case.make(), settings)
    start = simulation.t, simulation.stepper.q, simulation.stepper.v
    times = []
    for _ in range(3):
        begin = time.process_time()
        found = select_solver(simulation.compiled, [start], settings.options(simulation.stepper.options.duration))
        times.append(time.process_time() - begin)
    return found.solver, min(times), simulation.compiled


def compare(names: Sequence[str]) -> None:
    """Print a row for each case."""
    for name, case in CASES.items():
        if names and not any(part in name for part in names):
            continue
        solver, picking, compiled = taken(case)
        right, unit, rivals = exact(case), sizes(compiled), families(compiled)
        runs = [lowest(case, rivals, tolerance, right, unit) for tolerance in TOLERANCES]
        own, seconds = runs[TOLERANCES.index(case.tolerance)][solver]
        error = max(own, case.tolerance)
        costs = {s: cost([found[s] for found in runs], error) for s in rivals} | {solver: seconds}
        told = ", ".join(f"{s} {1e3 * costs[s]:.3g}" for s in rivals)
        ratio = costs[solver] / min(costs.values())
        print(f"| {name} | {solver} in {1e3 * picking:.1f} ms | {error:.1e} | {told} | {ratio:.2f} |", flush=True)


def compare_scenes(names: Sequence[str]) -> None:
    """Print times and errors of ``auto`` and ``ida`` on every scene of the package: for 10 s, for sheets 0.5 s."""
    for name in names or [f"{model}/{scene}" for model in sorted(models()) for scene in scenes(find(model))]:
        scene = load_scene(name)
        tolerance, large = scene.settings.tolerance, not scene.model.compile().system.has_matrices
        case = Case(
            make=lambda scene=scene: scene.model,
            stop_time=min(scene.stop_time, 0.5 if large else 10.0),
            tolerance=tolerance,
            reference=("esdirk" if large else "adams", max(1e-11, (1e-2 if large else 1e-4) * tolerance)),
        )
        solver, picking, compiled = taken(case)
        right = exact(case)
        found = lowest(case, list(dict.fromkeys((solver, "ida"))), case.tolerance, right, sizes(compiled))
        (error, seconds), (other, long) = found[solver], found["ida"]
        print(
            f"| {name} | {solver} in {1e3 * picking:.1f} ms | {1e3 * seconds:.3g} | {error:.1e} | {1e3 * long:.3g} "
            f"| {other:.1e} | {seconds / long:.2f} | {error / other:.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    compare_scenes(sys.argv[2:]) if sys.argv[1:2] == ["--scenes"] else compare(sys.argv[1:])

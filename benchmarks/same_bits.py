"""Whether two versions of the sources compute the same numbers, to the last bit, and how long each takes to compile.

A change of structure must not change what the program computes. Run this on both commits and compare the files:

    git worktree add ../before <commit>
    PYTHONPATH=../before python benchmarks/same_bits.py > before.txt
    python benchmarks/same_bits.py > after.txt && diff before.txt after.txt

Every line is a run, a steady state or a state matrix and a fingerprint of its numbers. stderr has the time. With
``--speed`` every line has the lowest CPU time of some runs in place of the numbers, ms, of building the mechanism, of
starting, and of the run: do that on both commits in turn.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from hashlib import sha256
from typing import Any

import numpy as np

from mbfmu.mechanics import (
    Beam,
    BeamElement,
    DistanceCutJoint,
    Floating,
    Harmonic,
    Input,
    JointForce,
    JointSpring,
    Mechanism,
    PointForce,
    Polynomial,
    Revolute,
    RevoluteCutJoint,
    RunUp,
    Spherical,
    SphericalCutJoint,
    Spring,
    Torque,
    Translational,
    Weld,
    add_chain,
    rod,
)
from mbfmu.modeling.scene import load_scene
from mbfmu.modeling.settings import Settings
from mbfmu.session.run import simulate
from mbfmu.session.simulation import Simulation
from mbfmu.sheets import Support, add_sheet
from mbfmu.steady.equilibrium import build_problem

SCENES = (
    "fourbar", "fmus/fourbar/scenes/flexible.toml", "governor", "fmus/governor/scenes/damped.toml", "pendulum", "sheet",
    "fmus/sheet/scenes/damped.toml", "fmus/sheet/scenes/thrown.toml",
)  # fmt: skip


def every_kind() -> Mechanism:
    """A tree with every joint of small trees, every force, signal and sensor, and a rod that closes a loop."""
    m = Mechanism(gravity=(0.3, -9.81, 0.5))
    post = m.body("post", m.ground, Revolute(axis="y", drive=RunUp(speed=3.0, duration=0.2)), mass=2.0, com=(0.1, 0, 0))
    arm = m.body("arm", post, Revolute(at=(0.2, 0.3, 0), axis=(0.1, 0, 1.0), start=0.4), **rod(mass=1.0, length=0.6))
    ram = m.body("ram", arm, Translational(at=(0.6, 0, 0), axis="x", start=0.1), mass=0.3, inertia=(0.01, 0.02, 0.02))
    ball = m.body("ball", ram, Spherical(at=(0.1, 0, 0)), mass=0.4, com=(0.05, 0.1, 0), inertia=(0.01, 0.012, 0.02))
    m.body("fixed", ball, Weld(at=(0.1, 0.1, 0)), mass=0.1, inertia=(0.001, 0.001, 0.001))
    free = m.body("free", m.ground, Floating(at=(1.0, 1.0, 0)), mass=0.5, inertia=(0.02, 0.03, 0.04))
    shaken = m.body("shaken", m.ground, Translational(axis="z", drive=Harmonic(amplitude=0.1, frequency=3.0)), mass=1.0)
    held = m.body("held", shaken, Revolute(at=(0, 0.5, 0), start=0.3), **rod(mass=0.2, length=0.4))
    tie = m.cut("tie", DistanceCutJoint(at_a=(0.3, 0, 0), at_b=(0.1, 0, 0), length=1.0), arm, free)
    m.force("spring", Spring(stiffness=40.0, damping=0.5, free=0.3, at_a=(0.1, 0, 0), at_b=(0, 0.1, 0)), free, held)
    m.force("ram.spring", JointSpring(stiffness=300.0, damping=1.0, free=0.1), ram)
    m.force("motor", JointForce(magnitude=Harmonic(amplitude=0.5, frequency=2.0, mean=0.1)), arm)
    m.force("push", PointForce(magnitude=Polynomial((0.1, 0.5, -0.2)), axis=(1, 1, 0), at_a=(0, 0.1, 0.1)), free)
    m.force("twist", Torque(magnitude=Input(name="torque", unit="N.m", start=0.05), axis="x"), ball)
    beam = BeamElement(length=0.5, axial=50.0, torsion=0.1, bending_y=0.2, bending_z=0.3, damping=0.01)
    m.force("beam", beam, held, free)
    for axis in "xyz":
        m.output(f"free.{axis}", free.position(axis, (0.1, 0.2, 0.3)))
        m.output(f"ball.v{axis}", ball.velocity(axis, (0.1, 0.2, 0.3)))
        m.output(f"ball.a{axis}", ball.point_acceleration(axis))
        m.output(f"arm.f{axis}", arm.joint_force(axis))
        m.output(f"arm.m{axis}", arm.joint_moment(axis))
        m.output(f"tie.f{axis}", tie.joint_force(axis, "a"))
    m.output("arm.angle", arm.angle())
    m.output("arm.rate", arm.rate())
    m.output("arm.acceleration", arm.acceleration())
    m.output("effort", post.effort())
    m.output("tie", tie.force())
    m.output("energy", m.energy)
    m.output("kinetic", m.kinetic_energy)
    m.output("potential", m.potential_energy)
    m.output("jacobi", m.jacobi_integral)
    m.output("residual", m.position_residual)
    m.output("opening", m.velocity_residual)
    return m


def bent_loop() -> Mechanism:
    """A crank, a coupler that bends, and a slider."""
    m = Mechanism(gravity=(0, -9.81, 0))
    crank = m.body("crank", m.ground, Revolute(start=0.3, fixed=True), **rod(mass=0.5, length=0.1))
    beam = Beam(length=0.3, mass=0.4, bending_stiffness=2.0, modes=2, damping=1e-4)
    coupler = m.flexible_body("coupler", crank, Revolute(at=(0.1, 0, 0), start=-0.4), beam)
    slider = m.body("slider", m.ground, Translational(axis="x", start=0.38), mass=1.0)
    pin = m.cut("pin", RevoluteCutJoint(), coupler.section(0.3), slider)
    m.output("crank.angle", m.turn(crank))
    m.output("crank.rate", m.turn_rate(crank))
    m.output("middle", coupler.deflection(0.15))
    m.output("moment", coupler.moment(0.15))
    m.output("pin", pin.force("x"))
    return m


def rope() -> Mechanism:
    """A chain of nodal bodies and beam elements, with a weight at its end."""
    m = Mechanism(gravity=(0, -9.81, 0))
    nodes = add_chain(
        m, "rope", m.ground, Weld(), length=1.0, mass=0.2, axial=1e3, bending_stiffness=0.05, elements=12, damping=1e-3
    )
    m.body("weight", nodes[-1], Spherical(at=(0, 0, 0)), mass=0.1, com=(0.05, 0, 0), inertia=(1e-4, 2e-4, 2e-4))
    m.output("tip", nodes[-1].position("y"))
    return m


def links() -> Mechanism:
    """A hundred and ten links, the last tied to the ground."""
    m = Mechanism(gravity=(0, -9.81, 0))
    link = m.ground
    for i in range(110):
        link = m.body(
            f"link{i}", link, Revolute(at=(0.01 if i else 0, 0, 0), start=0.01), **rod(mass=0.01, length=0.01)
        )
        m.force(f"hinge{i}", JointSpring(stiffness=0.05, damping=1e-4), link)
    m.cut("pin", SphericalCutJoint(at_a=(0.01, 0, 0), at_b=(0.8, -0.3, 0)), link, m.ground)
    m.force("pull", Spring(stiffness=3.0, damping=0.01, free=0.1, at_b=(0.4, 0.4, 0)), link, m.ground)
    m.output("tip", link.position("y"))
    return m


def pressed_sheet() -> Mechanism:
    """A sheet with every effect, under pressure."""
    m = Mechanism(gravity=(0, -9.81, 0))
    sheet = add_sheet(
        m, "sheet", length=0.3, width=0.2, thickness=2e-4, youngs_modulus=3e9, density=800.0, grid=(9, 7),
        membrane=True, damping=1e-3, drag=1.3, supports=[Support("x0", "clamped")],
    )  # fmt: skip
    faces = [
        (sheet.node(i, j), sheet.node(i + 1, j), sheet.node(i + 1, j + 1), sheet.node(i, j + 1))
        for i in range(8)
        for j in range(6)
    ]
    m.pressure("wind", Harmonic(amplitude=0.3, frequency=4.0), faces)
    m.output("tip", sheet.node(-1, 3).position("y"))
    return m


def runs() -> Iterator[tuple[str, Callable[[], list[Any]]]]:
    """Yield a name, and what computes the numbers."""
    for name in SCENES:
        model = load_scene(name).model
        for solver in ("adams", "ida", "hybrid"):
            stop = 0.02 if "sheet" in name else 0.5
            yield f"{name} {solver}", lambda m=model, s=solver, e=stop: moved(m, e, solver=s)
        yield f"{name} steady", lambda m=model: steady(m)
    zoo = {
        "every kind": every_kind,
        "bent loop": bent_loop,
        "rope": rope,
        "links": links,
        "pressed sheet": pressed_sheet,
    }
    for name, make in zoo.items():
        for solver in ("adams", "ida", "hybrid"):
            stop = 0.02 if name == "pressed sheet" else 0.3
            yield f"{name} {solver}", lambda m=make, s=solver, e=stop: moved(m(), e, solver=s)
        yield f"{name} steady", lambda m=make: steady(m())


def moved(model: Any, stop: float, **settings: Any) -> list[Any]:
    """Run a model."""
    result = simulate(model, stop, interval=stop / 20, tolerance=1e-6, **settings)
    return [result.t, result.values, result.failure]


def steady(model: Any) -> list[Any]:
    """Find a steady state, and the state matrices about it."""
    state = build_problem(model).solve()
    space = state.state_space
    return [state.q, state.lam, space.A, space.B, space.C, space.D]


def speeds(repeats: int = 21) -> None:
    """Print the lowest CPU times of building, starting and running."""
    for name, stop in (("fourbar", 2.0), ("governor", 2.0), ("pendulum", 2.0), ("sheet", 0.02)):
        model = load_scene(name).model
        for solver in ("adams", "ida"):
            found = []
            for _ in range(repeats):
                times = [time.process_time()]
                model.compile()
                times.append(time.process_time())
                simulation = Simulation(model, Settings(solver=solver, tolerance=1e-6))
                times.append(time.process_time())
                simulation.advance(stop)
                times.append(time.process_time())
                found.append(np.diff(times))
            print(f"{name:10} {solver:6}", *(f"{1e3 * x:9.2f}" for x in np.min(found, axis=0)), flush=True)


def main() -> None:
    """Print every fingerprint, or every time."""
    if "--speed" in sys.argv:
        speeds()
        return
    begin, used = time.perf_counter(), time.process_time()
    for name, compute in runs():
        try:
            numbers = compute()
        except Exception as error:
            told = f"{type(error).__name__}: {str(error)[:60]}"
        else:
            told = sha256(b"".join(np.asarray(x).tobytes() for x in numbers)).hexdigest()[:16]
        print(f"{name:28} {told}", flush=True)
    print(
        f"{time.perf_counter() - begin:.1f} s, {time.process_time() - used:.1f} s of CPU: nearly all to compile, "
        "where nothing was compiled before",
        file=sys.stderr,
    )


if __name__ == "__main__":
    main()

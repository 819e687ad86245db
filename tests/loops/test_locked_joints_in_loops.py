"""Joints that are locked and released in loops, with redundant constraints, and in large models."""

from __future__ import annotations

import numpy as np
import pytest
from mechanisms import G, n_four_bar
from scipy.integrate import quad
from scipy.special import ellipk

import mbfmu as mb
from mbfmu.modeling.model import as_model
from mbfmu.session.result import Result
from solvers import Options
from solvers.steppers import stepper

SMALL = ["adams", "hybrid", "ida", "radau"]


def times(result: Result, name: str) -> list[float]:
    return [event.time for event in result.events if event.name == name]


def parallelogram(*locked: str) -> mb.Mechanism:
    """Return a beam of 1 kg on three cranks of 1 m without mass: a pendulum, with a redundant loop.

    These joints are locked 0.5 rad before the vertical, and released at 1 s.
    """
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    angle = 1.0 - np.pi / 2
    crank = m.body("crank", m.ground, mb.Revolute(start=angle, fixed=True))
    beam = m.body("beam", crank, mb.Revolute(at=(1.0, 0.0, 0.0), start=-angle), **mb.rod(mass=1.0, length=2.0))
    bodies = {"crank": crank, "beam": beam}
    for name, x in (("middle", 1.0), ("last", 2.0)):
        bodies[name] = m.body(name, beam, mb.Revolute(at=(x, 0.0, 0.0), start=angle))
        m.cut(f"{name} pivot", mb.RevoluteCutJoint(at_a=(-1.0, 0.0, 0.0), at_b=(x, 0.0, 0.0)), bodies[name], m.ground)
    locks = [mb.Lock(bodies[name]) for name in locked]
    m.event("brake", crank.angle(), crosses=0.5 - np.pi / 2, direction="down", then=locks)
    m.event("open", at=1.0, then=[mb.Release(bodies[name]) for name in locked])
    m.event("vertical", crank.angle(), crosses=-np.pi / 2, direction="down", then=mb.EndRun())
    m.output("angle", crank.angle())
    m.output("rate", bodies["last"].rate())
    m.output("residual", m.velocity_residual)
    m.output("effort", bodies[locked[0]].effort())
    return m


@pytest.mark.parametrize("locked", [("crank",), ("last",), ("beam", "middle")])
@pytest.mark.parametrize("solver", SMALL)
def test_a_brake_stops_a_parallelogram(solver: str, locked: tuple[str, ...]) -> None:
    """Closed form: the whole loop stands while one joint is locked; then it falls from rest. Locked joints of a closed
    loop are redundant, too.
    """
    tolerance, amplitude = 1e-7, 0.5
    result = mb.simulate(parallelogram(*locked), 2.0, interval=0.1, solver=solver, tolerance=tolerance)
    fall = quad(lambda x: 1.0 / np.sqrt(2.0 * G * (np.cos(1.0 - x * x) - np.cos(1.0))) * 2.0 * x, 0.0, np.sqrt(0.5))[0]
    assert times(result, "brake") == pytest.approx([fall], abs=30.0 * tolerance)
    quarter = ellipk(np.sin(amplitude / 2) ** 2) / np.sqrt(G)
    assert times(result, "vertical") == pytest.approx([1.0 + quarter], abs=30.0 * tolerance)
    held = (result.t > fall) & (result.t < 1.0)
    np.testing.assert_allclose(result["angle"][held], amplitude - np.pi / 2, rtol=0.0, atol=tolerance)
    np.testing.assert_allclose(result["rate"][held], 0.0, rtol=0.0, atol=1e-12)
    assert result["residual"].max() <= 1e-9
    if locked == ("crank",):
        np.testing.assert_allclose(result["effort"][held], G * np.sin(amplitude), rtol=1e-6)
    assert not result.warning


@pytest.mark.parametrize("solver", ["adams", "ida", "esdirk"])
def test_a_brake_stops_a_row_of_fourbars(solver: str) -> None:
    """Reference: SciPy's integral of the time over the angle, whose rate follows from the energy. The loops are
    eliminated along the tree, also where the locked joints leave no more coordinates than a small model has.
    """
    loops, tolerance, m = 31, 1e-6, n_four_bar(31).mechanism
    inertia, weight = (loops + 1) / 3.0 + loops, (0.5 * (loops + 1) + loops) * G  # kg m2; N m, of rods of 1 m and 1 kg
    first = 1.2
    columns = [m.bodies[k] for k in (loops, 1, 2)]
    m.event("brake", m.bodies[1].angle(), crosses=first, direction="down", then=list(map(mb.Lock, columns)))
    m.event("open", at=1.4, then=list(map(mb.Release, columns)))
    m.event("low", m.bodies[1].angle(), crosses=0.8, direction="down", then=mb.EndRun())
    m.output("rate", m.bodies[-1].rate())
    result = mb.simulate(m, 5.0, interval=0.1, solver=solver, tolerance=tolerance)
    fall = quad(lambda x: 1.0 / np.sqrt(1.0 + 2.0 * weight / inertia * (1.0 - np.sin(x))), first, 0.5 * np.pi)[0]
    speed = lambda x: np.sqrt(2.0 * weight / inertia * (np.sin(first) - np.sin(first - x * x)))  # noqa: E731
    then = quad(lambda x: 2.0 * x / speed(x), 0.0, np.sqrt(first - 0.8))[0]
    assert times(result, "brake") == pytest.approx([fall], abs=100.0 * tolerance)
    assert times(result, "low") == pytest.approx([1.4 + then], abs=100.0 * tolerance)
    held = (result.t > fall) & (result.t < 1.4)
    np.testing.assert_allclose(result["rate"][held], 0.0, rtol=0.0, atol=1e-9)
    assert not result.warning


@pytest.mark.parametrize("solver", ["adams", "esdirk", "ida"])
def test_one_of_many_masses_is_held(solver: str) -> None:
    """Closed form: the last of 130 masses is pushed with 1 N, held at 0.5 m after 1 s, and released at 1.5 s."""
    m = mb.Mechanism()
    bodies = [m.body(f"b{k}", m.ground, mb.Translational(axis="x"), mass=1.0) for k in range(130)]
    m.force("push", mb.JointForce(mb.Step(height=1.0)), bodies[-1])
    m.event("hold", bodies[-1].coordinate(), crosses=0.5, then=mb.Lock(bodies[-1]))
    m.event("let go", at=1.5, then=mb.Release(bodies[-1]))
    m.output("x", bodies[-1].coordinate())
    result = mb.simulate(m, 2.0, interval=0.5, solver=solver, tolerance=1e-6)
    np.testing.assert_allclose(times(result, "hold"), [1.0], rtol=0.0, atol=3e-5)
    np.testing.assert_allclose(result["x"], [0.0, 0.125, 0.5, 0.5, 0.625], rtol=0.0, atol=3e-5)
    assert not result.warning


@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida", "esdirk", "radau"])
def test_a_large_model_all_of_whose_loops_are_locked(solver: str) -> None:
    """Closed form: no constraint remains, and a mass that is not locked falls."""
    m = n_four_bar(31).mechanism
    rods = m.bodies[1:]
    mass = m.body("mass", m.ground, mb.Translational(axis="y"), mass=2.0)
    m.event("brake", at=1.0, then=[mb.Lock(rod) for rod in rods])
    compiled = as_model(m).compile()
    q, v = compiled.assemble(0.0)
    held = {rod.index: float(q[compiled.data.arrays.bodies["qf"][rod.index]]) for rod in rods}
    system = compiled.locks.lock(held, (), 0.0, q)
    assert (system.n, system.m) == (mass.joint.nv, 0)
    run = stepper(solver, system, 0.0, *compiled.locks.free_coordinates(q, 0.0 * v), Options(rtol=1e-6, duration=0.4))
    run.advance(0.4)
    assert run.status.ok
    np.testing.assert_allclose(run.q, -0.5 * G * 0.4**2, rtol=1e-6)

"""Impulses at events: jumps of velocities in open trees and in loops, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.modeling.settings import Settings
from mbfmu.session.impulses import UndeterminedJumpError, velocity_jump
from mbfmu.session.simulation import Simulation

SMALL = ["adams", "hybrid", "ida", "radau"]


@pytest.mark.parametrize("solver", SMALL)
def test_an_impulse_on_a_double_pendulum(solver: str):
    """Closed form: two rods of 1 kg and 1 m in one line, without gravity; the impulse acts at the second joint.

    About the first joint and in relative angles the mass matrix is [[8/3, 5/6], [5/6, 1/3]] kg m^2. A first-order
    state does not change.
    """
    m = mb.Mechanism()
    first = m.body("first", m.ground, mb.Revolute(), **mb.rod(mass=1.0, length=1.0))
    second = m.body("second", first, mb.Revolute(at=(1.0, 0.0, 0.0)), **mb.rod(mass=1.0, length=1.0))
    z = m.state("z", "0", start=3.0)
    m.event("hit", at=0.5, then=[mb.Impulse(second, 0.2), mb.EndRun()])
    for name, sensor in (("first", first.rate()), ("second", second.rate()), ("z", z.value())):
        m.output(name, sensor)
    result = mb.simulate(m, 1.0, interval=0.5, solver=solver, tolerance=1e-8)
    expected = np.linalg.solve([[8 / 3, 5 / 6], [5 / 6, 1 / 3]], [0.0, 0.2])
    simulation = Simulation(m, Settings(solver=solver, tolerance=1e-8))
    simulation.advance(1.0)
    assert result.t[-1] == simulation.t == 0.5
    np.testing.assert_allclose(simulation.outputs()[:3], [*expected, 3.0], rtol=1e-9)
    assert simulation.discontinuity_work == pytest.approx(0.5 * 0.2 * expected[1], rel=1e-9)


def test_an_impulse_on_a_joint_between_two_bodies() -> None:
    """The same pendulum as a graph, with the second joint in the opposite direction, and so with the opposite sign."""
    m = mb.Mechanism()
    first = m.body("first", **mb.rod(mass=1.0, length=1.0))
    second = m.body("second", **mb.rod(mass=1.0, length=1.0))
    shoulder = m.joint("shoulder", m.ground, first, mb.Revolute())
    elbow = m.joint("elbow", second, first, mb.Revolute(), at_b=(1.0, 0.0, 0.0))
    m.event("hit", at=0.5, then=mb.Impulse(elbow, -0.2))
    m.output("first", shoulder.rate())
    m.output("second", elbow.rate())
    simulation = Simulation(m, Settings(solver="adams", tolerance=1e-8))
    simulation.advance(0.5)
    expected = np.linalg.solve([[8 / 3, 5 / 6], [5 / 6, 1 / 3]], [0.0, 0.2])
    np.testing.assert_allclose(simulation.outputs()[:2], [expected[0], -expected[1]], rtol=1e-9)


@pytest.mark.parametrize("solver", SMALL)
def test_an_impulse_on_a_parallelogram(solver: str):
    """Closed form: massless cranks of 1 m, a coupler of 2 kg that only translates: the rate jumps by p / (m l^2)."""
    m = mb.Mechanism()
    crank = m.body("crank", m.ground, mb.Revolute(start=1.0, fixed=True))
    coupler = m.body("coupler", crank, mb.Revolute(at=(1.0, 0.0, 0.0), start=-1.0), **mb.rod(mass=2.0, length=2.0))
    rocker = m.body("rocker", coupler, mb.Revolute(at=(2.0, 0.0, 0.0), start=1.0))
    m.cut("pivot", mb.RevoluteCutJoint(at_a=(-1.0, 0.0, 0.0), at_b=(2.0, 0.0, 0.0)), rocker, m.ground)
    m.event("hit", at=0.25, then=mb.Impulse(crank, 0.5))
    for name, body in (("crank", crank), ("coupler", coupler), ("rocker", rocker)):
        m.output(name, body.rate())
    m.output("angle", crank.angle())
    m.output("residual", m.velocity_residual)
    result = mb.simulate(m, 1.25, interval=0.25, solver=solver, tolerance=1e-7)
    for name, sign in (("crank", 1.0), ("coupler", -1.0), ("rocker", 1.0)):
        np.testing.assert_allclose(result[name][2:], sign * 0.25, rtol=0.0, atol=1e-6)
    assert result["angle"][-1] == pytest.approx(1.25, abs=3e-6)
    assert result["residual"].max() <= 1e-9
    assert not result.warning


@pytest.mark.parametrize("density", [1e-9, 1.0, 1e6])  # kg/m
@pytest.mark.parametrize("length", [1e-6, 1.0, 1e3])
def test_an_impulse_in_a_redundant_loop_of_any_size(length: float, density: float) -> None:
    """Closed form: rods on three parallel cranks, one of them redundant, have the inertia 3 m l^2 / 3 + 2 m l^2."""
    mass = density * length
    m = mb.Mechanism()
    cranks = [
        m.body(f"crank{k}", m.ground, mb.Revolute(at=(k * length, 0, 0), start=1.0), **mb.rod(mass=mass, length=length))
        for k in range(3)
    ]
    at = {"at": (length, 0, 0), "start": -1.0}
    coupler = m.body("coupler", cranks[0], mb.Revolute(**at), **mb.rod(mass=2.0 * mass, length=2.0 * length))
    for k in (1, 2):
        joint = mb.RevoluteCutJoint(at_a=(k * length, 0, 0), at_b=(length, 0, 0))
        m.cut(f"pin{k}", joint, coupler, cranks[k])
    m.event("kick", at=0.1, then=mb.Impulse(cranks[0], 0.7 * 3.0 * mass * length**2))
    for crank in cranks:
        m.output(f"{crank.name}.rate", crank.rate())
    result = mb.simulate(m, 0.3, interval=0.1, solver="adams", tolerance=1e-8)
    assert not result.warning
    for crank in cranks:
        assert result[f"{crank.name}.rate"][-1] == pytest.approx(0.7, rel=1e-7)


def test_an_impulse_on_what_has_no_mass_is_refused() -> None:
    m = mb.Mechanism()
    arm = m.body("arm", m.ground, mb.Revolute(), **mb.rod(mass=1.0, length=1.0))
    m.body("nothing", arm, mb.Translational(axis="x"))
    compiled = mb.mechanics.CompiledMechanism(m)
    with pytest.raises(UndeterminedJumpError, match="moves a coordinate without mass"):
        velocity_jump(compiled, 0.0, np.zeros(2), np.zeros(2), np.array([0.0, 1.0]))

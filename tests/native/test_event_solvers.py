"""Events in native FMUs with every solver, in loops, at several stops at once, and in large models."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from fmpy import simulate_fmu

import mbfmu as mb
from mbfmu.fmi.export import export

pytestmark = [
    pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="needs a C compiler"),
    pytest.mark.campaign,
]
G, FALL = 9.81, 0.5


@dataclass(frozen=True, kw_only=True)
class Loop(mb.Model):
    """A beam on three parallel cranks, one of which is redundant; and a rod that falls flat on two stops.

    The rods of the cranks have 1 kg and 1 m, the beam has 2 kg: the moment of inertia is 3 / 3 + 2 kg m^2.
    """

    name = "loop"

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism()
        cranks = [
            m.body(f"crank{k}", m.ground, mb.Revolute(at=(k, 0, 0), start=1.0), **mb.rod(mass=1.0, length=1.0))
            for k in range(3)
        ]
        coupler = m.body("coupler", cranks[0], mb.Revolute(at=(1, 0, 0), start=-1.0), **mb.rod(mass=2.0, length=2.0))
        for k in (1, 2):
            m.cut(f"pin{k}", mb.RevoluteCutJoint(at_a=(k, 0, 0), at_b=(1, 0, 0)), coupler, cranks[k])
        m.event("kick", at=0.123, then=mb.Impulse(cranks[2], 3.0))
        m.event("back", cranks[1].angle(), crosses=1.5, direction="up", then=mb.Bounce(0.5))
        rod = m.body("rod", m.ground, mb.Planar(start=(0, FALL, 0)), **mb.rod(mass=1.0, length=1.0))
        m.force("weight", mb.PointForce(magnitude=-G, axis="y", at_a=(0.5, 0, 0)), rod)
        for name, x in (("left", 0.0), ("right", 1.0)):
            m.event(name, rod.position("y", point=(x, 0, 0)), direction="down", then=mb.Bounce(0.6))
        m.output("angle", cranks[0].angle())
        m.output("rate", cranks[2].rate())
        m.output("height", rod.position("y"))
        m.output("turning", rod.rate(2))
        return m


@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
@pytest.mark.parametrize("solver", ["adams", "hybrid", "radau", "ida"])
def test_events_in_a_loop_and_at_two_stops(solver: str, kind: str, tmp_path: Path) -> None:
    """Closed forms: after the kick the loop turns with 1 rad/s until it bounces at 1.5 rad; the rod does not turn.

    Errors of the solver decide which end of the rod hits first at its second impact, which is not compared.
    """
    path = export(Loop(), tmp_path / "loop.fmu", mb.Settings(solver=solver, tolerance=1e-8), native=True)
    how = {"fmi_type": kind, "relative_tolerance": 1e-9, "record_events": False}
    found = simulate_fmu(str(path), stop_time=1.0, output_interval=0.1, **how)
    t, turn, hit = found["time"], 0.123 + 0.5, np.sqrt(2.0 * FALL / G)
    angle = np.where(t < 0.123, 1.0, np.where(t < turn, 1.0 + t - 0.123, 1.5 - 0.5 * (t - turn)))
    np.testing.assert_allclose(found["angle"], angle, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(
        found["rate"], np.where(t < 0.123, 0.0, np.where(t < turn, 1.0, -0.5)), rtol=0.0, atol=1e-6
    )
    speed, flight = 0.6 * G * hit, t - hit
    height = np.where(flight < 0.0, FALL - 0.5 * G * t**2, speed * flight - 0.5 * G * flight**2)
    once = flight < 2.0 * speed / G
    np.testing.assert_allclose(found["height"][once], height[once], rtol=0.0, atol=2e-6)
    np.testing.assert_allclose(found["turning"][once], 0.0, rtol=0.0, atol=1e-8)


@dataclass(frozen=True, kw_only=True)
class Row(mb.Model):
    """130 masses, the last of which is pushed until it has moved 0.5 m, and then braked until it stands; two others hit
    a stop and are hit.
    """

    name = "row"

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism()
        force = mb.Input(name="force", unit="N", start=1.0)
        bodies = [m.body(f"b{k}", m.ground, mb.Translational(axis="x"), mass=1.0) for k in range(130)]
        m.force("push", mb.JointForce(force), bodies[-1])
        m.event("mark", bodies[-1].coordinate(), crosses=0.5, direction="up", then=mb.SetInput("force", -2.0))
        m.event("stop", bodies[-1].rate(), direction="down", then=mb.EndRun())
        m.event("hit", at=0.25, then=[mb.Impulse(bodies[0], 2.0), mb.Impulse(bodies[1], -1.0)])
        m.event("back", bodies[0].coordinate(), crosses=1.0, direction="up", then=mb.Bounce(0.5))
        m.output("x", bodies[-1].coordinate())
        m.output("first", bodies[0].coordinate())
        m.output("second", bodies[1].coordinate())
        return m


@pytest.mark.parametrize("solver", ["adams", "esdirk", "ida"])
def test_events_in_a_large_model(solver: str, tmp_path: Path) -> None:
    path = export(Row(), tmp_path / "row.fmu", mb.Settings(solver=solver, tolerance=1e-6), native=True)
    found = simulate_fmu(str(path), stop_time=3.0, output_interval=0.4, fmi_type="CoSimulation")
    t = found["time"]
    assert t[-1] == pytest.approx(1.5, abs=3e-5)
    expected = np.where(t < 1.0, 0.5 * t**2, 0.5 + (t - 1.0) - (t - 1.0) ** 2)
    np.testing.assert_allclose(found["x"], expected, rtol=0.0, atol=3e-5)
    first = np.minimum(2.0 * np.maximum(t - 0.25, 0.0), 1.0 - np.maximum(t - 0.75, 0.0))
    np.testing.assert_allclose(found["first"], first, rtol=0.0, atol=3e-5)
    np.testing.assert_allclose(found["second"], -np.maximum(t - 0.25, 0.0), rtol=0.0, atol=3e-5)

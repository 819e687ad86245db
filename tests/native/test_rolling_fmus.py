"""Wheels that roll without slip in native FMUs: the bits of a simulation, closed forms, and warnings."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import simulate_fmu

import mbfmu as mb
from mbfmu.fmi.export import export

G, MASS = 9.81, 2.0
BALL_RATE = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # m/s, rad/s
needs_compiler = pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="needs a C compiler")


@dataclass(frozen=True, kw_only=True)
class Disk(mb.Model):
    """A disk that rolls in a circle with an inclined axle, and another one that is pushed along x."""

    radius: float = mb.parameter(1.0, unit="m", min=1e-4, doc="Radius of the disks")
    lean: float = mb.parameter(0.35, unit="rad", structural=True, doc="Angle of the axle above the plane")
    push: float = mb.parameter(1.0, doc="Force on the second disk over its weight")
    friction: float = mb.parameter(0.3, min=0.01, doc="Coefficient of friction of the second disk")

    def build(self) -> mb.Mechanism:
        R, lean, turning = self.radius, self.lean, 1.7 * np.sqrt(G / self.radius)
        across, along = MASS * R**2 / 4, MASS * R**2 / 2
        w_u, w_e = -turning * np.cos(lean), turning * np.sin(lean)
        spin = (across * w_e * w_u + MASS * G * R * np.sin(lean)) / ((along + MASS * R**2) * w_u)
        m = mb.Mechanism(gravity=(0.0, 0.0, -G))
        start = (0.0, 0.0, R * np.cos(lean), np.cos(lean / 2), np.sin(lean / 2), 0.0, 0.0)
        joint = mb.Floating(start=start, rate=(R * spin, 0.0, 0.0, 0.0, spin, -w_u))
        disk = m.body("disk", m.ground, joint, mass=MASS, inertia=(across, along, across))
        contact = m.cut("contact", mb.RollingWheel(radius=R), m.ground, disk)
        cart = m.body("cart", m.ground, mb.Translational(axis="x", at=(0.0, 0.0, R)))
        lift = m.body("lift", cart, mb.Translational(axis="z"))
        wheel = m.body("wheel", lift, mb.Revolute(axis="y"), mass=MASS, inertia=(across, along, across))
        rolling = mb.RollingWheel(radius=R, grip="longitudinal", friction=self.friction)
        road = m.cut("road", rolling, m.ground, wheel)
        m.force("push", mb.PointForce(magnitude=self.push * MASS * G, axis="x"), cart)
        ball = m.body(
            "ball",
            m.ground,
            mb.Floating(start=(0.0, 0.0, 0.999 * R, 1.0, 0.0, 0.0, 0.0), rate=BALL_RATE),
            mass=MASS,
            inertia=(0.4 * MASS * R**2,) * 3,
        )
        tire = mb.SlippingWheel(
            radius=R,
            crown_radius=R,
            stiffness=1e3 * MASS * G / R,
            damping=1.0 / np.sqrt(G * R),
            friction=self.friction,
            deflection=1e-3 * R,
        )
        m.force("tire", tire, ball)
        for axis in "xyz":
            m.output(axis, disk.position(axis))
        m.output("normal", contact.force("normal"))
        m.output("way", cart.position("x"))
        m.output("demand", road.required_friction())
        m.output("slid", ball.position("x"))
        return m


NAMES = "x", "y", "z", "normal", "way", "demand", "slid"


def exact(t: Any, size: float, push: float = 1.0, friction: float = 0.3) -> Any:
    """NAMES: a circle of the radius R spin / yaw', and x'' = F / (m + C / R^2), of which C x'' / R^2 is friction."""
    lean, turning = 0.35, 1.7 * np.sqrt(G / size)
    w_u, w_e = -turning * np.cos(lean), turning * np.sin(lean)
    spin = (0.25 * w_e * w_u + G / size * np.sin(lean)) / (1.5 * w_u)
    radius, angle = size * spin / turning, turning * t
    circle = radius * np.sin(angle), radius * (1.0 - np.cos(angle)), 0.0 * t + size * np.cos(lean)
    s = np.minimum(t, 1.0 / (friction * G * 3.5))  # until the ball rolls
    slid = s - 0.5 * friction * G * s**2 + (1.0 - friction * G * s) * (t - s)
    return *circle, 0.0 * t + MASS * G, push * G / 1.5 * t**2 / 2.0, 0.0 * t + abs(push) / 3.0, slid


def run(path: Path, duration: float, kind: str = "CoSimulation", **start: float) -> tuple[Any, list[str]]:
    """Return the outputs of an FMU, and the warnings that it logs."""
    said: list[str] = []
    found = simulate_fmu(
        str(path), stop_time=duration, output_interval=duration / 10, fmi_type=kind, start_values=start,
        relative_tolerance=1e-8, debug_logging=True,
        logger=lambda *given: said.append(given[-1].decode()) if given[2] == 1 else None,
    )  # fmt: skip
    return found, said


@needs_compiler
@pytest.mark.parametrize(
    "solver", ["adams", *(pytest.param(solver, marks=pytest.mark.campaign) for solver in ("ida", "radau"))]
)
def test_native_fmu_rolls_as_the_simulation_and_the_closed_form(tmp_path: Path, solver: str) -> None:
    settings = mb.Settings(solver=solver, tolerance=1e-8)
    path = export(Disk(), tmp_path / "disk.fmu", settings, native=True)
    found, said = run(path, 2.0)
    simulation = mb.Simulation(Disk(), settings)
    for row in found[1:]:
        assert simulation.advance(row["time"]).ok
        assert [row[name] for name in NAMES] == simulation.outputs()[: len(NAMES)].tolist()
    warned = [d for d in simulation.diagnostics if d.severity == "warning"]
    assert [d.code for d in warned] == ["slipping-wheel"]
    assert sorted(said) == sorted(map(str, warned))
    for size, push, friction in ((1.0, 0.8, 0.3), (1e-3, -0.5, 0.3), (1e3, 2.0, 0.7)):
        for kind in ("CoSimulation", "ModelExchange"):
            duration = 2.0 * np.sqrt(size)
            found, said = run(path, duration, kind, radius=size, push=push, friction=friction)
            values = np.array([found[name] for name in NAMES])
            units = np.array([size, size, size, MASS * G, size, 1.0, 1e3 * size])[:, np.newaxis]
            np.testing.assert_allclose(
                values / units, np.array(exact(found["time"], size, push, friction)) / units, atol=2e-6
            )
            assert not said, (size, kind)


@dataclass(frozen=True, kw_only=True)
class Bump(mb.Model):
    """A wheel that rolls over a bump and leaves the points of its profile on the other side."""

    radius: float = mb.parameter(0.3, unit="m", min=1e-4, doc="Radius of the wheel")

    def build(self) -> mb.Mechanism:
        x = np.linspace(-1.0, 2.2, 33)
        table = mb.Table(x, 0.06 * (1.0 - np.cos(np.pi * x)) * ((x > 0.0) & (x < 2.0)), kind="akima")
        m = mb.Mechanism(gravity=(0.0, 0.0, -G))
        cart = m.body("cart", m.ground, mb.Translational(axis="x", start=-0.5, rate=1.5, fixed=True))
        lift = m.body("lift", cart, mb.Translational(axis="z", start=self.radius))
        wheel = m.body("wheel", lift, mb.Revolute(axis="y"), mass=MASS, inertia=(0.1, 0.1, 0.1))
        road = m.cut("road", mb.RollingWheel(radius=self.radius, profile=table), m.ground, wheel)
        m.output("way", cart.position("x"))
        m.output("rate", cart.velocity("x"))
        m.output("height", lift.position("z"))
        m.output("normal", road.force("normal"))
        return m


@needs_compiler
def test_native_fmu_rolls_over_a_bump_and_reports_what_the_simulation_does(tmp_path: Path) -> None:
    """Behind the bump the wheel has its first velocity again."""
    settings = mb.Settings(solver="adams", tolerance=1e-8)
    path = export(Bump(), tmp_path / "bump.fmu", settings, native=True)
    found, said = run(path, 3.0)
    simulation = mb.Simulation(Bump(), settings)
    for row in found[1:]:
        assert simulation.advance(row["time"]).ok
        assert [row[name] for name in ("way", "rate", "height", "normal")] == simulation.outputs()[:4].tolist()
    warned = [d for d in simulation.diagnostics if d.severity == "warning"]
    assert [d.code for d in warned] == ["profile-end"]
    assert sorted(said) == sorted(map(str, warned))
    exchanged, said = run(path, 3.0, "ModelExchange")
    assert len(said) == 1
    assert "touches its profile at x = " in said[0]
    for values in (found, exchanged):
        assert values["rate"][-1] == pytest.approx(1.5, abs=1e-6)
        assert values["rate"].min() < 1.0

"""Events in FMUs that call Python: they occur within communication steps, and importing tools may repeat steps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from fmpy import simulate_fmu

import mbfmu as mb
from mbfmu.fmi import Fmu, export
from mbfmu.fmi.export import without_rest
from mbfmu.util.errors import UserError

G, RESTITUTION, END = 9.81, 0.8, 2.8


@dataclass(frozen=True, kw_only=True)
class Ball(mb.Model):
    """A ball that falls from 1 m and bounces, until a given time."""

    name = "bouncing_ball"
    restitution: float = mb.parameter(RESTITUTION)

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0.0, -G, 0.0))
        push = mb.Input(name="push", unit="N", start=0.0)
        ball = m.body("ball", m.ground, mb.Translational(axis="y", start=1.0, fixed=True), mass=1.0)
        m.force("jet", mb.JointForce(push), ball)
        m.event("floor", ball.coordinate(), direction="down", then=mb.Bounce(self.restitution))
        m.event("end", at=END, then=mb.EndRun())
        m.output("height", ball.coordinate())
        m.output("rate", ball.rate())
        return m


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    settings = mb.Settings(solver="adams", tolerance=1e-8)
    return export(Ball(), tmp_path_factory.mktemp("fmu") / "ball.fmu", settings, native=False)


def test_the_export_states_which_stops_of_native_fmus_hold_nothing() -> None:
    m = Ball().build()
    assert not without_rest(m)
    m.event("wall", m.bodies[1].position("y"), crosses=2.0, direction="up", then=mb.Bounce(0.5))
    (note,) = without_rest(m)
    assert (note.severity, note.code, note.subject) == ("note", "resting-bounce", "wall")


def motion(t: float) -> tuple[float, float]:
    """Return height and rate: a parabola from 1 m, then flights that start with e^n times the first speed."""
    fall, speed = np.sqrt(2.0 / G), np.sqrt(2.0 * G)
    t, speed = (t - fall, RESTITUTION * speed) if t > fall else (t + fall, speed)
    while t > 2.0 * speed / G:
        t, speed = t - 2.0 * speed / G, RESTITUTION * speed
    return speed * t - 0.5 * G * t * t, speed - G * t


def test_bounces_within_communication_steps(path: Path) -> None:
    """Closed form; steps of 0.4 s contain up to two bounces."""
    found = simulate_fmu(str(path), stop_time=2.4, output_interval=0.4, output=["height", "rate"])
    assert found["time"][-1] == pytest.approx(2.4)
    expected = np.array([motion(t) for t in found["time"]])
    np.testing.assert_allclose(found["height"], expected[:, 0], rtol=0.0, atol=2e-7)
    np.testing.assert_allclose(found["rate"], expected[:, 1], rtol=0.0, atol=2e-6)


def test_a_step_with_events_is_repeated(path: Path) -> None:
    """An importing tool returns to the state before two bounces; a second instance continues from there, too."""
    with Fmu(path) as first, Fmu(path) as second:
        first.step(0.9)
        state, t = first.save(), first.t
        first.step(0.9)
        reached = first.reals().tolist()
        for fmu in (first, second):
            fmu.restore(state)
            fmu.t = t
            fmu.step(0.9)
            assert fmu.reals().tolist() == reached


def test_a_step_beyond_the_end_is_refused_and_leaves_the_state(path: Path) -> None:
    with Fmu(path) as fmu:
        fmu.step(2.6)
        before = fmu.reals().tolist()
        with pytest.raises(UserError, match=r"event 'end' ends the run at t = 2.8 s; step to this time at most"):
            fmu.step(0.4)
        assert fmu.reals().tolist() == before
        fmu.t = 2.6
        fmu.step(0.15)
        np.testing.assert_allclose([fmu["height"], fmu["rate"]], motion(2.75), rtol=0.0, atol=2e-6)


@dataclass(frozen=True, kw_only=True)
class Brake(mb.Model):
    """A flywheel on a motor shaft, which turns with 3 rad/s; a brake holds the flywheel from 0.55 s to 1.25 s."""

    name = "braked_flywheel"

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism()
        torque = mb.Input(name="torque", unit="N.m", start=1.0)
        wheel = m.body("wheel", m.ground, mb.Revolute(rate=3.0), inertia=(1, 1, 2.0))
        m.force("motor", mb.JointForce(torque), wheel)
        m.event("hold", at=0.55, then=mb.Lock(wheel))
        m.event("let go", at=1.25, then=mb.Release(wheel))
        m.output("rate", wheel.rate())
        m.output("angle", wheel.angle())
        return m


def turned(t: float) -> tuple[float, float]:
    """Return rate and angle of the flywheel."""
    first, last = min(t, 0.55), max(t - 1.25, 0.0)
    rate = 3.0 + 0.5 * t if t < 0.55 else 0.5 * last
    return rate, 3.0 * first + 0.25 * first**2 + 0.25 * last**2


def test_a_joint_is_locked_and_released_within_communication_steps(tmp_path: Path) -> None:
    """Closed form. An importing tool returns from the locked state to the one before, and another instance, too."""
    path = export(Brake(), tmp_path / "brake.fmu", mb.Settings(solver="adams", tolerance=1e-8), native=False)
    found = simulate_fmu(str(path), stop_time=2.0, output_interval=0.4, output=["rate", "angle"])
    expected = np.array([turned(t) for t in found["time"]])
    np.testing.assert_allclose(found["rate"], expected[:, 0], rtol=0.0, atol=2e-7)
    np.testing.assert_allclose(found["angle"], expected[:, 1], rtol=0.0, atol=2e-7)
    with Fmu(path) as first, Fmu(path) as second:
        states = []
        for _ in range(4):
            states.append(first.save())
            first.step(0.5)
        reached = first.reals().tolist()
        for fmu in (first, second):
            for k in (2, 0, 3, 1):
                fmu.restore(states[k])
                fmu.t = 0.5 * k
                for _ in range(k, 4):
                    fmu.step(0.5)
                assert fmu.reals().tolist() == reached


def test_a_ball_at_rest_is_saved_and_lifted(tmp_path: Path) -> None:
    """Communication steps of different lengths; a second instance continues from a state in which the ball rests."""
    settings = mb.Settings(solver="adams", tolerance=1e-8)
    path = export(Ball(restitution=0.3), tmp_path / "ball.fmu", settings, native=False)
    at_rest = (1.0 + 2.0 * 0.3 / 0.7) * np.sqrt(2.0 / G)  # s; 0.84
    with Fmu(path) as first, Fmu(path) as second:
        while first.t < at_rest:
            first.step(0.17)
        assert (first["height"], first["rate"]) == (0.0, 0.0)
        state, t, second.t = first.save(), first.t, first.t
        second.restore(state)
        for fmu in (first, second):
            fmu.step(0.013)
            fmu["push"] = 1.5 * G
            fmu.step(0.5)
            assert fmu.t == pytest.approx(t + 0.513)
            assert fmu["height"] == pytest.approx(0.5 * 0.5 * G * 0.5**2, rel=1e-7)
            assert fmu["rate"] == pytest.approx(0.5 * G * 0.5, rel=1e-7)

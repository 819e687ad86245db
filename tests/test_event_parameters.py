"""Events that change parameters of the model, and parameters that change events."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.fmi import Fmu, export
from mbfmu.modeling.settings import Settings
from mbfmu.session.simulation import Simulation
from mbfmu.util.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Oscillator(mb.Model):
    """A mass of 1 kg on a spring, released at 1 m, whose stiffness changes where it passes a level."""

    name = "oscillator"
    stiffness: float = mb.parameter(1.0, unit="N/m", min=0.1, tunable=True)
    level: float = mb.parameter(0.5, unit="m", tunable=True)
    clock_time: float = mb.parameter(50.0, unit="s", tunable=True)
    mass: float = mb.parameter(1.0, unit="kg", min=0.1)
    action: tuple = ("stiffness", 4.0)

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism()
        body = m.body("mass", m.ground, mb.Translational(axis="x", start=1.0), mass=self.mass)
        m.force("spring", mb.JointSpring(stiffness=self.stiffness), body)
        m.event("pass", body.coordinate(), crosses=self.level, direction="down", then=mb.SetParameter(*self.action))
        m.event("clock", at=self.clock_time)
        m.output("x", body.coordinate())
        m.output("rate", body.rate())
        return m


def motion(t: float, level: float = 0.5) -> tuple[float, float]:
    """Return x and x': cos(t) down to the level, from there on with the stiffness 4."""
    at = float(np.arccos(level))
    if t < at:
        return float(np.cos(t)), -float(np.sin(t))
    c, s, rate = np.cos(2.0 * (t - at)), np.sin(2.0 * (t - at)), -np.sin(at)
    return float(level * c + 0.5 * rate * s), float(rate * c - 2.0 * level * s)


@pytest.mark.parametrize("solver", ["adams", "ida"])
def test_a_stiffness_changes(solver: str) -> None:
    """Closed form. The change of the energy of the spring is no energy error."""
    result = mb.simulate(Oscillator(), 1.6, interval=0.2, solver=solver, tolerance=1e-8)
    expected = np.array([motion(t) for t in result.t])
    np.testing.assert_allclose(result.values[:, :2], expected, rtol=0.0, atol=3e-7)
    assert result.events[0].time == pytest.approx(np.arccos(0.5), abs=1e-7)
    assert abs(result["energy_error"]).max() <= 1e-6
    assert not result.warning


@pytest.mark.parametrize("kept", ["checkpoint", "save"])
def test_a_run_that_returns_has_the_parameters_of_before(kept: str) -> None:
    simulation = Simulation(Oscillator(), Settings(solver="adams", tolerance=1e-8))
    simulation.advance(0.5)
    state = simulation.checkpoint() if kept == "checkpoint" else simulation.save()
    simulation.advance(1.5)
    reached = simulation.outputs().copy()
    assert simulation.model.stiffness == 4.0
    (simulation.rollback if kept == "checkpoint" else simulation.restore)(state)  # type: ignore[operator]
    assert simulation.model.stiffness == 1.0
    simulation.advance(1.5)
    np.testing.assert_array_equal(simulation.outputs(), reached)


def test_a_parameter_changes_a_level() -> None:
    """The event is located at the new level, also after a return to the state before."""
    simulation = Simulation(Oscillator(), Settings(solver="adams", tolerance=1e-8))
    simulation.advance(0.5)
    state = simulation.checkpoint()
    simulation.retune(Oscillator(level=0.1))
    simulation.advance(1.6)
    np.testing.assert_allclose(simulation.outputs()[:2], motion(1.6, 0.1), rtol=0.0, atol=3e-7)
    simulation.rollback(state)
    simulation.advance(1.6)
    np.testing.assert_allclose(simulation.outputs()[:2], motion(1.6), rtol=0.0, atol=3e-7)
    with pytest.raises(UserError, match="a parameter changes the number, time or direction of events, such as 'clock'"):
        simulation.retune(Oscillator(clock_time=60.0))


@pytest.mark.parametrize(
    ("action", "text"),
    [
        (("mass", 2.0), "parameter 'mass' cannot change during a run: it is not tunable"),
        (("stiff", 2.0), "model 'oscillator' has no parameter 'stiff'"),
        (("stiffness", 0.0), "'stiffness' of 'oscillator' is 0.0"),
        (("clock_time", 60.0), "a parameter changes the number, time or direction of events"),
    ],
)
def test_a_parameter_that_cannot_be_set_is_refused_at_the_start(action: tuple, text: str) -> None:
    with pytest.raises(UserError, match=text):
        mb.simulate(Oscillator(action=action), 1.0, solver="adams")


def test_an_importing_tool_keeps_what_events_have_set(tmp_path: Path) -> None:
    """It sets another parameter after the event: the stiffness remains that of the event."""
    settings = Settings(solver="adams", tolerance=1e-8)
    with Fmu(export(Oscillator(), tmp_path / "oscillator.fmu", settings, native=False)) as fmu:
        fmu.step(1.2)
        fmu["level"] = -5.0
        fmu.step(0.4)
        np.testing.assert_allclose([fmu["x"], fmu["rate"]], motion(1.6), rtol=0.0, atol=3e-7)

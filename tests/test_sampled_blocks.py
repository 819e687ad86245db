"""Sampled blocks against exact recursions: of a plant whose input is held between the samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.modeling.settings import Settings
from mbfmu.session.simulation import Simulation
from mbfmu.util.errors import UserError

PERIOD, MASS, DAMPING, TARGET, GAIN, INTEGRAL = 0.05, 2.0, 5.0, 1.5, 8.0, 30.0


def controlled_cart() -> mb.Mechanism:
    """Return a damped cart whose speed a PI controller in discrete time controls."""
    m = mb.Mechanism()
    cart = m.body("cart", m.ground, mb.Translational(axis="x"), mass=MASS)
    m.force("drag", mb.JointDamper(damping=DAMPING), cart)
    step = INTEGRAL * PERIOD
    matrices: dict[str, Any] = {"A": [[1.0]], "B": [[step, -step]], "C": [[1.0]], "D": [[GAIN, -GAIN]]}
    control = m.sampled_system("control", [TARGET, cart.rate()], period=PERIOD, **matrices, units=["N"], nominal=10.0)
    m.force("motor", mb.JointForce(control.value()), cart)
    m.output("rate", cart.rate())
    m.output("force", control.value())
    return m


def recursion(count: int) -> tuple[Any, Any]:
    """Return rate and force at each sample: v' = (u - d v) / m with a constant u from one sample to the next."""
    decay, v, x = np.exp(-DAMPING * PERIOD / MASS), 0.0, 0.0
    rates, forces = [], []
    for _ in range(count):
        error = TARGET - v
        u = GAIN * error + x
        x += INTEGRAL * PERIOD * error
        rates.append(v)
        forces.append(u)
        v = decay * v + (1.0 - decay) * u / DAMPING
    return np.array(rates), np.array(forces)


@pytest.mark.parametrize("solver", ["adams", "radau", "ida"])
def test_a_digital_controller_follows_its_recursion(solver: str) -> None:
    """Exact recursion; the outputs at the samples are those after them."""
    result = mb.simulate(controlled_cart(), 1.0, interval=PERIOD, solver=solver, tolerance=1e-9)
    rates, forces = recursion(21)
    np.testing.assert_allclose(result["rate"], rates, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(result["force"], forces, rtol=0.0, atol=1e-5)
    assert not result.warning
    assert not result.failed


def test_outputs_are_held_between_samples() -> None:
    """No output is at a sample; the held force is that of the sample before."""
    times = 0.013 + 0.029 * np.arange(20)
    simulation = Simulation(controlled_cart(), Settings(solver="adams", tolerance=1e-9))
    _, forces = recursion(20)
    for t in times:
        assert simulation.advance(float(t)).ok
        assert simulation.outputs()[1] == pytest.approx(forces[int(t / PERIOD)], abs=1e-5)


@pytest.mark.parametrize("kept", ["checkpoint", "save"])
def test_a_run_that_returns_repeats_its_samples(kept: str) -> None:
    simulation = Simulation(controlled_cart(), Settings(solver="adams", tolerance=1e-8))
    simulation.advance(0.12)
    state = simulation.checkpoint() if kept == "checkpoint" else simulation.save()
    simulation.advance(0.4)
    reached = simulation.outputs().copy()
    (simulation.rollback if kept == "checkpoint" else simulation.restore)(state)  # type: ignore[operator]
    simulation.advance(0.4)
    np.testing.assert_array_equal(simulation.outputs(), reached)


def test_a_quantizer_rounds_the_samples_of_a_signal() -> None:
    """The signal at each sample, rounded to a multiple of 0.2; a second block samples half as often, from 0.3 s on."""
    m = mb.Mechanism()
    m.body("idle", m.ground, mb.Translational(axis="x"), mass=1.0)
    wave = mb.Function("sin(5 * t)")
    fine = m.sample_hold("fine", wave, period=0.1, quantum=0.2, start=7.0)
    coarse = m.sample_hold("coarse", fine, period=0.2)
    m.output("fine", fine.value())
    m.output("coarse", coarse.value())
    result = mb.simulate(m, 2.0, interval=0.1, solver="adams", tolerance=1e-6)
    expected = 0.2 * np.floor(np.sin(5.0 * 0.1 * np.arange(21)) / 0.2 + 0.5)
    np.testing.assert_allclose(result["fine"], expected, rtol=0.0, atol=1e-12)
    before = np.append(7.0, expected[1:-1:2])  # both sample at once: the second one reads the output before
    np.testing.assert_allclose(result["coarse"][::2], before, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(result["coarse"][1::2], before[:-1], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(("solver", "others"), [("adams", 0), ("ida", 0), ("radau", 0), ("adams", 60), ("ida", 60)])
@pytest.mark.parametrize("interval", [0.1, 0.037])
def test_samples_that_cross_a_value_are_events(solver: str, others: int, interval: float) -> None:
    """They occur at the first sample beyond the value, after a sample in each direction, and not at the start. An
    impulse there gives another rate from then on; a jump by the action of an event is none.
    """
    m = mb.Mechanism()
    cart = m.body("cart", m.ground, mb.Translational(axis="x", rate=0.5), mass=2.0)
    for k in range(others):
        m.body(f"other{k}", m.ground, mb.Translational(axis="x", nominal=1.0), mass=1.0)
    offset = mb.Input(name="offset", unit="m", start=0.0)
    wave = m.sample_hold("wave", mb.Function("sin(5 * t)"), period=0.1, start=-1.0)
    place = m.sample_hold("place", cart.coordinate(), period=0.2)
    m.event("turn", wave, crosses=0.3)
    m.event("push", place, crosses=0.25, direction="up", then=mb.Impulse(cart, 1.0))
    m.event("shift", at=0.7, then=mb.SetInput("offset", 10.0))
    m.event("none", m.expression("x + u", uses={"x": place, "u": offset}), crosses=5.0)
    m.output("x", cart.coordinate())
    result = mb.simulate(m, 2.0, interval=interval, solver=solver, tolerance=1e-6)
    is_above = np.sin(0.5 * np.arange(21)) > 0.3
    turns = 1 + np.flatnonzero(is_above[1:] != is_above[:-1])
    found = [(event.name, event.direction) for event in result.events]
    expected = [(0.1 * k, "turn", "up" if is_above[k] else "down") for k in turns.tolist()]
    expected = sorted([*expected, (0.1 * 6, "push", "up"), (0.1 * 7, "shift", "")], key=lambda event: event[0])
    assert found == [(name, direction) for _, name, direction in expected]
    np.testing.assert_allclose([event.time for event in result.events], [time for time, *_ in expected], atol=1e-12)
    np.testing.assert_allclose(result["x"], 0.5 * result.t + 0.5 * np.maximum(result.t - 0.6, 0.0), atol=1e-6)
    assert not result.warning


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"period": 0.0}, "period of block 's' is 0.0; allowed: finite and greater than zero"),
        ({"period": 1.0, "quantum": -1.0}, "quantum of block 's' is -1.0"),
        ({"period": 1.0, "start": np.nan}, "start of block 's' is nan"),
    ],
)
def test_wrong_blocks_are_refused(change: dict[str, Any], text: str) -> None:
    m = mb.Mechanism()
    with pytest.raises(UserError, match=text):
        m.sample_hold("s", 1.0, **change)


def test_outputs_that_a_block_does_not_have_are_refused() -> None:
    control = mb.Mechanism().sample_hold("s", 1.0, period=0.1)
    with pytest.raises(UserError, match="block 's' has no output 1; allowed: 0 to 0"):
        control.value(1)

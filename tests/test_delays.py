"""Delays against closed forms: delayed sines, the method of steps, characteristic roots of delayed feedback."""

from __future__ import annotations

from math import factorial, pi
from typing import Any

import numpy as np
import pytest
from scipy.special import lambertw

import mbfmu as mb
from mbfmu.modeling.settings import Settings
from mbfmu.session.simulation import Simulation
from mbfmu.util.errors import EquilibriumError, UserError


def delayed_cart(T: float, gain: float, *, samples: int = 30, degree: int = 3, rate: float = 1.0) -> mb.Mechanism:
    """Return a cart of 1 kg with the velocity v' = -gain v(t - T); v is ``rate`` until the start."""
    m = mb.Mechanism()
    cart = m.body("cart", m.ground, mb.Translational(axis="x", rate=rate, nominal=T * rate), mass=1.0)
    given: dict[str, Any] = {"delay": T, "samples": samples, "degree": degree, "nominal": rate}
    late = m.delay("late", cart.rate(), **given, start=rate, unit="m/s")
    m.force("brake", mb.JointForce("-k * y", uses={"k": gain, "y": late}), cart)
    m.output("rate", cart.rate())
    m.output("late", late.value())
    return m


def steps(t: Any, T: float, gain: float) -> Any:
    """Return the solution by the method of steps for v = 1 until the start."""
    found = np.ones_like(t)
    for j in range(1, int(np.max(t) / T) + 2):
        found += (-gain) ** j * np.maximum(t - (j - 1) * T, 0.0) ** j / factorial(j)
    return found


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e3])
@pytest.mark.parametrize("solver", ["adams", "radau", "ida"])
def test_delayed_feedback_follows_the_method_of_steps(solver: str, scale: float) -> None:
    """Closed form; derivatives jump at multiples of the delay. ``scale`` is that of time and of velocity."""
    T, gain = 0.5 * scale, 2.0 / scale
    m = delayed_cart(T, gain, rate=scale)
    result = mb.simulate(m, 4.0 * scale, interval=0.05 * scale, solver=solver, tolerance=1e-8)
    np.testing.assert_allclose(result["rate"] / scale, steps(result.t, T, gain), rtol=0.0, atol=1e-6)
    late = np.where(result.t < T, 1.0, steps(np.maximum(result.t - T, 0.0), T, gain))
    np.testing.assert_allclose(result["late"] / scale, late, rtol=0.0, atol=1e-6)
    assert not result.warning


@pytest.mark.parametrize("degree", [1, 3, 5])
def test_the_error_decreases_with_the_order_of_the_polynomials(degree: int) -> None:
    """Closed form: a sine, with the bound of the interpolation error and the observed order."""
    rate, T, errors = 9.0, 1.0, []
    for samples in (10 * degree, 20 * degree) if degree < 5 else (10, 20):
        m = mb.Mechanism()
        m.body("idle", m.ground, mb.Translational(axis="x", nominal=1.0), mass=1.0)
        m.output("y", m.delay("d", f"sin({rate} * t)", delay=T, samples=samples, degree=degree).value())
        result = mb.simulate(m, 3.0, interval=0.0073, solver="adams", tolerance=1e-10)
        late = result.t > T
        errors.append(np.abs(result["y"][late] - np.sin(rate * (result.t[late] - T))).max())
        s = np.linspace(0.0, degree, 1001)
        peak = np.abs(np.prod([s - j for j in range(degree + 1)], axis=0)).max() / factorial(degree + 1)
        bound = peak * (rate * T / samples) ** (degree + 1)
        assert 0.5 * bound < errors[-1] < bound + 1e-8
        assert np.abs(result["y"][~late]).max() < 1e-8
    assert np.log2(errors[0] / errors[1]) == pytest.approx(degree + 1, abs=0.3)


def test_lines_do_not_overshoot_at_jumps() -> None:
    """A jump from 0 to 1 at 0.31 s appears after the delay, within the time between two samples."""
    m = mb.Mechanism()
    m.body("idle", m.ground, mb.Translational(axis="x", nominal=1.0), mass=1.0)
    target = mb.Input(name="target", unit="1", start=0.0)
    m.output("y", m.delay("d", target, delay=0.5, samples=50, degree=1).value())
    m.event("jump", at=0.31, then=mb.SetInput("target", 1.0))
    result = mb.simulate(m, 1.2, interval=0.005, solver="adams", tolerance=1e-9)
    y = result["y"]
    assert y.min() > -1e-9
    assert y.max() < 1.0 + 1e-9
    np.testing.assert_allclose(y[result.t < 0.31 + 0.5 - 0.01 - 1e-9], 0.0, atol=1e-9)
    np.testing.assert_allclose(y[result.t > 0.31 + 0.5 + 0.01 + 1e-9], 1.0, atol=1e-9)


def test_a_run_that_returns_repeats_the_delay() -> None:
    simulation = Simulation(delayed_cart(0.5, 2.0), Settings(solver="adams", tolerance=1e-8))
    simulation.advance(0.7)
    state = simulation.save()
    simulation.advance(1.9)
    reached = simulation.outputs().copy()
    simulation.restore(state)
    simulation.advance(1.9)
    np.testing.assert_array_equal(simulation.outputs(), reached)


def controlled(ratio: float, scale: float = 1.0) -> mb.Mechanism:
    """Return a slow drive x' = v with a P controller of its delayed position: v follows -k x(t - T) at once, as the
    drive is strongly damped. ``ratio`` is k T over its limit pi / 2.
    """
    T, gain, damping = 0.2 * scale, ratio * pi / 2.0 / (0.2 * scale), 1e6 / scale
    m = mb.Mechanism()
    cart = m.body("cart", m.ground, mb.Translational(axis="x", nominal=1.0), mass=1.0)
    late = m.delay("late", cart.coordinate(), delay=T, unit="m")
    m.force("motor", mb.JointForce("d * (k * (0.3 - y) - v)", uses={"d": damping, "k": gain, "y": late}), cart)
    m.output("x", cart.coordinate())
    m.output("late", late.value())
    return m


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e3])
@pytest.mark.parametrize("ratio", [0.5, 0.99, 1.01])
def test_delayed_control_is_stable_up_to_its_limit(ratio: float, scale: float) -> None:
    """Closed forms: x' = -k x(t - T) is stable if k T < pi / 2, with the roots W(-k T) / T."""
    state = mb.equilibrium(controlled(ratio, scale))
    assert state.outputs["x"] == pytest.approx(0.3, abs=1e-9)
    assert state.outputs["late"] == pytest.approx(0.3, abs=1e-9)
    assert state.stability == ("stable" if ratio < 1.0 else "unstable")
    assert state.multipliers is not None
    largest = np.abs(state.multipliers).max()
    growth = np.log(largest) * 10.0  # over the delay; a period has 3 of 30 samples
    assert growth == pytest.approx(lambertw(-ratio * pi / 2.0).real, abs=1e-5)


def test_a_run_remains_in_the_steady_state() -> None:
    """Closed form: the position is the target. Linear models in continuous time are refused."""
    result = mb.simulate(controlled(0.9), 1.0, interval=0.1, tolerance=1e-8, start_at_equilibrium=True)
    np.testing.assert_allclose(result["x"], 0.3, rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(result["late"], 0.3, rtol=0.0, atol=1e-8)
    with pytest.raises(EquilibriumError, match="has sampled blocks"):
        mb.linearize(controlled(0.9))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"delay": 0.0}, "delay of block 'd' is 0.0; allowed: finite and greater than zero"),
        ({"samples": 31}, "samples of block 'd' is 31; allowed: a multiple of its degree 3 from 6 to 1000"),
        ({"samples": 3}, "samples of block 'd' is 3; allowed"),
        ({"samples": 1002}, "samples of block 'd' is 1002; allowed"),
        ({"degree": 0}, "degree of block 'd' is 0; allowed: a whole number from 1 to 5"),
        ({"degree": 1.5}, "degree of block 'd' is 1.5"),
        ({"start": np.inf}, "start of block 'd.history' is inf"),
    ],
)
def test_wrong_delays_are_refused(change: dict[str, Any], text: str) -> None:
    m = mb.Mechanism()
    with pytest.raises(UserError, match=text):
        m.delay("d", 1.0, **({"delay": 1.0} | change))


def test_delays_have_unique_names_and_one_output() -> None:
    m = mb.Mechanism()
    late = m.delay("d", 1.0, delay=1.0)
    with pytest.raises(UserError, match="block is named 'd'"):
        m.delay("d", 1.0, delay=1.0)
    with pytest.raises(UserError, match="block 'd' has no output 1; allowed: 0 to 0"):
        late.value(1)

"""Sampled blocks in native FMUs, co-simulation and model exchange, against the exact recursion."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import simulate_fmu

import mbfmu as mb
from mbfmu.fmi import Fmu
from mbfmu.fmi.export import export

pytestmark = pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="needs a C compiler")
SETTINGS = mb.Settings(solver="adams", tolerance=1e-9)
MASS, DAMPING, TARGET, INTEGRAL, TRIP = 2.0, 5.0, 1.5, 30.0, 0.6


@dataclass(frozen=True, kw_only=True)
class Cart(mb.Model):
    """A damped cart whose speed a PI controller in discrete time controls; its measurement is quantized and has an
    event, and a signal of its speed is delayed.
    """

    name = "sampled_cart"

    gain: float = mb.parameter(8.0, unit="N.s/m", min=1.0, max=20.0, doc="Proportional gain")
    period: float = mb.parameter(0.05, unit="s", min=0.01, max=0.2, doc="Period of the controller")
    delay: float = mb.parameter(0.2, unit="s", min=0.05, max=0.4, doc="Delay of the signal of the speed")

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism()
        cart = m.body("cart", m.ground, mb.Translational(axis="x"), mass=MASS)
        m.force("drag", mb.JointDamper(damping=DAMPING), cart)
        step = INTEGRAL * self.period
        matrices: dict[str, Any] = {"A": [[1.0]], "B": [[step, -step]], "C": [[1.0]]}
        matrices["D"] = [[self.gain, -self.gain]]
        control = m.sampled_system("control", [TARGET, cart.rate()], period=self.period, **matrices, nominal=10.0)
        m.force("motor", mb.JointForce(control.value()), cart)
        rounded = m.sample_hold("rounded", cart.rate(), period=0.1, quantum=0.25)
        m.output("rate", cart.rate())
        m.output("force", control.value())
        m.output("rounded", rounded.value())
        late = m.delay("late", cart.rate(), delay=self.delay, samples=40, degree=2)
        m.output("late", late.value())
        tripped = mb.Input(name="tripped", unit="1", start=0.0)
        m.event("trip", rounded, crosses=TRIP, direction="up", then=mb.SetInput("tripped", 1.0))
        m.output("is_tripped", m.expression("u", uses={"u": tripped}))
        return m


def expected(times: Any, gain: float = 8.0, period: float = 0.05) -> Any:
    """Return rate and force: v' = (u - d v) / m with a constant u from one sample to the next."""
    found = []
    for t in times:
        v, x, u = 0.0, 0.0, 0.0
        for k in range(int(t / period + 1e-9) + 1):
            error = TARGET - v
            u = gain * error + x
            x += INTEGRAL * period * error
            decay = np.exp(-DAMPING * min(period, t - k * period) / MASS)
            v = decay * v + (1.0 - decay) * u / DAMPING
        found.append((v, u))
    return np.array(found).T


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(Cart(), tmp_path_factory.mktemp("sampled") / "cart.fmu", SETTINGS, native=True)


@pytest.mark.parametrize("values", [{}, {"gain": 4.0, "period": 0.03, "delay": 0.1}])
@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_samples_within_communication_steps(path: Path, kind: str, values: dict[str, float]) -> None:
    """Exact recursion, with parameters in the matrices, the period and the delay; no sample is at a communication
    point. Corners of the speed are at ends of polynomials, so that these have the error of smooth signals: for a delay
    of 0.2 s, 0.064 (5 ms)^3 times the third derivative of the speed, below 400 m/s^4.
    """
    recursion = {name: value for name, value in values.items() if name != "delay"}
    how: dict[str, Any] = {"fmi_type": kind, "relative_tolerance": 1e-9, "record_events": False}
    found = simulate_fmu(str(path), stop_time=1.0, output_interval=0.037, start_values=values, **how)
    delay = values.get("delay", 0.2)
    late, _ = expected(np.maximum(found["time"] - delay, 0.0), **recursion)
    np.testing.assert_allclose(found["late"], late, rtol=0.0, atol=5e-6)
    rate, force = expected(found["time"], **recursion)
    np.testing.assert_allclose(found["rate"], rate, rtol=0.0, atol=2e-6)
    np.testing.assert_allclose(found["force"], force, rtol=0.0, atol=5e-5)
    sampled, _ = expected(0.1 * np.floor(found["time"] / 0.1 + 1e-9), **recursion)
    rounded = 0.25 * np.floor(sampled / 0.25 + 0.5)
    np.testing.assert_allclose(found["rounded"], rounded, rtol=0.0, atol=1e-12)
    is_beyond = rounded > TRIP
    assert is_beyond.any()
    assert not is_beyond[:4].any()
    np.testing.assert_array_equal(found["is_tripped"], np.maximum.accumulate(is_beyond))  # from the first sample on


def test_steps_with_samples_are_repeated(path: Path) -> None:
    """An importing tool returns to an earlier state; a second instance continues from it to the same bits."""
    with Fmu(path) as first, Fmu(path) as second:
        first.step(0.12)
        state = first.save()
        first.step(0.31)
        reached = first.reals().tolist()
        for fmu in (first, second):
            fmu.restore(state)
            fmu.t = 0.12
            fmu.step(0.31)
            assert fmu.reals().tolist() == reached
        rate, force = expected([0.43])
        np.testing.assert_allclose([first["rate"], first["force"]], [rate[0], force[0]], rtol=0.0, atol=1e-6)

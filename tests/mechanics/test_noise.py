"""Noise as a signal: its spectrum, and the response of an oscillator against the sum of those to its cosines."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism, Mechanism
from mbfmu.mechanics.dispatch import signal as signal_at
from mbfmu.util.errors import UserError

PERIOD = 8.0  # s


def density(frequency: float) -> float:
    return 0.02 / (1.0 + frequency**2)


def noise(**changed: Any) -> mb.Noise:
    given: dict[str, Any] = {"density": density, "lowest": 0.5, "highest": 6.0, "period": PERIOD, "seed": 7}
    return mb.Noise(**{**given, **changed})


def values(signal: Any, times: Any) -> Any:
    """Values and first two derivatives of a signal (times, 3)."""
    m = Mechanism()
    m.body("slider", m.ground, mb.Translational(drive=signal))
    arrays = CompiledMechanism(m).kernel_data.arrays
    return np.array([signal_at(0, t, arrays) for t in times])


def test_spectrum_is_the_requested_density() -> None:
    n = 256
    times = np.arange(n) * PERIOD / n
    for mean in (0.0, 0.4):
        transform = np.fft.rfft(values(noise(mean=mean), times)[:, 0]) / n
        frequencies = np.arange(n // 2 + 1) / PERIOD
        inside = (frequencies >= 0.5) & (frequencies <= 6.0)
        assert inside.sum() == 45
        expected = np.where(inside, [density(f) for f in frequencies], 0.0)
        assert 2.0 * PERIOD * np.abs(transform[1:]) ** 2 == pytest.approx(expected[1:], abs=1e-13)
        assert transform[0].real == pytest.approx(mean, abs=1e-14)


def test_it_repeats_itself_and_depends_on_its_seed() -> None:
    times = np.array([0.3, 1.7, 5.0])
    first = values(noise(), times)
    assert values(noise(), times + 3.0 * PERIOD) == pytest.approx(first, abs=1e-10)
    assert np.array_equal(values(noise(), times), first)
    other = values(noise(seed=8), np.linspace(0.0, PERIOD, 256, endpoint=False))[:, 0]
    same = values(noise(), np.linspace(0.0, PERIOD, 256, endpoint=False))[:, 0]
    assert abs(other @ same) < 0.5 * same @ same  # the standard deviation of the ratio is about 0.2


@pytest.mark.parametrize("solver", ["adams", "ida"])
def test_oscillator_moves_as_the_sum_of_its_responses(solver: str) -> None:
    """x'' + 2 d x' + w^2 x = n(t), which starts on its periodic motion."""
    n, w, d = 256, 9.0, 0.4
    complex_amplitudes = 2.0 * np.fft.rfft(values(noise(), np.arange(n) * PERIOD / n)[:, 0]) / n
    s = 2j * np.pi * np.arange(n // 2 + 1) / PERIOD
    response = complex_amplitudes / (s * s + 2.0 * d * s + w * w)
    m = Mechanism()
    joint = mb.Translational(start=float(response.sum().real), rate=float((s * response).sum().real), fixed=True)
    slider = m.body("slider", m.ground, joint, mass=1.0)
    m.force("spring", mb.JointSpring(stiffness=w * w, damping=2.0 * d), slider)
    m.force("push", mb.JointForce(noise()), slider)
    m.output("x", slider.coordinate())
    result = mb.simulate(m, 2.0, solver=solver, tolerance=1e-9)
    exact = [float((response * np.exp(s * t)).sum().real) for t in result.t]
    assert result["x"] == pytest.approx(exact, abs=2e-8 if solver == "adams" else 1e-6)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"period": 0.0}, "period of a Noise is 0.0"),
        ({"highest": -1.0}, "highest of a Noise is -1.0"),
        ({"lowest": np.nan}, "lowest of a Noise is nan"),
        ({"lowest": 7.0}, "without a multiple of 1 / period = 0.125 Hz"),
        ({"highest": 1e5}, "has 799997 cosines; allowed: at most 10000"),
        ({"seed": 0.5}, "seed of a Noise is 0.5"),
        ({"seed": -1}, "seed of a Noise is -1"),
        ({"density": -1.0}, "density of a Noise is -1.0"),
        ({"density": lambda f: 1.0 - f}, "density of a Noise is -0.125 at 1.125 Hz"),
        ({"density": lambda f: np.inf}, "density of a Noise is inf at 0.5 Hz"),
        ({"mean": np.inf}, "mean of a Noise is inf"),
    ],
)
def test_wrong_noise_is_refused(changed: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        values(noise(**changed), [0.0])

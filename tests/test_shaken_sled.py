"""Cranks that are alike, on a sled that a drive shakes: redundant loops on a moved support, against one pendulum."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from mbfmu.mechanics import Harmonic, Mechanism, Revolute, RevoluteCutJoint, Translational, rod
from mbfmu.modeling import Model
from mbfmu.session.run import run
from mbfmu.session.simulation import Settings

TILT = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
TILT[:, 2] *= np.linalg.det(TILT)


@dataclass(frozen=True, kw_only=True)
class Sled(Model):
    """Equal parallel cranks that carry a bar, on a sled that slides to and fro; ``time`` in place of one second."""

    name = "sled"
    cranks: int = 3
    length: float = 1.0
    mass: float = 1.0
    time: float = 1.0
    start: float = -0.6

    @property
    def gravity(self) -> float:
        """Across the sled, m/s2."""
        return 9.81 * self.length / self.time**2

    @property
    def shaking(self) -> Harmonic:
        """Place of the sled, m."""
        return Harmonic(amplitude=0.3 * self.length, frequency=0.9 / self.time, phase=0.4)

    def build(self) -> Mechanism:
        L, mass = self.length, self.mass
        m = Mechanism(gravity=tuple(TILT @ (0.0, -self.gravity, 0.0)))
        sled = m.body("sled", m.ground, Translational(axis="x", rotation=TILT, drive=self.shaking), mass=2.0 * mass)
        cranks = [
            m.body(f"crank{k}", sled, Revolute(at=(k * L, 0.0, 0.0), start=self.start), **rod(mass=mass, length=L))
            for k in range(self.cranks)
        ]
        middle = 0.5 * L * (self.cranks - 1)
        inertia = (0.1 * mass * L**2, mass * L**2, mass * L**2)
        pin = Revolute(at=(L, 0.0, 0.0), start=-self.start)
        bar = m.body("bar", cranks[0], pin, mass=3.0 * mass, com=(middle, 0.0, 0.0), inertia=inertia)
        for k, crank in enumerate(cranks[1:], 1):
            m.cut(f"pin{k}", RevoluteCutJoint(at_a=(L, 0.0, 0.0), at_b=(k * L, 0.0, 0.0)), crank, bar)
        m.output("angle", cranks[0].angle())
        return m

    def angle(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Of a crank, rad: all turn alike and the bar stays parallel to the sled, which leaves a pendulum."""
        inertia = (self.cranks / 3.0 + 3.0) * self.mass * self.length**2
        moment = (self.cranks / 2.0 + 3.0) * self.mass * self.length
        w = 2.0 * np.pi * 0.9 / self.time

        def rates(t: float, y: NDArray[np.float64]) -> list[float]:
            shaken = -0.3 * self.length * w**2 * np.sin(w * t + 0.4)
            return [y[1], moment * (shaken * np.sin(y[0]) - self.gravity * np.cos(y[0])) / inertia]

        motion = solve_ivp(rates, (0.0, times[-1]), [self.start, 0.0], "DOP853", times, rtol=1e-12, atol=1e-12)
        return np.asarray(motion.y[0])


@pytest.mark.parametrize("solver", ["ida", "adams", "hybrid"])
@pytest.mark.parametrize(
    "model",
    [
        Sled(),
        Sled(cranks=5),
        Sled(length=1e-3, mass=1e-5, time=0.03),
        Sled(cranks=2, length=300.0, mass=1e4, time=20.0),
    ],
)
def test_alike_cranks_on_a_shaken_sled(model: Sled, solver: str) -> None:
    """Errors are compared by how a mistake in the start grows."""
    times = np.linspace(0.0, 4.0 * model.time, 81)
    exact = model.angle(times)
    growth = np.abs(replace(model, start=model.start + 1e-6).angle(times) - exact).max() / 1e-6
    for tolerance in (1e-6, 1e-9):
        result = run(model, Settings(solver=solver, tolerance=tolerance), times)
        assert not result.failure
        assert not result.warning
        np.testing.assert_allclose(result["angle"], exact, atol=10.0 * growth * tolerance)


@pytest.mark.parametrize("cranks", [2, 3, 5])
def test_lu_runs_where_it_serves(cranks: int) -> None:
    """What the drive does is no jump of the energy, and one choice among equals no better than another."""
    model = Sled(cranks=cranks)
    result = run(model, Settings(solver="hybrid", tolerance=1e-6), np.linspace(0.0, 4.0, 81))
    assert result.statistics.time_lu > 2.0
    assert result.statistics.left_by_energy == 0
    assert result.statistics.left_by_flicker == 0

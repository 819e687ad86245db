"""A parallelogram that turns back, creeps or settles in its flat position or next to it: right, or refused in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mbfmu.mechanics import Harmonic, JointSpring, Mechanism, Polynomial, Revolute, RevoluteCutJoint, rod
from mbfmu.modeling import Model
from mbfmu.session.run import run
from mbfmu.session.simulation import Settings

START, GRAVITY = 0.6, 9.81  # rad, m/s2
WEIGHT = (0.5 * 1.0 + 2.0 + 0.5 * 1.5) * GRAVITY  # N m about the cranks' pins
INERTIA = (1.0 + 1.5) / 3.0 + 2.0  # kg m2
BESIDE = (1e-3, 1e-5, 1e-6, 1e-8, 0.0, -1e-6, -1e-5, -1e-3)  # rad
DAMPING = 3.0  # N m s/rad
FACTOR = 200.0  # of the tolerance, of a right run


@dataclass(frozen=True, kw_only=True)
class Parallelogram(Model):
    """Cranks of 1 m on a coupler of 3 m, thrown at a speed (rad/s), driven, or pulled to an angle (rad) by a spring."""

    first: float = -START
    rate: float = 0.0
    drive: Harmonic | Polynomial | None = None
    rest: float | None = None

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, 0.0 if self.rest is not None else -GRAVITY, 0.0))
        first = self.first
        free = {"start": first, "fixed": True, "rate": self.rate}
        joint = Revolute(drive=self.drive) if self.drive else Revolute(**free)
        crank = m.body("crank", m.ground, joint, **rod(mass=1.0, length=1.0))
        coupler = m.body(
            "coupler",
            crank,
            Revolute(at=(1.0, 0.0, 0.0), start=-first, rate=-self.rate),
            **rod(mass=2.0, length=3.0),
        )
        rocker = m.body(
            "rocker",
            m.ground,
            Revolute(at=(3.0, 0.0, 0.0), start=first, rate=self.rate),
            **rod(mass=1.5, length=1.0),
        )
        m.cut("pin", RevoluteCutJoint(at_a=(3.0, 0.0, 0.0), at_b=(1.0, 0.0, 0.0)), coupler, rocker)
        if self.rest is not None:
            m.force("spring", JointSpring(stiffness=50.0, damping=DAMPING, free=self.rest), crank)
        m.output("crank", crank.coordinate())
        m.output("rocker", rocker.coordinate())
        return m


def worst(result, exact) -> float:
    """Largest error of what was reported, rad."""
    return max(abs(result[name] - exact[: len(result.t)]).max() for name in ("crank", "rocker"))


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
def test_thrown_up(solver: str, tolerance: float) -> None:
    """The coupler translates: the cranks are a pendulum, WEIGHT on INERTIA."""
    times = np.linspace(0.0, 0.6, 31)
    for beside in BESIDE:
        rate = np.sqrt(2.0 * WEIGHT * (np.sin(START) - np.sin(beside)) / INERTIA)
        exact = solve_ivp(
            lambda t, z: (z[1], -WEIGHT * np.cos(z[0]) / INERTIA),
            (0.0, 0.6),
            (-START, rate),
            method="DOP853",
            rtol=1e-12,
            atol=1e-13,
            t_eval=times,
        ).y[0]
        result = run(Parallelogram(rate=rate), Settings(solver=solver, tolerance=tolerance), times)
        assert worst(result, exact) <= FACTOR * tolerance or result.warning, (beside, result.failure)
        if abs(beside) >= 1e-3 or tolerance > 1e-8:
            assert not result.failure, (beside, result.failure)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-4, 1e-5, 1e-6, 1e-7])
@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
def test_driven_back(solver: str, tolerance: float) -> None:
    """The rocker goes where the crank goes, behind the flat position too."""
    times = np.linspace(0.0, 4.0, 81)
    for beside in BESIDE:
        drive = Harmonic(amplitude=0.3, frequency=0.5, phase=0.5 * np.pi, mean=0.3 + beside)
        model = Parallelogram(first=START + beside, drive=drive)
        result = run(model, Settings(solver=solver, tolerance=tolerance), times)
        apart = abs(result["rocker"] - result["crank"]).max()
        assert apart <= FACTOR * tolerance, (beside, apart)
        if beside == 1e-3:
            assert not result.failure, (beside, result.failure)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-4, 1e-5, 1e-6])
@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
def test_driven_through_slowly(solver: str, tolerance: float) -> None:
    """If only time moves the mechanism, the orientation is the same on both branches."""
    times = np.linspace(0.0, 2.0, 41)
    for speed in (1e-3, 5e-3, 1e-2, 3e-2):
        model = Parallelogram(first=-speed, drive=Polynomial((-speed, speed)))
        result = run(model, Settings(solver=solver, tolerance=tolerance), times)
        apart = abs(result["rocker"] - speed * (result.t - 1.0)).max()
        assert apart <= FACTOR * tolerance, (speed, apart, result.failure)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-5, 1e-6, 1e-7])
@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
def test_settles_near_the_singular_position(solver: str, tolerance: float) -> None:
    """A damped oscillator that comes to rest just behind the flat position."""
    times = np.linspace(0.0, 20.0, 101)
    for rest in (1e-3, 3e-3):
        decay = 0.5 * DAMPING / INERTIA
        swing = np.sqrt(50.0 / INERTIA - decay**2)
        shape = np.cos(swing * times) + decay / swing * np.sin(swing * times)
        exact = rest + (-START - rest) * np.exp(-decay * times) * shape
        result = run(Parallelogram(rest=rest), Settings(solver=solver, tolerance=tolerance), times)
        assert worst(result, exact) <= FACTOR * tolerance or result.warning, (rest, result.failure)

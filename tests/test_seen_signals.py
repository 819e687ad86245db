"""What varies by itself with time is seen, however it falls together with a solver's steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mbfmu.direct import run
from mbfmu.mechanics import (
    Harmonic,
    JointForce,
    JointSpring,
    Mechanism,
    Revolute,
    RevoluteCut,
    RunUp,
    Translational,
    rod,
)
from mbfmu.mechanics.signals import InUse
from mbfmu.model import Model
from mbfmu.simulation import Settings

SOLVERS = ["adams", "hybrid", "ida"]


@dataclass(frozen=True, kw_only=True)
class Made(Model):
    """Whatever its function builds."""

    make: Callable[[], Mechanism]

    def build(self) -> Mechanism:
        return self.make()


def shaken_slider(frequency: float) -> Mechanism:
    """1 kg under 100 N: nothing moves it at the start, and nothing at every half period."""
    m = Mechanism()
    body = m.body("slider", m.ground, Translational(axis="x"), mass=1.0)
    m.force("shaker", JointForce(magnitude=Harmonic(amplitude=100.0, frequency=frequency)), body)
    m.output("x", body.coordinate())
    return m


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize("frequency", [0.5, 5.0, 50.0, 52.0, 400.0])
def test_a_sine_that_is_zero_wherever_one_looks(frequency: float, tolerance: float, solver: str) -> None:
    omega, times = 2.0 * pi * frequency, np.array([0.0, 0.3, 1.0, 2.0])
    result = run(Made(make=lambda: shaken_slider(frequency)), Settings(solver=solver, tolerance=tolerance), times)
    exact = 100.0 * (times / omega - np.sin(omega * times) / omega**2)
    apart = 150.0 if solver == "ida" else 100.0  # of up to 800 periods, added up
    np.testing.assert_allclose(result["x"], exact, atol=apart * tolerance * (1.0 + exact.max()))
    assert result.warning == ""


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_loop_that_lies_still_until_it_is_shaken(solver: str) -> None:
    """A parallelogram in a horizontal plane: its coupler does not turn, so that it moves as one inertia does."""

    def build() -> Mechanism:
        m = Mechanism(gravity=(0.0, 0.0, -9.81))
        crank = m.body("crank", m.ground, Revolute(start=0.5, fixed=True), **rod(mass=1.0, length=1.0))
        coupler = m.body("coupler", crank, Revolute(at=(1.0, 0.0, 0.0), start=-0.5), **rod(mass=3.0, length=3.0))
        rocker = m.body("rocker", coupler, Revolute(at=(3.0, 0.0, 0.0), start=0.5), **rod(mass=1.0, length=-1.0))
        m.cut("pivot", RevoluteCut(at_a=(-1.0, 0.0, 0.0), at_b=(3.0, 0.0, 0.0)), rocker, m.ground)
        m.force("shaker", JointForce(magnitude=Harmonic(amplitude=500.0, frequency=100.0)), crank)
        m.output("angle", crank.angle())
        return m

    times, omega, inertia = np.linspace(0.0, 1.0, 11), 200.0 * pi, 2.0 / 3.0 + 3.0
    result = run(Made(make=build), Settings(solver=solver, tolerance=1e-8), times)
    exact = 0.5 + 500.0 / inertia * (times / omega - np.sin(omega * times) / omega**2)
    np.testing.assert_allclose(result["angle"], exact, atol=1e-6)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("duration", [0.02, 0.3])
def test_a_short_run_up_sets_a_hanging_mass_swinging(duration: float, solver: str) -> None:
    def build() -> Mechanism:
        m = Mechanism()
        base = m.body("base", m.ground, Translational(axis="x", drive=RunUp(speed=2.0, duration=duration)), mass=1.0)
        mass = m.body("mass", base, Translational(axis="x"), mass=1.0)
        m.force("spring", JointSpring(stiffness=50.0), mass)
        m.output("x", mass.coordinate())
        return m

    def rates(t: float, y: np.ndarray) -> list[float]:
        shaken = 2.0 / duration * (1.0 - np.cos(2.0 * pi * t / duration)) if t < duration else 0.0
        return [y[1], -50.0 * y[0] - shaken]

    first = solve_ivp(rates, (0.0, duration), [0.0, 0.0], rtol=1e-11, atol=1e-13, method="DOP853").y[:, -1]
    end = solve_ivp(rates, (duration, 1.0), first, rtol=1e-11, atol=1e-13, method="DOP853").y[0, -1]
    result = run(Made(make=build), Settings(solver=solver, tolerance=1e-6), np.array([0.0, 1.0]))
    assert abs(end) > 0.05
    assert result["x"][-1] == pytest.approx(end, abs=2e-5)
    assert result.warning == ""
    long_before = run(Made(make=build), Settings(solver=solver, tolerance=1e-6), np.array([-10.0, 1.0]))
    assert long_before["x"][-1] == pytest.approx(end, abs=2e-5)


def test_the_longest_step_sees_every_signal() -> None:
    plant = Made(make=lambda: shaken_slider(5.0)).plant()
    assert plant.system.resolves(0.7) == (pytest.approx(0.06), np.inf)
    run_up = RunUp(speed=2.0, duration=0.5)
    own = InUse(run_up, {"speed": 2.0, "duration": 0.5, "over": 0}, [])
    assert own.longest_step(-1.0) == (0.5, -0.5)
    assert own.longest_step(-0.1) == (pytest.approx(0.15), 0.5)
    assert own.longest_step(0.2) == (pytest.approx(0.15), 0.5)
    assert own.longest_step(0.5) == (np.inf, np.inf)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_start_so_far_out_that_angles_are_too_coarse(solver: str) -> None:
    from mbfmu.errors import UserError

    def build() -> Mechanism:
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        m.output("a", m.body("bar", m.ground, Revolute(start=1e11), **rod(mass=1.0, length=1.0)).angle())
        return m

    with pytest.raises(UserError, match="position 0 starts at 1e"):
        run(Made(make=build), Settings(solver=solver, tolerance=1e-8), np.array([0.0, 1.0]))

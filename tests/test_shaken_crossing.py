"""A loop that passes its singular position while something else is fast: its base, or a flap that it carries."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mbfmu.mechanics import Body, Harmonic, JointSpring, Mechanism, Revolute, RevoluteCut, Translational, rod
from mbfmu.model import Model
from mbfmu.native import run
from mbfmu.simulation import Settings

START, RATE = -0.4, 0.8  # rad, rad/s
MOMENT, INERTIA = 0.5 * 1.0 + 2.0 + 0.5 * 1.5, (1.0 + 1.5) / 3.0 + 2.0  # kg m, kg m2, of the cranks and the coupler


def parallelogram(m: Mechanism, base: Body) -> Body:
    """Hang one along x on a base, with outputs; return its coupler."""
    crank = m.body("crank", base, Revolute(start=START, fixed=True, rate=RATE), **rod(mass=1.0, length=1.0))
    joint = Revolute(at=(1.0, 0.0, 0.0), start=-START, rate=-RATE)
    coupler = m.body("coupler", crank, joint, **rod(mass=2.0, length=3.0))
    joint = Revolute(at=(3.0, 0.0, 0.0), start=START, rate=RATE)
    rocker = m.body("rocker", base, joint, **rod(mass=1.5, length=1.0))
    m.cut("pin", RevoluteCut(at_a=(3.0, 0.0, 0.0), at_b=(1.0, 0.0, 0.0)), coupler, rocker)
    m.output("crank", crank.coordinate())
    m.output("rocker", rocker.coordinate())
    return coupler


@dataclass(frozen=True, kw_only=True)
class Shaken(Model):
    """A base which is shaken along y."""

    amplitude: float
    frequency: float

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(9.81, 0.0, 0.0))
        shaker = Harmonic(amplitude=self.amplitude, frequency=self.frequency)
        parallelogram(m, m.body("base", m.ground, Translational(axis="y", drive=shaker), mass=5.0))
        return m


FLAP, LENGTH, STIFFNESS, OPEN = 0.2, 0.3, 6000.0, 0.5  # kg, m, N m, rad


@dataclass(frozen=True, kw_only=True)
class Flapping(Model):
    """A flap on a spring in the middle of the coupler: it swings at 160 Hz and half a radian."""

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(9.81, 0.0, 0.0))
        hinge = Revolute(at=(1.5, 0.0, 0.0), start=OPEN, fixed=True)
        flap = m.body("flap", parallelogram(m, m.ground), hinge, **rod(mass=FLAP, length=LENGTH))
        m.force("spring", JointSpring(stiffness=STIFFNESS), flap)
        m.output("flap", flap.coordinate())
        return m


@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
def test_a_flap_swings_fast(solver: str) -> None:
    """In angles of the crank and of the flap, by Lagrange."""

    def change(_t: float, z: np.ndarray) -> np.ndarray:
        crank, flap, speed, rate = z
        lever = 0.5 * FLAP * LENGTH
        c, s = lever * np.cos(flap - crank), lever * np.sin(flap - crank)
        mass = [[INERTIA + FLAP, c], [c, FLAP * LENGTH**2 / 3.0]]
        load = [
            s * rate**2 - (MOMENT + FLAP) * 9.81 * np.sin(crank),
            -s * speed**2 - STIFFNESS * flap - lever * 9.81 * np.sin(flap),
        ]
        return np.concatenate((z[2:], np.linalg.solve(mass, load)))

    times = np.linspace(0.0, 1.5, 31)
    exact = solve_ivp(change, (0.0, 1.5), (START, OPEN, RATE, 0.0), "DOP853", times, rtol=1e-12, atol=1e-12)
    for tolerance in (1e-6, 1e-8):
        result = run(Flapping(), Settings(solver=solver, tolerance=tolerance), times)
        assert not result.failure
        for name, true in zip(("crank", "flap"), exact.y[:2], strict=True):
            assert abs(result[name] - true).max() <= 300.0 * tolerance


@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
@pytest.mark.parametrize(("amplitude", "frequency"), [(2e-3, 200.0), (1e-2, 50.0), (1e-2, 20.0), (1e-3, 100.0)])
def test_the_base_is_shaken(amplitude: float, frequency: float, solver: str) -> None:
    """The coupler translates: a pendulum in a field that shakes."""
    times, omega = np.linspace(0.0, 2.0, 41), 2.0 * np.pi * frequency

    def change(t: float, z: np.ndarray) -> tuple[float, float]:
        shaken = amplitude * omega**2 * np.sin(omega * t)
        return z[1], -MOMENT / INERTIA * (9.81 * np.sin(z[0]) - shaken * np.cos(z[0]))

    exact = solve_ivp(
        change, (0.0, 2.0), (START, RATE), "DOP853", times, rtol=1e-11, atol=1e-12, max_step=0.02 / frequency
    )
    for tolerance in (1e-5, 1e-6):
        model = Shaken(amplitude=amplitude, frequency=frequency)
        result = run(model, Settings(solver=solver, tolerance=tolerance), times)
        assert not result.failure
        for name in ("crank", "rocker"):
            assert abs(result[name] - exact.y[0]).max() <= 300.0 * tolerance

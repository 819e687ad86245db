"""A loop that passes its singular configuration while something else is fast: its base, or a flap that it carries."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mbfmu.mechanics import (
    Body,
    Harmonic,
    JointForce,
    JointSpring,
    Mechanism,
    Polynomial,
    Revolute,
    RevoluteCutJoint,
    Translational,
    rod,
)
from mbfmu.modeling import Model
from mbfmu.session.run import run
from mbfmu.session.simulation import Settings

START, RATE = -0.4, 0.8  # rad, rad/s
MOMENT, INERTIA = 0.5 * 1.0 + 2.0 + 0.5 * 1.5, (1.0 + 1.5) / 3.0 + 2.0  # kg m, kg m2, of the cranks and the coupler


def parallelogram(
    m: Mechanism, base: Body, start: float = START, rate: float = RATE, *, driven: bool = False
) -> tuple[Body, Body]:
    """Put one along x on a base, with outputs; return its crank and its coupler."""
    pin = Revolute(drive=Polynomial((start, rate))) if driven else Revolute(start=start, fixed=True, rate=rate)
    crank = m.body("crank", base, pin, **rod(mass=1.0, length=1.0))
    joint = Revolute(at=(1.0, 0.0, 0.0), start=-start, rate=-rate)
    coupler = m.body("coupler", crank, joint, **rod(mass=2.0, length=3.0))
    joint = Revolute(at=(3.0, 0.0, 0.0), start=start, rate=rate)
    rocker = m.body("rocker", base, joint, **rod(mass=1.5, length=1.0))
    m.cut("pin", RevoluteCutJoint(at_a=(3.0, 0.0, 0.0), at_b=(1.0, 0.0, 0.0)), coupler, rocker)
    m.output("crank", crank.coordinate())
    m.output("rocker", rocker.coordinate())
    return crank, coupler


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
        flap = m.body("flap", parallelogram(m, m.ground)[1], hinge, **rod(mass=FLAP, length=LENGTH))
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


@dataclass(frozen=True, kw_only=True)
class Carrying(Model):
    """A driven parallelogram on a base which is shaken along y; a mass of 0.3 kg on a spring slides on its coupler."""

    amplitude: float
    frequency: float
    rate: float

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        shaker = Harmonic(amplitude=self.amplitude, frequency=self.frequency, phase=0.4)
        base = m.body("base", m.ground, Translational(axis="y", drive=shaker), mass=5.0)
        _, coupler = parallelogram(m, base, -0.6 * self.rate, self.rate, driven=True)
        slide = Translational(at=(1.5, 0.0, 0.0), axis="y", start=0.02, fixed=True)
        mass = m.body("mass", coupler, slide, mass=0.3)
        m.force("spring", JointSpring(stiffness=300.0), mass)
        m.output("mass", mass.coordinate())
        return m

    def exact(self, times: np.ndarray) -> np.ndarray:
        """The mass in the coupler: an oscillator that base, crank and weight excite."""
        own, shaken, turned = np.sqrt(300.0 / 0.3), 2.0 * np.pi * self.frequency, self.rate

        def excited(t: np.ndarray, derivative: int) -> np.ndarray:
            wave = np.cos if derivative else np.sin
            by_base = self.amplitude * shaken ** (2 + derivative) * wave(shaken * t + 0.4) / (own**2 - shaken**2)
            by_crank = turned ** (2 + derivative) * wave(turned * (t - 0.6)) / (own**2 - turned**2)
            return by_base + by_crank - (0.0 if derivative else 9.81 / own**2)

        start = np.zeros(1)
        free = (0.02 - excited(start, 0)) * np.cos(own * times) - excited(start, 1) / own * np.sin(own * times)
        return excited(times, 0) + free


@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
@pytest.mark.parametrize(
    ("amplitude", "frequency", "rate"), [(5e-3, 50.0, 1.0), (1e-4, 50.0, 1.0), (5e-3, 20.0, 1.0), (5e-3, 50.0, 5.0)]
)
def test_a_drive_passes_while_the_base_is_shaken(amplitude: float, frequency: float, rate: float, solver: str) -> None:
    """The loop follows its drive; what it carries must not be kicked."""
    times = np.linspace(0.0, 1.0, 41)
    model = Carrying(amplitude=amplitude, frequency=frequency, rate=rate)
    for tolerance in (1e-4, 1e-6, 1e-8):
        result = run(model, Settings(solver=solver, tolerance=tolerance), times)
        assert not result.failure
        assert abs(result["rocker"] - rate * (times - 0.6)).max() <= 100.0 * tolerance
        assert abs(result["mass"] - model.exact(times)).max() <= 100.0 * tolerance


@dataclass(frozen=True, kw_only=True)
class Spinning(Model):
    """A torque of 300 Hz swings a parallelogram slowly through its flat position; a rotor spins on it or near it."""

    torque: float
    spin: float
    aboard: bool
    driven: bool

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, 0.0, 0.0))
        crank, coupler = parallelogram(m, m.ground, -0.012, 0.02)
        how = {"drive": Polynomial((0.0, self.spin))} if self.driven else {"rate": self.spin, "fixed": True}
        hinge = Revolute(at=(1.5, 0.0, 0.0), **how)
        m.body("rotor", coupler if self.aboard else m.ground, hinge, mass=0.5, inertia=(0.01, 0.01, 0.01))
        m.force("torque", JointForce(magnitude=Harmonic(amplitude=self.torque, frequency=300.0)), crank)
        return m


@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
@pytest.mark.parametrize("spin", [5.0, 500.0])
@pytest.mark.parametrize("aboard", [True, False])
@pytest.mark.parametrize("driven", [True, False])
@pytest.mark.parametrize("torque", [20.0, 200.0])
def test_a_rotor_hides_nothing(torque: float, driven: bool, aboard: bool, spin: float, solver: str) -> None:
    """What is lost in a crossing is held against the loop's own speed: right, or refused."""
    times, fast = np.linspace(0.0, 1.0, 41), 600.0 * np.pi
    inertia = INERTIA + 0.5 * aboard
    exact = -0.012 + 0.02 * times + torque / inertia * (times / fast - np.sin(fast * times) / fast**2)
    for tolerance in (1e-4, 1e-6, 1e-8):
        result = run(
            Spinning(torque=torque, spin=spin, aboard=aboard, driven=driven),
            Settings(solver=solver, tolerance=tolerance),
            times,
        )
        off = abs(result["crank"] - exact[: len(result.t)]).max()
        assert off <= 100.0 * tolerance
        assert not result.failure or result.t[-1] > 0.15, "it is passed, or refused there"


@dataclass(frozen=True, kw_only=True)
class Turned(Model):
    """A parallelogram on a base that turns in its plane: base and loop move together."""

    speed: float

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, 0.0, 0.0))
        base = m.body("base", m.ground, Revolute(drive=Polynomial((0.3, self.speed))), mass=5.0)
        parallelogram(m, base)
        return m


@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
@pytest.mark.parametrize("speed", [0.5, 1.0, 3.1, 3.3, 5.0])
def test_the_base_turns_with_the_loop(speed: float, solver: str) -> None:
    """What drives do to both ends of a cut alike moves no constraint, whatever rounding leaves of it."""
    moment = 1.5 * (2.0 + 1.5) * speed**2  # of the centrifugal forces on coupler and rocker, on lever arms of 1.5 m
    times = np.linspace(0.0, 1.5, 31)
    exact = solve_ivp(
        lambda _t, z: (z[1], -moment / INERTIA * np.sin(z[0])),
        (0.0, 1.5), (START, RATE), "DOP853", times, rtol=1e-12, atol=1e-12,
    )  # fmt: skip
    for tolerance in (1e-4, 1e-6, 1e-8):
        result = run(Turned(speed=speed), Settings(solver=solver, tolerance=tolerance), times)
        assert not result.failure
        for name in ("crank", "rocker"):
            assert abs(result[name] - exact.y[0]).max() <= 100.0 * tolerance

"""What varies by itself with time is seen, however it falls together with a solver's steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mbfmu.mechanics import (
    CompiledMechanism,
    Function,
    Harmonic,
    Input,
    JointForce,
    JointSpring,
    Mechanism,
    Product,
    Revolute,
    RevoluteCutJoint,
    RunUp,
    Signal,
    Step,
    Sum,
    Table,
    Translational,
    kernel,
    rod,
)
from mbfmu.modeling import Model
from mbfmu.session.run import run
from mbfmu.session.simulation import Settings
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import COMPILED

SOLVERS = ["adams", "hybrid", "ida"]


@dataclass(frozen=True, kw_only=True)
class Made(Model):
    """Whatever its function builds."""

    make: Callable[[], Mechanism]

    def build(self) -> Mechanism:
        return self.make()


def pushed_by(signal: Any) -> Mechanism:
    """A wheel with a torque on it."""
    m = Mechanism()
    m.force("push", JointForce(signal), m.body("wheel", m.ground, Revolute(), mass=1.0, inertia=(1.0, 1.0, 1.0)))
    return m


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
def test_a_sine_that_is_zero_at_all_samples(frequency: float, tolerance: float, solver: str) -> None:
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
        m.cut("pivot", RevoluteCutJoint(at_a=(-1.0, 0.0, 0.0), at_b=(3.0, 0.0, 0.0)), rocker, m.ground)
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
    compiled = Made(make=lambda: shaken_slider(5.0)).compile()
    assert compiled.system.input_step_limit(0.7) == (pytest.approx(0.06), np.inf)
    compiled = CompiledMechanism(pushed_by(RunUp(speed=2.0, duration=0.5)))
    assert compiled.system.input_step_limit(-1.0) == (0.5, -0.5)
    assert compiled.system.input_step_limit(-0.1) == (pytest.approx(0.15), 0.5)
    assert compiled.system.input_step_limit(0.2) == (pytest.approx(0.15), 0.5)
    assert compiled.system.input_step_limit(0.5) == (np.inf, np.inf)


POINTS = (2.0, 2.4, 2.5)  # steps of one interval, and before a shorter interval of half the time to its begin
LATER = {
    "step": (Step(height=1.0, begin=2.0, duration=0.5), (1.0, 1.0), (0.15, 2.5), (0.15, 2.5), (np.inf, np.inf)),
    "no step": (Step(height=0.0, begin=2.0, duration=0.5), *4 * [(np.inf, np.inf)]),
    "table": (Table(POINTS, (0.0, 1.0, 0.0)), (1.0, 1.0), (0.4, 2.0), (0.1, 2.4), (np.inf, np.inf)),
    "held": (Table(POINTS, (0.0, 1.0, 0.0), beyond="hold"), (1.0, 1.0), (0.4, 2.0), (0.1, 2.4), (np.inf, np.inf)),
    "periodic": (Table(POINTS, (0.0, 1.0, 0.0), beyond="periodic"), (0.2, 0.2), (0.1, 2.0), (0.1, 2.4), (0.2, 3.2)),
    "flat": (Table(POINTS, (1.0, 1.0, 1.0)), *4 * [(np.inf, np.inf)]),
    "law": (Function("sin(t)", time=0.6), *4 * [(0.2, np.inf)]),
    "sum": (
        Sum(Harmonic(amplitude=1.0, frequency=1.0), Product(2.0, Step(height=1.0, begin=2.0, duration=0.5))),
        (0.3, 1.0), (0.15, 2.5), (0.15, 2.5), (0.3, np.inf),
    ),
    "input": (Input(name="u", unit="N.m"), *4 * [(np.inf, np.inf)]),
}  # fmt: skip


@pytest.mark.parametrize("name", LATER)
def test_steps_are_short_from_where_a_signal_varies(name: str) -> None:
    """Two seconds before, close before, in the middle, and after it."""
    signal, *expected = LATER[name]
    system = CompiledMechanism(pushed_by(signal)).system
    assert [system.input_step_limit(t) for t in (0.0, 1.9, 2.2, 3.0)] == [pytest.approx(one) for one in expected]


RATE = np.dtype([("rate", np.float64)])


@kernel
def chirp(signal: Any, t: float, arrays: Any) -> tuple[float, float, float]:
    """A sine whose frequency grows."""
    phase = signal.rate * t * t
    return np.sin(phase), 2.0 * signal.rate * t * np.cos(phase), 0.0


@kernel
def chirp_seen(signal: Any, t: float, arrays: Any) -> tuple[float, float]:
    """Shorter from second to second."""
    until = np.floor(t) + 1.0
    return 1.0 / (signal.rate * until), until


def chirp_in_python(self: Any, own: Any, t: float) -> tuple[float, float]:
    """No kernel."""
    return 0.1, np.inf


def own_signal(**said: Any) -> Signal:
    """Return a signal of a kind of a user's own."""
    said |= {"record": RATE, "evaluate": chirp, "fill": lambda self, record, site: record.__setitem__("rate", 5.0)}
    made: Signal = dataclass(frozen=True)(type("Chirp", (Signal,), said))()
    return made


def test_a_user_defined_signal_may_limit_the_steps() -> None:
    assert CompiledMechanism(pushed_by(own_signal())).system.input_step_limit(2.5) == (np.inf, np.inf)
    told = own_signal(longest_step=chirp_seen)
    assert CompiledMechanism(pushed_by(told)).system.input_step_limit(2.5) == (pytest.approx(1.0 / 15.0), 3.0)
    assert CompiledMechanism(pushed_by(Sum(told, 1.0))).system.input_step_limit(2.5) == (pytest.approx(1.0 / 15.0), 3.0)


@pytest.mark.skipif(not COMPILED, reason="plain Python is a kernel where nothing is compiled")
def test_a_longest_step_that_is_no_kernel_is_refused() -> None:
    with pytest.raises(UserError, match="of class Chirp, whose 'longest_step' is not a kernel; decorate it"):
        CompiledMechanism(pushed_by(own_signal(longest_step=chirp_in_python)))


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_start_so_far_out_that_angles_are_too_coarse(solver: str) -> None:
    def build() -> Mechanism:
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        m.output("a", m.body("bar", m.ground, Revolute(start=1e11), **rod(mass=1.0, length=1.0)).angle())
        return m

    with pytest.raises(UserError, match=r"coordinate '.*' starts at 1e"):
        run(Made(make=build), Settings(solver=solver, tolerance=1e-8), np.array([0.0, 1.0]))

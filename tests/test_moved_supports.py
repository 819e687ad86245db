"""Supports that inputs move: closed forms, momentum, energy, orders of convergence in the communication step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fmus.sheet import Sheet
from mbfmu.mechanics import (
    Body,
    CompiledMechanism,
    Harmonic,
    Input,
    JointSpring,
    Mechanism,
    Revolute,
    RunUp,
    SpeedInput,
    SphericalCutJoint,
    Translational,
    Weld,
    rod,
)
from mbfmu.modeling import Model
from mbfmu.session.run import run
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.diagnostics import without_details
from mbfmu.util.errors import UserError
from solvers.system import TreeSystem

AMPLITUDE, W = 0.02, 30.0  # m, rad/s, of a support that is shaken
STIFFNESS, BASE_MASS = 100.0, 0.5  # N/m, kg
SOLVERS = ("ida", "adams", "hybrid", "adams-lu")
LARGE = 61  # copies that make a large tree


@dataclass(frozen=True, kw_only=True)
class Made(Model):
    """Whatever a function builds."""

    name = "made"
    make: Callable[[Mechanism], None]
    gravity: Any = (0.0, 0.0, 0.0)

    def build(self) -> Mechanism:
        m = Mechanism(gravity=self.gravity)
        self.make(m)
        return m


def begin(make: Callable[[Mechanism], None], solver: str = "adams", tolerance: float = 1e-9, **more: Any) -> Simulation:
    return Simulation(Made(make=make), Settings(solver=solver, tolerance=tolerance), **more)


def position(t: float) -> float:
    return float(AMPLITUDE * np.sin(W * t))


def rate(t: float) -> float:
    return float(AMPLITUDE * W * np.cos(W * t))


def mean_rate(t: float, after: float) -> float:
    return (position(after) - position(t)) / (after - t)


WAYS: dict[str, Callable[[float, float], tuple[float, ...]]] = {  # what a host may give at t for a step to t'
    "position": lambda t, _: (position(t),),
    "rate": lambda t, _: (position(t), rate(t)),
    "mean rate": lambda t, after: (position(t), mean_rate(t, after)),
}


def shake(simulation: Simulation, way: str, stop: float, steps: int, first: int = 0) -> tuple[Any, Any]:
    """Times and outputs at the ends of all steps; inputs ``first`` and the one behind it move the support."""
    times, rows = np.linspace(0.0, stop, steps + 1), []
    for t, after in pairwise(times):
        for k, value in enumerate(WAYS[way](t, after)):
            simulation.set_input(first + k, value)
        assert simulation.advance(after).ok
        rows.append(simulation.outputs().copy())
    return times[1:], np.array(rows)


def oscillator(way: str, copies: int = 1) -> Callable[[Mechanism], None]:
    """1 kg on a spring on a base that moves, as often as wanted on the same base."""

    def make(m: Mechanism) -> None:
        motion = Input(name="u", unit="m", rate_name="" if way == "position" else "du")
        base = m.body("base", m.ground, Translational(axis="x", drive=motion), mass=BASE_MASS)
        for i in range(copies):
            mass = m.body(f"mass{i}", base, Translational(axis="x"), mass=1.0)
            m.force(f"spring{i}", JointSpring(stiffness=STIFFNESS), mass)
        m.output("x", mass.position("x"))
        m.output("force", base.effort())
        m.output("energy", m.energy)
        m.output("base", base.coordinate())

    return make


def from_rest(t: Any) -> Any:
    """Position of the mass where base and mass are at rest until 0: x'' = w^2 (u - x)."""
    w = np.sqrt(STIFFNESS)
    return AMPLITUDE * (w**2 * np.sin(W * t) - W * w * np.sin(w * t)) / (w**2 - W**2)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(("solver", "copies"), [("adams", 1), ("ida", 1), ("adams", LARGE), ("ida", LARGE)])
def test_an_oscillator_on_a_moved_base_converges_in_the_square_of_the_step(way: str, solver: str, copies: int) -> None:
    errors = []
    for steps in (20, 40):
        simulation = begin(oscillator(way, copies), solver, 1e-9 if solver == "adams" and copies == 1 else 1e-7)
        assert isinstance(simulation.compiled.system, TreeSystem) == (copies == LARGE)
        times, rows = shake(simulation, way, 0.2, steps)
        errors.append(np.abs(rows[:, 0] - from_rest(times)).max())
    assert from_rest(0.2) == pytest.approx(7.518e-3, abs=1e-6)
    assert errors[1] < 0.01 * AMPLITUDE
    assert np.log2(errors[0] / errors[1]) > 1.9
    if way == "rate" and solver == "adams" and copies == 1:
        assert np.log2(errors[0] / errors[1]) > 2.9


def test_the_force_on_a_base_converges_where_the_rate_is_given() -> None:
    """Without rates, or with mean ones, the base's own inertia is in the impulses."""
    errors = []
    for steps in (40, 80, 160):
        times, rows = shake(begin(oscillator("rate")), "rate", 0.2, steps)
        base = AMPLITUDE * np.sin(W * times)
        exact = -BASE_MASS * W**2 * base + STIFFNESS * (base - from_rest(times))
        errors.append(np.abs(rows[:, 1] - exact)[2:].max())  # two steps until two rates are known
    assert np.all(np.log2(np.divide(errors[:-1], errors[1:])) > 0.9)
    assert errors[-1] < 4.0 * (W * 0.2 / 160) * BASE_MASS * W**2 * AMPLITUDE  # late by a few steps at most


@pytest.mark.parametrize("solver", ["adams", "ida"])
def test_energy_closes_across_a_jump_of_speed(solver: str) -> None:
    """The base continues at speed V: x = V (t - sin(w t) / w), and the spring's force has done V m x' of work since."""
    speed, t, w = 0.7, 0.13, np.sqrt(STIFFNESS)

    def make(m: Mechanism) -> None:
        base = m.body("base", m.ground, Translational(axis="x", drive=SpeedInput(name="V", unit="m/s")), mass=BASE_MASS)
        mass = m.body("mass", base, Translational(axis="x"), mass=1.0)
        m.force("spring", JointSpring(stiffness=STIFFNESS), mass)
        m.output("x", mass.position("x"))
        m.output("v", mass.velocity("x"))

    simulation = begin(make, solver)
    simulation.set_input(0, speed)
    assert simulation.discontinuity_work == 0.0
    assert simulation.advance(t).ok
    x, v = simulation.outputs()[:2]
    assert x == pytest.approx(speed * (t - np.sin(w * t) / w), abs=1e-8)
    assert simulation.discontinuity_work == pytest.approx(0.5 * BASE_MASS * speed**2, rel=1e-12)
    assert simulation.energy() - speed * v == pytest.approx(simulation.discontinuity_work, rel=1e-7)


CRANK, ROD, SWING = 0.4, 0.6, 1.1  # m, m, rad between them


def crank(copies: int) -> Callable[[Mechanism], None]:
    def make(m: Mechanism) -> None:
        drive = SpeedInput(name="speed", unit="rad/s", start=2.0)
        turning = m.body("crank", m.ground, Revolute(drive=drive), **rod(mass=1.0, length=CRANK))
        for i in range(copies):
            joint = Revolute(at=(CRANK, 0.0, 0.0), start=SWING, rate=-0.5)
            m.body(f"rod{i}", turning, joint, **rod(mass=3.0, length=ROD))

    return make


@pytest.mark.parametrize(("solver", "copies"), [*((s, 1) for s in SOLVERS), ("adams", LARGE), ("ida", LARGE)])
def test_a_rod_on_a_crank_keeps_its_angular_momentum_about_the_pin(solver: str, copies: int) -> None:
    """m l^2 / 3 dW + m (l / 2) cos(swing) r dw = 0: no moment acts about the pin, however hard it is jerked."""
    simulation, jump = begin(crank(copies), solver), 5.0
    simulation.set_input(0, 2.0 + jump)
    assert simulation.advance(1e-12).ok
    absolute = -1.5 * CRANK / ROD * np.cos(SWING) * jump
    np.testing.assert_allclose(simulation.stepper.v, -0.5 + absolute - jump, rtol=1e-9)

    def kinetic(w: float, spin: float) -> float:
        c = 0.5 * ROD * np.array([np.cos(SWING), np.sin(SWING)])
        v = np.array([0.0, CRANK * w]) + spin * np.array([-c[1], c[0]])
        return float(CRANK**2 / 6.0 * w**2 + copies * (1.5 * v @ v + 0.5 * 3.0 * ROD**2 / 12.0 * spin**2))

    work = kinetic(2.0 + jump, 1.5 + absolute) - kinetic(2.0, 1.5)
    assert simulation.discontinuity_work == pytest.approx(work, rel=1e-9)


BARS = {"crank": (0.5, 1.0, 0.9), "coupler": (1.3, 2.0, 0.3), "rocker": (0.9, 1.5, 1.4)}  # m, kg, rad from the x-axis


def four_bar(m: Mechanism) -> None:
    """The pivot of the rocker is on a slider that an input moves along x."""
    (a, ma, start), (b, mb, along), (c, mc, up) = BARS.values()
    tip = [f(start) * a + f(along) * b - f(up) * c for f in (np.cos, np.sin)]
    first = m.body("crank", m.ground, Revolute(start=start, fixed=True), **rod(mass=ma, length=a))
    second = m.body("coupler", first, Revolute(at=(a, 0, 0), start=along - start), **rod(mass=mb, length=b))
    drive = Input(name="u", unit="m", rate_name="du")
    slider = m.body("slider", m.ground, Translational(axis="x", at=(tip[0], tip[1], 0.0), drive=drive))
    third = m.body("rocker", slider, Revolute(start=up), **rod(mass=mc, length=c))
    m.cut("pin", SphericalCutJoint(at_a=(b, 0, 0), at_b=(c, 0, 0)), second, third)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_drive_that_moves_a_loop_jumps_with_it(solver: str) -> None:
    """Against M dw + J^T p = -m du, J dw = nu in the angles of the bars from the x-axis."""
    simulation, jump = begin(four_bar, solver), 0.8
    before = simulation.stepper.v
    simulation.set_input(1, jump)
    assert simulation.advance(1e-12).ok
    (a, ma, p), (b, mb, s), (c, mc, _) = BARS.values()
    across = {k: length * np.array([-np.sin(x), np.cos(x)]) for k, (length, _, x) in BARS.items()}
    M = np.diag([(ma / 3.0 + mb) * a**2, mb * b**2 / 3.0, mc * c**2 / 3.0])
    M[0, 1] = M[1, 0] = 0.5 * mb * a * b * np.cos(p - s)
    J = np.column_stack((across["crank"], across["coupler"], -across["rocker"]))
    right = np.concatenate(([0.0, 0.0, -0.5 * mc * across["rocker"][0] * jump], [jump, 0.0]))
    spins = np.linalg.solve(np.block([[M, J.T], [J, np.zeros((2, 2))]]), right)[:3]
    found = simulation.stepper.v - before
    np.testing.assert_allclose(found, [spins[0], spins[1] - spins[0], spins[2]], rtol=1e-8)
    assert simulation.compiled.residuals(simulation.t, simulation.stepper.q, simulation.stepper.v)[1] < 1e-9


def parallelogram(start: float) -> Callable[[Mechanism], None]:
    """Two cranks of 1 kg and 0.5 m under a coupler of 2 kg, pivots on a base that an input moves along x."""

    def make(m: Mechanism) -> None:
        base = m.body("base", m.ground, Translational(axis="x", drive=Input(name="u", unit="m", rate_name="du")))
        left = m.body("left", base, Revolute(start=start, fixed=True), **rod(mass=1.0, length=0.5))
        right = m.body("right", base, Revolute(at=(1.0, 0, 0), start=start), **rod(mass=1.0, length=0.5))
        bar = m.body("bar", left, Revolute(at=(0.5, 0, 0), start=-start), **rod(mass=2.0, length=1.0))
        m.cut("pin", SphericalCutJoint(at_a=(1.0, 0, 0), at_b=(0.5, 0, 0)), bar, right)
        m.output("angle", left.angle())

    return make


@pytest.mark.parametrize("solver", ["adams", "ida", "hybrid"])
def test_a_closed_loop_on_a_shaken_base(solver: str) -> None:
    """One freedom: (8 / 3) r phi'' = 3 sin(phi) u'', at first at rest."""
    share = 3.0 / (8.0 / 3.0) / 0.5

    def motion(t: float, y: Any) -> list[float]:
        return [y[1], -share * np.sin(y[0]) * W**2 * position(t)]

    errors = []
    for steps in (10, 20):
        times, rows = shake(begin(parallelogram(1.0), solver, 1e-8), "rate", 0.2, steps)
        begun = [1.0, share * np.sin(1.0) * rate(0.0)]
        exact = solve_ivp(motion, (0.0, 0.2), begun, t_eval=times, rtol=1e-11, atol=1e-13).y[0]
        errors.append(np.abs(rows[:, 0] - exact).max())
    assert errors[1] < 1e-3
    assert np.log2(errors[0] / errors[1]) > 1.9


def test_no_impulse_where_branches_cross_at_rest() -> None:
    simulation = begin(parallelogram(0.0))
    before = simulation.compiled.inputs.state()
    simulation.set_input(1, 1.0)
    with pytest.raises(UserError, match=r"the rate of input 'u' jumps at t = .*, where the impulse is not determined"):
        simulation.advance(0.1)
    assert simulation.compiled.inputs.state()["held"] == before["held"]


def test_inputs_that_jump_together_make_one_impulse() -> None:
    def make(m: Mechanism) -> None:
        drives = {axis: SpeedInput(name=axis, unit="m/s") for axis in "xy"}
        base = m.body("base_x", m.ground, Translational(axis="x", drive=drives["x"]))
        base = m.body("base", base, Translational(axis="y", drive=drives["y"]))
        m.body("rod", base, Revolute(start=0.7), **rod(mass=1.0, length=ROD))

    simulation = begin(make)
    for k, speed in enumerate((1.0, -2.0)):
        simulation.set_input(k, speed)
    assert simulation.advance(1e-12).ok
    assert simulation.statistics.restarts == 0  # the first begin of a history is none
    expected = -1.5 / ROD * (np.cos(0.7) * -2.0 - np.sin(0.7) * 1.0)
    assert simulation.stepper.v == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("way", ["position", "rate"])
def test_a_jump_of_position_is_a_motion_of_one_step(way: str) -> None:
    """A message reports the jump if the host gave another rate; a constant position afterwards causes no restart."""
    simulation = begin(oscillator(way))
    names = [v.name for v in simulation.compiled.outputs]
    assert simulation.advance(0.01).ok
    simulation.set_input(0, 0.005)
    if way == "rate":
        simulation.set_input(1, 1e-3)
        assert simulation.advance(0.02).ok
        assert [d.subject for d in simulation.diagnostics if d.code != "assumed-length"] == ["u"]
        assert simulation.outputs()[names.index("base")] == pytest.approx(0.005 + 1e-5, rel=1e-12)
        return
    assert simulation.advance(0.02).ok
    assert not [d for d in without_details(simulation.diagnostics) if d.code != "assumed-length"]
    assert simulation.outputs()[names.index("base")] == pytest.approx(0.005, rel=1e-12)
    assert simulation.advance(0.03).ok
    restarts = simulation.statistics.restarts
    for t in (0.04, 0.05):
        simulation.set_input(0, 0.005)
        assert simulation.advance(t).ok
    assert simulation.outputs()[names.index("base")] == 0.005
    assert simulation.statistics.restarts == restarts


def test_a_rate_alone_goes_on_from_what_it_has_reached() -> None:
    simulation = begin(oscillator("rate"))
    base = [v.name for v in simulation.compiled.outputs].index("base")
    for t, speed, expected in ((0.1, 0.3, 0.03), (0.2, 0.3, 0.06), (0.3, -0.1, 0.05), (0.4, -0.1, 0.04)):
        simulation.set_input(1, speed)
        assert simulation.advance(t).ok
        assert simulation.outputs()[base] == pytest.approx(expected, rel=1e-12)
    assert simulation.statistics.restarts == 1


@pytest.mark.parametrize("way", WAYS)
def test_a_saved_run_goes_on_with_the_motion(way: str) -> None:
    """Saved in the middle of a motion, with values given for the next step."""
    first, second = begin(oscillator(way)), begin(oscillator(way))
    shake(first, way, 0.05, 7)

    def go_on(simulation: Simulation) -> Any:
        assert simulation.advance(0.06).ok
        for k, value in enumerate(WAYS[way](0.06, 0.07)):
            simulation.set_input(k, value)
        assert simulation.advance(0.07).ok
        return [*simulation.outputs(), simulation.discontinuity_work]

    for k, value in enumerate(WAYS[way](0.05, 0.06)):
        first.set_input(k, value)
    saved = first.save()
    expected = go_on(first)
    second.restore(saved)
    assert go_on(second) == expected


@pytest.mark.parametrize("way", WAYS)
def test_outputs_in_between_are_on_the_motion(way: str) -> None:
    """Many outputs in one call are as many steps of communication."""
    one, many = begin(oscillator(way)), begin(oscillator(way))
    times = 0.05 + np.array([0.01, 0.03, 0.04, 0.05])
    for simulation in (one, many):
        shake(simulation, way, 0.05, 7)
        for k, value in enumerate(WAYS[way](0.05, 0.06)):
            simulation.set_input(k, value)
    rows, values = [], np.zeros((4, 6))
    for t in times:
        assert one.advance(t).ok
        rows.append(one.outputs().copy())
    assert many.record(times, values) == 4
    np.testing.assert_allclose(values, rows, rtol=1e-7, atol=1e-9)


def swing(drive: Any) -> Callable[[Mechanism], None]:
    """A spindle about y with an arm on a spring that swings outward and is left behind."""

    def make(m: Mechanism) -> None:
        spindle = m.body("spindle", m.ground, Revolute(axis="y", drive=drive))
        joint = Revolute(axis=(1.0, 0.0, 1.0), at=(0.1, 0.0, 0.0))
        arm = m.body("arm", spindle, joint, mass=1.0, com=(0.2, -0.2, 0.0), inertia=(0.01, 0.02, 0.01))
        m.force("spring", JointSpring(stiffness=5.0), arm)
        m.output("angle", arm.angle())

    return make


def test_a_spindle_at_given_speeds_converges_to_its_run_up() -> None:
    run_up, stop = RunUp(speed=8.0, duration=0.4), 0.5
    exact = run(Made(make=swing(run_up)), Settings(solver="adams", tolerance=1e-10), np.array([0.0, stop]))["angle"][-1]
    errors = []
    for steps in (25, 50, 100):
        simulation = begin(swing(SpeedInput(name="speed", unit="rad/s")))
        for t, after in pairwise(np.linspace(0.0, stop, steps + 1)):
            x = min(t / run_up.duration, 1.0)
            simulation.set_input(0, run_up.speed * (x - np.sin(2.0 * np.pi * x) / (2.0 * np.pi)))
            assert simulation.advance(after).ok
        errors.append(abs(simulation.outputs()[0] - exact))
    assert np.all(np.log2(np.divide(errors[:-1], errors[1:])) > 0.9)
    assert errors[-1] < 0.05 * abs(exact)


def test_a_jump_of_gravity_lifts_the_energy() -> None:
    def make(m: Mechanism) -> None:
        m.body("a", m.ground, Translational(axis="y", start=3.0), mass=2.0)

    gravity = (0.0, Input(name="g", unit="m/s2", start=-10.0), 0.0)
    simulation = Simulation(Made(make=make, gravity=gravity), Settings(solver="adams", tolerance=1e-10))
    start = simulation.energy()
    assert simulation.advance(0.1).ok
    simulation.set_input(0, -4.0)
    assert simulation.discontinuity_work == pytest.approx(2.0 * (4.0 - 10.0) * (3.0 - 0.5 * 10.0 * 0.01), rel=1e-9)
    assert simulation.advance(0.2).ok
    assert simulation.energy() - start == pytest.approx(simulation.discontinuity_work, rel=1e-9)


@dataclass(frozen=True, kw_only=True)
class Shaken(Sheet):
    """A sheet whose edge a known function of time moves up and down."""

    support: str = "moved"

    def _edge(self, m: Mechanism) -> Body:
        stand = m.body("stand", m.ground, Weld(at=(self.length, 0.0, 0.5 * self.width)))
        drive = Harmonic(amplitude=AMPLITUDE, frequency=W / (2.0 * np.pi))
        return m.body("edge", stand, Translational(axis="y", drive=drive))


@pytest.mark.parametrize("grid", [(4, 3), (7, 5)])
def test_a_shaken_sheet_is_that_on_a_harmonic_drive(grid: tuple[int, int]) -> None:
    """The inputs give the speed of the edge from the start: connected nodes move with it, as on the drive."""
    values = {"nx": grid[0], "nz": grid[1], "gravity_y": 0.0, "thickness": 1e-3}
    settings, times = Settings(tolerance=1e-7), np.linspace(0.0, 0.06, 13)
    exact = run(Shaken(**values), settings, times)["tip.y"][1:]
    model, errors = Sheet(support="moved", **values), []
    names = [v.name for v in CompiledMechanism(model.build()).inputs.variables]
    first = names.index("edge.y")
    assert names[first + 1] == "edge.vy"
    for steps in (12, 24):
        simulation = Simulation(model, settings, inputs={first + 1: rate(0.0)})
        tip = [v.name for v in simulation.compiled.outputs].index("tip.y")
        _, rows = shake(simulation, "rate", times[-1], steps, first)
        errors.append(np.abs(rows[steps // 12 - 1 :: steps // 12, tip] - exact).max())
    assert np.ptp(exact - [position(t) for t in times[1:]]) > 0.2 * AMPLITUDE
    assert errors[1] < 0.01 * AMPLITUDE
    assert np.log2(errors[0] / errors[1]) > 1.9


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("steps", [20, 100, 1000])
def test_a_smooth_motion_to_rest_is_no_jump(size: float, steps: int) -> None:
    """Position and rate exact; a jump of a ten-thousandth of the way is noticed, with its time and size."""
    m = Mechanism()
    sled = m.body("sled", m.ground, Translational(axis="x", drive=Input(name="u", unit="m", rate_name="v")), mass=1.0)
    m.body("bob", sled, Translational(axis="x"), mass=1.0)
    m.output("x", sled.coordinate())

    def way(t: float) -> tuple[float, float]:
        s = min(t, 1.0)
        return size * (s - np.sin(2.0 * np.pi * s) / (2.0 * np.pi)), size * (1.0 - np.cos(2.0 * np.pi * s))

    for jump in (0.0, 1e-4 * size):
        simulation = Simulation(m, Settings(solver="adams", tolerance=1e-9))
        for t in np.linspace(0.0, 1.5, steps + 1):
            u, v = way(t)
            simulation.set_input("u", u + jump * (t > 1.2))
            simulation.set_input("v", v)
            simulation.advance(t + 1.5 / steps)
        told = [text for text in map(str, simulation.diagnostics) if "its position differs by" in text]
        assert len(told) == (jump > 0.0)
        assert all(f"its position differs by {jump:.3g} m " in text and "'u' at t = 1.2" in text for text in told)


def jumps_of(way: Callable[[float], float], rate: Callable[[float], float], times: Any, tolerance: float) -> list[str]:
    """Set position and rate at times, and return the messages on jumps."""
    m = Mechanism()
    sled = m.body("sled", m.ground, Translational(axis="x", drive=Input(name="u", unit="m", rate_name="v")), mass=1.0)
    m.body("bob", sled, Translational(axis="x"), mass=1.0)
    start = {"u": way(times[0]), "v": rate(times[0])}
    simulation = Simulation(m, Settings(solver="adams", tolerance=tolerance), inputs=start)
    for t, end in pairwise(times):
        simulation.set_input("u", way(t))
        simulation.set_input("v", rate(t))
        simulation.advance(end)
    return [text for text in map(str, simulation.diagnostics) if "its position differs by" in text]


EVEN = np.linspace(0.0, 1.0, 101)


@pytest.mark.parametrize("speed", [1e-3, 1.0, -30.0])
@pytest.mark.parametrize("jump", [1e-5, 0.01, 0.3])
@pytest.mark.parametrize("when", [0.005, 0.015, 0.505])
def test_a_jump_of_any_size_is_noticed_at_any_speed(speed: float, jump: float, when: float) -> None:
    """The size of the jump is larger than the tolerance, but may be smaller than the way of a step."""
    (told,) = jumps_of(lambda t: speed * t + jump * (t > when), lambda t: speed, EVEN, 1e-6)
    assert f"input 'u' at t = {when + 0.005:.9g} s: its position differs by {jump:.3g} m " in told
    smaller = 1e-4 * jump
    assert not jumps_of(lambda t: speed * t + smaller * (t > when), lambda t: speed, EVEN, 1e-4)


@pytest.mark.parametrize("factor", [0.0, 0.99, 2.0, -1.0])
def test_a_rate_with_a_wrong_factor_is_noticed(factor: float) -> None:
    for way, rate in ((lambda t: t, lambda t: 1.0), (lambda t: np.sin(3.0 * t), lambda t: 3.0 * np.cos(3.0 * t))):
        steps = np.linspace(0.0, 1.0, 1001)
        assert len(jumps_of(way, lambda t, rate=rate: factor * rate(t) + (factor == 0.0) * 1e-9, steps, 1e-6)) == 1


@pytest.mark.parametrize("steps", [12, 40, 1000])
@pytest.mark.parametrize("phase", [0.0, 0.7, 1.6, 3.0])
@pytest.mark.parametrize("uneven", [False, True])
def test_smooth_motions_are_no_jumps(steps: int, phase: float, uneven: bool) -> None:
    """A sine with ``steps`` points a period, with its rate now, or its mean rate of the step before or to come."""
    widths = np.random.default_rng(steps).uniform(0.7, 1.4, 2 * steps) if uneven else np.ones(2 * steps)
    times = np.append(0.0, np.cumsum(widths)) * 2.0 * np.pi / steps
    ends = np.append(times, times[-1] + 2.0 * np.pi / steps)

    def way(t: float) -> float:
        return float(np.sin(t + phase))

    def mean(t: float, ahead: int) -> float:
        k = max(int(np.searchsorted(ends, t)) + ahead, 0)
        return (way(ends[k + 1]) - way(ends[k])) / (ends[k + 1] - ends[k])

    for rate in (lambda t: np.cos(t + phase), lambda t: mean(t, 0), lambda t: mean(t, -1)):
        assert not jumps_of(way, rate, times, 1e-9)

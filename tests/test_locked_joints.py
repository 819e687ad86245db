"""Joints that events lock and release: momentum at the lock, rest in between, and the motion after the release."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad, solve_ivp
from scipy.special import ellipk

import mbfmu as mb
from mbfmu.modeling.settings import Settings
from mbfmu.session.result import Result
from mbfmu.session.simulation import Simulation
from mbfmu.util.errors import UserError

SMALL = ["adams", "hybrid", "ida", "radau"]
G = 9.81
Array = NDArray[np.float64]


def times(result: Result, name: str) -> list[float]:
    return [event.time for event in result.events if event.name == name]


@dataclass(frozen=True, kw_only=True)
class Clutch(mb.Model):
    """Two rotors on one axis, of 2 and 0.5 kg m2; the second turns on the first. A torque drives the first one."""

    name = "clutch_of_two_rotors"
    torque: float = mb.parameter(1.0, unit="N.m", tunable=True)

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism()
        first = m.body("first", m.ground, mb.Revolute(rate=3.0), inertia=(1, 1, 2.0))
        second = m.body("second", first, mb.Revolute(rate=-2.0), inertia=(1, 1, 0.5))
        m.force("motor", mb.JointForce(self.torque), first)
        m.event("close", at=0.5, then=mb.Lock(second))
        m.event("open", at=1.0, then=mb.Release(second))
        m.event("kick", at=1.1, then=mb.Impulse(second, 1.0))
        m.event("close again", at=1.5, then=[mb.Lock(second), mb.Impulse(second, 5.0)])
        m.event("open again", at=1.8, then=mb.Release(second))
        for name, body in (("first", first), ("second", second)):
            m.output(f"{name}.rate", body.rate())
        m.output("second.angle", second.angle())
        m.output("torque", second.joint_moment("z"))
        return m


def rotors(t: float, torque: float = 1.0) -> tuple[float, float, float, float]:
    """Return rate of the first rotor, rate and angle of the second one relative to it, and the torque in the joint.

    While the joint is open the momentum of the second rotor is constant; in all it grows by the torque times the time.
    """
    first, own, angle, last = 3.0, 1.0, 0.0, 0.0
    for until, event in ((0.5, "close"), (1.0, "open"), (1.1, "kick"), (1.5, "close"), (1.8, "open"), (np.inf, "")):
        h = min(t, until) - last
        is_closed = last in (0.5, 1.5)
        a = torque / (2.5 if is_closed else 2.0)
        angle += 0.0 if is_closed else (own - first) * h - 0.5 * a * h * h
        first += a * h
        own += a * h if is_closed else 0.0
        if t < until:
            return first, own - first, angle, 0.5 * a if is_closed else 0.0
        if event == "kick":
            first, own = first - 1.0 / 2.0, own + 1.0 / 0.5
        elif event == "close":
            first = own = (2.0 * first + 0.5 * own) / 2.5
        last = until
    raise AssertionError


@pytest.mark.parametrize("solver", SMALL)
def test_a_clutch_joins_two_rotors_twice(solver: str) -> None:
    """Closed form. The energy that is lost at the lock is no energy error, and a locked joint transmits an impulse."""
    result = mb.simulate(Clutch(), 2.0, interval=0.2, solver=solver, tolerance=1e-7)
    expected = np.array([rotors(t) for t in result.t])
    np.testing.assert_allclose(result.values[:, :4], expected, rtol=0.0, atol=2e-6)
    assert np.all(result["second.rate"][[3, 4, 8]] == 0.0)
    assert abs(result["energy_error"]).max() <= 1e-6
    assert np.all(np.diff(result["energy_throughput"]) >= 0.0)
    assert not result.warning
    assert not result.failed
    assert result.statistics.steps > 10


def throughput(end: float) -> float:
    """Return the range of the kinetic energy until then plus the work of the torque, which turns the rotor forward."""
    times = np.array([t for t in np.linspace(0.0, 2.0, 2001) if t <= end])
    for event in (0.5, 1.0, 1.1, 1.5, 1.8):
        times = np.append(times, [event - 1e-9] if event <= end else [])
    times = np.sort(times)
    rates = np.array([rotors(t)[:2] for t in times])
    kinetic = rates[:, 0] ** 2 + 0.25 * rates.sum(1) ** 2
    return float(np.ptp(kinetic) + np.trapezoid(rates[:, 0], times))


@pytest.mark.parametrize("solver", SMALL)
def test_the_energy_throughput_of_a_clutch_is_that_of_the_whole_run(solver: str) -> None:
    """Closed form; the solvers examine the kinetic energy at the ends of some of their steps, which are short here."""
    settings = Settings(solver=solver, tolerance=1e-7, max_step=1e-3)
    simulation = Simulation(Clutch(), settings)
    for t in (0.4, 0.7, 1.3, 1.7, 2.0):
        simulation.advance(t)
        assert simulation.outputs()[-1] == pytest.approx(throughput(t), abs=0.05)


@pytest.mark.parametrize("solver", SMALL)
def test_a_pendulum_is_held_in_flight(solver: str) -> None:
    """Closed form: released at 1 rad below the horizontal, held 0.5 rad before the vertical for a while, and released
    from rest: a quarter of the period of that amplitude later it is vertical. The brake holds the weight.
    """
    tolerance, amplitude = 1e-8, 0.5
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    bob = m.body("bob", m.ground, mb.Revolute(start=-0.5, rate=-0.3), mass=2.0, com=(1.0, 0.0, 0.0))
    m.event("hold", bob.angle(), crosses=amplitude - np.pi / 2, direction="down", then=mb.Lock(bob))
    m.event("let go", at=1.5, then=mb.Release(bob))
    m.event("vertical", bob.angle(), crosses=-np.pi / 2, then=mb.EndRun())
    m.output("angle", bob.angle())
    m.output("moment", bob.joint_moment("z"))
    m.output("effort", bob.effort())
    result = mb.simulate(m, 4.0, interval=0.1, solver=solver, tolerance=tolerance)
    rate = lambda angle: np.sqrt(0.09 + 2.0 * G * (np.sin(-0.5) - np.sin(angle)))  # noqa: E731
    fall = quad(lambda angle: 1.0 / rate(angle), amplitude - np.pi / 2, -0.5, epsabs=1e-12)[0]
    assert times(result, "hold") == pytest.approx([fall], abs=30.0 * tolerance)
    quarter = ellipk(np.sin(amplitude / 2) ** 2) / np.sqrt(G)
    assert times(result, "vertical") == pytest.approx([1.5 + quarter], abs=30.0 * tolerance)
    held = (result.t > fall) & (result.t < 1.5)
    np.testing.assert_allclose(result["angle"][held], amplitude - np.pi / 2, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(result["moment"][held], 2.0 * G * np.sin(amplitude), rtol=1e-9)
    np.testing.assert_allclose(result["effort"][held], 2.0 * G * np.sin(amplitude), rtol=1e-9)
    np.testing.assert_allclose(result["effort"][~held], 0.0, atol=1e-9)
    assert abs(result["energy_error"]).max() <= 1e-6  # also while nothing can move
    assert not result.warning


def double_pendulum() -> mb.Mechanism:
    """Return two rods of 1 m and 1 kg; the second joint is locked where it passes 0.4 rad, and released later."""
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    upper = m.body("upper", m.ground, mb.Revolute(start=0.2), **mb.rod(mass=1.0, length=1.0))
    lower = m.body("lower", upper, mb.Revolute(at=(1.0, 0.0, 0.0), start=-0.5), **mb.rod(mass=1.0, length=1.0))
    m.event("lock", lower.angle(), crosses=0.4, direction="up", then=mb.Lock(lower))
    for k, t in enumerate((1.3, 3.0)):
        m.event(f"release {k}", at=t, then=mb.Release(lower))
    m.output("upper", upper.angle())
    m.output("lower", lower.angle())
    return m


def absolute_angles(times_at: Array) -> tuple[Array, list[float]]:
    """Return the same motion by the absolute angles of the rods (SciPy, Lagrange's equations), and the times of locks.

    With both angles equal but for a constant the rods are one body. At the lock the sum of the momenta of the two
    angles is kept, since the moment of the joint acts on both with opposite signs.
    """

    def matrix(y: Array) -> Array:
        c = 0.5 * np.cos(y[0] - y[1])
        return np.array([[4.0 / 3.0, c], [c, 1.0 / 3.0]])

    def forces(y: Array) -> Array:
        s = 0.5 * np.sin(y[0] - y[1])
        return np.array([-s * y[3] ** 2 - 1.5 * G * np.cos(y[0]), s * y[2] ** 2 - 0.5 * G * np.cos(y[1])])

    def free(t: float, y: Array) -> Array:
        return np.concatenate((y[2:], np.linalg.solve(matrix(y), forces(y))))

    def joined(t: float, y: Array) -> Array:
        a = forces(y).sum() / matrix(y).sum()
        return np.array([y[2], y[3], a, a])

    def passes(t: float, y: Array) -> float:
        return float(y[1] - y[0] - 0.4)

    passes.terminal, passes.direction = True, 1.0  # type: ignore[attr-defined]
    y, t, rows, locks = np.array([0.2, -0.3, 0.0, 0.0]), 0.0, np.zeros((len(times_at), 2)), list[float]()
    for until in (1.3, 3.0, times_at[-1]):
        for law, event in ((free, passes), (joined, None)):
            if t >= until:
                continue
            found = solve_ivp(
                law, (t, until), y, method="DOP853", rtol=1e-12, atol=1e-12, dense_output=True, events=event
            )
            inside = (times_at >= t) & (times_at <= found.t[-1])
            angles = found.sol(times_at[inside])
            rows[inside] = np.column_stack((angles[0], angles[1] - angles[0]))
            y, t = found.y[:, -1], float(found.t[-1])
            if event and t < until:
                locks.append(t)
                y[2:] = (matrix(y) @ y[2:]).sum() / matrix(y).sum()
    return rows, locks


@pytest.mark.parametrize("solver", SMALL)
def test_a_double_pendulum_is_locked_twice(solver: str) -> None:
    """Reference: SciPy on another formulation; a lock at the value of the sensor is no event again at the release."""
    result = mb.simulate(double_pendulum(), 3.6, interval=0.1, solver=solver, tolerance=1e-9)
    expected, locks = absolute_angles(result.t)
    assert len(locks) == 2
    np.testing.assert_allclose(times(result, "lock"), locks, rtol=0.0, atol=3e-7)
    np.testing.assert_allclose(result.values[:, :2], expected, rtol=0.0, atol=2e-6)
    assert not result.warning


@pytest.mark.parametrize("kept", ["checkpoint", "save"])
@pytest.mark.parametrize("solver", ["adams", "ida", "radau"])
def test_a_run_returns_to_a_state_with_other_locks(solver: str, kept: str) -> None:
    """From a locked state to a free one, and back; a second simulation continues from both, too."""
    settings = Settings(solver=solver, tolerance=1e-7)
    runs = Simulation(Clutch(), settings), Simulation(Clutch(), settings)
    points, states = (0.3, 0.7, 1.2, 1.6, 1.9), []
    for t in points:
        runs[0].advance(t)
        states.append(runs[0].checkpoint() if kept == "checkpoint" else runs[0].save())
    reached, steps = runs[0].outputs().copy(), runs[0].statistics.steps
    for k in (1, 2, 0, 3):
        for run in runs if kept == "save" else runs[:1]:
            (run.rollback if kept == "checkpoint" else run.restore)(states[k])  # type: ignore[operator]
            assert run.t == points[k]
            np.testing.assert_allclose(run.outputs()[:4], rotors(points[k]), rtol=0.0, atol=2e-6)
            for t in points[k + 1 :]:
                run.advance(t)
            if solver == "ida":  # it starts a new history at a state
                np.testing.assert_allclose(run.outputs()[:4], reached[:4], rtol=0.0, atol=2e-6)
            else:
                np.testing.assert_array_equal(run.outputs(), reached)
                assert run.statistics.steps == steps
    assert [event.name for event in runs[0].events] == ["close", "open", "kick", "close again", "open again"]


def test_a_parameter_changes_while_a_joint_is_locked() -> None:
    """Closed form: without the torque the rotors turn on at their speed."""
    simulation = Simulation(Clutch(), Settings(solver="adams", tolerance=1e-8))
    simulation.advance(0.7)
    state = simulation.checkpoint()
    simulation.retune(Clutch(torque=0.0))
    simulation.advance(1.05)
    np.testing.assert_allclose(simulation.outputs()[:2], [rotors(0.7)[0], 0.0], rtol=0.0, atol=1e-7)
    simulation.rollback(state)
    simulation.advance(1.05)
    np.testing.assert_allclose(simulation.outputs()[:4], rotors(1.05), rtol=0.0, atol=1e-7)


def test_what_is_not_locked_is_not_released() -> None:
    m = mb.Mechanism()
    arm = m.body("arm", m.ground, mb.Revolute(rate=1.0), inertia=(1, 1, 1))
    m.event("open", at=0.5, then=mb.Release(arm))
    m.output("angle", arm.angle())
    result = mb.simulate(m, 1.0, interval=0.25, solver="adams")
    assert result.failure.startswith("event 'open' releases the joint 'arm' at t = 0.5 s, which is not locked")
    assert result.diagnostics[-1].code == "not-locked"


def test_a_drive_that_prescribes_a_rate_is_not_locked() -> None:
    m = mb.Mechanism()
    driven = m.body("driven", m.ground, mb.Revolute(drive=mb.Polynomial((0.0, 2.0))), inertia=(1, 1, 1))
    wheel = m.body("wheel", m.ground, mb.Revolute(), inertia=(1, 1, 1))
    m.couple("gear", mb.Gear(ratio=2.0), wheel, driven)
    m.event("brake", at=0.5, then=mb.Lock(wheel))
    m.output("angle", wheel.angle())
    result = mb.simulate(m, 1.0, interval=0.25, solver="adams")
    assert result.failure.startswith(
        "event 'brake' cannot lock the joint 'wheel' at t = 0.5 s: drives prescribe its rate"
    )


@pytest.mark.parametrize(
    ("joint", "text"),
    [
        (mb.Spherical(), r"a Spherical with 3 coordinates \(.*\); allowed: a joint with one coordinate"),
        (mb.Floating(), "a Floating with 6 coordinates"),
        (mb.Weld(), "has no joint coordinate 0"),
        (mb.Revolute(drive=0.0), "is 'arm', which is driven; allowed: a joint that moves freely"),
    ],
)
def test_joints_that_cannot_be_locked_are_refused(joint: mb.mechanics.Joint, text: str) -> None:
    m = mb.Mechanism()
    arm = m.body("arm", m.ground, joint, mass=1.0, inertia=(1, 1, 1))
    with pytest.raises(UserError, match=text):
        m.event("brake", at=0.5, then=mb.Lock(arm))


def test_a_joint_of_another_mechanism_is_refused() -> None:
    m, other = mb.Mechanism(), mb.Mechanism()
    arm = other.body("arm", other.ground, mb.Revolute(), inertia=(1, 1, 1))
    with pytest.raises(UserError, match="joint of the Release in event 'brake' is 'arm', which is not a body of this"):
        m.event("brake", at=0.5, then=mb.Release(arm))


def test_the_ground_has_no_joint_to_lock() -> None:
    m = mb.Mechanism()
    with pytest.raises(
        UserError, match="joint of the Lock in event 'brake' is the ground, which has no joint; allowed"
    ):
        m.event("brake", at=0.5, then=mb.Lock(m.ground))


def test_a_declared_joint_is_locked() -> None:
    """It connects two bodies in the opposite direction. Reference: SciPy, as above."""
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    upper, lower = (m.body(name, **mb.rod(mass=1.0, length=1.0)) for name in ("upper", "lower"))
    joint = m.joint("elbow", lower, upper, mb.Revolute(start=0.5), at_b=(1.0, 0.0, 0.0))
    shoulder = m.joint("shoulder", m.ground, upper, mb.Revolute(start=0.2))
    m.event("lock", joint.angle(), crosses=-0.4, direction="down", then=mb.Lock(joint))
    m.event("release", at=1.3, then=mb.Release(joint))
    m.output("upper", shoulder.angle())
    m.output("lower", joint.angle())
    result = mb.simulate(m, 1.8, interval=0.1, solver="adams", tolerance=1e-9)
    expected, locks = absolute_angles(np.append(result.t, 3.0))
    np.testing.assert_allclose(times(result, "lock"), locks[:1], rtol=0.0, atol=3e-7)
    np.testing.assert_allclose(result.values[:, :2], expected[:-1] * (1.0, -1.0), rtol=0.0, atol=2e-6)


@pytest.mark.parametrize("solver", ["adams", "ida"])
def test_given_times_next_to_communication_points(solver: str) -> None:
    """Closed form: 14 times 0.1 s is not 1.4 s as a number, and no solver takes a step of that difference."""
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    ball = m.body("ball", m.ground, mb.Translational(axis="y"), mass=2.0)
    m.event("restart", at=1.4, then=mb.Restart())
    m.event("throw", at=0.7, then=mb.Impulse(ball, 3.0))
    m.output("rate", ball.rate())
    result = mb.simulate(m, 2.0, interval=0.1, solver=solver, tolerance=1e-7)
    np.testing.assert_allclose(result["rate"], -G * result.t + 1.5 * (result.t >= 0.69), rtol=0.0, atol=1e-6)
    assert [event.name for event in result.events] == ["throw", "restart"]


@pytest.mark.parametrize("kept", ["checkpoint", "save"])
def test_a_roller_is_locked_near_a_sheet(kept: str) -> None:
    """Closed form: the sheet falls without bending; its elements have limits, which are checked at every point."""
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    roller = m.body("roller", m.ground, mb.Revolute(axis="x", rate=2.0), inertia=(1, 1, 1))
    sheet = mb.add_sheet(
        m, "sheet", length=0.1, width=0.1, thickness=1e-3, youngs_modulus=1e9, density=800.0, grid=(3, 3), tree="master"
    )
    m.event("brake", at=0.1, then=mb.Lock(roller))
    m.event("release", at=0.2, then=mb.Release(roller))
    m.output("angle", roller.angle())
    m.output("height", sheet.nodes[0][0].position("y"))
    simulation = Simulation(m, Settings(solver="radau", tolerance=1e-6))
    states, reached = [], []
    for t in (0.05, 0.15, 0.25):
        simulation.advance(t)
        states.append(simulation.checkpoint() if kept == "checkpoint" else simulation.save())
        reached.append(simulation.outputs()[:2].copy())
        np.testing.assert_allclose(reached[-1], [2.0 * min(t, 0.1), -0.5 * G * t * t], rtol=0.0, atol=1e-6)
    (simulation.rollback if kept == "checkpoint" else simulation.restore)(states[1])  # type: ignore[operator]
    simulation.advance(0.25)
    np.testing.assert_allclose(simulation.outputs()[:2], reached[2], rtol=0.0, atol=1e-12)
    assert not simulation.failed

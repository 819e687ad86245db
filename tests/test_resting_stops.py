"""Bodies that come to rest at rigid stops: how long they stay, which force they exert, and when they are lifted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import mbfmu as mb
from mbfmu.modeling.settings import Settings
from mbfmu.session.kernels.pull_search import lowest_time
from mbfmu.session.result import Result
from mbfmu.session.simulation import Simulation

from .test_bounces import CRANK, fourbar, linkage
from .test_events import SMALL, G, Midpoint, times

SIZES = [1e-3, 1.0, 1e3]


def lifts(result: Result, name: str, direction: str = "up") -> list[float]:
    """Return the times at which a stop releases what rests on it; its impacts have the other direction."""
    return [event.time for event in result.events if event.name == name and event.direction == direction]


def ball(restitution: float, size: float = 1.0, start: float = 1.0, lift: bool = False) -> mb.Mechanism:
    """Return a ball of 2 size^3 kg that falls from ``start`` times size; gravity is 9.81 size."""
    m = mb.Mechanism(gravity=(0.0, -G * size, 0.0))
    joint = mb.Translational(axis="y", start=start * size, nominal=size)
    body = m.body("ball", m.ground, joint, mass=2.0 * size**3)
    if lift:
        m.force("lift", mb.JointForce(mb.Input(name="lift", unit="N", start=0.0)), body)
    m.event("floor", body.coordinate(), direction="down", then=mb.Bounce(restitution))
    m.output("height", body.coordinate())
    m.output("rate", body.rate())
    m.output("force", body.effort())
    return m


def height(t: float, e: float) -> float:
    """Height of a ball that falls from 1 m, bounces, and has come to rest after infinitely many bounces."""
    fall = np.sqrt(2.0 / G)
    if t < fall:
        return float(1.0 - 0.5 * G * t * t)
    t, speed = t - fall, e * G * fall
    while speed > 1e-9:
        if t < 2.0 * speed / G:
            return float(speed * t - 0.5 * G * t * t)
        t, speed = t - 2.0 * speed / G, e * speed
    return 0.0


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("restitution", [0.0, 0.5, 0.8])
def test_a_ball_comes_to_rest(restitution: float, size: float) -> None:
    """Closed form: its height is right at all times within a few tolerances, and the floor carries its weight."""
    tolerance = 1e-7
    result = mb.simulate(ball(restitution, size), 6.0, interval=0.02, solver="adams", tolerance=tolerance)
    expected = [height(t, restitution) for t in result.t]
    np.testing.assert_allclose(result["height"] / size, expected, rtol=0.0, atol=10.0 * tolerance)
    rests = result.t > np.sqrt(2.0 / G) * (1.0 + restitution) / (1.0 - restitution) + 0.01
    assert np.all(result["rate"][rests] == 0.0)
    assert np.ptp(result["height"][rests]) == 0.0
    np.testing.assert_allclose(result["force"][rests], 2.0 * G * size**4, rtol=1e-12)
    assert result["height"].min() >= 0.0
    assert not result.warning
    assert not result.failed


@pytest.mark.parametrize("solver", SMALL)
def test_a_ball_rests_for_an_hour(solver: str) -> None:
    """It does not move at all."""
    result = mb.simulate(ball(0.5), 3600.0, interval=60.0, solver=solver, tolerance=1e-7)
    assert np.ptp(result["height"][1:]) == 0.0
    assert 0.0 <= result["height"][-1] <= 1e-12
    np.testing.assert_allclose(result["force"][1:], 2.0 * G, rtol=1e-12)
    assert result.events[-1].time < 2.0
    assert not result.warning
    assert not result.failed


@pytest.mark.parametrize("solver", [*SMALL, Midpoint])
def test_the_last_bounces_are_smaller_than_the_tolerance(solver: Any) -> None:
    """Closed form: they rise to e^2n m; 2 u^2 / (g (1 - e)) = 4 e^2n / (1 - e) of the last one is not resolved."""
    e, tolerance = 0.6, 1e-6
    result = mb.simulate(ball(e), 3.0, interval=0.5, solver=solver, tolerance=tolerance)
    count = len(times(result, "floor"))
    resolved = [4.0 * e ** (2 * n) / (1.0 - e) > tolerance for n in range(1, count + 1)]
    assert resolved == [True] * (count - 1) + [False]
    assert result["height"][-1] >= 0.0
    assert result["force"][-1] == pytest.approx(2.0 * G, rel=1e-9)
    assert not result.failed


@pytest.mark.parametrize("size", SIZES)
def test_a_ball_that_starts_on_the_floor_is_at_rest_there(size: float) -> None:
    result = mb.simulate(ball(1.0, size, start=0.0), 10.0, interval=1.0, solver="ida", tolerance=1e-7)
    assert not result.events
    assert np.all(result["height"] == 0.0)
    np.testing.assert_allclose(result["force"], 2.0 * G * size**4, rtol=1e-12)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("solver", ["adams", "hybrid", "radau"])
def test_a_growing_force_lifts_a_ball(solver: str, size: float) -> None:
    """Closed form: the force k t exceeds the weight at 5 s, after the bounces, and then the height is
    k (t - 5)^3 / (6 m).
    """
    weight = 2.0 * G * size**4
    force = {"lift": f"{weight / 5.0!r} * t"}
    result = mb.simulate(ball(0.4, size, 0.5, True), 6.0, interval=0.5, solver=solver, tolerance=1e-8, inputs=force)
    assert lifts(result, "floor") == pytest.approx([5.0], abs=1e-8)
    held = (result.t > 2.0) & (result.t < 5.0)
    np.testing.assert_allclose(result["force"][held], weight * (1.0 - result.t[held] / 5.0), rtol=1e-9)
    assert result["height"][-1] / size == pytest.approx(G / 30.0, abs=1e-8)
    assert abs(result["energy_error"]).max() <= 1e-7 * weight * size
    assert not result.warning


@pytest.mark.parametrize("solver", [*SMALL, Midpoint])
def test_a_short_pull_between_two_points_lifts_a_ball(solver: Any) -> None:
    """Closed form: the force of the floor touches zero at 0.3 s or becomes negative by a thousandth of the weight."""
    for excess, wanted in ((-1e-3, 0), (1e-3, 1)):
        pull = f"{2.0 * G * (1.0 + excess)!r} * (1 - 50 * (t - 0.3)**2)"
        result = mb.simulate(
            ball(0.0, start=0.0, lift=True), 0.35, interval=0.35, solver=solver, tolerance=1e-6, inputs={"lift": pull}
        )
        at = 0.3 - np.sqrt(excess / (1.0 + excess) / 50.0) if wanted else 0.0
        assert lifts(result, "floor")[:1] == (pytest.approx([at], abs=1e-6) if wanted else [])


def on_table(restitution: float) -> mb.Mechanism:
    """Return a block on a table that oscillates by 0.05 m with 3 Hz."""
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    drive = mb.Harmonic(amplitude=0.05, frequency=3.0)
    table = m.body("table", m.ground, mb.Translational(axis="y", drive=drive), mass=1.0)
    block = m.body("block", table, mb.Translational(axis="y"), mass=1.5)
    m.event("table", block.coordinate(), direction="down", then=mb.Bounce(restitution))
    m.output("gap", block.coordinate())
    m.output("force", block.effort())
    return m


@pytest.mark.parametrize("solver", SMALL)
def test_a_block_on_an_oscillating_table(solver: str) -> None:
    """Closed form: it lifts where the table accelerates downwards by g, and lands where its parabola meets the table.

    The restitution is 0: it rests on the table if the table does not accelerate downwards by more than g there.
    """
    w, lift, stop = 6.0 * np.pi, 0.05, 3.0
    table, rate = lambda t: lift * np.sin(w * t), lambda t: lift * w * np.cos(w * t)
    first, t, up, down = np.arcsin(G / (lift * w * w)) / w, 0.0, [], []
    while t < stop:
        turns = np.ceil(w * (t - first) / (2.0 * np.pi))
        leaves = first + 2.0 * np.pi * max(turns, 0.0) / w
        y, v = table(leaves), rate(leaves)
        gap = lambda x, y=y, v=v, t=leaves: y + v * (x - t) - 0.5 * G * (x - t) ** 2 - table(x)  # noqa: E731
        t = brentq(gap, leaves + 0.02, leaves + 2.0 * v / G + 0.1, xtol=1e-14)
        up.append(leaves)
        down.append(t)
        assert lift * w * w * np.sin(w * t) < G
    tolerance = 1e-8
    result = mb.simulate(on_table(0.0), stop, interval=0.01, solver=solver, tolerance=tolerance)
    expected_up, expected_down = np.array(up)[np.array(up) < stop], np.array(down)[np.array(down) < stop]
    np.testing.assert_allclose(lifts(result, "table"), expected_up, rtol=0.0, atol=100.0 * tolerance)
    np.testing.assert_allclose(lifts(result, "table", "down"), expected_down, rtol=0.0, atol=100.0 * tolerance)
    rests = np.array([np.sum(expected_up < t) == np.sum(expected_down < t) for t in result.t])
    assert 50 < rests.sum() < 250
    force = 1.5 * (G - lift * w * w * np.sin(w * result.t))
    np.testing.assert_allclose(result["force"], np.where(rests, force, 0.0), rtol=0.0, atol=1e-6)
    assert result["gap"].min() >= -1e-14
    assert not result.warning


def stack(size: float = 1.0) -> mb.Mechanism:
    """Return a body of 2 size^3 kg above a floor, one of size^3 above the first one, and a force between them."""
    m = mb.Mechanism(gravity=(0.0, -G * size, 0.0))
    lower = m.body("lower", m.ground, mb.Translational(axis="y", start=0.2 * size, nominal=size), mass=2.0 * size**3)
    upper = m.body("upper", lower, mb.Translational(axis="y", start=0.3 * size, nominal=size), mass=size**3)
    m.force("push", mb.JointForce(mb.Input(name="push", unit="N", start=0.0)), upper)
    for name, body in (("floor", lower), ("top", upper)):
        m.event(name, body.coordinate(), direction="down", then=mb.Bounce(0.5))
        m.output(name, body.coordinate())
        m.output(f"{name} force", body.effort())
    return m


@pytest.mark.parametrize(("solver", "size"), [("adams", 1.0), ("ida", 1.0), ("radau", 1e-3), ("radau", 1e3)])
def test_two_bodies_rest_on_each_other(solver: str, size: float) -> None:
    """Closed form: the force 2 t (per mass and size) between them lifts the upper one at g / 2, and then its distance
    is (t - g / 2)^3 / 3. The floor carries the weight of the lower one, and the force.
    """
    given = {"push": f"{2.0 * size**4!r} * t"}
    result = mb.simulate(stack(size), 6.0, interval=0.25, solver=solver, tolerance=1e-8, inputs=given)
    assert lifts(result, "top") == pytest.approx([G / 2.0], abs=1e-8)
    assert not lifts(result, "floor")
    late = result.t > 1.0
    t = result.t[late]
    rests = t < G / 2.0
    np.testing.assert_allclose(result["floor"][late] / size, 0.0, atol=1e-9)
    np.testing.assert_allclose(result["top"][late] / size, np.where(rests, 0.0, (t - G / 2.0) ** 3 / 3.0), atol=1e-7)
    np.testing.assert_allclose(result["top force"][late] / size**4, np.where(rests, G - 2.0 * t, 0.0), atol=1e-7)
    carried = np.where(rests, 3.0 * G, 2.0 * G + 2.0 * t)
    np.testing.assert_allclose(result["floor force"][late] / size**4, carried, rtol=1e-7)
    assert not result.failed


def test_an_impulse_on_a_resting_stack() -> None:
    """Closed form: an impulse on the lower body (2 kg) downwards is returned by the floor with e = 0.5, and the upper
    body (1 kg) goes with it. One upwards hits the upper body: momentum of 6 N s, relative rate 3 m/s before.
    """
    for push, upper, lower in ((-3.0, 0.0, 0.75), (6.0, 1.5, 1.5)):
        m = stack()
        m.event("kick", at=1.5, then=mb.Impulse(m.bodies[1], push))
        m.output("lower rate", m.bodies[1].rate())
        m.output("upper rate", m.bodies[2].rate())
        simulation = Simulation(m, Settings(solver="adams", tolerance=1e-8))
        simulation.advance(1.5)
        values = dict(zip([v.name for v in simulation.variables], simulation.outputs(), strict=True))
        assert [values["lower rate"], values["upper rate"]] == pytest.approx([lower, upper], abs=1e-12)


@pytest.mark.parametrize("solver", SMALL)
def test_a_torque_lifts_a_pendulum_off_a_wall(solver: str) -> None:
    """SciPy from event to event; the wall is left where the torque 3 sin(t) balances the weight: closed form."""
    e, tolerance = 0.3, 1e-8
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    rod = m.body("rod", m.ground, mb.Revolute(start=0.5), **mb.rod(mass=1.0, length=1.0))
    m.force("motor", mb.JointForce(mb.Input(name="torque", unit="N.m", start=0.0)), rod)
    m.event("wall", rod.angle(), crosses=-1.0, direction="down", then=mb.Bounce(e))
    m.output("angle", rod.angle())
    m.output("force", rod.effort())
    result = mb.simulate(m, 8.0, interval=0.5, solver=solver, tolerance=tolerance, inputs={"torque": "3 * sin(t)"})
    rate = lambda t, y: [y[1], 3.0 * (3.0 * np.sin(t) - 0.5 * G * np.cos(y[0]))]  # noqa: E731
    wall = lambda t, y: y[0] + 1.0  # noqa: E731
    wall.terminal, wall.direction = True, -1  # type: ignore[attr-defined]
    t, y, how = 0.0, np.array([0.5, 0.0]), {"rtol": 1e-12, "atol": 1e-13}
    hits: list[float] = []
    while not hits or len(hits) < 2 or hits[-1] - hits[-2] > 1e-4:
        found = solve_ivp(rate, (t, 8.0), y, events=wall, **how)
        t, y = found.t[-1], np.array([-1.0, -e * found.y[1, -1]])
        hits.append(t)
    impacts = lifts(result, "wall", "down")
    first = [x for x in impacts if x < 4.0]
    np.testing.assert_allclose(first[:8], hits[:8], rtol=0.0, atol=1e-6)
    leaves = np.arcsin(0.5 * G * np.cos(1.0) / 3.0) + 2.0 * np.pi
    assert lifts(result, "wall") == pytest.approx([leaves], abs=1e-8)
    rests = (result.t > 3.0) & (result.t < leaves)
    assert np.ptp(result["angle"][rests]) == 0.0
    np.testing.assert_allclose(
        result["force"][rests], 0.5 * G * np.cos(1.0) - 3.0 * np.sin(result.t[rests]), rtol=0.0, atol=1e-9
    )
    after = solve_ivp(rate, (leaves, 8.0), [-1.0, 0.0], **how).y[0, -1]
    assert result["angle"][-1] == pytest.approx(after, abs=1e-6)
    assert not result.warning


@pytest.mark.parametrize("solver", ["adams", "ida"])
def test_a_torque_reverses_at_a_fourbar_that_rests_at_a_stop(solver: str) -> None:
    """Reference: the equation of the angle of the crank, I a'' + I' a'^2 / 2 + V' = torque, by SciPy.

    The torque presses the crank against its stop at 2 rad until it has decreased to V' there.
    """
    e = 0.4
    m = fourbar(e, of_pin=False)
    m.events.pop()
    crank = m.bodies[1]
    m.force("motor", mb.JointForce(mb.Input(name="torque", unit="N.m", start=0.0)), crank)
    m.output("angle", crank.angle())
    m.output("force", crank.effort())
    torque = lambda t: 250.0 - 60.0 * t  # noqa: E731
    result = mb.simulate(m, 6.0, interval=0.05, solver=solver, tolerance=1e-9, inputs={"torque": "250 - 60 * t"})

    def slopes(angle: float) -> tuple[float, float, float]:
        (*_, i0, v0), (*_, i1, _), (*_, i2, v2) = linkage(angle - 1e-5), linkage(angle), linkage(angle + 1e-5)
        return i1, (i2 - i0) / 2e-5, (v2 - v0) / 2e-5

    def rate(t: float, y: Any) -> list[float]:
        inertia, growth, weight = slopes(y[0])
        return [y[1], (torque(t) - weight - 0.5 * growth * y[1] ** 2) / inertia]

    stop = lambda t, y: y[0] - 2.0  # noqa: E731
    stop.terminal, stop.direction = True, 1  # type: ignore[attr-defined]
    how: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-11}
    first = solve_ivp(rate, (0.0, 6.0), [0.5, 8.0], events=stop, **how)
    second = solve_ivp(rate, (first.t[-1], 6.0), [2.0, -e * first.y[1, -1]], events=stop, **how)
    assert lifts(result, "stop", "up")[:2] == pytest.approx([first.t[-1], second.t[-1]], abs=1e-6)
    leaves = brentq(lambda t: torque(t) - slopes(2.0)[2], 1.0, 6.0)
    assert lifts(result, "stop", "down") == pytest.approx([leaves], abs=1e-6)
    held = (result.t > 2.0) & (result.t < leaves)
    assert held.sum() > 10
    assert np.ptp(result["angle"][held]) == 0.0
    np.testing.assert_allclose(result["force"][held], slopes(2.0)[2] - torque(result.t[held]), rtol=0.0, atol=1e-4)
    after = solve_ivp(rate, (leaves, leaves + 0.3), [2.0, 0.0], dense_output=True, **how).sol
    free = (result.t > leaves) & (result.t < leaves + 0.3)
    np.testing.assert_allclose(result["angle"][free], after(result.t[free])[0], rtol=0.0, atol=1e-6)
    assert CRANK == 1.0
    assert not result.failed


@dataclass(frozen=True, kw_only=True)
class Shelf(mb.Model):
    """A ball that falls on a shelf, which can be lowered."""

    name = "ball_on_shelf"
    shelf: float = mb.parameter(0.0, unit="m", tunable=True)

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0.0, -G, 0.0))
        body = m.body("ball", m.ground, mb.Translational(axis="y", start=0.1), mass=1.0)
        m.event("shelf", body.coordinate(), crosses=self.shelf, direction="down", then=mb.Bounce(0.0))
        m.event("lower it", at=1.0, then=mb.SetParameter("shelf", -1.0))
        m.output("height", body.coordinate())
        return m


def test_a_ball_falls_off_a_shelf_that_is_lowered() -> None:
    """Closed form: it falls by 1 m."""
    result = mb.simulate(Shelf(), 2.0, interval=0.1, solver="adams", tolerance=1e-8)
    fall = np.sqrt(2.0 / G)
    assert lifts(result, "shelf") == [1.0]
    assert lifts(result, "shelf", "down") == pytest.approx([np.sqrt(0.2 / G), 1.0 + fall], abs=1e-7)
    assert result["height"][-1] == pytest.approx(-1.0, abs=1e-12)


def test_a_joint_that_rests_is_locked_and_released_by_events() -> None:
    """A lock at rest holds against a pull; after its release the ball is lifted at once."""
    m = ball(0.0, start=0.0, lift=True)
    m.event("lock", at=1.0, then=mb.Lock(m.bodies[1]))
    m.event("unlock", at=2.0, then=mb.Release(m.bodies[1]))
    result = mb.simulate(
        m, 2.5, interval=0.25, solver="adams", tolerance=1e-8, inputs={"lift": f"{2.0 * G / 1.5!r} * t"}
    )
    assert not lifts(result, "floor")
    assert np.all(result["height"][result.t <= 2.0] == 0.0)
    grown = lambda t: G / 1.5 * (t**3 / 6.0) - 0.5 * G * t * t  # noqa: E731
    slope = G / 1.5 * 2.0**2 / 2.0 - 2.0 * G
    expected = grown(2.5) - grown(2.0) - 0.5 * slope
    assert result["height"][-1] == pytest.approx(expected, abs=1e-8)


def test_a_saved_run_continues_at_rest() -> None:
    """Restored in the same simulation and in another one, bit for bit."""
    settings = Settings(solver="adams", tolerance=1e-8)
    m = on_table(0.0)
    simulation, other = Simulation(m, settings), Simulation(m, settings)
    simulation.advance(0.3)  # at rest again after the first flight
    assert simulation.events[-1].direction == "down"
    checkpoint, saved = simulation.checkpoint(), simulation.save()
    simulation.advance(1.0)
    expected, events = simulation.outputs().copy(), simulation.events
    assert len(events) > 3
    simulation.rollback(checkpoint)
    simulation.advance(1.0)
    other.restore(saved)
    other.advance(1.0)
    for again in (simulation, other):
        np.testing.assert_array_equal(again.outputs(), expected)
        assert again.events == events


@pytest.mark.parametrize("solver", ["adams", "esdirk"])
def test_many_balls_of_a_large_tree(solver: str) -> None:
    """Closed form: each falls from its own height and stays; one of them is lifted."""
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    force, starts = mb.Input(name="lift", unit="N", start=0.0), 0.1 + 0.01 * np.arange(70)
    for k, start in enumerate(starts):
        body = m.body(f"ball{k}", m.ground, mb.Translational(axis="y", start=float(start)), mass=1.0)
        if k in (3, 30, 50):
            m.event(f"floor{k}", body.coordinate(), direction="down", then=mb.Bounce(0.0))
        if k == 30:
            m.force("lift", mb.JointForce(force), body)
        m.output(f"ball{k}", body.coordinate())
        m.output(f"force{k}", body.effort())
    result = mb.simulate(m, 2.0, interval=0.1, solver=solver, tolerance=1e-7, inputs={"lift": f"{G!r} * t"})
    assert times(result, "floor50") == pytest.approx([np.sqrt(1.2 / G)], abs=1e-6)
    assert lifts(result, "floor30") == pytest.approx([1.0], abs=1e-6)
    assert abs(result["ball50"][-1]) <= 1e-9
    assert result["force50"][-1] == pytest.approx(G, rel=1e-9)
    assert result["ball30"][-1] == pytest.approx(G / 6.0, abs=1e-5)
    assert result["ball60"][-1] == pytest.approx(0.7 - 2.0 * G, abs=1e-5)
    assert not result.failed


def lying_rod(size: float, restitution: float, weights: int = 0) -> mb.Mechanism:
    """Return a rod of size^3 kg that falls on a floor with both ends; a force lifts its left end.

    There are also weights on springs.
    """
    m = mb.Mechanism(gravity=(0.0, -G * size, 0.0))
    car = m.body("car", m.ground, mb.Translational(axis="y", start=size, nominal=size))
    shape = mb.rod(mass=size**3, length=size)
    rod = m.body("rod", car, mb.Revolute(start=0.5), **shape)
    m.force("lift", mb.JointForce(mb.Input(name="lift", unit="N", start=0.0)), car)
    for name, x in (("left", 0.0), ("right", size)):
        end = rod.position("y", point=(x, 0.0, 0.0))
        m.event(name, end, direction="down", then=mb.Bounce(restitution))
        m.output(name, end)
    m.output("angle", rod.angle())
    for k in range(weights):
        joint = mb.Translational(axis="x", start=0.1 * size, nominal=size)
        weight = m.body(f"weight{k}", m.ground, joint, mass=size**3)
        m.force(f"spring{k}", mb.JointSpring(stiffness=(1.0 + 0.1 * k) * size**3), weight)
    return m


@pytest.mark.parametrize(
    ("solver", "size", "weights"),
    [
        *[("adams", 1e-3, 0), ("adams", 1.0, 0), ("ida", 1.0, 0), ("radau", 1e3, 0)],
        *[("adams", 1e-3, 66), ("hybrid", 1e3, 66), ("ida", 1.0, 66)],
    ],
)
def test_one_end_of_a_rod_is_lifted(solver: str, size: float, weights: int) -> None:
    """Closed form: the force t size^4 lifts the left end at g / 2. SciPy: the angle turns about the other end, which
    slides: a'' = 3 cos(a) (g / 2 - t).
    """
    given = {"lift": f"{size**4!r} * t"}
    result = mb.simulate(lying_rod(size, 0.5, weights), 6.0, interval=0.25, solver=solver, tolerance=1e-8, inputs=given)
    assert lifts(result, "left") == pytest.approx([G / 2.0], abs=1e-7)
    assert not lifts(result, "right")
    late = result.t > 2.0
    np.testing.assert_allclose(result["right"][late] / size, 0.0, atol=1e-9)
    slope = lambda t, y: [y[1], 3.0 * np.cos(y[0]) * (G / 2.0 - t)]  # noqa: E731
    found = solve_ivp(slope, (G / 2.0, 6.0), [0.0, 0.0], rtol=1e-11, atol=1e-13, dense_output=True)
    free = result.t > G / 2.0
    np.testing.assert_allclose(result["angle"][late & ~free], 0.0, atol=1e-9)
    np.testing.assert_allclose(result["angle"][free], found.sol(result.t[free])[0], rtol=0.0, atol=1e-6)
    assert not result.warning
    assert not result.failed


@pytest.mark.parametrize("solver", ["adams", "radau"])
def test_a_block_whose_stop_moves(solver: str) -> None:
    """The same motion as with the coordinate relative to the table, whose times are compared with closed forms above:
    here the joint of the block is to the ground, and the sensor is the position relative to the table.
    """
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    drive = mb.Harmonic(amplitude=0.05, frequency=3.0)
    table = m.body("table", m.ground, mb.Translational(axis="y", drive=drive), mass=1.0)
    speed = 0.05 * 6.0 * np.pi
    block = m.body("block", m.ground, mb.Translational(axis="y", rate=speed), mass=1.5)
    m.event("table", m.relative_position(block, table, "y"), direction="down", then=mb.Bounce(0.0))
    m.output("gap", m.relative_position(block, table, "y"))
    moving = mb.simulate(m, 1.0, interval=0.02, solver=solver, tolerance=1e-8)
    relative = mb.simulate(on_table(0.0), 1.0, interval=0.02, solver=solver, tolerance=1e-8)
    assert [(e.name, e.direction) for e in moving.events] == [(e.name, e.direction) for e in relative.events]
    np.testing.assert_allclose([e.time for e in moving.events], [e.time for e in relative.events], atol=1e-6)
    np.testing.assert_allclose(moving["gap"], relative["gap"], rtol=0.0, atol=1e-6)
    assert len(moving.events) >= 5


@pytest.mark.parametrize("solver", SMALL)
def test_a_rope_goes_slack_and_tightens(solver: str) -> None:
    """Closed form: a mass on a rope of 1 m is pushed with v at the lowest point. The rope is slack from the angle on at
    which v^2 / g = 2 - 3 cos; then the mass follows a parabola until its distance is 1 m again. The angle over time is
    that of a pendulum, by SciPy.
    """
    v = np.sqrt(3.5 * G)
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    across = m.body("across", m.ground, mb.Translational(axis="x", rate=v))
    mass = m.body("mass", across, mb.Translational(axis="y", start=-1.0), mass=2.0)
    m.event("rope", m.distance(m.ground, mass), crosses=1.0, direction="up", then=mb.Bounce(0.0))
    m.output("x", across.coordinate())
    m.output("y", mass.coordinate())
    result = mb.simulate(m, 1.6, interval=0.02, solver=solver, tolerance=1e-9)
    swing = lambda t, y: [y[1], -G * np.sin(y[0])]  # noqa: E731
    slack = lambda t, y: np.cos(y[0]) + 0.5  # noqa: E731
    slack.terminal = True  # type: ignore[attr-defined]
    first = solve_ivp(swing, (0.0, 2.0), [0.0, v], events=slack, rtol=1e-12, atol=1e-13, dense_output=True)
    leaves, (angle, rate) = first.t[-1], first.y[:, -1]
    place, speed = np.array([np.sin(angle), -np.cos(angle)]), rate * np.array([np.cos(angle), np.sin(angle)])
    fall = lambda t: place + speed * t + np.array([0.0, -0.5 * G]) * t * t  # noqa: E731
    tight = brentq(lambda t: np.linalg.norm(fall(t)) - 1.0, 0.1, 1.5, xtol=1e-14)
    assert lifts(result, "rope", "down")[0] == pytest.approx(leaves, abs=1e-6)
    assert lifts(result, "rope", "up")[0] == pytest.approx(leaves + tight, abs=1e-6)
    places = np.column_stack((result["x"], result["y"]))
    taut = result.t < leaves
    angles = first.sol(result.t[taut])[0]
    np.testing.assert_allclose(places[taut], np.column_stack((np.sin(angles), -np.cos(angles))), rtol=0.0, atol=1e-6)
    flying = (result.t > leaves) & (result.t < leaves + tight)
    np.testing.assert_allclose(places[flying], [fall(t - leaves) for t in result.t[flying]], rtol=0.0, atol=1e-6)
    end, last = fall(tight), speed + np.array([0.0, -G]) * tight
    along = np.array([-end[1], end[0]])  # the impact takes the radial velocity
    after = solve_ivp(
        swing, (leaves + tight, 1.6), [np.arctan2(end[0], -end[1]), along @ last], rtol=1e-11, atol=1e-12
    ).y[0, -1]
    np.testing.assert_allclose(places[-1], [np.sin(after), -np.cos(after)], rtol=0.0, atol=1e-5)
    assert not result.warning


def test_a_saved_run_continues_on_two_points() -> None:
    """Restored in the same simulation and in another one while both ends of the rod rest."""
    settings = Settings(solver="adams", tolerance=1e-8)
    simulation, other = (Simulation(lying_rod(1.0, 0.0), settings, inputs={"lift": 3.0}) for _ in range(2))
    simulation.advance(2.0)
    checkpoint, saved = simulation.checkpoint(), simulation.save()

    def lift(one: Simulation) -> Any:
        one.set_input("lift", 6.0)
        one.advance(2.3)
        return one.outputs().copy(), one.events

    expected, events = lift(simulation)
    assert events[-1].direction == "up"
    assert events[-1].time == 2.0
    simulation.rollback(checkpoint)
    other.restore(saved)
    for one in (simulation, other):
        found, also = lift(one)
        np.testing.assert_array_equal(found, expected)
        assert also == events


def test_stops_that_cannot_hold_end_the_run() -> None:
    """The sum of angles of a chain, and positions in large models with esdirk."""
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    rod = m.body("rod", m.ground, mb.Revolute(), **mb.rod(mass=1.0, length=1.0))
    m.event("wall", m.turn(rod), crosses=-1.0, direction="down", then=mb.Bounce(0.2))
    result = mb.simulate(m, 5.0, interval=1.0, solver="adams", tolerance=1e-7)
    assert "[resting-bounce]" in result.failure
    large = mb.Mechanism(gravity=(0.0, -G, 0.0))
    for k in range(70):
        body = large.body(f"ball{k}", large.ground, mb.Translational(axis="y", start=0.1), mass=1.0)
    large.event("floor", body.position("y"), direction="down", then=mb.Bounce(0.2))
    result = mb.simulate(large, 5.0, interval=1.0, solver="esdirk", tolerance=1e-7)
    assert "[resting-bounce]" in result.failure


def test_a_sampled_force_lifts_a_ball_at_its_sample() -> None:
    """Closed form: the force is constant between samples, and first exceeds the weight at a sample."""
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    body = m.body("ball", m.ground, mb.Translational(axis="y"), mass=2.0)
    force = m.sample_hold("force", mb.Harmonic(amplitude=30.0, frequency=1.1), period=0.1)
    m.force("lift", mb.JointForce("u", uses={"u": force}), body)
    m.event("floor", body.coordinate(), direction="down", then=mb.Bounce(0.0))
    m.output("height", body.coordinate())
    result = mb.simulate(m, 1.5, interval=0.05, solver="ida", tolerance=1e-6)
    found = [30.0 * np.sin(2.0 * np.pi * 1.1 * 0.1 * k) / 2.0 - G for k in range(16)]
    first = next(k for k, a in enumerate(found) if a > 0.0)
    assert lifts(result, "floor")[0] == pytest.approx(0.1 * first, abs=1e-12)
    assert result["height"][2 * first + 2] == pytest.approx(found[first] * 0.1**2 / 2.0, abs=1e-8)
    assert not result.failed


def test_no_lowest_point_without_three_times() -> None:
    """The parabola through three points of different times has one; steps as long as the spacing of times have not."""
    assert lowest_time(0.0, 1.0, 1.0, 0.0, 2.0, 1.5) == pytest.approx(0.9)
    assert np.isnan(lowest_time(0.0, 1.0, 0.0, 1.0, 1.0, 2.0))
    assert np.isnan(lowest_time(0.0, 1.0, 1.0, 0.0, 1.0, 0.0))


@pytest.mark.parametrize("solver", ["adams", "ida"])
@pytest.mark.parametrize("impulse", [1e155, 1e200, 1e307])
def test_an_impulse_whose_energy_overflows_ends_the_run(solver: str, impulse: float) -> None:
    """Its square is no number; the impulse is not ignored."""
    m = mb.Mechanism()
    body = m.body("ball", m.ground, mb.Translational(axis="y"), mass=1.0)
    m.event("kick", at=0.5, then=mb.Impulse(body, impulse))
    m.output("height", body.coordinate())
    assert mb.simulate(m, 1.0, interval=0.1, solver=solver).failed

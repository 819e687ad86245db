"""Stops that are hit: bounces of single bodies, of mechanisms with loops, of several stops at once, and their end."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

import mbfmu as mb
from mbfmu.mechanics.recursions.dynamics import watch_sensors
from mbfmu.modeling.settings import Settings
from mbfmu.session.impulses import solve_complementarity
from mbfmu.session.simulation import Simulation
from mbfmu.util.errors import UserError

from .test_events import SMALL, G, Midpoint, times


def ball(restitution: float, start: float = 1.0, rate: float = 0.0) -> mb.Mechanism:
    """Return a ball that falls to a floor."""
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    body = m.body("ball", m.ground, mb.Translational(axis="y", start=start, rate=rate), mass=2.0)
    m.event("floor", body.coordinate(), direction="down", then=mb.Bounce(restitution))
    m.output("height", body.coordinate())
    m.output("rate", body.rate())
    return m


@pytest.mark.parametrize(("solver", "tolerance"), [*((solver, 1e-7) for solver in SMALL), (Midpoint, 1e-4)])
def test_times_and_heights_of_a_ball(solver, tolerance: float):
    """Closed form: falls from 1 m; the n-th flight takes e^n times twice the time of the fall and rises to e^2n m."""
    e = 0.8
    m = ball(e)
    result = mb.simulate(m, 3.0, interval=0.5, solver=solver, tolerance=tolerance)
    fall = np.sqrt(2.0 / G)
    flights = np.concatenate(([fall], 2.0 * fall * e ** np.arange(1, 20)))
    expected = np.cumsum(flights)
    expected = expected[expected < 3.0]
    assert len(expected) == 6
    np.testing.assert_allclose(times(result, "floor"), expected, rtol=0.0, atol=20.0 * tolerance)
    assert {event.direction for event in result.events if event.name == "floor"} == {"down"}
    assert all(0.0 <= event.value <= 1e-3 * tolerance for event in result.events if event.name == "floor")
    assert result["height"].min() >= 0.0
    last, rate = expected[-1], np.sqrt(2.0 * G) * e ** len(expected)
    assert result["rate"][-1] == pytest.approx(rate - G * (3.0 - last), abs=200.0 * tolerance)
    assert not result.warning
    assert not result.failed


def test_a_ball_that_is_thrown_from_the_floor_bounces():
    """Closed form: it lands after 2 v / g."""
    result = mb.simulate(ball(1.0, start=0.0, rate=1.0), 1.0, solver="adams", tolerance=1e-8)
    assert times(result, "floor") == pytest.approx(2.0 / G * np.arange(1, 5), abs=1e-7)


def fallen_rod(angle: float, size: float, restitution: float) -> mb.Mechanism:
    """Return a rod of mass 3 size^3 that falls on its ends from 1 size, until one hits the floor."""
    mass, inertia = 3.0 * size**3, 0.25 * size**5
    m = mb.Mechanism(gravity=(0.0, -G * size, 0.0))
    joint = mb.Planar(start=(0.0, size * (0.5 * np.sin(angle) + 1.0), angle))
    rod = m.body("rod", m.ground, joint, mass=mass, inertia=(inertia, inertia, inertia))
    for name, x in (("left", -0.5), ("right", 0.5)):
        end = rod.position("y", point=(x * size, 0.0, 0.0))
        m.event(name, end, direction="down", then=[mb.Bounce(restitution), mb.EndRun()])
    m.output("rate", rod.rate(1))
    m.output("turning", rod.rate(2))
    return m


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e4])
def test_an_inclined_rod_hits_the_floor_with_one_end(size: float):
    """Closed form: at x from the center of mass the impulse is p = (1 + e) v / (1 / m + x^2 / I)."""
    simulation = Simulation(fallen_rod(0.5, size, 0.6), Settings(solver="adams", tolerance=1e-8))
    simulation.advance(1.0)
    speed, x, inertia = size * np.sqrt(2.0 * G), -0.5 * size * np.cos(0.5), size**2 / 12.0
    p = 1.6 * speed / (1.0 + x**2 / inertia)  # per mass
    assert [event.name for event in simulation.events] == ["left"]
    assert simulation.t == pytest.approx(np.sqrt(2.0 / G), abs=1e-8)
    np.testing.assert_allclose(simulation.outputs()[:2], [p - speed, x * p / inertia], rtol=1e-7)


def test_a_rod_hits_the_floor_with_both_ends():
    """Closed form: it rebounds without turning, with e v."""
    simulation = Simulation(fallen_rod(0.0, 1.0, 0.6), Settings(solver="adams", tolerance=1e-8))
    simulation.advance(1.0)
    assert [event.name for event in simulation.events] == ["left", "right"]
    np.testing.assert_allclose(simulation.outputs()[:2], [0.6 * np.sqrt(2.0 * G), 0.0], rtol=1e-7, atol=1e-12)


def test_impulses_of_several_stops():
    """A stop that others push away from has no impulse; equal stops share theirs."""
    A = np.array([[2.0, -1.5], [-1.5, 2.0]])
    np.testing.assert_allclose(solve_complementarity(A, np.array([1.0, 2.0])), np.linalg.solve(A, [1.0, 2.0]))
    np.testing.assert_allclose(
        solve_complementarity(-0.75 * A + 3.5 * np.eye(2), np.array([2.0, 0.5])), [1.0, 0.0], rtol=1e-14
    )
    p = solve_complementarity(np.ones((2, 2)), np.array([1.0, 1.0]))
    assert p is not None
    assert p.sum() == pytest.approx(1.0)
    assert p.min() >= 0.0


@pytest.mark.parametrize("spread", [0.0, 3.0, 6.0, 9.0])
@pytest.mark.parametrize("difference", [1.0, 1e-2, 1e-5])
def test_impulses_of_stops_on_masses_of_any_ratio(spread: float, difference: float):
    """The conditions of the problem hold; masses differ by powers of ten, and two stops have nearly one direction."""
    generator = np.random.default_rng(5)
    for count in (2, 3, 4):
        G = generator.normal(size=(count, 4))
        G[1] = G[0] + difference * generator.normal(size=4)
        A = (G / 10.0 ** generator.uniform(-0.5 * spread, 0.5 * spread, 4)) @ G.T
        b = A @ generator.uniform(0.1, 1.0, count) * generator.uniform(1.0, 2.0, count)
        p = solve_complementarity(A, b)
        assert p is not None
        assert p.min() >= 0.0
        excess, unit = A @ p - b, np.abs(b).max()
        assert excess.min() >= -1e-8 * unit
        assert np.abs(p * excess).max() <= 1e-8 * p.max() * unit


def test_stops_that_contradict_each_other():
    """A body between two stops that close cannot leave both; nor can one that a stop of its drive moves."""
    assert solve_complementarity(np.array([[1.0, -1.0], [-1.0, 1.0]]), np.array([1.0, 0.5])) is None
    assert solve_complementarity(np.array([[1.0, 0.0], [0.0, 0.0]]), np.array([1.0, 0.5])) is None
    np.testing.assert_array_equal(solve_complementarity(np.eye(2), np.array([-1.0, 0.0])), np.zeros(2))


@pytest.mark.parametrize("solver", SMALL)
def test_a_double_pendulum_hits_a_stop(solver: str):
    """Reference: SciPy with absolute angles. The angle of the lower rod, relative to the upper one, stays above 0."""
    e, tolerance = 0.7, 1e-8
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    first = m.body("first", m.ground, mb.Revolute(start=-1.0), **mb.rod(mass=1.0, length=1.0))
    second = m.body("second", first, mb.Revolute(at=(1.0, 0.0, 0.0), start=0.8), **mb.rod(mass=2.0, length=0.5))
    m.event("elbow", second.angle(), direction="down", then=mb.Bounce(e))
    for name, sensor in (("first", first.angle()), ("second", m.turn(second))):
        m.output(name, sensor)
    result = mb.simulate(m, 2.0, interval=0.5, solver=solver, tolerance=tolerance)
    hits, states = double_pendulum(e, result.t)
    assert len(hits) >= 3
    np.testing.assert_allclose(times(result, "elbow"), hits, rtol=0.0, atol=1e-5)
    np.testing.assert_allclose(result.values[:, :2], states, rtol=0.0, atol=1e-5)
    assert not result.warning


def double_pendulum(e: float, at: np.ndarray) -> tuple[list[float], np.ndarray]:
    """Return the times of the impacts and the absolute angles (k, 2) at times (k,) of the double pendulum."""

    def mass_matrix(a, b):  # type: ignore[no-untyped-def]
        c = 2.0 * 1.0 * 0.25 * np.cos(a - b)
        return np.array([[1.0 / 3.0 + 2.0, c], [c, 2.0 * 0.25 / 3.0]])

    def rate(t, y):  # type: ignore[no-untyped-def]
        a, b, u, w = y
        s = 0.5 * np.sin(a - b)
        forces = [-s * w * w - G * 2.5 * np.cos(a), s * u * u - G * 0.5 * np.cos(b)]
        return [u, w, *np.linalg.solve(mass_matrix(a, b), forces)]

    def elbow(t, y):  # type: ignore[no-untyped-def]
        return y[1] - y[0]

    elbow.terminal, elbow.direction = True, -1  # type: ignore[attr-defined]
    t, y, hits, pieces = 0.0, np.array([-1.0, -0.2, 0.0, 0.0]), [], []
    while t < at[-1]:
        span = {"rtol": 1e-12, "atol": 1e-12, "dense_output": True, "method": "DOP853"}
        found = solve_ivp(rate, (t, at[-1]), y, events=elbow, **span)
        pieces.append(found.sol)
        t, y = found.t[-1], found.y[:, -1]
        if found.status == 1:
            hits.append(t)
            pull = np.linalg.solve(mass_matrix(*y[:2]), [-1.0, 1.0])
            y[2:] -= (1.0 + e) * (y[3] - y[2]) / (pull[1] - pull[0]) * pull
    ends = [piece.t_max for piece in pieces]
    return hits, np.array([pieces[int(np.searchsorted(ends[:-1], x))](x)[:2] for x in at])


GROUND, CRANK, COUPLER, ROCKER = LENGTHS = 4.0, 1.0, 3.0, 2.5  # m


def linkage(angle: float) -> tuple[float, float, float, float]:
    """Return the absolute angles of coupler and rocker at an angle of the crank, and inertia and potential of it."""
    x, y = GROUND - CRANK * np.cos(angle), -CRANK * np.sin(angle)
    apart = np.hypot(x, y)
    slope = np.arctan2(y, x) + np.arccos((COUPLER**2 + apart**2 - ROCKER**2) / (2.0 * COUPLER * apart))
    rocker = np.arctan2(COUPLER * np.sin(slope) - y, COUPLER * np.cos(slope) - x)
    J = np.array(
        [[-COUPLER * np.sin(slope), ROCKER * np.sin(rocker)], [COUPLER * np.cos(slope), -ROCKER * np.cos(rocker)]]
    )
    p, r = np.linalg.solve(J, [CRANK * np.sin(angle), -CRANK * np.cos(angle)])
    middle = CRANK**2 + 0.25 * (COUPLER * p) ** 2 + CRANK * COUPLER * p * np.cos(slope - angle)
    inertia = CRANK**2 / 3.0 + 3.0 * (middle + (COUPLER * p) ** 2 / 12.0) + 2.0 * (ROCKER * r) ** 2 / 3.0
    lift = 0.5 * CRANK * np.sin(angle) + 3.0 * (CRANK * np.sin(angle) + 0.5 * COUPLER * np.sin(slope))
    return slope, rocker, inertia, G * (lift + ROCKER * np.sin(rocker))


def fourbar(restitution: float, of_pin: bool) -> mb.Mechanism:
    """Return a four-bar linkage in the plane of gravity that hits a stop where its crank is at 2 rad."""
    slope, angle, *_ = linkage(0.5)
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    a = m.body("crank", m.ground, mb.Revolute(start=0.5, rate=8.0, fixed=True), **mb.rod(mass=1.0, length=CRANK))
    b = m.body("coupler", a, mb.Revolute(at=(CRANK, 0, 0), start=slope - 0.5), **mb.rod(mass=3.0, length=COUPLER))
    c = m.body("rocker", m.ground, mb.Revolute(at=(GROUND, 0, 0), start=angle), **mb.rod(mass=2.0, length=ROCKER))
    m.cut("pin", mb.RevoluteCutJoint(at_a=(COUPLER, 0, 0), at_b=(ROCKER, 0, 0)), b, c)
    pin = b.position("x", point=(COUPLER, 0.0, 0.0))
    sensor, value, side = (pin, GROUND + ROCKER * np.cos(linkage(2.0)[1]), "down") if of_pin else (a.angle(), 2.0, "up")
    m.event("stop", sensor, crosses=value, direction=side, then=mb.Bounce(restitution))
    m.event("back", a.angle(), crosses=1.5, direction="down", then=mb.EndRun())
    m.output("rate", a.rate())
    m.output("residual", m.velocity_residual)
    return m


@pytest.mark.parametrize("solver", SMALL)
def test_a_stop_that_is_barely_reached(solver: str):
    """Closed form: a ball is thrown to a ceiling 1 nm below its highest point; one 1 nm above it is not reached."""
    top = 12.5 / G
    for off in (-1e-9, 1e-9):
        m = ball(0.0, rate=5.0)
        m.events.clear()
        m.event("ceiling", m.bodies[1].coordinate(), crosses=1.0 + top + off, direction="up", then=mb.Bounce(1.0))
        result = mb.simulate(m, 1.0, interval=1.0, solver=solver, tolerance=1e-10)
        hits = [5.0 / G - np.sqrt(2e-9 / G)] if off < 0.0 else []
        np.testing.assert_allclose(times(result, "ceiling"), hits, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("solver", ["adams", "ida", Midpoint])
def test_an_arm_hits_a_thin_stop_from_both_sides(solver):
    """Closed form: its end turns with 20 rad/s and hits a stop of 0.001 m depth, 0.0022 s long, in every turn."""
    m = mb.Mechanism()
    arm = m.body("arm", m.ground, mb.Revolute(rate=20.0), **mb.rod(mass=1.0, length=1.0))
    end = arm.position("y", point=(1.0, 0.0, 0.0))
    m.event("stop", end, crosses=0.999, direction="up", then=mb.Bounce(1.0))
    m.output("rate", arm.rate())
    result = mb.simulate(m, 1.2, interval=0.4, solver=solver, tolerance=1e-6)
    half = np.arccos(0.999)
    expected = (0.5 * np.pi - half + np.arange(4) * 2.0 * (np.pi - half)) / 20.0
    np.testing.assert_allclose(times(result, "stop"), expected[expected < 1.2], rtol=0.0, atol=1e-6)
    assert result["rate"][-1] == pytest.approx(20.0, rel=1e-6)
    assert not result.warning


@pytest.mark.parametrize(("solver", "of_pin"), [("adams", False), ("adams", True), ("ida", True)])
def test_a_fourbar_hits_a_stop(solver: str, of_pin: bool):
    """Reference: SciPy integrates the time over the angle of the crank, whose rate follows from the energy."""
    e, (*_, inertia, potential), (*_, there, above) = 0.7, linkage(0.5), linkage(2.0)

    def rate(angle: float, energy: float) -> float:
        *_, inertia, potential = linkage(angle)
        return float(np.sqrt(2.0 * (energy - potential) / inertia))

    before = 32.0 * inertia + potential
    after = above + 0.5 * there * (e * rate(2.0, before)) ** 2
    hit = quad(lambda x: 1.0 / rate(x, before), 0.5, 2.0, epsabs=1e-12)[0]
    back = quad(lambda x: 1.0 / rate(x, after), 1.5, 2.0, epsabs=1e-12)[0]
    result = mb.simulate(fourbar(e, of_pin), 2.0, interval=0.1, solver=solver, tolerance=1e-8)
    assert [event.name for event in result.events] == ["stop", "back"]
    np.testing.assert_allclose([event.time for event in result.events], [hit, hit + back], rtol=0.0, atol=1e-6)
    assert result["rate"][-1] == pytest.approx(-rate(1.5, after), rel=1e-6)
    assert result["residual"].max() <= 1e-9
    assert not result.warning


@pytest.mark.parametrize("solver", ["adams", "radau"])
def test_a_fourbar_comes_to_rest_at_a_stop(solver: str):
    """The shorter the flights, the more constant the acceleration: their ratio tends to the restitution."""
    m = fourbar(0.5, of_pin=True)
    m.events.pop()
    result = mb.simulate(m, 5.0, interval=0.5, solver=solver, tolerance=1e-10)
    assert not result.failed
    assert result["rate"][-1] == pytest.approx(0.0, abs=1e-9)
    flights = np.diff(times(result, "stop"))
    short = flights[(flights < 0.02) & (flights > 1e-4)]
    assert len(short) >= 7
    np.testing.assert_allclose(short[1:] / short[:-1], 0.5, rtol=0.0, atol=2e-3)


@pytest.mark.parametrize("solver", ["adams", "ida"])
def test_a_ball_bounces_on_a_shaken_table(solver: str):
    """Reference: SciPy finds where the parabola of the ball meets the table; the rates are relative to the table."""
    e, lift, w = 0.8, 0.05, 15.0
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    drive = mb.Harmonic(amplitude=lift, frequency=w / (2.0 * np.pi))
    table = m.body("table", m.ground, mb.Translational(axis="y", drive=drive), mass=1.0)
    body = m.body("ball", m.ground, mb.Translational(axis="y", start=0.5), mass=1.0)
    m.event("table", m.relative_position(body, table, "y"), direction="down", then=mb.Bounce(e))
    m.output("rate", body.rate())
    result = mb.simulate(m, 1.5, interval=0.5, solver=solver, tolerance=1e-8)

    def gap(t, y):  # type: ignore[no-untyped-def]
        return y[0] - lift * np.sin(w * t)

    gap.terminal, gap.direction = True, -1  # type: ignore[attr-defined]
    t, y, hits = 0.0, np.array([0.5, 0.0]), []
    while t < 1.5:
        how = {"rtol": 1e-12, "atol": 1e-12, "max_step": 0.01}
        found = solve_ivp(lambda t, y: [y[1], -G], (t, 1.5), y, events=gap, **how)
        t, y = found.t[-1], found.y[:, -1]
        if found.status == 1:
            hits.append(t)
            moving = lift * w * np.cos(w * t)
            y[1] = moving - e * (y[1] - moving)
    assert len(hits) >= 3
    np.testing.assert_allclose(times(result, "table"), hits, rtol=0.0, atol=1e-6)
    assert result["rate"][-1] == pytest.approx(y[1], abs=1e-5)
    assert not result.warning


@pytest.mark.parametrize("others", [0, 1])
def test_what_drives_prescribe_does_not_bounce(others: int) -> None:
    m = mb.Mechanism()
    if others:
        m.body("free", m.ground, mb.Translational(axis="x"), mass=1.0)
    body = m.body(
        "driven", m.ground, mb.Translational(axis="x", drive=mb.Harmonic(amplitude=1.0, frequency=1.0)), mass=1.0
    )
    m.event("stop", body.position("x"), crosses=0.5, direction="up", then=mb.Bounce(0.5))
    m.output("x", body.position("x"))
    result = mb.simulate(m, 2.0, solver="adams")
    assert "prescribed-bounce" in result.failure
    assert result.t[-1] <= 1.0 / 12.0


def test_a_start_beyond_a_stop_is_refused():
    with pytest.raises(UserError, match=r"sensor of event 'floor' is -0.01 at the start; allowed: at least 0"):
        mb.simulate(ball(0.5, start=-0.01), 1.0, solver="adams")
    assert not mb.simulate(ball(0.5, start=-1e-15, rate=1.0), 0.1, solver="adams").failed


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"direction": "both"}, "allowed with a Bounce: 'up', a stop above"),
        ({"then": mb.Bounce(1.5)}, "restitution in event 'e' is 1.5; allowed: 0 to 1"),
        ({"then": mb.Bounce(np.nan)}, "restitution in event 'e' is nan"),
        ({"sensor": "rate"}, "has a Bounce and a sensor of class Rate"),
        ({"sensor": "quaternion"}, "has a Bounce and a sensor of class Coordinate"),
        ({"sensor": None, "at": 1.0}, "has a Bounce and no sensor"),
    ],
)
def test_what_cannot_bounce_is_refused(change: dict, text: str):
    m = mb.Mechanism()
    body = m.body("body", m.ground, mb.Floating(), mass=1.0, inertia=(1.0, 1.0, 1.0))
    sensors = {"rate": body.rate(), "quaternion": body.coordinate(4), "position": body.coordinate(2), None: None}
    given = {"sensor": "position", "direction": "up", "then": mb.Bounce(1.0)} | change
    with pytest.raises(UserError, match=text):
        m.event("e", sensors[given.pop("sensor")], **given)


def test_rates_of_sensors_are_their_derivatives():
    """Reference: central differences along the motion."""
    m = mb.Mechanism()
    a = m.body("a", m.ground, mb.Floating(start=(0.3, 0.2, 0.5, 0.8, 0.0, 0.6, 0.0)), mass=1.0, inertia=(1.0, 2.0, 3.0))
    b = m.body("b", a, mb.Cylindrical(at=(0.1, 0.2, 0.3), start=(0.2, 0.7)), mass=1.0, inertia=(1.0, 2.0, 3.0))
    c = m.body("c", m.ground, mb.Revolute(at=(1.0, 0.0, 0.0), start=0.4), **mb.rod(mass=1.0, length=1.0))
    between = {"at_a": (0.1, 0.2, 0.3), "at_b": (0.4, 0.1, 0.2)}
    sensors = [
        *(a.coordinate(k) for k in range(3)), *(b.coordinate(k) for k in range(2)), c.angle(), m.turn(c),
        *(b.position(axis, point=(0.1, 0.3, 0.2)) for axis in "xyz"), m.distance(b, c, **between),
        *(m.relative_position(c, b, axis, **between) for axis in "xyz"),
    ]  # fmt: skip
    for k, sensor in enumerate(sensors):
        m.event(f"e{k}", sensor, crosses=-99.0, direction="down", then=mb.Bounce(0.5))
    compiled = mb.mechanics.CompiledMechanism(m)
    q, _ = compiled.assemble()
    v, h = np.linspace(0.3, 1.1, compiled.system.n), 1e-3

    def values(parts: np.ndarray, q: np.ndarray) -> np.ndarray:
        found = np.zeros(len(parts))
        watch_sensors(0.0, q, v, parts, compiled.system.pinned_data, found)
        return found

    def at(part: float) -> np.ndarray:
        moved = q.copy()
        compiled.system.apply(moved, part * h * v)
        return values(compiled.watched, moved)

    difference = (8.0 * (at(1.0) - at(-1.0)) - (at(2.0) - at(-2.0))) / (12.0 * h)
    np.testing.assert_allclose(values(compiled.watched_rates, q), difference, rtol=1e-9, atol=1e-10)

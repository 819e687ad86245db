"""Events: crossings are located to the tolerance by every solver, listed, and followed by their actions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ellipk, ellipkinc

import mbfmu as mb
from mbfmu.modeling.settings import Settings
from mbfmu.session.result import Result
from mbfmu.session.simulation import Simulation
from mbfmu.util.errors import UserError
from solvers import OneStepSolver

SMALL = ["adams", "hybrid", "ida", "radau"]
G = 9.81


class Midpoint(OneStepSolver):
    """The explicit midpoint rule: a user-defined solver without dense output."""

    order = 2

    def step(self, f, t, y, h):  # type: ignore[no-untyped-def]
        return y + h * f(t + h / 2, y + h / 2 * f(t, y))


def ball(rate: float = 5.0, start: float = 0.0) -> tuple[mb.Mechanism, mb.mechanics.Body]:
    """Return a ball that is thrown upward, which moves along y."""
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    body = m.body("ball", m.ground, mb.Translational(axis="y", start=start, rate=rate), mass=1.0)
    m.output("height", body.coordinate())
    m.output("rate", body.rate())
    return m, body


def sled(force: mb.Input, rate: float = 0.0) -> tuple[mb.Mechanism, mb.mechanics.Body]:
    """Return a mass of 1 kg that is pushed along x by an input."""
    m = mb.Mechanism()
    body = m.body("sled", m.ground, mb.Translational(axis="x", rate=rate), mass=1.0)
    m.force("push", mb.JointForce(force), body)
    m.output("x", body.coordinate())
    m.output("rate", body.rate())
    return m, body


def times(result: Result, name: str) -> list[float]:
    return [event.time for event in result.events if event.name == name]


@pytest.mark.parametrize(
    ("solver", "tolerance"), [*((solver, 10.0**-k) for solver in SMALL for k in (4, 7, 10)), (Midpoint, 1e-4)]
)
def test_a_thrown_ball(solver, tolerance: float):
    """Closed form: y = 5 t - g t^2 / 2. Several events are in one step, one of a given time among them."""
    m, body = ball()
    m.event("land", body.coordinate(), direction="down", then=mb.EndRun())
    m.event("top", body.rate())
    m.event("level", body.coordinate(), crosses=1.0)
    m.event("rising", body.coordinate(), crosses=1.0, direction="up")
    m.event("clock", at=0.1)
    result = mb.simulate(m, 3.0, interval=0.4, solver=solver, tolerance=tolerance)
    root = np.sqrt(25.0 - 2.0 * G)
    expected = {
        "clock": [0.1], "level": [(5.0 - root) / G, (5.0 + root) / G], "rising": [(5.0 - root) / G], "top": [5.0 / G],
        "land": [10.0 / G],
    }  # fmt: skip
    for name, at in expected.items():
        np.testing.assert_allclose(times(result, name), at, rtol=0.0, atol=tolerance)
    assert [event.time for event in result.events] == sorted(event.time for event in result.events)
    assert result.t[-1] == times(result, "land")[0]
    assert not result.failed
    assert abs(result["height"][-1]) <= 5.0 * tolerance
    levels = [event for event in result.events if event.name == "level"]
    assert [event.direction for event in levels] == ["up", "down"]
    assert [event.value for event in levels] == pytest.approx([1.0, 1.0], abs=5.0 * tolerance)


@pytest.mark.parametrize("solver", SMALL)
def test_a_pendulum_passes_the_vertical(solver: str):
    """Closed form: a pendulum of 1 m released at 2 rad passes the vertical at odd multiples of a quarter period."""
    tolerance, amplitude = 1e-7, 2.0
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    bob = m.body("bob", m.ground, mb.Revolute(start=amplitude - np.pi / 2), mass=1.0, com=(1.0, 0.0, 0.0))
    m.event("vertical", bob.angle(), crosses=-np.pi / 2)
    m.event("half", bob.angle(), crosses=amplitude / 2 - np.pi / 2, direction="down")
    m.output("angle", bob.angle())
    result = mb.simulate(m, 4.0, interval=1.0, solver=solver, tolerance=tolerance)
    modulus = np.sin(amplitude / 2) ** 2
    quarter = ellipk(modulus) / np.sqrt(G)
    found = times(result, "vertical")
    np.testing.assert_allclose(found, quarter * np.arange(1, 2 * len(found), 2), rtol=0.0, atol=300.0 * tolerance)
    assert len(found) == int((4.0 / quarter + 1.0) / 2.0)
    part = ellipkinc(np.arcsin(np.sin(amplitude / 4) / np.sin(amplitude / 2)), modulus) / np.sqrt(G)
    assert times(result, "half")[0] == pytest.approx(quarter - part, abs=30.0 * tolerance)


@pytest.mark.parametrize("solver", SMALL)
def test_a_parallelogram_passes_the_vertical(solver: str):
    """Closed form: two massless cranks of 1 m and a coupler that only translates are a pendulum."""
    tolerance, amplitude = 1e-7, 1.0
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    angle = amplitude - np.pi / 2
    crank = m.body("crank", m.ground, mb.Revolute(start=angle, fixed=True))
    coupler = m.body("coupler", crank, mb.Revolute(at=(1.0, 0.0, 0.0), start=-angle), **mb.rod(mass=1.0, length=2.0))
    rocker = m.body("rocker", coupler, mb.Revolute(at=(2.0, 0.0, 0.0), start=angle))
    m.cut("pivot", mb.RevoluteCutJoint(at_a=(-1.0, 0.0, 0.0), at_b=(2.0, 0.0, 0.0)), rocker, m.ground)
    m.event("vertical", crank.angle(), crosses=-np.pi / 2, direction="down", then=mb.EndRun())
    m.output("angle", crank.angle())
    result = mb.simulate(m, 2.0, interval=0.1, solver=solver, tolerance=tolerance)
    assert result.t[-1] == pytest.approx(ellipk(np.sin(amplitude / 2) ** 2) / np.sqrt(G), abs=30.0 * tolerance)


@pytest.mark.parametrize("solver", ["adams", "esdirk", "ida"])
def test_one_of_many_masses_passes_a_mark(solver: str):
    """Closed form: the last of 130 masses is pushed with 1 N and passes 0.5 m after 1 s."""
    m = mb.Mechanism()
    bodies = [m.body(f"b{k}", m.ground, mb.Translational(axis="x"), mass=1.0) for k in range(130)]
    m.force("push", mb.JointForce(mb.Step(height=1.0)), bodies[-1])
    m.event("mark", bodies[-1].coordinate(), crosses=0.5)
    m.output("x", bodies[-1].coordinate())
    result = mb.simulate(m, 2.0, interval=0.5, solver=solver, tolerance=1e-6)
    np.testing.assert_allclose(times(result, "mark"), [1.0], rtol=0.0, atol=3e-5)


@pytest.mark.parametrize("solver", SMALL)
def test_what_is_barely_crossed_within_a_step_is_found(solver: str):
    """The ball is above a mark for 28 microseconds; another mark 1 nm above its highest point is not reached."""
    m, body = ball()
    top = 25.0 / (2.0 * G)
    m.event("below", body.coordinate(), crosses=top - 1e-9)
    m.event("above", body.coordinate(), crosses=top + 1e-9)
    result = mb.simulate(m, 1.0, interval=1.0, solver=solver, tolerance=1e-10)
    apart = np.sqrt(2e-9 / G)
    np.testing.assert_allclose(times(result, "below"), [5.0 / G - apart, 5.0 / G + apart], rtol=0.0, atol=1e-6)
    assert not times(result, "above")


def test_a_value_at_the_start_is_not_crossed():
    m, body = ball()
    m.event("up", body.coordinate(), direction="up")
    m.event("zero", body.coordinate())
    result = mb.simulate(m, 2.0, interval=0.5, solver="adams", tolerance=1e-8)
    assert not times(result, "up")
    np.testing.assert_allclose(times(result, "zero"), [10.0 / G], rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("within", [None, 0.01])
@pytest.mark.parametrize("solver", ["adams", "ida", Midpoint])
def test_a_mark_on_a_wheel_is_counted(solver, within: float | None):
    """The wheel turns at constant speed, which solvers integrate in long steps, of more than a turn.

    The mark passes a height of 0.99 m twice in each turn, 0.014 s apart.
    """
    m = mb.Mechanism()
    wheel = m.body("wheel", m.ground, mb.Revolute(rate=20.0), mass=1.0, inertia=(1.0, 1.0, 1.0))
    m.event("mark", wheel.position("y", point=(1.0, 0.0, 0.0)), crosses=0.99, within=within)
    m.output("angle", wheel.angle())
    result = mb.simulate(m, 5.0, interval=5.0, solver=solver, tolerance=1e-6)
    half = np.arccos(0.99)
    tops = np.pi / 2 + 2.0 * np.pi * np.arange(16)
    expected = np.sort(np.concatenate((tops - half, tops + half))) / 20.0
    np.testing.assert_allclose(times(result, "mark"), expected[expected < 5.0], rtol=0.0, atol=1e-5)


@pytest.mark.parametrize("solver", [*SMALL, Midpoint])
def test_an_input_is_set_where_a_mark_is_passed(solver):
    """Closed form: 1 N pushes the sled for 0.5 m, then -2 N brake it, until it stands at 1.5 s and 0.75 m."""
    force = mb.Input(name="force", unit="N", start=1.0)
    m, body = sled(force)
    m.event("mark", body.coordinate(), crosses=0.5, direction="up", then=mb.SetInput("force", -2.0))
    m.event("stop", body.rate(), direction="down", then=[mb.SetInput("force", 0.0), mb.EndRun()])
    result = mb.simulate(m, 5.0, interval=1.0, solver=solver, tolerance=1e-6)
    assert [event.name for event in result.events] == ["mark", "stop"]
    assert [event.time for event in result.events] == pytest.approx([1.0, 1.5], abs=3e-5)
    assert result["x"][-1] == pytest.approx(0.75, abs=3e-5)
    assert result.t[-1] == result.events[-1].time
    assert not result.warning


def test_a_relay_holds_a_sled_between_two_marks():
    """Closed form: with 1 N and -1 N by turns, set where the rate is 1 m/s and -1 m/s, the period is 4 s."""
    force = mb.Input(name="force", unit="N", start=1.0)
    m, body = sled(force)
    m.event("fast", body.rate(), crosses=1.0, direction="up", then=mb.SetInput("force", -1.0))
    m.event("back", body.rate(), crosses=-1.0, direction="down", then=mb.SetInput("force", 1.0))
    result = mb.simulate(m, 20.0, interval=0.7, solver="adams", tolerance=1e-8)
    np.testing.assert_allclose([event.time for event in result.events], np.arange(1.0, 20.0, 2.0), rtol=0.0, atol=1e-6)
    assert not result.warning


def test_a_relay_without_hysteresis_stops_the_run():
    force = mb.Input(name="force", unit="N", start=1.0)
    m, body = sled(force, rate=-1.0)
    m.event("forward", body.rate(), direction="up", then=mb.SetInput("force", -1.0))
    m.event("backward", body.rate(), direction="down", then=mb.SetInput("force", 1.0))
    result = mb.simulate(m, 3.0, interval=0.5, solver="adams", tolerance=1e-6)
    assert result.failed
    assert "too-many-events" in result.failure
    assert "'forward'" in result.failure
    assert result.t[-1] == 1.0


def test_a_state_reaches_a_value():
    """Closed form: z' = -z falls to one half after ln 2."""
    m = mb.Mechanism()
    m.body("sled", m.ground, mb.Translational(axis="x"), mass=1.0)
    z = m.state("z", "-z", start=1.0)
    m.output("z", z.value())
    m.event("half", z.value(), crosses=0.5, direction="down")
    result = mb.simulate(m, 1.0, interval=0.5, solver="adams", tolerance=1e-8)
    np.testing.assert_allclose(times(result, "half"), [np.log(2.0)], rtol=0.0, atol=1e-7)


@pytest.mark.parametrize("kept", ["checkpoint", "save"])
def test_a_run_that_returns_repeats_its_events(kept: str):
    force = mb.Input(name="force", unit="N", start=1.0)
    m, body = sled(force)
    m.event("mark", body.coordinate(), crosses=0.5, direction="up", then=mb.SetInput("force", -2.0))
    m.event("clock", at=0.25)
    simulation = Simulation(m, Settings(solver="adams", tolerance=1e-6))
    simulation.advance(0.5)
    state = simulation.checkpoint() if kept == "checkpoint" else simulation.save()
    simulation.advance(1.2)
    found, reached = simulation.events, simulation.outputs().copy()
    (simulation.rollback if kept == "checkpoint" else simulation.restore)(state)  # type: ignore[operator]
    assert [event.name for event in simulation.events] == ["clock"]
    simulation.advance(1.2)
    assert repr(simulation.events) == repr(found)
    assert len(found) == 2
    np.testing.assert_array_equal(simulation.outputs(), reached)


def test_a_saved_result_has_its_events(tmp_path):
    m, body = ball()
    m.event("top", body.rate())
    result = mb.simulate(m, 1.0, interval=0.5, solver="adams", tolerance=1e-6)
    result.save(tmp_path / "run.npz")
    assert Result.load(tmp_path / "run.npz").events == result.events
    assert result.events[0].name == "top"


def test_events_without_actions_do_not_change_the_motion():
    """The steps of the solver are the same with and without them."""
    rows = []
    for has_events in (False, True):
        m, body = ball()
        if has_events:
            m.event("top", body.rate())
            m.event("level", body.coordinate(), crosses=1.0)
        result = mb.simulate(m, 2.0, interval=0.3, solver="adams", tolerance=1e-6)
        rows.append((result.values, result.statistics.steps))
    np.testing.assert_array_equal(rows[0][0][:, :2], rows[1][0][:, :2])
    assert rows[0][1] == rows[1][1]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"direction": "left"}, "direction of event 'e' is 'left'; allowed: 'up', 'down', 'both'"),
        ({"direction": ["up"]}, r"direction of event 'e' is \['up'\]"),
        ({"crosses": np.nan}, "value of event 'e' is nan"),
        ({"within": 0.0}, "within of event 'e' is 0.0"),
        ({"at": 1.0}, "allowed: one of the two"),
        ({"then": "stop"}, "allowed: SetInput, SetParameter, Impulse, Bounce, Lock, Release, Restart and EndRun"),
        ({"then": mb.SetInput("force", np.inf)}, "value of input 'force' in event 'e' is inf"),
        ({"then": mb.SetInput(["force"], 1.0)}, r"name in SetInput of event 'e' is \['force'\]; allowed: a text"),
        ({"then": mb.SetParameter(["force"], 1.0)}, "name in SetParameter of event 'e'"),
        ({"sensor": 3.0}, "sensor of event 'e' is 3.0"),
        ({"sensor": None}, "is given no sensor"),
    ],
)
def test_what_is_no_event_is_refused(change: dict, text: str):
    m, body = ball()
    with pytest.raises(UserError, match=text):
        m.event("e", **({"sensor": body.rate()} | change))


@pytest.mark.parametrize("coordinate", [None, True, 1.0, "x"])
def test_a_coordinate_of_an_impulse_that_is_no_number_is_refused(coordinate: object):
    m, body = ball()
    with pytest.raises(UserError, match=r"coordinate of the impulse in event 'e' is .*; allowed: a number from 0"):
        m.event("e", at=1.0, then=mb.Impulse(body, 1.0, coordinate=coordinate))


def test_a_time_before_the_start_of_models_is_refused():
    m, _ = ball()
    with pytest.raises(UserError, match=r"time of event 'e' is -1.0; allowed: finite and not negative"):
        m.event("e", at=-1.0)


def test_an_event_at_the_start_occurs_before_the_first_output():
    """Closed form: the ball is at rest, and starts with the impulse divided by its mass."""
    m, body = ball(rate=0.0)
    m.event("throw", at=0.0, then=mb.Impulse(body, 3.0))
    result = mb.simulate(m, 0.5, interval=0.25, solver="adams", tolerance=1e-8)
    np.testing.assert_allclose(result["rate"], 3.0 - G * result.t, rtol=0.0, atol=1e-7)
    assert times(result, "throw") == [0.0]
    m, body = ball()
    m.event("no run", at=0.0, then=mb.EndRun())
    result = mb.simulate(m, 0.5, interval=0.25, solver="adams")
    assert result.t.tolist() == [0.0]


def test_events_long_before_the_next_output_are_separate():
    """The spacing of floating-point numbers at the end, 1e15 s, is larger than the time between the two events."""
    m, body = ball(rate=0.0)
    m.event("throw", at=1.0, then=mb.Impulse(body, 3.0))
    m.event("end", at=1.1, then=mb.EndRun())
    result = mb.simulate(m, 1e15, interval=1e15, solver="adams", tolerance=1e-8)
    assert (times(result, "throw"), times(result, "end")) == ([1.0], [1.1])
    assert result["rate"][-1] == pytest.approx(3.0 - G * 1.1, abs=1e-7)


def test_events_before_the_start_of_a_run_are_reported():
    m, body = ball(rate=0.0)
    m.event("throw", at=0.5, then=mb.Impulse(body, 3.0))
    m.event("throw again", at=1.0, then=mb.Impulse(body, 3.0))
    simulation = Simulation(m, Settings(solver="adams", tolerance=1e-8), 1.0)
    note = next(d for d in simulation.diagnostics if d.code == "earlier-event")
    assert "at t = 1 s do not occur: 'throw' (t = 0.5 s)" in note.text
    assert simulation.outputs()[1] == pytest.approx(3.0)


def test_a_parameter_of_a_mechanism_without_parameters_is_refused():
    m, _ = ball()
    m.event("e", at=0.5, then=mb.SetParameter("mass", 1.0))
    with pytest.raises(UserError, match="has no parameter 'mass': it has no parameters"):
        mb.simulate(m, 1.0, solver="adams")


def test_sensors_of_forces_and_unknown_inputs_are_refused():
    m, body = ball()
    with pytest.raises(UserError, match="depends on forces or accelerations"):
        m.event("e", body.acceleration())
    m.event("e", body.rate(), then=mb.SetInput("brake", 1.0))
    with pytest.raises(UserError, match="there is no input 'brake'"):
        mb.simulate(m, 1.0, solver="adams")


@pytest.mark.parametrize("solver", SMALL)
@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_an_impulse_that_turns_a_ball_back_is_one_event(size: float, solver: str) -> None:
    """Closed form: the ball rises to its mark, where it has 3/5 of its speed, and falls from there with this speed."""
    m, body = ball(rate=5.0 * size, start=-0.8 / G * size)
    m.gravity[:] = (0.0, -G * size, 0.0)
    m.event("mark", body.coordinate(), crosses=8.0 / G * size - 0.8 / G * size, then=mb.Impulse(body, -6.0 * size))
    result = mb.simulate(m, 0.6, interval=0.3, solver=solver, tolerance=1e-8)
    assert times(result, "mark") == pytest.approx([2.0 / G], abs=1e-6)
    t = 0.6 - 2.0 / G
    assert result["height"][-1] == pytest.approx((7.2 / G - 3.0 * t - 0.5 * G * t * t) * size, abs=1e-6 * size)

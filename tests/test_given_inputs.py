"""Inputs that are given for a whole run: evaluated at the solver's times, whatever the interval of the outputs."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import mbfmu as mb

Array = NDArray[np.float64]
LOAD = mb.Input(name="F", unit="N")


def slider(load: Any, omega: float = 10.0, mass: float = 1.0, others: int = 0) -> mb.Mechanism:
    """A loaded mass on a spring, and others at rest next to it."""
    m = mb.Mechanism()
    body = m.body("b", m.ground, mb.Translational(axis="x"), mass=mass)
    m.force("k", mb.JointSpring(stiffness=mass * omega**2), body)
    m.force("load", mb.JointForce(load), body)
    for k in range(others):
        m.body(f"other{k}", m.ground, mb.Translational(axis="y"), mass=mass)
    m.output("x", body.coordinate())
    m.output("a", body.acceleration())
    return m


def base(drive: Any, omega: float = 10.0) -> mb.Mechanism:
    """A mass on a spring from a driven base."""
    m = mb.Mechanism()
    moved = m.body("base", m.ground, mb.Translational(axis="x", drive=drive), mass=1.0)
    mass = m.body("mass", moved, mb.Translational(axis="x"), mass=2.0)
    m.force("k", mb.JointSpring(stiffness=2.0 * omega**2), mass)
    m.output("base", moved.coordinate())
    m.output("x", mass.position("x"))
    m.output("drive", moved.effort())
    return m


def forced(t: Array, omega: float, w: float, amplitude: float = 1.0) -> Array:
    """Return x of x'' + omega^2 x = amplitude sin(w t), from rest."""
    found: Array = amplitude / (omega**2 - w**2) * (np.sin(w * t) - w / omega * np.sin(omega * t))
    return found


@pytest.mark.parametrize(
    ("solver", "size", "others"),
    [("adams", 1.0, 0), ("ida", 1.0, 0), ("adams", 1e-3, 0), ("ida", 1e3, 0), ("adams", 1.0, 60)],
)
def test_a_load_has_the_accuracy_of_the_solver(solver: str, size: float, others: int) -> None:
    """``size`` is that of the time; the ways are the same."""
    omega, w, end = 10.0 / size, 30.0 / size, size
    for interval in (0.25, 0.01):
        found = mb.simulate(
            slider(LOAD, omega, others=others), end, interval=interval * end, solver=solver, tolerance=1e-9,
            inputs={"F": lambda t: np.sin(w * t) / size**2},
        )  # fmt: skip
        exact = forced(found.t, omega, w, size**-2)
        assert not found.failure
        assert np.abs(found["x"] - exact).max() < 1e-7 * np.ptp(exact)
        assert found.inputs == ("F: function of time, evaluated at the solver's times",)
        assert not [remark for remark in map(str, found.diagnostics) if "input" in remark]


@pytest.mark.parametrize(("solver", "ratio"), [("ida", 100.0), ("ida", 1e3), ("adams", 1e3), ("radau", 100.0)])
@pytest.mark.parametrize("order", [2, 3])
def test_a_rotor_behind_a_gear_follows_a_rise_to_rest(solver: str, ratio: float, order: int) -> None:
    """The next derivative jumps where the motion ends, and the gear multiplies errors of the rate by its ratio."""
    slope = {2: np.poly1d([30.0, -60.0, 30.0, 0.0, 0.0]), 3: np.poly1d([-140.0, 420.0, -420.0, 140.0, 0.0, 0.0, 0.0])}
    rise, end = slope[order].integ(), 0.7
    m = mb.Mechanism()
    arm = m.body("arm", m.ground, mb.Revolute(drive=mb.Input(name="u", unit="rad")), mass=1.0, inertia=(0.1, 0.1, 0.1))
    rotor = m.body("rotor", m.ground, mb.Revolute(start=0.0, rate=0.0, fixed=True), inertia=(1e-4, 1e-4, 1e-4))
    m.couple("gear", mb.Gear(ratio=ratio), rotor, arm)
    m.output("speed", rotor.rate())
    m.output("torque", arm.effort())
    for tolerance in (1e-6, 1e-9):
        found = mb.simulate(
            m, 1.0, solver=solver, tolerance=tolerance, inputs={"u": lambda t: float(rise(min(t / end, 1.0)))}
        )
        assert not found.failure
        assert not found.warning
        x = np.minimum(found.t / end, 1.0)
        speed = ratio * slope[order](x) / end
        torque = (0.1 + 1e-4 * ratio**2) * slope[order].deriv()(x) / end**2
        apart = np.abs(found.t - end) > 0.02  # from the series in which the motion ends
        assert np.abs(found["speed"] - speed).max() < 1e-7 * speed.max()
        assert np.abs(found["torque"] - torque)[apart].max() < 1e-7 * torque.max()


@pytest.mark.parametrize("kind", ["position", "position and rate", "rate", "speed", "points"])
def test_a_driven_base_has_the_accuracy_of_the_solver(kind: str) -> None:
    omega, w, a = 10.0, 30.0, 0.02
    given: dict[str, Any] = {}
    if "position" in kind:
        given["u"] = lambda t: a * np.sin(w * t)
    if "rate" in kind:
        given["v"] = lambda t: a * w * np.cos(w * t)
    drive: Any = mb.Input(name="u", unit="m", rate_name="v")
    if kind == "speed":
        drive, given = mb.SpeedInput(name="v", unit="m/s"), {"v": "0.02 * 30 * (1 - 2 * sin(15 * t)**2)"}
    if kind == "points":
        times = np.linspace(0.0, 1.0, 4001)
        given = {"u": (times, a * np.sin(w * times))}
    tolerance = 1e-12 if kind == "points" else 1e-9  # the third derivative of a spline jumps at its points
    for interval in (0.25, 0.01):
        found = mb.simulate(base(drive), 1.0, interval=interval, solver="adams", tolerance=tolerance, inputs=given)
        # x'' = omega^2 (u - x), and the mass starts with the speed of the base
        exact = omega**2 * forced(found.t, omega, w, a) + a * w / omega * np.sin(omega * found.t)
        np.testing.assert_allclose(found["base"], a * np.sin(w * found.t), atol=1e-11)
        assert np.abs(found["x"] - exact).max() < 1e-7 * a
        # the second derivative of a spline through points h apart is off by 11 h^2 w^4 a / 12 at its ends: 4e-5
        force = -a * w**2 * np.sin(w * found.t) - 2.0 * omega**2 * (exact - a * np.sin(w * found.t))
        assert np.abs(found["drive"] - force).max() < (5e-5 if kind == "points" else 1e-7) * np.abs(force).max()
        assert not [remark for remark in map(str, found.diagnostics) if "input" in remark]


@pytest.mark.parametrize(("begin", "end"), [(0.3123, 0.3377), (10 / 32, 11 / 32), (0.5, 0.515625)])
@pytest.mark.parametrize("solver", ["adams", "ida", "radau"])
def test_a_jump_of_a_load_is_met_between_outputs(solver: str, begin: float, end: float) -> None:
    """And a pulse. The times of the last two are ends of intervals of the approximation."""
    found = mb.simulate(
        slider(LOAD), 1.0, interval=0.02, solver=solver, tolerance=1e-8,
        inputs={"F": lambda t: 1.0 if begin < t < end else 0.0},
    )  # fmt: skip
    t = found.t
    exact = np.zeros_like(t)
    for at, sign in ((begin, 1.0), (end, -1.0)):
        exact += np.where(t > at, sign * 0.01 * (1.0 - np.cos(10.0 * (t - at))), 0.0)
    assert np.abs(found["x"] - exact).max() < 1e-6 * np.abs(exact).max()


def test_points_are_joined_by_straight_lines() -> None:
    """SciPy on the same points, restarted at each of them."""
    times, values = np.linspace(0.0, 1.0, 12), np.random.default_rng(1).normal(size=12)
    given: list[Any] = [(times, values), (list(times), list(values)), mb.Table(times, values, "linear")]
    y = np.zeros(2)
    for a, b in pairwise(times):
        run = solve_ivp(
            lambda t, y: (y[1], np.interp(t, times, values) - 100.0 * y[0]), (a, b), y, rtol=1e-11, atol=1e-13
        )
        y = run.y[:, -1]
    for points in given:
        found = mb.simulate(slider(LOAD), 1.0, interval=0.5, solver="adams", tolerance=1e-9, inputs={"F": points})
        assert found["x"][-1] == pytest.approx(y[0], abs=1e-8)


def test_the_rate_of_a_load_is_integrated() -> None:
    load = mb.Input(name="F", unit="N", rate_name="dF", start=0.5)
    found = mb.simulate(
        slider(load), 1.0, interval=0.5, solver="adams", tolerance=1e-9, inputs={"dF": lambda t: np.cos(3.0 * t)}
    )
    exact = forced(found.t, 10.0, 3.0, 1.0 / 3.0) + 0.5 * 0.01 * (1.0 - np.cos(10.0 * found.t))
    np.testing.assert_allclose(found["x"], exact, atol=1e-10)


def test_a_run_can_start_at_equilibrium_under_a_function() -> None:
    """In that of the first value."""
    found = mb.simulate(
        slider(LOAD),
        1.0,
        interval=0.5,
        solver="adams",
        start_at_equilibrium=True,
        inputs={"F": lambda t: 3.0 + 0.0 * t},
    )
    np.testing.assert_allclose(found["x"], 0.03, atol=1e-9)


def remarks_of(m: mb.Mechanism, **given: Any) -> list[str]:
    found = mb.simulate(m, 1.0, interval=0.1, solver="adams", inputs=given)
    return [remark for remark in map(str, found.diagnostics) if "input" in remark]


def test_inputs_that_cannot_be_evaluated_at_any_time_are_held_with_a_note() -> None:
    """A position whose rate jumps, a speed that jumps, noise, gravity."""
    position = base(mb.Input(name="u", unit="m"))
    (told,) = remarks_of(position, u=lambda t: max(t - 0.31, 0.0))
    assert "input 'u' cannot be evaluated" in told
    assert "its rate jumps at t = 0.31" in told
    for when in (0.5, 0.3):  # where intervals meet, and elsewhere
        (told,) = remarks_of(base(mb.SpeedInput(name="v", unit="m/s")), v=lambda t, when=when: float(t > when))
        assert f"it jumps at t = {when:.2g}"[:-1] in told
        (told,) = remarks_of(position, u=lambda t, when=when: float(t > when))
        assert f"it jumps at t = {when:.2g}"[:-1] in told
    random = np.random.default_rng(0)
    assert "input 'F' cannot be evaluated" in remarks_of(slider(LOAD), F=lambda t: random.normal())[0]
    m = mb.Mechanism(gravity=(mb.Input(name="g", unit="m/s2"), 0.0, 0.0))
    m.body("b", m.ground, mb.Translational(axis="x"), mass=1.0)
    assert "input 'g' cannot be evaluated" in remarks_of(m, g=np.sin)[0]
    # at rest for so long a jump of the acceleration is none of the rate
    assert not remarks_of(position, u=lambda t: max(t - 0.31, 0.0) ** 2)


def test_a_function_that_depends_on_the_run_is_noticed() -> None:
    state = {"gain": 1.0}

    def watch(simulation: Any) -> None:
        state["gain"] = 1.0 + simulation.t

    found = mb.simulate(
        slider(LOAD), 1.0, interval=0.1, solver="adams", inputs={"F": lambda t: state["gain"]}, watch=watch
    )
    assert any("input 'F' does not depend on time alone" in remark for remark in map(str, found.diagnostics))


def test_a_rate_that_is_not_that_of_the_position_is_noticed() -> None:
    drive = mb.Input(name="u", unit="m", rate_name="v")
    (told,) = remarks_of(base(drive), u=np.sin, v=lambda t: 1.01 * np.cos(t))
    assert "input 'v' is 1.01 at t = 0 s, but the derivative of input 'u' is 1 at this time" in told


RISE = np.linspace(0.0, 1.0, 5)


@pytest.mark.parametrize("position", [lambda t: 0.3 * t, "0.3*t", (RISE, 0.3 * RISE), mb.Table(RISE, 0.3 * RISE)])
@pytest.mark.parametrize("rate", [5.0, "5.0", lambda t: 5.0, (RISE, 5.0 + 0.0 * RISE)])
def test_a_rate_is_compared_in_whatever_way_both_are_given(position: Any, rate: Any) -> None:
    drive = mb.Input(name="u", unit="m", rate_name="v")
    (told,) = remarks_of(base(drive), u=position, v=rate)
    assert "input 'v' is 5 at t = 0 s, but the derivative of input 'u' is 0.3 at this time. The derivative is" in told
    assert not remarks_of(base(drive), u=position, v=0.3)
    assert not remarks_of(base(drive), u=position, v=lambda t: 0.3)


@pytest.mark.parametrize("rate", [5.0, "5.0", lambda t: 5.0, (RISE, 5.0 + 0.0 * RISE)])
def test_a_constant_position_with_a_rate_is_noticed(rate: Any) -> None:
    drive = mb.Input(name="u", unit="m", rate_name="v")
    (told,) = remarks_of(base(drive), u=0.3, v=rate)
    assert "input 'v' is 5 at t = 0 s, but the derivative of input 'u' is 0 at this time" in told
    assert "Input 'u' is the value at the start, and 'v' is used from then on" in told
    assert not remarks_of(base(drive), u=0.3, v=0.0)
    assert not remarks_of(base(drive), v=rate)


def test_numbers_that_are_set_later_are_only_those_of_the_start() -> None:
    """A position and a rate that go on from the start."""

    def watch(simulation: Any) -> None:
        simulation.set_input("u", 0.3 + 5.0 * simulation.t)

    drive = mb.Input(name="u", unit="m", rate_name="v")
    found = mb.simulate(base(drive), 1.0, interval=0.1, solver="adams", inputs={"u": 0.3, "v": 5.0}, watch=watch)
    assert not [remark for remark in map(str, found.diagnostics) if "input" in remark]


def test_an_acceleration_is_compared_with_the_position_and_with_the_rate() -> None:
    drive = mb.Input(name="u", unit="m", rate_name="v", acceleration_name="a")
    told = remarks_of(base(drive), u="0.5*t*t", v="2*t", a=3.0)
    assert "input 'v' is 2 at t = 1 s, but the derivative of input 'u' is 1 at this time" in told[0]
    assert "input 'a' is 3 at t = 0 s, but the second derivative of input 'u' is 1 at this time" in told[1]
    (told_of_rate,) = remarks_of(base(drive), v="2*t", a=3.0)
    assert "input 'a' is 3 at t = 0 s, but the derivative of input 'v' is 2 at this time" in told_of_rate
    jump, alone = remarks_of(base(drive), a=lambda t: 2.0)
    assert "input 'a' cannot be evaluated at the solver's times (neither its value nor its rate is given" in alone
    assert "input 'u' at t = 0.1 s: its position differs by -0.01 m from the value that" in jump  # it remains zero


def no(t: float) -> float:
    raise KeyError(t)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (([0.0, 0.5], [1.0, 2.0]), r"input 'F' is given by points from 0 to 0.5 s, but the run is from 0 to 1 s"),
        (([0.0, 0.0], [1.0, 2.0]), r"input 'F'"),
        (([0.0, 1.0], 1.0), r"input 'F' has \(2,\) and \(\) numbers; allowed: as many x as y"),
        (([0.0, 1.0], [1.0, [2.0]]), r"y of input 'F' is \[1.0, \[2.0\]\]; it needs numbers"),
        ([1.0], "input 'F' is .*; allowed: a finite number, a function"),
        ("log(t - 1)", "input 'F' is .*nan.* at t = 0 s; allowed: a finite number"),
        (lambda t: np.nan, "input 'F' is nan at t = 0"),
        (lambda t: [t], r"input 'F' is \[.*at t = 0"),
        (no, r"input 'F': its function fails at t = 0 s \(KeyError"),
        ("10 * sin(x)", "input 'F' is .* where 'x' is not known"),
        (mb.Input(name="other", unit="N"), "input 'F' is .*; allowed"),
        (None, "input 'F' is None; it must be a finite number"),
    ],
)
def test_what_is_no_input_is_refused(given: Any, message: str) -> None:
    with pytest.raises(mb.UserError, match=message):
        mb.simulate(slider(LOAD), 1.0, interval=0.1, solver="adams", inputs={"F": given})


def test_a_given_input_cannot_be_set_meanwhile() -> None:
    with pytest.raises(mb.UserError, match="input 'F' is given for the whole run"):
        mb.simulate(slider(LOAD), 1.0, interval=0.1, inputs={"F": np.sin}, watch=lambda run: run.set_input("F", 1.0))
    with pytest.raises(mb.UserError, match="there is no input 'G'; this model has 'F'"):
        mb.simulate(slider(LOAD), 1.0, interval=0.1, inputs={"G": np.sin})


@pytest.mark.parametrize(("how", "order"), [("hold", 1.0), ("linear", 2.0)])
def test_values_set_step_by_step_are_held_or_extrapolated(how: str, order: float) -> None:
    """By ``input_interpolation``; the error falls with its order."""

    def error(interval: float) -> float:
        load: Callable[[float], float] = lambda t: 10.0 * np.sin(3.0 * t)  # noqa: E731
        found = mb.simulate(
            slider(LOAD), 1.0, interval=interval, solver="adams", tolerance=1e-9,
            input_interpolation=how, watch=lambda run: run.set_input("F", load(run.t)),
        )  # fmt: skip
        return float(np.abs(found["x"] - forced(found.t, 10.0, 3.0, 10.0)).max())

    assert np.log2(error(0.02) / error(0.01)) == pytest.approx(order, abs=0.25)


def test_a_saved_result_contains_how_inputs_were_treated(tmp_path: Any) -> None:
    found = mb.simulate(slider(LOAD), 0.1, interval=0.1, solver="adams", inputs={"F": np.cos})
    found.save(tmp_path / "r.npz")
    assert mb.Result.load(tmp_path / "r.npz").inputs == found.inputs
    assert "evaluated at the solver" in found._repr_html_()


PULSES = {  # points of a load that is zero at the start, in parts of the duration
    "triangle": ([0.0, 0.3, 0.5, 0.7, 1.0], [0.0, 0.0, 1.0, 0.0, 0.0]),
    "rectangle": ([0.0, 0.4, 0.4001, 0.6, 0.6001, 1.0], [0.0, 0.0, 1.0, 1.0, 0.0, 0.0]),
    "short": ([0.0, 0.495, 0.5, 0.505, 1.0], [0.0, 0.0, 1.0, 0.0, 0.0]),
    "both signs": ([0.0, 0.8, 0.82, 0.84, 0.86, 1.0], [0.0, 0.0, 1.0, -0.5, 0.0, 0.0]),
}


@pytest.mark.parametrize("shape", PULSES)
@pytest.mark.parametrize(
    ("solver", "size", "others"),
    [("adams", 1.0, 0), ("radau", 1.0, 0), ("ida", 1.0, 0), ("adams", 1e-3, 0), ("ida", 1e3, 0), ("esdirk", 1.0, 60)],
)
def test_no_pulse_by_points_is_missed_from_rest(solver: str, size: float, others: int, shape: str) -> None:
    """The reference integrates the straight lines between the points twice."""
    parts, loads = (np.array(part) for part in PULSES[shape])
    t = np.linspace(0.0, 1.0, 200_001)
    speed = np.concatenate(([0.0], np.cumsum(0.5 * np.diff(t) * np.add(*pair_of(np.interp(t, parts, loads))))))
    way = float(np.sum(0.5 * np.diff(t) * np.add(*pair_of(speed))))
    for interval in (1.0, 0.01):
        found = mb.simulate(
            slider(LOAD, 0.0, others=others), size, interval=interval * size, solver=solver,
            inputs={"F": (parts * size, loads / size**2)},
        )  # fmt: skip
        assert abs(found["x"][-1] - way) < 1e-4  # 100 tolerances
        assert not found.warning


@pytest.mark.parametrize("given", [lambda t: float(10 <= t < 11), lambda t: float(8 < t <= 24) - 15.0 * (t > 24)])
@pytest.mark.parametrize(("solver", "others"), [("adams", 0), ("radau", 0), ("ida", 0), ("esdirk", 60)])
def test_no_jump_of_a_function_at_a_fraction_of_the_run_is_missed_from_rest(
    solver: str, others: int, given: Callable[[float], float]
) -> None:
    """Piecewise constant over 32 s: the way is the sum of values times differences of squares of the times left."""
    edges = np.array([0.0, 8.0, 10.0, 11.0, 24.0, 32.0])
    values = [given(float(t)) for t in 0.5 * np.add(*pair_of(edges))]
    way = 0.5 * float(values @ -np.diff((32.0 - edges) ** 2))
    found = mb.simulate(slider(LOAD, 0.0, others=others), 32.0, interval=32.0, solver=solver, inputs={"F": given})
    assert abs(found["x"][-1] - way) < 1e-5 * abs(way)


def pair_of(values: Array) -> tuple[Array, Array]:
    """Return all but the last, and all but the first."""
    return values[:-1], values[1:]


@pytest.mark.parametrize("solver", ["adams", "radau", "ida"])
def test_no_motion_by_points_is_missed_from_rest(solver: str) -> None:
    """A base that is moved and comes back long after the start, by a spline through points."""
    times = np.linspace(0.0, 10.0, 401)
    way = np.where(np.abs(times - 8.0) < 0.25, np.cos(2.0 * np.pi * (times - 8.0)) ** 4, 0.0)
    drive = mb.Input(name="u", unit="m")
    spline = CubicSpline(times, way)
    reference = solve_ivp(
        lambda t, y: [y[1], -100.0 * (y[0] - spline(t))], (0.0, 10.0), [0.0, 0.0], rtol=1e-11, atol=1e-13, max_step=0.01
    )
    found = mb.simulate(base(drive), 10.0, interval=10.0, solver=solver, inputs={"u": (times, way)})
    assert abs(found["x"][-1] - reference.y[0, -1]) < 2e-4 * np.abs(reference.y[0]).max()


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_a_held_drive_that_does_not_start_at_rest_is_noticed(size: float) -> None:
    """The rate jumps within the run, so that the position is set at outputs: the joint starts at rest."""
    drive = mb.Input(name="u", unit="m")
    for start, noticed in ((lambda t: abs(t - 0.3), True), (lambda t: max(0.0, t - 0.3), False)):
        given = {"u": lambda t, law=start: size * law(t / size)}
        found = mb.simulate(base(drive), 0.5 * size, interval=0.01 * size, solver="adams", inputs=given)
        (told,) = (remark for remark in map(str, found.diagnostics) if "cannot be evaluated" in remark)
        assert ("although the input starts with the rate -1," in told) == noticed

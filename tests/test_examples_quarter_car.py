"""The quarter car: its weight on the tire, rigid kinematics, natural frequencies by Lagrange, and its controller."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import quarter_car as example
from numpy.typing import NDArray
from quarter_car import (
    LOWER_BALL,
    LOWER_HINGE,
    PASSIVE,
    STRUT_FOOT,
    STRUT_TOP,
    UPPER_BALL,
    UPPER_HINGE,
    WHEEL,
    QuarterCar,
)
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import eigh

from mbfmu import equilibrium, read_table, simulate
from mbfmu.cli import main
from mbfmu.native.runtime import COMPILERS
from mbfmu.native.targets import host

Array = NDArray[np.float64]
MASSES = {"lower": 5.0, "upper": 3.0, "tube": 3.0, "rod": 2.0}  # kg
STIFF = 1e9  # N/m, of bushings that are nearly rigid hinges

needs_compiler = pytest.mark.skipif(
    not host() or not any(map(shutil.which, COMPILERS)), reason="needs a C compiler, and a machine that is known"
)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, example.Run]:
    return example.example(tmp_path_factory.mktemp("quarter_car"))


def turn(angle: float, arm: Array) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * arm[0] - s * arm[1], s * arm[0] + c * arm[1]])


def places(coordinates: Array) -> Array:
    """Return y, z and angle of body, lower arm, upper arm, upright, tube and rod, with rigid hinges.

    Coordinates: height of the body (m) and angle of the lower arm (rad).
    """
    height, lower = coordinates
    points = (LOWER_HINGE, LOWER_BALL, UPPER_HINGE, UPPER_BALL, WHEEL, STRUT_TOP, STRUT_FOOT)
    lh, lb, uh, ub, w, st, sf = (np.array(p[1:]) for p in points)

    upper, upright = lower, 0.0
    for _ in range(20):  # Newton
        arm, height_of_upright = turn(upper, ub - uh), turn(upright, ub - lb)
        gap = lh + turn(lower, lb - lh) + height_of_upright - uh - arm
        columns = np.array([-turn(0.5 * np.pi, arm), turn(0.5 * np.pi, height_of_upright)]).T
        upper, upright = np.array([upper, upright]) - np.linalg.solve(columns, gap)
    assert np.abs(gap).max() < 1e-14
    foot = lh + turn(lower, sf - lh)
    along, axis = foot - st, sf - st
    tilt = np.arctan2(along[1], along[0]) - np.arctan2(axis[1], axis[0])
    found = [
        (np.zeros(2), 0.0),
        (lh + turn(lower, 0.5 * (lb - lh)), lower),
        (uh + turn(upper, 0.5 * (ub - uh)), upper),
        (lh + turn(lower, lb - lh) + turn(upright, w - lb), upright),
        (st + turn(tilt, 0.3 * axis), tilt),
        (foot - turn(tilt, 0.3 * axis), tilt),
    ]
    return np.array([(at[0], at[1] + height, angle) for at, angle in found])


def weights(car: QuarterCar) -> Array:
    masses = [car.body_mass, MASSES["lower"], MASSES["upper"], car.wheel_mass, MASSES["tube"], MASSES["rod"]]
    return np.array([masses, masses, [0.0, 0.05, 0.05, 0.8, 0.02, 0.01]]).T


def top_and_foot(coordinates: Array) -> Array:
    """Return the vector from the top of the strut to its foot, m."""
    foot = np.array(LOWER_HINGE[1:]) + turn(coordinates[1], np.subtract(STRUT_FOOT, LOWER_HINGE)[1:])
    return np.asarray(foot - STRUT_TOP[1:])


def potential(coordinates: Array, car: QuarterCar) -> float:
    at = places(coordinates)
    compressed = np.linalg.norm(np.subtract(STRUT_FOOT, STRUT_TOP)) - np.linalg.norm(top_and_foot(coordinates))
    stored = 0.5 * car.spring * (compressed + car.preload / car.spring) ** 2
    stored += 0.5 * car.tire * max(car.tire_radius - at[3, 1], 0.0) ** 2
    stored += 2.0 * car.bushing_turn * (2.0 - np.cos(at[1, 2]) - np.cos(at[2, 2]))
    return float(stored + 9.81 * weights(car)[:, 0] @ at[:, 1])


def derivative(f: Any, x: Array, h: float) -> Array:
    return np.array([(f(x + h * e) - f(x - h * e)) / (2.0 * h) for e in np.eye(len(x))])


def linear(car: QuarterCar) -> tuple[Array, Array, Array]:
    """Return coordinates at rest, and the matrices of stiffness and mass there, with rigid hinges."""
    rest = np.zeros(2)
    for _ in range(5):  # Newton, on central differences
        slope = derivative(lambda x: potential(x, car), rest, 1e-5)
        stiffness = derivative(lambda x: derivative(lambda y: potential(y, car), x, 1e-4), rest, 1e-4)
        rest = rest - np.linalg.solve(stiffness, slope)
    slopes = derivative(places, rest, 1e-5)
    return rest, 0.5 * (stiffness + stiffness.T), np.einsum("aij,bij,ij->ab", slopes, slopes, weights(car))


def test_frequencies_and_rest_are_those_of_two_coordinates_with_rigid_hinges() -> None:
    car = QuarterCar(bushing=STIFF, damping=0.0)
    rest, stiffness, mass = linear(car)
    exact = np.sqrt(eigh(stiffness, mass, eigvals_only=True))
    state = equilibrium(car)
    found = sorted(abs(mode.eigenvalue) for mode in state.modes)[:2]
    np.testing.assert_allclose(found, exact, rtol=2e-4)
    assert state.outputs["body.height"] == pytest.approx(rest[0], abs=2e-5)


def test_the_tire_carries_the_weight() -> None:
    car = QuarterCar()
    total = car.body_mass + car.wheel_mass + sum(MASSES.values())
    assert equilibrium(car).outputs["tire.force"] == pytest.approx(9.81 * total, rel=1e-10)


@pytest.mark.parametrize("angle", [-0.12, 0.05, 0.12])
def test_the_closed_form_of_the_linkage_closes_it(angle: float) -> None:
    upright = places(np.array([0.0, angle]))[3]
    travel, camber = example.rigid_linkage(angle)
    assert travel == pytest.approx(upright[1] - WHEEL[2], abs=1e-12)
    assert camber == pytest.approx(-upright[2], abs=1e-12)


def test_camber_follows_the_rigid_linkage_where_bushings_are_stiff() -> None:
    car = QuarterCar(bushing=STIFF, damping=PASSIVE)
    bump = {"road.height": "0.02 * (1 - cos(8 * t))"}
    result = simulate(car, 0.8, inputs=bump, solver="radau", start_at_equilibrium=True)
    assert not result.failure
    assert not result.warning
    angles = np.linspace(-0.2, 0.2, 2001)
    travel, camber = np.array([example.rigid_linkage(angle) for angle in angles]).T
    assert np.ptp(result["wheel.travel"]) > 0.02
    exact = np.interp(result["wheel.travel"], travel, camber)
    np.testing.assert_allclose(-np.arcsin(result["wheel.axis"]), exact, atol=1e-5)


def test_a_measured_road_moves_the_car_as_two_linear_coordinates(tmp_path: Path) -> None:
    """Small heights: M x'' + C x' + K x = k_t w h + c_t w h', with the slopes w of the wheel and of the strut in C.

    The damping of the tire is that of a stop, 0.05 s times its force at rest.
    """
    profile = example.road()
    low = CubicSpline(profile.x, 0.05 * profile(profile.x))
    example.write_road(tmp_path / "road.csv", low)
    car = QuarterCar(bushing=STIFF, damping=PASSIVE)
    on_road = car.with_inputs({"road.height": read_table(tmp_path / "road.csv")})
    result = simulate(on_road, 0.8, solver="radau", start_at_equilibrium=True)
    rest, stiffness, mass = linear(car)
    wheel = derivative(lambda x: places(x)[3, 1], rest, 1e-5)
    strut = derivative(lambda x: np.linalg.norm(top_and_foot(x)), rest, 1e-5)
    tire_damping = 0.05 * equilibrium(car).outputs["tire.force"]
    damping = PASSIVE * np.outer(strut, strut) + tire_damping * np.outer(wheel, wheel)

    def rates(t: float, y: Array) -> Array:
        push = wheel * (car.tire * low(t) + tire_damping * low(t, 1))
        return np.concatenate((y[2:], np.linalg.solve(mass, push - stiffness @ y[:2] - damping @ y[2:])))

    exact = solve_ivp(rates, (0.0, 0.8), np.zeros(4), t_eval=result.t, rtol=1e-8, atol=1e-10, max_step=1e-3).y
    height = result["body.height"] - result["body.height"][0]
    assert np.ptp(exact[0]) > 3e-4
    np.testing.assert_allclose(height, exact[0], atol=0.01 * np.ptp(exact[0]))
    travel = result["wheel.travel"] - result["wheel.travel"][0]
    np.testing.assert_allclose(travel, exact[:2].T @ (wheel - [1.0, 0.0]), atol=0.01 * np.ptp(travel))


def test_check_and_compare_examine_the_car_on_a_measured_road(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    times = np.linspace(0.0, example.STOP_TIME, 601)
    example.write_road(tmp_path / "road.csv", CubicSpline(times, 0.02 * np.sin(10.0 * times) ** 2))
    road = ["--set", f"damping={PASSIVE}", "--input", f"road.height={tmp_path / 'road.csv'}", "--stop-time", "0.04"]
    model = f"{example.__file__}:QuarterCar"
    compared = ["--solver", "adams", "--tolerance", "1e-4", "--repeats", "1", "-o", str(tmp_path)]
    for command in (["check", model, *road], ["compare", model, *road, *compared]):
        assert main(command) == 0
        shown = capsys.readouterr().out
        assert "'road.height'" not in shown, command  # it is not listed as an input that kept its value
        assert "road.csv', 1201 points from 0 to 3 s" in shown


@needs_compiler
def test_the_passive_damper_is_that_of_the_model(runs: dict[str, example.Run]) -> None:
    profile = example.road()
    points = profile.x[profile.x < example.STOP_TIME + 0.1]
    result = simulate(
        QuarterCar(damping=PASSIVE),
        example.STOP_TIME,
        inputs={"road.height": (points, profile(points))},
        solver="adams",
        start_at_equilibrium=True,
    )
    assert not result.warning
    for name in ("body.speed", "wheel.travel"):  # what the force, constant within a step, leaves
        assert np.abs(result[name] - runs["passive"][name]).max() < 0.005 * np.ptp(result[name])


@needs_compiler
def test_the_controller_makes_the_ride_smoother(runs: dict[str, example.Run]) -> None:
    rms = {label: run["body.acceleration"].std() for label, run in runs.items()}
    assert rms["skyhook"] < 0.85 * rms["passive"]
    assert {label: run["tire.force"].min() > 0.0 for label, run in runs.items()} == {"passive": True, "skyhook": True}
    coefficient = runs["skyhook"]["coefficient"]
    assert (coefficient.min(), coefficient.max()) == (example.SOFT, example.HARD)

"""The scissor lift: its static force, its equation of motion in one coordinate, and its controller around the FMU."""

from __future__ import annotations

import shutil
from math import atan2, cos, hypot, sin
from pathlib import Path

import numpy as np
import pytest
import scissor_lift as example
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scissor_lift import GRAVITY, LENGTH, LOWER, RAM, STAGES, TUBE, UPPER, ScissorLift, static_force

from mbfmu import simulate
from mbfmu.native.runtime import COMPILERS
from mbfmu.native.targets import host

needs_compiler = pytest.mark.skipif(
    not host() or not any(map(shutil.which, COMPILERS)), reason="needs a C compiler, and a machine that is known"
)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> example.Run:
    return example.example(tmp_path_factory.mktemp("scissor_lift"))


@pytest.mark.parametrize(("angle", "load"), [(0.1, 0.0), (0.5, 3000.0), (1.0, 0.0)])
def test_the_static_force_holds_the_lift(angle: float, load: float) -> None:
    lift = ScissorLift(angle=angle)
    height = STAGES * LENGTH * sin(angle)
    force = static_force(lift, height, load)
    result = simulate(lift, 1.0, inputs={"cylinder.force": force, "platform.load": load}, solver="adams")
    assert not result.failure
    assert not result.warning
    np.testing.assert_allclose(result["platform.height"], height, rtol=1e-9)
    moved = simulate(lift, 1.0, inputs={"cylinder.force": 1.001 * force, "platform.load": load}, solver="adams")
    assert moved["platform.height"][-1] > height * (1.0 + 1e-5)


def places(lift: ScissorLift, angle: float) -> NDArray[np.float64]:
    """Return x, y and angle of the centers of mass, one row a body of ``lift``, for an angle of the arms."""
    c, s, middle = LENGTH * cos(angle), LENGTH * sin(angle), np.arange(STAGES) + 0.5
    d = UPPER - LOWER
    tilt = atan2((LENGTH + d) * sin(angle), d * cos(angle))
    along = np.array([cos(tilt), sin(tilt)])
    lower = LOWER * np.array([cos(angle), sin(angle)])
    upper = UPPER * np.array([cos(angle), sin(angle)]) + np.array([0.0, s])
    arms = [(0.5 * c, k * s, way * angle) for k in middle for way in (1.0, -1.0)]
    cylinder = [(*(lower + 0.5 * TUBE * along), tilt), (*(upper - 0.5 * RAM * along), tilt)]
    return np.array([*arms, (0.5 * LENGTH, STAGES * s, 0.0), *cylinder])


def test_it_moves_as_its_equation_in_one_coordinate() -> None:
    lift, force, h = ScissorLift(), 1.5e4, 1e-4
    masses = np.array([*[lift.arm_mass] * 2 * STAGES, lift.platform_mass, lift.tube_mass, lift.ram_mass])
    own = [lift.arm_mass * (LENGTH**2 + 0.12**2) / 12.0] * 2 * STAGES
    inertias = np.array([*own, 0.0, lift.tube_mass * TUBE**2 / 12.0, lift.ram_mass * RAM**2 / 12.0])
    weights = np.stack([masses, masses, inertias], axis=1)

    def inertia(angle: float) -> float:
        slope = (places(lift, angle + h) - places(lift, angle - h)) / (2.0 * h)
        return float(np.sum(weights * slope**2))

    def potential(angle: float) -> float:
        return float(GRAVITY * masses @ places(lift, angle)[:, 1])

    def length(angle: float) -> float:
        return hypot((UPPER - LOWER) * cos(angle), (LENGTH + UPPER - LOWER) * sin(angle))

    def slope(f: object, angle: float) -> float:
        return (f(angle + h) - f(angle - h)) / (2.0 * h)  # type: ignore[operator]

    def rates(_: float, y: NDArray[np.float64]) -> list[float]:
        stretch = slope(length, y[0])
        push = (force - lift.damping * stretch * y[1]) * stretch
        return [y[1], (push - slope(potential, y[0]) - 0.5 * slope(inertia, y[0]) * y[1] ** 2) / inertia(y[0])]

    exact = solve_ivp(rates, (0.0, 2.0), [lift.angle, 0.0], "DOP853", rtol=1e-10, atol=1e-12).y[0, -1]
    result = simulate(lift, 2.0, inputs={"cylinder.force": force}, solver="adams", tolerance=1e-9)
    assert result["platform.height"][-1] > 1.5 * result["platform.height"][0]
    assert result["platform.height"][-1] == pytest.approx(STAGES * LENGTH * sin(exact), rel=1e-6)


def test_the_clamp_of_the_ram_holds_the_lift_when_the_pump_has_stopped(tmp_path: Path) -> None:
    """At rest the friction is the static force in closed form, and nothing creeps."""
    lift = ScissorLift(dry=True)
    example.write_pump(tmp_path / "pump.csv", lift)
    result = example.hold_platform(tmp_path / "pump.csv", lift)
    height = result["platform.height"]
    at_rest = result.t > example.PUMP_STOPS + 0.5
    assert not result.warning
    assert height[-1] > height[0] + 1.5
    assert np.ptp(height[at_rest]) < 1e-9
    force = static_force(lift, height[-1], example.CARRIED)
    np.testing.assert_allclose(result["friction.force"][at_rest], force, rtol=1e-7)
    example.draw_hold(result, lift, tmp_path / "held.png")


@pytest.mark.parametrize(("ratio", "holds"), [(1.25, True), (0.85, False)])
def test_the_clamp_slides_if_the_static_force_is_larger_than_its_breakaway_force(ratio: float, holds: bool) -> None:
    """The breakaway force is 1.1 times the friction of sliding."""
    lift = ScissorLift(dry=True, angle=0.5)
    height = STAGES * LENGTH * sin(lift.angle)
    friction = ratio * static_force(lift, height, 0.0)
    result = simulate(lift, 0.5, inputs={"ram.friction": friction}, solver="ida")
    assert (abs(result["platform.height"][-1] - height) < 1e-3) == holds


@needs_compiler
def test_the_controller_reaches_the_static_force(run: example.Run) -> None:
    lift = ScissorLift()
    for when, load in ((example.LOADED - example.STEP, 0.0), (example.STOP_TIME, example.PAYLOAD)):
        i = round(when / example.STEP)
        assert run["platform.height"][i] == pytest.approx(run["target"][i], abs=1e-4)
        assert run["force"][i] == pytest.approx(static_force(lift, run["target"][i], load), rel=1e-4)
    assert np.abs(run["platform.height"] - run["target"]).max() < 0.1


@needs_compiler
def test_the_energy_is_the_work_of_the_forces(run: example.Run) -> None:
    assert abs(example.energy_error(run, ScissorLift())) < 1e-4 * np.ptp(run["energy"])

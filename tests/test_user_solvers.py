"""The solver of the documentation, from outside the package, against exact motions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from user_solvers import AMPLITUDE, MASS, RATE, RK4, STIFFNESS, classes_of_one_file, oscillator  # noqa: F401  # classes_of_one_file is a fixture

import mbfmu as mb
from fmus.fourbar import FourBar
from mbfmu.mechanics import JointSpring, PointForce, Spherical, Step, Translational
from mbfmu.modeling.model import as_model
from mbfmu.modeling.scene import default_scene
from mbfmu.session.simulation import Simulation
from mbfmu.studies.comparison_report import as_text
from solvers import Options, stepper


def error_of_steps(h: float) -> float:
    """Largest error of positions with steps of h and no control of the error."""
    compiled = as_model(oscillator()).compile()
    motion = stepper("rk4", compiled.system, 0.0, *compiled.assemble(), Options(rtol=1e-2, atol=1e3, max_step=h))
    motion._control["h"] = h
    times = np.arange(1, 11) / 10.0
    samples = motion.sample(times)
    assert motion.statistics.steps == round(1.0 / h)
    return float(np.abs(samples.q[:, 0] - AMPLITUDE * np.cos(RATE * times)).max())


def test_the_example_has_the_order_four() -> None:
    mb.Settings(solver=RK4)  # the name is known from here on
    errors = np.array([error_of_steps(h) for h in (0.1, 0.05, 0.025, 0.0125)])
    orders = np.log2(errors[:-1] / errors[1:])
    np.testing.assert_allclose(orders, 4.0, atol=0.1)


class Buffered(RK4):  # type: ignore[misc, valid-type]
    """Returns the same array after every step."""

    name = "rk4-buffered"

    def step(self, f: Any, t: float, y: Any, h: float) -> Any:
        if not hasattr(self, "memory"):
            self.memory = np.zeros(len(y))
        self.memory[:] = super().step(f, t, y, h)
        return self.memory


def test_a_result_in_an_array_that_is_used_again_has_its_error_estimated() -> None:
    result = mb.simulate(oscillator(), 2.0, interval=1.0, solver=Buffered, tolerance=1e-8)
    assert not result.failure
    assert np.abs(result["x"] - AMPLITUDE * np.cos(RATE * result.t)).max() < 1e-6 * AMPLITUDE


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
def test_an_undamped_oscillation_is_exact_to_the_tolerance(tolerance: float) -> None:
    result = mb.simulate(oscillator(), 2.0, interval=0.1, solver=RK4, tolerance=tolerance)
    assert not result.failure
    assert not result.warning
    assert result.settings.solver == "rk4"
    exact = AMPLITUDE * np.cos(RATE * result.t)
    assert np.abs(result["x"] - exact).max() < 100.0 * tolerance * AMPLITUDE


def test_the_work_of_a_damper_is_in_the_energy_account() -> None:
    damping, tolerance = 4.0, 1e-8
    result = mb.simulate(oscillator(damping), 3.0, interval=0.1, solver=RK4, tolerance=tolerance)
    decay = 0.5 * damping / MASS
    rate = np.sqrt(RATE**2 - decay**2)
    t = result.t
    exact = AMPLITUDE * np.exp(-decay * t) * (np.cos(rate * t) + decay / rate * np.sin(rate * t))
    energy = 0.5 * STIFFNESS * AMPLITUDE**2
    assert np.abs(result["x"] - exact).max() < 1e-6 * AMPLITUDE
    assert np.abs(result["energy_error"]).max() < 1e-6 * energy
    assert result["energy_throughput"][-1] > 0.9 * energy  # nearly all is dissipated
    assert not result.warning


def test_a_wrong_power_raises_the_warning_of_the_energy_check() -> None:
    class Gaining(RK4):  # type: ignore[misc, valid-type]
        name = "gaining"
        error_order = 1

        def step(self, f: Any, t: float, y: Any, h: float) -> Any:
            end = super().step(f, t, y, h)
            return end * (1.0 + 0.05 * h), np.zeros(len(y))

    result = mb.simulate(oscillator(), 2.0, interval=0.1, solver=Gaining, tolerance=1e-6, max_step=0.01)
    assert "[energy-balance]" in result.warning


def test_a_force_that_jumps_at_a_known_time_is_followed() -> None:
    m = mb.Mechanism(gravity=(0, 0, 0))
    slider = m.body("slider", m.ground, Translational(axis="x"), mass=MASS)
    m.force("push", PointForce(magnitude=Step(begin=0.3037, height=3.0), axis="x"), slider)
    m.output("x", slider.coordinate())
    result = mb.simulate(m, 1.0, interval=0.25, solver=RK4, tolerance=1e-8)
    later = np.maximum(0.0, result.t - 0.3037)
    np.testing.assert_allclose(result["x"], 0.5 * 3.0 / MASS * later**2, atol=1e-7)


def equal_crank(model: FourBar, torque: Callable[[float], float], step: float, end: float) -> tuple[float, float]:
    """Angle and rate at the end: the coupler translates, so that the four-bar is one inertia about its pivot."""
    length = model.crank_length
    inertia = (model.crank_mass + model.rocker_mass) / 3.0 + model.coupler_mass
    weight = (0.5 * (model.crank_mass + model.rocker_mass) + model.coupler_mass) * model.gravity
    y: NDArray[np.float64] = np.array([model.start_angle, 0.0])
    for k in range(round(end / step)):
        held = torque(k * step)

        def rates(_t: float, y: NDArray[np.float64], held: float = held) -> list[float]:
            return [y[1], (held / length**2 - weight / length * np.cos(y[0])) / inertia]

        y = solve_ivp(rates, (0.0, step), y, rtol=1e-12, atol=1e-14, method="DOP853").y[:, -1]
    return float(y[0]), float(y[1])


def torque_at(t: float) -> float:
    return 3.0 * np.sin(7.0 * t)


def driven(end: float, step: float = 0.05, solver: Any = RK4) -> Simulation:
    simulation = Simulation(FourBar(start_angle=0.4), mb.Settings(solver=solver, tolerance=1e-8))
    for k in range(round(end / step)):
        simulation.set_input("crank.torque", torque_at(k * step))
        simulation.advance((k + 1) * step)
        assert not simulation.failure
    return simulation


def test_a_loop_with_an_input_that_is_set_at_every_communication_point() -> None:
    simulation = driven(1.0)
    found = dict(zip([v.name for v in simulation.variables], simulation.outputs(), strict=True))
    angle, rate = equal_crank(FourBar(start_angle=0.4), torque_at, 0.05, 1.0)
    assert abs(found["crank.angle"] - angle) < 1e-6
    assert abs(found["crank.rate"] - rate) < 1e-6
    assert found["position_residual"] < 1e-12
    assert not simulation.warning
    assert abs(found["energy_error"]) < 1e-5


def test_states_that_were_saved_continue_bit_for_bit() -> None:
    simulation = driven(0.5)
    checkpoint, saved = simulation.checkpoint(), simulation.save()
    simulation.advance(0.8)
    expected = simulation.outputs().copy()
    simulation.rollback(checkpoint)
    simulation.advance(0.8)
    np.testing.assert_array_equal(simulation.outputs(), expected)
    other = Simulation(FourBar(start_angle=0.4), mb.Settings(solver=RK4, tolerance=1e-8))
    other.restore(saved)
    other.advance(0.8)
    np.testing.assert_array_equal(other.outputs(), expected)


def test_a_free_symmetric_top_precesses_as_euler_found() -> None:
    m = mb.Mechanism(gravity=(0, 0, 0))
    inertia, spin = (0.3, 0.3, 0.5), (0.4, 0.0, 3.0)
    top = m.body("top", m.ground, Spherical(rate=spin), mass=1.0, inertia=inertia)
    for axis in "xyz":
        m.output(axis, top.angular_velocity(axis))
    result = mb.simulate(m, 2.0, interval=0.1, solver=RK4, tolerance=1e-9)
    # angular momentum, constant in global axes, and a steady rotation about it: Landau and Lifshitz, Mechanics, 33
    momentum = np.array([inertia[0] * spin[0], 0.0, inertia[2] * spin[2]])
    precession = momentum / inertia[0]
    figure = np.array([0.0, 0.0, 1.0])
    angles = np.linalg.norm(precession) * result.t
    n = precession / np.linalg.norm(precession)
    turned = np.array([
        figure * np.cos(a) + np.cross(n, figure) * np.sin(a) + n * (n @ figure) * (1.0 - np.cos(a)) for a in angles
    ])  # fmt: skip
    along = (1.0 / inertia[2] - 1.0 / inertia[0]) * momentum[2]
    expected = precession + along * turned
    found = np.stack([result[axis] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-7)


def test_a_large_model_is_integrated_by_its_recursions() -> None:
    m = mb.Mechanism(gravity=(0, 0, 0))
    rates = np.linspace(1.0, 6.0, 70)
    for k, rate in enumerate(rates):
        slider = m.body(f"s{k}", m.ground, Translational(axis="x", start=0.1), mass=1.0)
        m.force(f"f{k}", JointSpring(stiffness=rate**2), slider)
        m.output(f"x{k}", slider.coordinate())
    result = mb.simulate(m, 1.0, interval=0.25, solver=RK4, tolerance=1e-7)
    assert not result.warning
    for k, rate in enumerate(rates):
        np.testing.assert_allclose(result[f"x{k}"], 0.1 * np.cos(rate * result.t), atol=1e-6)


def test_it_is_compared_with_the_other_solvers() -> None:
    scene = default_scene(as_model(oscillator(4.0))).changed(stop_time=3.0, output_interval=1.0)  # s, longer than steps
    found = mb.compare(scene, solvers=["adams", RK4], tolerances=[1e-4, 1e-6], repeats=1, outputs=["x"])
    errors = {(row.solver, row.rtol): row.error or 0.0 for row in found.rows}
    assert set(errors) == {("adams", 1e-4), ("adams", 1e-6), ("rk4", 1e-4), ("rk4", 1e-6)}
    assert 0.0 < errors["rk4", 1e-6] < 0.1 * errors["rk4", 1e-4] < 1e-3
    assert all(row.trusted for row in found.rows)
    assert "rk4" in found.energies
    assert "rk4" in as_text(found)


def test_a_check_of_a_model_runs_it() -> None:
    found = mb.check(FourBar(), 0.1, solver=RK4)
    assert found.solver == "rk4"
    assert found.statistics is not None
    assert found.statistics.steps > 0

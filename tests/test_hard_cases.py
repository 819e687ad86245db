"""Long undamped runs and extreme numbers of the shipped models."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import simpson

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from mbfmu.modeling import Model
from mbfmu.session.run import Result, run
from mbfmu.session.simulation import Settings


def undamped(model: Model, solver: str, tolerance: float, end: float, interval: float) -> tuple[Result, float]:
    """Return a run and the largest change of its Jacobi integral, or where it has none of its energy, J."""
    result = run(model, Settings(solver=solver, tolerance=tolerance), np.arange(0.0, end + 0.5 * interval, interval))
    assert not result.failure
    outputs = result.as_dict()
    integral = outputs.get("jacobi_integral", outputs.get("energy"))
    assert integral is not None
    return result, float(np.abs(integral - integral[0]).max())


@pytest.mark.parametrize(("solver", "end", "bound"), [("adams", 100.0, 1e-5), ("ida", 20.0, 2e-4)])
def test_pendulum_keeps_its_jacobi_integral(solver: str, end: float, bound: float) -> None:
    """For 100 s at most 1e-5 J with adams, and in proportion to the time at most 1e-3 J with ida."""
    drifts = []
    for tolerance in (1e-4, 1e-7, 1e-10):
        result, drift = undamped(SwingPendulum(), solver, tolerance, end, 0.01)
        # theta_max follows from J; what J has drifted by is all that may be added
        assert np.abs(result["rod.angle"]).max() <= 0.1532 + 30.0 * tolerance + 0.002 * drift / 300.0 / 0.1532
        drifts.append(drift)
    assert drifts == sorted(drifts, reverse=True)
    assert drifts[-1] < bound


@pytest.mark.parametrize("gravity", [0.0, 9.81])
@pytest.mark.parametrize(("solver", "runs", "bound"), [("adams", 9, 1e-6), ("hybrid", 9, 1e-6), ("ida", 1, 1e-4)])
def test_governor_balances_energy_and_drive_work_for_200_s(
    solver: str, runs: int, bound: float, gravity: float
) -> None:
    """Its 23 000 steps fall differently with every last digit, and drifts differ by a factor of two: the median."""
    drifts = []
    for k in range(runs):
        model = Governor(gravity=gravity, stiffness=1000.0 * (1.0 + k * 1e-15))
        drifts.append(undamped(model, solver, 1e-8, 200.0, 0.05)[1])
    assert np.median(drifts) < bound


def test_the_work_of_the_drive_is_the_change_of_energy() -> None:
    result, _ = undamped(Governor(), "adams", 1e-10, 5.0, 0.001)
    work = 11.0174 * simpson(result["spindle.effort"], x=result.t)
    change = result["energy"][-1] - result["energy"][0]
    assert abs(change) > 0.1
    assert work == pytest.approx(change, abs=1e-7)


@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8, 1e-10])
def test_arms_stay_symmetric_through_the_singular_vertical(solver: str, tolerance: float) -> None:
    result, _ = undamped(Governor(), solver, tolerance, 30.0, 0.01)
    angle = result["arm1.angle"]
    assert angle.max() == pytest.approx(np.pi, abs=max(1e-2, 100.0 * tolerance))  # out on the other side
    assert np.abs(angle - result["arm2.angle"]).max() <= tolerance


@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
def test_a_spindle_a_million_times_the_collar_turns_as_if_driven(solver: str) -> None:
    heavy = Governor(driven=False, spindle_inertia=0.125e6)
    times = np.linspace(0.0, 5.0, 51)
    free = run(heavy, Settings(solver=solver, tolerance=1e-8), times)
    assert not free.failure
    exact = Governor().exact(times)
    assert exact is not None
    # the speed changes by the arms' share of the inertia, 4e-7 of it, and the angles by some of that a swing
    np.testing.assert_allclose(free["arm1.angle"], exact["arm1.angle"], atol=1e-5)
    np.testing.assert_allclose(free["spindle.speed"], 11.0174, rtol=1e-6)
    np.testing.assert_allclose(free["energy"], free["energy"][0], rtol=1e-12)


@pytest.mark.parametrize(("solver", "bound"), [("adams", 1e-7), ("hybrid", 1e-7), ("ida", 1e-5)])
@pytest.mark.parametrize(
    "model", [Governor(stiffness=1e7, start_angle=0.9, free_length=0.17), SwingPendulum(slider_stiffness=1e7)]
)
def test_a_spring_of_1e7_newton_a_meter_is_only_a_faster_motion(model: Model, solver: str, bound: float) -> None:
    times = np.linspace(0.0, 0.5, 51)
    result = run(model, Settings(solver=solver, tolerance=1e-9), times)
    assert not result.failure
    exact = model.exact(times)
    assert exact is not None
    for name, values in exact.items():
        np.testing.assert_allclose(result[name], values, atol=bound)


def test_a_run_reports_where_rounding_allows_no_finer_tolerance() -> None:
    model, times = FourBar(rocker_length=1.0 + 1e-9), np.linspace(0.0, 2.0, 11)
    finest, fine = (run(model, Settings(solver="adams", tolerance=rtol), times) for rtol in (1e-10, 1e-7))
    assert any("rounding errors" in text for text in map(str, finest.diagnostics))
    assert not any("rounding errors" in text for text in map(str, fine.diagnostics))

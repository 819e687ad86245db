"""The four-bar against its exact motion: singular configurations, hard starts, every solver and tolerance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from fmus.fourbar import FourBar
from mbfmu.session.run import run
from mbfmu.session.simulation import Settings

TIMES = np.linspace(0.0, 10.0, 501)
BOUNDS = {"adams": 100.0, "hybrid": 300.0, "ida": 1000.0}
FLOOR = 1e-7  # rad
MODELS = {
    "default": FourBar(),
    "rocker three times heavier": FourBar(rocker_mass=3.0 * FourBar().rocker_mass),
    "starts singular with a velocity": FourBar(start_angle=0.0, start_rate=-1.0),
}


def largest_error(model: FourBar, solver: str, rtol: float, times: np.ndarray) -> float:  # type: ignore[type-arg]
    """Largest error of an angle, on a run that must end and keep its branch."""
    result = run(model, Settings(solver=solver, tolerance=rtol), times)
    assert not result.failure
    exact = model.exact(times)
    assert exact is not None
    gap = model.branch_gap(result.as_dict())
    assert gap is not None
    error = max(float(np.abs(result[name] - x).max()) for name, x in exact.items())
    assert gap.max() < 2.0 * error + 1e-9
    return error


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("solver", BOUNDS)
def test_passes_every_singular_position(model: str, solver: str) -> None:
    tolerances = (1e-4, 1e-6, 1e-8, 1e-10)
    errors = [largest_error(MODELS[model], solver, rtol, TIMES) for rtol in tolerances]
    for rtol, error in zip(tolerances, errors, strict=True):
        assert error <= max(BOUNDS[solver] * rtol, FLOOR), rtol
    resolved = np.maximum(errors, FLOOR)
    assert np.all(np.diff(resolved) <= 0.0)


@pytest.mark.parametrize("solver", BOUNDS)
@pytest.mark.parametrize("rtol", [1e-4, 1e-6, 1e-8, 1e-10])
def test_communication_points_on_every_singular_time(solver: str, rtol: float) -> None:
    times = np.concatenate([[0.0], singular_times(FourBar()), [10.0]])
    assert len(times) == 19
    assert largest_error(FourBar(), solver, rtol, times) <= max(BOUNDS[solver] * rtol, FLOOR)


def singular_times(model: FourBar) -> np.ndarray:  # type: ignore[type-arg]
    """Times within 10 s at which all links lie on one line: sin(theta) = 0."""
    exact = model.exact(TIMES)
    assert exact is not None
    s = np.sin(exact["crank.angle"])
    crossings = np.flatnonzero(s[:-1] * s[1:] < 0.0)

    def sine(t: float) -> float:
        at = model.exact(np.array([0.0, t]))
        assert at is not None
        return float(np.sin(at["crank.angle"][-1]))

    return np.array([brentq(sine, TIMES[i], TIMES[i + 1], xtol=1e-14) for i in crossings])


@pytest.mark.parametrize("rtol", [1e-4, 1e-6])
def test_lu_fails_at_the_second_singular_position(rtol: float) -> None:
    """The paper's finding: the step collapses or the motion leaves its branch, and not at the first (0.18 s)."""
    result = run(FourBar(), Settings(solver="adams-lu", tolerance=rtol), TIMES)
    gap = FourBar().branch_gap(result.as_dict())
    assert gap is not None
    end = float(result.t[np.argmax(gap > 0.05)]) if gap.max() > 0.05 else float(result.t[-1])
    assert 0.9 < end < 1.2


def test_a_general_four_bar_agrees_between_solvers() -> None:
    model = FourBar(coupler_length=2.5, rocker_length=1.4, ground_length=2.2, start_angle=1.2)
    times = np.linspace(0.0, 2.0, 51)
    reference = run(model, Settings(solver="adams", tolerance=1e-12), times)
    for solver in BOUNDS:
        result = run(model, Settings(solver=solver, tolerance=1e-8), times)
        assert not result.failure
        for name in (v.name for v in reference.variables if v.unit == "rad"):
            np.testing.assert_allclose(result[name], reference[name], rtol=0, atol=1e-5)

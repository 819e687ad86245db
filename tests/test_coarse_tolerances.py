"""Runs at coarse tolerances report how large their errors may be; motions by SciPy from equations written by hand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from healthy_runs import Draw, double_pendulum, loop, pendulum, shaken, top

from fmus.sheet import Sheet
from mbfmu import simulate
from mbfmu.mechanics import Harmonic, Mechanism, Revolute, rod
from mbfmu.session.run_messages import COARSE_ERROR
from mbfmu.util.diagnostics import without_details

SOLVERS = ("adams", "hybrid", "ida", "radau")
SHIFT = 1e-7  # error of the start that its growth is found by
LARGE = 0.3  # rad


def codes(result: Any) -> set[str]:
    return {d.code for d in without_details(result.diagnostics)}


def apart(one: Any, other: Any, draw: Draw) -> float:
    return float((np.abs(one - other) / draw.sizes).max())


@pytest.mark.parametrize("family", [double_pendulum, shaken, loop, top], ids=lambda family: family.__name__)
def test_errors_at_coarse_tolerances_are_reported_and_not_larger(family: Callable[[Any], Draw]) -> None:
    """Runs five times as long as usual, so that errors grow; those without a warning are off by more than 0.3 rad."""
    silent = 0.0
    for solver, seed in zip((*SOLVERS, "ida"), (3, 5, 11, 13, 1), strict=True):
        draw = family(np.random.default_rng(seed))
        end = 5.0 * draw.end
        times = np.linspace(0.0, end, 201)
        exact = draw.exact(times)
        for tolerance in (1e-2, 1e-3):
            result = simulate(draw.mechanism, end, interval=end / 200.0, solver=solver, tolerance=tolerance)
            assert "coarse-tolerance" in codes(result)
            if result.failure or result.warning:
                continue
            error = apart(np.array([result[name] for name, *_ in draw.mechanism.outputs]).T, exact, draw)
            shifts = (SHIFT, tolerance, -tolerance)
            growth = max(1.0, *(apart(draw.exact(times, s), exact, draw) / abs(s) for s in shifts))
            assert error <= COARSE_ERROR * tolerance * growth
            silent = max(silent, error)
    assert silent > LARGE


def test_the_warning_states_the_size_of_the_errors() -> None:
    draw = pendulum(np.random.default_rng(0))
    result = simulate(draw.mechanism, draw.end, interval=draw.end, solver="adams", tolerance=2e-3)
    (text,) = (str(d) for d in result.diagnostics if d.code == "coarse-tolerance")
    assert "the tolerance is 0.002" in text
    assert "100 times the tolerance" in text
    assert "a tenth of the tolerance" in text


def test_finer_runs_and_runs_without_errors_have_no_warning() -> None:
    draw = double_pendulum(np.random.default_rng(0))
    for tolerance in (9e-4, 1e-4, 1e-6):
        result = simulate(draw.mechanism, 0.1, interval=0.1, solver="adams", tolerance=tolerance)
        assert "coarse-tolerance" not in codes(result)
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    m.body("arm", m.ground, Revolute(drive=Harmonic(amplitude=1.0, frequency=1.0)), **rod(mass=1.0, length=1.0))
    assert "coarse-tolerance" not in codes(simulate(m, 0.1, interval=0.1, solver="adams", tolerance=1e-2))
    damped = simulate(Sheet(nx=7, nz=5, damping=2e-4), 1e-3, interval=1e-3, solver="esdirk", tolerance=1e-3)
    assert not codes(damped)

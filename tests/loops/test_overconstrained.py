"""Spatial linkages with redundant constraint equations, against their exact motions."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from judge import conservative, energy_error, judge, truth
from mechanisms import UNSCALED, Scale
from overconstrained import OVERCONSTRAINED

from mbfmu.mechanics import Plant
from solvers import Options, stepper

SOLVERS = ("adams", "hybrid", "ida", "radau")
REGULAR = ("bennett", "bennett, turning", "sarrus")
SIZES = {"": UNSCALED, "thousandth": Scale(1e-3, 1e-6, 1e-2), "thousandfold": Scale(1e3, 1e6, 30.0)}


@cache
def known(name: str, size: str = ""):
    """The mechanism and its exact motion."""
    case = OVERCONSTRAINED[name](scale=SIZES[size])
    return case.mechanism, truth(case.mechanism, np.linspace(0.0, case.stop_time, 41), case.exact)


@pytest.mark.parametrize(
    ("solver", "size"), [*((s, "") for s in SOLVERS), ("ida", "thousandth"), ("ida", "thousandfold")]
)
@pytest.mark.parametrize("name", REGULAR)
def test_errors_stay_within_a_few_tolerances(name: str, solver: str, size: str) -> None:
    """Within 5 and not 100 rtol A(t): redundant equations must cost no accuracy."""
    mechanism, motion = known(name, size)
    for rtol in (1e-4, 1e-5, 1e-6, 3e-7, 1e-8):
        verdict = judge(mechanism, motion, solver, rtol, factor=5.0)
        assert verdict.word == "right", (rtol, verdict)


@pytest.mark.parametrize("rtol", [1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8])
def test_redundant_equations_take_no_energy(rtol: float) -> None:
    """Off the constraints their combinations act like friction: the energy tells it before the position does."""
    mechanism, motion = known("bennett")
    assert conservative(mechanism)
    plant = Plant(mechanism)
    run = stepper("ida", plant.system, 0.0, *motion.start, Options(rtol=rtol))
    rows = run.sample(motion.times[1:])
    lost = energy_error(mechanism, plant, motion, np.vstack((motion.q[:1], rows.q)), np.vstack((motion.v[:1], rows.v)))
    assert lost.max() < 20.0 * rtol
    assert run.statistics.rhs_evals < 2000

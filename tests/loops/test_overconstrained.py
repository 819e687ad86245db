"""Spatial linkages with redundant constraint equations, against their exact motions."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from judge import conservative, energy_error, judge, truth
from mechanisms import UNSCALED, Scale
from overconstrained import OVERCONSTRAINED
from watch import Watch

from mbfmu.mechanics import CompiledMechanism
from solvers import Options, stepper
from solvers.projection import singular

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
    """Off the constraints their combinations act like friction: the energy shows it before the position does."""
    mechanism, motion = known("bennett")
    assert conservative(mechanism)
    compiled = CompiledMechanism(mechanism)
    run = stepper("ida", compiled.system, 0.0, *motion.start, Options(rtol=rtol))
    rows = run.sample(motion.times[1:])
    lost = energy_error(
        mechanism, compiled, motion, np.vstack((motion.q[:1], rows.q)), np.vstack((motion.v[:1], rows.v))
    )
    assert lost.max() < 20.0 * rtol
    assert run.statistics.rhs_evals < 2000


@pytest.mark.parametrize("name", ["sarrus, folded flat", "sarrus, straight"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_sarrus_linkage_passes_its_singular_positions(solver: str, name: str) -> None:
    mechanism, motion = known(name)
    for rtol in (1e-4, 1e-6, 1e-7, 1e-8):
        verdict = judge(mechanism, motion, solver, rtol)
        assert verdict.word == "right", (rtol, verdict)


def lifted(angle: float):
    """Joint angles of Sarrus' linkage with its plate lifted."""
    return np.array((angle, np.pi - 2.0 * angle, angle - np.pi, -angle, np.pi + 2.0 * angle))


def resting(one: float, other: float):
    """Joint angles with the plate on the ground and both legs folded and turned by themselves."""
    return np.array((one, np.pi, -np.pi - one, -other, np.pi))


@pytest.mark.parametrize("angle", [0.1, 0.01, 3e-3])
def test_a_jump_to_the_branch_of_two_degrees_of_freedom_is_found(angle: float) -> None:
    """Flat, the plate may rise or rest: the positions at rest form a surface, each of them singular. Exact positions,
    no integration.
    """
    watch = Watch(OVERCONSTRAINED["sarrus, folded flat"]().mechanism)
    for sign in (1.0, -1.0):
        q = lifted(sign * angle)
        for part, accepted in ((-0.8, True), (0.5, True)):
            assert watch.begin(q) == singular.BIFURCATION
            assert watch.motion.formulation.workspace.critical["lost"] == 2
            np.testing.assert_allclose(watch.motion.formulation.workspace.q_c, lifted(0.0), atol=1e-9)
            assert watch.passes(lifted(part * sign * angle)) == accepted
        for one in (0.8, 0.3, -0.3, -0.8):
            for other in (0.8, 0.3, -0.3, -0.8):
                watch.begin(q)
                assert not watch.passes(resting(one * angle, other * angle)), (one, other)

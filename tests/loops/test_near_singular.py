"""Near and in singular configurations and with redundant equations every solver is right or refuses."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from judge import judge, truth
from mechanisms import CASES, GAPS, grashof, parallelogram

from mbfmu.mechanics import CompiledMechanism
from solvers import Options, Switching, stepper

NAMED = ("three cranks", "three cranks, singular", "table", "double parallelogram, singular", "slider-crank + 1e-5")
FOUR_BARS = {"rocker": parallelogram, "ground": grashof}


@cache
def known(make, stop_time, **options):
    """The case and its truth over ``stop_time``, s."""
    case = make(**options)
    return case.mechanism, truth(case.mechanism, np.linspace(0.0, stop_time, 41), case.exact)


@pytest.mark.parametrize("solver", ["ida", "adams", "hybrid", "radau"])
@pytest.mark.parametrize("gap", [*GAPS[::2], -1e-09, -1e-06])
@pytest.mark.parametrize("name", FOUR_BARS)
def test_a_four_bar_near_its_singular_position(name, gap, solver):
    mechanism, motion = known(FOUR_BARS[name], 2.0, eps=gap)
    for rtol in (1e-4, 1e-6, 1e-8):
        verdict = judge(mechanism, motion, solver, rtol)
        assert verdict.word == "right", verdict


@pytest.mark.parametrize("solver", ["adams", "hybrid"])
@pytest.mark.parametrize("make", [parallelogram, grashof])
@pytest.mark.parametrize("gap", [1e-9, -1e-9, 1e-8])
def test_a_tolerance_that_rounding_limits_is_raised_with_a_note(make, gap, solver):
    mechanism, motion = known(make, 2.0, eps=gap)
    verdict = judge(mechanism, motion, solver, 1e-10)
    assert verdict.word == "right", verdict
    assert verdict.evaluations < 6000  # noise would make it 20 000
    compiled = CompiledMechanism(mechanism)
    q, v = compiled.assemble()
    run = stepper(solver, compiled.system, 0.0, q, v, Options(rtol=1e-10))
    assert run.diagnostics == ()
    assert run.advance(2.0).ok
    assert 1.0 < run.statistics.coarser < 1e3
    (found,) = run.diagnostics
    assert "misses by" in found.text
    assert "rounding errors" in found.text


@pytest.mark.parametrize("solver", ["ida", "adams", "hybrid", "radau"])
@pytest.mark.parametrize("name", NAMED)
def test_redundant_and_singular_loops(name, solver):
    mechanism, motion = known(CASES[name], 3.0)
    for rtol in (1e-4, 1e-7):
        verdict = judge(mechanism, motion, solver, rtol)
        assert verdict.word == "right", verdict


@pytest.mark.parametrize(
    ("why", "switching"),
    [
        ("left_by_collapse", Switching(collapse_cuts=1)),
        ("left_by_energy", Switching(energy_jump=1e-15)),
    ],
)
def test_what_makes_the_hybrid_leave_lu_near_a_singular_position(why, switching):
    mechanism = grashof(1e-3).mechanism
    compiled = CompiledMechanism(mechanism)
    q, v = compiled.assemble()
    motion = stepper("hybrid", compiled.system, 0.0, q, v, Options(rtol=1e-6, switching=switching))
    assert motion.advance(2.0).ok
    assert getattr(motion.statistics, why) > 0

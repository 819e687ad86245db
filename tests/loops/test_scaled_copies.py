"""No threshold has a unit: a copy of a mechanism in other lengths, masses and times moves bit for bit alike.

The factors are powers of two, so that scaling a number rounds nothing.
"""

from __future__ import annotations

import numpy as np
import pytest
from mechanisms import Scale, crane, grashof, parallelogram, slider_crank, three_cranks
from random_loops import _MAKERS as RANDOM

from mbfmu.mechanics import CompiledMechanism
from solvers import Options, stepper

CASES = {
    "crossing": parallelogram,
    "near miss": lambda scale: grashof(1e-5, scale=scale),
    "slider": lambda scale: slider_crank(-1e-4, scale=scale),
    "redundant": three_cranks,
    "driven": crane,
}
SCALES = {
    "a thousandth": Scale(lengths=2.0**-10),
    "a thousand times": Scale(lengths=2.0**10),
    "light": Scale(masses=2.0**-20),
    "slow": Scale(times=2.0**6),
    "small, heavy and fast": Scale(lengths=2.0**-8, masses=2.0**10, times=2.0**-8),
}


def moved(make, scale, solver, rtol):
    """Run a case; return angles and lengths (k, n) in units of the scale, and what the run took."""
    case = make(scale=scale)
    compiled = CompiledMechanism(case.mechanism)
    q, v = compiled.assemble()
    motion = stepper(solver, compiled.system, 0.0, q, v, Options(rtol=rtol))
    samples = motion.sample(0.3 * scale.times * np.arange(1, 6))
    assert motion.status.ok
    s = motion.statistics
    slides = compiled.system.size != 1.0
    return samples.q / np.where(slides, scale.lengths, 1.0), (s.steps, s.rejected, s.rhs_evals)


@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida", "radau"])
@pytest.mark.parametrize("name", CASES)
def test_a_scaled_copy_takes_the_same_steps_to_the_same_numbers(name, solver):
    q, cost = moved(CASES[name], Scale(), solver, 1e-6)
    for scale in SCALES.values():
        q_scaled, cost_scaled = moved(CASES[name], scale, solver, 1e-6)
        assert cost_scaled == cost
        np.testing.assert_array_equal(q_scaled, q)


def taken(family, seed, scale, solver):
    """How a run of a random loop ended, and what it took."""
    case, _ = RANDOM[family](np.random.default_rng(seed), scale)
    compiled = CompiledMechanism(case.mechanism)
    q, v = compiled.assemble()
    motion = stepper(solver, compiled.system, 0.0, q, v, Options(rtol=1e-6))
    motion.sample(0.1 * case.stop_time * np.arange(1, 4))
    s = motion.statistics
    return motion.status.code, s.steps, s.rejected, s.rhs_evals


@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida", "radau"])
@pytest.mark.parametrize("family", RANDOM)
def test_scaled_copies_of_random_loops_take_the_same_steps(family, solver):
    scales = SCALES["a thousandth"], SCALES["light"], SCALES["small, heavy and fast"]
    for seed in range(100, 106):
        costs = [taken(family, seed, scale, solver) for scale in (Scale(), *scales)]
        assert len(set(costs)) == 1, f"seed {seed}: {costs}"

"""Steps of a fan of loops to another branch, at its singular configurations and next to them: all are found.

Positions are exact, without integration. Next to each other the loops are singular one after the other.
"""

from __future__ import annotations

from itertools import combinations
from math import pi

import numpy as np
import pytest
from fans import fan, parallel, turned
from watch import Watch

from solvers.projection.singular import SINGULAR_PIVOT_RATIO

SPREADS = (0.0, 1e-9, 1e-7, 1e-5, 1e-4, 1e-3, 1e-2, 0.1)  # rad, between the loops
DISTANCES = (0.2, 0.05, 1e-2, 3e-3)  # rad, from the singular configurations before the step
PARTS = (0.3, 0.8, 1.5)  # of it, after the step


def draw(loops: int, spread: float):
    """Tilts of the loops, the first one zero."""
    return np.append(0.0, spread * np.random.default_rng(loops).uniform(-1.0, 1.0, loops - 1))


def begin(watch: Watch, q) -> bool:
    """Begin at q; False: it is nearly singular itself, so that no step can be compared with it."""
    watch.begin(q)
    return watch.motion.formulation.workspace.branch_history["pivot_ratio"][0] >= SINGULAR_PIVOT_RATIO


def choices(loops: int):
    """Some of the sets of 1, 2, ... all loops."""
    return [who for k in range(1, loops + 1) for who in list(combinations(range(loops), k))[:: max(1, k)]]


@pytest.mark.parametrize("spread", SPREADS)
@pytest.mark.parametrize("loops", [1, 2, 3, 5])
def test_folded_loops_are_found(loops: int, spread: float) -> None:
    """Loops fold in the step, whether the column passes all singular configurations or returns before them."""
    tilts, compared = draw(loops, spread), 0
    watch = Watch(fan(tilts).mechanism)
    first, last = pi + tilts.max(), pi + tilts.min()
    for distance in DISTANCES:
        before = parallel(tilts, first + distance)
        for after in (first + part * distance for part in PARTS), (last - part * distance for part in PARTS):
            for angle in after:
                for who in choices(loops):
                    if begin(watch, before):
                        compared += 1
                        assert not watch.passes(parallel(tilts, angle, who)), (distance, angle, who)
    assert compared > 0


@pytest.mark.parametrize("spread", SPREADS)
@pytest.mark.parametrize("loops", [1, 2, 3, 5])
def test_loops_that_turn_by_themselves_are_found(loops: int, spread: float) -> None:
    """The column stays on a base line, and the loops of that line turn in the step."""
    tilts, compared = draw(loops, spread), 0
    watch = Watch(fan(tilts).mechanism)
    for distance in DISTANCES:
        before = parallel(tilts, tilts.max() + distance)
        for turn in (sign * part * distance for part in PARTS for sign in (1.0, -1.0)):
            for who in choices(loops) if spread == 0.0 else [(i,) for i in range(loops)]:
                if begin(watch, before):
                    compared += 1
                    assert not watch.passes(turned(tilts, who, turn)), (distance, turn, who)
    assert compared > 0


@pytest.mark.parametrize("base", [0.0, pi])
@pytest.mark.parametrize("loops", [1, 2, 3, 5])
def test_loops_that_go_on_are_accepted(loops: int, base: float) -> None:
    """Loops that are singular at once pass, or turn back before."""
    tilts = np.zeros(loops)
    watch = Watch(fan(tilts).mechanism)
    for distance in (1e-2, 3e-3):
        for part in (0.8, 0.3, -0.3, -0.8, -1.5):
            if begin(watch, parallel(tilts, base + distance)):
                assert watch.passes(parallel(tilts, base + part * distance)), (distance, part)

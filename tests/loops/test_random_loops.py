"""Random closed loops under every solver: right, or stopped with a message, and never wrong."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from campaign import POINTS
from judge import Truth, judge, truth
from random_loops import draw
from reference import distance
from stored import load

KNOWN = cache(load)
PARTS = 20  # of the seeds: each is one test
RARE = 0.02  # stopped runs, of all
CAMPAIGN = pytest.mark.campaign


@pytest.mark.parametrize("part", [*range(0, PARTS, 2), *(pytest.param(k, marks=CAMPAIGN) for k in range(1, PARTS, 2))])
@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida", "radau"])
def test_none_is_wrong(solver: str, part: int) -> None:
    own = sorted(KNOWN())[part::PARTS]
    stopped = 0
    for seed in own:
        drawn = draw(seed)
        verdict = judge(drawn.case.mechanism, KNOWN()[seed], solver, 1e-6)
        assert verdict.word != "wrong", f"{drawn}: {verdict}"
        stopped += verdict.word == "stopped"
    assert stopped <= max(1.0, RARE * len(own))


def test_there_are_three_hundred_of_every_family() -> None:
    families = [draw(seed).family for seed in KNOWN()]
    assert len(families) >= 300
    assert min(families.count(name) for name in set(families)) >= 20
    assert len(set(families)) == 5


@pytest.mark.parametrize("seed", [3, 17, 40])
def test_what_is_stored_is_what_the_reference_gives(seed: int) -> None:
    case, stored = draw(seed).case, KNOWN()[seed]
    part = 1 + (len(stored.times) - 1) // 4
    new: Truth = truth(case.mechanism, np.linspace(0.0, case.stop_time, POINTS)[:part], case.exact)
    k = len(new.times)
    assert k == part
    bound = 1e-9 * stored.amplification[:k] + 10.0 * stored.doubt[:k]
    assert np.all(distance(case.mechanism, stored.start[1], new.q, stored.q[:k]) <= bound)

"""Motions that begin again at a crossing or close to it, as where an input jumps: right, whatever the distance."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from judge import judge, truth
from mechanisms import CASES, n_four_bar
from scipy.optimize import brentq

CROSSES = {  # the first angle there, rad
    "parallelogram": 0.0,
    "slider-crank": 0.5 * np.pi,
    "three cranks, singular": 0.0,
    "table, singular": 0.0,
    "double parallelogram, singular": 0.0,
    "2 four-bars": 0.0,
    "3 four-bars": 0.0,
}
ASIDE = (-1e-2, -1e-3, -1e-4, -1e-5, -1e-7, 0.0, 1e-7, 1e-4, 1e-3)  # s


@cache
def known(name):
    """The mechanism, its truth, and the times next to its first two crossings."""
    case = n_four_bar(3) if name == "3 four-bars" else CASES[name]()

    def off(t):
        return np.sin(case.exact(np.array((0.0, t)))[0][-1, 0] - CROSSES[name])

    grid = np.linspace(1e-3, 2.0, 400)
    values = np.sin(case.exact(np.append(0.0, grid))[0][1:, 0] - CROSSES[name])
    passed = np.flatnonzero(values[:-1] * values[1:] < 0.0)[:2]
    crossings = [brentq(off, grid[k], grid[k + 1], xtol=1e-14) for k in passed]
    beside = np.add.outer(crossings, ASIDE).ravel()
    times = np.unique(np.concatenate((np.linspace(0.0, 2.0, 41), beside)))
    return case.mechanism, truth(case.mechanism, times, case.exact), beside


@pytest.mark.parametrize(("solver", "finest"), [("ida", 1e-8), ("adams", 1e-10), ("hybrid", 1e-10), ("radau", 1e-10)])
@pytest.mark.parametrize("name", CROSSES)
def test_a_motion_restarts_near_a_crossing(name, solver, finest):
    mechanism, motion, beside = known(name)
    for rtol in (1e-4, 1e-6, finest):
        for restart in beside:
            verdict = judge(mechanism, motion, solver, rtol, restart=float(restart))
            assert verdict.word == "right", (rtol, restart, verdict)

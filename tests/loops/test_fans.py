"""Loops that become singular one after the other, free and driven: right against the exact motion, or refused."""

from __future__ import annotations

from functools import cache
from math import pi

import numpy as np
import pytest
from fans import fan
from judge import judge, truth

from mbfmu.mechanics import Harmonic, Polynomial

SOLVERS = ("adams", "hybrid", "ida", "radau")


def constant(t):
    """Angle and rate of the drive at constant speed."""
    return 0.5 * pi - 2.0 * t, -2.0 + 0.0 * t


def reversing(t):
    """The same for a drive that turns back 0.01 rad behind the horizontal."""
    return 0.495 + 0.505 * np.cos(pi * t), -0.505 * pi * np.sin(pi * t)


DRIVES = {
    "free": {},
    "constant": {"drive": Polynomial((0.5 * pi, -2.0)), "motion": constant},
    "reversing": {
        "drive": Harmonic(amplitude=0.505, frequency=0.5, phase=0.5 * pi, mean=0.495),
        "motion": reversing,
    },
}


@cache
def known(tilts, drive):
    """The mechanism and its exact motion."""
    case = fan(tilts, **DRIVES[drive])
    return case.mechanism, truth(case.mechanism, np.linspace(0.0, 2.0, 41), case.exact)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(
    ("tilts", "drive"),
    [
        ((0.0, 0.3), "free"),
        ((0.0, 0.3, 0.09, 0.66, -0.42), "free"),
        ((0.0, 1e-9), "free"),
        ((0.0, 0.0, 0.0), "constant"),
        ((0.0, 0.01, 0.02), "constant"),
    ],
)
def test_loops_pass_their_singular_positions_one_after_the_other_or_at_once(tilts, drive, solver) -> None:
    mechanism, motion = known(tilts, drive)
    for rtol in (1e-4, 1e-6):
        verdict = judge(mechanism, motion, solver, rtol)
        assert verdict.word == "right", (rtol, verdict)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(
    ("tilts", "drive"),
    [
        ((0.0, 1e-2), "free"),
        ((0.0, 1e-4), "free"),
        ((0.0, 1e-4, 3e-5, 2.2e-4, -1.4e-4), "free"),
        ((0.0, 1e-4, 2e-4), "reversing"),
        ((0.0, 0.1, 0.2), "reversing"),
    ],
)
def test_slightly_different_times_are_right_or_refused(tilts, drive, solver) -> None:
    mechanism, motion = known(tilts, drive)
    for rtol in (1e-4, 1e-6):
        verdict = judge(mechanism, motion, solver, rtol)
        assert verdict.word in ("right", "stopped"), (rtol, verdict)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(
    ("start", "rate", "rtol"),
    [(0.5 * pi, -0.5, 3e-7), (0.4, -1.0, 1e-6), (0.7, -0.5, 1e-6), (0.7, -0.5, 3e-7), (1.0, -2.0, 1e-6)],
)
def test_a_loop_that_is_singular_next_to_others_does_not_change_its_branch(start, rate, rtol, solver) -> None:
    """The first column would stay on one of the base lines, while the loop of that line turns by itself."""
    case = fan((0.0, 1e-4, 3e-5, 2.2e-4, -1.4e-4), start=start, rate=rate)
    motion = truth(case.mechanism, np.linspace(0.0, 2.0, 41), case.exact)
    verdict = judge(case.mechanism, motion, solver, rtol)
    assert verdict.word in ("right", "stopped"), verdict

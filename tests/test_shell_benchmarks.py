"""Standard problems of shells on coarse meshes against what others published; finer ones: `benchmarks/shells.py`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shell_problems as problems
from shell_problems import Problem

import mbfmu as mb


def errors(problem: Problem) -> list[float]:
    """Relative errors of all that was published."""
    found = problem.displacements(mb.equilibrium(problem.mechanism).outputs)
    return [found[name] / value - 1.0 for name, value in problem.published.items()]


def refined(meshes: Sequence[Problem], within: float) -> None:
    """The last mesh comes within, and nearer than the first, in all that was published."""
    coarse, fine = errors(meshes[0]), errors(meshes[-1])
    assert np.abs(fine).max() < within
    assert np.abs(fine).max() < np.abs(coarse).max()


def test_cooks_membrane_by_bodies() -> None:
    refined([problems.cook(n) for n in (4, 8)], 0.02)


def test_a_strip_sheared_far() -> None:
    refined([problems.sheared_strip((n, 1)) for n in (6, 12)], 2e-3)


def test_a_strip_rolled_up() -> None:
    refined([problems.rolled_strip((n, 1), 1.5 * np.pi) for n in (12, 24)], 2e-3)

"""Standard problems of shells on coarse meshes against what others published; finer ones: `benchmarks/shells.py`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
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
    refined([problems.rolled_strip((n, 1), 1.5 * np.pi) for n in (12, 24)], 3e-3)


def test_a_slit_annulus_lifted_far() -> None:
    refined([problems.slit_annulus(cells) for cells in ((24, 4), (30, 6))], 0.015)


@pytest.mark.parametrize("axis", ["z", "y"])
def test_a_thin_twisted_strip(axis: str) -> None:
    refined([problems.twisted_strip(cells, axis, 0.0032) for cells in ((12, 2), (24, 4))], 0.02)


@pytest.mark.parametrize("axis", ["z", "y"])
def test_a_thick_twisted_strip(axis: str) -> None:
    """Where a spring about the normals that is too weak makes the strip softer on every mesh."""
    assert np.abs(errors(problems.twisted_strip((24, 4), axis))).max() < 0.01


def test_a_pinched_hemisphere() -> None:
    """Between 0.093 of Simo, Fox and Rifai and 0.094 of MacNeal and Harder."""
    assert np.abs(errors(problems.pinched_hemisphere(16, 0.02))).max() < 0.01


def test_a_hemisphere_pinched_far() -> None:
    refined([problems.pinched_hemisphere(n, 400.0) for n in (8, 12)], 0.05)


def test_a_cylinder_pulled_flat() -> None:
    assert np.abs(errors(problems.pulled_cylinder((8, 12)))).max() < 0.015


@pytest.mark.parametrize("edges", problems.PLATES)
def test_plates_buckle_at_one_load_whatever_the_tree(edges: str) -> None:
    exact = problems.ritz_buckling_load(edges)
    coarse, *fine = (
        problems.buckling_load(edges, n, way)
        for n, way in ((8, problems.WAYS[0]), *((16, way) for way in problems.WAYS))
    )
    np.testing.assert_allclose(fine, fine[0], rtol=1e-7)
    assert fine[0] == pytest.approx(exact, rel=0.02)
    assert abs(fine[0] - exact) < 0.35 * abs(coarse - exact)


def test_a_clamp_that_ends_inside_an_edge() -> None:
    """The same third is held on both grids: the corners hang alike, as far down on the one as on the other."""
    coarse, fine = (mb.equilibrium(problems.held_sheet(cells)) for cells in ((14, 12), (17, 15)))
    for found in (coarse, fine):
        assert found.outputs["corner"] == pytest.approx(found.outputs["other"], rel=1e-7)
        assert found.iterations < 40  # 90 with the stress of the present strain
    assert fine.outputs["corner"] == pytest.approx(coarse.outputs["corner"], rel=5e-3)

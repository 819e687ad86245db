"""Standard problems of shells on coarse meshes against what others published; finer ones: `benchmarks/shells.py`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.verification.mechanisms import plates, shells
from mbfmu.verification.mechanisms.shells import LoadedShell


def errors(problem: LoadedShell) -> list[float]:
    """Relative errors of all that was published."""
    found = problem.displacements(mb.equilibrium(problem.mechanism).outputs)
    return [found[name] / value - 1.0 for name, value in problem.published.items()]


def refined(meshes: Sequence[LoadedShell], within: float) -> None:
    """The last mesh comes within, and nearer than the first, in all that was published."""
    coarse, fine = errors(meshes[0]), errors(meshes[-1])
    assert np.abs(fine).max() < within
    assert np.abs(fine).max() < np.abs(coarse).max()


def test_cooks_membrane_by_bodies() -> None:
    refined([shells.cook(n) for n in (4, 8)], 0.02)


def test_a_strip_sheared_far() -> None:
    refined([shells.sheared_strip((n, 1)) for n in (6, 12)], 2e-3)


def test_a_strip_rolled_up() -> None:
    refined([shells.rolled_strip((n, 1), 1.5 * np.pi) for n in (12, 24)], 3e-3)


def test_a_slit_annulus_lifted_far() -> None:
    refined([shells.slit_annulus(cells) for cells in ((24, 4), (30, 6))], 0.015)


@pytest.mark.parametrize("axis", ["z", "y"])
def test_a_thin_twisted_strip(axis: str) -> None:
    refined([shells.twisted_strip(cells, axis, 0.0032) for cells in ((12, 2), (24, 4))], 0.02)


@pytest.mark.parametrize("axis", ["z", "y"])
def test_a_thick_twisted_strip(axis: str) -> None:
    """Where a spring about the normals that is too weak makes the strip softer on every mesh."""
    assert np.abs(errors(shells.twisted_strip((24, 4), axis))).max() < 0.01


def test_a_pinched_hemisphere() -> None:
    """Between 0.093 of Simo, Fox and Rifai and 0.094 of MacNeal and Harder."""
    assert np.abs(errors(shells.pinched_hemisphere(16, 0.02))).max() < 0.01


def test_a_hemisphere_pinched_far() -> None:
    refined([shells.pinched_hemisphere(n, 400.0) for n in (8, 12)], 0.05)


def test_a_cylinder_pulled_flat() -> None:
    assert np.abs(errors(shells.pulled_cylinder((8, 12)))).max() < 0.015


@pytest.mark.parametrize("edges", plates.PLATES)
def test_plates_buckle_at_one_load_whatever_the_tree(edges: str) -> None:
    exact = plates.ritz_buckling_load(edges)
    coarse, *fine = (
        plates.buckling_load(edges, n, root)
        for n, root in ((8, plates.ROOTS[0]), *((16, root) for root in plates.ROOTS))
    )
    np.testing.assert_allclose(fine, fine[0], rtol=1e-7)
    assert fine[0] == pytest.approx(exact, rel=0.02)
    assert abs(fine[0] - exact) < 0.35 * abs(coarse - exact)


def held_sheet(cells: tuple[int, int]) -> mb.Mechanism:
    """Return the sheet of the first paper, held by the middle third of an edge, whose ends are nodes."""
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    sheet = mb.add_sheet(
        m, "sheet", length=0.3, width=0.21, thickness=0.3e-3, youngs_modulus=1e10, density=1000.0,
        grid=(cells[0] + 1, cells[1] + 1), supports=[mb.Support("x1", span=(0.07, 0.14))], stretch=True,
    )  # fmt: skip
    for name, k in {"corner": 0, "other": cells[1]}.items():
        m.output(name, sheet.node(0, k).position("y"))
    return m


def test_a_clamp_that_ends_inside_an_edge() -> None:
    """The same third is held on both grids: the corners hang alike, as far down on the one as on the other."""
    coarse, fine = (mb.equilibrium(held_sheet(cells)) for cells in ((14, 12), (17, 15)))
    for found in (coarse, fine):
        assert found.outputs["corner"] == pytest.approx(found.outputs["other"], rel=1e-7)
        assert found.iterations < 40  # 90 with the stress of the present strain
    assert fine.outputs["corner"] == pytest.approx(coarse.outputs["corner"], rel=5e-3)

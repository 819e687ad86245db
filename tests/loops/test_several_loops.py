"""Loops that become singular at once (A02 of the IFToMM library): motions against the exact one, branches exactly."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from judge import judge, truth
from mechanisms import n_four_bar
from watch import Watch

from mbfmu.mechanics import CompiledMechanism
from solvers import Options, stepper
from solvers.projection import singular

SOLVERS = ("adams", "hybrid", "ida", "radau")
CAMPAIGN = pytest.mark.campaign
EVERY = [pytest.param(n, marks=() if n in (4, 9) else CAMPAIGN) for n in range(1, 41)]


@cache
def known(loops: int, grounded: bool):
    """The mechanism and its exact motion, through its first two singular configurations."""
    case = n_four_bar(loops, grounded=grounded)
    return case.mechanism, truth(case.mechanism, np.linspace(0.0, 2.0, 21), case.exact)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("grounded", [False, True])
@pytest.mark.parametrize("loops", EVERY)
def test_any_number_of_loops_passes_its_singular_positions(loops: int, grounded: bool, solver: str) -> None:
    mechanism, motion = known(loops, grounded)
    for rtol in (1e-4, 1e-6, 1e-8):
        verdict = judge(mechanism, motion, solver, rtol)
        assert verdict.word == "right", (rtol, verdict)


def relative(absolute):
    """Joint angles of the serial chain from angles of its links."""
    return np.diff(absolute, prepend=0.0)


def parallel(loops: int, angle: float):
    """All columns at ``angle``, couplers level."""
    links = np.zeros(2 * loops + 1)
    links[0::2] = angle
    return relative(links)


def folded(loops: int, angle: float, first: int):
    """Closed as well: loop ``first`` folded and turned about its fixed hinge, loops before it at rest at zero, loops
    behind it parallel to it.
    """
    links = np.zeros(2 * loops + 1)
    links[2 * first - 1] = angle
    links[2 * first :: 2] = angle
    return relative(links)


@pytest.mark.parametrize(("loops", "solver", "rtol"), [(22, "hybrid", 1e-8), (23, "adams", 1e-6), (40, "hybrid", 1e-4)])
def test_long_chains_are_nearly_singular_far_from_their_singular_positions(
    loops: int, solver: str, rtol: float
) -> None:
    """The smallest pivots are a thousandth of the largest at 0.2 to 0.6 rad, where no critical point is found."""
    mechanism, motion = known(loops, False)
    verdict = judge(mechanism, motion, solver, rtol)
    assert verdict.word == "right", verdict


@pytest.mark.parametrize("loops", [13, 14])
def test_a_crossing_that_lies_behind_is_found_where_pivots_have_no_gap(loops: int) -> None:
    """In serial chains of this length pivots decrease without a gap from 0.05 rad before the singular configuration."""
    mechanism, motion = known(loops, False)
    verdict = judge(mechanism, motion, "ida", 1e-8)
    assert verdict.word == "right", verdict


@pytest.mark.parametrize("loops", [1, 2, 3, 8, 9, 40])
def test_a_jump_of_any_number_of_loops_is_found(loops: int) -> None:
    """Exact positions, no integration: straight passages and returns are accepted; no jump is, whatever the number of
    loops that have gone to another branch.
    """
    watch = Watch(n_four_bar(loops).mechanism)
    for angle in (0.1, 0.01) if loops < 10 else (2e-3,):
        q = parallel(loops, angle)
        for there, accepted in ((parallel(loops, -0.8 * angle), True), (parallel(loops, 0.5 * angle), True)):
            assert watch.begin(q) == singular.BIFURCATION
            critical = watch.motion.formulation.workspace.critical
            assert critical["lost"] == loops
            np.testing.assert_allclose(watch.motion.formulation.workspace.q_c, 0.0, atol=1e-9)
            assert watch.passes(there) == accepted
        for first in sorted({1, min(2, loops), (loops + 1) // 2, loops}):
            for sign in (1.0, -1.0):
                watch.begin(q)
                assert not watch.passes(folded(loops, sign * angle, first)), (angle, first, sign)


@pytest.mark.parametrize("loops", [2, 5, 9])
@pytest.mark.parametrize("gap", [1e-9, 1e-6, -1e-4])
def test_the_gap_of_one_loop_among_others_is_found(loops: int, gap: float) -> None:
    """In the position where all links lie on a line all loops but one are closed, and that one gapes by its excess."""
    compiled = CompiledMechanism(n_four_bar(loops, longer={1 + loops // 2: gap}).mechanism)
    motion = stepper("adams", compiled.system, 0.0, *compiled.assemble(), Options(rtol=1e-6))
    open_by = np.zeros(2 * loops)  # x and y at the feet of the columns: those behind the coupler are off by its excess
    open_by[2 * (loops // 2) :: 2] = gap
    assert motion.formulation.bifurcation_gap(0.0, parallel(loops, 0.02)) == pytest.approx(
        np.linalg.norm(open_by / motion.formulation.workspace.row), rel=1e-3
    )


@cache
def missed(longer: tuple[tuple[int, float], ...]):
    """Three loops, some couplers too long, and the reference as far as it goes."""
    mechanism = n_four_bar(3, longer=dict(longer)).mechanism
    return mechanism, truth(mechanism, np.linspace(0.0, 2.0, 21))


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("longer", [((1, 1e-3), (2, 1e-3), (3, 1e-3)), ((1, -1e-3),), ((3, 1e-3),), ((2, 1e-9),)])
def test_near_misses_of_some_loops_or_all_are_right_or_refused(longer, solver: str) -> None:
    mechanism, motion = missed(longer)
    for rtol in (1e-4, 1e-6):
        verdict = judge(mechanism, motion, solver, rtol)
        allowed = ("right",) if len(longer) == 3 else ("right", "stopped")
        assert verdict.word in allowed, (rtol, verdict)

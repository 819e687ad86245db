"""Accelerations and multipliers with first-order states: against numpy, and without any entry of M of the states."""

from __future__ import annotations

import numpy as np
import pytest

from solvers.outcome import OK
from solvers.projection import lu_partition, projection
from solvers.projection.workspace import Workspace, factor
from solvers.system import Terms

SHAPES = [(0, 3, 0, 2), (1, 4, 1, 3), (3, 5, 2, 4), (3, 3, 3, 2)]  # m, velocities, rank, states


def make_case(m: int, moving: int, rank: int, states: int) -> tuple[Terms, Workspace]:
    """Random terms whose J has no columns of states, with NaN in the rows and columns of the states in M."""
    rng, n = np.random.default_rng(10 * m + moving), moving + states
    terms, work = Terms.allocate(n, n, m), Workspace.allocate(n, n, m, states)
    root = rng.standard_normal((moving, moving))
    terms.M[:] = np.nan
    terms.M[:moving, :moving] = root @ root.T + np.eye(moving)
    mix = np.vstack((np.eye(rank), rng.standard_normal((m - rank, rank))))
    terms.J[:, :moving] = mix @ rng.standard_normal((rank, moving))
    terms.h[:], terms.gamma[:] = rng.standard_normal(n), mix @ rng.standard_normal(rank)
    work.size[:], work.row[:] = rng.uniform(0.5, 2.0, n), rng.uniform(0.5, 2.0, m)
    return terms, work


def check(terms: Terms, moving: int, a: np.ndarray, lam: np.ndarray) -> None:
    """The accelerations are those of numpy, the rates of the states are -h, and the equations of motion hold."""
    M, J, m = terms.M[:moving, :moving], terms.J[:, :moving], len(terms.gamma)
    matrix = np.block([[M, J.T], [J, np.zeros((m, m))]])
    right = np.concatenate((-terms.h[:moving], terms.gamma))
    np.testing.assert_allclose(a[:moving], np.linalg.lstsq(matrix, right)[0][:moving], atol=1e-11)
    np.testing.assert_allclose(M @ a[:moving] + terms.h[:moving] + J.T @ lam, 0.0, atol=1e-11)
    np.testing.assert_array_equal(a[moving:], -terms.h[moving:])


@pytest.mark.parametrize(("m", "moving", "rank", "states"), SHAPES)
def test_accelerations_by_both_partitions_are_those_of_numpy(m: int, moving: int, rank: int, states: int) -> None:
    terms, work = make_case(m, moving, rank, states)
    a, lam = np.full(moving + states, np.nan), np.full(m, np.nan)
    factor(terms, work)
    assert projection.evaluate_regular_acceleration(terms, rank, work, a) == OK
    projection.evaluate_multipliers(terms, rank, work, a, lam)
    check(terms, moving, a, lam)
    if m == 0:
        return
    a[:], lam[:] = np.nan, np.nan
    assert lu_partition.choose_partition(terms, rank, work)
    np.testing.assert_array_equal(work.columns[moving:], np.arange(moving, moving + states))
    assert lu_partition.factor_dependent(terms, rank, work.rows, work.columns, work)
    found = lu_partition.evaluate_dependent_acceleration(terms, rank, work.rows, work.columns, work, a)
    assert found == OK
    lu_partition.evaluate_dependent_multipliers(terms, rank, work.rows, work.columns, work, a, lam)
    check(terms, moving, a, lam)

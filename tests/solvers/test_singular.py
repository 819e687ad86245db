"""Measures that distinguish singular configurations, against numpy's singular values and determinants."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from solvers.linalg import dense
from solvers.projection import critical, orientation
from solvers.projection.workspace import Workspace, factor

SHAPES = [(2, 3, 2), (2, 9, 2), (4, 12, 3), (3, 3, 3), (4, 7, 4), (5, 6, 3), (8, 9, 8), (6, 12, 5)]  # m, n, rank
# smallest singular values; redundant and trivially satisfied equations cannot be distinguished
NEARLY = [(*shape, x) for shape in SHAPES for x in (1e-2, 1e-6, 1e-13, 0.0) if shape[0] == shape[2] or x >= 1e-6]


class Terms(NamedTuple):
    J: Any


def jacobian(rng: Any, m: int, n: int, rank: int) -> tuple[Any, Any]:
    """Rows, and what makes them of ``rank`` independent ones."""
    return rng.standard_normal((rank, n)), np.vstack((np.eye(rank), rng.standard_normal((m - rank, rank))))


@pytest.mark.parametrize(("m", "n", "rank"), SHAPES)
def test_orientation_is_that_of_the_rows_in_the_axes_of_the_last_position(m: int, n: int, rank: int) -> None:
    """Signs of determinants and slopes by C = J Q, whichever rows the factors of today and of then begin with."""
    rng = np.random.default_rng(m + n)
    work = Workspace.allocate(n, n, m)
    found = set()
    for turn in [*np.linspace(0.0, 1.0, 40), *rng.uniform(0.0, 3.0, 40)]:
        A, mix = jacobian(rng, m, n, rank)
        B = A + turn * rng.standard_normal((rank, n))
        factor(Terms(mix @ A), work)
        work.frame[:], work.frame_tau[:], work.frame_pivots[:] = work.A, work.tau, work.pivots
        factor(Terms(mix @ B), work)
        way = orientation.compare_orientation(Terms(mix @ B), rank, work)

        Q = np.eye(n)
        for axis in Q:
            dense.apply_Q(work.frame, work.frame_tau, rank, n, axis)
        np.testing.assert_allclose(A @ Q[rank:].T, 0.0, atol=1e-13)
        before, now = A @ Q.T, B @ Q.T
        positive = np.linalg.det(now[:, :rank]) * np.linalg.det(before[:, :rank]) > 0.0
        slopes = np.linalg.norm(np.linalg.solve(now[:, :rank], now[:, rank:]), axis=0)
        if slopes.max(initial=0.0) <= orientation.SMALL_ROTATION_TANGENT:
            assert way == (orientation.ORIENTATION_KEPT if positive else orientation.ORIENTATION_REVERSED)
        elif slopes.max() <= orientation.MAX_ROTATION_TANGENT:
            assert way == (orientation.LARGE_ROTATION if positive else orientation.INDETERMINATE)
        else:
            assert way == orientation.INDETERMINATE
        found.add(way)
    assert orientation.ORIENTATION_KEPT in found
    assert len(found) > 1


@pytest.mark.parametrize(("m", "n", "rank", "smallest"), NEARLY)
def test_weakest_forces_are_the_left_singular_vector(m: int, n: int, rank: int, smallest: float) -> None:
    rng = np.random.default_rng(m)
    A, mix = jacobian(rng, m, n, rank)
    U, sigma, Vt = np.linalg.svd(mix @ A, full_matrices=False)
    sigma[rank - 1], sigma[rank:] = smallest * sigma[0], 0.0
    terms, work = Terms(U * sigma @ Vt), Workspace.allocate(n, n, m)
    factor(terms, work)
    critical.find_left_null_vector(terms, rank, work)
    assert abs(work.u @ U[:, rank - 1]) == pytest.approx(1.0, abs=1e-9)


def test_damping_leaves_what_is_nearly_singular_where_it_is() -> None:
    rng = np.random.default_rng(3)
    work = Workspace.allocate(3, 3, 2)
    K = rng.standard_normal((7, 7)) @ np.diag((1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1e-6))
    work.K[:], work.g[:] = K, 1.0
    assert critical.solve_damped_step(1e-4, work)
    np.testing.assert_allclose(work.change, np.linalg.solve(K.T @ K + 1e-4 * np.eye(7), K.T @ np.ones(7)), atol=1e-9)
    assert np.abs(work.change).max() < 1e-3 * np.abs(np.linalg.solve(K, np.ones(7))).max()

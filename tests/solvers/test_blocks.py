"""Block elimination along a tree against dense solutions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from solvers.compiled.kernel import kernel
from solvers.compiled.tuple_pointer import pin
from solvers.linalg.blocks import Factors, block_matrices, eliminate, reset, solve_blocks

TREES: list[tuple[list[int], list[int]]] = [
    ([5], [-1]),
    ([1, 2, 3, 4], [1, 2, 3, -1]),
    ([40, 17, 33, 9], [1, 2, 3, -1]),
    ([7, 0, 12, 8, 21], [2, 2, 4, 4, -1]),
    ([6, 30, 4, 16], [1, -1, 3, -1]),
]


def matrix(sizes: list[int], inward: list[int], symmetric: bool) -> Any:
    """A random indefinite matrix with such blocks; of couplings a part is zero."""
    rng = np.random.default_rng(len(sizes))
    at = np.concatenate(([0], np.cumsum(sizes)))
    A = np.zeros((at[-1], at[-1]))
    for k, inner in enumerate(inward):
        own = slice(at[k], at[k + 1])
        A[own, own] = rng.normal(size=(sizes[k], sizes[k])) + np.diag(8.0 * (-1.0) ** np.arange(sizes[k]))
        if inner >= 0:
            other = slice(at[inner], at[inner + 1])
            for rows, columns in ((own, other), (other, own)):
                coupling = rng.normal(size=A[rows, columns].shape)
                coupling[10:20, : coupling.shape[1] // 2] = 0.0
                coupling[-8:-3, 3:] = 0.0
                A[rows, columns] = coupling
    return 0.5 * (A + A.T) if symmetric else A


@kernel
def fill_and_eliminate(k: int, D: Any, U: Any, L: Any, factors: Any) -> bool:
    """Fill the matrices of block k with D, U and L, by columns, and eliminate it."""
    for given, matrix in zip((D, U, L), block_matrices(k, factors)):  # noqa: B905  # kernels have no strict
        for i in range(given.shape[0]):
            for j in range(given.shape[1]):
                matrix[i, j] = given[i, j]
    done: bool = eliminate(k, factors)
    return done


def eliminated(sizes: list[int], inward: list[int], A: Any, symmetric: bool) -> tuple[Any, bool]:
    """The factors of A and whether it is regular; of a symmetric A only the documented half is read."""
    factors, at = pin(Factors.allocate(sizes, inward)), np.concatenate(([0], np.cumsum(sizes)))
    reset(symmetric, False, factors)
    for k, inner in enumerate(inward):
        own = slice(at[k], at[k + 1])
        D = np.ascontiguousarray(A[own, own].T)
        U, L = np.zeros((0, sizes[k])), np.zeros((sizes[k], 0))
        if symmetric:
            D[np.tril_indices(sizes[k], -1)] = np.nan
        if inner >= 0:
            other = slice(at[inner], at[inner + 1])
            U = np.ascontiguousarray(A[own, other].T)
            L = np.full(U.T.shape, np.nan) if symmetric else np.ascontiguousarray(A[other, own].T)
        if not fill_and_eliminate(k, D, U, L, factors):
            return factors, False
    return factors, True


@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize(("sizes", "inward"), TREES)
def test_solutions_are_those_of_the_whole_matrix(sizes: list[int], inward: list[int], symmetric: bool) -> None:
    A = matrix(sizes, inward, symmetric)
    factors, regular = eliminated(sizes, inward, A, symmetric)
    assert regular
    for b in np.random.default_rng(7).normal(size=(2, len(A))):
        x = b.copy()
        solve_blocks(factors, x)
        np.testing.assert_allclose(A @ x, b, atol=1e-9)


@pytest.mark.parametrize("symmetric", [True, False])
def test_a_singular_block_is_reported(symmetric: bool) -> None:
    A = matrix([3, 4], [1, -1], symmetric)
    A[:3, :3] = 0.0
    assert not eliminated([3, 4], [1, -1], A, symmetric)[1]


@pytest.mark.parametrize("size", [1e-18, 1e-9, 1.0, 1e9, 1e14, 1e18])
def test_a_joint_leads_a_body_without_rotational_inertia_in_any_unit(size: float) -> None:
    """[c^2 M, N^T; N, 0] with M of rank three, and N of all directions but p: y = p (p f) / (p c^2 M p)."""
    rng = np.random.default_rng(3)
    parts, (p, *locked) = rng.normal(size=(3, 6)), np.linalg.qr(rng.normal(size=(6, 6)))[0].T
    A, b = np.zeros((11, 11)), np.concatenate((rng.normal(size=6), np.zeros(5)))
    A[:6, :6], A[6:, :6], A[:6, 6:] = size * parts.T @ parts, locked, np.transpose(locked)
    factors, regular = eliminated([11], [-1], A, False)
    assert regular
    expected = p * (p @ b[:6]) / (p @ A[:6, :6] @ p)
    solve_blocks(factors, b)
    np.testing.assert_allclose(b[:6], expected, atol=1e-11 * np.abs(expected).max())

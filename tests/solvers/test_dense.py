"""The small factorizations against numpy."""

from __future__ import annotations

import numpy as np
import pytest

from solvers.linalg import dense, svd

SHAPES = [(1, 1), (2, 3), (5, 3), (3, 3), (5, 10), (0, 2)]


def decomposed(J):
    m, n = J.shape
    U, sigma, W = np.zeros((n, n)), np.zeros(m), np.zeros((m, m))
    svd.decompose(J, m, n, np.zeros((n, m)), np.zeros(m, np.int64), U, sigma, W)
    return U, sigma, W


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("drop", [0, 1])
def test_decompose_has_numpys_singular_values_and_rebuilds_the_matrix(shape, drop):
    rng = np.random.default_rng(1)
    J = rng.standard_normal(shape)
    if drop and shape[0] > 1:
        J[-1] = 2.0 * J[0]
    U, sigma, W = decomposed(J)
    size = min(shape)
    np.testing.assert_allclose(U.T @ U, np.eye(shape[1]), atol=1e-14)
    np.testing.assert_allclose((U[:, :size] * sigma[:size]) @ W[:, :size].T, J.T, atol=1e-13)
    np.testing.assert_allclose(sigma[:size], np.linalg.svd(J, compute_uv=False), atol=1e-14)


def test_a_tiny_singular_value_keeps_its_digits():
    J = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 1e-9]])
    sigma = decomposed(J)[1]
    assert sigma[1] == pytest.approx(1e-9 / np.sqrt(2.0), rel=1e-6)


def test_least_norm_solutions_are_the_pseudo_inverse():
    rng = np.random.default_rng(2)
    J = rng.standard_normal((3, 5))
    J[2] = J[0] - J[1]
    U, sigma, W = decomposed(J)
    y, f = np.zeros(3), rng.standard_normal(5)
    svd.pseudo_inverse_transposed(f, 3, 5, 2, U, sigma, W, y)
    np.testing.assert_allclose(y, np.linalg.pinv(J.T) @ f, atol=1e-13)


def test_full_pivoting_finds_the_rank_and_independent_columns():
    J = np.array([[0.0, 1.0, 0.0, 2.0], [0.0, 2.0, 0.0, 4.0], [0.0, 0.0, 3.0, 0.0]])
    rows, columns = np.zeros(3, np.int64), np.zeros(4, np.int64)
    assert dense.factor_full_pivot(J.copy(), 3, 4, 1e-12, rows, columns) == 2
    assert sorted(columns[:2]) == [2, 3]
    assert sorted(columns) == [0, 1, 2, 3]


@pytest.mark.parametrize("n", [1, 2, 5])
def test_solves(n):
    rng = np.random.default_rng(n)
    A, b = rng.standard_normal((n, n)), rng.standard_normal(n)
    LU, order, x = A.copy(), np.zeros(n, np.int64), np.zeros(n)
    assert dense.factor_lu(LU, n, order)
    dense.solve_lu(LU, n, order, b, x)
    np.testing.assert_allclose(A @ x, b, atol=1e-12)
    dense.solve_lu_transposed(LU, n, order, b.copy(), x)
    np.testing.assert_allclose(A.T @ x, b, atol=1e-12)
    y = b.copy()
    assert dense.solve_positive_definite(A @ A.T, n, y)
    np.testing.assert_allclose(A @ A.T @ y, b, atol=1e-10)


def test_singular_matrices_are_refused():
    assert not dense.factor_lu(np.zeros((2, 2)), 2, np.zeros(2, np.int64))
    assert not dense.solve_positive_definite(np.zeros((2, 2)), 2, np.zeros(2))


@pytest.mark.parametrize("n", [0, 1, 2, 7])
def test_positive_pivots_are_the_dimension_of_a_definite_subspace(n):
    rng = np.random.default_rng(n)
    for _ in range(20):
        A = rng.standard_normal((n, n))
        A = A + A.T + rng.uniform(-3.0, 3.0) * np.eye(n)
        positive = int((np.linalg.eigvalsh(A) > 0.0).sum())
        found = dense.count_positive_pivots(A.copy(), n)
        assert found <= positive
        assert (found == n) == (positive == n)
    signs = np.diag(np.resize([1.0, -2.0, 3.0], n))
    assert dense.count_positive_pivots(signs.copy(), n) == int((np.diag(signs) > 0.0).sum())

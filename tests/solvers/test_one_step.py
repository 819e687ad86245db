"""The formulas of Dormand and Prince: the conditions of order, written out."""

from __future__ import annotations

import numpy as np
import pytest

from solvers.steppers.adams.one_step import N_STAGES, NODES, A, E

B = np.append(A[-1], 0.0)  # the step itself
SQUARE = np.hstack((A, np.zeros((N_STAGES, 1))))


def trees(c: np.ndarray, A: np.ndarray) -> list[tuple[int, np.ndarray, float]]:
    """Order, elementary weight of every stage and its value for exact formulas, of all trees up to five nodes."""
    one = np.ones(len(c))
    Ac, Ac2 = A @ c, A @ c**2
    return [
        (1, one, 1.0),
        (2, c, 1 / 2),
        (3, c**2, 1 / 3),
        (3, Ac, 1 / 6),
        (4, c**3, 1 / 4),
        (4, c * Ac, 1 / 8),
        (4, Ac2, 1 / 12),
        (4, A @ Ac, 1 / 24),
        (5, c**4, 1 / 5),
        (5, c**2 * Ac, 1 / 10),
        (5, Ac**2, 1 / 20),
        (5, c * Ac2, 1 / 15),
        (5, A @ c**3, 1 / 20),
        (5, c * (A @ Ac), 1 / 30),
        (5, A @ (c * Ac), 1 / 40),
        (5, A @ Ac2, 1 / 60),
        (5, A @ (A @ Ac), 1 / 120),
    ]


def test_the_step_is_of_order_five_and_the_other_of_order_four() -> None:
    np.testing.assert_allclose(SQUARE.sum(axis=1), NODES, atol=1e-14)
    misses = []
    for order, weights, value in trees(NODES, SQUARE):
        assert B @ weights == pytest.approx(value, abs=1e-14)
        if order <= 4:
            assert E @ weights == pytest.approx(0.0, abs=1e-14)
        else:
            misses.append(abs(E @ weights))
    assert max(misses) > 1e-4  # the estimate is not zero

"""Constraints that repeat each other, as saddle systems of trees with cut joints meet them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from solvers.compiled.tuple_pointer import pin, unpin
from solvers.projection.tree_constraints import ConstraintScratch, invert_scaled


def pseudo_inverse(S: Any) -> Any:
    """The pseudo-inverse of a matrix whose rows have the size one."""
    scratch = pin(ConstraintScratch.allocate(1, 1, len(S)))
    own = unpin(scratch)
    own.S[:], own.root[:] = S, 1.0
    assert invert_scaled(scratch)
    return own.inverse


def test_pseudo_inverse_shares_what_redundant_rows_carry() -> None:
    rng = np.random.default_rng(0)
    J = rng.normal(size=(3, 8))
    J = np.vstack((J, J[0] + J[1]))
    S = J @ J.T
    lam = pseudo_inverse(S) @ (J @ np.arange(8.0))
    expected: Any = np.linalg.lstsq(J.T, np.arange(8.0), rcond=None)[0]
    np.testing.assert_allclose(lam, expected, atol=1e-12)
    assert np.abs(S @ pseudo_inverse(S) @ S - S).max() == pytest.approx(0.0, abs=1e-12)


def test_matrices_that_are_not_finite_are_refused() -> None:
    scratch = pin(ConstraintScratch.allocate(1, 1, 2))
    unpin(scratch).S[:] = np.nan
    assert not invert_scaled(scratch)

"""Systems whose blocks form a tree, by block elimination from its leaves with LAPACK.

With i the neighbor inward of block k, and c its neighbors outward, whose matrices L_c stand in the rows of k::

    D_k x_k + U_k x_i + sum_c L_c x_c = b_k
    D_i <- D_i - L_k (D_k^-1 U_k),    pivoting inside a diagonal block

A path of blocks is a block-tridiagonal matrix. The elimination is stable where the diagonal blocks stay well
conditioned. Blocks may differ in size.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack
from threadpoolctl import ThreadpoolController

from solvers.system import Array

_threads = ThreadpoolController()


def one_thread() -> Any:
    """Return a context in which BLAS keeps to one thread: blocks of some hundred rows only lose by more."""
    return _threads.limit(limits=1, user_api="blas")


class BlockTree:
    """Factors of a matrix whose blocks are given outer ones first."""

    def __init__(self) -> None:
        self._factors: list[tuple[Array, NDArray[np.int32]]] = []
        self._right: list[Array] = []  # D_k^-1 U_k
        self._left: list[Array] = []  # L_k, in the rows of the neighbor inward
        self._inward: list[int] = []
        self._carried: dict[int, Array] = {}  # sum of L_k D_k^-1 U_k, by the neighbor inward

    def append(self, D: Array, U: Array, L: Array, inward: int) -> bool:
        """Eliminate the next block: D (n, n), U (n, n') to the one inward, L (n', n) from it; False where singular.

        ``inward`` is that block's number, counted as they are appended; -1: there is none, U and L are empty. ``D`` is
        overwritten.
        """
        carried = self._carried.pop(len(self._factors), None)
        if carried is not None:
            D -= carried
        lu, pivots, info = lapack.dgetrf(D, overwrite_a=1) if D.size else (D, np.zeros(0, np.int32), 0)
        if info != 0:
            return False
        right = lapack.dgetrs(lu, pivots, U)[0] if U.size else U
        self._factors.append((lu, pivots))
        self._right.append(right)
        self._left.append(L)
        self._inward.append(inward)
        if inward >= 0:
            self._carried[inward] = L @ right + self._carried.get(inward, 0.0)
        return True

    def solve(self, parts: list[Array]) -> list[Array]:
        """Return the solution for right-hand sides (n_k,) or (n_k, columns)."""
        x = list(parts)
        for k, (lu, pivots) in enumerate(self._factors):
            x[k], inward = lapack.dgetrs(lu, pivots, x[k])[0] if x[k].size else x[k], self._inward[k]
            if inward >= 0:
                x[inward] = x[inward] - self._left[k] @ x[k]
        for k in range(len(x) - 1, -1, -1):
            if self._inward[k] >= 0:
                x[k] = x[k] - self._right[k] @ x[self._inward[k]]
        return x

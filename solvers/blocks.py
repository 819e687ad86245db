"""Block-tridiagonal systems by block elimination with LAPACK: D_k x_k + U_k x_{k+1} + L_k x_{k-1} = b_k.

    D_k <- D_k - L_k (D_{k-1}^-1 U_{k-1}),    pivoting inside a diagonal block

which is stable where the diagonal blocks stay well conditioned. Blocks may differ in size.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack
from threadpoolctl import ThreadpoolController

from .system import Array

_threads = ThreadpoolController()


def one_thread() -> Any:
    """Return a context in which BLAS keeps to one thread: blocks of some hundred rows only lose by more."""
    return _threads.limit(limits=1, user_api="blas")


class BlockTridiagonal:
    """Factors of a matrix whose blocks are given one group after the other, from first to last."""

    def __init__(self) -> None:
        self._factors: list[tuple[Array, NDArray[np.int32]]] = []
        self._right: list[Array] = []  # D_k^-1 U_k
        self._left: list[Array] = []  # L_k, below D_k
        self._carried: Array | None = None  # L_{k+1} D_k^-1 U_k

    def append(self, D: Array, U: Array, L: Array) -> bool:
        """Eliminate the next group: D (n, n), U (n, n') to the next group, L (n', n) from it; False where singular.

        ``D`` is overwritten. For the last group U and L have no columns and no rows.
        """
        if self._carried is not None:
            D -= self._carried
        lu, pivots, info = lapack.dgetrf(D, overwrite_a=1) if D.size else (D, np.zeros(0, np.int32), 0)
        if info != 0:
            return False
        right = lapack.dgetrs(lu, pivots, U)[0] if U.size else U
        self._factors.append((lu, pivots))
        self._right.append(right)
        self._left.append(L)
        self._carried = L @ right
        return True

    def solve(self, parts: list[Array]) -> list[Array]:
        """Return the solution for right-hand sides (n_k,) or (n_k, columns)."""
        forward: list[Array] = []
        for k, (lu, pivots) in enumerate(self._factors):
            b = parts[k] - self._left[k - 1] @ forward[-1] if k else parts[k]
            forward.append(lapack.dgetrs(lu, pivots, b)[0] if b.size else b)
        for k in range(len(forward) - 2, -1, -1):
            forward[k] = forward[k] - self._right[k] @ forward[k + 1]
        return forward

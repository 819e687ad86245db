"""Products of the exact tangent of a large tree, by complex step.

The structured tangent leaves out what changes with the velocities, and what inertia forces of moving drives change with
the positions. The residual itself with an imaginary step of its arguments has all of it: one evaluation, O(n), is one
product (c0 K + c1 C + c2 M) x of

    K the derivative of M a + h + J^T lambda by the coordinates,    C the derivative of h by the velocities.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from solvers.compiled.kernel import kernel
from solvers.compiled.tuple_pointer import pin
from solvers.system import Array, TreeSystem

if TYPE_CHECKING:
    from solvers.compiled.record import Reals

PRODUCT_STEP_SIZE = 1e-30  # imaginary step; its square must be negligible


@kernel
def _retract(retract: Any, q: Reals, dq: Any, data: Any) -> None:
    retract(q, dq, data)


@kernel
def _inverse(
    inverse: Any, t: float, q: Reals, v: Reals, a: Reals, lam: Reals, data: Any, rate: Reals, force: Reals
) -> None:
    inverse(t, q, v, a, lam, data, rate, force)


class Products:
    """Products of the tangent of one large tree at the state given last by :meth:`set_state`."""

    def __init__(self, system: TreeSystem) -> None:
        if system.complex_step is None:
            raise ValueError("the system has no residual on complex numbers")
        self._complex_step = system.complex_step()
        self._data = pin(self._complex_step.data)
        self._rate, self._force = np.zeros(system.nq, complex), np.zeros(system.n, complex)

    def set_state(self, t: float, q: Array, v: Array, a: Array, lam: Array) -> None:
        """Set the state of all later products: (t, q (nq,), v (n,), a (n,), lambda (m,))."""
        self._t = t
        self._q, self._v, self._a, self._lam = (np.array(x, complex) for x in (q, v, a, lam))

    def apply(self, x: Array, c0: float, c1: float, c2: float) -> Array:
        """Return (c0 K + c1 C + c2 M) x, both (n,)."""
        step = PRODUCT_STEP_SIZE * 1j * x
        q = self._q.copy()
        _retract(self._complex_step.retract, q, c0 * step, self._data)
        moving = self._v + c1 * step, self._a + c2 * step
        _inverse(self._complex_step.inverse, self._t, q, *moving, self._lam, self._data, self._rate, self._force)
        return np.asarray(self._force.imag / PRODUCT_STEP_SIZE)

    def matrix(self, c0: float, c1: float, c2: float) -> Array:
        """Return c0 K + c1 C + c2 M (n, n), by one product a column."""
        n = len(self._v)
        return np.array([self.apply(unit, c0, c1, c2) for unit in np.eye(n)]).reshape(n, n).T

"""Ranks of constraints if some are nonholonomic: these restrict velocities, but no positions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mbfmu.util.errors import AssemblyError
from solvers.system import AnySystem, Array

from .rows import DEPENDENT_ROW_PIVOT_RATIO


def position_rank(system: AnySystem, t: float, q: Array) -> int:
    """Return the number of independent constraints of positions at time t, s, and positions q (nq,)."""
    return _rank(_scaled_jacobian(system, t, q)[system.holonomic])


def check_independent(system: AnySystem, t: float, q: Array) -> None:
    """Raise AssemblyError if at q (nq,) a nonholonomic constraint follows from constraints of positions.

    Positions could then not be corrected independently of it.
    """
    J, bound, own = _scaled_jacobian(system, t, q), system.holonomic, system.nonholonomic
    rank = _rank(J[bound])
    if not len(own) or _rank(J) == rank + _rank(J[own]):
        return
    implied = [k for k in own if _rank(J[np.append(bound, k)]) == rank]
    name = system.constraint_names[(implied or own.tolist())[-1]]
    raise AssemblyError(
        f"constraint {name!r} follows from constraints of the positions; allowed: constraints of rolling that are "
        "independent of them. Use grip='lateral' or grip='longitudinal' for this wheel, or remove the other joint that "
        "prevents the same motion"
    )


def _scaled_jacobian(system: AnySystem, t: float, q: Array) -> NDArray[np.float64]:
    terms = system.allocate_terms()
    system.fill_position(t, q, terms)
    return terms.J * system.size / system.row_size[:, np.newaxis]


def _rank(J: Array) -> int:
    sigma = np.linalg.svd(J, compute_uv=False)
    return int(np.count_nonzero(sigma > DEPENDENT_ROW_PIVOT_RATIO * sigma.max(initial=0.0)))

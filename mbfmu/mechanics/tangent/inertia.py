"""How many eigenvalues of a structured tangent are negative, by its factors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .factored import Tangent


def locked_directions(tangent: Tangent) -> int:
    """Return the number of directions that joints lock.

    The blocks hold the motions of bodies and a multiplier for each locked direction: a pair of eigenvalues of both
    signs that T does not have.
    """
    unknowns = len(tangent._unknowns.value.rows)
    free = int(sum(body["nv"] for body in tangent._held[0].value.bodies if body["vf"] >= 0))
    return (unknowns - free) // 2


def count_negative(tangent: Tangent) -> int:
    """Return the number of negative eigenvalues of T, as it was last factored ``averaged``.

    With a border T is T_0 + Z S Z^T, S = [0, 1; 1, 0]; the inertia of [T_0, Z; Z^T, -S] gives that of T by that of T_0
    and of S + Z^T T_0^-1 Z (Sylvester's law of inertia).
    """
    count = tangent._tree.negative - locked_directions(tangent)
    border = tangent._border
    r = len(border.bodies)
    if r:
        equations = np.eye(2 * r) + border.lines @ border.columns.T
        swapped = np.vstack((equations[r:], equations[:r]))
        count += int(np.sum(np.linalg.eigvalsh(0.5 * (swapped + swapped.T)) > 0.0)) - r
    return count

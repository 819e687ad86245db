"""How many eigenvalues of a structured tangent are negative, by its factors."""

from __future__ import annotations

import numpy as np

from .border import Border


def count_negative(within: int, border: Border) -> int:
    """Return the number of negative eigenvalues of T, of which there are ``within`` without its border.

    With a border T is T_0 + Z S Z^T, S = [0, 1; 1, 0]; the inertia of [T_0, Z; Z^T, -S] gives that of T by that of T_0
    and of S + Z^T T_0^-1 Z (Sylvester's law of inertia).
    """
    r = len(border.bodies)
    if not r:
        return within
    swapped = np.vstack((border.equations[r:], border.equations[:r]))
    return within + int(np.sum(np.linalg.eigvalsh(0.5 * (swapped + swapped.T)) > 0.0)) - r

"""Whether an even number of the eigenvalues of a structured tangent is negative."""

from __future__ import annotations

from .factored import Tangent


def even_negative(tangent: Tangent) -> bool:
    """Whether T has an even number, as it was last factored.

    The blocks hold the motions of bodies and, for each that is locked, a multiplier: a pair of eigenvalues of both
    signs that T has not.
    """
    unknowns = len(tangent._unknowns.value.rows)
    free = int(sum(body["nv"] for body in tangent._held[0].value.bodies if body["vf"] >= 0))
    locked = (unknowns - free) // 2
    return tangent._tree.positive == (locked % 2 == 0)

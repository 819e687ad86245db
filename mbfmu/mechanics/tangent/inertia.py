"""How many eigenvalues of a structured tangent are negative."""

from __future__ import annotations

from .factored import Tangent


def negative_eigenvalues(tangent: Tangent) -> int:
    """Return how many T has, as it was last factored, as a symmetric one.

    The blocks hold the motions of bodies and, for each that is locked, a multiplier: a pair of eigenvalues of both
    signs that T has not.
    """
    tree, unknowns = tangent._tree, len(tangent._unknowns.value.rows)
    free = int(sum(b["nv"] for b in tangent._held[0].value.bodies if b["vf"] >= 0))
    return tree.negative - (unknowns - free) // 2

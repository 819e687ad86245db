"""Whether the bodies at the corners of plates and shells are where those belong.

An element identifies its bodies by their order. In crosswise or reversed order they span a cell that is turned
inside out, which has forces, if it does not divide by zero, but has no meaning. The orientations reveal this: they
rotate the element as it is when nothing strains it, and each of its edges must go about that way.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbfmu.util.errors import UserError

if TYPE_CHECKING:
    from mbfmu.mechanics.arrays.load_groups import LoadGroup

MAX_EDGE_ANGLE = np.radians(45.0)  # of an edge: no element is good that far from its own shape


def check_corners(group: LoadGroup) -> None:
    """Raise UserError for an element whose bodies do not span it."""
    cells = np.array([[body.index for body in acting.bodies] for acting in group.acting])
    r, A = (group.bodies[name][cells] for name in ("r", "A"))
    shapes = {id(acting.load): acting.load.natural for acting in group.acting}  # type: ignore[attr-defined]
    corners, axes = (np.array([shapes[id(acting.load)][k] for acting in group.acting]) for k in (0, 1))
    turned = np.einsum("pcij,pckj->pik", A.real, axes)  # the sum over its bodies
    wanted = np.einsum("pij,pcj->pci", turned, np.roll(corners, -1, 1) - corners)
    edges = np.roll(r.real, -1, 1) - r.real
    along, sizes = np.sum(wanted * edges, 2), np.linalg.norm(wanted, axis=2) * np.linalg.norm(edges, axis=2)
    off = np.arccos(np.clip(along / np.where(sizes > 0.0, sizes, np.inf), -1.0, 1.0))  # a right angle of no length
    p, c = np.unravel_index(off.argmax(), off.shape)
    if off[p, c] > MAX_EDGE_ANGLE:
        names = [group.mechanism.bodies[k].name for k in cells[p]]
        raise UserError(
            f"corners of a plate are {names}: from {names[c]!r} to {names[(c + 1) % 4]!r} the direction of its "
            f"edge differs by {np.degrees(off[p, c]):.0f} degrees from the one that the orientations of its "
            f"bodies give; allowed: at most {np.degrees(MAX_EDGE_ANGLE):.0f}, and the bodies at (0, 0), (a, 0), "
            "(a, b), (0, b) of their x-z plane, in this order"
        )

"""Scratch memory of contact evaluation: a part of the state, so that it is complex if the state is."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.dispatch import scratch_record
from solvers.compiled.kernel import inlined

if TYPE_CHECKING:
    from mbfmu.mechanics.records import State

# Results are added up without forces on bodies: of the points that the cell owns; of all its points, those on borders
# with half their share.
ALL_POINTS, OWN_SHARE = 1, 2

CONTACT_REASON = "contact forces change within micrometers, and friction forces within millimeters per second"

CONTACT_SCRATCH = np.dtype(  # of one contact point
    [
        ("c", np.float64, (4, 3)),  # weights (N, a Nx, b Nz) of the four nodes
        ("cx", np.float64, (4, 3)),  # ... derivatives by xi
        ("cz", np.float64, (4, 3)),  # ... by zeta
        ("line", np.float64, (4, 3)),  # cubic that the point is on: its ends, m, and its derivatives there
        ("r", np.float64, (3,)),  # point, m
        ("rx", np.float64, (3,)),  # ... derivatives by xi and zeta
        ("rz", np.float64, (3,)),
        ("v", np.float64, (3,)),  # velocity
        ("f", np.float64, (3,)),  # force on the sheet there
        ("p", np.float64, (3,)),  # point in the axes of the surface
        ("n", np.float64, (3,)),  # normal there, towards the sheet
        ("part", np.float64),  # of the force that is left where the surface ends
        ("by", np.float64, (3, 6)),  # minus its derivatives by r and v
        ("dr", np.float64, (3, 6)),  # how it moves with the six motions of a body
        ("df", np.float64, (3, 6)),  # ... and minus what the force changes by
        ("result", np.float64, (8,)),  # sums over contact points; see the loads
        ("accumulate_only", np.int64),  # ALL_POINTS, OWN_SHARE: add up only; see above
    ],
    align=True,
)

NIP_SCRATCH = np.dtype(  # of a pair of stations
    [
        ("at", np.float64, (2, 2)),  # xi, zeta
        ("part", np.float64, (2,)),
        ("y", np.float64, (2,)),  # off the plane of the nip as the rubber feels it, m
        ("gain", np.float64, (2,)),  # ... its derivative by where the surface is
        ("u", np.float64, (2,)),  # along the feed in the cell, 0 to 1
        ("f", np.float64, (2,)),  # force across, N
        ("lean", np.float64, (2,)),  # slope that the cell's own bending adds
    ],
    align=True,
)


@inlined
def contact_scratch(item: Any, state: State) -> Any:
    """Scratch memory of the contact of a load or a sensor."""
    return scratch_record(item.scratch, CONTACT_SCRATCH, state)


@inlined
def nip_scratch(nip: Any, state: State) -> Any:
    """Scratch memory of a pair of stations."""
    return scratch_record(nip.pair_scratch, NIP_SCRATCH, state)

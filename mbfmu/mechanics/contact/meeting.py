"""Scratch of a contact at work, part of the state so that it is complex where that is."""

from __future__ import annotations

import numpy as np

ALL, OWN = 1, 2

MEETING = np.dtype(  # a contact at work
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
        ("told", np.float64, (8,)),  # sums over what was met; see the loads
        ("silent", np.int64),  # ALL: only these are wanted; OWN: with half of what points on the cell's border feel
    ],
    align=True,
)

GRIP = np.dtype(  # a pair of stations at work
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

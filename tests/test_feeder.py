"""The feeder and what it is made of: sensors of sheets against geometry, paths, skew, jams, its FMU."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mbfmu.mechanics import Mechanism, Plant, Welded, add_sheet

ANGLE, TILT = 0.3, 0.4  # rad


def turned(about: float, tilt: float) -> Any:
    """Rotation about y, then tilted about z."""
    c, s, k, j = np.cos(about), np.sin(about), np.cos(tilt), np.sin(tilt)
    return np.array([[k, -j, 0.0], [j, k, 0.0], [0.0, 0.0, 1.0]]) @ np.array(
        [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]
    )

"""Natural modes with their shapes about a steady state: of small mechanisms all, of large trees the lowest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mbfmu.errors import EquilibriumError
from mbfmu.mechanics import Plant
from mbfmu.steady.linear import Mode
from solvers.projection.saddle import Saddle
from solvers.statics.modes import natural_modes
from solvers.system import Array

ROUNDING = 1e-7  # omega^2 relative to the largest one found, below which it is none; 2e-8 on a free sheet of 51 x 35
SMALL = 1e-6  # rad/s or m/s: velocities at which damping forces are differenced


@dataclass(frozen=True, kw_only=True)
class ModeShape:
    """A mode and how the coordinates take part.

    Attributes
    ----------
    motion
        Change of the coordinates (n,). Of a large tree real and of unit modal mass; else complex and of any scale, the
        motion being the real part of motion exp(s t).
    """

    mode: Mode
    motion: Any


def shapes(plant: Plant, q: Array, count: int, lam: Array) -> list[ModeShape]:
    """Return the lowest modes of a large tree about a steady state q (nq,), lam (m,).

    A motion that nothing resists has the eigenvalue zero. Damping is taken as what each mode alone loses, phi^T D phi;
    velocity-dependent forces that do no work are left out.
    """
    system = plant.system
    n = system.n
    still, saddle = np.zeros(n), Saddle(system)
    saddle.weigh(0.0, q)
    saddle.residual(0.0, q, still, still, lam)
    try:
        values, motions = natural_modes(saddle, min(count, n - system.m - 1))
    except np.linalg.LinAlgError as reason:
        raise EquilibriumError(f"the natural modes were not found: {reason}; ask for fewer") from reason
    values = np.where(np.abs(values) <= ROUNDING * np.abs(values).max(initial=0.0), 0.0, values)
    found = []
    for square, motion in zip(values, motions.T, strict=True):
        there, back = (system.residual(0.0, q, sign * SMALL * motion, still, lam) for sign in (1.0, -1.0))
        decay = 0.5 * float(motion @ (there - back)) / (2.0 * SMALL)
        root = np.sqrt(complex(decay**2 - square))
        found.append(ModeShape(mode=Mode(complex(-decay + root)), motion=motion))
    return found

"""Natural modes with their shapes about a steady state: of most mechanisms all, of very large trees the lowest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.arrays.closing import check_inertia
from mbfmu.steady.linear import Mode, modes_as_text
from mbfmu.util.errors import EquilibriumError
from solvers.linalg.threads import one_thread
from solvers.statics.matrices import MAX_ASSEMBLED_COORDINATES, linearized_matrices
from solvers.statics.modes import lowest_modes
from solvers.statics.spectrum import Spectrum, spectrum_of
from solvers.system import Array

LISTED_MODES = 8  # modes of a large model by which its stability is evaluated, and that are listed


@dataclass(frozen=True, kw_only=True)
class ModeShape:
    """A mode and how the coordinates take part.

    Attributes
    ----------
    motion
        Change of the coordinates (n,). Real and of unit modal mass where nothing damps and no velocity acts; else
        complex and of any scale, the motion being the real part of motion exp(s t).
    """

    mode: Mode
    motion: Any


class ModeShapes(list[ModeShape]):
    """Modes with their shapes, the lowest or slowest first; ``str`` returns a table of their eigenvalues."""

    def __str__(self) -> str:
        """Return eigenvalues, frequencies and damping ratios as a table."""
        return modes_as_text([shape.mode for shape in self])


def find_spectrum(compiled: CompiledMechanism, q: Array, v: Array, lam: Array, count: int = LISTED_MODES) -> Spectrum:
    """Return the eigenvalues of the motion about a steady state q (nq,), v (n,), lam (m,).

    All of them, of a tree with more than LARGEST_ASSEMBLED coordinates the lowest ``count`` at least.

    Raises
    ------
    EquilibriumError
        They were not found.
    """
    system = compiled.system
    try:
        if system.has_matrices:
            check_inertia(system, 0.0, q, v)
            return spectrum_of(linearized_matrices(compiled.complex_system(), 0.0, q, v, lam))
        if system.n <= MAX_ASSEMBLED_COORDINATES:
            with one_thread():
                return spectrum_of(linearized_matrices(system, 0.0, q, v, lam))
        return lowest_modes(system, q, v, lam, min(count, system.n - system.m - 1))
    except np.linalg.LinAlgError as reason:
        raise EquilibriumError(f"the natural modes were not found: {reason}") from reason


def shapes(compiled: CompiledMechanism, q: Array, count: int, lam: Array, v: Array | None = None) -> list[ModeShape]:
    """Return the lowest modes about a steady state q (nq,), lam (m,), v (n,), which is rest by default.

    A motion that nothing resists has the eigenvalue zero.
    """
    v = np.zeros(compiled.system.n) if v is None else v
    return shapes_of(find_spectrum(compiled, q, v, lam, count))[:count]


def shapes_of(spectrum: Spectrum) -> list[ModeShape]:
    """Return the modes of a spectrum with their shapes, slowest first."""
    pairs = zip(spectrum.values, spectrum.motions.T, strict=True)
    return [ModeShape(mode=Mode(complex(s)), motion=motion) for s, motion in pairs]

"""Stress recovery: strains and curvatures of an element at a point as tensors, and their forces and moments."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
TENSOR_FACTORS = np.array([1.0, 1.0, 0.5])  # of (e_xx, e_zz, gamma) and of (w,xx, w,zz, 2 w,xz)


class Recovered(NamedTuple):
    """Components xx, zz, xz of a quantity: ``start`` (3,), and (3, ...) by each of an element's own strains."""

    start: Matrix
    weights: Matrix


def recover(
    strain: Any, curvature: Any, stretching: Matrix, bending: Matrix, *, drawn: Any = 0.0, natural: Any = 0.0
) -> dict[str, Recovered]:
    """Return curvature, moment, strain and force of an element at a point.

    Parameters
    ----------
    strain, curvature
        (e_xx, e_zz, gamma) and (w,xx, w,zz, 2 w,xz), the first axis, by its own strains, the others; None: it does not
        see strains.
    stretching, bending
        (3, 3), N/m and N m: their stiffness.
    drawn, natural
        (3,), curvatures that it has where its own strains are zero, and where nothing bends it.

    Returns
    -------
    dict
        ``curvature``, 1/m, and ``moment``, N m/m; ``strain`` and ``force``, N/m.
    """
    none = np.zeros(3)
    found = {
        "curvature": Recovered(TENSOR_FACTORS * drawn, np.einsum("i,i...->i...", TENSOR_FACTORS, curvature)),
        "moment": Recovered(bending @ (none + drawn - natural), np.tensordot(bending, curvature, 1)),
    }
    if strain is not None:
        found["strain"] = Recovered(none, np.einsum("i,i...->i...", TENSOR_FACTORS, strain))
        found["force"] = Recovered(none, np.tensordot(stretching, strain, 1))
    return found

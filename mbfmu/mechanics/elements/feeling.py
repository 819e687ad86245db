"""What an element feels at a point: strains and curvatures as tensors, and the forces and moments that go with them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
TENSOR = np.array([1.0, 1.0, 0.5])  # of (e_xx, e_zz, gamma) and of (w,xx, w,zz, 2 w,xz)


class Felt(NamedTuple):
    """Components xx, zz, xz of a quantity: ``start`` (3,), and (3, ...) by each of an element's own strains."""

    start: Matrix
    weights: Matrix


def felt(
    strain: Any, curvature: Any, stretching: Matrix, bending: Matrix, *, drawn: Any = 0.0, natural: Any = 0.0
) -> dict[str, Felt]:
    """Return what an element feels at a point.

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
        "curvature": Felt(TENSOR * drawn, np.einsum("i,i...->i...", TENSOR, curvature)),
        "moment": Felt(bending @ (none + drawn - natural), np.tensordot(bending, curvature, 1)),
    }
    if strain is not None:
        found["strain"] = Felt(none, np.einsum("i,i...->i...", TENSOR, strain))
        found["force"] = Felt(none, np.tensordot(stretching, strain, 1))
    return found

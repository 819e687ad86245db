"""What an element feels at a point: strains and curvatures as tensors, and the forces and moments that go with them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
TENSOR = np.array([1.0, 1.0, 0.5])  # of (e_xx, e_zz, gamma) and of (w,xx, w,zz, 2 w,xz)


def components(strain: Any, curvature: Any, stretching: Matrix, bending: Matrix) -> dict[str, Matrix]:
    """Return components xx, zz, xz (the first axis) of what is felt, by an element's own strains (the others).

    Parameters
    ----------
    strain, curvature
        (e_xx, e_zz, gamma) and (w,xx, w,zz, 2 w,xz) by these; None: the element does not see strains.
    stretching, bending
        (3, 3), N/m and N m: their stiffness.

    Returns
    -------
    dict
        ``curvature``, 1/m, and ``moment``, N m/m; ``strain`` and ``force``, N/m.
    """
    felt = {"curvature": np.einsum("i,i...->i...", TENSOR, curvature), "moment": np.tensordot(bending, curvature, 1)}
    if strain is not None:
        felt |= {"strain": np.einsum("i,i...->i...", TENSOR, strain), "force": np.tensordot(stretching, strain, 1)}
    return felt

"""Directions of a wheel that touches a plane."""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers.compiled.kernel import kernel


@kernel
def cross3(a: Any, b: Any) -> Any:
    """a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def dot3(a: Any, b: Any) -> Any:
    """a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def add3(a: Any, x: Any, b: Any) -> Any:
    """a + x b."""
    return a[0] + x * b[0], a[1] + x * b[1], a[2] + x * b[2]


@kernel
def heading(e: Any, n: Any) -> Any:
    """s = |e x n|, t = e x n / s and u = e x t for an axle e and a normal n."""
    across = cross3(e, n)
    s = np.sqrt(dot3(across, across))
    t = across[0] / s, across[1] / s, across[2] / s
    return s, t, cross3(e, t)

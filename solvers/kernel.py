"""The one place that knows numba: how kernels, callbacks and record arrays are made.

A *kernel* is a closed compiled function: scalar loops, no allocation, no exceptions, no Python objects,
out-parameters last. A *callback* is a kernel with a fixed signature that a solver receives as an argument;
numba types it by signature only, so the solver compiles once, is cached, and serves every system.

With ``NUMBA_DISABLE_JIT=1`` everything here is plain Python, for coverage and debugging.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

F = TypeVar("F", bound=Callable[..., Any])

COMPILED: bool = not numba.config.DISABLE_JIT


def kernel(function: F) -> F:
    """Compile a closed function on first use and keep the machine code on disk."""
    return cast(F, numba.njit(cache=True, error_model="numpy")(function))


def callback(signature: Any) -> Callable[[F], F]:
    """Compile a function for one signature, so that it can be passed to a kernel as an argument."""

    def compile_(function: F) -> F:
        if not COMPILED:
            return function
        return cast(F, numba.cfunc(signature, cache=True, error_model="numpy")(function))

    return compile_


def records(count: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return ``count`` zeroed records whose fields kernels reach as attributes (``bodies[i].mass``)."""
    array = np.zeros(count, dtype)
    return array if COMPILED else array.view(np.recarray)

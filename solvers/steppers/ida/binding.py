"""IDA by way of scikit-sundae, with Python around every call: where :mod:`.sundials` does not serve."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import sksundae.ida
from numpy.typing import NDArray

from solvers.options import Statistics
from solvers.system import Array

from .logging import discard_logs, discard_output
from .loop import go


class BoundIDA:
    """IDA on N unknowns; what :class:`.sundials.DirectIDA` does, and what :func:`.loop.go` finds in its place.

    Parameters
    ----------
    residual
        (t, y, y', out).
    accept
        (t, y, y', data), see :func:`.loop.go`.
    counts, course
        As the loop finds them in its data.
    options
        Of scikit-sundae.
    """

    memory = yy = yp = told_at = 0

    def __init__(
        self, residual: Callable[..., None], accept: Callable[..., int], counts: Array, course: NDArray[Any],
        **options: Any,
    ) -> None:  # fmt: skip
        self._residual, self._options = residual, options
        self.accept, self.counts, self.course = accept, counts, course.view(np.recarray)
        count = len(options["atol"])
        self.y, self.slopes, self.reached = np.zeros(count), np.zeros(count), np.zeros(1)
        self._stop: float | None = None

    def begin(self, t: float, y: Array, slopes: Array) -> None:
        """Begin a history at t (s) with unknowns and their derivatives (N,), tolerances as they are now."""
        self._ida = sksundae.ida.IDA(self._residual, **self._options)  # which copies them
        with discard_logs():
            self._ida.init_step(t, y, slopes)

    def go(self, t: float) -> int:
        """Step until t (s) is passed; see :func:`.loop.go`."""
        with discard_output():
            return int(getattr(go, "py_func", go)(self, self, t))

    def stop_at(self, _memory: int, t: float) -> None:
        """Let the next step end at t (s) if it gets so far."""
        self._stop = t

    def stop_nowhere(self, _memory: int) -> None:
        """Let it end anywhere."""
        self._stop = None

    def solve(self, _memory: int, t: float, *_: Any) -> int:
        """Take a step towards t (s); return IDA's status."""
        result = self._ida.step(t, method="onestep", tstop=self._stop)
        self.reached[0], self.y[:], self.slopes[:] = result.t, result.y, result.yp
        return int(result.status)

    def interpolate(self, t: float) -> Array:
        """Return the unknowns (N,) at t in the last step."""
        with discard_output():
            found: Array = self._ida.step(t).y
        return found

    def told(self) -> Statistics:
        """Return nothing: scikit-sundae does not report it."""
        return Statistics()

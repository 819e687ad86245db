"""IDA through scikit-sundae, with Python around every call: if :mod:`.sundials` cannot call the library."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.template import substitute
from solvers.options import Statistics
from solvers.system import Array

from . import loop
from .logging import discard_logs, discard_output


class BoundIDA:
    """IDA on N unknowns; what :class:`.sundials.DirectIDA` does, and what the hooks of :func:`.loop.step_until` call.

    Parameters
    ----------
    residual
        (t, y, y', out).
    accept
        (t, y, y', data), see :func:`.loop.step_until`.
    counts, progress
        As the loop is given them.
    options
        Of scikit-sundae.
    """

    def __init__(
        self, residual: Callable[..., None], accept: Callable[..., int], counts: Array, progress: NDArray[Any],
        **options: Any,
    ) -> None:  # fmt: skip
        self._residual, self._options = residual, options
        self._accept, self._counts, self._progress = accept, counts, progress.view(np.recarray)
        count = len(options["atol"])
        self.y, self.slopes, self.reached = np.zeros(count), np.zeros(count), np.zeros(1)
        self._stop: float | None = None

    def begin(self, t: float, y: Array, slopes: Array) -> None:
        """Begin a history at t (s) with unknowns and their derivatives (N,), tolerances as they are now."""
        from sksundae.ida import IDA

        self._ida = IDA(self._residual, **self._options)  # which copies them
        with discard_logs():
            self._ida.init_step(t, y, slopes)

    def step_until(self, t: float) -> int:
        """Step until t (s) is passed; see :func:`.loop.step_until`."""
        with discard_output():
            return int(step_until(self, self._progress, self._counts, self._accept, t))

    def stop_at(self, t: float | None) -> None:
        """Stop at t (s) if the next step reaches it; None: nowhere."""
        self._stop = t

    def solve(self, t: float) -> int:
        """Take a step towards t (s); return IDA's status."""
        result = self._ida.step(t, method="onestep", tstop=self._stop)
        self.reached[0], self.y[:], self.slopes[:] = result.t, result.y, result.yp
        return int(result.status)

    def interpolate(self, t: float) -> Array:
        """Return the unknowns (N,) at t in the last step."""
        with discard_output():
            found: Array = self._ida.step(t).y
        return found

    def statistics(self) -> Statistics:
        """Return nothing: scikit-sundae does not report it."""
        return Statistics()


step_until = substitute(
    loop.step_until,
    __name__,
    {
        "solve": BoundIDA.solve,
        "stop_at": BoundIDA.stop_at,
        "clear_stop": lambda ida: ida.stop_at(None),
        "accept": lambda t, y, slopes, accept: accept(t, y, slopes, None),
    },
)

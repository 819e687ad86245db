"""Motions by SciPy from equations of motion that are written by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from .mechanisms.case import ExactMotion
from .problem import NUDGE, Exact, Reference, Solution

Array = NDArray[np.float64]
Right = Callable[[float, Array], Any]  # time, s, and state (s,) -> rates (s,)
Output = Callable[[Array, Array], Any]  # times (k,) and states (s, k) -> quantities, one array (k,) each

FINE_TOLERANCES = {"rtol": 1e-12, "atol": 1e-13}
COARSE_TOLERANCES = {"rtol": 1e-10, "atol": 1e-11}  # for the uncertainty and sensitivities


def integrated(
    right: Right, start: Any, scales: Any, output: Output, stop_time: float, *, method: str = "DOP853"
) -> Exact:
    """Return the motion that SciPy integrates.

    The uncertainty is the difference between two tolerances at the end and at 20 times before it.

    Parameters
    ----------
    right
        Right-hand side of the first-order equations.
    start, scales
        State (s,) at t = 0, and the sizes of its numbers.
    output
        Quantities as functions of times and states.
    stop_time
        End of the motion, s.
    method
        Method of ``scipy.integrate.solve_ivp``; implicit methods, for stiff equations, are run at larger tolerances.
    """
    is_stiff = method in ("Radau", "BDF")
    fine = {"rtol": 1e-11, "atol": 1e-13} if is_stiff else FINE_TOLERANCES
    coarse = {"rtol": 1e-9, "atol": 1e-11} if is_stiff else COARSE_TOLERANCES

    def solution_with(tolerances: dict[str, float]) -> Solution:
        def solution(first: Array, times: Array) -> Array:
            span = (0.0, float(times[-1]))
            found = scipy.integrate.solve_ivp(right, span, first, method=method, t_eval=times, **tolerances)
            if not found.success:
                raise RuntimeError(f"the reference stops: {found.message}")
            return np.column_stack([np.broadcast_to(x, times.shape) for x in output(times, found.y)])

        return solution

    first, times = np.array(start, float), np.linspace(0.0, stop_time, 21)
    solution, rough = solution_with(fine), solution_with(coarse)
    difference = np.abs(solution(first, times) - rough(first, times)).max()
    return Exact(solution, tuple(first), tuple(np.array(scales, float)), float(difference), rough)


def closed_form(solution: Solution, start: Any, scales: Any, size: float) -> Exact:
    """Return the motion of a formula, whose values of the given size have errors of rounding only."""
    return Exact(solution, tuple(np.array(start, float)), tuple(np.array(scales, float)), 1e-13 * size)


@dataclass(frozen=True)
class Pushed:
    """Motion whose sensitivity is measured by random changes at each of the times.

    Errors that are committed in the whole run then appear, also those near a singular configuration.

    Attributes
    ----------
    motion
        Motion of a mechanism, see :mod:`.mechanisms.case`.
    select
        Returns the quantities (k, n) for coordinates and velocities.
    uncertainty
        Largest error of the quantities.
    """

    motion: ExactMotion
    select: Callable[[Any, Any], Array]
    uncertainty: float

    def at(self, times: Array) -> Reference:
        """Return the reference at times (k,), s."""
        values = self.select(*self.motion(times))
        deviation = np.abs(self.select(*self.motion(times, nudge=NUDGE)) - values) / NUDGE
        return Reference(values, np.maximum.accumulate(deviation), self.uncertainty)

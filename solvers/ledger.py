"""What a stepper books beside the motion: work, and how far the tolerance lets the energy stray from it.

Along an exact motion E - W is constant, W the work of all that has no potential. A step ends off the exact motion
through its beginning by its local error e = (e_q, e_v), so to first order a run has

    E(t) - E(0) - W(t) = sum over steps (g . e_q + p . e_v - e_W),      p = dE/dv,  g = dE/dq.

The error control keeps ||e / tol|| <= 1, tol_i = rtol |y_i| + atol_i, so by Cauchy and Schwarz one step adds at most
its *exposure*

    sqrt(sum (p_i tol_i)^2 + sum (g_i tol_i)^2),

and the sum over the steps is what the tolerance explains (``stray``). p is the generalised momentum, all bodies and
drives in it; for g stands the bias h of the equations of motion, which holds the forces of every potential and the same
products of velocities. An energy that is a square of the error is covered: the exposure is taken where a step ends. No
tolerance controls e_W. Driven coordinates count among the others as if they were integrated, since it is through their
momentum and effort that the work errs; and where a formula estimates the errors of its components, that of W is added.

``exchanged`` is the range of the kinetic energy so far, and what W has moved either way.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .kernel import kernel
from .system import Array

FIELDS: list[tuple[str, str]] = [
    ("exposure", "f8"),  # J a step, at the last look
    ("stray", "f8"),  # J, sum of the exposures
    ("most", "f8"),  # J, kinetic energy
    ("least", "f8"),
    ("through", "f8"),  # J, sum of |changes of W|
    ("looks", "i8"),
]
BOOK = np.dtype([*FIELDS, ("steps", "f8")], align=True)  # of a stepper whose steps another one takes
WORK, STRAY, EXCHANGED, MOST, EXPOSURE = 0, 1, 2, 3, 4  # of a reported row
ROW = 5
EVERY, AT_FIRST = 8, 8  # steps between two looks, and looks in a row after the start
BETWEEN = 4.0  # exposures: a reported state is interpolated, and closed


class Scales(NamedTuple):
    """What the exposure is measured by."""

    rtol: Array  # (1,)
    place: Array  # (n,)  absolute tolerances of the free coordinates, and of their rates
    rate: Array  # (n,)
    mean: Array  # (1,)  the error's norm is the root of its mean square over so many; 1: of its sum
    found: Array  # (2,)  exposure in the norm of a sum, and kinetic energy, J

    @staticmethod
    def of(rtol: float, place: Array, rate: Array, mean: int = 1) -> Scales:
        """Return the scales of these tolerances."""
        return Scales(np.array([rtol]), place, rate, np.array([float(mean)]), np.zeros(2))


@kernel
def look(exposure: Any, data: Any, c: Any, s: Any) -> None:
    """Note exposure and kinetic energy; a system's ``exposure`` can be called."""
    exposure(s.rtol[0], s.place, s.rate, data, s.found)
    kinetic = s.found[1]
    if c.looks == 0:
        c.most, c.least = kinetic, kinetic
    c.looks += 1
    c.most, c.least = max(c.most, kinetic), min(c.least, kinetic)
    c.exposure = s.found[0] * np.sqrt(s.mean[0])


@kernel
def due(c: Any) -> bool:
    """Whether a look at the energy is due: the exposure changes slowly."""
    return c.looks < AT_FIRST or c.steps % EVERY == 0


@kernel
def catch_up(exposure: Any, data: Any, c: Any, begun: float, s: Any) -> None:
    """:func:`look`, and add the exposure of the steps since the last time, of ``begun`` in all.

    For an integrator that tells of no steps: those it begins are seen by the new times it evaluates at.
    """
    before = c.exposure
    look(exposure, data, c, s)
    c.stray += (begun - c.steps) * max(before, c.exposure)
    c.steps = begun


@kernel
def report(c: Any, work: float, row: Any) -> None:
    """row (ROW,) = work, stray, exchanged and largest kinetic energy, exposure of a step, J."""
    row[0], row[1], row[2] = work, c.stray + BETWEEN * c.exposure, c.most - c.least + c.through
    row[3], row[4] = c.most, c.exposure

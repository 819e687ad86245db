"""What a stepper books beside the motion: work, and how far the tolerance lets the energy stray from it.

Along an exact motion E - W is constant, W the work of all that has no potential. A step ends off the exact motion
through its beginning by its local error e = (e_q, e_v), so to first order a run has

    E(t) - E(0) - W(t) = sum over steps (g . e_q + p . e_v - e_W),      p = dE/dv,  g = dE/dq.

The error control keeps ||e / tol|| <= 1, tol_i = rtol |y_i| + atol_i, so by Cauchy and Schwarz one step adds at most
its *exposure*

    sqrt(sum (p_i tol_i)^2 + sum (g_i tol_i)^2),

and the sum over the steps is what the tolerance explains (``stray``). p is the generalized momentum, all bodies and
drives in it; for g stands the bias h of the equations of motion, which holds the forces of every potential and the same
products of velocities. An energy that is a square of the error is covered: the exposure is taken where a step ends. No
tolerance controls e_W. Driven coordinates count among the others as if they were integrated, since it is through their
momentum and effort that the work errs; and what a formula for W estimates as its error is added.

``exchanged`` is the range of the kinetic energy so far, and what W has moved either way.

Where another one takes the steps, W is summed here: over each step the integral of the polynomial through the powers
where the last steps ended.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from solvers.compiled.kernel import kernel

from .system import Array

FIELDS: list[tuple[str, str]] = [
    ("exposure", "f8"),  # J a step, at the last look
    ("stray", "f8"),  # J, sum of the exposures
    ("most", "f8"),  # J, kinetic energy
    ("least", "f8"),
    ("through", "f8"),  # J, sum of |changes of W|
    ("looks", "i8"),
]
POINTS = 6  # powers that a polynomial goes through: as many as a formula of order 5 knows states
BOOK = np.dtype(
    [
        *FIELDS, ("steps", "i8"),
        ("before", "f8"), ("work", "f8"),  # J, W where the last step began and ended
        ("known", "i8"), ("at", "f8", POINTS), ("power", "f8", POINTS),  # s, W, where steps ended, the last one first
    ],
    align=True,
)  # fmt: skip
NODES, WEIGHTS = np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)]), np.array([5.0, 8.0, 5.0]) / 9.0  # of Gauss
WORK, STRAY, EXCHANGED, MOST, EXPOSURE = 0, 1, 2, 3, 4  # of a reported row
ROW = 5
EVERY, AT_FIRST, ANEW = 8, 24, 3  # steps between two looks; looks in a row after the start, and after a change
SLIP = 4.0  # what a formula says its error in W is counts so many times: it is an error, where the exposure is a bound
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
def set_scales(s: Any, absolute: float, size: Any, pace: Any) -> None:
    """Take the absolute tolerance, in units ``size`` of the coordinates, whose own rates are ``pace`` (n,), 1/s."""
    for k in range(size.shape[0]):
        s.place[k] = absolute * size[k]
        s.rate[k] = pace[k] * s.place[k]


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
    """Whether a look at the energy is due: the exposure changes slowly, but at the start and where loads jump."""
    return c.looks < AT_FIRST or c.steps % EVERY == 0


@kernel
def look_anew(books: Any) -> None:
    """Let the next steps be looked at one by one: loads have changed. books (1,) of FIELDS."""
    c = books[0]
    c.looks = min(c.looks, AT_FIRST - ANEW)


@kernel
def begin_work(books: Any, work: float) -> None:
    """Forget the powers: the motion goes on from another state, where W is ``work``, J. books (1,) of BOOK."""
    c = books[0]
    c.known, c.work, c.before = 0, work, work
    c.looks = min(c.looks, AT_FIRST - ANEW)


@kernel
def add_step(books: Any, t: float, power: float) -> None:
    """Book a step that ended at t with ``power`` W; the first one only begins."""
    c = books[0]
    for k in range(POINTS - 1, 0, -1):
        c.at[k], c.power[k] = c.at[k - 1], c.power[k - 1]
    c.at[0], c.power[0] = t, power
    c.known = min(c.known + 1, POINTS)
    c.before = c.work
    if c.known > 1:
        done = integral(c, t, c.known)
        c.work += done
        c.steps += 1
        c.through += abs(done)
        c.stray += c.exposure + SLIP * abs(done - integral(c, t, c.known - 1))


@kernel
def work_at(books: Any, t: float) -> float:
    """W at t in the last step, J."""
    c = books[0]
    return c.before + integral(c, t, c.known) if c.known > 1 else c.work


@kernel
def integral(c: Any, t: float, points: int) -> float:
    """Integral from where the last step began to t of the polynomial through so many powers, exactly."""
    middle, half, total = 0.5 * (c.at[1] + t), 0.5 * (t - c.at[1]), 0.0
    for k in range(NODES.shape[0]):
        s = middle + half * NODES[k]
        for i in range(points):
            value = WEIGHTS[k] * c.power[i]
            for j in range(points):
                if j != i:
                    value *= (s - c.at[j]) / (c.at[i] - c.at[j])
            total += value
    return half * total


@kernel
def report(c: Any, work: float, row: Any) -> None:
    """row (ROW,) = work, stray, exchanged and largest kinetic energy, exposure of a step, J."""
    row[0], row[1], row[2] = work, c.stray + BETWEEN * c.exposure, c.most - c.least + c.through
    row[3], row[4] = c.most, c.exposure


@kernel
def report_at(books: Any, t: float, row: Any) -> None:
    """:func:`report` of what is booked, with the work at t in the last step."""
    report(books[0], work_at(books, t), row)

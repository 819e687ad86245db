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
momentum and effort that the work errs; and what a formula for W estimates as its error is added. The largest such
error of a step is ``slip``: at corners of a force, as where a stop releases a body, W errs by more than the motion.

An error estimate is that of a smooth motion. A step that is refused shows that the force has a corner there: the
estimates are then multiplied by the same factor as those of W, and taken in the tolerance that the solver holds them
to, which for 'radau' is looser than the one asked for.

The *extent* of the motion is its largest displacement or velocity in absolute tolerances, whichever is less. A motion
of a few tolerances is not known to a small part of its energy.

``exchanged`` is the range of the kinetic energy so far, and what W has moved either way.

Where another one takes the steps, W is summed here: over each step the integral of the polynomial through the powers
where the last steps ended.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from solvers.compiled.kernel import inlined, kernel

from .system import Array

FIELDS: list[tuple[str, str]] = [
    ("exposure", "f8"),  # J a step, at the last look
    ("stray", "f8"),  # J, sum of the exposures
    ("most", "f8"),  # J, kinetic energy
    ("least", "f8"),
    ("through", "f8"),  # J, sum of |changes of W|
    ("looks", "i8"),
    ("slip", "f8"),  # J, the largest estimated error of the work of one step
    ("corners", "f8"),  # refusals of the step that is being tried, each in tolerances that its error is held to
    ("reach", "f8"),
    ("pace", "f8"),  # the largest displacement and velocity so far, in absolute tolerances
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
WORK, STRAY, EXCHANGED, MOST, EXPOSURE, SLIPPED, EXTENT = range(7)  # of a reported row
ROW = 7
# exposure in the norm of a sum, kinetic energy, J, displacement and velocity in absolute tolerances: entries of what a
# look finds, before the positions at the first look (rad or m, nan before it)
FOUND = 4
EVERY, AT_FIRST, ANEW = 8, 24, 3  # steps between two looks; looks in a row after the start, and after a change
SLIP = 12.0  # estimates of errors are multiplied by this where forces have corners
MESH_ERROR = 100.0  # tolerances: error of a mesh's vibrations that is no reason for a warning
BETWEEN = 4.0  # exposures: a reported state is interpolated, and closed


class Scales(NamedTuple):
    """What the exposure is measured by."""

    rtol: Array  # (1,)
    place: Array  # (n,)  absolute tolerances of the free coordinates, and of their rates
    rate: Array  # (n,)
    mean: Array  # (1,)  the error's norm is the root of its mean square over so many; 1: of its sum
    found: (
        Array  # (4 + n,)  see FOUND: exposure, kinetic energy, J; displacement, velocity; positions at the first look
    )
    extent: Array  # (2,)  by which displacement and velocity are multiplied, to be in tolerances of the motion

    @staticmethod
    def of(rtol: float, place: Array, rate: Array, mean: int = 1, extent: tuple[float, float] = (1.0, 1.0)) -> Scales:
        """Return the scales of these tolerances."""
        found = np.concatenate((np.zeros(FOUND), np.full(len(place), np.nan)))
        return Scales(np.array([rtol]), place, rate, np.array([float(mean)]), found, np.array(extent))

    @staticmethod
    def of_mesh(rtol: float, place: Array, rate: Array, mean: int, looser: float) -> Scales:
        """Return those of a mesh, whose stiff modes are damped on purpose; its rates have ``looser`` tolerances."""
        return Scales.of(rtol, place, rate, mean, (1.0 / MESH_ERROR, looser / MESH_ERROR))


@kernel
def set_scales(s: Any, absolute: float, size: Any, pace: Any) -> None:
    """Take the absolute tolerance, in units ``size`` of the coordinates, whose own rates are ``pace`` (n,), 1/s."""
    for k in range(size.shape[0]):
        s.place[k] = absolute * size[k]
        s.rate[k] = pace[k] * s.place[k]
        s.found[FOUND + k] = np.nan


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
    c.reach, c.pace = max(c.reach, s.extent[0] * s.found[2]), max(c.pace, s.extent[1] * s.found[3])


@kernel
def due(c: Any) -> bool:
    """Whether a look at the energy is due: the exposure changes slowly, but at the start and where loads jump."""
    return c.looks < AT_FIRST or c.steps % EVERY == 0 or c.corners > 0.0


@kernel
def look_anew(books: Any) -> None:
    """Let the next steps be looked at one by one: loads have changed. books (1,) of FIELDS."""
    c = books[0]
    c.looks = min(c.looks, AT_FIRST - ANEW)


@inlined
def refuse_step(c: Any, looser: float) -> None:
    """Count a step that is refused; ``looser`` is the tolerance that its error exceeds in tolerances asked for, 0.0 if
    another test refuses it.
    """
    c.rejected += 1
    c.corners += looser


@inlined
def book_stray(c: Any, error: float) -> None:
    """Add what a step may have changed the imbalance by; ``error`` is the estimated error of its work, J."""
    c.slip = max(c.slip, abs(error))
    c.stray += (1.0 + SLIP * c.corners) * c.exposure + SLIP * abs(error)
    if c.corners > 0.0:
        c.corners, c.looks = 0.0, min(c.looks, AT_FIRST - ANEW)


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
        book_stray(c, done - integral(c, t, c.known - 1))


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
    """row (ROW,) = work, stray, exchanged and largest kinetic energy, exposure of a step, largest error of the work of
    one, J, and the extent of the motion in absolute tolerances.
    """
    row[0], row[1], row[2] = work, c.stray + BETWEEN * c.exposure, c.most - c.least + c.through
    row[3], row[4], row[5], row[6] = c.most, c.exposure, SLIP * c.slip, min(c.reach, c.pace)


@kernel
def report_at(books: Any, t: float, row: Any) -> None:
    """:func:`report` of what is booked, with the work at t in the last step."""
    report(books[0], work_at(books, t), row)

"""Energy accounting of a stepper: accumulated work W of forces without potential, and a bound of the energy error.

Along an exact motion E - W is constant, where W is the work of all forces without a potential. A step ends off the
exact motion through its beginning by its local error e = (e_q, e_v), so to first order a run has

    E(t) - E(0) - W(t) = sum over steps (g . e_q + p . e_v - e_W),      p = dE/dv,  g = dE/dq.

The error control keeps ||e / tol|| <= 1, tol_i = rtol |y_i| + atol_i, so by Cauchy and Schwarz one step adds at most
its *exposure*

    sqrt(sum (p_i tol_i)^2 + sum (g_i tol_i)^2),

and the sum over the steps is the energy error that the tolerance explains (``stray``). p is the generalized momentum of
all bodies, including drives. g is approximated by the bias h of the equations of motion, which contains the forces of
all potentials and the same products of velocities. An energy that is a square of the error is covered, since the
exposure is evaluated where a step ends. e_W is not controlled by a tolerance. Driven coordinates count among the others
as if they were integrated, since the error of W results from their momentum and force; the error estimate of a formula
for W is added. The largest such error of a step is ``slip``: at corners of a force, as where a stop releases a body,
the error of W is larger than that of the motion.

Error estimates are those of a smooth motion. A rejected step shows that the force has a corner there: the estimates are
then multiplied by the same factor as those of W.

The *extent* of the motion is its largest displacement or velocity in absolute tolerances, whichever is smaller. The
energy of a motion of a few tolerances is not accurate.

A *slow passage* leads past an unstable equilibrium: a pendulum swings over its highest position, or turns just
below it. Its energy is the kinetic energy where it is slowest, or the energy lacking to pass. The momentum times the
velocities of the previous evaluation changes its sign where the motion turns. Every step must be evaluated for that, so
it is done at large tolerances, where steps are few. A passage counts when the kinetic energy has risen again: not if a
motion comes to rest, and not if the work done exceeds the kinetic energy, since inertia is not decisive there.

``exchanged`` is the range of the kinetic energy so far plus the total variation of W.

If another library takes the steps, W is accumulated here: over each step the integral of the polynomial through the
powers at the ends of the last steps.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from solvers.compiled.kernel import inlined, kernel

from .system import Array

SPEEDS = 4  # by which a slow passage is found
FIELDS: list[Any] = [
    ("exposure", "f8"),  # J a step, at the last look
    ("stray", "f8"),  # J, sum of the exposures
    ("most", "f8"),  # J, kinetic energy
    ("least", "f8"),
    ("through", "f8"),  # J, sum of |changes of W|
    ("looks", "i8"),
    ("slip", "f8"),  # J, the largest estimated error of the work of one step
    ("passage", "f8"),  # J, of the last slow passage; 0: there was none
    ("lowest", "f8"),  # J, of one that the motion has yet to leave; 0: there is none
    ("highest", "f8"),  # J, the largest kinetic energy since the last one
    ("seen", "f8"),  # J, kinetic energy at the last look
    ("every", "i8"),  # 1: every step is looked at
    ("unread", "i8"),  # 1: the last look is of this step
    ("sign", "f8"),  # of the speed; it changes where the motion turns
    ("speeds", "f8", SPEEDS),  # root of twice the kinetic energy where the last steps ended, the last one last
    ("lapses", "f8", SPEEDS - 1),  # s, between them; 0: it is not known
    ("corners", "f8"),  # refusals of the step that is being tried, where a force may have a corner
    ("reach", "f8"),
    ("pace", "f8"),  # the largest displacement and velocity so far, in absolute tolerances
]
POINTS = 6  # powers of the polynomial: the number of states of a formula of order 5
BOOK = np.dtype(
    [
        *FIELDS, ("steps", "i8"),
        ("before", "f8"), ("work", "f8"),  # J, W where the last step began and ended
        ("known", "i8"), ("at", "f8", POINTS), ("power", "f8", POINTS),  # s, W, where steps ended, the last one first
    ],
    align=True,
)  # fmt: skip
NODES, WEIGHTS = np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)]), np.array([5.0, 8.0, 5.0]) / 9.0  # of Gauss
WORK, STRAY, THROUGHPUT, MOST, EXPOSURE, SLIPPED, EXTENT, PASSAGE = range(8)  # of a reported row
ROW = 8
# exposure in the norm of a sum, kinetic energy, J, displacement and velocity in absolute tolerances, and the momentum
# times the velocities of the look before, J: entries of what a look finds, before the positions at the first look (rad
# or m, nan before it) and the velocities at the last one
FOUND = 5
# Of the largest kinetic energy, and of what it was in a slow passage: above both the passage is left. Before it the
# energy must have been above the latter, too: errors of a steady speed are no passages.
LEFT, RISEN = 0.1, 4.0
COARSE = 5e-4  # tolerance from which every step is looked at for slow passages
EVERY, AT_FIRST, ANEW = 8, 24, 3  # steps between two looks; looks in a row after the start, and after a change
SLIP = 12.0  # estimates of errors are multiplied by this where forces have corners
# Tolerances: error of a mesh's vibrations that is no reason for a warning, as of other motions that count as right in
# tests; and the largest such error in units of the coordinates: at 1e-2 the whole motion of a sheet is 50 to 120
# tolerances.
MESH_ERROR, LARGEST_MESH_ERROR = 100.0, 1e-2
BETWEEN = 4.0  # exposures: a reported state is interpolated, and closed


class Scales(NamedTuple):
    """What the exposure is measured by."""

    rtol: Array  # (1,)
    place: Array  # (n,)  absolute tolerances of the free coordinates, and of their rates
    rate: Array  # (n,)
    mean: Array  # (1,)  number over which the error's norm takes the mean square; 1: sum of squares
    found: Array  # (5 + 2 n,)  see FOUND
    extent: Array  # (2,)  by which displacement and velocity are multiplied, to be in tolerances of the motion

    @staticmethod
    def of(rtol: float, place: Array, rate: Array, mean: int = 1, extent: tuple[float, float] = (1.0, 1.0)) -> Scales:
        """Return the scales of these tolerances."""
        found = np.concatenate((np.zeros(FOUND), np.full(2 * len(place), np.nan)))
        return Scales(np.array([rtol]), place, rate, np.array([float(mean)]), found, np.array(extent))

    @staticmethod
    def of_mesh(rtol: float, place: Array, rate: Array, mean: int, looser: float) -> Scales:
        """Return those of a mesh, whose stiff modes are damped on purpose; its rates have ``looser`` tolerances."""
        error = max(1.0, min(MESH_ERROR, LARGEST_MESH_ERROR / rtol))
        return Scales.of(rtol, place, rate, mean, (1.0 / error, looser / error))


@kernel
def set_scales(s: Any, absolute: float, size: Any, pace: Any) -> None:
    """Take the absolute tolerance, in units ``size`` of the coordinates, whose own rates are ``pace`` (n,), 1/s."""
    for k in range(size.shape[0]):
        s.place[k] = absolute * size[k]
        s.rate[k] = pace[k] * s.place[k]
        s.found[FOUND + k], s.found[FOUND + size.shape[0] + k] = np.nan, np.nan


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
    c.seen, c.unread, c.every = kinetic, 1, int(s.rtol[0] >= COARSE)
    if c.sign == 0.0:
        c.sign = 1.0
    if c.every == 1 and s.found[4] < 0.0:
        c.sign = -c.sign


@kernel
def due(c: Any) -> bool:
    """Whether a look at the energy is due: the exposure changes slowly, but at the start and where loads jump."""
    return c.looks < AT_FIRST or c.steps % EVERY == 0 or c.corners > 0.0 or c.every == 1


@kernel
def look_anew(books: Any) -> None:
    """Let the next steps be looked at one by one: loads have changed. books (1,) of FIELDS."""
    c = books[0]
    c.looks = min(c.looks, AT_FIRST - ANEW)
    forget_speeds(c)


@inlined
def refuse_step(c: Any, corner: bool) -> None:
    """Count a rejected step; ``corner``: its error may be that of a corner of a force."""
    c.rejected += 1
    if corner:
        c.corners += 1.0


@inlined
def forget_speeds(c: Any) -> None:
    """Let slow passages be found in the steps from here on only."""
    c.lowest, c.highest = 0.0, 0.0
    for k in range(SPEEDS - 1):
        c.lapses[k] = 0.0


@inlined
def note_passage(c: Any, taken: float) -> None:
    """Note whether the steps before the last one, of ``taken`` (s), were a slow passage, and whether it is left.

    Near an unstable equilibrium speeds are proportional to cosh(k t) if the motion passes and to sinh(k t) if it turns.
    """
    s, h = c.speeds, c.lapses
    for k in range(SPEEDS - 1):
        s[k], h[k] = s[k + 1], h[k + 1] if k < SPEEDS - 2 else taken
    s[SPEEDS - 1], low = c.sign * np.sqrt(2.0 * max(0.0, c.seen)), 0.0
    if c.every == 1 and h[0] > 0.0 and c.through < c.most:
        if s[1] * s[2] < 0.0:
            slope = (s[2] - s[1]) / h[1]
            left = 2.0 * (slope - (s[1] - s[0]) / h[0]) / (h[0] + h[1])
            right = 2.0 * ((s[3] - s[2]) / h[2] - slope) / (h[1] + h[2])
            growth = (left * s[1] + right * s[2]) / (s[1] * s[1] + s[2] * s[2])
            if min(left * s[1], right * s[2]) > 0.0:  # at a stop it is one of the two at most
                low = 0.5 * slope * slope / growth
        elif s[0] * s[1] > 0.0 and abs(s[1]) < min(abs(s[0]), abs(s[2])):
            low = 0.5 * s[1] * s[1]
    c.highest = max(c.highest, c.seen)
    if 0.0 < low < c.highest / RISEN and (c.lowest == 0.0 or low < c.lowest):
        c.lowest = low
    if c.lowest > 0.0 and c.seen > max(LEFT * c.most, RISEN * c.lowest):
        c.passage, c.lowest, c.highest = c.lowest, 0.0, c.seen


@inlined
def book_stray(c: Any, error: float, taken: float) -> None:
    """Add the largest change of the energy error in a step of ``taken`` (s); ``error`` is the estimated error of its
    work, J.
    """
    if c.unread == 1:
        note_passage(c, taken)
        c.unread = 0
    else:
        forget_speeds(c)
    c.slip = max(c.slip, abs(error))
    c.stray += (1.0 + SLIP * c.corners) * c.exposure + SLIP * abs(error)
    if c.corners > 0.0:
        c.corners, c.looks = 0.0, min(c.looks, AT_FIRST - ANEW)


@kernel
def begin_work(books: Any, work: float) -> None:
    """Discard the powers: the motion continues from another state, where W is ``work``, J. books (1,) of BOOK."""
    c = books[0]
    c.known, c.work, c.before = 0, work, work
    c.looks = min(c.looks, AT_FIRST - ANEW)
    forget_speeds(c)


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
        book_stray(c, done - integral(c, t, c.known - 1), t - c.at[1])


@kernel
def work_at(books: Any, t: float) -> float:
    """W at t in the last step, J."""
    c = books[0]
    return c.before + integral(c, t, c.known) if c.known > 1 else c.work


@kernel
def integral(c: Any, t: float, points: int) -> float:
    """Exact integral, from the beginning of the last step to t, of the polynomial through the last powers."""
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
    one, J, the extent of the motion in absolute tolerances, and the energy of the last slow passage, J.
    """
    row[0], row[1], row[2] = work, c.stray + BETWEEN * c.exposure, c.most - c.least + c.through
    row[3], row[4], row[5], row[6] = c.most, c.exposure, SLIP * c.slip, min(c.reach, c.pace)
    row[7] = c.passage


@kernel
def report_at(books: Any, t: float, row: Any) -> None:
    """:func:`report` of what is booked, with the work at t in the last step."""
    report(books[0], work_at(books, t), row)

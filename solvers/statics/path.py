"""Equilibrium paths through limit points: steady states over one load p, by pseudo-arc-length.

Unknowns u = (q, lambda, p) of f(u) = [ h + J^T lambda ; Phi ] = 0, see :mod:`.newton`. A step goes along the tangent
t of the path, and Newton corrects it on the bordered system (Keller 1977; in mechanics Riks 1979, Crisfield 1981)

    K x + f_p dp = -f,      <t, u - u_0> = ds,      K = df/d(q, lambda)

by block elimination: K a = -f and K b = -f_p with one factorization, x = a + dp b. K may become singular between two
states: at a limit point, where the path turns back in p, and at a bifurcation, where another one crosses it. The
length is

    <u, u> = |q|^2 / Q^2 + (p / P)^2

with q in units of the coordinates, P the range of the load and Q what it moves the coordinates by where the path
begins, so that neither load nor displacement alone decides. f_p is a central difference.

**Singular points.** Between two states each eigenvalue of K (on the constraints) that changes its sign is either the
limit point's, if dp/ds does so too, or a bifurcation's. A limit point is where dp/ds = 0, a bifurcation where the
eigenvalue nearest to zero is; Brent's method finds both along the step. From a bifurcation a second path leaves along
the critical vector (Wagner and Wriggers 1988): the same corrector, with that vector, less its part along t, for t.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy

from solvers.system import Array

from .linearized import Linearized
from .newton import EQUILIBRIUM_NEWTON_TOLERANCE

MAX_CORRECTOR_ITERATIONS = 9  # of the corrector; more means that the step was too long
EASY_ITERATIONS = 4  # after as many the next step may be longer
STALLED_CORRECTION = 1e-6  # a correction shorter than this, in units, that no longer shrinks is rounding
FIRST_STEP, MIN_STEP = 0.02, 1e-7  # steps, in the length of the path
# of the longest, the first step off a path: near it the other is only as accurate as the crossing
BRANCH_STEP_FRACTION = 0.05
MIN_POINT_DISTANCE = 1e-4  # singular points nearer than this are taken for one
STEP_GROWTH_FACTOR, STEP_REDUCTION_FACTOR = 1.6, 0.5  # changes of the step
MAX_TANGENT_ROTATION = 0.35  # rad, of the tangent in one step
MAX_COORDINATE_CHANGE = 0.2  # change of a coordinate in one step, in its unit
MAX_LOAD_FRACTION = 0.05  # of the range of the load in one step
LOAD_DIFFERENCE_FRACTION = 1e-4  # of that range, for f_p
MIN_DISPLACEMENT = 1e-9  # length of the displacements by the whole load, in units, that are none
EIGENVALUE_ITERATIONS = 8  # inverse iterations for the eigenvalue nearest to zero
POINT_TOLERANCE = 1e-7  # of a step: how well special points are placed in it


class Load(NamedTuple):
    """The load that a path is followed over."""

    apply: Callable[[float], None]
    begin: float
    end: float


@dataclass(frozen=True, kw_only=True)
class State:
    """A steady state on a path.

    Attributes
    ----------
    q, lam, p
        Positions (nq,), multipliers, load.
    x, y, dp
        Tangent, of length one: changes of the coordinates (n,) in their units, of the multipliers, and of the load over
        its range.
    way
        Length along the tangent of the state before.
    unstable
        Negative eigenvalues of the stiffness on the constraints.
    kind
        ``limit point``, ``bifurcation``, or empty.
    critical
        Critical vector (n,) of a bifurcation, in units.
    """

    q: Array
    lam: Array
    p: float
    x: Array
    y: Array
    dp: float
    arclength: float = 0.0
    unstable: int = 0
    kind: str = ""
    critical: Array | None = None


class CorrectorFailedError(Exception):
    """The corrector did not converge."""


class Follower:
    """Follows the paths of one mechanism over one load.

    Parameters
    ----------
    equations, load
        What is followed over what.
    q, lam
        The steady state at the load's beginning.

    Attributes
    ----------
    start
        That state, with the tangent towards the load's end.
    ended
        Reason if the last path ended before the load did.
    """

    def __init__(self, equations: Linearized, load: Load, q: Array, lam: Array) -> None:
        self._equations, self._load, self.ended = equations, load, ""
        self._range = load.end - load.begin
        load.apply(load.begin)
        equations.inspect(q, lam)
        moved = float(np.linalg.norm(self._response(q, lam, load.begin)[0]))
        self._unit = min(moved, np.sqrt(len(equations.size))) if moved > MIN_DISPLACEMENT else 1.0
        at = State(q=q, lam=lam, p=load.begin, x=np.zeros(len(equations.size)), y=0.0 * lam, dp=1.0)
        self.start = self._complete_state(at, at)

    def follow(self, start: State, stop: Callable[[State], float] | None = None) -> Iterator[State]:
        """Yield the states after ``start`` along its tangent, with limit points and bifurcations between them.

        The last one is at the load's end, or as far behind its begin, or where ``stop`` changes its sign.
        """
        here, first, self.ended = start, start.kind == "bifurcation", ""
        step = BRANCH_STEP_FRACTION * self._longest(start) if first else FIRST_STEP
        while True:
            step = min(step, self._longest(here))
            found, count = self._step(here, step)
            turn = np.pi if found is None else float(np.arccos(min(1.0, self._inner(found.x, found.dp, here))))
            if (
                found is None
                or turn > MAX_TANGENT_ROTATION
                or (not first and step > MIN_POINT_DISTANCE and has_hidden_points(here, found))
            ):
                step *= STEP_REDUCTION_FACTOR
                if step < MIN_STEP:
                    self.ended = f"no state was found beyond {here.p:.6g}"
                    return
                continue
            over = self._passed_bound(found.p)
            if over is not None:
                found = self._at_load(here, over, found)
            if not first:
                yield from self._special(here, found)
            if stop is not None and stop(here) * stop(found) < 0.0:
                yield self._locate_zero(here, found, stop)
                return
            yield found
            if over is not None:
                return
            longer = (
                STEP_GROWTH_FACTOR
                if count <= EASY_ITERATIONS and turn < 0.5 * MAX_TANGENT_ROTATION
                else 1.0
                if turn < 0.75 * MAX_TANGENT_ROTATION
                else STEP_REDUCTION_FACTOR
            )
            here, first, step = found, False, longer * step

    def branch_start(self, at: State, sign: float) -> State:
        """Return a bifurcation as the start of the path that crosses there, towards one side (1 or -1)."""
        if at.critical is None:
            raise ValueError("no critical vector is known of this state")
        along = self._inner(at.critical, 0.0, at)
        x, dp = at.critical - along * at.x, -along * at.dp
        length = sign * self._length(x, dp)
        return replace(at, x=x / length, y=0.0 * at.y, dp=dp / length)

    def _inner(self, x: Array, dp: float, of: State) -> float:
        return float(x @ of.x) / self._unit**2 + dp * of.dp

    def _length(self, x: Array, dp: float) -> float:
        return float(np.sqrt(x @ x / self._unit**2 + dp**2))

    def _longest(self, at: State) -> float:
        """Return the step that moves a coordinate or the load as far as a step may."""
        farthest = float(np.abs(at.x).max(initial=0.0))
        return 1.0 / max(farthest / MAX_COORDINATE_CHANGE, abs(at.dp) / MAX_LOAD_FRACTION)

    def _passed_bound(self, p: float) -> float | None:
        """Return the bound of the load that p is beyond, if it is: its end, or as far on the other side."""
        low, high = sorted((2.0 * self._load.begin - self._load.end, self._load.end))
        return low if p < low else high if p > high else None

    def _response(self, q: Array, lam: Array, p: float) -> tuple[Array, Array]:
        """Return what the factored equations move by for the range of the load: coordinates in units, multipliers."""
        sides, equations = [], self._equations
        for side in (-LOAD_DIFFERENCE_FRACTION, LOAD_DIFFERENCE_FRACTION):
            self._load.apply(p + side * self._range)
            sides.append(equations.residual(q, lam))
        self._load.apply(p)
        (f, g), (f_ahead, g_ahead) = sides
        x, y = equations.solve(
            (f - f_ahead) / (2.0 * LOAD_DIFFERENCE_FRACTION), (g - g_ahead) / (2.0 * LOAD_DIFFERENCE_FRACTION)
        )
        return x / equations.size, y

    def _complete_state(self, at: State, before: State) -> State:
        """Return a state with its tangent, in the direction of the previous one, and how unstable it is."""
        self._load.apply(at.p)
        unstable = self._equations.inspect(at.q, at.lam)
        x, y = self._response(at.q, at.lam, at.p)
        length = np.copysign(self._length(x, 1.0), self._inner(x, 1.0, before))
        return replace(at, x=x / length, y=y / length, dp=float(1.0 / length), unstable=unstable)

    def _step(self, here: State, step: float) -> tuple[State | None, int]:
        """Return the state a step along the tangent, and the iterations that took."""
        return self._correct(here, step, here.x / self._unit**2, here.dp, step)

    def _at_load(self, here: State, p: float, beyond: State) -> State:
        """Return the state at a load between two neighbors; the one beyond if there is none."""
        step = beyond.arclength * (p - here.p) / (beyond.p - here.p)
        found, _ = self._correct(here, step, 0.0 * here.x, 1.0, (p - here.p) / self._range)
        return beyond if found is None else replace(found, p=p)

    def _correct(self, here: State, step: float, x: Array, dp: float, value: float) -> tuple[State | None, int]:
        """Run Newton from a step along the tangent to where x . moved + dp moved_p is the value."""
        equations, size = self._equations, self._equations.size
        moved, load, lam = step * here.x, step * here.dp, here.lam + step * here.y
        q, many, before = equations.moved(here.q, size * moved), np.sqrt(len(size)), np.inf
        for count in range(1, MAX_CORRECTOR_ITERATIONS + 1):
            p = here.p + load * self._range
            self._load.apply(p)
            f, g = equations.residual(q, lam)
            if not np.isfinite(f).all() or not equations.factor(q, lam):
                break
            a, y = equations.solve(-f, -g)
            b, z = self._response(q, lam, p)
            a /= size
            slope = float(x @ b) + dp
            change = (value - float(x @ (moved + a)) - dp * load) / slope if slope else np.inf
            a, y = a + change * b, y + change * z
            length = float(np.linalg.norm(a)) + abs(change)
            rounded = before < STALLED_CORRECTION * many
            if not np.isfinite(length) or (count > 2 and length > before and not rounded):
                break
            moved, load, lam, q = moved + a, load + change, lam + y, equations.moved(q, size * a)
            if length <= EQUILIBRIUM_NEWTON_TOLERANCE * many or (rounded and length > 0.5 * before):
                arclength = self._inner(moved, load, here)
                at = replace(
                    here, q=q, lam=lam, p=here.p + load * self._range, arclength=arclength, kind="", critical=None
                )
                return self._complete_state(at, here), count
            before = length
        self._load.apply(here.p)
        return None, MAX_CORRECTOR_ITERATIONS

    def _special(self, here: State, there: State) -> Iterator[State]:
        """Yield the limit point and the bifurcation between two neighbors, as far as there are."""
        limit, changes = here.dp * there.dp < 0.0, abs(there.unstable - here.unstable)
        before = min(here.unstable, there.unstable)  # at the point itself rounding decides
        if limit:
            yield replace(self._locate_zero(here, there, lambda at: at.dp), kind="limit point", unstable=before)
        if changes > limit:
            seed = np.random.default_rng(5).uniform(-1.0, 1.0, len(here.x))

            def nearest(at: State) -> float:
                """Return the size of the eigenvalue nearest to zero, below zero behind the bifurcation."""
                value = self._critical(at, seed)[1]
                return value if at.unstable == here.unstable else -value

            at = self._locate_zero(here, there, nearest)
            yield replace(at, kind="bifurcation", unstable=before, critical=self._critical(at, seed)[0])

    def _critical(self, at: State, x: Array) -> tuple[Array, float]:
        """Return vector (n,) and size of the eigenvalue nearest to zero, by inverse iteration from x."""
        self._load.apply(at.p)
        self._equations.inspect(at.q, at.lam)
        none, size = 0.0 * at.lam, self._equations.size
        for _ in range(EIGENVALUE_ITERATIONS):
            x = x / np.linalg.norm(x)
            before, x = x, self._equations.solve(x / size, none)[0] / size
            if not np.linalg.norm(x) > 0.0:  # exactly singular, and nothing else moves
                return before, 0.0
        value = 1.0 / abs(float(before @ x))
        x = x / np.linalg.norm(x)
        return x * np.sign(x[np.argmax(np.abs(x))]), value

    def _locate_zero(self, here: State, there: State, value: Callable[[State], float]) -> State:
        """Return the state between two neighbors where a value that changes its sign is zero."""
        seen = {0.0: (here, value(here)), there.arclength: (there, value(there))}

        def at(arclength: float) -> float:
            if arclength not in seen:
                found, _ = self._step(here, arclength)
                if found is None:
                    raise CorrectorFailedError
                seen[arclength] = found, value(found)
            return seen[arclength][1]

        with suppress(CorrectorFailedError):
            scipy.optimize.brentq(at, 0.0, there.arclength, xtol=POINT_TOLERANCE * there.arclength)
        return min(seen.values(), key=lambda one: abs(one[1]))[0]


def has_hidden_points(here: State, there: State) -> bool:
    """Whether there is more than one singular point between two states."""
    return abs(there.unstable - here.unstable) > 1 or (here.dp * there.dp < 0.0 and here.unstable == there.unstable)

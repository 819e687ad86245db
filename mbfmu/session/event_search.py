"""Location of events: the first time at which a sensor crosses a value, in the steps of any solver.

After every step the sensors are evaluated at points of the solver's dense output, between which no coordinate moves
far, and where the values between the points may have an extremum, by their rates or by their values. A change of sign
is located by the Illinois variant of the rule of false position (Dowell and Jarratt, *BIT* 11, 1971, 168-174). The time
that is reported is the end of the bracket at which the sign has changed, so that the motion continues on the other
side. At a stop it is the other end: there the motion returns to the side that it comes from, and a value beyond the
stop is a crossing at any time.

A step without dense output is repeated from its beginning to the time that is examined.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.outcome import Code, Status
from solvers.stepper import Stepper, spacing
from solvers.system import Array

POINTS_PER_STEP = 4  # evaluations of the sensors in a step with dense output, its end included
MAX_MOTION = 0.25  # of a coordinate between two evaluations, in its unit
MAX_POINTS_PER_STEP = 1000  # even if coordinates move further between them
TIME_ACCURACY_RATIO = 1e-3  # of a located time, in units of the tolerance times the step
MAX_ROOT_ITERATIONS = 100  # of the search for a root; bisection alone needs 60
MIN_BRACKET_RATIO = 1e-3  # of the values of a bracket, else bisection: the first may be the crossing before
MIN_STEPS_AFTER_RESTART = 8  # to the next event at which the solver restarts
MAX_EXTREMUM_ITERATIONS, MAX_MINIMUM_ITERATIONS = 6, 20  # by values; by values and rates
MAX_EXTREMUM_RATIO = 0.3  # of the values of three points: a parabola with a larger least value does not reach zero


class Point(NamedTuple):
    """Sensors minus the values that they may cross (k,) at a time, s."""

    t: float
    g: Array
    rates: Array  # (k,) of the sensors, nan where they are not known
    speed: float  # 1/s, largest rate of a coordinate in its unit


class EventSearch:
    """Search for the crossings of several sensors.

    Parameters
    ----------
    evaluate
        (t, q, v) -> g, rates: sensors minus the values that they may cross (k,), and their rates (k,); nan: not known.
    size
        Unit of each free coordinate (n,).
    directions
        Sign of the rate at a crossing (k,); 0: any.
    stops
        Which sensors have their values as stops (k,), which are hit in their directions.

    Attributes
    ----------
    sides
        Sign of every sensor minus its value (k,) before the next crossing; 0: not known yet. At a stop it is constant.
    bands
        Distance of every sensor from its value (k,) up to which its side is not known, see :meth:`leave`.
    within
        Longest time between two evaluations, s.
    limit, limited
        Longest step, s, and number of the next steps for which it holds.
    """

    within: float = np.inf
    limit: float = np.inf
    limited: int = 0

    def __init__(
        self,
        evaluate: Callable[[float, Array, Array], tuple[Array, Array]],
        size: Array,
        directions: NDArray[np.int64],
        stops: NDArray[np.bool_],
    ) -> None:
        self._evaluate, self.size, self._directions, self._stops = evaluate, size, directions, stops
        self.sides, self.bands = np.where(stops, -directions, 0), np.zeros(len(stops))

    def begin(self, stepper: Stepper) -> Point:
        """Note the sides at the reported state, at which nothing is a crossing; return the values there."""
        point = self._point(stepper)
        self._note(point)
        return point

    def advance(self, stepper: Stepper, end: float) -> list[int]:
        """Advance to the first crossing before or at ``end`` (s), or to it; return the numbers of the sensors that
        cross there. ``stepper.status`` contains why neither is reached.
        """
        before, taken, earlier = self.begin(stepper), 0, list[Point]()
        while stepper.t < end:
            if taken >= stepper.options.max_steps:
                stepper.status = Status(Code.MAX_STEPS, stepper.t, stepper.fallback_solvers)
                return []
            stepper.step_limit, self.limited = (self.limit, self.limited - 1) if self.limited > 0 else (np.inf, 0)
            is_dense = stepper.has_dense_output
            saved = None if is_dense else stepper.save()
            target = end if is_dense else min(end, before.t + self.within)
            if not stepper.advance_one_step(target).ok:
                return []
            taken += 1
            step = ExaminedStep(self, stepper, (saved, target), before, self._point(stepper))
            if (found := step.search(earlier)) or not stepper.status.ok:
                return found
            before, earlier = step.end, [before]
        return []

    def leave(self, sensors: list[int], bands: Array) -> None:
        """Let these sensors leave their values without a crossing from distances up to ``bands`` (k,), as at a start.

        A quantity that rests at its value has rounding errors of any sign.
        """
        for k in sensors:
            if not self._stops[k]:
                self.sides[k], self.bands[k] = 0, bands[k]

    def restart(self, stepper: Stepper, end: float, restarting: NDArray[np.bool_]) -> None:
        """Restart the solver, and limit its steps so that several lead to the next crossing of sensors at which it
        restarts (k,), or to ``end``, s. A trial shows when that is.
        """
        stepper.restart()
        self.limited, begin, saved, taken = 0, stepper.t, stepper.save(), 0
        sides, bands = self.sides, self.bands
        found, before = list[int](), self._point(stepper)
        while stepper.t < end and taken < MIN_STEPS_AFTER_RESTART and not restarting[found].any():
            stepper.step_limit, step_saved = np.inf, None if stepper.has_dense_output else stepper.save()
            if not stepper.advance_one_step(end).ok:
                break
            taken += 1
            step = ExaminedStep(self, stepper, (step_saved, end), before, self._point(stepper))
            found = step.search([])
            before = self._point(stepper)
        if taken < MIN_STEPS_AFTER_RESTART and stepper.t > begin:
            self.limit, self.limited = (stepper.t - begin) / MIN_STEPS_AFTER_RESTART, MIN_STEPS_AFTER_RESTART
        stepper.restore(saved)
        stepper.status, self.sides = Status(Code.OK, begin, stepper.fallback_solvers), sides
        self.bands = bands

    def _point(self, stepper: Stepper) -> Point:
        q, v, _ = stepper.reported
        speed = float(np.abs(v[: len(self.size)] / self.size).max(initial=0.0))
        return Point(stepper.t, *self._evaluate(stepper.t, q, v), speed)

    def _note(self, point: Point) -> None:
        signs = self._signs(point)
        self.sides = np.where((signs == 0) | self._stops, self.sides, signs)
        self.bands = np.where(signs == 0, self.bands, 0.0)

    def _signs(self, point: Point) -> NDArray[np.int64]:
        signs: NDArray[np.int64] = np.sign(np.where(np.abs(point.g) <= self.bands, 0.0, point.g)).astype(np.int64)
        return signs

    def _crossed(self, point: Point) -> NDArray[np.bool_]:
        """Return which sensors (k,) have crossed their values in their directions at a point."""
        signs = self._signs(point)
        changed = (signs == -self.sides) & (signs != 0)
        return np.asarray(changed & ((self._directions == 0) | (self._directions == signs)))


class ExaminedStep:
    """A part of one step of a solver, in which the motion can be reported at any time again."""

    def __init__(
        self, search: EventSearch, stepper: Stepper, taken: tuple[bytes | None, float], begin: Point, end: Point
    ) -> None:
        self._search, self._stepper = search, stepper
        saved, self._target = taken
        self._saved = None if stepper.has_dense_output else saved
        self.begin, self.end = begin, end
        self._min_width = max(4.0 * spacing(end.t), TIME_ACCURACY_RATIO * stepper.options.rtol * (end.t - begin.t))

    def search(self, earlier: list[Point]) -> list[int]:
        """Make the first crossing the reported state and return which sensors cross there, or report the end.

        ``earlier`` is the point before this step, if there is one.
        """
        points, search = self._points(earlier), self._search
        for a, b in pairwise(points):
            crossed = search._crossed(b)
            if crossed.any():
                brackets = {int(k): self._locate(int(k), a, b) for k in np.flatnonzero(crossed)}
                first = min(after.t for _, after in brackets.values())
                hit = [k for k, (before, _) in brackets.items() if search._stops[k] and before.t < first]
                if hit:
                    self._at(min(brackets[k][0].t for k in hit))
                    return hit
                point = self._at(first)
                passed = np.flatnonzero(search._crossed(point) & ~search._stops)
                search._note(point)
                return [int(k) for k in passed]
            search._note(b)
        if self._stepper.t != self.end.t:
            self._report_end()
        return []

    def _report_end(self) -> None:
        stepper = self._stepper
        if self._saved is None:
            self._at(self.end.t)
        else:  # the same step again
            stepper.restore(self._saved)
            stepper.advance_one_step(self._target)

    def _at(self, t: float) -> Point:
        if self._stepper.t != t:
            self._stepper.return_to(t, self._saved)
        return self._search._point(self._stepper)

    def _points(self, earlier: list[Point]) -> list[Point]:
        """Return the values at points of the step, in which no two crossings of one sensor are between two points."""
        begin, end, search = self.begin, self.end, self._search
        duration = end.t - begin.t
        motion = duration * max(begin.speed, end.speed) / MAX_MOTION
        if self._saved is None:
            motion = max(motion, POINTS_PER_STEP, duration / search.within)
        times = np.linspace(begin.t, end.t, 1 + int(np.ceil(max(1.0, min(motion, MAX_POINTS_PER_STEP)))))
        points = [begin, *(self._at(float(t)) for t in np.unique(times) if begin.t < t < end.t), end]
        added = list[Point]()
        known = [*earlier, *points]
        for k in range(len(search.sides)):
            if np.isnan(end.rates[k]):
                for three in zip(known, known[1:], known[2:], strict=False):
                    added += self._extremum(k, three)
            else:
                for two in pairwise(points):
                    added += self._extremum_by_rates(k, *two)
        return sorted([*points, *added], key=lambda point: point.t)

    def _extremum_by_rates(self, k: int, a: Point, b: Point) -> list[Point]:
        """Return a point between two in which sensor k has another sign than in both, if there is one.

        There is a minimum between them if the rates are of different signs; it is not below the intersection of the
        tangents, if the curve is convex. The intersection, which finds the tip of a distance, and the minimum of the
        cubic through values and rates (Nocedal and Wright, *Numerical Optimization*, 2006, eq. 3.59) are tried by
        turns, and two points on both sides of the minimum remain.
        """
        side = np.sign(b.g[k])
        for i in range(MAX_MINIMUM_ITERATIONS):
            (ga, ra), (gb, rb), h = (side * a.g[k], side * a.rates[k]), (side * b.g[k], side * b.rates[k]), b.t - a.t
            if not (min(ga, gb) >= 0.0 and ra < 0.0 < rb):
                break
            x = (gb - ga - rb * h) / ((ra - rb) * h)
            if ga + ra * x * h > 0.0:
                break
            if i % 2:
                d = ra + rb - 3.0 * (gb - ga) / h
                e = np.sqrt(d * d - ra * rb)
                x = 1.0 - (rb + e - d) / (rb - ra + 2.0 * e)
            if not min(x, 1.0 - x) * h > self._min_width:
                break
            point = self._at(float(a.t + x * h))
            if not side * point.g[k] > 0.0:
                return [point]
            a, b = (point, b) if side * point.rates[k] < 0.0 else (a, point)
        return []

    def _extremum(self, k: int, three: tuple[Point, Point, Point]) -> list[Point]:
        """Return a point between three in which sensor k has another sign than in all of them, if there is one.

        It is searched for by parabolas through three points, of which the two at the least value remain.
        """
        side = np.sign(three[1].g[k])
        for _ in range(MAX_EXTREMUM_ITERATIONS):
            (t0, g0), (t1, g1), (t2, g2) = ((p.t, side * p.g[k]) for p in three)
            if not min(g0, g1, g2) > 0.0:
                break
            left, right = (g1 - g0) / (t1 - t0), (g2 - g1) / (t2 - t1)
            bend = (right - left) / (t2 - t0)
            if not bend > 0.0:
                break
            t = 0.5 * (t0 + t1 - left / bend)
            least = g0 + left * (t - t0) + bend * (t - t0) * (t - t1)
            known = (t0, t1, t2)
            if not max(t0, self.begin.t) < t < t2 or least > MAX_EXTREMUM_RATIO * (
                max(g0, g1, g2) - min(g0, g1, g2, least)
            ):
                break
            if min(abs(t - other) for other in known) <= self._min_width:
                break
            point = self._at(float(t))
            if not side * point.g[k] > 0.0:
                return [point]
            nearest = sorted([*three, point], key=lambda p: abs(p.t - t))[:3]
            first, second, third = sorted(nearest, key=lambda p: p.t)
            three = first, second, third
        return []

    def _locate(self, k: int, a: Point, b: Point) -> tuple[Point, Point]:
        """Return the narrowest bracket (a, b) in which sensor k gets the sign that it has in b; all if a has it too."""
        ga, gb, kept = float(a.g[k]), float(b.g[k]), 0
        if np.sign(ga) == np.sign(gb):
            return a, b
        for i in range(MAX_ROOT_ITERATIONS):
            if b.t - a.t <= self._min_width:
                break
            halves = i % 3 == 2 or abs(ga) < MIN_BRACKET_RATIO * abs(gb)
            t = 0.5 * (a.t + b.t) if halves else b.t - gb * (b.t - a.t) / (gb - ga)
            margin = 0.5 * self._min_width  # so that the bracket closes from both sides
            t = min(max(t, a.t + margin), b.t - margin)
            point = self._at(t)
            g = float(point.g[k])
            if np.sign(g) == np.sign(b.g[k]):
                b, gb = point, g
                ga *= 0.5 if kept == 1 else 1.0
                kept = 1
            else:
                a, ga = point, g
                gb *= 0.5 if kept == -1 else 1.0
                kept = -1
        return a, b

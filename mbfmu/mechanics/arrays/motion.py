"""The motion of a support between the points at which a host prescribes it.

A host sets inputs at communication points; what it sets is meant for the point it stands at, as FMI has it. The
coordinate x of a support never jumps: it is somewhere, x_n, and over the step of length h that follows it goes to where
the host's motion u will be by extrapolation. With the rate v given, and s the time into the step::

    x = x_n + v s + a s^2 / 2 + e (3 (s/h)^2 - 2 (s/h)^3),     e = u_n - x_n
    a_1 = (v_n - v_(n-1)) / H,     a_2 = 2 ((u_n - u_(n-1)) / H - v_(n-1)) / H
    a = minmod(4 a_1 - 3 a_2, 2 a_1, 2 a_2)

H is the step before; 4 a_1 - 3 a_2 is u'' now, of the cubic through both points. So x errs by O(h^3) and x' by O(h^2)
at the end, and the next e takes that back by a motion that begins and ends at rest; in between x'' errs by O(h). Where
u jumps in position or in rate a_1 and a_2 have nothing in common, and minmod (the smallest of numbers of one sign, else
zero; a limiter after van Leer 1977) leaves out what would overshoot. Where the host gives the mean rate
of the step to come a_2 and a are zero, and x is u interpolated linearly.

Without a rate that of the step is what two differences of u agree in, and what has been missed::

    x = x_n + (r + (u_n - x_n) / h) s,     r = minmod((u_n - u_(n-1)) / H, the same a step before)

Where the rate jumps between two steps the mechanism gets an impulse, :func:`impulse`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf, nan
from typing import Any, NamedTuple

from solvers.system import Array


def minmod(*numbers: float) -> float:
    """Return the smallest of numbers of one sign; zero where their signs differ."""
    return max(0.0, min(numbers)) + min(0.0, max(numbers))


class Segment(NamedTuple):
    """A motion from one communication point to the next; positions in m or rad."""

    begin: float  # s
    end: float  # s
    path: tuple[float, ...]  # (4,) coefficients of x in time since the beginning
    goal: float  # x at the end
    position: float  # u at the beginning
    rate: float  # v at the beginning, as the host gave it
    mean: float  # rate of u over the segment before
    jumps: bool  # u is farther off than the rates given explain


class Departure(NamedTuple):
    """A support that changes its motion: its segment and the jump of its rate, m/s or rad/s."""

    motion: InputMotion
    segment: Segment
    jump: float


class InputMotion:
    """One driven coordinate and what a host has said of its motion.

    Parameters
    ----------
    name
        Of the input.
    signal
        Record of the drive's signal, a polynomial; its start is where the support is and how fast it goes.
    speed
        Whether the host sets the speed alone, see :class:`mbfmu.mechanics.signals.SpeedInput`.
    """

    def __init__(self, name: str, signal: Any, *, speed: bool) -> None:
        self.name = name
        self._signal = signal
        self._speed = speed
        self.start()

    def start(self) -> None:
        """Begin as the signal says; nothing is known of the time before."""
        x, v = (float(c) for c in self._signal["c"][:2])
        self._position, self._rate = x, v
        self._set = False  # a position was given since the last point
        self._rated = v != 0.0  # the host gives rates
        self._segment = Segment(-inf, nan, (x, v, 0.0, 0.0), x, x, v, 0.0, False)

    def give(self, coefficient: int, value: float) -> None:
        """Take a position (coefficient 0) or a rate (1) for the point the host stands at."""
        if coefficient == 0:
            self._position, self._set = value, True
        else:
            self._rate, self._rated = value, self._rated or value != 0.0

    def depart(self, t: float, end: float) -> Departure | None:
        """Return how the motion changes at t for a step until ``end`` (s); None where it goes on as it is."""
        if not self._set and self._rate == self._segment.rate and t < self._segment.end and end <= self._segment.end:
            return None  # in the middle of a segment
        segment, (x, v) = self._next(t, end), self._now(t)
        if segment.path != (x, v, 0.0, 0.0) or self._signal["c"][2:].any():
            return Departure(self, segment, segment.path[1] - v)
        self._note(segment)
        return None

    def set_out(self, segment: Segment) -> None:
        """Take up a motion that :meth:`depart` returned."""
        self.follow(segment.begin, segment.path)
        self._note(segment)

    def _note(self, segment: Segment) -> None:
        self._segment, self._position, self._set = segment, segment.position, False

    @property
    def settled(self) -> bool:
        """Whether the motion goes on as it does until the host sets another."""
        _, v, *higher = self._segment.path
        arrived = self._speed or self._rated or (v == 0.0 and self._segment.goal == self._position)
        return arrived and not any(higher) and not self._set and self._rate == self._segment.rate

    def course(self) -> tuple[float, Array]:
        """Return the polynomial that the signal is, to be given to :meth:`follow`."""
        return float(self._signal["t0"]), self._signal["c"].copy()

    def follow(self, t: float, path: Sequence[float] | Array) -> None:
        """Let the signal be a polynomial (4,) about t."""
        self._signal["t0"], self._signal["c"] = t, path

    def perturb(self, t: float, acceleration: float) -> None:
        """Let the signal have an acceleration at t, and the position and rate it has there."""
        self.follow(t, (*self._now(t), 0.5 * acceleration, 0.0))

    def _now(self, t: float) -> tuple[float, float]:
        """Return position and rate at t, before any jump."""
        s, (c0, c1, c2, c3) = t - float(self._signal["t0"]), map(float, self._signal["c"])
        x = self._segment.goal if t == self._segment.end else c0 + s * (c1 + s * (c2 + s * c3))
        return x, c1 + s * (2.0 * c2 + s * 3.0 * c3)

    def _next(self, t: float, end: float) -> Segment:
        """Return the motion from t to ``end``, see the module's docstring."""
        last, h, x = self._segment, end - t, self._now(t)[0]
        v, before = self._rate, t - last.begin
        u = self._position if self._set or not self._rated else x
        if self._speed:
            return Segment(t, end, (x, v, 0.0, 0.0), x + v * h, x, v, 0.0, False)
        mean = (u - last.position) / before if before > 0.0 else last.mean
        if not self._rated:
            r = minmod(mean, last.mean)
            return Segment(t, end, (x, r + (u - x) / h, 0.0, 0.0), u + r * h, u, v, mean, False)
        a = 0.0
        if before > 0.0:
            a1, a2 = (v - last.rate) / before, 2.0 * (mean - last.rate) / before
            a = minmod(4.0 * a1 - 3.0 * a2, 2.0 * a1, 2.0 * a2)
        e = u - x
        path = (x, v, 0.5 * a + 3.0 * e / h**2, -2.0 * e / h**3)
        longest = max(h, before) if before < inf else h
        jumps = abs(e) > longest * (abs(v) + abs(last.rate))
        return Segment(t, end, path, u + h * (v + 0.5 * a * h), u, v, mean, jumps)

    def state(self) -> list[Any]:
        """Return what is remembered, beside the signal, to be given to :meth:`restore`."""
        return [self._position, self._rate, self._set, self._rated, list(self._segment)]

    def restore(self, state: list[Any]) -> None:
        """Remember what was remembered when ``state`` was taken."""
        self._position, self._rate, self._set, self._rated, (begin, end, path, *rest) = state
        self._segment = Segment(begin, end, tuple(path), *rest)


def impulse(t: float, departures: Sequence[Departure], accelerations: Callable[[], Array]) -> Array:
    """Return how the free velocities (n,) jump where the rates of supports do, all at once.

    Over an instant only what is unbounded counts: M dv + J^T dlambda = -m du, J dv = dnu, where m du is the part of h
    that the drives' accelerations make. The same equations give v' by accelerations of du, less that by none.

    Parameters
    ----------
    t
        s
    departures
        What changes; their signals are left perturbed.
    accelerations
        Returns v' (n,) at t for the drives' signals as they are.
    """
    found = []
    for part in (0.0, 1.0):
        for motion, _, jump in departures:
            motion.perturb(t, part * jump)
        found.append(accelerations())
    dv: Array = found[1] - found[0]
    return dv

"""Profiles that wheels roll on, as users give them: checks, and values for messages and pictures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.mechanics import law
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import is_finite, positive
from mbfmu.mechanics.signals import Signal, Table
from mbfmu.util.errors import UserError

Array = NDArray[np.float64]

MIN_REFINEMENT = 1e-9  # relative, of the greatest curvature between points in which it is searched
OUTLINE_PLACES = 401  # of the profile below a wheel, where its curvature is compared with that of the wheel
POINTS_PER_PIECE = 16  # of a polynomial between two points of a table, in which the curvature is searched
POINTS_PER_WIDTH, MAX_WIDTHS = 50, 2000  # the same for a function, over the distance in which it changes; most of these
FINER_WIDTH, DERIVATIVE_TOLERANCE = 0.25, 1e-6  # second derivatives over a smaller width must agree so well
MAX_SLOPE_JUMP_RATIO = 0.1  # of a change of the slope between points that its second derivative does not explain


@dataclass(frozen=True)
class Profile:
    """Height z = h(x) of a cylindrical surface.

    Parameters
    ----------
    height
        :class:`.Table` of z over x, m; a function of x or an expression.
    interval
        Least and greatest x, m; None: those of the points of a table.
    width
        For a function: distance over which it changes noticeably, m.
    """

    height: Any
    interval: Any
    width: float

    @property
    def is_table(self) -> bool:
        """Whether it goes through points."""
        return isinstance(self.height, Table)

    @property
    def is_without_end(self) -> bool:
        """Whether the user has stated the continuation beyond the interval."""
        return self.is_table and self.interval is None and self.height.beyond != "linear"

    @cached_property
    def function(self) -> Any:
        """Kernel of a function."""
        return law.law_of("profile of a wheel", self.height, ("x",))

    @cached_property
    def rows(self) -> Array:
        """Rows of a table, see :mod:`mbfmu.mechanics.curve`."""
        found: Array = self.height.rows("profile of a wheel")
        return found

    @property
    def ends(self) -> tuple[float, float]:
        """Least and greatest x of the interval, or of the points, m."""
        if self.interval is None:
            return float(np.min(self.height.x)), float(np.max(self.height.x))
        return float(self.interval[0]), float(self.interval[1])

    @property
    def limits(self) -> tuple[float, float]:
        """x between which the profile is evaluated, m: it continues straight beyond."""
        return (-np.inf, np.inf) if self.is_without_end else self.ends

    def check(self, what: str, radius: float) -> None:
        """Raise UserError unless it is smooth and a wheel of this radius, m, touches it at one place only."""
        if not self.is_table and (isinstance(self.height, Signal) or not (callable(self.height) or self._is_text)):
            raise UserError(f"profile of {what} is {self.height!r}; allowed: a Table, a function or an expression of x")
        self._check_interval(what)
        if self.is_table:
            self.height.rows(f"profile of {what}")
            if not self.height.drives:
                raise UserError(f"profile of {what} is {self.height!r}; its slope jumps, and no wheel can roll there")
        else:
            self._check_function(what)
        self._check_curvature(what, radius)

    @property
    def _is_text(self) -> bool:
        return isinstance(self.height, str)

    def _check_interval(self, what: str) -> None:
        own = self.interval
        if own is None:
            if not self.is_table:
                raise UserError(
                    f"profile of {what} is a function; give profile_interval=(least x, greatest x), m, where the wheel "
                    "may touch it"
                )
            return
        if not (is_finite(own) and np.shape(own) == (2,) and own[0] < own[1]):
            raise UserError(f"profile_interval of {what} is {own!r}; allowed: two finite numbers, ascending, m")
        if self.is_table and self.height.beyond == "linear":
            first, last = float(np.min(self.height.x)), float(np.max(self.height.x))
            if own[0] < first or own[1] > last:
                raise UserError(
                    f"profile_interval of {what} is {own!r}; the points of its profile are between {first:g} and "
                    f"{last:g} m"
                )

    def _check_function(self, what: str) -> None:
        width, (low, high) = positive(f"profile_width of {what}", self.width), self.ends
        if high - low > MAX_WIDTHS * width:
            raise UserError(
                f"profile_interval of {what} is {(low, high)!r}; allowed: a length of at most {MAX_WIDTHS} times the "
                f"profile_width, {width:g} m. Use a shorter one, or a Table with beyond='periodic'"
            )
        x = first_irregular(self.function, low, high, width)
        if x is None:
            return
        height = float(self.function(x))
        if not np.isfinite(height):
            raise UserError(
                f"profile of {what} is {height!r} at x = {x:.4g} m; allowed: finite heights in profile_interval"
            )
        raise UserError(
            f"profile of {what} is not smooth near x = {x:.4g} m: differences over thousandths of {width:g} m do not "
            "resolve its changes; use profile_width with the distance in m over which it changes, a shorter "
            "profile_interval, or a Table with kind='akima' if its curvature jumps. Its slope must not jump"
        )

    def _check_curvature(self, what: str, radius: float) -> None:
        x, curvature = self.sharpest
        if not curvature * radius < 1.0:
            raise UserError(
                f"radius of {what} is {radius:g} m, but its profile has a trough with a radius of curvature of "
                f"{1.0 / curvature:.4g} m at x = {x:.4g} m, where the wheel would touch it at two places; allowed: a "
                "radius below that in all of the profile. Use a smaller wheel, a smoother profile, or "
                "profile_interval with the part that the wheel reaches"
            )

    @cached_property
    def sharpest(self) -> tuple[float, float]:
        """x of the greatest curvature in the interval, m, and this curvature, 1/m, which is positive in a trough."""
        x = self.samples
        k = int(np.argmax(self.curvature(x)))
        ends = x[max(k - 1, 0)], x[min(k + 1, len(x) - 1)]
        size = ends[1] - ends[0]
        found = scipy.optimize.minimize_scalar(
            lambda part: -float(self.curvature(np.array([ends[0] + part * size]))[0]),
            bounds=(0.0, 1.0),
            method="bounded",
            options={"xatol": 1e-9},
        )
        at_sample = float(self.curvature(x[k : k + 1])[0])
        if -found.fun > (1.0 + MIN_REFINEMENT) * at_sample:
            return float(ends[0] + found.x * size), -float(found.fun)
        return float(x[k]), at_sample

    @property
    def samples(self) -> Array:
        """Places x, m, between which the profile changes little; of a periodic table within one period."""
        low, high = self.ends
        if not self.is_table:
            return function_points(low, high, self.width)
        points = self.rows[:, 0]
        if self.height.beyond == "periodic":
            period = points[-1] - points[0]
            high = min(high, low + period)
            shift = period * np.floor((low - points[0]) / period)
            points = shift + np.append(points, points[1:] + period)
        parts = np.linspace(0.0, 1.0, POINTS_PER_PIECE, endpoint=False)
        x = (points[:-1, np.newaxis] + np.diff(points)[:, np.newaxis] * parts).ravel()
        return np.concatenate(([low], x[(x > low) & (x < high)], [high]))

    def values(self, x: Array) -> Array:
        """Return the height, m, its slope and its second derivative, 1/m, at places x (k,), m: (3, k)."""
        low, high = self.limits
        inside = np.clip(x, low, high)
        if self.is_table:
            found = self._of_table(inside)
        else:
            found = derivatives_of(self.function, inside, self.width)
        beyond = x - inside
        return np.array((found[0] + found[1] * beyond, found[1], np.where(beyond == 0.0, found[2], 0.0)))

    def _of_table(self, x: Array) -> Array:
        """Return what :func:`mbfmu.mechanics.curve.curve` does, for all x."""
        rows, end = self.rows, self.rows[-1, 0]
        if self.height.beyond == "periodic":
            begin, period = rows[0, 0], end - rows[0, 0]
            x = x - period * np.floor((x - begin) / period)
        low = np.clip(np.searchsorted(rows[:, 0], x, "right") - 1, 0, len(rows) - 1)
        s = x - rows[low, 0]
        c0, c1, c2, c3 = rows[low, 1:5].T
        before = s < 0.0
        c2, c3 = np.where(before, 0.0, c2), np.where(before, 0.0, c3)
        return np.array(
            (c0 + s * (c1 + s * (c2 + s * c3)), c1 + s * (2.0 * c2 + 3.0 * s * c3), 2.0 * c2 + 6.0 * s * c3)
        )

    def curvature(self, x: Array) -> Array:
        """Return the curvature at places x (k,), m, in 1/m; positive in a trough."""
        _, slope, bend = self.values(x)
        found: Array = bend / (1.0 + slope**2) ** 1.5
        return found

    def tightest(self, record: Any, A: Array, B: Array, near: float, reach: float) -> tuple[float, float, float]:
        """Return where a trough fits the outline of a wheel worst, within a ``reach`` from the place ``near``, m.

        ``record`` is that of the wheel, A and B are the axes of the bodies (3, 3) as columns. See
        :mod:`.rolling_profile`.

        Returns
        -------
        tuple of float
            x, m; the curvature of the profile there, 1/m; the radius of curvature of the outline, m.
        """
        e = record["Ra"].T @ A.T @ B @ record["Rb"][:, 2]
        x = near + reach * np.linspace(-1.0, 1.0, OUTLINE_PLACES)
        slope = self.values(x)[1]
        curvature = self.curvature(x)
        q = (e[0] + slope * e[2]) / np.sqrt(1.0 + slope**2)
        s = np.sqrt(q**2 + e[1] ** 2)
        outline = record["crown"] + record["radius"] * e[1] ** 2 / s**3
        k = int(np.argmax(curvature * outline))
        return float(x[k]), float(curvature[k]), float(outline[k])

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the table, the limits and the width of a function."""
        record["lower"], record["upper"] = self.limits
        record["width"] = self.width
        if self.is_table:
            self.height.write(f"profile of {site.name}", record, site)


def function_points(low: float, high: float, width: float) -> Array:
    """Return places x, m, between which a function changes little."""
    count = int(np.ceil(POINTS_PER_WIDTH * (high - low) / width))
    return np.linspace(low, high, max(POINTS_PER_WIDTH, count) + 1)


def derivatives_of(function: Any, x: Array, width: float) -> Array:
    """Return a function and its first two derivatives at places x (k,), m, by differences: (3, k)."""
    with np.errstate(all="ignore"):  # functions that are not compiled warn where they are not finite
        return np.array([law.real_derivatives(function, float(at), width) for at in x], float).T


@lru_cache(maxsize=64)  # a model is built many times, and has several wheels on one profile
def first_irregular(function: Any, low: float, high: float, width: float) -> float | None:
    """Return where a function is not finite, or its differences are not derivatives, first: x, m; None: nowhere."""
    x = function_points(low, high, width)
    height, slope, bend = derivatives_of(function, x, width)
    finer = derivatives_of(function, x, FINER_WIDTH * width)[2]
    wrong = ~np.isfinite([height, slope, bend, finer]).all(axis=0)
    if not wrong.any():
        rounding = 1e-2 * np.abs(height).max() / width**2
        wrong = np.abs(bend - finer) > DERIVATIVE_TOLERANCE * (np.abs(finer).max() + rounding)
        step = x[1] - x[0]
        jump = np.abs(np.diff(slope) - 0.5 * step * (bend[1:] + bend[:-1]))
        wrong[1:] |= jump > MAX_SLOPE_JUMP_RATIO * step * (np.abs(bend).max() + rounding)
    return float(x[np.argmax(wrong)]) if wrong.any() else None

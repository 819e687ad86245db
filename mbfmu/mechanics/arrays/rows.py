"""Constraint equations that are trivially satisfied, and those that are redundant.

A constraint equation is **trivially satisfied** if its Jacobian is zero at every position of the mechanism: a planar
loop has three. It is removed when the mechanism is compiled. So is one whose Jacobian differs from zero only by the
rounding of the geometry, see :mod:`.rounded`. A constraint equation is **redundant** if it depends on others: the loop
is closed without it, and the distribution of the reaction forces among them is not unique. It is kept.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.mechanics.builder.handles import CouplingHandle, CutHandle
from mbfmu.mechanics.signals import InUse
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import AssemblyError
from solvers.system import AnySystem, Array

from .inputs import Drives, Inputs
from .rounded import ROUNDED_ADVICE

VANISHING_TOLERANCE = 1e-9  # of a Jacobian in units of row and coordinate, and of a gap: what rounding leaves of zero
DEPENDENT_ROW_PIVOT_RATIO = 1e-4  # to the largest; a loop closed to 1e-11 is that far from a singular configuration
CHECK_LOOP = "; check the positions and axes of the joints of this loop, or add a joint"
NOT_UNIQUE = (
    "The motion is not affected, but the distribution of the reaction forces among them is not unique. Choose a joint "
    "that constrains fewer directions if these forces are needed"
)
MAX_LISTED = 4  # loops that are listed one by one


Handle = CutHandle | CouplingHandle


def row_names(handles: Iterable[Handle]) -> list[str]:
    """Return the name of every row."""
    return [f"{handle.name}.{row}" if row else handle.name for handle in handles for row in handle.rows]


def advice(why: str) -> str:
    """Return which axes are nearly parallel, with what to do about it; empty: none are."""
    return f": {why}; if they are intended to be parallel, {ROUNDED_ADVICE}" if why else ""


class Probe:
    """Largest Jacobian (m,) and gap (m,) of every row over positions that are tried, in units of the row."""

    def __init__(self, system: AnySystem) -> None:
        self._system, self._terms = system, system.allocate_terms()
        self._random, self._first = np.random.default_rng(0), True
        self.slope, self.gap, self.at_start = np.zeros(system.m), np.zeros(system.m), np.zeros(system.m)

    def normal(self) -> float:
        """Return a random number about zero, of order one."""
        return float(self._random.normal())

    def turns(self) -> float:
        """Return a random number from zero to that of a turn, rad."""
        return float(self._random.uniform(0.0, 2.0 * np.pi))

    def try_at(self, t: float, start: Array) -> None:
        """Take the rows at time t, at a random position about ``start`` (nq,)."""
        s, q = self._system, start.copy()
        s.apply(q, s.size * self._random.normal(size=s.n))
        s.fill_position(t, q, self._terms)
        slopes = np.abs(self._terms.J) * s.size / s.row_size[:, np.newaxis]
        gaps = np.abs(self._terms.Phi) / s.row_size
        pace = (s.rate or 1.0) * s.row_size[s.nonholonomic]
        gaps[s.nonholonomic] = np.abs(self._terms.nu[s.nonholonomic]) / pace  # where drives violate them
        if self._first:
            self.at_start, self._first = gaps, False
        self.slope = np.maximum(self.slope, slopes.max(axis=1, initial=0.0))
        self.gap = np.maximum(self.gap, gaps)

    def vanishing(self, units: list[str], slack: Array, driven: bool, why: list[str]) -> NDArray[np.bool_]:
        """Return which rows (m,) no free motion works against; AssemblyError where one of them does not close.

        ``slack`` (m,) is the effect of rounding of the geometry on slopes and gaps, in units of the rows; ``why`` names
        the axes that are nearly parallel.
        """
        s, limit = self._system, np.maximum(slack, VANISHING_TOLERANCE)
        vanishing = (self.slope < VANISHING_TOLERANCE) | ((self.slope <= limit) & (self.gap <= limit))
        for i in np.flatnonzero((self.slope < VANISHING_TOLERANCE) & (self.gap > limit)):
            name, unit = s.constraint_names[i], units[i]
            if self.at_start[i] > VANISHING_TOLERANCE:
                off = self.at_start[i] * s.row_size[i]
                raise AssemblyError(
                    f"loop cannot close: constraint {name!r} is violated by {off:.3g} {unit} and no free joint can "
                    f"change that{advice(why[i]) or CHECK_LOOP}"
                )
            if not driven:
                raise AssemblyError(
                    f"loop cannot move: constraint {name!r} is violated by {self.gap[i] * s.row_size[i]:.3g} {unit} "
                    f"when its joints move{advice(why[i]) or CHECK_LOOP}"
                )
            raise AssemblyError(
                f"the drives open a loop: when they move, constraint {name!r} is violated by "
                f"{self.gap[i] * s.row_size[i]:.3g} {unit} and no free joint can follow; free a joint of this loop, or "
                "choose another drive"
            )
        return vanishing


def find_vanishing_rows(
    system: AnySystem,
    start: Array,
    drives: Drives,
    inputs: Inputs,
    signals: list[InUse],
    units: list[str],
    slack: Array,
    why: list[str],
) -> tuple[NDArray[np.bool_], Array]:
    """Return the trivially satisfied constraint equations (m,) and the largest gap of each, in units of the rows.

    ``slack`` and ``why`` (m,) as for :meth:`Probe.vanishing`.

    A few random positions decide, of the free coordinates about ``start`` (nq,) and of the drives: those that are
    functions of time where they are at some time, those that are inputs anywhere. Another row is zero there with
    probability zero. The inputs' signals are left elsewhere.

    Raises
    ------
    AssemblyError
        A trivially satisfied equation is not closed at the start, or the drives open it.
    """
    probe = Probe(system)
    given = [k for k in drives.signals if k in inputs.signals]
    centers = {k: float(signals[k].record["c"][0]) for k in given}
    time_scales = [drives.time_scale(k) for k in drives.signals if k not in given]
    for scale in (0.0, *(x for x in time_scales if x), *(1.0 for _ in given)):
        for _ in range(3):
            probe.try_at(scale * probe.turns(), start)
            for k in given:
                signals[k].record["c"][0] = centers[k] + drives.sizes[k] * probe.normal()
    return probe.vanishing(units, slack, bool(drives.signals), why), probe.gap


def find_constant_rows(system: AnySystem, t: float, near: Array) -> NDArray[np.bool_]:
    """Return which constraint equations (m,) no free motion changes, by a few random positions about ``near`` (nq,)."""
    probe = Probe(system)
    for _ in range(3):
        probe.try_at(t, near)
    return probe.slope < VANISHING_TOLERANCE


def dependent_rows(system: AnySystem, t: float, q: Array) -> NDArray[np.int64]:
    """Return the constraint equations that depend on the others at q (nq,), in order: by pivoting, in their units."""
    terms = system.allocate_terms()
    system.fill_position(t, q, terms)
    if system.m == 0 or system.n == 0:
        return np.arange(system.m)
    return find_dependent_rows(terms.J * system.size / system.row_size[:, np.newaxis])


def find_dependent_rows(J: Array) -> NDArray[np.int64]:
    """Return the rows of a matrix (m, n) that depend on the others, in order: by pivoting.

    Pivots are between the smallest and the largest singular value. If these are in proportion, no row depends on
    others, and SciPy is not imported.
    """
    if len(J) <= J.shape[1]:
        sigma = np.linalg.svdvals(J)
        if sigma[-1] > DEPENDENT_ROW_PIVOT_RATIO * sigma[0]:
            return np.arange(0)
    R, order = scipy.linalg.qr(J.T, mode="r", pivoting=True)
    pivots = np.abs(np.diag(R))
    rank = int(np.sum(pivots > DEPENDENT_ROW_PIVOT_RATIO * pivots[0]))
    return np.sort(order[rank:])


def describe(handles: Iterable[Handle], vanishing: Collection[str], redundant: Collection[str]) -> list[Diagnostic]:
    """Return a note on every cut joint or coupling with removed constraints, and one on every one with redundant ones;
    the first few of each.
    """
    removed: list[Diagnostic] = []
    dependent: list[Diagnostic] = []
    for handle in handles:
        if text := _describe_rows(handle, vanishing, "trivially satisfied{which} and removed"):
            removed.append(Diagnostic.note("removed-constraints", text, subject=handle.name))
        if text := _describe_rows(handle, redundant, "redundant{which}"):
            dependent.append(Diagnostic.note("redundant-constraints", text, NOT_UNIQUE, subject=handle.name))
    return [
        *first_of(removed, "loops with constraints that are trivially satisfied"),
        *first_of(dependent, "loops with redundant constraints"),
    ]


def _describe_rows(handle: Handle, those: Collection[str], what: str) -> str:
    """Return which of ``those`` rows a cut joint or a coupling has, and ``what`` they are; empty: it has none."""
    named = [row for name, row in zip(row_names([handle]), handle.rows, strict=True) if name in those]
    if not named:
        return ""
    which = f" ({', '.join(named)})" if len(handle.rows) > 1 else ""
    count = f"{len(named)} of its {len(handle.rows)} constraints {'is' if len(named) == 1 else 'are'}"
    return f"{handle.what} {handle.name!r}: {count} {what.format(which=which)}"


def first_of(found: list[Diagnostic], rest: str) -> list[Diagnostic]:
    """Return the first of many diagnostics of one code, and how many more ``rest`` there are."""
    if len(found) <= MAX_LISTED:
        return found
    more = f"{len(found) - MAX_LISTED} more {rest}"
    return [*found[:MAX_LISTED], replace(found[0], subject="", text=more, remedy="")]

"""The solver that ``auto`` stands for: chosen once, before the run, from the model as it starts.

What a family costs is counted in steps of ``adams`` a second, from the eigenvalues about the start
(:mod:`mbfmu.spectrum`). An explicit solver follows the fastest motion there is, at rest or not. An implicit one follows
what swings farther than the tolerance and does not decay at once; its steps cost more::

    explicit   max(OWN own, SWING followed, fastest / (0.5 ... 1.5)),     from swinging to decaying
    implicit   COST max(OWN own, LESS followed) (1e-6 / tolerance)^(1/6, of trees 0.45)

The numbers were measured on the four-bar with an elastic coupler, 3 to 1e5 times as fast as the swing, damped and not,
and on a sheet that is released and stiffens as it bends. What else stiffens later, such as a stop that is not yet met,
is not seen: nothing here depends on anything but the start.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import NamedTuple

from mbfmu.errors import UserError
from mbfmu.mechanics import Plant
from mbfmu.spectrum import Spectrum, spectrum
from solvers.system import LARGEST_DENSE, Array

OWN = 16.0  # steps for every 1/s of a motion at its start
SWING, LESS = 2.0, 1.2  # of a fast swing, explicit and implicit
SLOW_REACH, FAST_REACH = 0.5, 1.0  # step times eigenvalue at which Adams PECE is stable: of swings, and more of decays
STIFFENS = 5.0  # the fastest motion of a sheet that has bent, in units of that at the start
COST = 8.0  # of a step of radau or esdirk, in those of adams
GAIN, GAIN_OF_TREES = 1.0 / 6.0, 0.45  # steps of radau, and of esdirk or ida on trees, grow as tolerance to this power
WIDE = 10  # rows of loops from which LU on the dependent coordinates pays
COARSE = 1e-6  # tightest tolerance of esdirk


class Pick(NamedTuple):
    """A solver, and why ``auto`` took it; without a reason it was asked for."""

    solver: str
    reason: str = ""  # a clause with the numbers that decided
    stiff: bool = False  # whether it was taken because an explicit one would take too many steps

    def __str__(self) -> str:
        """Return both in a sentence; empty where it was asked for."""
        return f"auto took {self.solver!r}: {self.reason}" if self.reason else ""


def pick(plant: Plant, t: float, q: Array, v: Array, tolerance: float) -> Pick:
    """Return the solver of the cheapest family for the motion from (q (nq,), v (n,)) at time t, s.

    ``tolerance`` is the absolute one, in units of each coordinate.
    """
    if not plant.system.n:
        return Pick(solver="adams", reason="drives say where everything is, and nothing is integrated")
    try:
        found = spectrum(plant, t, q, v)
    except UserError as error:
        solver, size = explicit(plant)
        return Pick(solver=solver, reason=f"{error} at the start, so that stiffness is not known; {size}")
    return suited(plant, [found], tolerance)


def suited(plant: Plant, found: Sequence[Spectrum], tolerance: float) -> Pick:
    """Return the solver of the cheapest family where these are the eigenvalues, at one state or at several."""
    stiff = implicit_steps(plant, found, tolerance) < explicit_steps(plant, found, tolerance)
    solver, size = implicit(plant, tolerance) if stiff else explicit(plant)
    fastest, followed = max(abs(f.fastest) for f in found), max(f.followed(tolerance) for f in found)
    least = "only " if stiff else ""
    return Pick(
        solver,
        f"{'' if stiff else 'not '}stiff: its fastest motion is of {fastest:.3g} 1/s, and what moves by more than "
        f"{tolerance:g} of {least}{followed:.3g} 1/s; {size}",
        stiff,
    )


def _forced(plant: Plant, found: Spectrum) -> float:
    """Return the steps a second that a motion's own rate, and what varies by itself, ask of any solver."""
    longest, _ = plant.system.resolves(found.t)
    return max(OWN * found.own, 1.0 / longest if longest < inf else 0.0)


def reach(value: complex) -> float:
    """Return the longest step of an explicit solver that an eigenvalue (1/s) leaves stable, s."""
    size = abs(value)
    return (SLOW_REACH + FAST_REACH * abs(value.real) / size) / size if size > 0.0 else inf


def explicit_steps(plant: Plant, found: Sequence[Spectrum], tolerance: float) -> float:
    """Return the most steps a second of an explicit solver, 1/s."""
    later = STIFFENS if plant.mechanism.plates else 1.0
    return max(max(_forced(plant, f), SWING * f.followed(tolerance), later / reach(f.fastest)) for f in found)


def implicit_steps(plant: Plant, found: Sequence[Spectrum], tolerance: float) -> float:
    """Return the most steps a second of an implicit solver, in those of an explicit one, 1/s."""
    most = max(max(_forced(plant, f), LESS * f.followed(tolerance)) for f in found)
    return float(COST * most * (1e-6 / tolerance) ** (GAIN if plant.system.has_matrices else GAIN_OF_TREES))


def explicit(plant: Plant) -> tuple[str, str]:
    """Return the solver to take where nothing is stiff, and what its size has to do with it."""
    s = plant.system
    if not s.has_matrices and not s.m:
        return "adams", f"a tree of {s.n} coordinates without loops, by its recursions"
    if s.n > LARGEST_DENSE:
        return "ida", f"the only one for {s.n} coordinates with loops"
    if s.m >= WIDE:
        return "hybrid", f"{s.n} coordinates under {s.m} rows of loops, the dependent ones by LU"
    return "adams", f"{s.n} coordinates under {s.m} rows of loops" if s.m else f"{s.n} coordinates without loops"


def implicit(plant: Plant, tolerance: float) -> tuple[str, str]:
    """Return the solver to take where something is stiff, and what its size has to do with it."""
    s = plant.system
    if s.has_matrices:
        return "radau", f"{s.n} coordinates, by their matrices"
    if s.m:
        return "ida", f"a tree of {s.n} coordinates with {s.m} rows of loops"
    if tolerance < COARSE:
        return "ida", f"a tree of {s.n} coordinates, and a tolerance below {COARSE:g}, for which esdirk is no good"
    return "esdirk", f"a tree of {s.n} coordinates without loops, by its recursions"

"""Remarks at the start of a run on what its tolerance means for the results."""

from __future__ import annotations

from mbfmu.mechanics import Plant
from mbfmu.util.codes import coded

STIFF_OUTPUT_TOLERANCE = 1e-7  # tolerance at which forces in the plane of a sheet in motion are good to some percents
COARSE_TOLERANCE = 1e-3  # from which on runs report how large their errors may be
COARSE_ERROR = 100.0  # tolerances times the growth of errors of the motion: what counts as right in tests
COARSE_TEXT = (
    f"errors may be about {COARSE_ERROR:g} times the tolerance (in rad, or in lengths of the mechanism), multiplied by "
    "the growth of errors of the motion itself, which is large near unstable equilibria and in chaotic motions. Repeat "
    "the run with a tenth of the tolerance and compare the results"
)


def describe_loose(plant: Plant, tolerance: float) -> str:
    """Return a warning that outputs need a smaller tolerance; empty: none does."""
    names = plant.stiff_outputs
    if not names or tolerance <= STIFF_OUTPUT_TOLERANCE:
        return ""
    more = f" and {len(names) - 1} more" if names[1:] else ""
    return coded(
        "loose-tolerance",
        f"output {names[0]!r}{more} depends on the in-plane strains of a sheet, whose stiffness amplifies "
        f"the position errors that the tolerance of {tolerance:g} allows; use {STIFF_OUTPUT_TOLERANCE:g} or less",
    )


def describe_coarse(plant: Plant, tolerance: float, freedom: int) -> str:
    """Return how large errors may be at a coarse tolerance; empty: it is a finer one, or nothing is integrated.

    The growth of errors is not estimated: at 1e-3 a growth of 3, that of a pendulum in a few swings, makes an error of
    0.3 rad possible. Sheets are left out: the solvers report their errors.
    """
    if tolerance < COARSE_TOLERANCE or freedom == 0 or plant.mechanism.meshes:
        return ""
    return coded("coarse-tolerance", f"the tolerance is {tolerance:g}: {COARSE_TEXT}")

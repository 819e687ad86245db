"""Whether a start is what was meant, in machine code: loops closed the right way round, and numbers fine enough.

In Python :func:`mbfmu.mechanics.arrays.closing.check_frames` and two functions of :mod:`solvers.stepper` do this.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

import numpy as np

from mbfmu.mechanics.arrays.closing import fill_frame_angles
from mbfmu.util.diagnostics import Diagnostic
from solvers.assembly import ASSEMBLED, Outcome
from solvers.compiled.kernel import inlined, kernel
from solvers.stepper import MAX_SPACING_IN_TOLERANCES

SPACING_FACTOR = 2.0**-53 * (1.0 + 2.0**-52)  # of a number, which it is less than one step away from


class Flaw(IntEnum):
    """What else may be wrong with a start; the numbers go on from those of ``solvers.assembly.Outcome``."""

    TURNED = len(Outcome)  # a loop is closed the wrong way round: cut joint, and its angle in degrees
    UNRESOLVED = len(Outcome) + 1  # numbers about the start time are too far apart: the time
    UNPLACED = len(Outcome) + 2  # numbers about a position are: the position


TURNED, UNRESOLVED, UNPLACED = map(int, Flaw)  # for kernels

START_MESSAGES = {
    Flaw.TURNED: Diagnostic.error(
        "cannot-assemble",
        "loop {name!r} closes with a wrong orientation: the frames of its cut joint are rotated by {gap:.0f} deg from "
        "each other; allowed: 0 deg",
        "Change rotation_a or rotation_b of the cut joint, or start nearer to the closed loop",
    ),
    Flaw.UNRESOLVED: Diagnostic.error(
        "clock-resolution",
        "the start time is {gap:g} s, where the spacing of floating-point numbers is a time in which the motion "
        "changes by more than the tolerance",
        "Use a start time nearer to zero",
    ),
    Flaw.UNPLACED: Diagnostic.error(
        "clock-resolution",
        "a joint coordinate starts at {gap:g}, where the spacing of floating-point numbers is too coarse for the "
        "tolerance",
        "Start nearer to zero (an angle minus a multiple of 2 pi is the same position)",
    ),
}


@kernel
def find_turned(instance: Any, worst: Any) -> int:
    """TURNED if a cut joint is closed with a wrong orientation in this position; ``worst`` names it."""
    k = fill_frame_angles(instance.frames, instance.given.eqs.data, instance.angles)
    if k == instance.angles.shape[0]:
        return ASSEMBLED
    worst.row, worst.gap = k, np.floor(np.degrees(instance.angles[k]) + 0.5)
    return TURNED


@inlined
def spacing(x: float) -> float:
    """How far the next number is from x."""
    return (abs(x) + SPACING_FACTOR * abs(x)) - abs(x)


@kernel
def check_resolution(t: float, rate: float, q: Any, size_q: Any, rtol: float, worst: Any) -> int:
    """Whether numbers resolve t (s) and q (nq,), in units ``size_q``, to the tolerance; ``rate`` in 1/s."""
    code, most = ASSEMBLED, MAX_SPACING_IN_TOLERANCES * rtol
    for k in range(q.shape[0]):
        apart = spacing(q[k]) / size_q[k]
        if not apart <= most:
            code, most = UNPLACED, apart
            worst.row, worst.gap = k, q[k]
    if not spacing(t) * rate <= rtol:
        code = UNRESOLVED
        worst.row, worst.gap = 0, t
    return code

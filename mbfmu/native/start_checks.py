"""Whether a start is what was meant, in machine code: loops closed the right way round, and numbers fine enough.

In Python :func:`mbfmu.mechanics.arrays.closing.check_frames` and two functions of :mod:`solvers.stepper` see to it.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import Plant
from mbfmu.mechanics.cuts.base import CUT_PARAMETERS
from mbfmu.util.codes import coded
from solvers.assembly import ASSEMBLED, Outcome
from solvers.compiled.kernel import inlined, kernel
from solvers.stepper import MAX_SPACING_IN_TOLERANCES
from solvers.system import Array

PARALLEL_AXES = ("", "z", "xyz")  # what of two frames is parallel, see Cut.parallel
Z_AXIS = PARALLEL_AXES.index("z")
RA, RB = (np.dtype(CUT_PARAMETERS).fields[name][1] // 8 for name in ("Ra", "Rb"))  # type: ignore[index]  # words into a record
MIN_AGREEING_COSINE = float(np.cos(1.0))  # closed frames are turned by zero, or by 120 degrees at least
SPACING_FACTOR = 2.0**-53 * (1.0 + 2.0**-52)  # of a number, which it is less than one step away from


class Flaw(IntEnum):
    """What else may be wrong with a start; the numbers go on from those of ``solvers.assembly.Outcome``."""

    TURNED = len(Outcome)  # a loop is closed the wrong way round: cut joint, and its angle in degrees
    UNRESOLVED = len(Outcome) + 1  # numbers about the start time are too far apart: the time
    UNPLACED = len(Outcome) + 2  # numbers about a position are: the position


TURNED, UNRESOLVED, UNPLACED = map(int, Flaw)  # for kernels

START_MESSAGES = {
    Flaw.TURNED: coded(
        "cannot-assemble",
        "loop {name!r} closes with a wrong orientation: the frames of its cut joint are rotated by {gap:.0f} deg from "
        "each other; allowed: 0 deg. Change rotation_a or rotation_b of the cut joint, or start nearer to the closed "
        "loop",
    ),
    Flaw.UNRESOLVED: coded(
        "clock-resolution",
        "the start time is {gap:g} s, where the spacing of floating-point numbers is a time in which the motion "
        "changes by more than the tolerance; use a start time nearer to zero",
    ),
    Flaw.UNPLACED: coded(
        "clock-resolution",
        "a joint coordinate starts at {gap:g}, where the spacing of floating-point numbers is too coarse for the "
        "tolerance; start nearer to zero (an angle minus a multiple of 2 pi is the same position)",
    ),
}


class Frames(NamedTuple):
    """Which frames of cut joints are to agree, and where they are."""

    ways: NDArray[np.int64]  # (cuts,) place in WAYS
    numbers: Array  # all records of ``Arrays.memory``, as numbers

    @staticmethod
    def of(plant: Plant) -> Frames:
        """Return those of a plant."""
        ways = [PARALLEL_AXES.index(handle.cut.parallel) for handle in plant.mechanism.cuts]
        return Frames(np.array(ways, np.int64), plant.data.arrays.memory.view(np.float64))


@kernel
def find_turned(frames: Any, data: Any, worst: Any) -> int:
    """TURNED if a cut joint is closed in the opposite direction in this position; ``worst`` names it."""
    for k in range(frames.ways.shape[0]):
        if frames.ways[k] == 0:
            continue
        cosine = cosine_between(frames, k, data)
        if not cosine > MIN_AGREEING_COSINE:
            worst.row, worst.gap = k, np.floor(np.degrees(np.arccos(min(1.0, max(-1.0, cosine)))) + 0.5)
            return TURNED
    return ASSEMBLED


@kernel
def cosine_between(frames: Any, k: int, data: Any) -> float:
    """Cosine of the angle between the z axes of a cut joint's frames; or of that by which one frame is turned."""
    cut, numbers, total = data.arrays.cuts[k], frames.numbers, 0.0
    A, B, first = data.state.bodies[cut.a].A, data.state.bodies[cut.b].A, cut.at // 8
    hinge = frames.ways[k] == Z_AXIS
    for axis in range(2 if hinge else 0, 3):
        for i in range(3):
            a, b = 0.0, 0.0
            for j in range(3):
                a += A[i, j] * numbers[first + RA + 3 * j + axis]
                b += B[i, j] * numbers[first + RB + 3 * j + axis]
            total += a * b
    return total if hinge else 0.5 * (total - 1.0)


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

"""Whether a start is what was meant: what the kernels that Python uses too find, as codes of machine code."""

from __future__ import annotations

from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from mbfmu.mechanics.arrays.closing import fill_frame_angles
from mbfmu.mechanics.arrays.load_groups import MISPLACED_LOAD, find_misplaced_load
from mbfmu.mechanics.loads.base import MAX_MISPLACEMENT
from mbfmu.session.failure_diagnosis import MIN_RATE_PARTICIPATION
from mbfmu.session.kernels.points import energy_at
from mbfmu.util.diagnostics import Diagnostic
from solvers.compiled.kernel import kernel
from solvers.linalg.dense import apply_Q
from solvers.loop_closure import ASSEMBLED, Outcome, factor_scaled_jacobian
from solvers.resolution import RESOLVED, UNRESOLVED_TIME, find_unresolved
from solvers.statics.newton import MAX_STATE_DISTANCE
from solvers.system import Array


class Flaw(IntEnum):
    """What else may be wrong with a start; the numbers go on from those of ``solvers.loop_closure.Outcome``."""

    TURNED = len(Outcome)  # a loop is closed the wrong way round: cut joint, and its angle in degrees
    UNRESOLVED = len(Outcome) + 1  # numbers about the start time are too far apart: the time
    UNPLACED = len(Outcome) + 2  # numbers about a position are: the position
    MISPLACED = len(Outcome) + 3  # bodies are not where a load requires them: load, and its ``misplacement``
    NO_BRANCH = len(Outcome) + 4  # the rates belong to no branch of the motion in a singular configuration
    NO_STEADY_STATE = len(Outcome) + 5  # no steady state was found: a coordinate and the residual there
    NOT_UNIQUE = len(Outcome) + 6  # a steady state has others next to it, or forces in loops are not determined
    NOT_STEADY = len(Outcome) + 7  # forces do not balance after the drives have moved: see NO_STEADY_STATE
    FAR_STATE = len(Outcome) + 8  # the steady state is not the one next to the start: a coordinate and its change


TURNED, UNRESOLVED, UNPLACED, MISPLACED, NO_BRANCH, NO_STEADY_STATE, NOT_UNIQUE, NOT_STEADY, FAR_STATE = map(int, Flaw)

STEADY_ADVICE = (
    "Set parameters, inputs and start values nearer to those of the export, or export the FMU again with the values "
    "that are set"
)

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
    Flaw.MISPLACED: MISPLACED_LOAD,
    Flaw.NO_BRANCH: Diagnostic.error(
        "singular-start",
        "the start is a singular configuration, in which several branches of the motion cross, and the given rates are "
        "not those of any branch",
        "Give other rates",
    ),
    Flaw.NO_STEADY_STATE: Diagnostic.error(
        "no-steady-state",
        "no steady state was found for the values that are set: at the end of the search {name!r} has an unbalanced "
        "force or moment of {gap:.3g} N or N m, or this rate if it is a first-order state",
        STEADY_ADVICE,
    ),
    Flaw.NOT_UNIQUE: Diagnostic.error(
        "no-steady-state",
        "the steady state for the values that are set is not unique, or forces of loop-closing joints are not "
        "determined in it; {name!r} has the largest residual, {gap:.3g} N or N m",
        STEADY_ADVICE,
    ),
    Flaw.NOT_STEADY: Diagnostic.error(
        "no-steady-state",
        "there is no steady state for the values that are set: after the drives have moved, {name!r} has an unbalanced "
        "force or moment of {gap:.3g} N or N m, or this rate if it is a first-order state",
        STEADY_ADVICE,
    ),
    Flaw.FAR_STATE: Diagnostic.error(
        "no-steady-state",
        "no steady state was found near the start: in the one that the search reaches, {name!r} is {gap:.3g} rad or m "
        f"from its start position; allowed: {MAX_STATE_DISTANCE:g} rad, or this number of lengths of the mechanism",
        STEADY_ADVICE,
    ),
}


class Start(NamedTuple):
    """What a mechanism is assembled from."""

    q: Array  # (nq,) first positions, as given to the builder
    v: Array  # (n,) first velocities, see q
    scratch: Any  # solvers.loop_closure.ClosureScratch: units, what is held, and which rows or coordinates are wrong
    eliminates: int  # 1: loops are closed by the elimination of their constraints, if it can


@kernel
def find_turned(instance: Any, worst: Any) -> int:
    """TURNED if a cut joint is closed with a wrong orientation in this position; ``worst`` names it."""
    k = fill_frame_angles(instance.frames, instance.eqs.data, instance.angles)
    if k == instance.angles.shape[0]:
        return ASSEMBLED
    worst.row, worst.gap = k, np.floor(np.degrees(instance.angles[k]) + 0.5)
    return TURNED


@kernel
def find_misplaced(instance: Any, t: float) -> int:
    """MISPLACED if bodies of a load are not where it requires them in the reported state; ``worst`` names it."""
    session, worst = instance.session, instance.start.scratch.worst[0]
    energy_at(session, t, instance.q, instance.v)  # places the bodies
    arrays = session.data.arrays
    k, ratio = find_misplaced_load(arrays.loads, arrays, session.data.state)
    if ratio <= MAX_MISPLACEMENT:
        return ASSEMBLED
    worst.row, worst.gap = k, ratio
    return MISPLACED


@kernel
def mark_free_rates(J: Any, rank: int, work: Any) -> int:
    """1 if J (m, n) has not the ``rank`` at the start that it has nearby, else 0; then ``work.massless`` is 1 for
    coordinates whose rates the loops do not determine, see :func:`mbfmu.session.failure_diagnosis`.
    """
    n, x = J.shape[1], work.left_B
    for j in range(n):
        work.massless[j] = 0.0
    here = factor_scaled_jacobian(J, True, work) if rank > 0 else rank
    if here >= rank:
        return 0
    for k in range(here, n):
        for j in range(n):
            x[j] = 1.0 if j == k else 0.0
        apply_Q(work.A, work.tau, here, n, x)
        for j in range(n):
            work.massless[j] += x[j] * x[j]
    for j in range(n):
        work.massless[j] = 1.0 if np.sqrt(work.massless[j]) > MIN_RATE_PARTICIPATION else 0.0
    return 1


@kernel
def check_resolution(t: float, rate: float, q: Any, size_q: Any, rtol: float, worst: Any) -> int:
    """Whether numbers resolve t (s) and q (nq,), see :func:`solvers.resolution.find_unresolved`."""
    k = find_unresolved(t, rate, q, size_q, rtol)
    if k == RESOLVED:
        return ASSEMBLED
    worst.row, worst.gap = k, t if k == UNRESOLVED_TIME else q[k]
    return UNRESOLVED if k == UNRESOLVED_TIME else UNPLACED

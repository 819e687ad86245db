"""The start in a steady state in the FMU: the search of :mod:`solvers.statics.differences` and checks of its result.

The checks are those of :mod:`mbfmu.steady.checks`. The search is at t = 0 with closed loops near the start positions.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.dispatch import signal
from mbfmu.steady.checks import CHECKED_DRIVE_POSITIONS, CLOSED_TOLERANCE, STEADY_TOLERANCE, STIFFNESS_STEP
from solvers.compiled.kernel import kernel
from solvers.loop_closure import ASSEMBLED, OPEN, OPENS, find_closed_positions
from solvers.statics.differences import (
    TOO_FAR,
    SteadyScratch,
    find_farthest,
    find_steady_state,
    weigh_states,
    weighted_rate,
)
from solvers.statics.newton import FOUND, UNDETERMINED
from solvers.system import Array

from .start_checks import FAR_STATE, NO_STEADY_STATE, NOT_STEADY, NOT_UNIQUE, find_misplaced, find_turned


class SteadyStart(NamedTuple):
    """What the search for the steady state of a start needs; empty arrays if a run does not start in one."""

    search: Any  # SteadyScratch
    drives: NDArray[np.int64]  # numbers of the signals that drive joints
    drive_sizes: Array  # units of their coordinates
    q: Array  # (nq,) another position
    dq: Array  # (n,)
    v: Array  # (n,) velocities of the steady motion
    lam: Array  # (m,) multipliers
    forces: Array  # (n,) h + J^T lambda in the steady state
    gaps: Array  # (m,) Phi there

    @staticmethod
    def allocate(nq: int, m: int, search: SteadyScratch, drives: NDArray[np.int64], drive_sizes: Array) -> SteadyStart:
        """Return arrays for ``nq`` positions and ``m`` constraints."""
        n, z = len(search.newton.v), np.zeros
        return SteadyStart(search, drives, drive_sizes, z(nq), z(n), z(n), z(m), z(n), z(m))

    @staticmethod
    def empty() -> SteadyStart:
        """Return that a run does not start in a steady state."""
        z, none = np.zeros, np.zeros(0, np.int64)
        search = SteadyScratch.allocate(0, z(0), z(0), none, np.zeros(0, bool), np.zeros(0, bool))
        return SteadyStart.allocate(0, 0, search, none, z(0))


@kernel
def no_search(instance: Any) -> int:
    """Return that there is no search for large models, whose export fixes all that a steady state depends on."""
    return NO_STEADY_STATE


@kernel
def find_start_in_steady_state(instance: Any) -> int:
    """Let the reported state be the steady state near the start; return ASSEMBLED, another code of an assembly, or one
    of :class:`.start_checks.Flaw`, for which ``worst`` names a row, a loop or a coordinate.
    """
    problem, start, work, steady = instance.given, instance.start, instance.start.scratch, instance.steady
    search, eqs = steady.search, problem.eqs
    code: int = find_closed_positions(eqs, 0.0, start.q, problem.q, work)
    if code == ASSEMBLED:
        code = find_turned(instance, work.worst[0])
    if code != ASSEMBLED:
        return code
    n = steady.v.shape[0]
    moving = n - search.newton.weights.shape[0]
    for i in range(n):
        search.newton.size[i] = work.size[i]
        steady.v[i] = start.v[i] if search.newton.cyclic[i] == 1 or i >= moving else 0.0
        search.newton.v[i], problem.v[i] = steady.v[i], steady.v[i]
    for r in range(search.rows.shape[0]):
        search.newton.row[r] = work.row[search.rows[r]]
    code = find_misplaced(instance, 0.0)
    if code != ASSEMBLED:
        return code
    weigh_states(eqs, 0.0, problem.q, instance.known[0], search)
    outcome = find_steady_state(eqs, 0.0, problem.q, search)
    for i in range(moving, n):
        steady.v[i], problem.v[i] = search.newton.v[i], search.newton.v[i]
    fill_balance(eqs, 0.0, problem.q, steady, steady.forces, steady.gaps)
    if outcome == TOO_FAR:
        farthest = find_farthest(search.newton.moved, work.size, moving)
        work.worst[0].row, work.worst[0].gap = farthest, abs(search.newton.moved[farthest])
        return FAR_STATE
    if outcome != FOUND:
        note_largest(steady.forces, steady, work)
        return NOT_UNIQUE if outcome == UNDETERMINED else NO_STEADY_STATE
    code = check_closed(eqs, problem.q, steady, work, fastest_drive(eqs.data.arrays, steady))
    if code == ASSEMBLED:
        code = find_turned(instance, work.worst[0])
    if code == ASSEMBLED:
        code = check_moved(eqs, problem.q, steady, work)
    return code


@kernel
def fill_balance(eqs: Any, t: float, q: Any, steady: SteadyStart, forces: Any, gaps: Any) -> None:
    """forces (n,) = h + J^T lambda and gaps (m,) = Phi at q, by the multipliers of the search; the equations of
    first-order states are weighted as in the search.
    """
    search, terms = steady.search, eqs.terms
    for r in range(steady.lam.shape[0]):
        steady.lam[r] = 0.0
    for r in range(search.rows.shape[0]):
        steady.lam[search.rows[r]] = search.lam[r]
    eqs.dynamics(t, q, steady.v, eqs.data, terms)
    for i in range(forces.shape[0]):
        forces[i] = terms.h[i]
        for r in range(steady.lam.shape[0]):
            forces[i] += terms.J[r, i] * steady.lam[r]
        forces[i] = weighted_rate(i, forces[i], search.newton)
    for r in range(gaps.shape[0]):
        gaps[r] = terms.Phi[r]


@kernel
def note_largest(forces: Any, steady: SteadyStart, work: Any) -> float:
    """Note the coordinate with the largest of these forces (n,), or the first-order state with its rate, as the worst;
    return it in units of the energy.
    """
    worst, largest, weights = work.worst[0], -1.0, steady.search.newton.weights
    moving = forces.shape[0] - weights.shape[0]
    for i in range(forces.shape[0]):
        if not abs(forces[i]) * work.size[i] <= largest:
            largest, worst.row, worst.gap = abs(forces[i]) * work.size[i], i, abs(forces[i])
    if worst.row >= moving:
        worst.gap /= weights[worst.row - moving]
    return largest


@kernel
def fastest_drive(arrays: Any, steady: SteadyStart) -> float:
    """Return the largest speed of a drive in units of its coordinate, 1/s."""
    fastest = 0.0
    for k in range(steady.drives.shape[0]):
        speed = signal(steady.drives[k], 0.0, arrays)[1]
        fastest = max(fastest, abs(speed) / steady.drive_sizes[k])
    return fastest


@kernel
def check_closed(eqs: Any, q: Any, steady: SteadyStart, work: Any, fastest: float) -> int:
    """Return OPEN or OPENS if a constraint is open in the steady state, or opens; else ASSEMBLED. The terms are those
    of the steady state.
    """
    terms, worst, largest, rates = eqs.terms, work.worst[0], 0.0, fastest
    for r in range(steady.gaps.shape[0]):
        if not abs(steady.gaps[r]) / work.row[r] <= largest:
            largest, worst.row, worst.gap = abs(steady.gaps[r]) / work.row[r], r, abs(steady.gaps[r])
    if not largest <= CLOSED_TOLERANCE:
        return OPEN
    largest = 0.0
    for i in range(steady.v.shape[0] - steady.search.newton.weights.shape[0]):
        rates = max(rates, abs(steady.v[i]) / work.size[i])
    for r in range(steady.gaps.shape[0]):
        opening = -terms.nu[r]
        for i in range(steady.v.shape[0]):
            opening += terms.J[r, i] * steady.v[i]
        if not abs(opening) / work.row[r] <= largest:
            largest, worst.row, worst.gap = abs(opening) / work.row[r], r, abs(opening)
    return OPENS if not largest <= STEADY_TOLERANCE * rates else ASSEMBLED


@kernel
def check_moved(eqs: Any, q: Any, steady: SteadyStart, work: Any) -> int:
    """Return NOT_STEADY unless the forces balance with the same multipliers after drives at constant speed have moved.

    :func:`mbfmu.steady.checks.check_turned` lets the multipliers change if the forces of the cut joints turn with a
    body; a model for which they change at the export is not searched in the FMU.
    """
    fastest, n = fastest_drive(eqs.data.arrays, steady), steady.v.shape[0]
    moving = n - steady.search.newton.weights.shape[0]
    if not fastest > 0.0:
        return ASSEMBLED
    small = STEADY_TOLERANCE * find_stiffness(eqs, q, steady, work)
    for turn in CHECKED_DRIVE_POSITIONS:
        t = turn / fastest
        for i in range(n):
            steady.dq[i] = t * steady.v[i] if i < moving else 0.0
        move(eqs, q, steady)
        fill_balance(eqs, t, steady.q, steady, steady.dq, work.gaps)
        for i in range(n):
            steady.dq[i] -= steady.forces[i]
        if not note_largest(steady.dq, steady, work) <= small:
            return NOT_STEADY
        for r in range(steady.gaps.shape[0]):
            if not abs(work.gaps[r] - steady.gaps[r]) / work.row[r] <= STEADY_TOLERANCE:
                work.worst[0].row, work.worst[0].gap = r, abs(work.gaps[r])
                return OPEN
    return ASSEMBLED


@kernel
def move(eqs: Any, q: Any, steady: SteadyStart) -> None:
    """steady.q = q moved by steady.dq."""
    for i in range(q.shape[0]):
        steady.q[i] = q[i]
    eqs.retract(steady.q, steady.dq, eqs.data)


@kernel
def find_stiffness(eqs: Any, q: Any, steady: SteadyStart, work: Any) -> float:
    """Return what forces change by, times units, if coordinates change by about their units, J: as
    :func:`mbfmu.steady.checks.stiffness`, with other factors between -1 and 1.
    First-order states do not change.
    """
    largest, moving = 0.0, steady.v.shape[0] - steady.search.newton.weights.shape[0]
    for i in range(steady.v.shape[0]):
        steady.dq[i] = 0.0
    for i in range(moving):
        steady.dq[i] = STIFFNESS_STEP * work.size[i] * np.cos(1.0 + 2.0 * i)
    move(eqs, q, steady)
    fill_balance(eqs, 0.0, steady.q, steady, steady.dq, work.gaps)
    for i in range(steady.v.shape[0]):
        largest = max(largest, abs(steady.dq[i] - steady.forces[i]) * work.size[i])
    return largest / STIFFNESS_STEP

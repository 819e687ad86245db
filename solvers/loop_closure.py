"""Consistent positions and velocities from approximate ones: loops are closed, or are known to be open.

Gauss-Newton with the least change of the coordinates that are free (minimum norm), the step limited so that the loops
close on the branch that was meant. Coordinates and rows are measured in their units (``System.size`` and ``row_size``),
so that a mechanism closes alike at every size::

    J~ = R^-1 J S = L Q^T     s of least |J~ s - gaps|^2 + damping^2 |s|^2:    s = Q z,   [L; damping I] z = [gaps; 0]

with :func:`solvers.linalg.dense.factor_lq` once for Q and once, of the transposed, for z. Rows that depend on others
are no trouble: z has as many entries as there are independent ones, and all rows take part in it.

Nonholonomic constraints take part for the velocities only.

Three sets of coordinates may change, one after the other until the loops close: those without a given value; all that
are not held, given ones by ``GIVEN_WEIGHT`` of what the others change by; and all that are not held, alike.
Deformations change in the last stage only, by ``GIVEN_WEIGHT`` of what the others change by.

The inertia of the allowed motions is checked in the same way: Q_2, the last columns of Q, spans them.
"""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, Table, f8, i8
from solvers.compiled.tuple_pointer import pin
from solvers.linalg.dense import apply_Q, apply_Qt, factor_lq, rank_at, solve_transposed_basic
from solvers.positions import place_states
from solvers.system import AnySystem, Array

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.system import Terms

GAP_TOLERANCE = 1e-11  # in units of the row; a loop is closed
MAX_COORDINATE_STEP = 0.5  # in units of the coordinate, of one coordinate in one iteration
MAX_STAGES = 3  # sets of coordinates that are tried
MAX_ITERATIONS, MAX_STALLED_ITERATIONS = 200, 30  # in all, and without half of the gap
VELOCITY_RESIDUAL_TOLERANCE = 1e-8  # of a row's rate relative to the velocities: the loop opens
DRIVE_RATE_TOLERANCE = 1e-12  # ... or of the pace of the drives, whose motion may cancel in a row
DEPENDENT_ASSEMBLY_PIVOT_RATIO = 1e-9  # pivots below this part of the largest count as zero
MASSLESS_PIVOT_RATIO = 1e-12  # ... the same for the mass matrix
MASS_ROUNDING_RATIO = 1e-28  # square of rounding: what moves by so little of the largest mass moves none
GIVEN_WEIGHT = 1e-2  # weight of the change of a coordinate whose value is given, when it must change
MOVED_FRACTION = 0.1  # part of the largest change that names a coordinate


class Outcome(IntEnum):
    """How an assembly ended; the numbers are those the kernels return."""

    ASSEMBLED = 0
    OPEN = 1  # no closed position is near: row, and its gap
    NOT_FINITE = 2  # a row or its slope is not finite on the way: row
    OPENS = 3  # no velocities are consistent: row, and how fast it opens
    NO_MASS = 4  # what is allowed moves no mass: coordinates


ASSEMBLED, OPEN, NOT_FINITE, OPENS, NO_MASS = map(int, Outcome)  # for kernels


class WorstRecord(Record):
    """The constraint equation with the largest residual."""

    row: i8
    gap: f8


class Loops(NamedTuple):
    """What closing needs of a system of any size; kernels take :class:`solvers.system.Equations` as well."""

    position: Any
    retract: Any
    data: Any
    terms: Any

    @staticmethod
    def of(system: AnySystem) -> Any:
        """Return the loops of a system with separate terms, pinned."""
        return pin(Loops(system.position, system.retract, system.pinned_data, pin(system.allocate_terms())))


class ClosureScratch(NamedTuple):
    """Units, scratch, and what is wrong; allocated once. k = min(m, n)."""

    size: Array  # (n,) units of the coordinates
    row: Array  # (m,) units of the constraints
    free: Array  # (n,) 1 for coordinates that may be changed, 0 for those that are held
    given: Array  # (2, n) 1 where the position, and the velocity, is given and not only a default; 2: of a
    # deformation; else 0
    states: NDArray[np.int64]  # (k,) places of first-order states in v: the last ones
    nonholonomic: NDArray[np.int64]  # (k,) constraints that restrict velocities only
    weight: Array  # (n,) weight of the change of each coordinate now
    gaps: Array  # (m,) what is to be closed, in units of the rows
    step: Array  # (n,) the change that closes it, in units of the coordinates
    A: Array  # (m, n) L, and the reflectors of Q, of J~[pivots] = L Q^T
    tau: Array  # (m,) of the reflectors
    pivots: NDArray[np.int64]  # (m,) order of the rows, int64
    pivot: Array  # (m,) |L_ii|
    B: Array  # (k, m + k) factors of [L^T, damping I]
    b: Array  # (m + k,) its right side
    tau_B: Array  # (n,) of B or of a mass matrix
    pivots_B: NDArray[np.int64]  # (n,) int64
    left_B: Array  # (n,)
    own: Array  # (n,) measure of every allowed motion, root of its mass
    worst: Table[WorstRecord]  # (1,) the row that does not close, and by what, in SI units
    massless: Array  # (n,) 1 for coordinates of a motion that moves no mass, 0 for others

    @staticmethod
    def allocate(n: int, m: int, states: int = 0, nonholonomic: NDArray[np.int64] | None = None) -> ClosureScratch:
        """Return scratch for ``n`` velocities, all free, the last ``states`` of which are first-order states, and ``m``
        constraints, units of one; ``nonholonomic`` (k,) are those that restrict velocities only.
        """
        k, z, one = min(m, n), np.zeros, np.ones
        rows = np.zeros(0, np.int64) if nonholonomic is None else nonholonomic
        return ClosureScratch(
            one(n), one(m), one(n), z((2, n)), place_states(n, states), rows, one(n),
            z(m), z(n), z((m, n)), z(m), z(m, np.int64), z(m), z((k, m + k)), z(m + k), z(n),
            z(n, np.int64), z(n), z(n), WorstRecord.zeros(1), z(n),
        )  # fmt: skip

    @staticmethod
    def of(system: AnySystem, held: NDArray[np.bool_] | None = None, given: Array | None = None) -> ClosureScratch:
        """Return scratch with the units of a system; ``held`` (n,) coordinates are to stay, none by default.

        ``given`` (2, n) positions and velocities, 1, change after the others, deformations, 2, after these; none by
        default.
        """
        scratch = ClosureScratch.allocate(system.n, system.m, system.n_states, system.nonholonomic)
        scratch.size[:], scratch.row[:] = system.size, system.row_size
        if held is not None:
            scratch.free[held] = 0.0
        scratch.weight[:] = scratch.free
        if given is not None:
            scratch.given[:] = given
        return scratch


@kernel
def find_closed_positions(eqs: Loops, t: float, start: Any, q: Reals, work: ClosureScratch) -> int:
    """q (nq,) = closed positions near ``start`` (nq,). Where there are none: the last that was tried.

    First by damped steps (Levenberg and Marquardt, the damping falling as the square of the gap), which stay near where
    redundant constraints contradict each other in an open loop; then without damping, which converges near singular
    configurations.
    """
    code = OPEN
    for stage in range(MAX_STAGES):
        if set_weights(stage, work.given[0], work):
            code = iterate_to_closed(eqs, t, start, True, q, work)
            if code == OPEN:
                code = iterate_to_closed(eqs, t, start, False, q, work)
            if code == ASSEMBLED:
                break
    return code


@kernel
def set_weights(stage: int, given: Any, work: ClosureScratch) -> bool:
    """Fill work.weight for a stage of the module docstring; False if the stage does not differ from the last one."""
    some, others, deforms = False, False, False
    for j in range(given.shape[0]):
        if work.free[j] > 0.0:
            deforms = deforms or given[j] > 1.0
            some, others = some or given[j] == 1.0, others or not given[j] > 0.0
        weight = 1.0
        if given[j] > 1.0:
            weight = GIVEN_WEIGHT if stage == MAX_STAGES - 1 else 0.0
        elif given[j] > 0.0:
            weight = 0.0 if stage == 0 else GIVEN_WEIGHT if stage == 1 else 1.0
        work.weight[j] = work.free[j] * weight
    if stage == MAX_STAGES - 1 or (some and others):
        return True
    return deforms and (others if stage == 0 else some)


@kernel
def iterate_to_closed(eqs: Loops, t: float, start: Any, damped: bool, q: Reals, work: Any) -> int:
    """One of the two ways of :func:`find_closed_positions`."""
    for i in range(q.shape[0]):
        q[i] = start[i]
    best, since = np.inf, 0
    for _ in range(MAX_ITERATIONS):
        eqs.position(t, q, eqs.data, eqs.terms)
        if has_nonfinite(eqs.terms, work):
            return NOT_FINITE
        error = fill_scaled_gaps(eqs.terms, work)
        if error < GAP_TOLERANCE:
            return ASSEMBLED
        for k in range(work.nonholonomic.shape[0]):
            for j in range(eqs.terms.J.shape[1]):
                eqs.terms.J[work.nonholonomic[k], j] = 0.0
        since = 0 if error < 0.5 * best else since + 1
        best = min(best, error)
        if since > MAX_STALLED_ITERATIONS:
            break
        solve_least_change(eqs.terms.J, error if damped else 0.0, work)
        apply_limited_step(eqs, q, work)
    return OPEN


@kernel
def has_nonfinite(terms: Terms, work: ClosureScratch) -> bool:
    """Whether some row or its slope is not finite; the first that is not is the worst."""
    for i in range(terms.Phi.shape[0]):
        total = terms.Phi[i]
        for j in range(terms.J.shape[1]):
            total += 0.0 * terms.J[i, j]
        if not np.isfinite(total):
            worst = work.worst[0]
            worst.row, worst.gap = i, terms.Phi[i]
            return True
    return False


@kernel
def fill_scaled_gaps(terms: Terms, work: ClosureScratch) -> float:
    """work.gaps = Phi in units of the rows; return the largest."""
    worst, largest = work.worst[0], 0.0
    for i in range(terms.Phi.shape[0]):
        work.gaps[i] = terms.Phi[i] / work.row[i]
        if abs(work.gaps[i]) > largest:
            largest = abs(work.gaps[i])
            worst.row, worst.gap = i, abs(terms.Phi[i])
    return largest


@kernel
def apply_limited_step(eqs: Loops, q: Reals, work: Any) -> None:
    """q <- q (+) -S step, as much of it as no coordinate moves too far by; ``work.step`` becomes that."""
    largest = 0.0
    for j in range(work.step.shape[0]):
        largest = max(largest, abs(work.step[j]))
    part = min(1.0, MAX_COORDINATE_STEP / max(largest, 1e-300))
    for j in range(work.step.shape[0]):
        work.step[j] *= -work.size[j] * part
    eqs.retract(q, work.step, eqs.data)


@kernel
def factor_scaled_jacobian(J: Reals, whole: bool, work: Any) -> int:
    """Factor J (m, n) in units of rows and coordinates, the ``whole`` or weighted; return its rank."""
    m, n = J.shape
    for i in range(m):
        for j in range(n):
            part = 1.0 if whole else work.weight[j]
            work.A[i, j] = part * J[i, j] * (work.size[j] / work.row[i])
    factor_lq(work.A, m, n, work.tau, work.pivots, work.pivot)
    for i in range(min(m, n)):
        work.pivot[i] = abs(work.A[i, i])
    return rank_at(work.pivot, min(m, n), DEPENDENT_ASSEMBLY_PIVOT_RATIO)


@kernel
def solve_least_change(J: Any, damping: float, work: Any) -> None:
    """work.step = the shortest s of least |J~ s - work.gaps|^2 + damping^2 |s|^2; held coordinates stay."""
    m, n = J.shape
    rank = factor_scaled_jacobian(J, False, work)
    width = m + rank if damping > 0.0 else m
    for k in range(rank):
        for i in range(width):
            work.B[k, i] = damping if i == m + k else 0.0
        for i in range(k, m):
            work.B[k, work.pivots[i]] = work.A[i, k]
    for i in range(width):
        work.b[i] = work.gaps[i] if i < m else 0.0
    for j in range(n):
        work.step[j] = 0.0
    factor_lq(work.B, rank, width, work.tau_B, work.pivots_B, work.left_B)
    solve_transposed_basic(work.b, rank, width, rank, work.B, work.tau_B, work.pivots_B, work.step)
    apply_Q(work.A, work.tau, rank, n, work.step)
    for j in range(n):
        work.step[j] *= work.weight[j]


@kernel
def find_consistent_velocities(
    eqs: Loops, t: float, q: Reals, start: Any, rate: float, v: Reals, work: ClosureScratch
) -> int:
    """v (n,) = velocities with J v = nu, the least change from ``start`` (n,); ``rate`` (1/s) as that of the system."""
    code = OPENS
    for stage in range(MAX_STAGES):
        if code != ASSEMBLED and set_weights(stage, work.given[1], work):
            code = find_consistent_velocities_once(eqs, t, q, start, rate, v, work)
    return code


@kernel
def find_consistent_velocities_once(
    eqs: Loops, t: float, q: Reals, start: Any, rate: float, v: Reals, work: Any
) -> int:
    """One stage of :func:`find_consistent_velocities`."""
    m, n = eqs.terms.J.shape
    eqs.position(t, q, eqs.data, eqs.terms)
    fill_velocity_residual(eqs.terms, start, work)
    solve_least_change(eqs.terms.J, 0.0, work)
    fast = 0.0
    for j in range(n):
        v[j] = start[j] - work.size[j] * work.step[j]
        if j < n - work.states.shape[0]:
            fast = max(fast, abs(v[j] / work.size[j]))
    for i in range(m):
        fast = max(fast, abs(eqs.terms.nu[i] / work.row[i]))
    fill_velocity_residual(eqs.terms, v, work)
    worst, largest = work.worst[0], 0.0
    for i in range(m):
        if abs(work.gaps[i]) > largest:
            largest = abs(work.gaps[i])
            worst.row, worst.gap = i, largest * work.row[i]
    return OPENS if largest > VELOCITY_RESIDUAL_TOLERANCE * fast + DRIVE_RATE_TOLERANCE * rate else ASSEMBLED


@kernel
def fill_velocity_residual(terms: Terms, v: Reals, work: ClosureScratch) -> None:
    """work.gaps = J v - nu, in units of the rows."""
    for i in range(work.gaps.shape[0]):
        total = -terms.nu[i]
        for j in range(v.shape[0]):
            total += terms.J[i, j] * v[j]
        work.gaps[i] = total / work.row[i]


@kernel
def is_off_branch(terms: Terms, v: Reals, rank: int, tolerance: float, work: Any) -> bool:
    """Whether the rates v (n,) belong to no branch of the motion in a singular configuration with these ``terms``.

    An acceleration exists if J v' = gamma has a solution. In a singular configuration, in which J has not the ``rank``
    that it has nearby, this is the tangent cone of the constraints. What the best solution leaves of gamma is compared
    with ``tolerance`` times the squares of the rates, all in the units of rows and coordinates.
    """
    m, n = terms.J.shape
    for i in range(m):
        work.gaps[i] = terms.gamma[i] / work.row[i]
    for j in range(n):
        work.weight[j] = 1.0
    if rank == 0 or factor_scaled_jacobian(terms.J, True, work) >= rank:
        return False
    solve_least_change(terms.J, 0.0, work)
    left, rates = 0.0, 0.0
    for i in range(m):
        gap = work.gaps[i]
        for j in range(n):
            gap -= terms.J[i, j] * (work.size[j] / work.row[i]) * work.step[j]
        left += gap * gap
        rates += (terms.nu[i] / work.row[i]) ** 2
    for j in range(n - work.states.shape[0]):
        rates += (v[j] / work.size[j]) ** 2
    return bool(np.sqrt(left) > tolerance * rates)


@kernel
def check_mobile_mass(terms: Terms, mass: Any, work: Any) -> int:
    """Whether all that the constraints allow moves mass, held or not; ``mass`` (n, n) is scratch.

    Every motion is scaled by itself: a light body may move together with a heavy one. First-order states are not
    considered.
    """
    n = terms.M.shape[0]
    rank = factor_scaled_jacobian(terms.J, True, work)
    reduce_mass_matrix(terms.M, rank, mass, work)
    freedom, most = n - work.states.shape[0] - rank, 0.0
    for k in range(freedom):
        most = max(most, mass[k, k])
    most = most if most > 0.0 else 1.0
    for k in range(freedom):
        work.own[k] = np.sqrt(mass[k, k] if mass[k, k] > MASS_ROUNDING_RATIO * most else most)
    for k in range(freedom):
        for i in range(freedom):
            mass[k, i] /= work.own[k] * work.own[i]
    factor_lq(mass, freedom, freedom, work.tau_B, work.pivots_B, work.left_B)
    if freedom == 0 or not abs(mass[freedom - 1, freedom - 1]) <= MASSLESS_PIVOT_RATIO * max(abs(mass[0, 0]), 1e-300):
        return ASSEMBLED
    mark_massless_coordinates(freedom, rank, mass, work)
    return NO_MASS


@kernel
def reduce_mass_matrix(M: Reals, rank: int, mass: Any, work: Any) -> None:
    """First n - rank rows and columns of ``mass`` = Q_2^T S M S Q_2."""
    n = M.shape[0]
    for i in range(n):
        for j in range(n):
            mass[i, j] = work.size[i] * M[i, j] * work.size[j]
        apply_Qt(work.A, work.tau, rank, n, mass[i])
    for i in range(n):
        for j in range(i):
            mass[i, j], mass[j, i] = mass[j, i], mass[i, j]
    for i in range(rank, n):
        apply_Qt(work.A, work.tau, rank, n, mass[i])
        for j in range(rank, n):
            mass[i - rank, j - rank] = mass[i, j]


@kernel
def mark_massless_coordinates(freedom: int, rank: int, mass: Any, work: ClosureScratch) -> None:
    """work.massless from the factors of a singular ``mass``: coordinates of one motion that it has nothing for."""
    n, x, y, solid = work.step.shape[0], work.left_B, work.step, freedom
    while solid > 0 and not abs(mass[solid - 1, solid - 1]) > MASSLESS_PIVOT_RATIO * abs(mass[0, 0]):
        solid -= 1
    for k in range(freedom):
        x[k] = 1.0 if k == freedom - 1 else 0.0
    apply_Q(mass, work.tau_B, solid, freedom, x)
    for j in range(n):
        y[j] = x[j - rank] / work.own[j - rank] if j >= rank else 0.0
    apply_Q(work.A, work.tau, rank, n, y)
    most = 0.0
    for j in range(n):
        most = max(most, abs(y[j]))
    for j in range(n):
        work.massless[j] = 1.0 if abs(y[j]) > MOVED_FRACTION * most else 0.0

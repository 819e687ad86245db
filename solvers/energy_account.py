"""Energy accounting of a stepper: accumulated work W of forces without potential, and a bound of the energy error.

Along an exact motion E - W is constant, where W is the work of all forces without a potential. A step ends off the
exact motion through its beginning by its local error e = (e_q, e_v), so to first order a run has

    E(t) - E(0) - W(t) = sum over steps (g . e_q + p . e_v - e_W),      p = dE/dv,  g = dE/dq.

The error control keeps ||e / tol|| <= 1, tol_i = rtol |y_i| + atol_i, so by Cauchy and Schwarz one step adds at most
the *step bound*

    sqrt(sum (p_i tol_i)^2 + sum (g_i tol_i)^2),

and the sum over the steps is the energy error that the tolerance explains (``energy_error_bound``). p is the
generalized momentum of all bodies, including drives. g is approximated by the bias h of the equations of motion, which
contains the forces of all potentials and the same products of velocities. An energy that is a square of the error is
covered, since the step bound is evaluated where a step ends. e_W is not controlled by a tolerance. Driven coordinates
count among the others as if they were integrated, since the error of W results from their momentum and force; the error
estimate of a formula for W is added. The largest such error of a step is ``max_work_error``: at corners of a force, as
where a stop releases a body, the error of W is larger than that of the motion.

Error estimates are those of a smooth motion. A rejected step shows that the force has a corner there: the estimates are
then multiplied by the same factor as those of W.

The *extent* of the motion is its largest displacement or velocity in absolute tolerances, whichever is smaller. The
energy of a motion of a few tolerances is not accurate.

A *slow passage* leads past an unstable equilibrium: a pendulum swings over its highest position, or turns just
below it. Its energy is the kinetic energy where it is slowest, or the energy lacking to pass. The momentum times the
velocities of the previous evaluation changes its sign where the motion turns. Every step must be evaluated for that, so
it is done at large tolerances, where steps are few. A passage counts when the kinetic energy has risen again: not if a
motion comes to rest, and not if the work done exceeds the kinetic energy, since inertia is not decisive there.

The *exchanged energy* is the range of the kinetic energy so far plus the total variation of W.

If another library takes the steps, W is accumulated here: over each step the integral of the polynomial through the
powers at the ends of the last steps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from solvers.compiled.kernel import inlined, kernel

from .system import Array

if TYPE_CHECKING:
    from solvers.compiled.record import Integers, Reals

PASSAGE_SPEEDS = 4  # by which a slow passage is found
ACCOUNT_FIELDS: list[Any] = [
    ("step_energy_error_bound", "f8"),  # J, of one step, at the last evaluation
    ("energy_error_bound", "f8"),  # J, sum of the step bounds
    ("kinetic_max", "f8"),  # J, largest and smallest kinetic energy
    ("kinetic_min", "f8"),
    ("work_total_variation", "f8"),  # J, sum of |changes of W|
    ("check_count", "i8"),  # evaluations of the step bound
    ("max_work_error", "f8"),  # J, the largest estimated error of the work of one step
    ("passage_energy", "f8"),  # J, of the last slow passage; 0: there was none
    ("open_passage_energy", "f8"),  # J, of one that the motion has yet to leave; 0: there is none
    ("kinetic_max_since_passage", "f8"),  # J, the largest kinetic energy since the last one
    ("last_kinetic", "f8"),  # J, kinetic energy at the last evaluation
    ("check_every_step", "i8"),  # 1: the step bound is evaluated at every step
    ("bound_is_new", "i8"),  # 1: the last evaluation is of this step
    ("speed_sign", "f8"),  # of the speed; it changes where the motion turns
    ("speeds", "f8", PASSAGE_SPEEDS),  # root of twice the kinetic energy where the last steps ended, the last one last
    ("speed_intervals", "f8", PASSAGE_SPEEDS - 1),  # s, between them; 0: it is not known
    ("corner_rejections", "f8"),  # rejections of the current step where a force may have a corner
    ("max_displacement", "f8"),
    ("max_velocity", "f8"),  # the largest displacement and velocity so far, in absolute tolerances
]
POWER_POINTS = 6  # powers of the polynomial: the number of states of a formula of order 5
ENERGY_ACCOUNT = np.dtype(
    [
        *ACCOUNT_FIELDS, ("steps", "i8"),
        ("work_before", "f8"), ("work", "f8"),  # J, W where the last step began and ended
        # number, times (s) and powers (W) of the ends of the last steps, the last one first
        ("power_count", "i8"), ("power_times", "f8", POWER_POINTS), ("powers", "f8", POWER_POINTS),
    ],
    align=True,
)  # fmt: skip
GAUSS_NODES, GAUSS_WEIGHTS = np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)]), np.array([5.0, 8.0, 5.0]) / 9.0
# Entries of a reported row
WORK, ENERGY_ERROR_BOUND, EXCHANGED_ENERGY, KINETIC_MAX, STEP_BOUND, MAX_WORK_ERROR, EXTENT, PASSAGE_ENERGY = range(8)
ACCOUNT_SIZE = 8
# Number of scalar results of an evaluation: the step bound in the norm of a sum, the kinetic energy, J, displacement
# and velocity in absolute tolerances, and the momentum times the velocities of the previous evaluation, J. The
# positions at the first evaluation (rad or m, nan before it) and the velocities at the last one follow.
SCALAR_RESULTS = 5
# Of the largest kinetic energy, and of what it was in a slow passage: above both the passage is left. Before it the
# energy must have been above the latter, too: errors of a steady speed are no passages.
PASSAGE_EXIT_FRACTION, PASSAGE_RISE_FACTOR = 0.1, 4.0
CHECK_EVERY_STEP_TOLERANCE = 5e-4  # tolerance from which every step is examined for slow passages
# steps between two evaluations of the step bound; steps in a row at the start, and after a change
CHECK_INTERVAL_STEPS, INITIAL_CHECK_STEPS, RENEWED_CHECK_STEPS = 8, 24, 3
WORK_ERROR_SAFETY = 12.0  # estimates of errors are multiplied by this where forces have corners
# In tolerances: error of a mesh's vibrations that is no reason for a warning, as of other motions that count as right
# in tests; and the largest such error in units of the coordinates: at 1e-2 the whole motion of a mesh is 50 to 120
# tolerances.
MAX_MESH_ERROR_IN_TOLERANCES, MAX_MESH_ERROR_IN_SIZES = 100.0, 1e-2
REPORTED_BOUND_FACTOR = 4.0  # in step bounds: a reported state is interpolated and projected


class EnergyScales(NamedTuple):
    """Tolerances and scales of the step bound."""

    rtol: Array  # (1,)
    position_tolerance: Array  # (n,)  absolute tolerances of the free coordinates, and of their rates
    rate_tolerance: Array  # (n,)
    mean_count: Array  # (1,)  number over which the error's norm takes the mean square; 1: sum of squares
    bound_results: Array  # (5 + 2 n,)  see SCALAR_RESULTS
    extent_factors: Array  # (2,)  by which displacement and velocity are multiplied, to be in tolerances of the motion

    @staticmethod
    def of(
        rtol: float,
        position_tolerance: Array,
        rate_tolerance: Array,
        mean_count: int = 1,
        extent_factors: tuple[float, float] = (1.0, 1.0),
    ) -> EnergyScales:
        """Return the scales of these tolerances."""
        bound_results = np.concatenate((np.zeros(SCALAR_RESULTS), np.full(2 * len(position_tolerance), np.nan)))
        return EnergyScales(
            np.array([rtol]),
            position_tolerance,
            rate_tolerance,
            np.array([float(mean_count)]),
            bound_results,
            np.array(extent_factors),
        )

    @staticmethod
    def of_mesh(
        rtol: float, position_tolerance: Array, rate_tolerance: Array, mean_count: int, rate_factor: float
    ) -> EnergyScales:
        """Return those of a mesh, whose stiff modes are damped on purpose; ``rate_factor`` is the ratio of its
        tolerances of rates to the usual ones.
        """
        error = max(1.0, min(MAX_MESH_ERROR_IN_TOLERANCES, MAX_MESH_ERROR_IN_SIZES / rtol))
        return EnergyScales.of(rtol, position_tolerance, rate_tolerance, mean_count, (1.0 / error, rate_factor / error))


@kernel
def set_energy_scales(scales: EnergyScales, absolute: float, size: Reals, rates: Reals) -> None:
    """Set the absolute tolerance, in units ``size`` of the coordinates, whose own rates are ``rates`` (n,), 1/s."""
    for k in range(size.shape[0]):
        scales.position_tolerance[k] = absolute * size[k]
        scales.rate_tolerance[k] = rates[k] * scales.position_tolerance[k]
        scales.bound_results[SCALAR_RESULTS + k], scales.bound_results[SCALAR_RESULTS + size.shape[0] + k] = (
            np.nan,
            np.nan,
        )


@kernel
def set_uniform_scales(
    scales: EnergyScales, rtol: float, absolute: float, size: Reals, rate: float, mean_count: int
) -> None:
    """As :meth:`EnergyScales.of`; absolute tolerances of rates are those of coordinates times ``rate``, 1/s."""
    scales.rtol[0], scales.mean_count[0] = rtol, mean_count
    scales.extent_factors[0], scales.extent_factors[1] = 1.0, 1.0
    n = size.shape[0]
    for k in range(n):
        scales.position_tolerance[k] = absolute * size[k]
        scales.rate_tolerance[k] = rate * scales.position_tolerance[k]
        scales.bound_results[SCALAR_RESULTS + k], scales.bound_results[SCALAR_RESULTS + n + k] = np.nan, np.nan


@kernel
def set_state_scales(scales: EnergyScales, absolute: float, size: Reals, states: Integers) -> None:
    """Set the absolute tolerances of first-order states, whose places are ``states`` (k,), in units ``size`` (n,)."""
    for k in range(states.shape[0]):
        scales.rate_tolerance[states[k]] = absolute * size[states[k]]


@kernel
def set_mesh_scales(
    scales: EnergyScales, rtol: float, absolute: float, size: Reals, rate: float, mean_count: int, rate_factor: float
) -> None:
    """As :meth:`EnergyScales.of_mesh`; absolute tolerances of rates are those of coordinates times ``rate``, 1/s."""
    set_uniform_scales(scales, rtol, absolute, size, rate, mean_count)
    error = max(1.0, min(MAX_MESH_ERROR_IN_TOLERANCES, MAX_MESH_ERROR_IN_SIZES / rtol))
    scales.extent_factors[0], scales.extent_factors[1] = 1.0 / error, rate_factor / error


@kernel
def update_energy_bound(evaluate_energy_bound: Any, data: Any, account: Any, scales: EnergyScales) -> None:
    """Evaluate the step bound and the kinetic energy with ``evaluate_energy_bound`` of a system."""
    evaluate_energy_bound(scales.rtol[0], scales.position_tolerance, scales.rate_tolerance, data, scales.bound_results)
    kinetic = scales.bound_results[1]
    if account.check_count == 0:
        account.kinetic_max, account.kinetic_min = kinetic, kinetic
    account.check_count += 1
    account.kinetic_max, account.kinetic_min = max(account.kinetic_max, kinetic), min(account.kinetic_min, kinetic)
    account.step_energy_error_bound = scales.bound_results[0] * np.sqrt(scales.mean_count[0])
    account.max_displacement, account.max_velocity = (
        max(account.max_displacement, scales.extent_factors[0] * scales.bound_results[2]),
        max(account.max_velocity, scales.extent_factors[1] * scales.bound_results[3]),
    )
    account.last_kinetic, account.bound_is_new, account.check_every_step = (
        kinetic,
        1,
        int(scales.rtol[0] >= CHECK_EVERY_STEP_TOLERANCE),
    )
    if account.speed_sign == 0.0:
        account.speed_sign = 1.0
    if account.check_every_step == 1 and scales.bound_results[4] < 0.0:
        account.speed_sign = -account.speed_sign


@kernel
def energy_check_scheduled(account: Any) -> bool:
    """Whether the step bound is evaluated at this step: it changes slowly, except at the start and after jumps of
    loads.
    """
    return (
        account.check_count < INITIAL_CHECK_STEPS
        or account.steps % CHECK_INTERVAL_STEPS == 0
        or account.corner_rejections > 0.0
        or account.check_every_step == 1
    )


@kernel
def reset_check_schedule(accounts: Any) -> None:
    """Schedule an evaluation at each of the next steps: loads have changed. accounts (1,) of ACCOUNT_FIELDS."""
    account = accounts[0]
    account.check_count = min(account.check_count, INITIAL_CHECK_STEPS - RENEWED_CHECK_STEPS)
    clear_speeds(account)


@inlined
def count_rejected_step(account: Any, corner: bool) -> None:
    """Count a rejected step; ``corner``: its error may be that of a corner of a force."""
    account.rejected += 1
    if corner:
        account.corner_rejections += 1.0


@inlined
def clear_speeds(account: Any) -> None:
    """Discard the speeds: only later steps are examined for slow passages."""
    account.open_passage_energy, account.kinetic_max_since_passage = 0.0, 0.0
    for k in range(PASSAGE_SPEEDS - 1):
        account.speed_intervals[k] = 0.0


@inlined
def detect_slow_passage(account: Any, taken: float) -> None:
    """Record whether the steps before the last one, of ``taken`` (s), were a slow passage, and whether it is left.

    Near an unstable equilibrium speeds are proportional to cosh(k t) if the motion passes and to sinh(k t) if it turns.
    """
    s, h = account.speeds, account.speed_intervals
    for k in range(PASSAGE_SPEEDS - 1):
        s[k], h[k] = s[k + 1], h[k + 1] if k < PASSAGE_SPEEDS - 2 else taken
    s[PASSAGE_SPEEDS - 1], low = account.speed_sign * np.sqrt(2.0 * max(0.0, account.last_kinetic)), 0.0
    if account.check_every_step == 1 and h[0] > 0.0 and account.work_total_variation < account.kinetic_max:
        if s[1] * s[2] < 0.0:
            slope = (s[2] - s[1]) / h[1]
            left = 2.0 * (slope - (s[1] - s[0]) / h[0]) / (h[0] + h[1])
            right = 2.0 * ((s[3] - s[2]) / h[2] - slope) / (h[1] + h[2])
            growth = (left * s[1] + right * s[2]) / (s[1] * s[1] + s[2] * s[2])
            if min(left * s[1], right * s[2]) > 0.0:  # at a stop it is one of the two at most
                low = 0.5 * slope * slope / growth
        elif s[0] * s[1] > 0.0 and abs(s[1]) < min(abs(s[0]), abs(s[2])):
            low = 0.5 * s[1] * s[1]
    account.kinetic_max_since_passage = max(account.kinetic_max_since_passage, account.last_kinetic)
    if 0.0 < low < account.kinetic_max_since_passage / PASSAGE_RISE_FACTOR and (
        account.open_passage_energy == 0.0 or low < account.open_passage_energy
    ):
        account.open_passage_energy = low
    if account.open_passage_energy > 0.0 and account.last_kinetic > max(
        PASSAGE_EXIT_FRACTION * account.kinetic_max, PASSAGE_RISE_FACTOR * account.open_passage_energy
    ):
        account.passage_energy, account.open_passage_energy, account.kinetic_max_since_passage = (
            account.open_passage_energy,
            0.0,
            account.last_kinetic,
        )


@inlined
def add_energy_error_bound(account: Any, error: float, taken: float) -> None:
    """Add the largest change of the energy error in a step of ``taken`` (s); ``error`` is the estimated error of its
    work, J.
    """
    if account.bound_is_new == 1:
        detect_slow_passage(account, taken)
        account.bound_is_new = 0
    else:
        clear_speeds(account)
    account.max_work_error = max(account.max_work_error, abs(error))
    account.energy_error_bound += (
        1.0 + WORK_ERROR_SAFETY * account.corner_rejections
    ) * account.step_energy_error_bound + WORK_ERROR_SAFETY * abs(error)
    if account.corner_rejections > 0.0:
        account.corner_rejections, account.check_count = (
            0.0,
            min(account.check_count, INITIAL_CHECK_STEPS - RENEWED_CHECK_STEPS),
        )


@kernel
def restart_work(accounts: Any, work: float) -> None:
    """Discard the powers: the motion continues from another state, where W is ``work``, J. accounts (1,) of
    ENERGY_ACCOUNT.
    """
    account = accounts[0]
    account.power_count, account.work, account.work_before = 0, work, work
    account.check_count = min(account.check_count, INITIAL_CHECK_STEPS - RENEWED_CHECK_STEPS)
    clear_speeds(account)


@kernel
def record_step(accounts: Any, t: float, power: float) -> None:
    """Record a step that ended at t with ``power`` (W); the first call only stores it."""
    account = accounts[0]
    for k in range(POWER_POINTS - 1, 0, -1):
        account.power_times[k], account.powers[k] = account.power_times[k - 1], account.powers[k - 1]
    account.power_times[0], account.powers[0] = t, power
    account.power_count = min(account.power_count + 1, POWER_POINTS)
    account.work_before = account.work
    if account.power_count > 1:
        done = integrate_power(account, t, account.power_count)
        account.work += done
        account.steps += 1
        account.work_total_variation += abs(done)
        add_energy_error_bound(
            account, done - integrate_power(account, t, account.power_count - 1), t - account.power_times[1]
        )


@kernel
def work_at(accounts: Any, t: float) -> float:
    """W at t in the last step, J."""
    account = accounts[0]
    return (
        account.work_before + integrate_power(account, t, account.power_count)
        if account.power_count > 1
        else account.work
    )


@kernel
def integrate_power(account: Any, t: float, points: int) -> float:
    """Exact integral, from the beginning of the last step to t, of the polynomial through the last powers."""
    middle, half, total = 0.5 * (account.power_times[1] + t), 0.5 * (t - account.power_times[1]), 0.0
    for k in range(GAUSS_NODES.shape[0]):
        s = middle + half * GAUSS_NODES[k]
        for i in range(points):
            value = GAUSS_WEIGHTS[k] * account.powers[i]
            for j in range(points):
                if j != i:
                    value *= (s - account.power_times[j]) / (account.power_times[i] - account.power_times[j])
            total += value
    return half * total


@kernel
def fill_account_row(account: Any, work: float, row: Any) -> None:
    """row (ACCOUNT_SIZE,) = work, bound of the energy error, exchanged energy, largest kinetic energy, step bound,
    largest error of the work of one step, J, the extent of the motion in absolute tolerances, and the energy of the
    last slow passage, J.
    """
    row[0], row[1], row[2] = (
        work,
        account.energy_error_bound + REPORTED_BOUND_FACTOR * account.step_energy_error_bound,
        account.kinetic_max - account.kinetic_min + account.work_total_variation,
    )
    row[3], row[4], row[5], row[6] = (
        account.kinetic_max,
        account.step_energy_error_bound,
        WORK_ERROR_SAFETY * account.max_work_error,
        min(account.max_displacement, account.max_velocity),
    )
    row[7] = account.passage_energy


@kernel
def fill_account_row_at(accounts: Any, t: float, row: Any) -> None:
    """:func:`fill_account_row` with the work at t in the last step. accounts (1,) of ENERGY_ACCOUNT."""
    fill_account_row(accounts[0], work_at(accounts, t), row)

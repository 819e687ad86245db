"""Every solver against exact motions, through singular configurations, and against its contract."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import oracles
import pytest
from oracles import fourbar, fourbar_q, fourbar_v, particle, pendulum, rigid_body, singular_times

from solvers import SOLVERS, Code, Options, SolverError, Switching
from solvers.steppers.ida.dense_memory import MIN_RTOL

START = np.radians(10.0)
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
BOUND = {"adams": 100.0, "hybrid": 300.0, "ida": 1000.0, "radau": 30.0}  # of the largest error, in units of rtol
PACE = 0.2  # s, one radian at full speed
TIMES = tuple(np.linspace(0.0, 10.0, 101)[1:])


def run(name, rtol, times=TIMES, theta=START, rate=0.0, rocker_mass=1.0, redundant=False, without_rates=(), **options):
    """Return stepper and largest error of positions, rad, and of velocities times PACE, not at times without rates."""
    exact = pendulum(theta, rate, rocker_mass)
    system = fourbar(rocker_mass, redundant)
    stepper = SOLVERS[name](system, 0.0, fourbar_q(theta), fourbar_v(rate), Options(rtol=rtol, **options))
    largest = 0.0
    for t in times:
        if not stepper.advance(t).ok:
            break
        angle, speed = exact(t)
        largest = max(largest, abs(stepper.q - fourbar_q(angle)).max())
        if t not in without_rates:
            largest = max(largest, PACE * abs(stepper.v - fourbar_v(speed)).max())
    return stepper, largest


SOON = 0.01  # s, after a singular configuration
CASES = {
    "generic": {},
    "starts singular": {"theta": 0.0, "rate": 2.0},
    "heavy rocker": {"rocker_mass": 3.0},
    "heavy rocker starts singular": {"theta": 0.0, "rate": 2.0, "rocker_mass": 3.0},
    "output at singular times": {"times": "singular"},
    "redundant": {"redundant": True},
}


@pytest.mark.parametrize("rtol", TOLERANCES)
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("name", BOUND)
def test_passes_all_singular_positions(name, case, rtol):
    options = dict(CASES[case])
    if options.get("times") == "singular":
        options["times"] = times = singular_times()
        if (
            name == "ida"
        ):  # reports rates there that rounding has put off by up to 1e-5 rad/s; they are right soon after
            options |= {"times": sorted((*times, *(t + SOON for t in times))), "without_rates": set(times)}
    stepper, error = run(name, rtol, **options)
    assert stepper.status.ok, stepper.status.message
    assert error <= BOUND[name] * rtol


@pytest.mark.parametrize("name", BOUND)
def test_errors_fall_with_the_tolerance(name):
    errors = [run(name, rtol)[1] for rtol in TOLERANCES if name != "ida" or rtol > MIN_RTOL]
    assert all(late < 0.2 * early for early, late in pairwise(errors))


@pytest.mark.parametrize("name", BOUND)
def test_a_restart_in_every_singular_position_does_not_lose_the_branch(name):
    exact = pendulum()
    stepper = SOLVERS[name](fourbar(), 0.0, fourbar_q(START), np.zeros(3), Options(rtol=1e-8))
    for t in singular_times():
        assert stepper.advance(t).ok
        stepper.restart()
    np.testing.assert_allclose(stepper.q, fourbar_q(exact(stepper.t)[0]), atol=2e-5)


@pytest.mark.parametrize("name", BOUND)
def test_steps_that_end_where_asked_do_not_end_in_singular_positions(name):
    exact = pendulum()
    stepper = SOLVERS[name](fourbar(), 0.0, fourbar_q(START), np.zeros(3), Options(rtol=1e-8))
    for t in singular_times():
        for ahead in (0.01, 1e-4, 0.0):
            stepper.continue_after_event()
            assert stepper.advance(t - ahead).ok
    np.testing.assert_allclose(stepper.q, fourbar_q(exact(stepper.t)[0]), atol=2e-5)


def test_lu_passes_the_first_singular_position_and_fails_at_the_second():
    stepper, error = run("adams-lu", 1e-6)
    assert stepper.status.code is Code.COLLAPSED
    assert stepper.t == pytest.approx(singular_times()[1], abs=1e-3)
    assert error < 1e-4
    assert stepper.statistics.choices > 10
    assert "'adams'" in stepper.status.remedy


def test_lu_at_a_loose_tolerance_jumps_branch():
    stepper, error = run("adams-lu", 3e-4)
    angles = np.cumsum(stepper.q)
    assert error > 1.0
    assert abs(np.sin(0.5 * (angles[2] - np.pi - angles[0]))) > 1e-3


def test_hybrid_uses_both_partitions_and_reports_why_it_switched():
    stepper, _ = run("hybrid", 1e-6, max_step=0.01)
    s = stepper.statistics
    assert s.partition_switches >= 2 * s.left_by_turn - 1 > 0
    assert s.time_lu > 1.0
    assert s.time_projection > 1.0
    assert s.time_lu + s.time_projection == pytest.approx(10.0, abs=0.02)


def test_limit_of_the_acceleration_in_the_singular_position():
    stepper = SOLVERS["adams"](fourbar(3.0), 0.0, fourbar_q(0.0), fourbar_v(1.0))
    a, lam = stepper.accelerations()
    inertia, weight = 4.0 / 3.0 + 3.0, 2.0 + 3.0
    np.testing.assert_allclose(a, fourbar_v(-weight * oracles.G / inertia), rtol=1e-6)
    assert np.isfinite(lam).all()


def test_at_rest_in_the_singular_position_nothing_is_decided():
    stepper = SOLVERS["adams"](fourbar(), 0.0, fourbar_q(0.0), np.zeros(3))
    assert stepper.advance(1.0).code is Code.UNDECIDABLE
    assert stepper.t == 0.0
    assert "velocity" in stepper.status.remedy
    with pytest.raises(SolverError, match="velocity"):
        stepper.accelerations()


@pytest.mark.parametrize("name", SOLVERS)
def test_what_nothing_moves_stays(name):
    """At rest no slope bounds the first step."""
    stepper = SOLVERS[name](particle(4.0), 0.0, np.zeros(1), np.zeros(1), Options(rtol=1e-8))
    for t in (1e-3, 0.5, 30.0):
        assert stepper.advance(t).ok
        assert (stepper.t, stepper.q[0], stepper.v[0]) == (t, 0.0, 0.0)


@pytest.mark.parametrize("name", SOLVERS)
def test_oscillator(name):
    stepper = SOLVERS[name](particle(4.0), 0.0, np.ones(1), np.zeros(1), Options(rtol=1e-8))
    for t in np.linspace(0.1, 20.0, 50):
        assert stepper.advance(t).ok
        assert stepper.q[0] == pytest.approx(np.cos(2.0 * t), abs=1e-6)


@pytest.mark.parametrize("name", SOLVERS)
def test_a_free_body_keeps_its_angular_momentum_and_a_unit_quaternion(name):
    v0 = np.array([0.1, 2.0, 0.1])
    stepper = SOLVERS[name](rigid_body(), 0.0, np.array([1.0, 0.0, 0.0, 0.0]), v0, Options(rtol=1e-8))
    for t in np.linspace(1.0, 20.0, 20):
        assert stepper.advance(t).ok
        assert np.linalg.norm(stepper.q) == pytest.approx(1.0, abs=1e-14)
        momentum = oracles.angular_momentum(stepper.q, stepper.v)
        np.testing.assert_allclose(momentum, oracles.INERTIA * v0, atol=2e-5)


@pytest.mark.parametrize("name", ["adams", "hybrid", "adams-lu"])
def test_the_history_holds_unit_quaternions_however_long_the_run(name):
    options = Options(rtol=1e-4)
    stepper = SOLVERS[name](rigid_body(), 0.0, np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.1, 2.0, 0.1]), options)
    assert stepper.advance(300.0).ok
    assert np.linalg.norm(stepper.method.memory.y[:4]) == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5, 6, 8])
def test_observed_order(order):
    # a predictor of order k corrected by order k + 1: the error falls with h^(k + 1)
    coarse, errors = (0.02 if order < 4 else 0.09), []
    for step in (coarse, 0.5 * coarse):
        options = Options(rtol=1e-2, atol=1e6, max_step=step, max_order=order)
        stepper = SOLVERS["adams"](particle(1.0), 0.0, np.zeros(1), np.ones(1), options)
        stepper.advance(4.0)  # past the start at low order; from there against the exact motion of that state
        q, v = stepper.q[0], stepper.v[0]
        stepper.advance(6.0)
        errors.append(abs(stepper.q[0] - (q * np.cos(2.0) + v * np.sin(2.0))))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order + 1, abs=0.6)


@pytest.mark.parametrize("name", ["adams", "hybrid"])
def test_a_restored_run_goes_on_bit_for_bit(name):
    stepper, _ = run(name, 1e-6, times=(0.9,))
    saved = stepper.save()
    stepper.advance(1.3)
    first = stepper.q.tobytes() + stepper.v.tobytes()
    other, _ = run(name, 1e-6, times=())
    for again in (stepper, other):
        again.restore(saved)
        assert again.t == 0.9
        again.advance(1.3)
        assert again.q.tobytes() + again.v.tobytes() == first
    assert stepper.save() == other.save()


def test_ida_is_restored_to_its_tolerance():
    stepper, _ = run("ida", 1e-8, times=(0.9,))
    saved = stepper.save()
    stepper.advance(1.3)
    q = stepper.q
    stepper.restore(saved)
    assert stepper.advance(1.3).ok
    np.testing.assert_allclose(stepper.q, q, atol=1e-6)


def test_saved_bytes_of_another_system_are_refused():
    with pytest.raises(ValueError, match="bytes"):
        run("adams", 1e-6, times=())[0].restore(b"123")


@pytest.mark.parametrize("name", ["adams", "hybrid"])
def test_results_do_not_depend_on_communication_points(name):
    few, _ = run(name, 1e-6, times=(5.0, 10.0))
    many, _ = run(name, 1e-6, times=np.linspace(0.0, 10.0, 1001)[1:])
    assert few.q.tobytes() == many.q.tobytes()
    assert few.statistics == many.statistics


@pytest.mark.parametrize("name", SOLVERS)
def test_a_sample_is_what_advancing_step_by_step_gives(name):
    times = np.linspace(0.0, 0.8, 9)
    stepper, other = run(name, 1e-6, times=())[0], run(name, 1e-6, times=())[0]
    samples = stepper.sample(times)
    assert len(samples.q) == len(times)
    for t, q, v, a, lam, energy_account in zip(times, *samples, strict=True):
        assert other.advance(t).ok
        np.testing.assert_array_equal(energy_account, other.energy_account)
        np.testing.assert_array_equal(q, other.q)
        np.testing.assert_array_equal(v, other.v)
        for own, theirs in zip((a, lam), other.accelerations(), strict=True):
            np.testing.assert_allclose(own, theirs, rtol=1e-9, atol=1e-9)
    assert (stepper.t, stepper.status) == (other.t, other.status)
    assert stepper.q.tobytes() == other.q.tobytes()
    with pytest.raises(ValueError, match="ascend"):
        stepper.sample(np.array([0.5]))


@pytest.mark.parametrize("name", SOLVERS)
def test_a_sample_ends_where_advance_fails(name):
    stepper = SOLVERS[name](particle(1.0, nan_from=0.5), 0.0, np.ones(1), np.zeros(1), Options(rtol=1e-6))
    samples = stepper.sample(np.array([0.1, 0.2, 0.9, 1.0]))
    assert len(samples.a) == 2
    assert stepper.status.code is Code.NOT_FINITE
    assert 0.2 <= stepper.t <= 0.5
    assert np.isfinite(stepper.q).all()


def test_a_sample_ends_at_a_state_without_accelerations():
    stepper = SOLVERS["adams"](fourbar(), 0.0, fourbar_q(0.0), np.zeros(3))
    assert len(stepper.sample(np.array([0.0, 1.0])).q) == 0
    assert stepper.status.code is Code.UNDECIDABLE
    assert stepper.t == 0.0


@pytest.mark.parametrize("name", ["adams", "ida"])
def test_restart_takes_a_changed_force_from_the_reported_time_on(name):
    system = particle(1.0)
    stepper = SOLVERS[name](system, 0.0, np.ones(1), np.zeros(1), Options(rtol=1e-8))
    stepper.advance(1.0)
    system.data[0] = 0.0
    stepper.restart()
    stepper.advance(2.0)
    assert stepper.q[0] == pytest.approx(np.cos(1.0) - np.sin(1.0), abs=1e-6)
    assert stepper.statistics.restarts == 1


@pytest.mark.parametrize("name", ["adams", "ida"])
def test_a_derivative_that_is_not_finite_stops_at_the_last_good_state(name):
    stepper = SOLVERS[name](particle(1.0, nan_from=0.5), 0.0, np.ones(1), np.zeros(1), Options(rtol=1e-6))
    status = stepper.advance(1.0)
    assert status.code is Code.NOT_FINITE
    assert status.remedy
    assert 0.0 <= stepper.t <= 0.5
    assert np.isfinite(stepper.q).all()


def test_a_motion_that_ends_in_finite_time_stops():
    stepper = SOLVERS["adams"](particle(0.0, blow_up=1.0), 0.0, np.ones(1), 2.0 * np.ones(1))
    status = stepper.advance(2.0)
    assert status.code in (Code.COLLAPSED, Code.NOT_FINITE)
    assert stepper.t == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("name", ["adams", "hybrid"])
def test_step_limit_can_be_continued(name):
    limited, _ = run(name, 1e-6, times=(), max_steps=100)
    codes = [limited.advance(10.0).code for _ in range(10)]
    assert codes[0] is Code.MAX_STEPS
    assert codes[-1] is Code.OK
    assert limited.q.tobytes() == run(name, 1e-6, times=(10.0,))[0].q.tobytes()


def test_max_step_is_kept():
    stepper, _ = run("adams", 1e-4, times=(1.0,), max_step=0.01)
    assert stepper.statistics.steps >= 100
    assert stepper.statistics.step_size <= 0.01


def test_an_open_loop_is_closed_at_construction():
    stepper = SOLVERS["adams"](fourbar(), 0.0, fourbar_q(0.5) + np.array([1e-3, 0.0, -2e-3]), np.zeros(3))
    ends = np.cumsum(stepper.q)
    gap = np.cos(ends[0]) + 3.0 * np.cos(ends[1]) + np.cos(ends[2]) - 3.0
    assert abs(gap) < 1e-12


@pytest.mark.parametrize(
    "wrong",
    [{"rtol": 0.5}, {"rtol": float("nan")}, {"atol": -1.0}, {"max_step": 0.0}, {"max_order": 13}, {"max_steps": 0}],
)
def test_options_are_checked(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Options(**wrong)


def test_switching_needs_counts():
    with pytest.raises(ValueError, match="flicker_count"):
        Switching(flicker_count=0)


def test_wrong_sizes_and_times_are_named():
    with pytest.raises(ValueError, match="q0 has the shape"):
        SOLVERS["adams"](fourbar(), 0.0, np.zeros(2), np.zeros(3))
    with pytest.raises(ValueError, match="v0"):
        SOLVERS["adams"](fourbar(), 0.0, np.zeros(3), np.full(3, np.nan))
    with pytest.raises(ValueError, match="the time to advance to is"):
        run("adams", 1e-6, times=(1.0,))[0].advance(0.5)

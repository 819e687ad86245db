"""A few steps thrown away, so that every kernel is compiled (or loaded) before a run and not in its first step.

They go over so short a time that nothing moves: what they cost does not depend on the motion.
"""

from __future__ import annotations

import numpy as np

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.arrays import input_kernels
from solvers import SolverError
from solvers.compiled.tuple_pointer import pin
from solvers.resolution import start_rate
from solvers.stepper import Stepper
from solvers.steppers.guard import GuardedStepper

from .kernels.points import (
    Session,
    account_discontinuity,
    account_parameters,
    begin_session,
    check_point,
    check_samples,
    energy_at,
    note_energy,
    note_impulse,
    start_support_motions,
    store_velocity_jump,
)
from .stepper_run import SEQUENCE, StepperRun

WARMUP_TIME_FACTOR = 1e-6  # of the time in which the motion changes
MAX_WARMUP_STEPS = 30  # between two times of a trial


def interval_of(trial: Stepper, compiled: CompiledMechanism) -> float:
    """Return a time in which next to nothing moves, s; above the resolution of the clock."""
    n = len(trial.v)
    try:
        a, _ = trial.accelerations()
    except SolverError:
        a = np.zeros(n)
    size = np.ascontiguousarray(np.broadcast_to(compiled.system.size, n), float)
    v = trial.v[: compiled.system.n_velocities]
    rate = float(start_rate(compiled.system.rate, trial.options.duration, size, v, a))
    return max(WARMUP_TIME_FACTOR / rate if np.isfinite(rate) else 0.0, 1e4 * float(np.spacing(abs(trial.t))))


def compile_kernels(trial: Stepper, compiled: CompiledMechanism, outputs: int) -> bool:
    """Whether all went well with everything that a run calls: steps of ``trial``, and ``outputs`` of the compiled
    mechanism.

    Kernels differ with the solver, with dense or large systems, and with constraints.
    """
    t0, q, v = trial.t, trial.q, trial.v
    h, values = interval_of(trial, compiled), np.zeros((1, outputs))
    sampled = trial.sample(np.array([t0 + h]), values)
    compiled.observe(t0, q, v, np.zeros(len(v)), np.zeros(compiled.system.m), values[0])
    compiled.energy(t0, q, v)
    compiled.limit_ratio(t0, q)
    trial.limit_step(h)  # as where a signal changes fast, and no longer
    ends = [trial.status, trial.advance(t0 + 2.0 * h)]
    for k in (3, 4):  # as where loads change, the second time with what is kept across
        trial.continue_after_event()
        ends.append(trial.advance(t0 + k * h))
    _warm_up_points(trial, compiled, outputs)
    trial.statistics  # noqa: B018  # counts by a kernel
    if not isinstance(trial, GuardedStepper):
        trial.restore(trial.save())
    return len(sampled.q) > 0 and all(status.ok for status in ends)


def _warm_up_points(trial: Stepper, compiled: CompiledMechanism, outputs: int) -> None:
    """Call what communication points call, with inputs that are nobody's."""
    inputs = input_kernels.InputRecords.example()
    session, pinned = pin(Session.allocate(compiled.system.pinned_data, inputs, compiled.monitored)), pin(inputs)
    run = StepperRun(session, pinned, trial, outputs)
    state = trial.t, trial.q, trial.v
    begin_session(session, *state, 0, True, 1, 1e-6, 0.0, 1.0)
    SEQUENCE.set_input(run, 0, 0.0, np.nan)
    SEQUENCE.begin_step(run, trial.t + 1.0)
    input_kernels.perturb_motions(pinned, 0.0, 0.0)
    input_kernels.restore_motions(pinned)
    input_kernels.skip_points(pinned, 0.0)
    input_kernels.all_finished(pinned)
    start_support_motions(session)
    note_impulse(session, 0)
    store_velocity_jump(trial.v, 0, trial.v)
    account_discontinuity(session, energy_at(session, *state), *state)
    note_energy(session, *state)
    account_parameters(session, *state)
    check_point(session, *state, trial.energy_account, False)
    SEQUENCE.read(run)
    rows = np.atleast_2d(trial.q), np.atleast_2d(trial.v), np.atleast_2d(trial.energy_account)
    check_samples(session, np.zeros(1), *rows, np.zeros(1), np.zeros((1, outputs)))

"""A few steps thrown away, so that every kernel is compiled (or loaded) before a run and not in its first step.

They go over so short a time that nothing moves: what they cost does not depend on the motion.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from mbfmu.mechanics import Plant
from mbfmu.mechanics.arrays import points
from solvers import SolverError
from solvers.balance import BALANCE, check_energy_balance, find_violation
from solvers.compiled.kernel import records
from solvers.compiled.tuple_pointer import pin
from solvers.energy_account import ACCOUNT_SIZE
from solvers.stepper import Stepper, start_rate

WARMUP_TIME_FACTOR = 1e-6  # of the time in which the motion changes
MAX_WARMUP_STEPS = 30  # between two times of a trial


def interval_of(trial: Stepper, plant: Plant) -> float:
    """Return a time in which next to nothing moves, s; above the resolution of the clock."""
    n = len(trial.v)
    try:
        a, _ = trial.accelerations()
    except SolverError:
        a = np.zeros(n)
    size = np.ascontiguousarray(np.broadcast_to(plant.system.size, n), float)
    rate = float(start_rate(plant.system.rate, trial.options.duration, size, trial.v, a))
    return max(WARMUP_TIME_FACTOR / rate if np.isfinite(rate) else 0.0, 1e4 * float(np.spacing(abs(trial.t))))


def compile_kernels(trial: Stepper, plant: Plant, outputs: int) -> bool:
    """Whether all went well with everything that a run calls: steps of ``trial``, and ``outputs`` of the plant.

    Kernels differ with the solver, with dense or large systems, and with constraints.
    """
    t0, q, v = trial.t, trial.q, trial.v
    h, values = interval_of(trial, plant), np.zeros((1, outputs))
    sampled = trial.sample(np.array([t0 + h]), values)
    plant.observe(t0, q, v, np.zeros(len(v)), np.zeros(plant.system.m), values[0])
    plant.energy(t0, q, v)
    ends = [trial.status, trial.advance(t0 + 2.0 * h)]
    for k in (3, 4):  # as where loads change, the second time with what is kept across
        trial.continue_after_event()
        ends.append(trial.advance(t0 + k * h))
    with suppress(SolverError):
        trial.accelerations()
    _warm_up_points()
    return len(sampled.q) > 0 and all(status.ok for status in ends)


def _warm_up_points() -> None:
    """Call what communication points call, with inputs and a balance that are nobody's."""
    inputs, balance = pin(points.InputRecords.example()), records(1, BALANCE)
    points.set_input(inputs, 0, 0.0, 0.0)
    points.begin_support_motions(inputs, 0.0, 1.0)
    points.perturb_motions(inputs, 0.0, 0.0)
    points.restore_motions(inputs)
    points.start_motions(inputs, 0.0)
    points.skip_points(inputs, 0.0)
    points.all_finished(inputs)
    check_energy_balance(balance, 0.0, np.zeros(ACCOUNT_SIZE))
    find_violation(balance, np.zeros(1), np.zeros((1, ACCOUNT_SIZE)), np.zeros(1))

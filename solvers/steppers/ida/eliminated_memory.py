"""What an integration by IDA with eliminated constraints remembers, its options and tolerances."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import kernel, records
from solvers.compiled.record import Record, f8, i8
from solvers.energy_account import ENERGY_ACCOUNT, set_state_scales, set_uniform_scales
from solvers.positions import count_velocities
from solvers.system import Array

from .calls import IDAHandle
from .dense_callbacks import RTOL_EXPONENT
from .dense_memory import CONTROL, RTOL_FACTOR
from .loop import MAX_ORDER, N_COUNTERS, PROGRESS, STANDSTILL_RATIO

if TYPE_CHECKING:
    from solvers.steppers.step_loop import Integration


class SettingsRecord(Record):
    """Options of IDA with eliminated constraints."""

    rtol: f8  # relative tolerance of IDA
    motion_rtol: f8  # ... of the motion
    atol: f8  # absolute tolerance of IDA in units of the coordinates
    motion_atol: f8  # ... of the motion
    rate: f8  # of the motion, 1/s
    max_step: f8  # s
    max_order: i8
    max_steps: i8  # in one call
    energy_check: i8  # 1: record energy and work
    works: i8  # 1: some force does work


SETTINGS = SettingsRecord.dtype
# A tighter rtol is run as this one: near crossings of many loops at once rounding errors of accelerations are larger.
MIN_RTOL = 1e-8


class EliminatedIDAMemory(NamedTuple):
    """What is remembered from step to step; N = nq + n unknowns."""

    control: NDArray[Any]  # (1,) record of CONTROL
    progress: NDArray[Any]  # (1,) record of solvers.steppers.ida.loop.PROGRESS
    counts: Array  # (N_COUNTERS,) see solvers.steppers.ida.loop
    energy_record: NDArray[Any]  # (1,) record of ENERGY_ACCOUNT
    last_accepted: Array  # (N,) unknowns after the last step
    ida: Any  # solvers.steppers.ida.calls.IDAHandle

    @staticmethod
    def allocate(nq: int, n: int) -> EliminatedIDAMemory:
        """Return the memory of a motion that has yet to begin."""
        progress = records(1, PROGRESS)
        progress["is_pending"], progress["max_next_step"], progress["max_step"] = 1, np.inf, np.inf
        own = records(1, CONTROL), progress, np.zeros(N_COUNTERS), records(1, ENERGY_ACCOUNT), np.zeros(nq + n)
        return EliminatedIDAMemory(*own, IDAHandle.allocate(nq + n))

    def memory(self) -> list[NDArray[Any]]:
        """Return the arrays to save: IDA's history is not among them."""
        return [self.control, self.counts, self.energy_record]


@kernel
def set_options(options: Any, problem: Integration) -> None:
    """Fill the settings from a record of solvers.options.OPTIONS, ``options`` (1,)."""
    own, settings = options[0], problem.settings[0]
    rtol = max(MIN_RTOL, own.rtol)
    settings.motion_rtol, settings.motion_atol = rtol, rtol if own.absolute == own.rtol else own.absolute
    settings.rtol = RTOL_FACTOR * rtol**RTOL_EXPONENT
    settings.atol = settings.rtol if own.absolute == own.rtol else own.absolute * settings.rtol / rtol
    settings.max_step, settings.max_steps, settings.energy_check = own.max_step, own.max_steps, own.energy_check
    settings.max_order = own.max_order if own.max_order > 0 else MAX_ORDER
    problem.memory.progress[0].energy_check = own.energy_check


@kernel
def set_up(problem: Integration, t: float, rate: float) -> None:
    """Prepare a motion that starts at t (s) with this rate (1/s)."""
    progress = problem.memory.progress[0]
    problem.settings[0].rate, problem.memory.control[0].t = rate, t
    progress.t_reached, progress.t_begun = t, t
    set_tolerances(problem)


@kernel
def set_tolerances(problem: Integration) -> None:
    """Set the tolerances of IDA and of the energy account in the present units."""
    settings, size, atol = problem.settings[0], problem.work.loops.size, problem.memory.ida.atol
    nq, n, rate = problem.q.shape[0], problem.v.shape[0], settings.rate
    for i in range(nq):
        atol[i] = settings.atol * problem.work.loops.size_q[i]
    moving = count_velocities(problem.work.positions, n)
    for i in range(n):
        atol[nq + i] = settings.atol * ((rate if i < moving else 1.0) * size[i])
    set_uniform_scales(problem.scales, settings.motion_rtol, settings.motion_atol, size, rate, 1)
    set_state_scales(problem.scales, settings.motion_atol, size, problem.work.positions.states)
    problem.memory.progress[0].min_step = STANDSTILL_RATIO / rate

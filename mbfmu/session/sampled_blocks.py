"""The sampled blocks of a run, see :mod:`mbfmu.mechanics.sampling`: their times, and the jumps of their states."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.recursions.dynamics import watch_sensors
from mbfmu.mechanics.sampling import SampledBlock
from mbfmu.util.errors import UserError
from solvers.resolution import spacing
from solvers.system import AnySystem, Array

from .stepper_run import StepperRun

EQUAL_TIME_SPACINGS = 8  # of floating-point numbers, up to which two given times are one: no step is so short


class SampledBlocks:
    """The sampled blocks of one run.

    Attributes
    ----------
    counts
        Number of samples of each block that are over, from time zero on.
    """

    def __init__(self, compiled: CompiledMechanism, run: StepperRun) -> None:
        self._compiled, self._run = compiled, run
        self._blocks = compiled.mechanism.sampled
        self._periods = np.array([block.period for block in self._blocks])
        t, slack = run.stepper.t, EQUAL_TIME_SPACINGS * spacing(run.stepper.t)
        self.counts = np.ceil((t - slack) / self._periods).astype(np.int64) if self._blocks else np.zeros(0, np.int64)
        self.counts[:] = np.maximum(self.counts, 0)
        self._system: AnySystem | None = None
        self._places: list[Any] = []

    def adopt(self, declared: list[SampledBlock]) -> None:
        """Use the numbers of the same blocks with other parameters of the model; their times must be the same."""
        for before, after in zip(self._blocks, declared, strict=True):
            if before.period != after.period:
                raise UserError(
                    f"a parameter changes the period of block {before.name!r} during a run from {before.period!r} to "
                    f"{after.period!r}; allowed: other matrices. Use a parameter that is not tunable"
                )
        self._blocks = declared

    def next_time(self) -> float:
        """Return the time of the next sample, s; infinite: there is none."""
        return float(np.min(self.counts * self._periods, initial=np.inf))

    def jump(self) -> Array | None:
        """Take the samples of the time reached; return the jump (n,) of velocities and states, None: there are none."""
        run, t = self._run, self._run.stepper.t
        due = np.flatnonzero(self.counts * self._periods <= t + EQUAL_TIME_SPACINGS * spacing(t))
        if not len(due):
            return None
        parts, dv = self._compiled.sampled, np.zeros(len(run.v))
        u = np.zeros(len(parts))
        watch_sensors(t, run.q, run.v, parts, self._compiled.system.pinned_data, u)
        ends = np.cumsum([len(block.inputs) for block in self._blocks])
        for k in due:
            block, places = self._blocks[k], self._state_places()[k]
            values = run.v[places]
            dv[places] = block.sample(values, u[ends[k] - len(block.inputs) : ends[k]]) - values
        self.counts[due] += 1
        return dv

    def _state_places(self) -> list[Any]:
        """Return where the states of each block are in the velocities of the present system."""
        system = self._compiled.system
        if system is not self._system:
            names = {name: k for k, name in enumerate(system.coordinate_names)}
            self._system, self._places = system, [[names[own] for own in block.states] for block in self._blocks]
        return self._places

"""The steppers on Adams PECE: 'adams' (projection), 'adams-lu', and 'hybrid'."""

from __future__ import annotations

from typing import Any, ClassVar

from numpy.typing import NDArray

from solvers.compiled.kernel import records
from solvers.options import Options, Statistics
from solvers.steppers.compiled_loop import CompiledLoopStepper
from solvers.system import Array, System

from . import loop
from .explicit import ExplicitStepper
from .formulas import History, collect_counts
from .hybrid import HYBRID, LU, PROJECTION


class AdamsStepper(ExplicitStepper, CompiledLoopStepper):
    """Adams PECE with the projection partition; see :mod:`.loop`."""

    fallback_solvers: tuple[str, ...] = ("radau", "ida", "hybrid")
    partition = PROJECTION
    loop: ClassVar = loop

    def __init__(self, system: System, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        self._history = History.allocate(system.nq, system.n, system.m)
        self._control, self._settings = self._history.control[0], self._encode(self.options)
        self._set_up(self._history)

    def _encode(self, options: Options) -> NDArray[Any]:
        """Return the record the kernels read."""
        settings = records(1, loop.SETTINGS)
        loop.set_options(options.record(), settings)
        settings["partition"] = self.partition if self._rank else PROJECTION  # nothing to partition: all the same
        for name in (
            "flicker_steps", "flicker_count", "energy_jump", "collapse_cuts", "calm_steps"
        ):  # fmt: skip
            settings[name] = getattr(options.switching, name)
        return settings

    @property
    def _needs_work(self) -> bool:
        return self.options.energy_check or self.partition == HYBRID  # which asks whether the energy jumps

    def arrays(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.stepper.Stepper.arrays`."""
        seen, limit = self._scales.bound_results, self._settings["max_step"]
        own = self.clock, self._q, self._v, self._energy_account, seen, limit
        return [*self._history, *own, *self._workspace.memory()]

    @property
    def statistics(self) -> Statistics:
        """What the run has cost so far."""
        control = self._control
        left = int(control["by_turn"] + control["by_flicker"] + control["by_energy"] + control["by_collapse"])
        return Statistics(
            **collect_counts(control),
            partition_switches=left + int(control["returns"]),
            choices=int(control["changes"]),
            rate_growth=self._growth()[0],
            rate_growth_at=self._growth()[1],
            refused=int(control["refused"]),
            coarser=max(1.0, float(control["max_near_miss_factor"])),
            left_by_turn=int(control["by_turn"]),
            left_by_flicker=int(control["by_flicker"]),
            left_by_energy=int(control["by_energy"]),
            left_by_collapse=int(control["by_collapse"]),
            time_lu=float(control["time_lu"]),
            time_projection=float(control["time_projection"]),
        )


class AdamsLUStepper(AdamsStepper):
    """Adams PECE with the LU partition, for comparison: it fails at singular configurations.

    See :mod:`solvers.projection.lu_partition`.
    """

    fallback_solvers = ("radau", "adams", "hybrid")
    partition = LU


class HybridStepper(AdamsStepper):
    """Adams PECE with LU partition away from singular configurations and projection near them."""

    fallback_solvers = ("radau", "ida", "adams")
    partition = HYBRID

"""Adams PECE as a method of compiled steps: how it starts, continues and counts, whatever the formulation."""

from __future__ import annotations

from typing import Any, ClassVar

from solvers.compiled.kernel import kernel
from solvers.steppers.compiled_loop import CompiledMethod, MethodKernels

from .formulas import History, restart_history
from .jumps import limit_steps


@kernel
def count(history: History, counts: Any) -> None:
    """See :class:`solvers.steppers.compiled_loop.MethodKernels`."""
    control = history.control[0]
    left = control.by_turn + control.by_flicker + control.by_energy + control.by_collapse
    counts[0], counts[1], counts[2] = control.steps, control.rejected, control.evaluations
    counts[3], counts[4], counts[5] = left + control.returns, max(0, control.starts - 1), control.stability_limited


ADAMS_KERNELS = MethodKernels(restart_history, limit_steps, count)


class AdamsMethod(CompiledMethod):
    """Adams formulas, and one-step formulas where a history would not last; its memory: :class:`.formulas.History`."""

    kernels: ClassVar = ADAMS_KERNELS

    @property
    def has_dense_output(self) -> bool:
        """See :attr:`solvers.stepper.Stepper.has_dense_output`: one-step formulas have none."""
        control = self.control
        takes_one_step_formulas = control["start"] == 1 and control["rk_steps"] > 0
        return bool(control["is_projected"] == 0 and not takes_one_step_formulas)

    def details(self) -> dict[str, Any]:
        """As :meth:`solvers.steppers.compiled_loop.CompiledMethod.details`."""
        control = self.control
        return {
            "order": int(control["kold"]),
            "step_size": float(control["hold"]),
            "choices": int(control["changes"]),
            "refused": int(control["refused"]),
            "coarser": max(1.0, float(control["max_near_miss_factor"])),
            **{f"left_{name}": int(control[name]) for name in ("by_turn", "by_flicker", "by_energy", "by_collapse")},
            "time_lu": float(control["time_lu"]),
            "time_projection": float(control["time_projection"]),
        }

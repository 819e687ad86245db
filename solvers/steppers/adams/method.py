"""Adams PECE as a method of compiled steps: how it starts, continues and counts, whatever the formulation."""

from __future__ import annotations

from typing import Any

from solvers.steppers.compiled_loop import CompiledMethod
from solvers.system import Array

from .formulas import restart_history
from .jumps import limit_steps


class AdamsMethod(CompiledMethod):
    """Adams formulas, and one-step formulas where a history would not last; its memory: :class:`.formulas.History`."""

    def start(self, t: float, q: Array, v: Array, work: float, truncated_steps: int, keeps_position: bool) -> None:
        """As :meth:`solvers.steppers.compiled_loop.CompiledMethod.start`; truncated steps need no history."""
        needs_derivative = int(truncated_steps > 0)
        restart_history(self.pinned, t, q, v, work, truncated_steps, needs_derivative, keeps_position)

    def limit_step(self, t: float, q: Array, v: Array, work: float, longest: float) -> None:
        """As :meth:`solvers.steppers.compiled_loop.CompiledMethod.limit_step`; the order falls ahead of a jump."""
        limit_steps(self.pinned, self.settings, t, q, v, work, longest)

    def counts(self) -> dict[str, Any]:
        """As :meth:`solvers.steppers.compiled_loop.CompiledMethod.counts`."""
        control = self.control
        left = {name: int(control[name]) for name in ("by_turn", "by_flicker", "by_energy", "by_collapse")}
        return {
            "steps": int(control["steps"]),
            "rejected": int(control["rejected"]),
            "rhs_evals": int(control["evaluations"]),
            "restarts": max(0, int(control["starts"]) - 1),
            "order": int(control["kold"]),
            "step_size": float(control["hold"]),
            "stability_limited": int(control["stability_limited"]),
            "partition_switches": sum(left.values()) + int(control["returns"]),
            "choices": int(control["changes"]),
            "refused": int(control["refused"]),
            "coarser": max(1.0, float(control["max_near_miss_factor"])),
            **{f"left_{name}": count for name, count in left.items()},
            "time_lu": float(control["time_lu"]),
            "time_projection": float(control["time_projection"]),
        }

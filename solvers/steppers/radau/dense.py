"""The stepper on Radau IIA: 'radau'."""

from __future__ import annotations

from typing import Any, ClassVar

from solvers.compiled.kernel import records
from solvers.options import Options
from solvers.steppers.compiled_loop import CompiledMethod, LoopStepper, MethodKernels
from solvers.steppers.dense import DenseFormulation
from solvers.system import Array, System

from . import loop
from .formulas import Memory


class RadauMethod(CompiledMethod):
    """Radau IIA of order 5; its memory is a :class:`.formulas.Memory`."""

    kernels: ClassVar = MethodKernels(loop.restart_at_state, loop.limit_steps, loop.count)

    def details(self) -> dict[str, Any]:
        """As :meth:`solvers.steppers.compiled_loop.CompiledMethod.details`."""
        control = self.control
        return {
            "order": 5,
            "step_size": float(control["hold"]),
            "refused": int(control["refused"]),
            "coarser": max(1.0, float(control["max_near_miss_factor"])),
        }


class RadauStepper(LoopStepper):
    """Radau IIA of order 5; see :mod:`.loop`. For stiff models, and for loads that change at every requested time."""

    fallback_solvers: tuple[str, ...] = ("adams", "ida")
    needs_matrices = True
    loop: ClassVar = loop

    def __init__(self, system: System, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        settings = records(1, loop.SETTINGS)
        loop.set_options(self.options.record(), settings)
        formulation = DenseFormulation(system, self._t, self._q, self._v, self.options)
        self._compose(formulation, RadauMethod(Memory.allocate(system.nq, system.n), settings))
        loop.set_up(self.integration, formulation.rank, self.options.absolute)
        self.restart()

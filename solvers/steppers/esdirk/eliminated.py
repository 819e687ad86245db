"""The stepper on ESDIRK3(2) for large mechanisms with loops, whose constraints are eliminated along their structure."""

from __future__ import annotations

from typing import Any, ClassVar

from numpy.typing import NDArray

from solvers.compiled.kernel import records
from solvers.compiled.tuple_pointer import pin
from solvers.options import Options
from solvers.steppers.compiled_loop import CompiledMethod, LoopStepper
from solvers.steppers.eliminated import EliminatedFormulation, ImplicitElimination
from solvers.steppers.eliminated_newton import ImplicitEquations, Work
from solvers.steppers.step_loop import Integration
from solvers.system import AnySystem, Array

from . import eliminated_loop
from .eliminated_steps import StageWork
from .formulas import Memory, Stage
from .loop import MIN_RTOL, set_options
from .tree import ESDIRK_KERNELS


class ESDIRKMethod(CompiledMethod):
    """ESDIRK3(2); its memory is a :class:`.formulas.Memory`."""

    kernels: ClassVar = ESDIRK_KERNELS

    def details(self) -> dict[str, Any]:
        """As :meth:`solvers.steppers.compiled_loop.CompiledMethod.details`."""
        coarser = max(1.0, float(self.control["max_near_miss_factor"]))
        return {"order": 3, "step_size": float(self.control["hold"]), "coarser": coarser}


class EliminatedESDIRKStepper(LoopStepper):
    """ESDIRK3(2) with eliminated constraints; see :mod:`.eliminated_steps`."""

    fallback_solvers = ("adams", "ida")
    min_rtol = MIN_RTOL
    loop: ClassVar = eliminated_loop

    def __init__(self, system: AnySystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        nq, n, m, settings = system.nq, system.n, system.m, records(1, eliminated_loop.SETTINGS)
        set_options(self.options.record(), settings)
        form = EliminatedFormulation(system, self._t, self._q, self._v, self.options)
        assert isinstance(system.elimination, ImplicitElimination)  # else another stepper is used
        self._tangent = system.elimination.tangent()
        method = ESDIRKMethod(Memory.allocate(nq, n, m), settings)
        self._compose(form, method)
        newton = Work.allocate(nq, n, m, form.work, system.placed)
        newton.row_size[:], self._saved = system.row_size, newton.factored()
        own = pin(self._scales), self._q, self._v, self._energy_account
        equations = pin(ImplicitEquations(form.equations, *self._tangent.callbacks))
        inner = pin(Integration(equations, settings, method.pinned, pin(newton), *own))
        stage = pin(Stage.allocate(nq, n, m, system.placed))
        work = pin(StageWork.allocate(nq, n, inner, stage))
        self.integration = pin(Integration(form.equations, settings, method.pinned, work, *own))
        eliminated_loop.set_up(self.integration, form.rate)
        self.restart()

    def arrays(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.stepper.Stepper.arrays`."""
        return [*super().arrays(), *self._saved, self._settings]

    def restore(self, data: bytes) -> None:
        """Return to the state in which ``data`` was saved, bit for bit: factors are made again from their data."""
        super().restore(data)
        eliminated_loop.renew_factors(self.integration)

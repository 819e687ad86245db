"""The stepper on Adams PECE for large mechanisms with loops, whose constraints are eliminated along their structure."""

from __future__ import annotations

from typing import ClassVar

from solvers.compiled.kernel import records
from solvers.options import Options
from solvers.steppers.compiled_loop import LoopStepper
from solvers.steppers.eliminated import EliminatedFormulation
from solvers.system import AnySystem, Array

from . import eliminated_loop
from .formulas import History
from .method import AdamsMethod
from .pece import set_options


class EliminatedAdamsStepper(LoopStepper):
    """Adams PECE with eliminated constraints; see :mod:`.eliminated_loop`."""

    fallback_solvers = ("ida",)
    is_explicit = True
    loop: ClassVar = eliminated_loop

    def __init__(self, system: AnySystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        settings = records(1, eliminated_loop.SETTINGS)
        set_options(self.options.record(), settings)
        formulation = EliminatedFormulation(system, self._t, self._q, self._v, self.options)
        self._compose(formulation, AdamsMethod(History.allocate(system.nq, system.n, 0), settings))
        eliminated_loop.set_up(self.integration, formulation.rate)
        self.restart()

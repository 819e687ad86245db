"""The stepper on Adams PECE for large trees: 'adams' where the system is a :class:`solvers.system.TreeSystem`."""

from __future__ import annotations

from typing import ClassVar

from solvers.compiled.kernel import records
from solvers.options import Options
from solvers.steppers.compiled_loop import LoopStepper
from solvers.steppers.tree import TreeFormulation
from solvers.system import Array, TreeSystem

from . import tree_loop
from .formulas import History
from .method import AdamsMethod
from .pece import set_options


class TreeAdamsStepper(LoopStepper):
    """Adams PECE on a large tree; see :mod:`.tree_loop`."""

    fallback_solvers = ("ida",)
    is_explicit = True
    loop: ClassVar = tree_loop

    def __init__(self, system: TreeSystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        system = system.without_tangent()
        super().__init__(system, t0, q0, v0, options)
        settings = records(1, tree_loop.SETTINGS)
        set_options(self.options.record(), settings)
        formulation = TreeFormulation(system, self._t, self._q, self._v, self.options)
        self._compose(formulation, AdamsMethod(History.allocate(system.nq, system.n, 0), settings))
        tree_loop.set_up(self.integration, self._t, system.rate, self.options.duration)
        self.restart()

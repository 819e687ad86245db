"""The stepper on Adams PECE for large trees: 'adams' where the system is a :class:`solvers.system.TreeSystem`."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import records
from solvers.compiled.tuple_pointer import pin
from solvers.energy_account import EnergyScales
from solvers.options import Options, Statistics
from solvers.outcome import CODES, Code
from solvers.stepper import require_resolved_position, require_resolved_time
from solvers.steppers.compiled_loop import Integration
from solvers.system import Array, TreeSystem, energy_callbacks

from . import tree_loop
from .explicit import ExplicitStepper
from .formulas import History, collect_counts
from .loop import set_options


class TreeAdamsStepper(ExplicitStepper):
    """Adams PECE on a large tree; see :mod:`.tree_loop`.

    Attributes
    ----------
    integration
        What its kernels take, held: a record of :class:`solvers.steppers.compiled_loop.Integration`.
    """

    fallback_solvers = ("ida",)
    loop: ClassVar = tree_loop

    def __init__(self, system: TreeSystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        self.system, options = system, self.options
        self._history, self._settings = History.allocate(system.nq, system.n, 0), records(1, tree_loop.SETTINGS)
        set_options(options.record(), self._settings)
        self._control, self._pinned = self._history.control[0], pin(self._history)
        work = tree_loop.Scratch.allocate(system.nq, system.n, system.positions)
        work.size[:] = system.size
        self._inertia = work.inertia
        self._inertia["watched"] = system.can_compute_rate_growth
        callbacks = system.forward, system.inverse, system.retract, *energy_callbacks(system), system.parts_callback
        eqs = pin(tree_loop.TreeEquations(*callbacks, system.pinned_data))
        self._scales = EnergyScales.of(options.rtol, np.zeros(system.n), np.zeros(system.n))
        own = eqs, self._settings, self._pinned, pin(work), pin(self._scales)
        self.integration = pin(Integration(*own, self._q, self._v, self._energy_account))
        tree_loop.set_up(self.integration, self._t, system.rate, options.duration)
        require_resolved_time(self._t, float(self._settings["rate"][0]), options.rtol)
        require_resolved_position(self._q, work.size_q, options.rtol, system.coordinate_names)
        self.restart()

    def advance_to(self, t: float) -> Code:
        """As :meth:`solvers.stepper.Stepper.advance_to`."""
        code = CODES[tree_loop.advance_reported(self.integration, t)]
        self._t = t if code is Code.OK else float(self._control["t"])
        return code

    def evaluate(self) -> tuple[Code, Array, Array]:
        """As :meth:`solvers.stepper.Stepper.evaluate`."""
        a = np.zeros(self.system.n)
        return CODES[tree_loop.evaluate(self.integration, self._t, a)], a, np.zeros(0)

    @property
    def _needs_work(self) -> bool:
        return self.options.energy_check

    def arrays(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.stepper.Stepper.arrays`."""
        return [
            self.clock,
            self._q,
            self._v,
            self._energy_account,
            self._scales.bound_results,
            *self._history,
            self._settings["max_step"],
            self._inertia,
        ]

    @property
    def statistics(self) -> Statistics:
        """What the run has cost so far."""
        c = self._inertia[0]
        return Statistics(
            **collect_counts(self._control), rate_growth=float(c["largest"]), rate_growth_at=float(c["at"])
        )

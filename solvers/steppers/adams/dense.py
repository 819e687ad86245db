"""The steppers on Adams PECE by matrices: 'adams' (projection), 'adams-lu', and 'hybrid'."""

from __future__ import annotations

from typing import Any, ClassVar

from numpy.typing import NDArray

from solvers.compiled.kernel import records
from solvers.options import Options
from solvers.steppers.compiled_loop import LoopStepper
from solvers.steppers.dense import DenseFormulation
from solvers.system import Array, System

from . import loop
from .formulas import History
from .hybrid import HYBRID, LU, PROJECTION
from .method import AdamsMethod
from .pece import set_options


class AdamsStepper(LoopStepper):
    """Adams PECE with the projection partition; see :mod:`.loop`."""

    fallback_solvers: tuple[str, ...] = ("radau", "ida", "hybrid")
    needs_matrices = True
    is_explicit = True
    partition = PROJECTION
    loop: ClassVar = loop

    def __init__(self, system: System, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        formulation = DenseFormulation(system, self._t, self._q, self._v, self.options)
        partition = self.partition if formulation.rank else PROJECTION  # nothing to partition: all the same
        settings = encode_settings(self.options, partition)
        method = AdamsMethod(History.allocate(system.nq, system.n, system.m), settings)
        method.needs_work = self.partition == HYBRID  # which asks whether the energy jumps
        self._compose(formulation, method)
        loop.set_up(self.integration, formulation.rank, self.options.absolute)
        self.restart()


def encode_settings(options: Options, partition: int) -> NDArray[Any]:
    """Return the record (1,) of SETTINGS that the kernels read."""
    settings = records(1, loop.SETTINGS)
    set_options(options.record(), settings)
    settings["partition"] = partition
    for name in ("flicker_steps", "flicker_count", "energy_jump", "collapse_cuts", "calm_steps"):
        settings[name] = getattr(options.switching, name)
    return settings


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

"""SUNDIALS IDA on large mechanisms whose constraints are eliminated along their structure ('ida').

Unknowns y = (q, v). With P(y) the nearest state on the constraints and f(y) = (N v, v') the equations of motion there
(:mod:`solvers.projection.eliminated`)::

    y' = f(P(y)) - k (y - P(y)),      k the rate of the motion

Motions on the constraints are exact solutions, and errors across the constraints decay. Singular configurations,
crossings and near misses are treated as by 'adams': f is evaluated at closed states only. A step that may have jumped
to another branch is rejected, and IDA restarts from its beginning with a shorter step.

Newton's linear systems, with c IDA's cj, go to GMRES; the preconditioner is :mod:`solvers.steppers.eliminated_newton`.
The term of damping is left out where damping is weak, compared with c M. On 76 coordinates with springs of 1e6 Nm/rad
the eigenvalues of the preconditioned matrix are within 0.02 of one (c = 100 and 1000 1/s).

IDA's history cannot be saved: a restored run restarts at order one, so it agrees with the saved one to the tolerance,
not bit for bit.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import records
from solvers.compiled.tuple_pointer import pin, unpin
from solvers.energy_account import EnergyScales
from solvers.options import Options
from solvers.outcome import CODES, Code
from solvers.steppers.eliminated import EliminatedFormulation, ImplicitElimination
from solvers.steppers.eliminated_newton import ImplicitEquations, Work, apply_preconditioner
from solvers.steppers.step_loop import Integration
from solvers.system import AnySystem, Array

from . import eliminated_loop
from .binding import BoundIDA
from .calls import KRYLOV_DIMENSION
from .driver import IDADriver
from .eliminated_c import ELIMINATED_CALLBACKS, step_until
from .eliminated_callbacks import (
    accept_step,
    end_start,
    evaluate_residual,
    fill_start,
    report_unknowns,
    set_up_preconditioner,
)
from .eliminated_memory import (
    MIN_RTOL,
    SETTINGS,
    EliminatedIDAMemory,
    set_options,
    set_up,
)
from .loop import MAX_CONVERGENCE_FAILURES
from .sundials import DirectIDA, is_library_supported


class EliminatedIDAStepper(IDADriver):
    """IDA with eliminated constraints."""

    fallback_solvers = ("adams",)
    min_rtol = MIN_RTOL
    loop: ClassVar = eliminated_loop

    def __init__(self, system: AnySystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        self.system, nq, n, m = system, system.nq, system.n, system.m
        self.formulation = form = EliminatedFormulation(system, self._t, self._q, self._v, self.options)
        assert isinstance(system.elimination, ImplicitElimination)  # else another stepper is used
        self._tangent = system.elimination.tangent()
        self._memory, self._settings = EliminatedIDAMemory.allocate(nq, n), records(1, SETTINGS)
        memory, callbacks = self._memory, self._tangent.callbacks
        self._set_records(memory.counts, memory.energy_record, memory.progress)
        work = Work.allocate(nq, n, m, form.work, system.placed)
        work.row_size[:], self._refusal, self._saved = system.row_size, work.refusal, work.memory()
        equations = ImplicitEquations(form.equations, *callbacks)
        self._scales = pin(EnergyScales.of(self.options.rtol, np.zeros(n), np.zeros(n)))
        own = pin(equations), self._settings, pin(memory), pin(work), self._scales
        self.integration = pin(Integration(*own, self._q, self._v, self._energy_account))
        set_options(self.options.record(), self.integration)
        set_up(self.integration, self._t, form.rate)
        self._ida = self._make_ida()
        self.starts_singular, self.status = form.starts_singular, self._status(form.status)

    def _make_ida(self) -> DirectIDA | BoundIDA:
        options, memory, settings, problem = self.options, self._memory, self._settings[0], self.integration
        rtol, order = float(settings["rtol"]), int(settings["max_order"])
        if is_library_supported():
            return DirectIDA(
                ELIMINATED_CALLBACKS, step_until, problem, memory.progress, memory.counts,
                unpin(unpin(problem).memory).ida, rtol=rtol, max_order=order, max_step=options.max_step,
            )  # fmt: skip

        from sksundae.ida import IDAPrecond

        def residual(t: float, y: Array, yp: Array, res: Array) -> None:
            evaluate_residual(t, y, yp, res, problem)

        def set_up(t: float, y: Array, yp: Array, res: Array, cj: float) -> int:
            return int(set_up_preconditioner(t, y, cj, problem))

        def solve(t: float, y: Array, yp: Array, res: Array, r: Array, z: Array, cj: float, delta: float) -> None:
            apply_preconditioner(y, r, z, problem)

        return BoundIDA(
            residual, lambda t, y, slopes, _: accept_step(t, y, slopes, problem), self._counts, self._progress_array,
            linsolver="gmres", krylov_dim=KRYLOV_DIMENSION, precond=IDAPrecond(set_up, solve),
            max_step=0.0 if np.isinf(options.max_step) else options.max_step,
            max_conv_fails=MAX_CONVERGENCE_FAILURES, rtol=rtol, atol=memory.ida.atol, max_order=order,
        )  # fmt: skip

    def advance_to(self, t: float) -> Code:
        """As :meth:`solvers.stepper.Stepper.advance_to`."""
        code = super().advance_to(t)
        refusal = CODES[int(self._refusal[0])]
        return refusal if code in (Code.COLLAPSED, Code.NOT_FINITE) and refusal is not Code.OK else code

    def _begin(self) -> Code:
        self._settings["works"] = self._has_work()
        code = CODES[fill_start(self.integration, self._t)]
        if code is Code.OK:
            self._begin_with(self._memory.ida.y, self._memory.ida.slopes)
            end_start(self.integration, self._t)
        return code

    def _resume(self) -> Code:
        code = self._report_unknowns(float(self._progress["t_reached"]), self._memory.last_accepted)
        if code is not Code.OK:
            return code
        self._report_energy()
        record = self._energy_record[0]
        passage = record["open_passage_energy"], record["kinetic_max_since_passage"]
        code = self._begin()
        record["open_passage_energy"], record["kinetic_max_since_passage"] = passage  # the motion is the same
        return code

    def _report_unknowns(self, t: float, y: Array) -> Code:
        code = CODES[report_unknowns(self.integration, t, y)]
        if code is Code.OK:
            self._t = t
        return code

    def _has_work(self) -> bool:
        return self.system.works()

    def _undetermined(self) -> bool:
        return self.formulation.has_unresolved_forces(self.options.rtol)

    @property
    def freedom(self) -> int:
        """In how many ways the constraints let the mechanism move."""
        return self.formulation.freedom

    def evaluate(self) -> tuple[Code, Array, Array]:
        """As :meth:`solvers.stepper.Stepper.evaluate`."""
        code = self.formulation.evaluate(self._t, self._q, self._v)
        return code, self.formulation.a.copy(), self.formulation.lam.copy()

    def arrays(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.stepper.Stepper.arrays`."""
        return [*super().arrays(), *self._saved]

"""SUNDIALS IDA on the stabilized equations of constrained motion ('ida'): variable-order BDF on :mod:`.ggl`.

After each step jumps between branches are detected (:mod:`solvers.projection.singular`). A step that may have jumped to
another branch is rejected: IDA restarts from its beginning with a shorter step. A crossing is jumped over. Near a near
miss positions must be more accurate than its gap, or the other branch is as near: D is removed except for redundant
rows, and d as far as rounding lets it.

If a motion is so slow that D affects it, as where it reverses in a singular configuration, D takes from it what it
should keep: the run stops when that is more than the tolerance forgives.

Multipliers carry no error control: they may be unbounded where the motion is smooth. Reported states are IDA's,
interpolated, then closed onto the constraints; reported accelerations are computed there
(:meth:`solvers.stepper.Stepper.accelerations`), not read from the BDF. IDA's history cannot be saved: a restored run
restarts at order one, so it agrees with the saved one to the tolerance, not bit for bit.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import records
from solvers.compiled.tuple_pointer import pin, unpin
from solvers.diagnostics import Diagnostic
from solvers.energy_account import EnergyScales
from solvers.inertia import describe_large_growth
from solvers.options import Options
from solvers.outcome import CODES, Code
from solvers.stepper import Samples
from solvers.steppers.dense import DenseStepper
from solvers.steppers.step_control import TRUNCATED_STEPS
from solvers.steppers.step_loop import Integration
from solvers.system import Array, System

from . import dense_loop
from .binding import BoundIDA
from .dense_c import DENSE_CALLBACKS, ITERATIVE_CALLBACKS
from .dense_callbacks import (
    accept_step,
    apply_preconditioner_at,
    evaluate_residual_at,
    multiply_matrix,
    set_up_preconditioner_at,
)
from .dense_memory import (
    MIN_RTOL,
    SETTINGS,
    IDAMemory,
    continue_history,
    end_start,
    fill_start,
    is_shift_too_large,
    report_unknowns,
    restore_tolerances,
    set_options,
    set_up,
)
from .driver import IDADriver
from .ggl import assemble_matrix
from .loop import JACOBIANS, MAX_CONVERGENCE_FAILURES, RESIDUALS
from .sundials import DirectIDA, is_library_supported


class IDAStepper(IDADriver, DenseStepper):
    """SUNDIALS IDA; see :mod:`solvers.steppers.ida.dense`. For stiff models; order at most 5."""

    loop = dense_loop

    def __init__(self, system: System, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        self.min_rtol = MIN_RTOL if system.m else 0.0
        n, memory = system.n, IDAMemory.allocate(system.nq, system.n, system.m)
        self._memory, self._settings, self._control = memory, records(1, SETTINGS), memory.control[0]
        self._set_records(memory.counts, memory.energy_record, memory.progress)
        self._scales = pin(EnergyScales.of(self.options.rtol, np.zeros(n), np.zeros(n)))
        own = self._eqs, self._settings, pin(memory), self._work, self._scales
        self.integration = pin(Integration(*own, self._q, self._v, self._energy_account))
        set_options(self.options.record(), self.integration)
        set_up(self.integration, self._t, self._rank)
        self._ida = self._make_ida()

    def _make_ida(self) -> DirectIDA | BoundIDA:
        settings, options, memory = self._settings[0], self.options, self._memory
        rtol, order = float(settings["rtol"]), int(settings["max_order"])
        if is_library_supported():
            callbacks = ITERATIVE_CALLBACKS if self.system.m else DENSE_CALLBACKS
            return DirectIDA(
                callbacks, dense_loop.step_until, self.integration, memory.progress, memory.counts,
                unpin(unpin(self.integration).memory).ida, rtol=rtol, max_order=order, max_step=options.max_step,
            )  # fmt: skip
        return self._bound_ida({"rtol": rtol, "atol": memory.ida.atol, "max_order": order})

    def _bound_ida(self, ida_options: dict[str, Any]) -> BoundIDA:
        """Return IDA with the same kernels for callbacks, called through Python."""
        from sksundae.ida import IDAJacTimes, IDAPrecond

        problem, unknowns, work, eqs = self.integration, self._memory.unknowns, self._work, self._eqs
        pinned = unpin(unpin(problem).memory).unknowns

        def resfn(t: float, y: Array, yp: Array, res: Array) -> None:
            evaluate_residual_at(t, y, yp, res, problem)

        def setup(t: float, y: Array, yp: Array, res: Array, cj: float) -> None:
            set_up_preconditioner_at(t, y, yp, problem)

        def precondition(
            t: float, y: Array, yp: Array, res: Array, right: Array, left: Array, cj: float, delta: float
        ) -> None:
            apply_preconditioner_at(t, y, yp, right, left, cj, problem)

        def times(t: float, y: Array, yp: Array, res: Array, vector: Array, product: Array, cj: float) -> None:
            multiply_matrix(vector, product, problem)

        def dense(t: float, y: Array, yp: Array, res: Array, cj: float, matrix: Array) -> None:
            set_up_preconditioner_at(t, y, yp, problem)
            assemble_matrix(eqs, pinned, work, cj)
            matrix[:] = unknowns.matrix

        fresh = {"linsolver": "gmres", "precond": IDAPrecond(setup, precondition), "jactimes": IDAJacTimes(None, times)}
        max_step = 0.0 if np.isinf(self.options.max_step) else self.options.max_step
        return BoundIDA(
            resfn, lambda t, y, slopes, _: accept_step(t, y, slopes, problem), self._counts, self._progress_array,
            **(fresh if self.system.m else {"jacfn": dense}), max_step=max_step,
            max_conv_fails=MAX_CONVERGENCE_FAILURES, **ida_options,
        )  # fmt: skip

    def _begin(self) -> Code:
        """Initialize IDA at the reported state with consistent derivatives."""
        self._settings["works"] = int(self._has_work())
        code = CODES[fill_start(self.integration, self._t)]
        if code is Code.OK:
            self._begin_with(self._memory.ida.y, self._memory.ida.slopes)
            end_start(self.integration, self._t)
        return code

    def _has_work(self) -> bool:
        return self.system.works()

    def continue_after_event(self) -> None:
        """Continue IDA's history if its last step ends at the reported time; the next steps end at the targets."""
        self._settings["works"] = int(self._has_work())
        if not continue_history(self.integration, self._t, self.status.ok):
            self.restart()
        self._progress["truncated_steps"] = TRUNCATED_STEPS

    def advance_to(self, t: float) -> Code:
        """As :meth:`solvers.stepper.Stepper.advance_to`."""
        if isinstance(self._ida, DirectIDA):
            self._prepare_loop()
            code = CODES[dense_loop.advance_reported(self.integration, t)]
            self._t = float(self._control["t"])
            return code
        if is_shift_too_large(self.integration, t):
            self.restart()
        return super().advance_to(t)

    def _prepare_loop(self) -> None:
        """Write what the compiled driver reads and what may have changed since its last call."""
        self._control["t"], self._settings["max_steps"] = self._t, self.max_steps
        if self._progress["is_pending"]:
            self._settings["works"] = int(self._has_work())

    def _sample(self, times: Array, out: Samples, outputs: Array) -> int:
        if not isinstance(self._ida, DirectIDA):
            return super()._sample(times, out, outputs)
        if times[0] == self._t:  # the reported state is not interpolated again
            done = super()._sample(times[:1], Samples(*(part[:1] for part in out)), outputs[:1])
            if not done or len(times) == 1:
                return done
            return done + self._sample(times[1:], Samples(*(part[1:] for part in out)), outputs[1:])
        self._prepare_loop()
        control = self._control
        control["undetermined"] = 0
        code, done = dense_loop.sample(self.integration, times, *out, outputs)
        self._t = float(control["t"])
        self.status = self._status(CODES[code])
        if control["undetermined"]:
            self.undetermined_at = float(control["undetermined_at"])
        return int(done)

    def _resume(self) -> Code:
        code = self._report_unknowns(float(self._progress["t_reached"]), self._memory.last_accepted[0])
        if code is not Code.OK:
            return code
        self._report_energy()
        record_energy = self._energy_record[0]
        passage = record_energy["open_passage_energy"], record_energy["kinetic_max_since_passage"]
        code = self._begin()
        record_energy["open_passage_energy"], record_energy["kinetic_max_since_passage"] = (
            passage  # the motion is the same
        )
        return code

    def arrays(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.stepper.Stepper.arrays`."""
        return [*super().arrays(), *self._workspace.memory()]

    def restore(self, data: bytes) -> None:
        """Set a reported state and the units of its integration; the history restarts."""
        super().restore(data)
        restore_tolerances(self.integration, self._t)

    def _report_unknowns(self, t: float, y: Array) -> Code:
        code = CODES[report_unknowns(self.integration, t, y)]
        if code is Code.OK:
            self._t = t
        return code

    def _growth(self) -> tuple[float, float]:
        return DenseStepper._growth(self)

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Whether the tolerance is larger than requested, or than the mass matrix requires."""
        large = describe_large_growth(self._workspace.inertia) if isinstance(self._ida, BoundIDA) else ""
        if large:
            text = f"{large}, and 'ida' without the C functions of SUNDIALS 7 cannot compensate that"
            since = float(self._workspace.inertia[0]["large_since"])
            return (Diagnostic.warning("ill-conditioned-mass", text, "Use 'adams'", subject="ida", time=since),)
        return super().diagnostics

    def _evaluations(self) -> int:
        columns = self.system.nq + 2 * self.system.n + 1
        return int(self._counts[RESIDUALS] + columns * self._counts[JACOBIANS])

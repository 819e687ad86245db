"""Steppers whose step loop is one kernel: a formulation and a method, put together."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.tuple_pointer import pin
from solvers.diagnostics import Diagnostic
from solvers.energy_account import WORK, EnergyScales
from solvers.options import Options, Statistics
from solvers.outcome import CODES, Code
from solvers.stepper import Samples, Stepper, validated_vector
from solvers.system import AnySystem, Array

from .formulation import Formulation
from .step_control import TRUNCATED_STEPS
from .step_loop import Integration, one_step_at_most

LIMITED_TOLERANCE = Diagnostic.warning(  # its text is filled by native FMUs too, see mbfmu.session.run_messages
    "limited-tolerance",
    "the tolerance was {used:.0e} instead of {requested:g} near a singular configuration that the loop misses by "
    "{gap:.0e} of its size (0: it passes through), because rounding errors allow no smaller one there",
    "Change the lengths of the loop if the error is too large",
    subject="tolerance",
)
COUNTED = ("steps", "rejected", "rhs_evals", "partition_switches", "restarts", "stability_limited")  # of Statistics


class MethodKernels(NamedTuple):
    """What is compiled of a method besides its loop, for steppers in Python and in native FMUs.

    Arguments are the memory of the method, its settings (1,), and a state: time t, s, positions q (nq,), velocities
    v (n,) and work W, J.
    """

    # (memory, t, q, v, work, truncated_steps, keeps_position): begin the next step at a state. The truncated steps end
    # at the requested times, after a change of loads; 0: restart without any history. keeps_position: the position is
    # on the constraints if it is that of the last step
    start: Callable[..., Any]
    limit_step: Callable[..., Any]  # (memory, settings, t, q, v, work, longest): no step from there on is longer, s
    count: Callable[..., Any]  # (memory, counts): fill the counts in the order of COUNTED, int64


class CompiledMethod(ABC):
    """A method whose steps are compiled: its memory, its settings, and how it starts and continues.

    Attributes
    ----------
    kernels
        How it starts, limits its steps and counts them.
    memory, pinned
        Named tuple of all that an integration remembers, with its ``control`` (1,); and the same for kernels.
    control
        Record of the memory.
    settings
        Record (1,) that the kernels read, with ``works`` and ``max_step``.
    needs_work
        Whether the work is computed even if the energy is not checked.
    """

    kernels: ClassVar[MethodKernels]
    needs_work: bool = False

    def __init__(self, memory: Any, settings: NDArray[Any]) -> None:
        self.memory, self.settings = memory, settings
        self.pinned, self.control = pin(memory), memory.control[0]

    @property
    def has_dense_output(self) -> bool:
        """See :attr:`solvers.stepper.Stepper.has_dense_output`."""
        return True

    def counts(self) -> dict[str, Any]:
        """Return counters by the names of :class:`solvers.options.Statistics`."""
        counts = np.zeros(len(COUNTED), np.int64)
        self.kernels.count(self.pinned, counts)
        return dict(zip(COUNTED, counts.tolist(), strict=True)) | self.details()

    @abstractmethod
    def details(self) -> dict[str, Any]:
        """Return the other fields of :class:`solvers.options.Statistics` that the method has."""


class LoopStepper(Stepper):
    """A stepper that takes the steps of a method on a formulation.

    Attributes
    ----------
    loop
        Module with the kernel ``advance_reported``, and ``sample`` if it exists.
    formulation, method
        What it is made of.
    integration
        What the kernels take, pinned: a record of :class:`solvers.steppers.step_loop.Integration`.
    """

    loop: ClassVar[ModuleType]

    def __init__(self, system: AnySystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        self.system = system

    def _compose(self, formulation: Formulation, method: CompiledMethod) -> None:
        """Put the two together; the caller sets up the loop and restarts."""
        self.formulation, self.method = formulation, method
        self._control, self._settings, self._max_step = method.control, method.settings, method.settings["max_step"]
        self.starts_singular, self.status = formulation.starts_singular, self._status(formulation.status)
        n = self.system.n
        self._scales = EnergyScales.of(self.options.rtol, np.zeros(n), np.zeros(n))  # set with the loop
        own = formulation.equations, method.settings, method.pinned, formulation.work, pin(self._scales)
        self.integration = pin(Integration(*own, self._q, self._v, self._energy_account))

    def advance_to(self, t: float) -> Code:
        """As :meth:`solvers.stepper.Stepper.advance_to`."""
        code = CODES[self.loop.advance_reported(self.integration, t)]
        self._t = t if code is Code.OK else float(self._control["t"])
        return code

    def _take_one_step(self, t: float) -> Code:
        with one_step_at_most(self._settings):
            return super()._take_one_step(t)

    @property
    def has_dense_output(self) -> bool:
        """As :attr:`solvers.stepper.Stepper.has_dense_output`."""
        return self.method.has_dense_output

    @property
    def own_time(self) -> float:
        """As :attr:`solvers.stepper.Stepper.own_time`."""
        return float(self._control["t"])

    def evaluate(self) -> tuple[Code, Array, Array]:
        """As :meth:`solvers.stepper.Stepper.evaluate`."""
        form = self.formulation
        code = form.evaluate(self._t, self._q, self._v)
        return code, form.a.copy(), form.lam.copy()

    def _undetermined(self) -> bool:
        return self.formulation.has_unresolved_forces(self.options.rtol)

    def _sample(self, times: Array, out: Samples, outputs: Array) -> int:
        sample = getattr(self.loop, "sample", None)
        if sample is None:
            return super()._sample(times, out, outputs)
        self._control["undetermined"] = 0
        code, done = sample(self.integration, times, *out, outputs)
        last = min(done, len(times) - 1)
        self._t = min(float(times[last]), float(self._control["t"]))
        self._q[:], self._v[:], self._energy_account[:] = out.q[last], out.v[last], out.energy_account[last]
        self.status = self._status(CODES[code])
        if self._control["undetermined"]:
            self.undetermined_at = float(self._control["undetermined_at"])
        return int(done)

    def _reported(self) -> tuple[float, Array, Array, float]:
        return self._t, self._q, self._v, float(self._energy_account[WORK])

    def limit_step(self, longest: float) -> None:
        """As :meth:`solvers.stepper.Stepper.limit_step`; a limit that is in force already is not set again."""
        if longest != self._max_step[0]:
            method = self.method
            method.kernels.limit_step(method.pinned, method.settings, *self._reported(), longest)

    def restart(self) -> None:
        """Restart at the reported state, without its history."""
        self._start(0, False)

    def continue_after_event(self) -> None:
        """Continue in steps that end at the requested time, at which the next change may occur."""
        self._start(TRUNCATED_STEPS, self.status.ok)

    def _start(self, truncated_steps: int, keeps_position: bool) -> None:
        needs_work = self.options.energy_check or self.method.needs_work
        self._settings["works"] = needs_work and self.system.works()
        self.method.kernels.start(self.method.pinned, *self._reported(), truncated_steps, keeps_position)

    def jump(self, dv: Array) -> None:
        """Add dv (n,) to the reported velocities, and continue as after :meth:`continue_after_event`."""
        self._v += validated_vector("dv", dv, self.system.n)
        self.continue_after_event()

    @property
    def freedom(self) -> int:
        """In how many ways the constraints let the mechanism move."""
        return self.formulation.freedom

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Whether the tolerance was larger than requested, everywhere or near a near miss."""
        control, found = self._control, super().diagnostics
        if not control["max_near_miss_factor"] > 1.0:
            return found
        used, requested = control["max_near_miss_factor"] * self.options.rtol, self.options.rtol
        text = LIMITED_TOLERANCE.text.format(used=used, requested=requested, gap=control["min_gap"])
        return (*found, replace(LIMITED_TOLERANCE, text=text))

    def arrays(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.stepper.Stepper.arrays`."""
        own = self.clock, self._q, self._v, self._energy_account, self._scales.bound_results, self._max_step
        return [*self.method.memory, *own, *self.formulation.memory()]

    @property
    def statistics(self) -> Statistics:
        """Counters of the run so far."""
        growth = self.formulation.growth()[0]
        largest, at = float(growth["largest"]), float(growth["at"])
        return Statistics(**self.method.counts(), rate_growth=largest, rate_growth_at=at)

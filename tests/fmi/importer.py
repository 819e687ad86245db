"""An importing tool of model exchange of FMI 2.0: SciPy's solvers around the C functions."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from ctypes import byref, c_double, c_int, c_size_t
from typing import Any, NamedTuple

import numpy as np
from binding import DISCARD, OK, WARNING, Binary, Instance
from numpy.typing import NDArray
from scipy.integrate import DOP853

Array = NDArray[np.float64]
MOST_EVALUATIONS = 100_000


class EventInfo(ctypes.Structure):
    """fmi2EventInfo."""

    _fields_ = (
        ("more", c_int),
        ("ends", c_int),
        ("nominals_changed", c_int),
        ("states_changed", c_int),
        ("has_next", c_int),
        ("next", c_double),
    )


class Run(NamedTuple):
    """States and outputs at some times, (k, ...) each, and what it took."""

    x: Array
    out: Array
    evaluations: int
    discarded: int
    warned: int  # completed steps with a warning


class Importer:
    """An instance for model exchange, and SciPy's view of it."""

    def __init__(self, binary: Binary, outputs: list[str] | None = None) -> None:
        component = binary.component(0)
        assert component, binary.logged
        self.fmu, self.binary = Instance(binary, component), binary
        variables = binary.description.modelVariables
        self.references = {v.name: v.valueReference for v in variables}
        self.outputs = [v.name for v in variables if v.causality == "output"] if outputs is None else outputs
        self.count = len(binary.description.derivatives)
        self.evaluations = self.discarded = self.warned = 0
        self.inputs: dict[str, Any] = {}  # functions of time by name

    def start(self, t: float = 0.0, values: Mapping[str, float] | None = None) -> EventInfo:
        """Initialize at t (s), and handle the first event."""
        assert self.fmu.set_up(t) == OK
        assert self.fmu.call("EnterInitializationMode") == OK
        for name, value in (values or {}).items():
            assert self.fmu.set("Real", [self.references[name]], [value]) == OK
        self._give(t)
        assert self.fmu.call("ExitInitializationMode") == OK
        return self._update()

    def _give(self, t: float) -> None:
        for name, function in self.inputs.items():
            assert self.fmu.set("Real", [self.references[name]], [function(t)]) == OK

    def _update(self) -> EventInfo:
        info = EventInfo(more=1)
        while info.more:
            assert self.fmu.call("NewDiscreteStates", byref(info)) == OK, self.binary.logged
        assert self.fmu.call("EnterContinuousTimeMode") == OK
        return info

    def event(self) -> EventInfo:
        """Handle an event here."""
        assert self.fmu.call("EnterEventMode") == OK
        return self._update()

    def place(self, t: float, x: Array) -> None:
        """Set the time, the states and the inputs."""
        given = np.ascontiguousarray(x)
        assert self.fmu.call("SetTime", c_double(t)) == OK
        assert self.fmu.call("SetContinuousStates", given.ctypes.data_as(ctypes.c_void_p), c_size_t(len(x))) == OK
        self._give(t)

    def _read(self, name: str) -> tuple[int, Array]:
        values = np.zeros(self.count)
        return self.fmu.call(name, values.ctypes.data_as(ctypes.c_void_p), c_size_t(self.count)), values

    def states(self) -> Array:
        """Return the states."""
        status, x = self._read("GetContinuousStates")
        assert status == OK
        return x

    def nominals(self) -> Array:
        """Return the nominal values."""
        status, nominal = self._read("GetNominalsOfContinuousStates")
        assert status == OK
        return nominal

    def derivatives(self, t: float, x: Array) -> Array:
        """Return x', not a number if the evaluation is discarded: SciPy repeats such a step with a smaller one."""
        self.evaluations += 1
        self.place(t, x)
        status, slope = self._read("GetDerivatives")
        assert status in (OK, DISCARD), self.binary.logged
        assert np.isfinite(slope).all() == (status == OK)
        self.discarded += status == DISCARD
        return slope

    def read(self, t: float, x: Array) -> Array:
        """Return the outputs."""
        self.place(t, x)
        status, values = self.fmu.get("Real", [self.references[name] for name in self.outputs])
        assert status == OK, self.binary.logged
        return np.array(values)

    def complete(self, t: float, x: Array) -> int:
        """Report a completed step; return the status."""
        self.place(t, x)
        event, ends = c_int(), c_int()
        status = self.fmu.call("CompletedIntegratorStep", c_int(1), byref(event), byref(ends))
        assert status in (OK, WARNING), self.binary.logged
        assert not event.value
        assert not ends.value
        self.warned += status == WARNING
        return status

    def integrate(
        self, times: Array, rtol: float, method: Any = DOP853, info: EventInfo | None = None, completes: bool = True
    ) -> Run:
        """Integrate from the first of the times (k,) with SciPy's ``method``; ``info`` is that of the start."""
        nominal, rows, t = self.nominals(), [self.states()], float(times[0])
        while len(rows) < len(times):
            end = float(times[-1]) if info is None or not info.has_next else min(float(times[-1]), info.next)
            assert end > t
            options = {"rtol": rtol, "atol": rtol * nominal, "first_step": min(1e-3, 0.5 * (end - t))}
            solver = method(self.derivatives, t, self.states(), end, **options)
            while solver.status == "running":
                solver.step()
                assert solver.status != "failed"
                assert self.evaluations < MOST_EVALUATIONS
                while len(rows) < len(times) and times[len(rows)] < solver.t:
                    rows.append(solver.dense_output()(times[len(rows)]))  # may evaluate within the step
                if completes:
                    self.complete(solver.t, solver.y)
                if len(rows) < len(times) and times[len(rows)] == solver.t:
                    rows.append(solver.y.copy())
            t = solver.t
            self.place(t, solver.y)
            info = self.event()
        out = [self.read(time, row) for time, row in zip(times, rows, strict=True)]
        return Run(np.array(rows), np.array(out), self.evaluations, self.discarded, self.warned)

    def free(self) -> None:
        """Free the instance."""
        self.fmu.free()


@contextmanager
def importing(binary: Binary, outputs: list[str] | None = None) -> Iterator[Importer]:
    """Instantiate an FMU for model exchange."""
    own = Importer(binary, outputs)
    try:
        yield own
    finally:
        own.free()

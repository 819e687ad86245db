"""Drive an FMU through FMPy: what ``mbfmu run``, the examples and the tests use."""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from ctypes import byref, c_void_p, cast
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from fmpy import calloc, extract, free, read_model_description
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
    fmi2Warning,
)
from numpy.typing import NDArray

from mbfmu.session.run_messages import RUN_ENDED
from mbfmu.util.diagnostics import Diagnostic, without_repeats
from mbfmu.util.errors import UserError, suggest
from solvers.compiled.foreign_call import address_of_array, call_int
from solvers.compiled.kernel import concurrent_kernel
from solvers.diagnostics import CODE_PATTERN, Severity
from solvers.system import Array

FMI_TRUE, FMI_WARNING = np.int32(1), np.int32(fmi2Warning)
ENTRY_BYTES = 8  # of a real number


_loading = threading.Lock()


@contextmanager
def keeping_working_directory() -> Iterator[None]:
    """Let one thread at a time load a library: FMPy changes the working directory of all threads meanwhile."""
    with _loading:
        try:
            before = Path.cwd()
        except FileNotFoundError as error:
            raise UserError(
                "the working directory of this process has been removed; change to another folder with os.chdir"
            ) from error
        try:
            yield
        finally:
            os.chdir(before)


def called(variable: Any) -> str:
    """Return the type in the name of the function that reads or sets a variable."""
    return "Integer" if variable.type == "Enumeration" else str(variable.type)


@concurrent_kernel
def fill_rows(do_step: int, get_real: int, fmu: int, times: Array, references: NDArray[np.uint32], rows: Array) -> int:
    """See :meth:`Fmu.make_run`; the first arguments are addresses of functions of FMI 2.0, and of the instance."""
    count = references.shape[0]
    for i in range(times.shape[0]):
        if i > 0 and call_int(do_step, (fmu, times[i - 1], times[i] - times[i - 1], FMI_TRUE)) > FMI_WARNING:
            return i
        place = address_of_array(rows) + ENTRY_BYTES * count * i
        if call_int(get_real, (fmu, address_of_array(references), count, place)) > FMI_WARNING:
            return i
    return int(times.shape[0])


def severity_of(status: int) -> Severity:
    """Return the severity of a message that an FMU logs with a status of FMI."""
    return "note" if status < fmi2Warning else "warning" if status == fmi2Warning else "error"


def as_note_of_end(found: Diagnostic) -> Diagnostic:
    """Return a note in place of the error that an event has ended the run; other errors as they are."""
    return replace(found, severity="note") if found.code == RUN_ENDED.code else found


class Fmu:
    """An FMU (FMI 2.0 for co-simulation, ours or another's) unzipped and instantiated.

    ``diagnostics`` are the notes, warnings and errors that it logs.

    >>> with Fmu(path, {"gravity": 1.62}) as fmu:                                   # doctest: +SKIP
    ...     fmu.step(0.01)
    ...     fmu["crank.angle"]

    Parameters
    ----------
    path
        The FMU file.
    values
        Start values of parameters and inputs by name; choices, such as the solver, by name or number.
    start_time
        s.
    tolerance
        Passed to fmi2SetupExperiment; None: not defined.
    """

    def __init__(
        self,
        path: Path,
        values: Mapping[str, Any] | None = None,
        *,
        start_time: float = 0.0,
        tolerance: float | None = None,
    ) -> None:
        self.description = read_model_description(str(path))
        self.variables = {v.name: v for v in self.description.modelVariables}
        self._folder = Path(extract(str(path)))
        self.outputs = [v.name for v in self.description.modelVariables if v.causality == "output"]
        self.real_outputs = [n for n in self.outputs if self.variables[n].type == "Real"]
        self._real_references = [self.variables[n].valueReference for n in self.real_outputs]
        try:
            with keeping_working_directory():
                self.slave = FMU2Slave(
                    guid=self.description.guid,
                    unzipDirectory=str(self._folder),
                    modelIdentifier=self.description.coSimulation.modelIdentifier,
                    instanceName=self.description.modelName,
                )
        except BaseException:
            shutil.rmtree(self._folder, ignore_errors=True)
            raise
        self.diagnostics: list[Diagnostic] = []
        self.slave.instantiate(callbacks=self._callbacks(), loggingOn=True)
        self.t, self._begun = start_time, False
        try:
            self.start(values or {}, tolerance)
        except BaseException:
            self.close()
            raise

    def _callbacks(self) -> Any:
        """Return what the FMU calls; FMPy's own would print what it logs among the results."""
        callbacks = fmi2CallbackFunctions()
        callbacks.logger = fmi2CallbackLoggerTYPE(self._note)
        callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(calloc)
        callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(free)
        with suppress(Exception):  # FMPy cannot fill in numbers on every machine; mbfmu's texts have none
            from fmpy.logging import addLoggerProxy

            addLoggerProxy(byref(callbacks))
        return callbacks

    def _note(self, _environment: Any, _name: bytes, status: int, _category: bytes, text: bytes) -> None:
        message = text.decode(errors="replace")
        if status >= fmi2Warning or CODE_PATTERN.search(message):  # other FMUs log their course without codes
            self.diagnostics.append(Diagnostic.parse(message, severity_of(status), "fmu-warning"))

    def start(self, values: Mapping[str, Any], tolerance: float | None = None) -> None:
        """Initialize with these start values; raises UserError with the FMU's reason where it cannot."""
        try:
            self.slave.setupExperiment(startTime=self.t, tolerance=tolerance)
            self.slave.enterInitializationMode()
            for name, value in values.items():
                self[name] = value
            self.slave.exitInitializationMode()
        except FMICallException as error:
            logged = [d.text for d in self.diagnostics if d.severity == "error"]
            raise UserError(self.message() or (logged or [str(error)])[-1]) from error
        self._begun = True

    def make_run(
        self, values: Mapping[str, Any], times: Array, references: NDArray[np.uint32], rows: Array
    ) -> tuple[int, tuple[Diagnostic, ...]]:
        """Begin again with the start values of the FMU but for these, and advance through all points in one call.

        Parameters
        ----------
        values
            Start values by name.
        times
            Times (k,), s, from 0 on.
        references
            Value references (n,) of real variables.
        rows
            Array (k, n) that receives their values.

        Returns
        -------
        tuple[int, tuple[Diagnostic, ...]]
            Number of rows that are complete, and the diagnostics of the run: fewer than k, and an error, if the start
            fails or a step is discarded; fewer, and a note, if an event ends the run.
        """
        self.slave.reset()
        self.diagnostics.clear()
        self.t, done, failures = float(times[0]), 0, list[Diagnostic]()
        try:
            self.start(values)
            library = self.slave.dll
            functions = (cast(function, c_void_p).value or 0 for function in (library.fmi2DoStep, library.fmi2GetReal))
            do_step, get_real = functions
            done = fill_rows(do_step, get_real, self.slave.component, times, references, rows)
            self.t = float(times[max(done - 1, 0)])
            if done < len(times):
                raise UserError(self.message())
        except UserError as error:
            failures.append(as_note_of_end(error.diagnostic))
        return done, without_repeats([*(d for d in self.diagnostics if d.severity != "error"), *failures])

    def step(self, dt: float) -> None:
        """Advance by dt (s); raises UserError with the FMU's reason if it discards the step."""
        self.step_to(self.t + dt)

    def step_to(self, t: float) -> None:
        """Advance to the communication point t (s); the same failures."""
        try:
            self.slave.doStep(currentCommunicationPoint=self.t, communicationStepSize=t - self.t)
        except FMICallException as error:
            raise UserError(self.message() or str(error)) from error
        self.t = t

    def message(self) -> str:
        """Return why the FMU stopped; empty where all is well or the FMU has no ``solver.message``."""
        return str(self["solver.message"]) if "solver.message" in self.variables else ""

    def reals(self) -> NDArray[np.float64]:
        """Return all real outputs, in the order of ``real_outputs``."""
        return np.array(self.slave.getReal(self._real_references))

    def __getitem__(self, name: str) -> Any:
        variable = self._variable(name)
        value = getattr(self.slave, f"get{called(variable)}")([variable.valueReference])[0]
        if variable.type == "Enumeration":
            return next((item.name for item in variable.declaredType.items if int(item.value) == value), value)
        return value.decode() if isinstance(value, bytes) else value

    def __setitem__(self, name: str, value: Any) -> None:
        variable = self._variable(name)
        if variable.type == "Enumeration" and isinstance(value, str):
            numbers = {item.name: int(item.value) for item in variable.declaredType.items}
            if value not in numbers:
                raise UserError(f"{name} is {value!r}{suggest(value, numbers)}")
            value = numbers[value]
        getattr(self.slave, f"set{called(variable)}")([variable.valueReference], [value])

    def _variable(self, name: str) -> Any:
        if name not in self.variables:
            raise UserError(f"the FMU has no variable {name!r}")
        return self.variables[name]

    def names(self, causality: str) -> Sequence[str]:
        """Return the names of the variables of a causality: parameter, input, output."""
        return [n for n, v in self.variables.items() if v.causality == causality]

    def save(self) -> bytes:
        """Return the FMU's state as bytes."""
        state = self.slave.getFMUstate()
        try:
            return bytes(self.slave.serializeFMUstate(state))
        finally:
            self.slave.freeFMUstate(state)

    def restore(self, state: bytes) -> None:
        """Take up a state saved by this or another instance of the same FMU."""
        handle = self.slave.deSerializeFMUstate(state)
        try:
            self.slave.setFMUstate(handle)
        finally:
            self.slave.freeFMUstate(handle)

    def close(self) -> None:
        """Terminate, free the instance and remove its folder."""
        if self._begun:
            with suppress(FMICallException):  # an instance whose last call was an error need not be terminated
                self.slave.terminate()
        self.slave.freeInstance()
        shutil.rmtree(self._folder, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        self.close()

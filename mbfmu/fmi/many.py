"""Many runs of one model with different values, on all processors: the model is compiled once, as a native FMU.

Every thread has an instance of the FMU. One call of it advances through all communication points of a run, while the
other threads continue.
"""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import Variable
from mbfmu.mechanics.numbers import array_of
from mbfmu.modeling.model import Model, as_model
from mbfmu.modeling.scene import Scene
from mbfmu.modeling.settings import Settings
from mbfmu.session.run import check_interval, communication_points
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import UserError, suggest
from mbfmu.util.processes import count_processors
from solvers.system import Array

from .export import FmuKind, export_scene
from .harness import Fmu

VARIABLE_CAUSALITIES = ("parameter", "input")  # of variables of an FMU that can differ between runs
FMI2_NUMBER_TYPES: dict[str, type] = {"Real": float, "Integer": int, "Boolean": bool}
STUDY_ADVICE = "Vary it with mb.study, which builds the model for every run"


@dataclass(frozen=True, kw_only=True, repr=False)
class Batch:
    """Outputs of many runs of one model.

    ``batch["crank.angle"]`` is one output of all runs over ``batch.t``, an array (runs, times).

    Attributes
    ----------
    t
        Times (times,) of all runs, s.
    values
        Outputs (runs, times, outputs); nan after the end of a run that has failed.
    variables
        Name, unit and description of each output.
    varied
        Values (runs,) of all that was varied, by name.
    diagnostics
        Notes, warnings and errors of each run (runs,).
    """

    t: Array
    values: NDArray[np.float64]
    variables: tuple[Variable, ...]
    varied: dict[str, NDArray[Any]]
    diagnostics: tuple[tuple[Diagnostic, ...], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(v.name for v in self.variables)

    @property
    def failures(self) -> tuple[str, ...]:
        """Reason why a run has no result or ended early, of each run (runs,); empty: it reached its end."""
        return tuple(next((str(d) for d in own if d.severity == "error"), "") for own in self.diagnostics)

    def __repr__(self) -> str:
        """Return what there is, in one line."""
        runs, times, outputs = self.values.shape
        failed = sum(map(bool, self.failures))
        return f"<Batch of {runs} runs, {failed} failed: {times} times until {self.t[-1]:g} s, {outputs} outputs>"

    def __getitem__(self, name: str) -> Array:
        """Return one output of all runs (runs, times)."""
        if name not in self.names:
            raise UserError(f"no output {name!r}{suggest(str(name), self.names)}")
        return self.values[:, :, self.names.index(name)]


def simulate_many(
    model: Model,
    stop_time: float | None = None,
    *,
    parameters: Mapping[str, Sequence[Any]] | None = None,
    inputs: Mapping[str, Sequence[float]] | None = None,
    outputs: Sequence[str] = (),
    interval: float | None = None,
    threads: int = 0,
    **settings: Any,
) -> Batch:
    """Simulate a model many times with different parameters and inputs, on all processors of this machine.

    The model is exported once as a native FMU, which takes some seconds. Its runs then need no Python; threads of this
    process make them. They compute the same numbers as :func:`mbfmu.simulate`, up to rounding of parameter values that
    several numbers of the model follow.

    Parameters
    ----------
    model
        Model with the values of all parameters that are not varied.
    stop_time, interval
        End of the runs and time between outputs, s; by default those of the model.
    parameters
        Values of each run by name, as many of every name: parameters of the model, start values and tolerances among
        them (``start_angle``, ``tolerance``), as far as native FMUs can change them. A run with a value outside the
        range of the FMU, which may be smaller than that of the model, fails; :func:`mbfmu.study` has no such limit.
    inputs
        Values of inputs by name, in the unit of the input, constant during a run, as many as of the parameters.
    outputs
        Names of the outputs that are returned; by default all. Memory: 8 bytes for each run, time and output.
    threads
        Number of runs at a time; 0: as many as there are processors.
    **settings
        Settings of all runs, see :class:`~mbfmu.modeling.settings.Settings`.

    Returns
    -------
    Batch
        Outputs of all runs. A run that fails does not end the others: its outputs are nan from that time on, and
        ``failures`` contains the reason.

    Raises
    ------
    UserError
        The model, the times or the settings are invalid, a name is unknown or cannot be varied in a native FMU, or the
        model cannot be exported as one.

    Examples
    --------
    >>> lengths = np.linspace(0.9, 1.1, 1000)  # doctest: +SKIP
    >>> batch = mb.simulate_many(FourBar(), 10.0, parameters={"crank_length": lengths, "rocker_length": lengths})
    >>> batch["crank.angle"].shape
    (1000, 1001)
    """
    model = as_model(model)
    scene = _scene(model, stop_time, interval, settings)
    times = communication_points(scene.stop_time, scene.output_interval)
    varied = _arrays({**(parameters or {}), **(inputs or {})})
    if isinstance(outputs, str):
        raise UserError(f"outputs is {outputs!r}; allowed: a list of names, such as [{outputs!r}]")
    if not isinstance(threads, int) or threads < 0:
        raise UserError(f"threads is {threads!r}; allowed: a number of runs at a time, or 0 for one per processor")
    with tempfile.TemporaryDirectory(prefix="mbfmu_") as folder:
        path = Path(folder) / "model.fmu"
        export_scene(scene, path, FmuKind.NATIVE, falls_back=False)
        return _Runs(path, times, varied, outputs).make(threads or count_processors())


def _scene(model: Model, stop_time: float | None, interval: float | None, settings: dict[str, Any]) -> Scene:
    """Return what all runs have in common."""
    own: dict[str, Any] = {"solver": model.default_solver, "tolerance": model.tolerance}
    scene = Scene(
        name=model.name,
        model=model,
        settings=Settings(**own | settings),
        stop_time=float(model.stop_time if stop_time is None else stop_time),
        output_interval=float(model.output_interval if interval is None else interval),
    )
    if interval is not None:
        check_interval(scene.stop_time, interval)
    return scene


def _arrays(given: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Return the values (runs,) by name; raises UserError unless there are as many of each."""
    found = {}
    for name, values in given.items():
        array = np.asarray(values)
        found[name] = array if array.dtype == bool else array_of(f"values of {name!r}", values)
        if array.ndim != 1:
            raise UserError(
                f"values of {name!r} have the shape {array.shape}; allowed: (runs,), one value for each run"
            )
    counts = {name: len(values) for name, values in found.items()}
    if len(set(counts.values())) != 1:
        text = ", ".join(f"{count} of {name!r}" for name, count in counts.items()) or "none"
        raise UserError(f"values of parameters and inputs are {text}; allowed: one for each run, as many of every name")
    return found


class _Runs:
    """Runs of the native FMU at ``path`` over the same times, s."""

    def __init__(self, path: Path, times: Array, varied: dict[str, NDArray[Any]], outputs: Sequence[str]) -> None:
        self._path, self._times, self._varied = path, times, varied
        with Fmu(path) as fmu:
            self._check(fmu)
            names = list(outputs) or fmu.real_outputs
            for name in names:
                if name not in fmu.real_outputs:
                    raise UserError(f"there is no output {name!r}{suggest(str(name), fmu.real_outputs)}")
            described = [fmu.variables[name] for name in names]
            self._types = {name: FMI2_NUMBER_TYPES[fmu.variables[name].type] for name in varied}
        self._variables = tuple(Variable(v.name, v.unit or "1", v.description or "") for v in described)
        self._references = np.array([v.valueReference for v in described], np.uint32)
        count = len(next(iter(varied.values())))
        self._values = np.full((count, len(times), len(names)), np.nan)
        self._diagnostics: list[tuple[Diagnostic, ...]] = [()] * count
        self._numbers, self._ended = iter(range(count)), threading.Event()

    def _check(self, fmu: Fmu) -> None:
        """Refuse values of what the FMU does not have, or of what is constant in it."""
        for name, values in self._varied.items():
            own = fmu.variables.get(name)
            known = [n for n, v in fmu.variables.items() if v.causality in VARIABLE_CAUSALITIES]
            if own is None or (own.causality not in VARIABLE_CAUSALITIES and own.variability != "constant"):
                raise UserError(f"there is no parameter or input {name!r}{suggest(str(name), known)}")
            if own.causality not in VARIABLE_CAUSALITIES:
                raise UserError(f"{name!r} cannot be varied in one compiled model: {own.description}. {STUDY_ADVICE}")
            kind = FMI2_NUMBER_TYPES.get(own.type, float)
            if (kind is bool) != (values.dtype == bool) or (kind is int and np.any(values != np.round(values))):
                wanted = {bool: "True or False", int: "whole numbers", float: "numbers"}[kind]
                raise UserError(f"values of {name!r} are {values.dtype} numbers; allowed: {wanted}")

    def make(self, threads: int) -> Batch:
        """Make all runs."""
        with ThreadPoolExecutor(threads) as pool:
            try:
                for done in [pool.submit(self._work) for _ in range(min(threads, len(self._diagnostics)))]:
                    done.result()
            except BaseException:  # of Ctrl-C too: no other run begins
                self._ended.set()
                raise
        values, diagnostics = self._values, tuple(self._diagnostics)
        return Batch(
            t=self._times, values=values, variables=self._variables, varied=self._varied, diagnostics=diagnostics
        )

    def _work(self) -> None:
        """Make runs with one instance until none is left."""
        with Fmu(self._path) as fmu:
            for number in self._numbers:
                if self._ended.is_set():
                    return
                values = {name: self._types[name](own[number]) for name, own in self._varied.items()}
                run = values, self._times, self._references, self._values[number]
                _, self._diagnostics[number] = fmu.make_run(*run)

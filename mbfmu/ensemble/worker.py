"""What a worker does: it makes runs, a batch of them at a time, and measures them.

A job is what all runs of a study share, small enough to travel with every batch. A worker makes it ready once.
"""

from __future__ import annotations

import os
import signal
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import inf, nan
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

import mbfmu
from mbfmu.modeling.model import Model
from mbfmu.modeling.modules import load_module
from mbfmu.modeling.registry import find
from mbfmu.modeling.settings import Settings
from mbfmu.modeling.variables import ENERGY_OUTPUTS
from mbfmu.session.result import Result
from mbfmu.session.run import communication_points, run
from mbfmu.steady.equilibrium import equilibrium
from mbfmu.steady.state import Equilibrium
from mbfmu.util.errors import UserError
from mbfmu.util.extras import import_optional
from solvers.system import Array

from .design import Point
from .measures import Measure, Steady

STATUS_OK, STATUS_SUSPECT, STATUS_FAILED = "ok", "suspect", "failed"
STOP_TIME_KEY = "stop_time"
ENERGY_OUTPUT_NAMES = tuple(v.name for v in ENERGY_OUTPUTS)
STUDY_EXTRA = "study"  # of mbfmu: the packages that studies need


def dump(content: Any) -> bytes:
    """Return as bytes what workers are to have, functions and classes that they cannot import included."""
    return bytes(import_optional("cloudpickle", STUDY_EXTRA).dumps(content))


def load(content: bytes) -> Any:
    """Return what was pickled."""
    return import_optional("cloudpickle", STUDY_EXTRA).loads(content)


class Outcome(NamedTuple):
    """What became of one run."""

    number: int
    measures: tuple[float, ...]
    status: str
    message: str  # why it failed, or is not to be trusted
    energy_error: float  # J, the largest of the run
    seconds: float  # CPU time
    kept: tuple[Array, Array] | None  # times, and the outputs that are kept (times, outputs)


class Files(NamedTuple):
    """A user's file that is sent to workers, with the modules that it imports from its folder."""

    name: str
    contents: tuple[tuple[str, bytes], ...]

    def unpacked(self, folder: Path) -> Path:
        """Write them into a folder; return the path of the first."""
        for name, content in self.contents:
            (folder / name).write_bytes(content)
        return folder / self.name


class Runner(Protocol):
    """A job that is ready."""

    def result(self, point: Point) -> Result:
        """Return a run."""
        ...

    def steady(self, point: Point) -> Equilibrium:
        """Return the steady state."""
        ...

    def close(self) -> None:
        """Remove what it has written."""
        ...


@dataclass(frozen=True, kw_only=True)
class Job:
    """What all runs of a study share."""

    identity: str  # of the subject and of what is measured
    version: str
    measures: bytes  # pickled, as functions are in it
    measure_files: tuple[Files, ...]
    keep: tuple[str, ...]  # outputs whose history is kept
    fixed: Mapping[str, Any]  # values that every run has
    time_limit: float = 0.0  # s by the clock, after which a run has failed; 0: there is none


@dataclass(frozen=True, kw_only=True)
class ModelJob(Job):
    """Runs of a model without an FMU.

    Attributes
    ----------
    reference
        Name of a registered model; empty: it travels.
    files, class_name
        Where the class of the model is.
    pickled
        A model that is in no file.
    inputs
        Pickled signals that replace inputs, by name; empty: there are none.
    """

    reference: str = ""
    files: Files | None = None
    class_name: str = ""
    pickled: bytes = b""
    inputs: bytes = b""
    values: Mapping[str, Any]
    settings: Settings
    stop_time: float
    interval: float

    def make_runner(self, folder: Path) -> Runner:
        """Return it ready."""
        if self.pickled:
            return ModelRunner(self, load(self.pickled))
        if self.files:
            cls: type[Model] = getattr(load_module(self.files.unpacked(folder)), self.class_name)
        else:
            cls = find(self.reference)
        model = cls(**self.values)
        return ModelRunner(self, model.with_inputs(load(self.inputs)) if self.inputs else model)


class ModelRunner:
    """Runs of a model in this process."""

    def __init__(self, job: ModelJob, model: Model) -> None:
        self.job, self._model = job, model
        self._parameters = {p.name for p in model.parameters()}
        self._settings = set(vars(job.settings))

    def _model_at(self, point: Point) -> Model:
        return self._model.with_values({k: v for k, v in point.items() if k in self._parameters})

    def result(self, point: Point) -> Result:
        """Return a run."""
        settings = replace(self.job.settings, **{k: v for k, v in point.items() if k in self._settings})
        inputs = {k: v for k, v in point.items() if k not in self._parameters | self._settings | {STOP_TIME_KEY}}
        times = communication_points(point.get(STOP_TIME_KEY, self.job.stop_time), self.job.interval)
        return run(self._model_at(point), settings, times, inputs=inputs)

    def steady(self, point: Point) -> Equilibrium:
        """Return the steady state."""
        return equilibrium(self._model_at(point))

    def close(self) -> None:
        """Do nothing."""


@dataclass(frozen=True, kw_only=True)
class FmuJob(Job):
    """Runs of an FMU for co-simulation, of FMI 1, 2 or 3, through FMPy."""

    content: bytes
    values: Mapping[str, Any]
    outputs: tuple[tuple[str, str], ...]  # names and units
    stop_time: float
    interval: float
    is_native: bool = False  # whether it is a native FMU of mbfmu, whose runs need no separate instances

    def make_runner(self, folder: Path) -> Runner:
        """Return it ready."""
        from .fmu_runners import FmuRunner, NativeRunner  # which import this module

        return NativeRunner(self, folder) if self.is_native else FmuRunner(self, folder)


class PreparedJob(NamedTuple):
    """A job on this worker."""

    runner: Runner
    measures: tuple[Measure, ...]
    keep: tuple[str, ...]
    fixed: Mapping[str, Any]
    time_limit: float = 0.0


_prepared: dict[str, PreparedJob] = {}  # by identity: as long as this process lasts


def prepare(job: ModelJob | FmuJob) -> PreparedJob:
    """Return a job that is ready, made so where this process has not seen it.

    Raises
    ------
    UserError
        This mbfmu is another version, or the model that travels cannot be loaded here.
    """
    if mbfmu.__version__ != job.version:
        there = mbfmu.__version__
        raise UserError(f"a worker has mbfmu {there}, but the study needs {job.version}; install that version there")
    if job.identity not in _prepared:
        folder = Path(tempfile.mkdtemp(prefix="study-", dir=_scratch_dir()))
        for k, files in enumerate(job.measure_files):
            (folder / f"measures{k}").mkdir()
            load_module(files.unpacked(folder / f"measures{k}"))
        _prepared[job.identity] = PreparedJob(
            job.make_runner(folder), load(job.measures), job.keep, job.fixed, job.time_limit
        )
    return _prepared[job.identity]


def _scratch_dir() -> str | None:
    """Return the folder of this worker, which goes when it ends; None: the system's for temporary files."""
    try:
        return str(import_optional("distributed", STUDY_EXTRA).get_worker().local_directory)
    except ValueError:  # none
        return None


def forget_job(job: ModelJob | FmuJob) -> None:
    """Forget a job in this process, with its folder."""
    known = _prepared.pop(job.identity, None)
    if known is not None:
        known.runner.close()


def run_batch(job: ModelJob | FmuJob, points: Sequence[tuple[int, Point]], max_time: float = inf) -> list[Outcome]:
    """Make runs and measure them; the outcome of a run contains its error message.

    No run is begun after ``max_time`` seconds, but the first: outcomes may be fewer than points.
    """
    known, found = prepare(job), list[Outcome]()
    end = time.monotonic() + max_time
    for number, point in points:
        found.append(_run_one(known, number, point))
        if time.monotonic() > end:
            break
    return found


def _run_one(known: PreparedJob, number: int, point: Point) -> Outcome:
    begin = time.thread_time()
    nothing = (nan,) * len(known.measures)
    try:
        with _limited(known.time_limit):
            outcome = _measured(known, number, {**known.fixed, **point})
    except UserError as error:
        outcome = Outcome(number, nothing, STATUS_FAILED, str(error), nan, 0.0, None)
    except BaseException as error:  # what a model of the user's does; a worker would end at some of these
        outcome = Outcome(number, nothing, STATUS_FAILED, f"{type(error).__name__}: {error}", nan, 0.0, None)
    return outcome._replace(seconds=time.thread_time() - begin)


@contextmanager
def _limited(seconds: float) -> Iterator[None]:
    """Kill this process if the block takes longer: code of others that hangs cannot be stopped in another way."""
    if not seconds:
        yield
        return
    timer = threading.Timer(seconds, os.kill, (os.getpid(), signal.SIGKILL))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _measured(known: PreparedJob, number: int, point: Point) -> Outcome:
    found, of_runs = [nan] * len(known.measures), [not isinstance(m, Steady) for m in known.measures]
    status, message, energy_error, kept = STATUS_OK, "", nan, None
    if any(of_runs) or known.keep or not of_runs:
        result = known.runner.result(point)
        status = STATUS_FAILED if result.failed else STATUS_SUSPECT if result.warning else STATUS_OK
        message = next(map(str, result.problems), "")
        if "energy_error" in result.names:
            energy_error = float(np.abs(result["energy_error"]).max())
        if known.keep:
            kept = result.t, np.column_stack([result[name] for name in known.keep])
        for k, measure in enumerate(known.measures):
            if not isinstance(measure, Steady) and status != STATUS_FAILED:
                found[k] = measure.of(result)
    if not all(of_runs) and status != STATUS_FAILED:
        state = known.runner.steady(point)
        for k, measure in enumerate(known.measures):
            if isinstance(measure, Steady):
                found[k] = measure.of(state)
    return Outcome(number, tuple(found), status, message, energy_error, 0.0, kept)

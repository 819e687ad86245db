"""What a worker does: it makes runs, a batch of them at a time, and measures them.

A job is what all runs of a study share, small enough to travel with every batch. A worker makes it ready once.
"""

from __future__ import annotations

import os
import shutil
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
from mbfmu.mechanics import Variable
from mbfmu.modeling.model import Model
from mbfmu.modeling.modules import load_module
from mbfmu.modeling.registry import find
from mbfmu.modeling.settings import Settings
from mbfmu.modeling.variables import ENERGY_OUTPUTS
from mbfmu.session.result import Result
from mbfmu.session.run import communication_points, run
from mbfmu.steady.equilibrium import equilibrium
from mbfmu.steady.state import Equilibrium
from mbfmu.util.diagnostics import Diagnostic, without_repeats
from mbfmu.util.errors import UserError
from mbfmu.util.extras import import_optional
from solvers import Statistics
from solvers.system import Array

from .design import Point
from .measures import Measure, Steady

STATUS_OK, STATUS_SUSPECT, STATUS_FAILED = "ok", "suspect", "failed"
STOP_TIME_KEY = "stop_time"
ENERGY_OUTPUT_NAMES = tuple(v.name for v in ENERGY_OUTPUTS)
FMU_CODE = "fmu-warning"  # of messages without a code
FMI_WARNING_STATUS = 1  # the status of FMI; larger ones are worse
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
    dump
        A model that is in no file.
    """

    reference: str = ""
    files: Files | None = None
    class_name: str = ""
    pickled: bytes = b""
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
        return ModelRunner(self, cls(**self.values))


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


@dataclass(frozen=True, kw_only=True)
class FmuJob(Job):
    """Runs of an FMU for co-simulation, of FMI 1, 2 or 3, through FMPy."""

    content: bytes
    values: Mapping[str, Any]
    outputs: tuple[tuple[str, str], ...]  # names and units
    stop_time: float
    interval: float

    def make_runner(self, folder: Path) -> Runner:
        """Return it ready."""
        return FmuRunner(self, folder)


class FmuRunner:
    """Runs of an FMU in this process; each uses a separate instance."""

    def __init__(self, job: FmuJob, folder: Path) -> None:
        from fmpy import extract, read_model_description

        self.job, self._folder = job, folder / "fmu"
        file = folder / "model.fmu"
        file.write_bytes(job.content)
        extract(str(file), str(self._folder))
        self._description = read_model_description(str(self._folder))

    def result(self, point: Point) -> Result:
        """Return a run."""
        from fmpy import simulate_fmu

        job, messages = self.job, []
        stop, reached = float(point.get(STOP_TIME_KEY, job.stop_time)), [-inf]

        def step_finished(t: float, _: Any) -> bool:  # FMPy repeats a discarded step without limit
            stuck = t <= reached[0]
            reached[0] = t
            return not stuck

        def log_message(*given: Any) -> None:  # what an FMU logs of its course may be long
            if given[-3] >= FMI_WARNING_STATUS:
                messages.append((given[-3], _text(given[-1])))

        names = [name for name, _ in job.outputs]
        failure, rows = "", None
        try:
            rows = simulate_fmu(
                str(self._folder), stop_time=stop, output_interval=job.interval, output=names,
                start_values={**job.values, **{k: v for k, v in point.items() if k != STOP_TIME_KEY}},
                model_description=self._description, step_finished=step_finished, logger=log_message,
                debug_logging=True,
            )  # fmt: skip
        except Exception as error:  # FMPy raises what it likes
            failure = _last_error(messages) or f"{type(error).__name__}: {error}"
        if rows is None:
            raise UserError(failure)
        if rows["time"][-1] < stop * (1.0 - 1e-9):
            failure = _last_error(messages) or f"the FMU ended at {rows['time'][-1]:g} s, before {stop:g} s"
        return Result(
            t=rows["time"],
            values=np.column_stack([rows[name] for name in names]).astype(float),
            variables=tuple(Variable(name, unit, "") for name, unit in job.outputs),
            statistics=Statistics(),
            wall_time=0.0,
            diagnostics=without_repeats(
                [
                    *(_parse(text) for status, text in messages if status == FMI_WARNING_STATUS),
                    *_find_nonfinite(rows, names),
                    *([Diagnostic.parse(failure, "error", FMU_CODE)] if failure else []),
                ]
            ),
        )

    def steady(self, point: Point) -> Equilibrium:
        """Refuse."""
        raise UserError(
            "an FMU provides no steady states; use a measure of the motion, or the model in place of its FMU"
        )


def _parse(text: str) -> Diagnostic:
    return Diagnostic.parse(text, "warning", FMU_CODE)


def _find_nonfinite(rows: Any, names: Sequence[str]) -> list[Diagnostic]:
    """Return a warning about the first output that is no finite number."""
    for name in names:
        odd = ~np.isfinite(rows[name].astype(float))
        if odd.any() and name not in ENERGY_OUTPUT_NAMES:
            value, time = rows[name][odd][0], rows["time"][odd][0]
            return [_parse(f"output {name!r} is {value} at t = {time:g} s, which is not a finite number")]
    return []


def _text(given: Any) -> str:
    return given.decode(errors="replace") if isinstance(given, bytes) else str(given)


def _last_error(messages: Sequence[tuple[int, str]]) -> str:
    """Return the last that is more than a warning."""
    return next((text for status, text in reversed(messages) if status > FMI_WARNING_STATUS), "")


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
    if known is not None and isinstance(known.runner, FmuRunner):
        shutil.rmtree(known.runner._folder.parent, ignore_errors=True)


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

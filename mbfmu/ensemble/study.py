"""A study from its definition to its table: many runs, made by workers and stored during the study."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mbfmu.util.errors import UserError
from mbfmu.util.extras import import_optional

from .definition import Definition, define, read_study
from .design import Point
from .engine import Workers, check_place, pad_outcomes
from .objective import Optimum, optimize_objective
from .records import HISTORIES_FOLDER, Records, Row, read_definition, read_histories, read_table
from .worker import STATUS_FAILED, STATUS_OK, STATUS_SUSPECT, STUDY_EXTRA, FmuJob, ModelJob, Outcome

Progress = Callable[[int, int, int], None]  # arguments: finished runs, all runs, failed runs


@dataclass(frozen=True)
class Study:
    """Results of a study, in the order of its runs.

    Attributes
    ----------
    name
        Name of the model, scene or FMU.
    rows
        One dictionary per run: varied values, measures, ``status`` ("ok", "suspect" or "failed") with the reason in
        ``message``, the largest ``energy_error`` in J, and its CPU time in ``seconds``.
    units
        Units of varied values and measures, by name.
    varied, measures
        Names of varied values and of measures.
    folder
        Folder of the study.
    replaced_inputs
        A line for every input of the model that a signal replaces in all runs.
    found
        Best value of the aim, and its point; None without an aim.
    wall_time, summed_time
        Time of the study, s, and sum of the CPU times of its runs, s.
    """

    name: str
    rows: tuple[Row, ...]
    units: Mapping[str, str]
    varied: tuple[str, ...]
    measures: tuple[str, ...]
    folder: Path
    found: Optimum | None = None
    wall_time: float = 0.0
    replaced_inputs: tuple[str, ...] = ()

    @property
    def summed_time(self) -> float:
        """CPU time of all runs, s."""
        return float(sum(row["seconds"] for row in self.rows))

    def count(self, status: str) -> int:
        """Return the number of runs with a status.

        Parameters
        ----------
        status
            ``"ok"``, ``"suspect"`` or ``"failed"``.

        Returns
        -------
        int
            Number of runs.
        """
        return sum(row["status"] == status for row in self.rows)

    def column(self, name: str) -> Any:
        """Return a varied value or a measure over the runs.

        Parameters
        ----------
        name
            Name of the column.

        Returns
        -------
        Array
            Values (runs,) in the order of the runs.
        """
        return np.array([row[name] for row in self.rows])

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame with one row per run; units in ``attrs["units"]``."""
        pandas = import_optional("pandas", STUDY_EXTRA)
        frame = pandas.DataFrame(list(self.rows)).set_index("run")
        frame.attrs["units"] = dict(self.units)
        return frame

    def to_xarray(self) -> Any:
        """Return an xarray Dataset with one variable per column over ``run``, with units."""
        dataset = self.to_dataframe().to_xarray()
        for name, unit in self.units.items():
            dataset[name].attrs["units"] = unit
        return dataset

    def trajectories(self) -> Any:
        """Return a pandas DataFrame of the stored outputs, by run and time in s."""
        import_optional("pandas", STUDY_EXTRA)
        if not (self.folder / HISTORIES_FOLDER).exists():
            raise UserError("the study contains no trajectories; list outputs in keep")
        frame = read_histories(self.folder).to_pandas()
        runs = {row["key"]: row["run"] for row in self.rows}
        frame = frame[frame["key"].isin(runs)]
        frame.insert(0, "run", frame.pop("key").map(runs).astype(int))
        frame = frame.set_index(["run", "time"]).sort_index()
        return frame[~frame.index.duplicated()]  # a study that was killed may have written a part twice

    def __repr__(self) -> str:
        """Return it in one line."""
        told = ", ".join(f"{self.count(s)} {s}" for s in (STATUS_OK, STATUS_SUSPECT, STATUS_FAILED) if self.count(s))
        return f"<Study of {self.name}: {len(self.rows)} runs, {told}>"


def study(
    given: Any,
    vary: Mapping[str, Any] | None = None,
    measure: Mapping[str, Any] | None = None,
    *,
    folder: Path | str,
    resume: bool = False,
    scheduler: str = "",
    workers: int = 0,
    progress: Progress | None = None,
    **more: Any,
) -> Study:
    """Make many runs of a scene, a model or an FMU, and measure each.

    Parameters
    ----------
    given
        A scene or its name, a model, a mechanism, the path of an FMU, or that of a study file (``.toml`` with a table
        ``[vary]``), which contains the other arguments.
    vary
        Varied quantities by name: parameters, inputs, settings and ``stop_time``; see :mod:`mbfmu.ensemble.variation`.
    measure
        Measures by name; see :mod:`mbfmu.ensemble.measures`.
    folder
        Folder for the results.
    resume
        Whether to continue the same study in this folder without repeating its runs; else the folder must be new or
        empty.
    scheduler
        Address of a Dask scheduler; empty: processes of this machine.
    workers
        Number of processes; 0: one per processor.
    progress
        Function that receives the numbers of finished runs, of all runs, and of failed runs.
    **more
        Other keys of a study file, see :mod:`mbfmu.ensemble.definition`; ``runs`` stands for ``with``.

    Returns
    -------
    Study
        Results of all runs, in the order of the runs.

    Raises
    ------
    UserError
        The study, the folder or the workers are invalid. A failed run is a row with its reason.
    """
    return run_study(
        define(content_of(given, vary, measure, more)), Path(folder), resume=resume, scheduler=scheduler,
        workers=workers, progress=progress,
    )  # fmt: skip


def content_of(
    given: Any, vary: Mapping[str, Any] | None, measure: Mapping[str, Any] | None, more: Mapping[str, Any]
) -> dict[str, Any]:
    """Return a study as its file would say it."""
    own = {("with" if k == "runs" else k): v for k, v in more.items()}
    if vary is not None:
        kind = "fmu" if str(given).endswith(".fmu") else "scene"
        return {kind: given, "vary": vary} | ({"measure": measure} if measure is not None else {}) | own
    if not str(given).endswith(".toml"):
        raise UserError(
            f"vary is not given for {given!r}; allowed: a table of parameters and their variations, or a study file"
        )
    return read_study(Path(given)) | own


def run_study(
    definition: Definition,
    folder: Path,
    *,
    resume: bool = False,
    scheduler: str = "",
    workers: int = 0,
    progress: Progress | None = None,
) -> Study:
    """Make the runs of a definition; see :func:`study`."""
    begin = time.perf_counter()
    check_place()
    job, records = definition.job(), Records(folder, definition)
    wanted = [] if definition.aim else definition.points()
    campaign = RunScheduler(job, records, scheduler, workers, progress)
    found = None
    with closing(campaign), closing(records):
        records.begin(resume)
        try:
            if definition.aim:
                found = optimize_objective(definition.aim, definition.vary, campaign.measured, definition.sampling.seed)
            else:
                campaign.evaluate(wanted)
        except Exception:  # such as no scheduler; an interrupted study is resumed
            records.discard()
            raise
        records.finish(campaign.keys)
    return replace(load_study(folder), found=found, wall_time=time.perf_counter() - begin)


class RunScheduler:
    """Requested runs, made by workers unless a record exists; workers are started when they are needed.

    Attributes
    ----------
    keys
        Keys of all requested runs, in order.
    """

    def __init__(
        self, job: ModelJob | FmuJob, records: Records, scheduler: str, count: int, progress: Progress | None
    ) -> None:
        self.keys: list[str] = []
        self._job, self._records, self._progress = job, records, progress
        self._where, self._seconds, self._done = (scheduler, count), 0.0, 0
        self._workers: Workers | None = None

    def evaluate(self, points: Sequence[Point]) -> None:
        """Let there be a record of the run at each of these points."""
        keys = [self._records.key(point) for point in points]
        first = len(self.keys)
        self.keys += keys
        missing: dict[str, tuple[int, Point]] = {}
        for k, (key, point) in enumerate(zip(keys, points, strict=True), first):
            if key not in self._records.done:
                missing.setdefault(key, (k, point))
        waiting = list(missing.values())
        self._done += len(keys) - len(waiting)
        self._report_progress()
        if not waiting:
            return
        self._workers = self._workers or Workers(*self._where)
        asked = dict(waiting)
        for some in [waiting] if self._seconds else [waiting[:1], waiting[1:]]:  # the first compiles what all need
            for outcomes in self._workers.run(self._job, some, self._seconds or 1.0):
                self._add_outcomes(outcomes, asked)
                self._seconds = outcomes[0].seconds or 1.0  # nothing is known of one that killed its process

    def _add_outcomes(self, outcomes: Sequence[Outcome], requested: Mapping[int, Point]) -> None:
        whole = pad_outcomes(outcomes, len(self._records.definition.measures))
        self._records.add(whole, [requested[outcome.number] for outcome in whole])
        self._done += len(whole)
        self._report_progress()

    def _report_progress(self) -> None:
        if self._progress is not None:
            self._progress(self._done, len(self.keys), self._records.failed)

    def measured(self, points: Sequence[Point]) -> list[dict[str, float]]:
        """Return the measures at each of these points; NaN where a run failed."""
        self.evaluate(points)
        names, asked = [m.name for m in self._records.definition.measures], self.keys[len(self.keys) - len(points) :]
        return [dict(zip(names, self._records.done[key], strict=True)) for key in asked]

    def close(self) -> None:
        """Let the workers go."""
        if self._workers is not None:
            self._workers.close()


def load_study(folder: Path | str) -> Study:
    """Return the study that is stored in a folder, with its completed runs.

    Parameters
    ----------
    folder
        Folder of the study.

    Returns
    -------
    Study
        Results of the completed runs; ``found`` is None.

    Raises
    ------
    UserError
        The folder contains no study.
    """
    folder = Path(folder)
    told = read_definition(folder)
    written = told["study"]
    varied, measures = tuple(written["vary"]), tuple(written.get("measure", {}))
    rows, replaced = tuple(read_table(folder).to_pylist()), tuple(told.get("replaced_inputs", ()))
    return Study(told["name"], rows, told["units"], varied, measures, folder, replaced_inputs=replaced)

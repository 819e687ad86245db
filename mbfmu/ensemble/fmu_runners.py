"""Runs of an FMU for a study: a native FMU of mbfmu by one instance, any other FMU by FMPy."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics import Variable
from mbfmu.session.result import Result
from mbfmu.session.run import communication_points
from mbfmu.steady.state import Equilibrium
from mbfmu.util.diagnostics import Diagnostic, without_repeats
from mbfmu.util.errors import UserError
from solvers import Statistics

from .design import Point
from .worker import ENERGY_OUTPUT_NAMES, STOP_TIME_KEY

if TYPE_CHECKING:
    from .worker import FmuJob

FMU_CODE = "fmu-warning"  # of messages without a code
FMI_WARNING_STATUS = 1  # the status of FMI; larger ones are worse
NO_STEADY_STATES = "an FMU provides no steady states; use a measure of the motion, or the model in place of its FMU"


class NativeRunner:
    """Runs of a native FMU in this process, by one instance, as those of :func:`mbfmu.simulate_many`."""

    def __init__(self, job: FmuJob, folder: Path) -> None:
        from mbfmu.fmi.harness import Fmu

        file = folder / "model.fmu"
        file.write_bytes(job.content)
        self.job, self._fmu, self.folder = job, Fmu(file), folder
        references = [self._fmu.variables[name].valueReference for name, _ in job.outputs]
        self._references = np.array(references, np.uint32)

    def result(self, point: Point) -> Result:
        """Return a run."""
        job = self.job
        times = communication_points(point.get(STOP_TIME_KEY, job.stop_time), job.interval)
        given = {**job.values, **{name: value for name, value in point.items() if name != STOP_TIME_KEY}}
        rows = np.zeros((len(times), len(job.outputs)))
        done, diagnostics = self._fmu.make_run(given, times, self._references, rows)
        if not done:
            raise UserError(str(diagnostics[-1]))
        return Result(
            t=times[:done],
            values=rows[:done],
            variables=tuple(Variable(name, unit, "") for name, unit in job.outputs),
            statistics=Statistics(),
            wall_time=0.0,
            diagnostics=diagnostics,
        )

    def steady(self, point: Point) -> Equilibrium:
        """Refuse."""
        raise UserError(NO_STEADY_STATES)

    def close(self) -> None:
        """Free the instance, and remove its folder."""
        self._fmu.close()
        shutil.rmtree(self.folder, ignore_errors=True)


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
        raise UserError(NO_STEADY_STATES)

    def close(self) -> None:
        """Remove its folder."""
        shutil.rmtree(self._folder.parent, ignore_errors=True)


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

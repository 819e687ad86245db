"""Run the FMU of a model through FMPy and record what the direct run records."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import Variable
from mbfmu.modeling.model import Model
from mbfmu.modeling.replaced_inputs import given_for
from mbfmu.modeling.settings import Settings
from mbfmu.modeling.variables import COUNTERS
from mbfmu.session.interrupts import interrupts_held
from mbfmu.session.run import Result
from mbfmu.util.diagnostics import INACCURATE_CODES, Diagnostic, without_repeats
from mbfmu.util.errors import UserError
from solvers.options import Statistics

from .harness import Fmu

IMMEDIATE_CODES = INACCURATE_CODES | {"slow-solver"}  # reported during the run


def run_fmu(
    path: Path,
    model: Model,
    settings: Settings,
    times: NDArray[np.float64],
    progress: Callable[[float], None] | None = None,
    warn: Callable[[Diagnostic], None] | None = None,
) -> Result:
    """Drive the FMU of a model over ``times`` (s); stops where the FMU discards a step.

    ``warn`` is called at once when the energy balance is violated, and when another solver would be far faster; the run
    continues. Ctrl-C ends it between two steps.
    """
    given = given_for(model.replaced_inputs)
    with (
        interrupts_held(fatal=True) as interrupt,
        Fmu(path, start_time=float(times[0]), tolerance=settings.tolerance) as fmu,
    ):
        values = np.zeros((len(times), len(fmu.real_outputs)))
        values[0] = fmu.reals()
        begin, done, failures, reported = time.perf_counter(), 1, list[Diagnostic](), len(fmu.diagnostics)
        for i, t in enumerate(times[1:], 1):
            interrupt()
            try:
                fmu.step_to(float(t))
            except UserError as error:
                failures.append(error.diagnostic)
                break
            values[i] = fmu.reals()
            done = i + 1
            for found in fmu.diagnostics[reported:]:
                if warn is not None and found.code in IMMEDIATE_CODES:
                    warn(found)
            reported = len(fmu.diagnostics)
            if progress is not None:
                progress(float(t))
        wall = time.perf_counter() - begin
        described = [fmu.variables[name] for name in fmu.real_outputs]
        variables = tuple(Variable(v.name, v.unit or "1", v.description or "") for v in described)
        statistics = Statistics(**{name: fmu[f"solver.{name}"] for name in COUNTERS})
        return Result(
            t=times[:done],
            values=values[:done],
            variables=variables,
            statistics=statistics,
            wall_time=wall,
            name=model.name,
            settings=settings,
            diagnostics=without_repeats([*(d for d in fmu.diagnostics if d.severity != "error"), *failures]),
            inputs=given.summary(settings.input_interpolation) if given else (),
        )

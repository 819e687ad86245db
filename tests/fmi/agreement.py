"""What every FMU must do: move as its model does without one, and go on from a saved state as if nothing had been."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbfmu.fmi import Fmu
from mbfmu.modeling import Model
from mbfmu.session.run import run
from mbfmu.session.simulation import Settings

STEP = 0.013  # s, in no proportion to the solvers' own steps


def check_against_direct(path: Path, model: Model, solver: str, times: NDArray[np.float64]) -> None:
    direct = run(model, Settings(solver=solver, tolerance=1e-8), times)
    with Fmu(path, {"solver": solver, "tolerance": 1e-8}) as fmu:
        for t, expected in zip(times[1:], direct.values[1:], strict=True):
            fmu.step_to(float(t))
            np.testing.assert_allclose(fmu.reals(), expected, rtol=1e-12, atol=1e-12)


def check_continuation(first: Fmu, second: Fmu, before: int, after: int) -> None:
    """The second instance continues the first bit by bit: ``before`` steps, a saved state, ``after`` steps."""
    for _ in range(before):
        first.step(STEP)
    second.restore(first.save())
    second.t = first.t
    for _ in range(after):
        first.step(STEP)
        second.step(STEP)
        np.testing.assert_array_equal(first.reals(), second.reals())

"""Runs of a study by a native FMU: one instance makes all of them, and each is that of the model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbfmu.ensemble.definition import define
from mbfmu.ensemble.fmu_runners import NativeRunner
from mbfmu.ensemble.worker import STATUS_FAILED, STATUS_OK, Outcome, forget_job, prepare, run_batch

POINTS: list[tuple[int, dict[str, Any]]] = [
    (0, {"start_angle": 0.2}), (1, {"start_angle": 0.2, "crank_length": 9.0}), (2, {"start_angle": 0.2}),
    (3, {"start_angle": -0.4, "gravity": 1.62}), (4, {"start_angle": 0.2, "stop_time": 0.3}),
]  # fmt: skip


@pytest.fixture
def scene(tmp_path: Path) -> str:
    path = tmp_path / "swing.toml"
    path.write_text('model = "fourbar"\nsolver = "adams"\nstop_time = 0.5\noutput_interval = 0.01\n')
    return str(path)


def outcomes(scene: str, method: str) -> list[Outcome]:
    vary = {"start_angle": [0.2], "gravity": [1.62], "crank_length": [9.0], "stop_time": [0.3]}
    measure = {"fastest": "largest crank.rate", "last": "end crank.angle"}
    job = define({"scene": scene, "with": method, "vary": vary, "measure": measure, "keep": ["pivot.force.y"]}).job()
    assert isinstance(prepare(job).runner, NativeRunner) == (method == "native")
    try:
        return run_batch(job, POINTS)
    finally:
        forget_job(job)


def test_runs_of_a_native_fmu_are_those_of_the_model(scene: str):
    native, direct = outcomes(scene, "native"), outcomes(scene, "simulation")
    assert [o.status for o in native] == [STATUS_OK, STATUS_FAILED, STATUS_OK, STATUS_OK, STATUS_OK]
    assert [o.status for o in native] == [o.status for o in direct]
    assert "pivot" in native[1].message
    for one, other in zip(native, direct, strict=True):
        assert np.array_equal(one.measures, other.measures, equal_nan=True)
        assert np.array_equal(one.energy_error, other.energy_error, equal_nan=True)
        if one.kept is not None and other.kept is not None:
            np.testing.assert_array_equal(one.kept[0], other.kept[0])
            np.testing.assert_array_equal(one.kept[1], other.kept[1])
    assert native[2].measures == native[0].measures

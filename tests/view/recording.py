"""The motion of a model as it runs."""

from __future__ import annotations

from mbfmu.modeling import Model
from mbfmu.session.run import Result, communication_points, run
from mbfmu.session.simulation import Settings
from mbfmu.viewer import Motion, Recorder


def recorded(model: Model, stop: float = 0.5) -> tuple[Result, Motion]:
    recorder = Recorder()
    result = run(model, Settings(solver="adams"), communication_points(stop, 0.01), watch=recorder)
    assert not result.failure
    return result, recorder.motion(model.name)

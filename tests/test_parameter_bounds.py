"""Parameters of the models at the ends of what they allow: right, or refused, or stopped with a message."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from mbfmu.modeling import Model
from mbfmu.session.run import run
from mbfmu.session.simulation import Settings
from mbfmu.util.errors import UserError

MODELS = (FourBar(), Governor(), SwingPendulum())
ENDS = [
    pytest.param(model, p.name, type(p.default)(end), id=f"{model.name}-{p.name}-{end:g}")
    for model in MODELS
    for p in model.parameters()
    if not isinstance(p.default, bool | str)
    for end in (p.min, p.max)
    if np.isfinite(end)
]
OUT_OF_REACH = {"ground_length", "coupler_length", "rocker_length", "rod_length"}  # 1 mm does not close the loop


@pytest.mark.parametrize("solver", ["ida", "adams", pytest.param("hybrid", marks=pytest.mark.campaign)])
@pytest.mark.parametrize(("model", "name", "end"), ENDS)
def test_a_run_at_the_end_of_a_range(model: Model, name: str, end: float, solver: str) -> None:
    settings, times = Settings(solver=solver, tolerance=1e-6), np.linspace(0.0, 0.5, 11)
    changed = replace(model, **{name: end})
    if name in OUT_OF_REACH:
        with pytest.raises(UserError, match="loop cannot close"):
            run(changed, settings, times)
        return
    result = run(changed, settings, times)
    if name == "slider_mass":  # a billionth on the stiff spring: 7 MHz
        assert "number of steps" in result.failure
        return
    if (name, end, solver) == ("coupler_modes", 12, "ida"):  # its crossing at 0.18 s passes or not by the last digits
        assert not result.failure or "two branches" in result.failure
    else:
        assert not result.failure
    loss = np.abs(result["energy_error"]).max()
    assert loss < 1e-4 * np.abs(result["energy_throughput"]).max()

"""The arm that is spun up, against geometrically exact beams (data of Simo and Vu-Quoc, tip from two codes)."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from mbfmu.session.run import run
from mbfmu.session.simulation import Settings

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))

from spinning_arm import SpinningArm

TIMES = np.linspace(0.0, 20.0, 2001)


@pytest.mark.parametrize("solver", ["ida", "adams"])
def test_with_geometric_stiffening_the_tip_comes_back(solver: str) -> None:
    result = run(SpinningArm(), Settings(solver=solver, tolerance=1e-7), TIMES)
    assert not result.failure
    tip = result["tip.deflection"]
    assert tip.min() == pytest.approx(-0.574, abs=2e-3)
    assert TIMES[tip.argmin()] == pytest.approx(6.76, abs=0.05)
    assert tip[500] == pytest.approx(-0.4685, abs=5e-3)
    assert tip[1000] == pytest.approx(-0.3630, abs=5e-3)
    assert np.abs(tip[TIMES > 15.0]).max() < 4e-3
    np.testing.assert_allclose(result["hub.speed"][TIMES > 15.0], 6.0, rtol=1e-12)


def test_without_it_the_arm_runs_away() -> None:
    result = run(SpinningArm(stiffening=False), Settings(solver="adams", tolerance=1e-7), TIMES[TIMES <= 9.3])
    tip = result["tip.deflection"]
    assert tip[750] == pytest.approx(-1.46, abs=0.01)
    assert np.abs(tip[TIMES[: len(tip)] < 9.0]).max() < 10.0  # longer than the arm is
    assert np.abs(tip).max() > 10.0

"""Four-bar whose coupler is a mesh in three dimensions, against the coupler of beam elements."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbfmu as mb

pytest.importorskip("skfem")
BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.mark.campaign
def test_the_deflection_of_a_meshed_coupler_approaches_that_of_beam_elements(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the square of the size of the cells; a frame in one end lengthens the chord by (pi w)^2 / (2 L)."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    import meshed_fourbar as own  # type: ignore[import-not-found]

    exact = own.reference()
    largest = float(np.abs(exact).max())

    def difference(**parameters: Any) -> float:
        result = mb.simulate(own.MeshedFourBar(**parameters), own.STOP_TIME, **own.OPTIONS)
        assert not result.failure
        return float(np.abs(own.deflection(result) - exact).max()) / largest

    coarse, fine = difference(cells=8), difference(cells=16)
    assert fine < 0.006
    assert coarse > 3.5 * fine
    assert difference(cells=16, is_centered=False) > 5.0 * fine

"""By how much a loop misses a singular configuration, as a stepper reports it."""

from __future__ import annotations

from math import isnan

import numpy as np
import pytest

from fmus.fourbar import FourBar
from solvers import Options
from solvers.steppers.dense import DenseFormulation


@pytest.mark.parametrize(("longer", "low", "high"), [(0.0, 0.0, 0.0), (1e-5, 1e-6, 1e-5), (1e-3, 1e-4, 1e-3)])
def test_the_gap_grows_with_the_excess_length_of_a_bar_and_is_computed_again(
    longer: float, low: float, high: float
) -> None:
    compiled = FourBar(coupler_length=3.0 * (1.0 + longer)).compile()
    start, v = compiled.assemble()
    own = DenseFormulation(compiled.system, 0.0, start, v, Options())
    for _ in range(2):
        assert low <= own.bifurcation_gap(0.0, np.array([1e-3, -1e-3, 1e-3])) <= high
        far = own.bifurcation_gap(0.0, np.array([1.5, -1.5, 1.5]))
        assert isnan(far) or low <= far <= high

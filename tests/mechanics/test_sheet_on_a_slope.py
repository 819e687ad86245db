"""A sheet on a slope: its creep below the angle of friction, and its acceleration above it."""

from __future__ import annotations

import numpy as np
import pytest

from mbfmu.mechanics import Mechanism
from mbfmu.sheets import Wall, add_contact

from .strips import GRAVITY, THICKNESS, add_strip, run, sliding


def on_a_slope(share: float, creep: float) -> Mechanism:
    """A strip on a table with friction 0.3, inclined by gravity: tan(angle) = 0.3 share."""
    angle = np.arctan(0.3 * share)
    m = Mechanism(gravity=(GRAVITY * np.sin(angle), -GRAVITY * np.cos(angle), 0.0))
    sheet = add_strip(m, 7, 0.1)
    add_contact(m, "table", sheet, Wall(at=(0.0, -0.5 * THICKNESS, 0.0), normal="y"), friction=0.3, creep=creep)
    for name, quantity in (("x", sheet.node(3, 1).position("x")), ("rate", sheet.node(3, 1).velocity("x"))):
        m.output(name, quantity)
    return m


@pytest.mark.parametrize("solver", ["ida", "esdirk"])
@pytest.mark.parametrize("creep", [1e-3, 1e-4])
def test_a_sheet_on_a_slope_creeps_at_the_velocity_of_the_closed_form(solver: str, creep: float) -> None:
    """Below the angle of friction, the component of the weight along the slope is mu N v / sqrt(v^2 + v_r^2)."""
    found = run(on_a_slope(0.7, creep), 0.4, 0.2, solver=solver)
    assert (found["x"][-1] - found["x"][-2]) / 0.2 == pytest.approx(creep * sliding(0.7), rel=5e-3)


def test_a_sheet_with_a_small_creep_rests_for_ten_seconds() -> None:
    """With v_r = 1 nm/s, nine seconds move it by nine seconds of creep: 9 nm."""
    found = run(on_a_slope(0.7, 1e-9), 10.0, 1.0, solver="esdirk")
    assert found["x"][-1] - found["x"][1] == pytest.approx(9e-9 * sliding(0.7), rel=5e-3)


@pytest.mark.parametrize("solver", ["ida", "esdirk"])
def test_a_sheet_slides_down_a_steep_slope(solver: str) -> None:
    """Above the angle of friction: g (sin a - mu cos a)."""
    angle = np.arctan(0.45)
    found = run(on_a_slope(1.5, 1e-4), 0.4, 0.2, solver=solver, tolerance=1e-5)
    due = GRAVITY * (np.sin(angle) - 0.3 * np.cos(angle))
    assert (found["rate"][-1] - found["rate"][-2]) / 0.2 == pytest.approx(due, rel=5e-3)

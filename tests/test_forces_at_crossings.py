"""Forces of a loop that a drive takes through a singular configuration: unbounded in the pins, and not in the drive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from mbfmu.mechanics import Mechanism, Polynomial, Revolute, RevoluteCutJoint, rod
from mbfmu.modeling import Model
from mbfmu.session.run import run
from mbfmu.session.simulation import Settings
from mbfmu.util.diagnostics import without_details

WEIGHT = (0.5 * 1.0 + 2.0 + 0.5 * 1.5) * 9.81  # N m at the crank, of coupler and half of both cranks
DISTANCES = np.array([1e-4, 3e-4, 1e-3, 2e-3, 2.5e-3, 3e-3, 1e-2])


@dataclass(frozen=True, kw_only=True)
class Lifted(Model):
    """A parallelogram whose crank is driven through the horizontal at constant speed, and optionally a free bar."""

    speed: float = 1.0
    has_bar: bool = False

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        crank = m.body("crank", m.ground, Revolute(drive=Polynomial((-0.6, self.speed))), **rod(mass=1.0, length=1.0))
        coupler = m.body("coupler", crank, Revolute(at=(1.0, 0.0, 0.0), start=0.6), **rod(mass=2.0, length=3.0))
        rocker = m.body("rocker", m.ground, Revolute(at=(3.0, 0.0, 0.0), start=-0.6), **rod(mass=1.5, length=1.0))
        pin = m.cut("pin", RevoluteCutJoint(at_a=(3.0, 0.0, 0.0), at_b=(1.0, 0.0, 0.0)), coupler, rocker)
        if self.has_bar:
            m.body("bar", m.ground, Revolute(at=(0.0, -2.0, 0.0), start=1.0), **rod(mass=1.0, length=1.0))
        m.output("crank", crank.angle())
        m.output("rocker", rocker.angle())
        m.output("effort", crank.effort())
        m.output("pin", pin.joint_force("x"))
        return m


@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
@pytest.mark.parametrize("has_bar", [False, True])
@pytest.mark.parametrize("speed", [0.1, 1.0, 10.0])
def test_the_effort_follows_from_virtual_work(speed: float, has_bar: bool, solver: str) -> None:
    """The coupler translates and nothing accelerates: M = weight cos, whatever the pins hold."""
    angles = np.concatenate(([-0.6], -DISTANCES[::-1], DISTANCES, [0.6]))
    times = (angles + 0.6) / speed
    result = run(Lifted(speed=speed, has_bar=has_bar), Settings(solver=solver, tolerance=1e-8), times)
    assert result.failure == result.warning == ""
    np.testing.assert_allclose(result["rocker"], result["crank"], atol=1e-8)
    np.testing.assert_allclose(result["effort"], WEIGHT * np.cos(angles), rtol=2e-3)
    if speed <= 1.0:  # what half of the coupler's weight asks of a pin grows as one over the angle
        growing = result["pin"][1:-1] * np.tan(angles[1:-1])
        np.testing.assert_allclose(growing, growing[len(growing) // 2], rtol=2e-2)


@pytest.mark.parametrize("solver", ["adams", "ida"])
def test_forces_in_the_singular_position_itself_are_reported(solver: str) -> None:
    result = run(Lifted(), Settings(solver=solver, tolerance=1e-6), np.array([0.0, 0.3, 0.6, 0.9]))
    assert [text for text in map(str, result.diagnostics) if "are not determined and may be" in text]
    assert "t = 0.6 s" in result.diagnostics[-1].text
    quiet = run(Lifted(), Settings(solver=solver, tolerance=1e-6), np.array([0.0, 0.3, 0.59, 0.9]))
    assert not without_details(quiet.diagnostics)

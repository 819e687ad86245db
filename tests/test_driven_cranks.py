"""Loops without freedom: a crank that is driven, through its dead centers or into one that it cannot pass."""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, atan2, cos, radians, sin

import numpy as np
import pytest

from mbfmu.mechanics import Mechanism, Polynomial, Revolute, RevoluteCutJoint, Translational, rod
from mbfmu.modeling import Model
from mbfmu.session.run import run
from mbfmu.session.simulation import Settings


@dataclass(frozen=True, kw_only=True)
class Driven(Model):
    """Crank and rocker 1 m, coupler and ground 2.5 m but for ``longer``."""

    name = "driven"
    start: float = radians(40.0)
    longer: float = 0.0

    def build(self) -> Mechanism:
        coupler = 2.5 * (1.0 + self.longer)
        way = 2.5 - complex(cos(self.start), sin(self.start))
        knee = acos((coupler**2 + abs(way) ** 2 - 1.0) / (2.0 * coupler * abs(way)))
        along = min((atan2(way.imag, way.real) + s * knee for s in (1.0, -1.0)), key=abs)
        back = coupler * complex(cos(along), sin(along)) - way
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        drive = Polynomial((self.start, 2.0))
        crank = m.body("crank", m.ground, Revolute(drive=drive), **rod(mass=1.0, length=1.0))
        link = Revolute(at=(1.0, 0.0, 0.0), start=along - self.start)
        rod_ = m.body("coupler", crank, link, **rod(mass=2.0, length=coupler))
        pin = Revolute(at=(coupler, 0.0, 0.0), start=atan2(back.imag, back.real) - along)
        rocker = m.body("rocker", rod_, pin, **rod(mass=0.5, length=-1.0))
        m.cut("pivot", RevoluteCutJoint(at_a=(2.5, 0.0, 0.0), at_b=(-1.0, 0.0, 0.0)), m.ground, rocker)
        m.output("link", rod_.angle())
        return m


@dataclass(frozen=True, kw_only=True)
class Across(Model):
    """Crank and rod of one length: the slider passes the crank's center, where the drive has no lever on it."""

    name = "across"
    length: float
    start: float = 0.3

    def build(self) -> Mechanism:
        r = self.length
        m = Mechanism(gravity=(0.0, -9.81 * r, 0.0))
        crank = m.body("crank", m.ground, Revolute(drive=Polynomial((self.start, 2.0))), **rod(mass=1.0, length=r))
        pin = Revolute(at=(r, 0.0, 0.0), start=-2.0 * self.start)
        link = m.body("rod", crank, pin, **rod(mass=0.5, length=r))
        slider = m.body("slider", m.ground, Translational(axis="x", start=2.0 * r * cos(self.start)), mass=0.8)
        m.cut("pin", RevoluteCutJoint(at_a=(r, 0.0, 0.0)), link, slider)
        m.output("way", slider.coordinate())
        return m


@pytest.mark.parametrize("solver", ["ida", "adams", "hybrid"])
@pytest.mark.parametrize("length", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
def test_a_slider_passes_the_center_of_its_crank(solver: str, length: float, tolerance: float) -> None:
    result = run(Across(length=length), Settings(solver=solver, tolerance=tolerance), np.linspace(0.0, 4.0, 81))
    assert not result.failure
    np.testing.assert_allclose(
        result["way"], 2.0 * length * np.cos(0.3 + 2.0 * result.t), atol=10.0 * tolerance * length
    )


@pytest.mark.parametrize("solver", ["ida", "adams", "hybrid"])
@pytest.mark.parametrize(("longer", "locks"), [(-1e-9, 1.222), (1e-6, 2.793), (1e-2, 2.72)])
def test_a_crank_stops_with_a_message_where_it_locks(solver: str, longer: float, locks: float) -> None:
    """And does not hang."""
    result = run(Driven(longer=longer), Settings(solver=solver), np.linspace(0.0, 4.0, 201))
    assert result.failure
    assert locks - 0.05 < result.t[-1] < locks + 0.001


@pytest.mark.parametrize(("solver", "tolerance"), [("ida", 1e-6), ("adams", 1e-8), ("hybrid", 1e-8)])
def test_where_nothing_is_free_the_balance_is_not_held_against_the_motion(solver: str, tolerance: float) -> None:
    """An exact parallelogram: the coupler stays as it lies."""
    model = Driven(start=0.7)
    result = run(model, Settings(solver=solver, tolerance=tolerance), np.linspace(0.0, 1.0, 51))
    assert not result.failure
    assert not result.warning
    assert np.isnan(result["energy_error"]).all()
    np.testing.assert_allclose(result["link"] + 0.7 + 2.0 * result.t, 0.0, atol=1e-9)

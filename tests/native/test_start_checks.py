"""What Python refuses or reports about a start, native FMUs refuse or report too, if parameters lead there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
from binding import ERROR, OK, WARNING, Binary, Instance
from running import needs_linker

from mbfmu.fmi import export
from mbfmu.mechanics import Mechanism, Revolute, RevoluteCutJoint, Translational, rod
from mbfmu.modeling import Model, parameter
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.sheets.elements import Plate
from mbfmu.util.errors import UserError

pytestmark = needs_linker

ADAMS = Settings(solver="adams")
CORNERS = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 0.0, 1.0), (0.0, 0.0, 1.0)  # m, of a square
SHEET: dict[str, Any] = {"a": 1.0, "b": 1.0, "thickness": 0.01, "youngs_modulus": 1e6}


@dataclass(frozen=True, kw_only=True)
class Raised(Model):
    """A square plate on four posts, one of which is raised."""

    lift: float = parameter(0.01, unit="m", doc="height of a corner")

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, 0.0, 0.0))
        lifts = 0.0, 0.0, self.lift, 0.0
        posts = [
            m.body(f"post{k}", m.ground, Translational(axis="y", at=at, start=lift), mass=1.0)
            for k, (at, lift) in enumerate(zip(CORNERS, lifts, strict=True))
        ]
        m.element(Plate(**SHEET), *posts)
        m.output("y", posts[2].coordinate())
        return m


@dataclass(frozen=True, kw_only=True)
class Bent(Model):
    """A square plate whose edge is turned by a hinge."""

    bend: float = parameter(0.05, unit="rad", doc="angle of the hinges of one edge")

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, 0.0, 0.0))
        angles = 0.0, self.bend, self.bend, 0.0
        hinges = [
            m.body(f"hinge{k}", m.ground, Revolute(axis="z", at=at, start=angle), mass=1.0, inertia=(1.0, 1.0, 1.0))
            for k, (at, angle) in enumerate(zip(CORNERS, angles, strict=True))
        ]
        m.element(Plate(**SHEET), *hinges)
        m.output("angle", hinges[1].angle())
        return m


@dataclass(frozen=True, kw_only=True)
class Flat(Model):
    """A parallelogram that starts flat: with w of the coupler in the ground and b of the rocker, 1 + 2.5 w = b and
    1 + 2.5 w^2 = b^2, so that w is 0 or -4/3.
    """

    coupler_rate: float = parameter(-1.0, unit="rad/s", doc="rate of the coupler on the crank")
    rocker_rate: float = parameter(1.0, unit="rad/s", doc="rate of the rocker")

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        crank = m.body("crank", m.ground, Revolute(start=0.0, rate=1.0), **rod(mass=1.0, length=1.0))
        pin = Revolute(at=(1.0, 0.0, 0.0), start=0.0, rate=self.coupler_rate)
        coupler = m.body("coupler", crank, pin, **rod(mass=1.0, length=2.5))
        pin = Revolute(at=(2.5, 0.0, 0.0), start=0.0, rate=self.rocker_rate)
        rocker = m.body("rocker", m.ground, pin, **rod(mass=1.0, length=1.0))
        m.cut("pin", RevoluteCutJoint(at_a=(2.5, 0.0, 0.0), at_b=(1.0, 0.0, 0.0)), coupler, rocker)
        m.output("angle", rocker.angle())
        return m


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Model, str], Binary]:
    """What opens the native FMU of a model with a solver, once."""

    @cache
    def known(model: Model, solver: str) -> Binary:
        folder = tmp_path_factory.mktemp("fmu")
        return Binary(export(model, folder / "model.fmu", Settings(solver=solver), native=True), folder)

    return known


def code_of(text: str) -> str:
    """Return the code that a message ends in."""
    return text.rpartition("[")[2].rstrip("]")


def begin(fmu: Instance, values: dict[str, float]) -> int:
    """Return how the initialization ends."""
    known = {v.name: v.valueReference for v in fmu.binary.description.modelVariables}
    assert fmu.set("Real", [known[name] for name in values], list(values.values())) == OK
    assert fmu.set_up(0.0) == fmu.call("EnterInitializationMode") == OK
    return fmu.call("ExitInitializationMode")


def check_refused(fmu: Instance, model: Model, solver: str, values: dict[str, float]) -> tuple[str, str]:
    """Return what Python and the FMU say about a start that both refuse."""
    with pytest.raises(UserError) as error:
        Simulation(model.with_values(values), Settings(solver=solver))
    assert begin(fmu, values) == ERROR
    said = fmu.binary.logged[-1][1]
    assert code_of(said) == code_of(str(error.value)) != ""
    assert fmu.call("Reset") == OK
    return str(error.value), said


def test_a_plate_whose_edges_are_too_steep_is_refused(opened: Callable[[Model, str], Binary]):
    """An edge of 1 m to a corner at 3 m rises by arctan(3) = 72 degrees, 1.59 times 45 degrees."""
    fmu = opened(Raised(), "adams").instantiate()
    python, said = check_refused(fmu, Raised(), "adams", {"lift": 3.0})
    assert "differs by 72 degrees" in python
    assert said.startswith("'a plate at post0' is misplaced at the start: its bodies are 1.59")
    for lift in (0.5, 0.99):
        assert begin(fmu, {"lift": lift}) == OK
        assert fmu.step(0.0, 0.01) == OK
        assert fmu.call("Reset") == OK
    fmu.free()


@pytest.mark.parametrize("solver", ["adams", "radau"])
def test_rates_that_belong_to_no_branch_are_refused(opened: Callable[[Model, str], Binary], solver: str):
    fmu = opened(Flat(), solver).instantiate()
    for rates in ((0.0, 0.0), (-0.5, 0.3)):
        values = dict(zip(("coupler_rate", "rocker_rate"), rates, strict=True))
        python, said = check_refused(fmu, Flat(), solver, values)
        assert "the given rates are not those of any branch" in python
        assert "the given rates are not those of any branch" in said
    for rates in ((-1.0, 1.0), (-7.0 / 3.0, -7.0 / 3.0)):
        assert begin(fmu, dict(zip(("coupler_rate", "rocker_rate"), rates, strict=True))) == OK
        assert fmu.step(0.0, 0.01) == OK
        assert fmu.call("Reset") == OK
    fmu.free()


@pytest.mark.parametrize("bend", [0.2, 0.4, 0.7])
def test_a_plate_that_is_bent_too_far_at_the_start_is_reported_there(
    bend: float, opened: Callable[[Model, str], Binary]
):
    """Plates are accurate up to 15 degrees, 0.26 rad, between neighbors."""
    fmu = opened(Bent(), "adams").instantiate()
    fmu.binary.logged.clear()
    assert begin(fmu, {"bend": bend}) == OK
    said = [text for status, text in fmu.binary.logged if status == WARNING and code_of(text) == "coarse-mesh"]
    python = [str(d) for d in Simulation(Bent(bend=bend), ADAMS).diagnostics if d.code == "coarse-mesh"]
    assert len(said) == len(python) == (bend > np.radians(15.0))
    for text in (*said, *python):
        assert f"at t = 0 s: adjacent cells are rotated by up to {np.degrees(bend):.0f} deg" in text
    fmu.free()

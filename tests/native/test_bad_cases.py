"""What may go wrong at the start of a native FMU, or in it: right, or a sentence, and everything as it was."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from math import pi
from pathlib import Path

import numpy as np
import pytest
from binding import DISCARD, ERROR, OK, Binary, Instance
from fmpy import read_model_description
from running import needs_linker

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from fmus.sheet import Sheet
from mbfmu.fmi import export
from mbfmu.mechanics import Mechanism, Revolute, RevoluteCutJoint, rod
from mbfmu.modeling import Model, parameter
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.errors import UserError

pytestmark = needs_linker

ADAMS = Settings(solver="adams")
Opened = Callable[[Model], Binary]


@dataclass(frozen=True, kw_only=True)
class Wheel(Model):
    """A wheel whose axle is twisted against its bearing, until the bearing is closed."""

    twist: float = parameter(0.3, unit="rad", doc="axle against its bearing, as drawn")

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        spun = m.body("spun", m.ground, Revolute(axis="z", start=0.2), **rod(mass=1.0, length=0.5))
        wheel = m.body("wheel", spun, Revolute(axis="x", start=self.twist), mass=1.0, inertia=(0.1, 0.1, 0.2))
        m.cut("bearing", RevoluteCutJoint(), m.ground, wheel)
        m.output("angle", spun.angle())
        return m


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Opened:
    """What opens the native FMU of a model, once."""

    @cache
    def known(model: Model) -> Binary:
        folder = tmp_path_factory.mktemp("fmu")
        return Binary(export(model, folder / "model.fmu", ADAMS, native=True), folder)

    return known


@pytest.fixture
def fmu(opened: Opened) -> Iterator[Instance]:
    """The four-bar."""
    instance = opened(FourBar()).instantiate()
    yield instance
    instance.free()


def references(fmu: Instance) -> dict[str, int]:
    return {v.name: v.valueReference for v in fmu.binary.description.modelVariables}


def outputs(fmu: Instance) -> list[float]:
    described = fmu.binary.description.modelVariables
    wanted = [v.valueReference for v in described if v.causality == "output" and v.type == "Real"]
    status, values = fmu.get("Real", wanted)
    assert status == OK
    return values


def begin(fmu: Instance, start: float = 0.0, **values: float) -> int:
    """Return how the initialization ends."""
    known = references(fmu)
    assert fmu.set("Real", [known[name] for name in values], list(values.values())) == OK
    assert fmu.set_up(start) == fmu.call("EnterInitializationMode") == OK
    return fmu.call("ExitInitializationMode")


def said(fmu: Instance) -> str:
    """Return the last sentence in the log."""
    return fmu.binary.logged[-1][1]


def test_a_loop_that_closes_the_wrong_way_round_is_refused(opened: Opened):
    wheel = opened(Wheel()).instantiate()
    assert begin(wheel, twist=pi - 0.2) == ERROR
    with pytest.raises(UserError) as error:
        Simulation(Wheel(twist=pi - 0.2), ADAMS)
    found, wanted = (text.partition("a wrong orientation") for text in (said(wheel), str(error.value)))
    assert found[0] == wanted[0] == "loop 'bearing' closes with "
    assert "180 deg from each other" in found[2]
    assert "180 deg from each other" in wanted[2]
    assert found[2].partition("; ")[2] == wanted[2].partition("; ")[2]  # what to do
    assert wheel.call("Reset") == OK
    assert begin(wheel, twist=-0.7) == OK
    assert wheel.step(0.0, 0.1) == OK
    wheel.free()


@pytest.mark.parametrize("time", [1e12, -1e15])
def test_a_start_so_late_that_times_are_too_far_apart_is_refused(time: float, fmu: Instance):
    with pytest.raises(UserError, match="the motion changes by more than the tolerance"):
        Simulation(FourBar(), ADAMS, time)
    assert begin(fmu, time) == ERROR
    assert said(fmu).startswith(f"the start time is {time:.9g} s, where the spacing of floating-point numbers")
    assert fmu.call("Reset") == OK
    assert begin(fmu, 1e4) == OK


def test_a_position_too_far_out_for_floating_point_numbers_is_refused(opened: Opened):
    pendulum = opened(SwingPendulum()).instantiate()
    with pytest.raises(UserError, match="Start nearer to zero"):
        Simulation(SwingPendulum(start_angle=1e12), ADAMS)
    assert begin(pendulum, start_angle=1e12) == ERROR
    assert said(pendulum).startswith(
        "a joint coordinate starts at 1e+12, where the spacing of floating-point numbers is too coarse"
    )
    assert pendulum.call("Reset") == OK
    assert begin(pendulum, start_angle=1e3) == OK
    pendulum.free()


def test_a_mechanism_without_mass_is_refused(fmu: Instance):
    masses = dict.fromkeys(("crank_mass", "coupler_mass", "rocker_mass"), 0.0)
    with pytest.raises(UserError) as error:
        Simulation(FourBar(**masses), ADAMS)
    assert begin(fmu, **masses) == ERROR
    assert said(fmu) == str(error.value).removeprefix("model 'fourbar': ")
    assert fmu.call("Reset") == OK
    assert begin(fmu, crank_mass=0.0, rocker_mass=0.0) == OK  # the coupler swings on two ropes
    assert fmu.step(0.0, 0.5) == OK


def test_a_mass_that_is_less_than_nothing_is_refused(fmu: Instance):
    assert fmu.set("Real", [references(fmu)["crank_mass"]], [-1.0]) == ERROR
    assert "'crank_mass' was set to -1; allowed: " in said(fmu)
    assert begin(fmu) == ERROR
    assert "'crank_mass' was set to a value that is not allowed" in said(fmu)


def test_a_start_in_a_singular_position_is_refused_at_rest_and_goes_on_with_a_rate(fmu: Instance):
    with pytest.raises(UserError) as error:
        Simulation(FourBar(start_angle=0.0), ADAMS).outputs()
    assert begin(fmu, start_angle=0.0) == ERROR
    assert said(fmu) == str(error.value).removeprefix("model 'fourbar': ")
    assert fmu.call("Reset") == OK
    simulation = Simulation(FourBar(start_angle=0.0, start_rate=1.0), ADAMS)
    assert begin(fmu, start_angle=0.0, start_rate=1.0) == OK
    for k in range(100):
        assert simulation.advance(0.01 * k + 0.01).ok
        assert fmu.step(0.01 * k, 0.01) == OK
    wanted = simulation.outputs()[:-2]
    np.testing.assert_allclose(outputs(fmu)[:-2], wanted, rtol=1e-4, atol=1e-4 * np.abs(wanted).max())


def test_a_million_seconds_in_one_call_end_where_the_steps_do_and_shorter_ones_go_on(fmu: Instance):
    known = references(fmu)
    assert fmu.set("Integer", [known["max_steps"]], [2000]) == OK
    assert begin(fmu) == OK
    before = outputs(fmu)
    assert fmu.step(0.0, 1e6) == DISCARD
    assert "the maximum number of steps" in said(fmu)
    assert outputs(fmu) == before
    other = fmu.binary.instantiate()
    assert begin(other) == OK
    for k in range(20):
        assert fmu.step(0.01 * k, 0.01) == other.step(0.01 * k, 0.01) == OK
        assert outputs(fmu)[:-2] == outputs(other)[:-2]
    other.free()


def test_states_of_other_formats_and_lengths_are_refused(fmu: Instance):
    assert begin(fmu) == OK
    _, state = fmu.save()
    data = fmu.to_bytes(state)
    for bad in (b"mbfmu15a" + data[8:], data + b"\0", data[:-1], b"\0" * len(data), b"\xff" * len(data)):
        assert fmu.from_bytes(bad)[0] == ERROR
        assert "not one of this FMU" in said(fmu)
    assert fmu.from_bytes(data)[0] == OK
    fmu.release(state)


def test_a_lost_energy_balance_is_reported_with_the_numbers_of_a_simulation(tmp_path: Path):
    """Partitioning by LU is wrong after the singular configuration, and does not stop there at a large tolerance."""
    settings = Settings(solver="adams-lu", tolerance=1e-2)
    four_bar = Binary(export(FourBar(), tmp_path / "model.fmu", settings, native=True), tmp_path).instantiate()
    simulation = Simulation(FourBar(), settings)
    assert begin(four_bar) == OK
    for k in range(20):
        assert four_bar.step(0.1 * k, 0.1) == OK
        assert simulation.advance(0.1 * k + 0.1).ok
        numbers = re.sub(
            r"; the loop closed by .* \(ratio of singular values .*?\)", "", simulation.warning
        )  # known to Python alone
        assert four_bar.get("String", [references(four_bar)["solver.message"]])[1] == [numbers.encode()]
    assert numbers.startswith("the energy error is too large at t = ")
    assert four_bar.step(2.0, 0.0) == OK
    assert four_bar.get("String", [references(four_bar)["solver.message"]])[1] == [numbers.encode()]
    coarse, *others = [text for _, text in four_bar.binary.logged]
    assert "[coarse-tolerance]" in coarse
    assert others == [numbers]  # once
    four_bar.free()


def test_a_step_of_length_zero_clears_the_reason_of_the_last_failure(fmu: Instance):
    assert begin(fmu) == OK
    assert fmu.step(0.0, -0.1) == DISCARD
    message = [references(fmu)["solver.message"]]
    assert b"not negative" in fmu.get("String", message)[1][0]
    assert fmu.step(0.0, 0.0) == OK
    assert fmu.get("String", message)[1] == [b""]


LATER = {  # what else is a constant in native FMUs
    "governor": set(), "pendulum": set(),
    "sheet": {
        "length", "width", "youngs_modulus_cross", "shear_modulus", "held_part", "curl_x", "curl_z",
        "damping", "drag", "pressure",
    },
}  # fmt: skip


@pytest.mark.parametrize("model", [Governor(), SwingPendulum(), Sheet(nx=5, nz=4)], ids=lambda model: model.name)
def test_variables_are_those_of_the_fmu_that_calls_python(model: Model, opened: Opened, tmp_path: Path):
    other = read_model_description(str(export(model, tmp_path / "model.fmu", ADAMS, native=False)))
    native = {v.name: v for v in opened(model).description.modelVariables}
    assert [name for name in native if "state." not in name] == [v.name for v in other.modelVariables]
    structural = {p.name for p in model.parameters() if p.structural}
    constant = {"solver", "input_interpolation", "start_at_equilibrium"} | structural | LATER[model.name]
    for v in other.modelVariables:
        mine = native[v.name]
        assert (mine.valueReference, mine.type, mine.unit, mine.start) == (v.valueReference, v.type, v.unit, v.start)
        assert mine.description.partition("; constant in this FMU: ")[0] == v.description
        assert mine.causality == ("local" if v.name in constant else v.causality), v.name


def pendulum(length: float) -> type[Model]:
    """Return a model that has its name and its parameters in common with others of this function."""

    @dataclass(frozen=True, kw_only=True)
    class Pendulum(Model):
        """A rod on a hinge."""

        mass: float = parameter(1.0, unit="kg", min=1e-3)

        def build(self) -> Mechanism:
            m = Mechanism(gravity=(0.0, -9.81, 0.0))
            bar = m.body("bar", m.ground, Revolute(start=0.3), **rod(mass=self.mass, length=length))
            m.output("angle", bar.angle())
            return m

    return Pendulum


def test_a_model_that_was_changed_makes_another_fmu_which_refuses_old_states(opened: Opened):
    old, new = (opened(pendulum(length)()) for length in (1.0, 2.0))
    assert old.description.guid != new.description.guid
    first, second = old.instantiate(), new.instantiate()
    assert begin(first) == begin(second) == OK
    _, state = first.save()
    assert second.from_bytes(first.to_bytes(state))[0] == ERROR
    assert second.restore(state) == ERROR
    first.release(state)
    first.free()
    second.free()

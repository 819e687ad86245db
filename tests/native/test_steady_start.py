"""A native FMU that starts in a steady state, for the inputs as they are set before the end of the initialization."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import nan
from pathlib import Path

import pytest
from binding import ERROR, OK, Binary, Instance
from running import needs_linker

from fmus.governor import Governor
from mbfmu.fmi import Fmu, export
from mbfmu.mechanics import Input, JointForce, JointSpring, Mechanism, Revolute, Translational
from mbfmu.modeling import Model, parameter
from mbfmu.session.simulation import Settings
from mbfmu.steady.equilibrium import equilibrium

pytestmark = needs_linker

STEADY = Settings(solver="adams", start_at_equilibrium=True)
TOLERANCE = 1e-6  # of the settings
Opened = Callable[[Model], Binary]


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Opened:
    """What opens the native FMU of a model, once."""

    @cache
    def known(model: Model) -> Binary:
        folder = tmp_path_factory.mktemp("fmu")
        return Binary(export(model, folder / "model.fmu", STEADY, native=True), folder)

    return known


def started(binary: Binary, values: dict[str, float], start: float = 0.0) -> tuple[int, Instance]:
    """How the initialization ends with these inputs, and the instance."""
    binary.logged.clear()
    fmu = binary.instantiate()
    known = {v.name: v.valueReference for v in binary.description.modelVariables}
    assert fmu.set_up(start) == fmu.call("EnterInitializationMode") == OK
    assert fmu.set("Real", [known[name] for name in values], list(values.values())) == OK
    return fmu.call("ExitInitializationMode"), fmu


def height(fmu: Instance) -> float:
    (reference,) = (v.valueReference for v in fmu.binary.description.modelVariables if v.name == "collar.height")
    status, (value,) = fmu.get("Real", [reference])
    return float(value) if status == OK else nan


@pytest.mark.parametrize("start", [0.0, 100.0])
@pytest.mark.parametrize(
    ("model", "values"),
    [
        (Governor(), {"spindle.drive": 10.0}),
        (Governor(), {"spindle.drive": 11.0174 * (1.0 + 100.0 * TOLERANCE)}),
        (Governor(spindle_speed=14.0, ball_mass=0.5), {"spindle.drive": -14.0}),
    ],
)
def test_the_steady_state_of_another_input_is_found(
    model: Governor, values: dict[str, float], start: float, opened: Opened
) -> None:
    status, fmu = started(opened(model), values, start)
    wanted = equilibrium(model.with_values({"spindle_speed": values["spindle.drive"]})).outputs["collar.height"]
    assert status == OK
    for k in range(3):
        assert height(fmu) == pytest.approx(wanted, rel=1e-5 if k else 1e-9)
        assert fmu.step(start + 0.1 * k, 0.1) == OK
    fmu.free()


def test_a_torque_on_a_free_spindle_has_no_steady_state(opened: Opened) -> None:
    status, fmu = started(opened(Governor(driven=False)), {"spindle.torque": 5.0})
    assert status == ERROR
    said = fmu.binary.logged[-1][1]
    assert said.startswith("no steady state was found for the values that are set: at the end of the search 'spindle'")
    assert fmu.call("Reset") == OK  # and as it is exported it starts
    assert fmu.set_up() == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
    assert fmu.step(0.0, 0.01) == OK
    fmu.free()


@dataclass(frozen=True, kw_only=True)
class Seat(Model):
    """A mass on a spring, on a floor whose height is an input."""

    mass: float = parameter(2.0, unit="kg", min=0.1)

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        floor = m.body("floor", m.ground, Translational(axis="y", drive=Input(name="floor.height", unit="m")))
        seat = m.body("seat", floor, Translational(axis="y", start=0.1), mass=self.mass)
        m.force("spring", JointSpring(stiffness=500.0, damping=10.0), seat)
        m.output("travel", seat.coordinate())
        return m


def test_a_support_must_start_where_it_is_at_the_export(opened: Opened) -> None:
    """A steady state may have to be followed while supports move."""
    status, fmu = started(opened(Seat()), {"floor.height": 0.2})
    assert status == ERROR
    said = fmu.binary.logged[-1][1]
    assert said.startswith("'floor.height' was set to 0.2 before the end of the initialization, but the steady state")
    assert "was computed at the export for 0. Set it after the initialization" in said
    assert fmu.call("Reset") == OK
    assert fmu.set_up() == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
    assert fmu.step(0.0, 0.01) == OK
    fmu.free()


def test_a_mass_on_a_spring_is_pressed_by_its_weight(opened: Opened) -> None:
    status, fmu = started(opened(Seat()), {"mass": 3.1})
    known = {v.name: v.valueReference for v in fmu.binary.description.modelVariables}
    assert status == OK
    assert fmu.get("Real", [known["travel"]])[1][0] == pytest.approx(-3.1 * 9.81 / 500.0, rel=1e-12)
    fmu.free()


@dataclass(frozen=True, kw_only=True)
class Winder(Model):
    """A disk on a torsion spring, turned by a moment."""

    name = "winder"

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, 0.0, 0.0))
        disk = m.body("disk", m.ground, Revolute(axis=(0.0, 0.0, 1.0)), mass=1.0, inertia=(0.1, 0.1, 0.1))
        m.force("spring", JointSpring(stiffness=10.0, damping=0.1), disk)
        m.force("moment", JointForce(Input(name="moment", unit="N.m")), disk)
        m.output("angle", disk.angle())
        return m


def test_a_steady_state_far_from_the_start_is_refused_with_the_distance(opened: Opened) -> None:
    """The angle is moment / 10 N m. From 3.2 rad on, another steady state may be the intended one."""
    status, fmu = started(opened(Winder()), {"moment": 30.0})
    known = {v.name: v.valueReference for v in fmu.binary.description.modelVariables}
    assert status == OK
    assert fmu.get("Real", [known["angle"]])[1][0] == pytest.approx(3.0, rel=1e-12)
    fmu.free()
    status, fmu = started(opened(Winder()), {"moment": 40.0})
    assert status == ERROR
    said = fmu.binary.logged[-1][1]
    assert said.startswith("no steady state was found near the start: in the one that the search reaches, 'disk")
    assert "is 4 rad or m from its start position; allowed: 3.2 rad, or this number of lengths of the" in said
    fmu.free()


@pytest.mark.parametrize("start", [0.0, 100.0])
def test_the_input_of_the_steady_state_is_taken_to_the_tolerance(start: float, opened: Opened) -> None:
    wanted = equilibrium(Governor()).outputs["collar.height"]
    for speed in (11.0174, 11.0174 * (1.0 + 0.1 * TOLERANCE)):
        status, fmu = started(opened(Governor()), {"spindle.drive": speed}, start)
        assert status == OK
        for k in range(3):
            assert height(fmu) == pytest.approx(wanted, rel=1e-5)
            assert fmu.step(start + 0.1 * k, 0.1) == OK
        assert not fmu.binary.logged
        fmu.free()


def test_a_value_that_is_set_again_counts(opened: Opened) -> None:
    binary = opened(Governor())
    known = {v.name: v.valueReference for v in binary.description.modelVariables}
    fmu = binary.instantiate()
    assert fmu.set_up() == fmu.call("EnterInitializationMode") == OK
    for speed in (10.0, 11.0174):
        assert fmu.set("Real", [known["spindle.drive"]], [speed]) == OK
        wanted = equilibrium(Governor(spindle_speed=speed)).outputs["collar.height"]
        assert fmu.get("Real", [known["collar.height"]])[1][0] == pytest.approx(wanted, rel=1e-9)
    assert fmu.call("ExitInitializationMode") == OK
    assert fmu.set("Real", [known["spindle.drive"]], [10.0]) == OK  # from now on it is a change
    assert fmu.step(0.0, 0.1) == OK
    fmu.free()


def test_a_host_gets_the_start_of_the_fmu_that_calls_python(tmp_path: Path) -> None:
    values = {"spindle.drive": 10.0, "stiffness": 900.0}
    found = []
    for native in (True, False):
        with Fmu(export(Governor(), tmp_path / f"{native}.fmu", STEADY, native=native), values) as fmu:
            found.append(fmu["collar.height"])
    assert found[0] == pytest.approx(found[1], rel=1e-9)


def test_what_else_the_export_decides_cannot_be_set(opened: Opened) -> None:
    described = {v.name: v for v in opened(Governor()).description.modelVariables}
    constants = {name for name, v in described.items() if v.variability == "constant"}
    assert constants == {"driven", "solver", "input_interpolation", "start_at_equilibrium"}

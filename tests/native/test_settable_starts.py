"""Parameters of native FMUs that act on the start: it is that of a model that is built with the values."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import cos, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from binding import ERROR, OK, Binary, Instance
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from quarter_car import QuarterCar
from running import needs_linker
from scipy.optimize import brentq

from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from mbfmu.fmi import export
from mbfmu.modeling import Model
from mbfmu.session.simulation import Settings, Simulation

pytestmark = needs_linker

Opened = Callable[[Model, bool], Binary]
RANDOM_STARTS = 12


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Opened:
    """What opens the native FMU of a model that starts in a steady state, or with closed loops only."""

    @cache
    def known(model: Model, steady: bool) -> Binary:
        folder = tmp_path_factory.mktemp("fmu")
        return Binary(export(model, folder / "model.fmu", settings_of(steady), native=True), folder)

    return known


def settings_of(steady: bool) -> Settings:
    return Settings(solver="adams", tolerance=1e-11, start_at_equilibrium=steady)


def started(binary: Binary, values: dict[str, Any]) -> tuple[int, Instance]:
    """Return the status of the end of the initialization with these values, and the instance."""
    fmu, known = binary.instantiate(), {v.name: v for v in binary.description.modelVariables}
    assert fmu.set_up() == fmu.call("EnterInitializationMode") == OK
    for name, value in values.items():
        assert fmu.set(known[name].type, [known[name].valueReference], [value]) == OK
    return fmu.call("ExitInitializationMode"), fmu


def outputs(fmu: Instance, names: list[str]) -> np.ndarray:
    known = {v.name: v.valueReference for v in fmu.binary.description.modelVariables}
    status, values = fmu.get("Real", [known[name] for name in names])
    assert status == OK
    return np.array(values)


def settable(binary: Binary, model: Model) -> list[str]:
    described = {v.name: v for v in binary.description.modelVariables}
    return [p.name for p in model.parameters() if described[p.name].causality == "parameter"]


def governor_height(model: Governor) -> float:
    """Return the height of the collar at the steady state, from the potential in the rotating frame.

    One angle phi of the arms below the horizontal; the speed of the spindle is constant.
    """
    g, L, half = model, model.rod_length, model.rod_position

    def fall(phi: float) -> float:  # of the collar below the pivot, m
        return half * sin(phi) + sqrt(L**2 - (half * cos(phi)) ** 2)

    def slope(phi: float) -> float:
        s = fall(phi)
        ds = half * cos(phi) + half**2 * cos(phi) * sin(phi) / sqrt(L**2 - (half * cos(phi)) ** 2)
        spring = g.stiffness * (s - g.free_length) * ds
        spin = 2.0 * g.ball_mass * (g.spindle_speed * g.arm_length) ** 2 * cos(phi) * sin(phi)
        weight = -g.gravity * (2.0 * g.ball_mass * g.arm_length * cos(phi) + g.collar_mass * ds)
        return spring + spin + weight

    phi = brentq(slope, 0.02, 1.45, xtol=1e-15, rtol=1e-15)
    return float(g.pivot_height - fall(phi))


def test_the_steady_state_for_other_parameters_is_that_of_the_potential(opened: Opened) -> None:
    model, random = Governor(), np.random.default_rng(4)
    binary = opened(model, True)
    for _ in range(RANDOM_STARTS):
        names = ("stiffness", "ball_mass", "collar_mass", "spindle_speed", "gravity", "free_length")
        values = {n: float(getattr(model, n) * random.uniform(0.95, 1.05)) for n in names}
        status, fmu = started(binary, values)
        assert status == OK
        assert outputs(fmu, ["collar.height"])[0] == pytest.approx(governor_height(model.with_values(values)), rel=1e-9)
        fmu.free()


@pytest.mark.parametrize(
    ("model", "steady"),
    [
        (Governor(), True),
        (SwingPendulum(), False),
        pytest.param(Governor(driven=False), True, marks=pytest.mark.campaign),
        pytest.param(Governor(), False, marks=pytest.mark.campaign),
    ],
)
def test_random_parameters_give_the_motion_of_a_model_built_with_them(
    model: Model, steady: bool, opened: Opened
) -> None:
    binary, random = opened(model, steady), np.random.default_rng(8)
    described = {v.name: v for v in binary.description.modelVariables}
    names = settable(binary, model)
    assert len(names) >= 13
    wanted_names = [v.name for v in model.compile().outputs]
    for _ in range(RANDOM_STARTS):
        values = {}
        for n in names:
            value, v = getattr(model, n), described[n]
            low, high = (float(x) if x is not None else s * np.inf for x, s in ((v.min, -1), (v.max, 1)))
            values[n] = float(
                np.clip(value * random.uniform(0.9, 1.1) if value else 0.02 * random.uniform(), low, high)
            )
        status, fmu = started(binary, values)
        simulation = Simulation(model.with_values(values), settings_of(steady))
        places = [[v.name for v in simulation.variables].index(n) for n in wanted_names]
        assert status == OK, binary.logged[-1]
        for k in range(3):
            wanted = np.asarray(simulation.outputs())[places]
            scale = np.maximum(np.abs(wanted), 1e-3 * np.abs(wanted).max())
            assert np.abs((outputs(fmu, wanted_names) - wanted) / scale).max() < 1e-9
            assert fmu.step(0.02 * k, 0.02) == OK
            simulation.advance(0.02 * (k + 1))
        fmu.free()


@pytest.mark.parametrize(
    "factors",
    [
        (1.04, 1.223, 1.371, 1.123, 1.154, 1.355, 0.893, 0.456, 0.868),
        (0.993, 0.924, 0.632, 0.995, 0.996, 0.484, 0.901, 1.118, 1.048),
    ],
)
def test_a_search_from_a_start_without_contact_is_refused_and_does_not_end_in_one_of_many_states(
    factors: tuple[float, ...], opened: Opened
) -> None:
    """The tire of the quarter car does not touch the road at the start: Newton's method alone finds nothing."""
    model, binary = QuarterCar(), opened(QuarterCar(), True)
    names = [p.name for p in model.parameters()]
    values = {n: float(getattr(model, n) * factor) for n, factor in zip(names, factors, strict=True)}
    status, fmu = started(binary, values)
    assert status == ERROR
    assert binary.logged[-1][1].startswith("no steady state was found for the values that are set: at the end of")
    fmu.free()


def test_without_changes_the_start_is_that_of_the_export_to_the_last_bit(opened: Opened) -> None:
    model, binary = Governor(), opened(Governor(), True)
    simulation, names = Simulation(model, settings_of(True)), [v.name for v in model.compile().outputs]
    status, fmu = started(binary, {"stiffness": model.stiffness, "spindle.drive": model.spindle_speed})
    assert status == OK
    places = [[v.name for v in simulation.variables].index(n) for n in names]
    assert outputs(fmu, names).tolist() == np.asarray(simulation.outputs())[places].tolist()
    fmu.free()


def test_a_steady_state_that_does_not_exist_is_an_error_that_names_a_coordinate(opened: Opened) -> None:
    """With gravity in its plane the forces on the driven pendulum depend on the angle of the crank."""
    binary = opened(SwingPendulum(), True)
    status, fmu = started(binary, {"gravity": -9.81})
    assert status == ERROR
    said = binary.logged[-1][1]
    assert said.startswith("there is no steady state for the values that are set: after the drives have moved, '")
    assert "has an unbalanced force or moment of " in said
    assert "export the FMU again with the values that are set [no-steady-state]" in said
    assert fmu.call("Reset") == OK
    assert fmu.set_up() == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
    fmu.free()


def test_a_reset_takes_back_parameters(opened: Opened, tmp_path: Path) -> None:
    binary = opened(Governor(), True)
    names = [v.name for v in Governor().compile().outputs]
    _, fresh = started(binary, {})
    _, fmu = started(binary, {"stiffness": 900.0, "tolerance": 1e-5, "spindle.drive": 11.2})
    assert fmu.step(0.0, 0.1) == OK
    assert fmu.call("Reset") == OK
    known = {v.name: v for v in binary.description.modelVariables}
    for name in ("stiffness", "tolerance", "spindle.drive"):
        assert fmu.get("Real", [known[name].valueReference])[1] == [float(known[name].start)]
    assert fmu.set_up() == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
    for k in range(3):
        assert fmu.step(0.1 * k, 0.1) == fresh.step(0.1 * k, 0.1) == OK
        assert outputs(fmu, names).tolist() == outputs(fresh, names).tolist()
    fmu.free()
    fresh.free()


@pytest.mark.parametrize("fmi", [2, 3])
def test_fmpy_resets_all_values(fmi: int, tmp_path: Path) -> None:
    path = export(Governor(), tmp_path / "model.fmu", settings_of(True), native=True, fmi=fmi)
    description, folder = read_model_description(str(path)), extract(str(path), str(tmp_path / "fmu"))
    known = {v.name: v for v in description.modelVariables}
    kind = FMU2Slave if fmi == 2 else FMU3Slave
    place = {"unzipDirectory": folder, "modelIdentifier": description.coSimulation.modelIdentifier}
    fmu = kind(guid=description.guid, instanceName="one", **place)
    get, set_to = (fmu.getReal, fmu.setReal) if fmi == 2 else (fmu.getFloat64, fmu.setFloat64)

    def begin(values: dict[str, float]) -> list[float]:
        if fmi == 2:
            fmu.setupExperiment(startTime=0.0)
        fmu.enterInitializationMode()
        for name, value in values.items():
            set_to([known[name].valueReference], [value])
        fmu.exitInitializationMode()
        found = [get([known["collar.height"].valueReference])[0]]
        for k in range(3):
            fmu.doStep(0.1 * k, 0.1)
            found.append(get([known["collar.height"].valueReference])[0])
        return found

    fmu.instantiate()
    first = begin({})
    fmu.reset()
    changed = begin({"stiffness": 900.0, "tolerance": 1e-5, "spindle.drive": 11.2})
    assert changed[0] != first[0]
    fmu.reset()
    for name in ("stiffness", "tolerance", "spindle.drive"):
        assert get([known[name].valueReference])[0] == float(known[name].start)
    assert begin({}) == first
    fmu.terminate()
    fmu.freeInstance()

"""Derivatives of inputs in co-simulation of FMI 2.0: ramps over communication steps are exact."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import c_double, c_int, c_size_t, c_uint
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from binding import DISCARD, ERROR, OK, Binary, Instance
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu
from input_ramps import KINDS, Ramps, exact
from running import needs_linker, pair

import mbfmu as mb
from mbfmu.fmi import export
from mbfmu.modeling import Model
from mbfmu.session.simulation import Settings
from solvers.outcome import OK as REACHED

RATE = 3.0  # of the input per second
SOLVERS = ("adams", "radau", "ida")
OUTPUTS = ("x", "v", "base.x", "base.v")

pytestmark = needs_linker


class Weighed(Model):
    """A mass under a gravity that is an input."""

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0.0, mb.Input(name="g", unit="m/s2", start=-9.81), 0.0))
        m.body("mass", m.ground, mb.Translational(axis="y"), mass=1.0)
        return m


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Return the native FMU of a model with a solver; each is written once."""
    found: dict[Any, Path] = {}

    def write(kind: str, solver: str = "adams", **settings: Any) -> Path:
        key = kind, solver, *settings.items()
        if key not in found:
            path = tmp_path_factory.mktemp("fmu") / "ramps.fmu"
            given = Settings(solver=solver, tolerance=1e-9, **settings)
            found[key] = export(Ramps(kind=kind), path, given, native=True)
        return found[key]

    return write


@pytest.fixture
def instance(exported: Callable[..., Path], tmp_path: Path) -> Callable[..., Instance]:
    """Return a started instance of an FMU."""

    def start(kind: str, folder: str = "fmu", **settings: Any) -> Instance:
        own = Binary(exported(kind, **settings), tmp_path / folder).instantiate()
        assert own.set_up() == OK
        assert own.call("EnterInitializationMode") == OK
        assert own.call("ExitInitializationMode") == OK
        return own

    return start


def reference(fmu: Instance, name: str) -> int:
    return next(int(v.valueReference) for v in fmu.binary.description.modelVariables if v.name == name)


def derive(fmu: Instance, rate: float, name: str = "u", order: int = 1) -> int:
    """fmi2SetRealInputDerivatives."""
    given = (c_uint * 1)(reference(fmu, name)), c_size_t(1), (c_int * 1)(order), (c_double * 1)(rate)
    return fmu.call("SetRealInputDerivatives", *given)


def put(fmu: Instance, value: float, rate: float | None = None) -> None:
    assert fmu.set("Real", [reference(fmu, "u")], [value]) == OK
    assert rate is None or derive(fmu, rate) == OK


def read(fmu: Instance) -> list[float]:
    status, values = fmu.get("Real", [reference(fmu, name) for name in OUTPUTS])
    assert status == OK
    return values


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_ramp_is_exact_in_fmpy(exported: Callable[..., Path], tmp_path: Path, kind: str, solver: str) -> None:
    """In communication steps of 0.1 s; without derivatives the error is that of an input that is late."""
    path = exported(kind, solver)
    assert validate_fmu(str(path)) == []
    described = read_model_description(str(path))
    assert described.coSimulation.canInterpolateInputs
    slave = FMU2Slave(
        guid=described.guid,
        unzipDirectory=extract(str(path), str(tmp_path / "fmu")),
        modelIdentifier=described.coSimulation.modelIdentifier,
    )
    known = {v.name: v.valueReference for v in described.modelVariables}
    slave.instantiate()
    errors = []
    for gives_rates in (True, False):
        slave.setupExperiment()
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        found = []
        for k in range(10):
            slave.setReal([known["u"]], [0.1 * k * RATE])
            if gives_rates:
                slave.setRealInputDerivatives([known["u"]], [1], [RATE])
            slave.doStep(0.1 * k, 0.1)
            found.append(slave.getReal([known[name] for name in OUTPUTS]))
        slave.reset()
        wanted = exact(kind, 0.1 * np.arange(1.0, 11.0), RATE)
        errors.append(float(np.abs(np.transpose(found) - [wanted[name] for name in OUTPUTS]).max()))
    slave.freeInstance()
    assert errors[0] < 3e-7
    assert errors[1] > 1e-3


@pytest.mark.parametrize("interpolation", ["hold", "linear"])
@pytest.mark.parametrize("solver", ["adams", "radau"])
@pytest.mark.parametrize("kind", KINDS)
def test_native_and_python_agree_bit_for_bit(kind: str, solver: str, interpolation: str) -> None:
    settings = Settings(solver=solver, input_interpolation=interpolation)
    simulation, native = pair(partial(Ramps, kind=kind), settings)
    given = ((0.0, RATE), (0.3, RATE), None, (0.9, None), (1.0, -RATE), (0.0, 0.0), None)
    for k, own in enumerate(given):
        if own is not None:
            value, rate = own
            simulation.set_input("u", value, rate)
            assert native.call("set", 0, value, np.nan if rate is None else rate) == REACHED
        end = 0.1 * (k + 1)
        assert simulation.advance(end).ok
        assert native.call("step", end) == REACHED
        assert native.call("read") == REACHED
        np.testing.assert_array_equal(native.out, simulation.outputs())


def test_the_order_of_the_calls_does_not_matter(instance: Callable[..., Instance]) -> None:
    """Value and derivative, with outputs that are read between them, or the derivative alone."""
    results = []
    for way in ("value first", "derivative first", "read between", "derivative alone"):
        fmu = instance("force", way)
        if way == "value first":
            put(fmu, 0.0, RATE)
        else:
            assert derive(fmu, RATE) == OK
            if way == "read between":
                read(fmu)
            if way != "derivative alone":
                put(fmu, 0.0)
        assert fmu.step(0.0, 0.5) == OK
        results.append(read(fmu))
        fmu.free()
    wanted = exact("force", 0.5, RATE)
    np.testing.assert_allclose(results, [[wanted[name] for name in OUTPUTS]] * 4, rtol=0.0, atol=1e-8)


def test_a_value_alone_is_held_and_none_continues(instance: Callable[..., Instance]) -> None:
    fmu = instance("speed")
    put(fmu, 0.0, RATE)
    assert fmu.step(0.0, 0.1) == OK
    assert fmu.step(0.1, 0.1) == OK
    assert read(fmu)[3] == pytest.approx(0.2 * RATE, abs=1e-14)
    put(fmu, 0.2 * RATE)
    assert fmu.step(0.2, 0.1) == OK
    assert read(fmu)[3] == pytest.approx(0.2 * RATE, abs=1e-14)
    fmu.free()


def test_a_rate_of_the_initialization_is_that_of_the_first_step(exported: Callable[..., Path], tmp_path: Path) -> None:
    fmu = Binary(exported("force"), tmp_path).instantiate()
    assert fmu.set_up() == OK
    assert fmu.call("EnterInitializationMode") == OK
    put(fmu, 1.0, RATE)
    read(fmu)
    assert fmu.call("ExitInitializationMode") == OK
    assert fmu.step(0.0, 0.5) == OK
    wanted = exact("force", 0.5, RATE, 1.0)
    np.testing.assert_allclose(read(fmu), [wanted[name] for name in OUTPUTS], rtol=0.0, atol=1e-8)
    fmu.free()


def test_a_state_has_a_rate_that_is_about_to_act(instance: Callable[..., Instance]) -> None:
    fmu = instance("force")
    put(fmu, 0.0, RATE)
    assert fmu.step(0.0, 0.1) == OK
    put(fmu, 1.0, -RATE)
    status, state = fmu.save()
    assert status == OK
    first = []
    for _ in range(2):
        assert fmu.step(0.1, 0.2) == OK
        first.append(read(fmu))
        put(fmu, 7.0, 5.0)
        assert fmu.restore(state) == OK
    assert first[0] == first[1]
    content = fmu.to_bytes(state)
    other = instance("force", "other")
    status, again = other.from_bytes(content)
    assert status == OK
    assert other.restore(again) == OK
    assert other.step(0.1, 0.2) == OK
    assert read(other) == first[0]
    for own, held in ((fmu, state), (other, again)):
        own.release(held)
        own.free()


def test_a_step_that_is_discarded_keeps_the_rate(instance: Callable[..., Instance]) -> None:
    """One from a wrong time; the next one begins with it."""
    fmu = instance("force")
    put(fmu, 0.0, RATE)
    assert fmu.step(0.3, 0.1) == DISCARD
    assert fmu.step(0.0, 0.5) == OK
    assert read(fmu)[1] == pytest.approx(exact("force", 0.5, RATE)["v"], abs=1e-8)
    fmu.free()


def test_what_is_refused(instance: Callable[..., Instance]) -> None:
    fmu = instance("force")
    logged = fmu.binary.logged
    assert derive(fmu, RATE, order=2) == ERROR
    assert logged[-1][1].startswith(
        "fmi2SetRealInputDerivatives was called for derivative 2 of 'u'; allowed: derivative 1"
    )
    assert derive(fmu, RATE, name="x") == ERROR
    assert logged[-1][1].startswith("fmi2SetRealInputDerivatives was called for 'x'; allowed: inputs")
    assert derive(fmu, float("inf")) == ERROR
    assert "the derivative of 'u' was set to inf; allowed: a finite number" in logged[-1][1]
    assert fmu.step(0.0, 0.1) == DISCARD
    put(fmu, 0.0, RATE)
    assert fmu.step(0.0, 0.1) == OK
    null = ctypes.c_void_p()
    assert fmu.call("SetRealInputDerivatives", null, c_size_t(1), null, null) == ERROR
    assert fmu.call("SetRealInputDerivatives", null, c_size_t(0), null, null) == OK
    fmu.free()


def test_other_inputs_take_no_derivative(tmp_path: Path) -> None:
    path = export(Weighed(), tmp_path / "weighed.fmu", Settings(solver="adams"), native=True)
    assert not read_model_description(str(path)).coSimulation.canInterpolateInputs
    fmu = Binary(path, tmp_path).instantiate()
    assert derive(fmu, 1.0, name="g") == ERROR
    assert "fmi2SetRealInputDerivatives is not supported" in fmu.binary.logged[-1][1]
    fmu.free()

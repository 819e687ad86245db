"""Warnings of native FMUs are those of the same run in Python, and there is none where Python gives none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from binding import OK, WARNING, Binary
from mechanisms import parallelogram
from running import needs_linker
from scipy.integrate import solve_ivp

from fmus.fourbar import FourBar
from mbfmu.fmi import export
from mbfmu.mechanics import (
    Harmonic,
    Input,
    Mechanism,
    Polynomial,
    Revolute,
    RevoluteCutJoint,
    Translational,
    rod,
)
from mbfmu.modeling import Model, parameter
from mbfmu.session.run import run
from mbfmu.session.simulation import Settings, Simulation

pytestmark = needs_linker

TIMES = np.linspace(0.0, 5.0, 101)
G = 9.81


@dataclass(frozen=True, kw_only=True)
class Upright(Model):
    """A rod of 1 kg and 1 m that swings over its highest position, and starts above it."""

    rate: float = parameter(0.5, unit="rad/s")

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -G, 0.0))
        hinge = Revolute(start=0.5 * np.pi, rate=self.rate, fixed=True)
        m.output("angle", m.body("rod", m.ground, hinge, **rod(mass=1.0, length=1.0)).angle())
        return m


@dataclass(frozen=True, kw_only=True)
class Driven(Model):
    """A driven rod: nothing is integrated."""

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -G, 0.0))
        drive = Harmonic(amplitude=1.0, frequency=1.0)
        m.output("angle", m.body("rod", m.ground, Revolute(drive=drive), **rod(mass=1.0, length=1.0)).angle())
        return m


def error_of(rate: float, angle: Any) -> float:
    """Largest error of an angle, rad, by SciPy."""
    exact = solve_ivp(
        lambda _, y: [y[1], -1.5 * G * np.cos(y[0])], (0.0, TIMES[-1]), [0.5 * np.pi, rate], "DOP853", t_eval=TIMES,
        rtol=1e-12, atol=1e-12,
    ).y[0]  # fmt: skip
    return float(np.abs(angle - exact).max())


def code_of(text: str) -> str:
    return text.rpartition("[")[2].rstrip("]")


def logged(model: Model, settings: Settings, folder: Path) -> list[str]:
    """The warnings that a native FMU logs in a run."""
    binary = Binary(export(model, folder / "model.fmu", settings, native=True), folder)
    fmu = binary.instantiate()
    assert fmu.set_up() == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
    for begin, end in pairwise(TIMES):
        assert fmu.step(begin, end - begin) == OK
    fmu.free()
    return [text for status, text in binary.logged if status == WARNING]


@pytest.mark.parametrize(
    ("solver", "rate", "tolerance", "passes_inaccurately"),
    [
        ("adams", 0.5, 1e-2, True),
        ("hybrid", 1.0, 1e-3, True),
        ("radau", 0.5, 1e-3, True),
        ("radau", 4.0, 1e-3, False),
        ("adams", 4.0, 3e-3, False),
        ("hybrid", 4.0, 1e-3, False),
        ("radau", 0.5, 1e-6, False),
    ],
)
def test_a_slow_passage_is_logged_as_in_python(
    solver: str, rate: float, tolerance: float, passes_inaccurately: bool, tmp_path: Path
) -> None:
    model, settings = Upright(rate=rate), Settings(solver=solver, tolerance=tolerance)
    result = run(model, settings, TIMES)
    said = logged(model, settings, tmp_path)
    assert [code_of(text) for text in said if "energy" in text] == [d.code for d in result.problems]
    assert ("slow-passage" in map(code_of, said)) == passes_inaccurately
    assert error_of(rate, result["angle"]) > 0.2 if passes_inaccurately else error_of(rate, result["angle"]) < 0.2
    if result.warning:
        assert result.warning in said


@pytest.mark.parametrize(
    ("model", "tolerance"), [(Upright(), 1e-2), (Upright(), 1e-3), (Upright(), 9e-4), (Driven(), 1e-2)]
)
def test_a_coarse_tolerance_is_logged_as_in_python(model: Model, tolerance: float, tmp_path: Path) -> None:
    settings = Settings(solver="radau", tolerance=tolerance)
    remarks = [str(d) for d in run(model, settings, TIMES).diagnostics if d.code == "coarse-tolerance"]
    said = logged(model, settings, tmp_path)
    assert [text for text in said if code_of(text) == "coarse-tolerance"] == remarks
    assert len(remarks) == (isinstance(model, Upright) and tolerance >= 1e-3)


@dataclass(frozen=True, kw_only=True)
class NearMiss(Model):
    """A four-bar that misses its singular configuration by less than a solver can resolve."""

    def build(self) -> Mechanism:
        return parallelogram(1e-9).mechanism


@dataclass(frozen=True, kw_only=True)
class Lifted(Model):
    """A parallelogram that a drive takes through its singular configuration at 0.6 s; all pins are loaded."""

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -G, 0.0))
        crank = m.body("crank", m.ground, Revolute(drive=Polynomial((-0.6, 1.0))), **rod(mass=1.0, length=1.0))
        coupler = m.body("coupler", crank, Revolute(at=(1.0, 0.0, 0.0), start=0.6), **rod(mass=2.0, length=3.0))
        rocker = m.body("rocker", m.ground, Revolute(at=(3.0, 0.0, 0.0), start=-0.6), **rod(mass=1.5, length=1.0))
        pin = m.cut("pin", RevoluteCutJoint(at_a=(3.0, 0.0, 0.0), at_b=(1.0, 0.0, 0.0)), coupler, rocker)
        m.output("pin", pin.joint_force("x"))
        return m


@dataclass(frozen=True, kw_only=True)
class Flat(Model):
    """A parallelogram that starts flat, of whose three rates two are given."""

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -G, 0.0))
        crank = m.body("crank", m.ground, Revolute(start=0.0, rate=1.0, fixed=True), **rod(mass=1.0, length=1.0))
        pin = Revolute(at=(1.0, 0.0, 0.0), start=0.0, rate=-1.0)
        coupler = m.body("coupler", crank, pin, **rod(mass=1.0, length=2.5))
        rocker = m.body("rocker", m.ground, Revolute(at=(2.5, 0.0, 0.0), start=0.0), **rod(mass=1.0, length=1.0))
        m.cut("pin", RevoluteCutJoint(at_a=(2.5, 0.0, 0.0), at_b=(1.0, 0.0, 0.0)), coupler, rocker)
        m.output("angle", rocker.angle())
        return m


@dataclass(frozen=True, kw_only=True)
class Sleds(Model):
    """Two sleds whose positions and rates are inputs, each with a bob on it."""

    def build(self) -> Mechanism:
        m = Mechanism()
        for k in range(2):
            drive = Input(name=f"u{k}", unit="m", rate_name=f"v{k}")
            sled = m.body(f"sled{k}", m.ground, Translational(axis="x", drive=drive), mass=1.0)
            m.output(f"x{k}", m.body(f"bob{k}", sled, Translational(axis="x"), mass=1.0).coordinate())
        return m


def jumping(t: float) -> dict[str, float]:
    """The sleds' positions jump at 0.3 and 0.5 s, and once more, by more than their rates explain."""
    first, other = 0.1 * (t > 0.25) + 0.2 * (t > 0.65), -0.03 * (t > 0.45)
    return {"u0": 0.5 * t + first, "v0": 0.5, "u1": other - t, "v1": -1.0}


Given = Callable[[float], dict[str, float]]
LATER: list[tuple[Model, Settings, Given, list[str]]] = [
    (NearMiss(), Settings(solver="adams", tolerance=1e-10), lambda _: {}, ["limited-tolerance"]),
    (Lifted(), Settings(solver="radau", tolerance=1e-6), lambda _: {}, ["undetermined-forces"]),
    (Flat(), Settings(solver="adams", tolerance=1e-6), lambda _: {}, ["singular-start"]),
    (Sleds(), Settings(solver="adams", tolerance=1e-6), jumping, ["input-jump", "input-jump"]),
]


@pytest.mark.parametrize(("model", "settings", "given", "codes"), LATER, ids=[code for *_, (code, *_) in LATER])
def test_what_the_solver_and_the_inputs_cause_is_logged_as_in_python(
    model: Model, settings: Settings, given: Given, codes: list[str], tmp_path: Path
) -> None:
    """The first text of every code and subject, as FMUs with Python log it; a later text may have other numbers."""
    times = np.linspace(0.0, 2.1, 22) if codes == ["limited-tolerance"] else np.linspace(0.0, 0.9, 10)
    binary = Binary(export(model, tmp_path / "model.fmu", settings, native=True), tmp_path)
    numbers = {v.name: v.valueReference for v in binary.description.modelVariables}
    outputs = [v.valueReference for v in binary.description.modelVariables if v.causality == "output"]
    simulation, fmu = Simulation(model, settings), binary.instantiate()
    assert fmu.set_up() == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
    found: dict[tuple[str, str], str] = {}
    for begin, end in pairwise(times):
        for name, value in given(begin).items():
            simulation.set_input(name, value)
            assert fmu.set("Real", [numbers[name]], [value]) == OK
        assert simulation.advance(end).ok
        assert fmu.step(begin, end - begin) == OK
        np.testing.assert_array_equal(fmu.get("Real", outputs)[1], simulation.outputs())
        for d in simulation.diagnostics:
            found.setdefault((d.code, d.subject), str(d))
    fmu.free()
    expected = [text for (code, _), text in found.items() if code in codes]
    assert list(map(code_of, expected)) == codes
    assert [text for _, text in binary.logged if code_of(text) in codes] == expected


@pytest.mark.parametrize("tolerance", [1e-10, 1e-9])
def test_ida_reports_that_it_uses_another_tolerance(tolerance: float, tmp_path: Path) -> None:
    settings = Settings(solver="ida", tolerance=tolerance)
    expected = [str(d) for d in Simulation(FourBar(), settings).diagnostics if d.code == "limited-tolerance"]
    told = [text for text in logged(FourBar(), settings, tmp_path) if code_of(text) == "limited-tolerance"]
    assert told == expected
    assert len(told) == (tolerance < 1e-9)

"""Warnings of native FMUs are those of the same run in Python, and there is none where Python gives none."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from binding import OK, WARNING, Binary
from running import needs_linker
from scipy.integrate import solve_ivp

from mbfmu.fmi import export
from mbfmu.mechanics import Harmonic, Mechanism, Revolute, rod
from mbfmu.modeling import Model, parameter
from mbfmu.session.run import run
from mbfmu.session.simulation import Settings

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

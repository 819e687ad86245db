"""A support that a host moves: what fmi2SetReal and doStep make of it."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from mbfmu.fmi import Fmu, export
from mbfmu.modeling import Model, find
from mbfmu.session.simulation import Settings, Simulation

SOURCE = """
from dataclasses import dataclass
from mbfmu.mechanics import Input, JointSpring, Mechanism, Translational
from mbfmu.modeling import Model

@dataclass(frozen=True, kw_only=True)
class Oscillator(Model):
    '''A mass on a spring on a base that a host moves.'''
    name = "oscillator"

    def build(self):
        m = Mechanism()
        motion = Input(name="base", unit="m", rate_name="base_rate", description="position of the base")
        base = m.body("base", m.ground, Translational(axis="x", drive=motion))
        mass = m.body("mass", base, Translational(axis="x"), mass=1.0)
        m.force("spring", JointSpring(stiffness=100.0), mass)
        m.output("mass.x", mass.position("x"), "position of the mass")
        m.output("base.x", base.position("x"), "position of the base")
        return m
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Model, Path]:
    """The model, and its FMU."""
    folder = tmp_path_factory.mktemp("moved")
    (folder / "oscillator.py").write_text(SOURCE)
    model = find(str(folder / "oscillator.py"))()
    return model, export(model, folder / "oscillator.fmu", Settings(solver="adams", tolerance=1e-9), native=False)


def test_a_shaken_base_is_that_of_the_closed_form(made: tuple[Model, Path]) -> None:
    """20 mm sin(30 t) from rest; step by step as the direct simulation, saved and restored on the way."""
    model, path = made
    direct = Simulation(model, Settings(solver="adams", tolerance=1e-9))
    times = np.linspace(0.0, 0.2, 41)
    with Fmu(path) as fmu:
        for t, after in pairwise(times):
            values = (0.02 * np.sin(30.0 * t), 0.6 * np.cos(30.0 * t))
            for k, (name, value) in enumerate(zip(("base", "base_rate"), values, strict=True)):
                fmu[name] = value
                direct.set_input(k, value)
            saved, reached = fmu.save(), fmu.t
            fmu.step_to(float(after))
            assert direct.advance(float(after)).ok
            np.testing.assert_allclose(fmu.reals(), direct.outputs(), rtol=1e-12, atol=1e-12)
            fmu.restore(saved)  # with what has been set for this step
            fmu.t = reached
            fmu.step_to(float(after))
            np.testing.assert_allclose(fmu.reals(), direct.outputs(), rtol=1e-12, atol=1e-12)
        exact = 0.02 * (100.0 * np.sin(6.0) - 300.0 * np.sin(2.0)) / (100.0 - 900.0)
        assert fmu["mass.x"] == pytest.approx(exact, abs=5e-6)
        assert exact == pytest.approx(7.518e-3, abs=1e-6)


def test_a_position_set_again_is_taken(made: tuple[Model, Path]) -> None:
    """The base has moved on at its rate: the same position means that it comes back."""
    with Fmu(made[1]) as fmu:
        fmu["base_rate"] = 0.5
        fmu.step(0.1)
        assert fmu["base.x"] == pytest.approx(0.05, rel=1e-12)
        fmu["base"], fmu["base_rate"] = 0.0, 0.0
        fmu.step(0.1)
        assert fmu["base.x"] == pytest.approx(0.0, abs=1e-15)


def test_an_input_that_holds_restarts_nothing(made: tuple[Model, Path]) -> None:
    with Fmu(made[1]) as fmu:
        for _ in range(5):
            fmu["base"], fmu["base_rate"] = 0.0, 0.0
            fmu.step(0.01)
        assert fmu["solver.restarts"] == 0

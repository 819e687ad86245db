"""Joint friction in native FMUs: the bits of a simulation, and parameters of mass and size."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest
from fmpy import simulate_fmu

import mbfmu as mb
from mbfmu.fmi.export import export

G = 9.81
needs_compiler = pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="needs a C compiler")


@dataclass(frozen=True, kw_only=True)
class BrakedBlock(mb.Model):
    """A block that slides until friction stops it."""

    mass: float = mb.parameter(2.0, unit="kg", min=0.1, doc="Mass of the block")
    friction: float = mb.parameter(0.5, min=0.01, doc="Coefficient of friction")
    speed: float = mb.parameter(2.0, unit="m/s", doc="Velocity at the start")

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism()
        joint = mb.Translational(axis="x", nominal=1.0, rate=self.speed)
        block = m.body("block", m.ground, joint, mass=self.mass)
        weight = mb.Input(name="normal.force", unit="N", start=2.0 * G)
        friction = m.force("friction", mb.JointFriction(coulomb=self.friction, normal_force=weight), block)
        m.output("x", block.coordinate())
        m.output("force", friction.effort())
        return m


@needs_compiler
def test_native_fmu_stops_as_the_simulation_and_for_other_parameters(tmp_path: Path) -> None:
    settings = mb.Settings(solver="radau", tolerance=1e-6)
    path = export(BrakedBlock(), tmp_path / "block.fmu", settings, native=True)
    found = simulate_fmu(str(path), stop_time=1.0, output_interval=0.05, fmi_type="CoSimulation")
    simulation = mb.Simulation(BrakedBlock(), settings)
    for row in found[1:]:
        assert simulation.advance(row["time"]).ok
        assert [row["x"], row["force"]] == simulation.outputs()[:2].tolist()
    values = {"mass": 4.0, "friction": 0.8, "speed": 3.0}
    for kind in ("CoSimulation", "ModelExchange"):
        how = {"fmi_type": kind, "relative_tolerance": 1e-6, "output_interval": 0.05}
        found = simulate_fmu(str(path), stop_time=2.0, start_values=values, **how)
        assert found["x"][-1] == pytest.approx(4.0 * 9.0 / (2.0 * 0.8 * 2.0 * G), abs=1e-4), kind

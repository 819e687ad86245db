"""Native FMUs of models that are declared as graphs: reversed joints, frames on both bodies, divided bodies."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from fmpy import read_model_description, simulate_fmu

import mbfmu as mb
from mbfmu.fmi import export
from mbfmu.native.runtime import COMPILERS
from mbfmu.native.targets import host
from mbfmu.session.simulation import Settings

pytestmark = pytest.mark.skipif(
    not host() or not any(map(shutil.which, COMPILERS)), reason="needs a C compiler, and a machine that is known"
)


@dataclass(frozen=True, kw_only=True)
class Linkage(mb.Model):
    """Four-bar linkage whose joints are declared in any order; ``angles``: all are outputs."""

    rocker_length: float = mb.parameter(2.0, unit="m", min=1.5, max=2.5, doc="Length of the rocker")
    angles: bool = mb.parameter(False, doc="The angles of all joints are outputs")

    def build(self) -> mb.Mechanism:
        """Return the mechanism."""
        m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
        rocker = m.body("rocker", **mb.rod(mass=1.5, length=self.rocker_length))
        coupler = m.body("coupler", **mb.rod(mass=2.0, length=3.0))
        crank = m.body("crank", **mb.rod(mass=1.0, length=1.0))
        joints = (
            m.joint("C", rocker, coupler, mb.Revolute(at=(self.rocker_length, 0, 0)), at_b=(3.0, 0, 0)),
            m.joint("D", rocker, m.ground, mb.Revolute(start=-1.5), at_b=(3.0, 0, 0)),
            m.joint("B", coupler, crank, mb.Revolute(), at_b=(1.0, 0, 0)),
            m.joint("A", m.ground, crank, mb.Revolute(start=1.0, fixed=True)),
        )
        for joint in joints:
            m.output(f"{joint.name}.force", joint.force("x"))
            if self.angles:
                m.output(f"{joint.name}.angle", joint.angle())
        m.output("height", coupler.position("y", (1.5, 0, 0)))
        return m


@pytest.mark.parametrize("angles", [False, True])
def test_a_native_fmu_of_a_graph_is_the_simulation_with_other_parameters_too(angles: bool, tmp_path: Path) -> None:
    path = export(Linkage(angles=angles), tmp_path / "linkage.fmu", Settings(solver="adams"), native=True)
    names = [v.name for v in read_model_description(str(path)).modelVariables if v.causality == "output"]
    for length in (2.0, 2.2):
        found = simulate_fmu(
            str(path), stop_time=1.0, output_interval=0.1, step_size=0.1, start_values={"rocker_length": length}
        )
        expected = mb.simulate(Linkage(angles=angles, rocker_length=length), 1.0, interval=0.1, solver="adams")
        assert {"C.force", "height"} <= set(names)
        for name in ("A.force", "B.force", "C.force", "D.force", "height", *(["C.angle"] if angles else [])):
            np.testing.assert_allclose(found[name], expected[name], rtol=1e-9, atol=1e-9)

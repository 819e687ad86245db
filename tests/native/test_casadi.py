"""CasADi (extra ``bench``) as the importing tool: it linearizes FMUs by their directional derivatives."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from exchange_models import ExportedModels

from fmus.pendulum import SwingPendulum
from mbfmu.mechanics import Input, JointForce, JointSpring, Mechanism, Revolute, Translational, rod
from mbfmu.native.runtime import COMPILERS
from mbfmu.native.targets import host
from mbfmu.steady.equilibrium import equilibrium

casadi = pytest.importorskip("casadi")
pytestmark = pytest.mark.skipif(
    not host() or not any(map(shutil.which, COMPILERS)), reason="needs a C compiler, and a machine that is known"
)


def robot_arm() -> Mechanism:
    """Two links on a sliding base with springs, turned by torques that are inputs."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    base = m.body("base", m.ground, Translational(axis="x"), mass=3.0)
    upper = m.body("upper", base, Revolute(start=-1.2), **rod(mass=2.0, length=0.8))
    lower = m.body("lower", upper, Revolute(at=(0.8, 0.0, 0.0), start=0.4), **rod(mass=1.0, length=0.5))
    m.force("rail", JointSpring(stiffness=200.0, damping=4.0), base)
    m.force("shoulder", JointSpring(stiffness=40.0, damping=0.5), upper)
    m.force("elbow", JointSpring(stiffness=10.0, damping=0.2), lower)
    m.force("motor", JointForce(magnitude=Input(name="torque", unit="N.m", start=3.0)), upper)
    m.output("tip", lower.position("y", (0.5, 0.0, 0.0)))
    m.output("acceleration", base.acceleration())
    return m


@pytest.mark.parametrize("make", [robot_arm, SwingPendulum], ids=["arm", "pendulum"])
def test_state_matrices_are_those_of_mbfmu_linearize(
    make: Any, tmp_path_factory: pytest.TempPathFactory, tmp_path: Path
) -> None:
    model = make()
    steady = equilibrium(model)
    expected = steady.state_space
    path = ExportedModels(tmp_path_factory).export("model", make())
    fmpy.extract(str(path), unzipdir=str(tmp_path))
    dae = casadi.DaeBuilder("model", str(tmp_path))
    outputs = [str(name) for name in expected.outputs]
    u = [float(np.ravel(dae.start(name))[0]) for name in dae.u()]
    right = dae.create("right", ["x", "u"], ["ode", "y"], {"enable_ad": True})
    linear = right.factory("linear", ["x", "u"], ["jac:ode:x", "jac:ode:u", "jac:y:x", "jac:y:u"])
    A, B, C, D = (np.array(matrix) for matrix in linear(np.concatenate((steady.q, steady.v)), u))
    rows = [list(dae.y()).index(name) for name in outputs]
    scale = np.abs(expected.A).max()
    f = steady.compiled.system.n
    pairs = (
        (A, expected.A[: 2 * f, : 2 * f]),
        (B, expected.B[: 2 * f]),
        (C[rows], expected.C[:, : 2 * f]),
        (D[rows], expected.D),
    )
    for found, matrix in pairs:
        np.testing.assert_allclose(
            found.reshape(matrix.shape), matrix, atol=1e-12 * scale * max(1.0, np.abs(matrix).max())
        )

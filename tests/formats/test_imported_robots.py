"""Models from URDF and MJCF files have the equations of motion of MuJoCo, which reads the same files.

Contact, ranges of joints and friction are disabled in MuJoCo; what the import reports as lost is removed there, too.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from mbfmu.formats.compiler import compile_file
from mbfmu.formats.imported import model_of
from mbfmu.formats.reader import read_file
from mbfmu.formats.writer import source_of
from mbfmu.mechanics import CompiledMechanism

ROBOTS = Path(__file__).parents[1] / "data" / "robots"
ROUNDING = 1e-13  # relative; the errors are 2e-14 and less
DISABLED = ("CONTACT", "LIMIT", "FRICTIONLOSS", "EQUALITY")

# Several joints per body with anchors off the origin, reference angles, unloaded springs, tilted frames and inertias.
MACHINE = """
<mujoco model="machine">
  <compiler angle="degree"/>
  <option gravity="1 -2 -9"/>
  <worldbody>
    <body name="cart" pos="0.1 0.2 0.3" euler="10 20 30">
      <joint name="rail" type="slide" axis="1 2 0" ref="0.2" stiffness="5" springref="0.4" damping="0.7"/>
      <joint name="turn" axis="0 1 1" pos="0.1 0 -0.2" ref="25" springref="-15" stiffness="3" damping="0.2"
             armature="0.3"/>
      <joint name="tilt" axis="1 0 0" pos="-0.1 0.3 0" damping="0.1" range="-60 60" frictionloss="0.4"/>
      <inertial pos="0.1 -0.05 0.02" quat="1 0.2 0.3 0.1" mass="2" diaginertia="0.3 0.2 0.15"/>
      <body name="ball" pos="0 0.4 0" quat="1 1 0 0">
        <joint type="ball" pos="0.05 0.1 0"/>
        <geom type="box" size="0.1 0.05 0.02" pos="0.1 0 0" mass="1.5"/>
        <site name="tip" pos="0.2 0 0"/>
        <body name="fixed" pos="0.3 0 0" euler="0 45 0">
          <geom type="capsule" size="0.02 0.1" mass="0.4"/>
          <body name="wrist" gravcomp="0.7">
            <joint name="wrist" axis="0 0 1"/>
            <geom type="capsule" size="0.02 0.1" pos="0.1 0 0" mass="0.3"/>
          </body>
        </body>
      </body>
    </body>
    <body name="drone" pos="1 1 1" euler="0 0 90">
      <freejoint/>
      <geom type="ellipsoid" size="0.2 0.1 0.05" mass="1"/>
      <site name="hook" pos="0 0 -0.1"/>
      <body name="rotor" pos="0.2 0 0"><joint name="spin"/><geom type="cylinder" size="0.1 0.01" mass="0.1"/></body>
    </body>
  </worldbody>
  <tendon>
    <spatial name="cord" stiffness="40" damping="0.3" springlength="0.5"><site site="tip"/><site site="hook"/></spatial>
  </tendon>
  <actuator>
    <motor name="push" joint="rail" gear="2.5"/>
    <position name="turn" joint="turn" kp="12" kv="0.8" gear="1.5"/>
    <position name="hold" joint="wrist" kp="9" kv="0.5" ctrlrange="-1 1" forcerange="-2 1.5"/>
    <motor name="blow" joint="spin" ctrllimited="true" ctrlrange="-0.5 1" forcelimited="true" forcerange="-1 0.6"/>
  </actuator>
  <equality>
    <connect name="pin" body1="cart" body2="drone" anchor="0.2 0.1 0"/>
    <weld name="grip" body1="wrist" body2="rotor" anchor="0.05 0 0.1"/>
    <joint name="law" joint1="wrist" joint2="tilt" polycoef="0.1 0.5 0.3 -0.2 0.05"/>
    <joint name="belt" joint1="spin" joint2="turn" polycoef="0.2 -3 0 0 0"/>
  </equality>
</mujoco>
"""


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("machine") / "machine.xml"
    path.write_text(MACHINE)
    return path


@cache
def read(path: Path, loops: bool) -> tuple[CompiledMechanism, Any, Any]:
    """The imported mechanism without stops and friction, its description, and the model of MuJoCo."""
    description = read_file(path)
    if not loops:
        description.cuts.clear()
        description.couplings.clear()
    model = model_of(source_of(description))
    off = {p.name: 0.0 for p in model.parameters() if p.name.endswith("_friction")}
    off |= {"stops": False} if hasattr(model, "stops") else {}
    compiled = model.with_values(off).compile()
    reference = compile_file(path).model
    remove_lost(reference)
    return compiled, description, reference


def remove_lost(model: Any) -> None:
    """Remove from a model of MuJoCo what has no counterpart."""
    for flag in DISABLED:
        model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}"))
    model.opt.density = model.opt.viscosity = 0.0
    model.tendon_armature[:] = 0.0
    of_ball = np.isin(model.jnt_type, (0, 1))
    model.dof_damping[of_ball[model.dof_jntid]] = 0.0
    model.dof_armature[of_ball[model.dof_jntid]] = 0.0
    for k in range(model.nu):
        on_joint, target = model.actuator_trntype[k] <= 1, model.actuator_trnid[k][0]
        is_lost = of_ball[target] if on_joint else not is_fixed_tendon(model, k, target)
        if is_lost or model.actuator_dyntype[k] or model.actuator_gaintype[k] or model.actuator_biastype[k] > 1:
            model.actuator_gainprm[k] = model.actuator_biasprm[k] = 0.0
            model.actuator_gaintype[k] = model.actuator_biastype[k] = 0


def is_fixed_tendon(model: Any, k: int, target: int) -> bool:
    """Whether an actuator acts on a tendon of up to three joints."""
    if model.actuator_trntype[k] != mujoco.mjtTrn.mjTRN_TENDON:
        return False
    kinds = model.wrap_type[model.tendon_adr[target] :][: model.tendon_num[target]]
    return len(kinds) <= 3 and bool(np.all(kinds == int(mujoco.mjtWrap.mjWRAP_JOINT)))


def random_state(model: Any, seed: int) -> Any:
    """A state of MuJoCo with random positions, velocities and controls, and everything computed."""
    rng, data = np.random.default_rng(seed), mujoco.MjData(model)
    mujoco.mj_integratePos(model, data.qpos, 0.5 * rng.standard_normal(model.nv), 1.0)
    data.qvel[:] = rng.standard_normal(model.nv)
    data.ctrl[:] = 2.0 * rng.standard_normal(model.nu)  # beyond limits, too
    mujoco.mj_forward(model, data)
    return data


def set_controls(compiled: CompiledMechanism, description: Any, model: Any, data: Any) -> None:
    given = (*description.drives, *description.transmissions)
    for index, variable in enumerate(compiled.inputs.variables):
        drive = next(own for own in given if own.input == variable.name)
        for k in range(model.nu):
            if (mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, k) or f"actuator{k + 1}") == drive.name:
                compiled.inputs.start(index, float(data.ctrl[k]))


def close(found: Any, expected: Any) -> None:
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=ROUNDING * max(float(np.abs(expected).max()), 1e-9))


@pytest.mark.parametrize("name", ["humanoid.xml", "test_model.xml", "connect_3d.xml", "panda.urdf", "machine"])
def test_mass_matrix_accelerations_and_inverse_dynamics_are_those_of_mujoco(name: str, machine: Path) -> None:
    path = machine if name == "machine" else ROBOTS / name
    compiled, description, model = read(path, loops=False)
    system, mass = compiled.system, np.zeros((model.nv, model.nv))
    assert system.n == model.nv
    for seed in range(3):
        data = random_state(model, seed)
        set_controls(compiled, description, model, data)
        terms = system.allocate_terms()
        system.fill(0.0, data.qpos, data.qvel, terms)
        mujoco.mj_fullM(model, data, mass)
        close(terms.M, mass)
        # accelerations a of MuJoCo: M a must be the force, in which the condition of M has no part
        close(-terms.h, mass @ data.qacc_smooth)
        controls = data.qfrc_actuator.copy()
        data.qacc[:] = np.random.default_rng(seed + 10).standard_normal(model.nv)
        mujoco.mj_inverse(model, data)
        close(terms.M @ data.qacc + terms.h, data.qfrc_inverse - controls)


@pytest.mark.parametrize("name", ["humanoid.xml", "test_model.xml", "panda.urdf", "machine"])
def test_bodies_and_sites_are_where_those_of_mujoco_are(name: str, machine: Path) -> None:
    compiled, description, model = read(machine if name == "machine" else ROBOTS / name, loops=False)
    data = random_state(model, 1)
    out = np.zeros(len(compiled.outputs))
    compiled.observe(0.0, data.qpos, data.qvel, np.zeros(model.nv), np.zeros(0), out)
    found = {variable.name: value for variable, value in zip(compiled.outputs, out, strict=True)}
    original = {new: old for old, new in description.renamed.items()}
    for point in description.points:
        site = original.get(point.name, f"site '{point.name}'").split("'")[1]
        close([found[f"{point.name}.{letter}"] for letter in "xyz"], data.site(site).xpos)
    by_name = {body.name: body for body in compiled.mechanism.bodies}
    compiled.place_bodies(0.0, data.qpos)
    states = compiled.data.state.bodies
    moved = [i for i in range(1, model.nbody) if mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, i) in by_name]
    assert len(moved) >= 3
    for i in moved:
        body = by_name[mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, i)]
        motion = states[body.index]
        close(motion["r"] + motion["A"] @ body.com, data.xipos[i])
        close(motion["A"], data.xmat[i].reshape(3, 3))


def rows_of(model: Any, data: Any) -> np.ndarray:
    """The Jacobian of the equality constraints of MuJoCo."""
    rows = np.zeros((data.nefc, model.nv))
    if mujoco.mj_isSparse(model):
        mujoco.mju_sparse2dense(rows, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
    else:
        rows[:] = data.efc_J.reshape(rows.shape)
    return rows


def row_space(J: np.ndarray) -> np.ndarray:
    """The projection onto the rows of a matrix."""
    _, sizes, rows = np.linalg.svd(J, full_matrices=False)
    kept = rows[sizes > 1e-9 * sizes[0]]
    return kept.T @ kept


@pytest.mark.parametrize("name", ["test_model.xml", "connect_3d.xml", "panda.urdf", "machine"])
def test_loops_and_couplings_constrain_the_same_velocities(name: str, machine: Path) -> None:
    """At the start, where the loops of all these models are closed."""
    compiled, _, model = read(machine if name == "machine" else ROBOTS / name, loops=True)
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_EQUALITY)
    data, terms = mujoco.MjData(model), compiled.system.allocate_terms()
    mujoco.mj_forward(model, data)
    compiled.system.fill(0.0, data.qpos, data.qvel, terms)
    np.testing.assert_allclose(row_space(terms.J), row_space(rows_of(model, data)), rtol=0.0, atol=1e-12)
    of_loops = [k for k, row in enumerate(compiled.system.constraint_names) if "." in row]
    assert np.abs(terms.Phi[of_loops]).max(initial=0.0) < 1e-14


def test_couplings_are_the_polynomials_of_mujoco_at_all_positions(machine: Path) -> None:
    compiled, _, model = read(machine, loops=True)
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_EQUALITY)
    data, terms = random_state(model, 5), compiled.system.allocate_terms()
    compiled.system.fill(0.0, data.qpos, data.qvel, terms)
    names, rows = list(compiled.system.constraint_names), rows_of(model, data)
    for name, row in (("law", -2), ("belt", -1)):
        k = next(k for k, own in enumerate(names) if own.startswith(name))
        follower = np.flatnonzero(rows[row] == 1.0)[0]
        np.testing.assert_allclose(terms.J[k] / terms.J[k, follower], rows[row], rtol=0.0, atol=1e-9)
        assert terms.Phi[k] / terms.J[k, follower] == pytest.approx(data.efc_pos[row], abs=1e-14)

"""Public models of robots: import, mass matrices against MuJoCo and Pinocchio, time of a run, native FMU.

    pip download --no-deps dm_control==1.0.50 gymnasium==1.4.0 robosuite==1.5.2 example-robot-data==6.0.0
    for package in *.whl; do unzip -q "$package" -d models; done
    python benchmarks/imported_robots.py models --runs

Without ``--runs`` all models of the folder are imported and their mass matrices are compared; with it, those of RUNS
are simulated for 1 s from the start of the file with all inputs zero, and exported. Pinocchio is used for URDF files if
it is installed (extra ``bench``). The mass matrix is compared at two random positions, relative to its largest entry.
"""

from __future__ import annotations

import argparse
import time
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import mbfmu as mb
from mbfmu.formats.compiler import compile_file
from mbfmu.formats.imported import model_of
from mbfmu.formats.reader import read_file
from mbfmu.formats.writer import source_of

RUNS = (  # parts of the paths of models that are simulated
    "dm_control/suite/acrobot.xml",
    "dm_control/suite/cheetah.xml",
    "dm_control/suite/humanoid.xml",
    "dm_control/suite/quadruped.xml",
    "gymnasium/envs/mujoco/assets/ant.xml",
    "robosuite/models/assets/robots/panda/robot.xml",
    "robosuite/models/assets/grippers/robotiq_gripper_s.xml",
    "double_pendulum_description/urdf/double_pendulum.urdf",
    "ur_description/urdf/ur5_robot.urdf",
    "panda_description/urdf/panda.urdf",
    "so_arm_description/urdf/so100.urdf",
    "solo_description/robots/solo12.urdf",
    "talos_data/robots/talos_reduced.urdf",
)
SEEDS = (0, 1)


def pinocchio_model(path: Path) -> Any:
    """Return the model of Pinocchio of a URDF file; None: it is not installed, or refuses the file."""
    try:
        import pinocchio
    except ImportError:
        return None
    try:
        return pinocchio.buildModelFromUrdf(str(path))
    except (ValueError, RuntimeError):
        return None


def mass_matrix_of_pinocchio(
    model: Any, compiled: mb.mechanics.CompiledMechanism, names: dict[str, str], q: Any
) -> Any:
    """Return the mass matrix by Pinocchio in the order of the coordinates of the imported model; None: others exist."""
    import pinocchio

    records, bodies = compiled.data.arrays.bodies, compiled.mechanism.bodies
    moving = [body for body in bodies if body.joint.nv]
    if any(body.joint.nv != 1 for body in moving) or model.nv != len(moving):
        return None
    configuration, order = pinocchio.neutral(model), np.zeros(model.nv, int)
    for body in moving:
        joint = model.joints[model.getJointId(names[body.name])]
        angle = q[int(records[body.index]["qi"])]
        configuration[joint.idx_q : joint.idx_q + joint.nq] = (
            (np.cos(angle), np.sin(angle)) if joint.nq == 2 else (angle,)
        )
        order[int(records[body.index]["vi"])] = joint.idx_v
    M = np.array(pinocchio.crba(model, model.createData(), configuration))
    M = np.triu(M) + np.triu(M, 1).T
    return M[np.ix_(order, order)]


def remove_lost(file: Any) -> None:
    """Remove what is not imported from a model of MuJoCo, and give bodies the inertias that it had refused."""
    import mujoco

    model = file.model
    model.tendon_armature[:] = 0.0
    model.dof_armature[np.isin(model.jnt_type, (0, 1))[model.dof_jntid]] = 0.0
    for name, own in file.inertias.items():
        body = model.body(name).id
        model.body_mass[body] = own.mass
        if own.inertia is None:
            model.body_inertia[body] /= own.factor
            continue
        moments, axes = np.linalg.eigh(own.inertia)
        axes *= np.sign(np.linalg.det(axes))
        model.body_inertia[body] = moments
        mujoco.mju_mat2Quat(model.body_iquat[body], axes.ravel())
        model.body_sameframe[body] = 0  # MuJoCo would not use the new axes


def deviations(path: Path, model: mb.Model, description: Any) -> tuple[float, float | None]:
    """Return the largest deviations of the mass matrix from MuJoCo and from Pinocchio, without loops."""
    import mujoco

    compiled, file = model.compile(), compile_file(path)
    remove_lost(file)
    other = pinocchio_model(path) if file.robot is not None else None
    joints = {joint.name: body for body, joint in ((b.name, b.joint) for b in description.bodies)}
    originals = {new: old.split("'")[1] for old, new in description.renamed.items() if old.startswith("joint")}
    names = {body: originals.get(joint, joint) for joint, body in joints.items()}
    found, of_other = 0.0, None
    for seed in SEEDS:
        data, M = mujoco.MjData(file.model), np.zeros((file.model.nv, file.model.nv))
        rng = np.random.default_rng(seed)
        mujoco.mj_integratePos(file.model, data.qpos, 0.5 * rng.standard_normal(file.model.nv), 1.0)
        mujoco.mj_forward(file.model, data)
        mujoco.mj_fullM(file.model, data, M)
        own = compiled.mass_matrix(0.0, data.qpos)
        found = max(found, float(np.abs(own - M).max() / np.abs(M).max()))
        if other is not None and (P := mass_matrix_of_pinocchio(other, compiled, names, data.qpos)) is not None:
            of_other = max(of_other or 0.0, float(np.abs(own - P).max() / np.abs(P).max()))
    return found, of_other


def without_states(model: mb.Model) -> mb.Model:
    """Return a model without dry friction, whose states would be further coordinates."""
    return model.with_values({p.name: 0.0 for p in model.parameters() if p.name.endswith("_friction")})


def run(model: mb.Model) -> tuple[float, str]:
    """Return the CPU time (s) of a second run of 1 s, and whether the FMU is native."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mb.simulate(model, 1.0, interval=0.01)
        begin = time.process_time()
        result = mb.simulate(model, 1.0, interval=0.01)
        needed = time.process_time() - begin
    if result.failure:
        return np.nan, result.failure[:60]
    with TemporaryDirectory() as folder:
        try:
            mb.export(model, Path(folder) / "model.fmu")
        except mb.UserError as error:
            return needed, f"no: {error}"[:60]
    return needed, "yes"


def measure(path: Path, name: str, *, runs: bool) -> str:
    """Return the row of the table of a model."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        description = read_file(path)
        loops = len(description.cuts) + len(description.couplings)
        cuts, couplings = list(description.cuts), list(description.couplings)
        description.cuts.clear()
        description.couplings.clear()
        of_mujoco, of_pinocchio = deviations(path, without_states(model_of(source_of(description))), description)
        description.cuts[:], description.couplings[:] = cuts, couplings
        model = model_of(source_of(description))
    other = "" if of_pinocchio is None else f"{of_pinocchio:.0e}"
    row = f"| {name} | {len(description.bodies)} | {loops} | {of_mujoco:.0e} | {other} |"
    if runs:
        needed, native = run(model)
        row += f" {needed:.2g} | {native} |"
    return row


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--runs", action="store_true", help="only the models of RUNS, which are simulated and exported")
    options = parser.parse_args()
    paths = sorted(path for kind in ("xml", "urdf") for path in options.folder.rglob(f"*.{kind}"))
    columns = ["model", "bodies", "loops", "mass matrix: MuJoCo", "Pinocchio"]
    columns += ["CPU time of 1 s, s", "native FMU"] if options.runs else []
    print("|".join(("", *(f" {column} " for column in columns), "")))
    print("|".join(("", *(["---"] * len(columns)), "")))
    for path in paths:
        name = next((part for part in RUNS if str(path).endswith(part)), "")
        if options.runs and not name:
            continue
        try:
            print(measure(path, name or str(path.relative_to(options.folder)), runs=options.runs), flush=True)
        except mb.UserError as error:
            print(f"refused: {path.relative_to(options.folder)}: {str(error)[:300]}", flush=True)


if __name__ == "__main__":
    main()

"""Bodies and joints of a model of MuJoCo.

MuJoCo places a body in its parent by T0 (``body_pos``, ``body_quat``) and then moves it by its joints in turn, with the
anchor p (``jnt_pos``) and the axis n in the frame of the body, and q0 the coordinate in T0 (``qpos0``):

    hinge  Trans(p) Rot(n, q - q0) Trans(-p),    slide  Trans(n (q - q0)),    ball  Trans(p) Rot(quaternion) Trans(-p).

Here every joint carries one body. All joints of a body but the last carry bodies without mass. The frame of the body
is at the anchor of its last hinge or ball: points of the body are shifted by -p. The joint frame is rotated by -q0
about n, or shifted by -n q0, so that coordinates are those of MuJoCo. A free joint is relative to the ground.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .compiler import CompiledFile
from .description import GROUND_NAME, ImportedBody, ImportedJoint, Matrix, Vector
from .inertias import ReplacedInertia, rotation_of
from .losses import Key, Losses, printable
from .names import RESERVED, Names

FREE, BALL, SLIDE, HINGE = range(4)  # mjtJoint


def rotation_about(axis: Vector, angle: float) -> Matrix:
    """Return the rotation matrix about a unit vector."""
    return rotation_of([np.cos(0.5 * angle), *(np.sin(0.5 * angle) * axis)])


class Tree:
    """Bodies of the description, with where the elements of MuJoCo are.

    Attributes
    ----------
    bodies
        Bodies in order.
    of_body
        Names of the bodies, by the number in MuJoCo.
    shift
        Origin of the frame of MuJoCo in that of the body, by the number in MuJoCo (n, 3), m; the axes are the same.
    of_joint
        Names of the bodies whose joints are the joints of MuJoCo, and the joints.
    """

    def __init__(self, file: CompiledFile, losses: Losses) -> None:
        self.file, self.losses = file, losses
        self.names = Names(RESERVED)
        self.joint_names = Names(frozenset())
        self.renamed: dict[str, str] = {}
        self.bodies: list[ImportedBody] = []
        self.of_body = [GROUND_NAME]
        self.shift = np.zeros((file.model.nbody, 3))
        self.of_joint: list[tuple[str, ImportedJoint]] = []
        for number in range(1, file.model.nbody):
            self._add_body(number)

    def name_of(self, kind: str, number: int) -> str:
        """Return the name of an element of MuJoCo; empty: it has none."""
        return self.file.name_of(kind, number)

    def number_of_body(self, name: str) -> int:
        """Return the number in MuJoCo of a body."""
        mujoco = self.file.mujoco
        return int(mujoco.mj_name2id(self.file.model, mujoco.mjtObj.mjOBJ_BODY, name))

    def new_name(self, names: Names, kind: str, number: int, default: str) -> str:
        """Return an identifier for an element of MuJoCo, and remember its name if it differs."""
        original = self.name_of(kind, number)
        name = names.new(original, default)
        if original and name != original:
            self.renamed[f"{kind.lower()} {printable(original)!r}"] = name
        return name

    def _add_body(self, i: int) -> None:
        model = self.file.model
        parent = int(model.body_parentid[i])
        if model.body_mocapid[i] >= 0:
            self.losses.add("mocap", self.name_of("BODY", i))
        first, count = int(model.body_jntadr[i]), int(model.body_jntnum[i])
        name = self.new_name(self.names, "BODY", i, f"body{i}")
        joints, anchor = self._joints_of(i, parent, range(first, first + count), name)
        here = self.of_body[parent]
        for joint in joints[:-1]:
            label = self.names.new(joint.name, f"{name}_part")
            self.bodies.append(
                ImportedBody(name=label, parent=here, joint=joint, mass=0.0, com=np.zeros(3), inertia=np.zeros((3, 3)))
            )
            self.of_joint.append((label, joint))
            here = label
        mass, inertia = self._inertia_of(i)
        self.bodies.append(
            ImportedBody(
                name=name,
                parent=here,
                joint=joints[-1],
                mass=mass,
                com=model.body_ipos[i] - anchor,
                inertia=inertia,
                origin=-anchor,
            )
        )
        if count:
            self.of_joint.append((name, joints[-1]))
        self.of_body.append(name)
        self.shift[i] = -anchor

    def _inertia_of(self, i: int) -> tuple[float, Matrix]:
        """Return the mass of a body, and its inertia (3, 3) about the center of mass, body axes."""
        model, R = self.file.model, rotation_of(self.file.model.body_iquat[i])
        own = self.file.inertias.get(self.name_of("BODY", i), ReplacedInertia(float(model.body_mass[i])))
        inertia = R @ np.diag(model.body_inertia[i] / own.factor) @ R.T if own.inertia is None else own.inertia
        return own.mass, 0.5 * (inertia + inertia.T)

    def _joints_of(self, i: int, parent: int, numbers: range, name: str) -> tuple[list[ImportedJoint], Vector]:
        """Return the joints of a body, and the point of the body, in its axes, at which the last frame is."""
        model = self.file.model
        at, rotation = model.body_pos[i] + self.shift[parent], rotation_of(model.body_quat[i])
        joints, anchor = list[ImportedJoint](), np.zeros(3)
        for j in numbers:
            kind, q0, axis = int(model.jnt_type[j]), float(model.qpos0[model.jnt_qposadr[j]]), model.jnt_axis[j].copy()
            default = name if len(numbers) == 1 else f"{name}_{j - numbers[0] + 1}"
            own = self.new_name(self.joint_names, "JOINT", j, default)
            if kind == FREE:
                start = model.qpos0[model.jnt_qposadr[j] :][:7].copy()
                joint = ImportedJoint(kind="Floating", name=own, at=np.zeros(3), rotation=np.eye(3), start=start)
            elif kind == SLIDE:
                at = at - rotation @ axis * q0
                joint = ImportedJoint(kind="Translational", name=own, at=at, rotation=rotation, axis=axis)
            else:
                at, anchor = at + rotation @ (model.jnt_pos[j] - anchor), model.jnt_pos[j].copy()
                if kind == HINGE:
                    turned = rotation @ rotation_about(axis, -q0) if q0 else rotation
                    joint = ImportedJoint(kind="Revolute", name=own, at=at, rotation=turned, axis=axis)
                else:
                    joint = ImportedJoint(kind="Spherical", name=own, at=at, rotation=rotation)
            if joint.has_one_coordinate:
                joint.start = np.array([q0])
            self._set_properties(j, joint)
            joints.append(joint)
            at, rotation = np.zeros(3), np.eye(3)
        return joints or [ImportedJoint(kind="Weld", at=at, rotation=rotation)], anchor

    def _set_properties(self, j: int, joint: ImportedJoint) -> None:
        """Set spring, damper, friction, armature and range of a joint."""
        model, losses = self.file.model, self.losses
        v = int(model.jnt_dofadr[j])
        own = slice(v, v + {FREE: 6, BALL: 3}.get(int(model.jnt_type[j]), 1))
        stiffness, damping = float(model.jnt_stiffness[j]), model.dof_damping[own]
        friction, armature = model.dof_frictionloss[own], model.dof_armature[own]
        if joint.has_one_coordinate:
            joint.stiffness, joint.damping = stiffness, float(damping[0])
            joint.unloaded = float(model.qpos_spring[model.jnt_qposadr[j]])
            joint.friction, joint.armature = float(friction[0]), float(armature[0])
        else:
            of_ball: tuple[tuple[Key, Any, tuple[str, ...]], ...] = (
                ("ball spring", stiffness, ("SPRING",)),
                ("ball damping", damping, ("DAMPER",)),
                ("ball friction", friction, ("FRICTIONLOSS", "CONSTRAINT")),
                ("ball armature", armature, ()),
                ("ball range", model.jnt_limited[j], ("LIMIT", "CONSTRAINT")),
            )
            for key, values, flags in of_ball:
                if np.any(values) and not self.file.disables(*flags):
                    losses.add(key, joint.name)
        if self.file.disables("SPRING"):
            joint.stiffness = 0.0
        if self.file.disables("DAMPER"):
            joint.damping = 0.0
        if self.file.disables("FRICTIONLOSS", "CONSTRAINT"):
            joint.friction = 0.0
        is_limited = model.jnt_limited[j] and not self.file.disables("LIMIT", "CONSTRAINT")
        if is_limited and joint.has_one_coordinate and self.file.robot is None:
            lower, upper = map(float, model.jnt_range[j])
            if lower < upper:
                joint.lower, joint.upper = lower, upper
                joint.stop_stiffness = stop_stiffness(model, j, v)
            else:
                losses.add("empty range", joint.name)
        elif self.file.robot is None and model.jnt_range[j][0] > model.jnt_range[j][1]:
            losses.add("reversed range", joint.name)


def stop_stiffness(model: Any, j: int, v: int) -> float:
    """Return the stiffness of the stops of joint j with the coordinate v of MuJoCo."""
    return stiffness_of_range(model.jnt_solref[j], model.jnt_solimp[j], model.dof_invweight0[v])


def stiffness_of_range(solref: Vector, solimp: Vector, inverse_inertia: float) -> float:
    """Return the stiffness of the stops of a range: that of the constraint of MuJoCo in the start position.

    MuJoCo's acceleration at the penetration x is -k x with k = 1 / (dmax tc zeta)^2 (time constant tc, damping ratio
    zeta, largest impedance dmax), or -solref[0] / dmax^2 if solref is negative. The effective inertia is that of
    ``dof_invweight0`` or ``tendon_invweight0``.
    """
    time, ratio = map(float, solref)
    largest = float(solimp[1]) or 1.0
    scale = largest * time * ratio  # powers and divisions by zero would raise exceptions for extreme numbers
    rate = 1.0 / scale / scale if time > 0.0 and scale > 0.0 else abs(time) / largest / largest
    return rate / (float(inverse_inertia) or 1.0)

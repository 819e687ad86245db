"""Drives: actuators of MuJoCo, and inputs on the joints of URDF files."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import numpy as np

from .description import Description, ImportedDrive, ImportedJoint
from .losses import Losses, listed
from .names import Names
from .tree import Tree

MAX_GROUP = 30  # of actuators that a file can disable
UNITS = {"Revolute": "N.m", "Translational": "N"}
FORCES = {"Revolute": "torque", "Translational": "force"}


class Drives:
    """Adds the drives of joints to a description.

    ``undriven`` are the names of joints that follow others or are locked.
    """

    def __init__(self, tree: Tree, description: Description, losses: Losses, names: Names, undriven: set[str]) -> None:
        self.tree, self.description, self.losses, self.names = tree, description, losses, names
        self.model, self.undriven = tree.file.model, undriven

    def add(self) -> None:
        """Add everything."""
        self.add_rotors()
        if not self.tree.file.disables("ACTUATION"):
            self.add_actuators()
        if self.tree.file.robot is not None:
            self.add_inputs_of_joints(self.tree.file.robot)

    def is_on_joint(self, k: int) -> bool:
        """Whether an actuator acts on a joint."""
        return int(self.model.actuator_trntype[k]) <= 1

    def driven(self, k: int) -> tuple[str, ImportedJoint]:
        """Return the body and the joint on which an actuator acts."""
        return self.tree.of_joint[int(self.model.actuator_trnid[k][0])]

    def gear_of(self, k: int) -> float:
        """Return the first gear ratio of an actuator."""
        return float(self.model.actuator_gear[int(self.model.actuator_outadr[k])][0])

    def name_of(self, k: int) -> str:
        """Return the name of an actuator."""
        return self.tree.name_of("ACTUATOR", k) or f"actuator{k + 1}"

    def add_rotors(self) -> None:
        """Add the armature and damping of actuators, times the square of the gear ratio, to those of the joints."""
        model, has_damping = self.model, not self.tree.file.disables("DAMPER")
        for k in range(model.nactuator):
            armature, damping = float(model.actuator_armature[k]), float(model.actuator_damping[k]) * has_damping
            if not (armature or damping):
                continue
            if not self.is_on_joint(k):
                self.losses.add("tendon range", self.name_of(k))
                continue
            joint = self.driven(k)[1]
            if joint.has_one_coordinate:
                joint.armature += armature * self.gear_of(k) ** 2
                joint.damping += damping * self.gear_of(k) ** 2
            else:
                self.losses.add("ball armature" if armature else "ball damping", joint.name)

    def add_actuators(self) -> None:
        """Add actuators on hinges and slides whose force is gain * control + an affine function of the coordinate."""
        model, disabled = self.model, []
        for k in range(model.nactuator):
            name, group = self.name_of(k), int(model.actuator_group[k])
            if 0 <= group <= MAX_GROUP and int(model.opt.disableactuator) >> group & 1:
                disabled.append(name)
                continue
            law = int(model.actuator_dyntype[k]), int(model.actuator_gaintype[k])
            if law != (0, 0) or int(model.actuator_biastype[k]) > 1:
                self.losses.add("actuator", name)
            elif not self.is_on_joint(k) or not self.driven(k)[1].has_one_coordinate:
                self.losses.add("transmission", name)
            elif self.driven(k)[1].is_locked:
                self.losses.add("locked drive", name)
            else:
                self.add_actuator(k, name)
        if disabled:
            self.losses.note(
                f"actuators are disabled by the file ({listed(disabled)})",
                "They have no input. Their groups are in the attribute actuatorgroupdisable",
            )

    def add_actuator(self, k: int, name: str) -> None:
        """Add an actuator: gear (gain u + b0 + b1 gear q + b2 gear v) along the coordinate q."""
        model = self.model
        gear, gain = self.gear_of(k), float(model.actuator_gainprm[k][0])
        bias = model.actuator_biasprm[k][:3] if int(model.actuator_biastype[k]) == 1 else np.zeros(3)
        body, joint = self.driven(k)
        if bias[1] > 0.0 or bias[2] > 0.0:
            self.losses.add("unstable servo", name)
        is_force = gear * gain == 1.0 and not np.any(bias)
        own = self.tree.new_name(self.names, "ACTUATOR", k, name)
        self.description.drives.append(
            ImportedDrive(
                name=own,
                body=body,
                joint=joint.name,
                input=f"{own}.{FORCES[joint.kind] if is_force else 'control'}",
                unit=UNITS[joint.kind] if is_force else "1",
                description=f"Control of {own}, which drives {joint.name}",
                gain=gear * gain,
                bias=gear * float(bias[0]),
                stiffness=max(0.0, -float(bias[1]) * gear**2),
                damping=max(0.0, -float(bias[2]) * gear**2),
                limits=self.limits(k, name, gear, gain, has_bias=bool(np.any(bias))),
            )
        )

    def limits(self, k: int, name: str, gear: float, gain: float, *, has_bias: bool) -> tuple[float, float] | None:
        """Return the limits of the force of an actuator on its joint; None: it has none."""
        model, j, control = self.model, int(self.model.actuator_trnid[k][0]), int(self.model.actuator_ctrladr[k])
        found = []
        if model.actuator_ctrllimited[control] and not self.tree.file.disables("CLAMPCTRL"):
            found.append(gear * gain * model.actuator_ctrlrange[control])
        of_force = [gear * model.actuator_forcerange[k]] if model.actuator_forcelimited[k] else []
        if model.jnt_actfrclimited[j]:
            of_force.append(model.jnt_actfrcrange[j])
        others = sum(self.is_on_joint(i) and int(model.actuator_trnid[i][0]) == j for i in range(model.nactuator)) > 1
        if of_force and (has_bias or (others and model.jnt_actfrclimited[j])):
            self.losses.add("actuator limits", name)
        else:
            found += of_force
        ranges = model.actuator_ctrlrange[control], model.actuator_forcerange[k], model.jnt_actfrcrange[j]
        if any(lower > upper for lower, upper in ranges):
            self.losses.add("reversed limits", name)
        if not found:
            return None
        return max(float(min(pair)) for pair in found), min(float(max(pair)) for pair in found)

    def add_inputs_of_joints(self, robot: ElementTree.Element) -> None:
        """Add an input on every joint of a URDF file that does not follow another one."""
        for number, (body, joint) in enumerate(self.tree.of_joint):
            if not joint.has_one_coordinate or joint.name in self.undriven:
                continue
            limits: Any = self.model.jnt_actfrcrange[number] if self.model.jnt_actfrclimited[number] else None
            force = FORCES[joint.kind]
            self.description.drives.append(
                ImportedDrive(
                    name=self.names.new(f"{joint.name}_drive", "drive"),
                    body=body,
                    joint=joint.name,
                    input=f"{joint.name}.{force}",
                    unit=UNITS[joint.kind],
                    description=f"{force.capitalize()} of the drive of {joint.name}",
                    limits=None if limits is None else (float(limits[0]), float(limits[1])),
                )
            )
        mimics = [joint for joint in robot.findall("joint") if joint.find("mimic") is not None]
        moving = [joint for joint in mimics if joint.get("type") != "fixed"]
        for element in moving[self.tree.file.model.neq :]:
            self.losses.add("mimic", element.get("name", ""))

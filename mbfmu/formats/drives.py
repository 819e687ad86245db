"""Drives: actuators of MuJoCo, and inputs on the joints of URDF files."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import numpy as np

from .description import Description, ImportedDrive, ImportedJoint, ImportedTransmission
from .losses import Losses, listed
from .names import Names
from .tendons import Tendons
from .tree import Tree

MAX_GROUP = 30  # of actuators that a file can disable
UNITS = {"Revolute": "N.m", "Translational": "N"}
FORCES = {"Revolute": "torque", "Translational": "force"}
Limits = tuple[float, float]


def scaled(limits: Any, factor: float) -> Limits:
    """Return limits of a quantity times a factor, the smaller one first."""
    lower, upper = sorted(factor * float(limit) for limit in limits)
    return lower, upper


class Drives:
    """Adds the drives of joints to a description.

    ``undriven`` are the names of joints that follow others or are locked.
    """

    def __init__(
        self,
        tree: Tree,
        description: Description,
        losses: Losses,
        names: Names,
        undriven: set[str],
        tendons: Tendons,
    ) -> None:
        self.tree, self.description, self.losses, self.names = tree, description, losses, names
        self.model, self.undriven, self.tendons = tree.file.model, undriven, tendons

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

    def is_on_tendon(self, k: int) -> bool:
        """Whether an actuator acts on a tendon."""
        return int(self.model.actuator_trntype[k]) == int(self.tree.file.mujoco.mjtTrn.mjTRN_TENDON)

    def target(self, k: int) -> int:
        """Return the number of the joint or of the tendon on which an actuator acts."""
        return int(self.model.actuator_trnid[k][0])

    def driven(self, k: int) -> tuple[str, ImportedJoint]:
        """Return the body and the joint on which an actuator acts."""
        return self.tree.of_joint[self.target(k)]

    def joints_of(self, k: int) -> list[int]:
        """Return the numbers of the joints on which an actuator acts, also by a fixed tendon."""
        if self.is_on_joint(k):
            return [self.target(k)]
        return self.tendons.path_of(self.target(k))[1] if self.is_on_tendon(k) else []

    def terms_of(self, k: int) -> list[tuple[str, ImportedJoint, float]] | None:
        """Return bodies and joints on which an actuator acts, with the factors of its length; None: on other things."""
        if self.is_on_joint(k):
            body, joint = self.driven(k)
            return [(body, joint, 1.0)] if joint.has_one_coordinate else None
        terms = self.tendons.driven_terms(self.target(k)) if self.is_on_tendon(k) else None
        return None if terms is None else [(term.body, term.joint, term.factor) for term in terms]

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
                self.losses.add("tendon friction", self.name_of(k))
                continue
            joint = self.driven(k)[1]
            if joint.has_one_coordinate:
                joint.armature += armature * self.gear_of(k) * self.gear_of(k)
                joint.damping += damping * self.gear_of(k) * self.gear_of(k)
            else:
                self.losses.add("ball armature" if armature else "ball damping", joint.name)

    def add_actuators(self) -> None:
        """Add actuators on hinges, slides and fixed tendons: gain * control + an affine function of their length."""
        model, disabled = self.model, []
        for k in range(model.nactuator):
            name, group = self.name_of(k), int(model.actuator_group[k])
            if 0 <= group <= MAX_GROUP and int(model.opt.disableactuator) >> group & 1:
                disabled.append(name)
                continue
            law = int(model.actuator_dyntype[k]), int(model.actuator_gaintype[k])
            if law != (0, 0) or int(model.actuator_biastype[k]) > 1:
                self.losses.add("actuator", name)
                continue
            terms = self.terms_of(k)
            if terms is None:
                self.losses.add("transmission", name)
            elif terms[0][1].is_locked:
                self.losses.add("locked drive", name)
            else:
                self.add_actuator(k, name, terms)
        if disabled:
            self.losses.note(
                f"actuators are disabled by the file ({listed(disabled)})",
                "They have no input. Their groups are in the attribute actuatorgroupdisable",
            )

    def add_actuator(self, k: int, name: str, terms: list[tuple[str, ImportedJoint, float]]) -> None:
        """Add an actuator: gear (gain u + b0 + b1 gear L + b2 gear L') along its length L."""
        model = self.model
        gear, gain = self.gear_of(k), float(model.actuator_gainprm[k][0])
        bias = model.actuator_biasprm[k][:3] if int(model.actuator_biastype[k]) == 1 else np.zeros(3)
        own = self.tree.new_name(self.names, "ACTUATOR", k, name)
        body, joint, factor = terms[0]
        is_force = gear * gain == 1.0 and not np.any(bias) and len(terms) == 1 and factor == 1.0
        coefficients: dict[str, Any] = {
            "name": own,
            "input": f"{own}.{FORCES[joint.kind] if is_force else 'control'}",
            "unit": UNITS[joint.kind] if is_force else "1",
            "description": f"Control of {own}, which drives {', '.join(joint.name for _, joint, _ in terms)}",
            "gain": gear * gain,
            "bias": gear * float(bias[0]),
            "stiffness": -float(bias[1]) * gear * gear + 0.0,
            "damping": -float(bias[2]) * gear * gear + 0.0,
        }
        of_control, of_force = self.control_limits(k), self.force_limits(k, name, gear)
        ranges = [model.actuator_ctrlrange[int(model.actuator_ctrladr[k])], model.actuator_forcerange[k]]
        ranges += [model.jnt_actfrcrange[j] for j in self.joints_of(k)]
        if any(lower > upper for lower, upper in ranges):
            self.losses.add("reversed limits", name)
        is_servo = bool(coefficients["stiffness"] or coefficients["damping"])
        is_simple = not is_servo or (of_force is None and bias[1] <= 0.0 and bias[2] <= 0.0)
        if len(terms) == 1 and factor == 1.0 and is_simple and not (of_force and bias[0]):
            found = [of_force] if of_force else []
            found += [scaled(of_control, gear * gain)] if of_control else []
            limits = self.common(name, found)
            self.description.drives.append(ImportedDrive(**coefficients, body=body, joint=joint.name, limits=limits))
            return
        self.description.transmissions.append(
            ImportedTransmission(
                **coefficients,
                bodies=[body for body, _, _ in terms],
                factors=tuple(factor for _, _, factor in terms),
                control_limits=of_control,
                limits=of_force,
            )
        )

    def control_limits(self, k: int) -> Limits | None:
        """Return the limits of the control of an actuator; None: it has none."""
        own = int(self.model.actuator_ctrladr[k])
        if not self.model.actuator_ctrllimited[own] or self.tree.file.disables("CLAMPCTRL"):
            return None
        return scaled(self.model.actuator_ctrlrange[own], 1.0)

    def force_limits(self, k: int, name: str, gear: float) -> Limits | None:
        """Return the limits of the force of an actuator along its length; None: it has none."""
        model = self.model
        found = [scaled(model.actuator_forcerange[k], gear)] if model.actuator_forcelimited[k] else []
        joints = self.joints_of(k)
        limited = [j for j in joints if model.jnt_actfrclimited[j]]
        others = [i for i in range(model.nactuator) if i != k]
        is_shared = any(set(self.joints_of(i)) & set(limited) for i in others)
        if self.is_on_joint(k) and limited and not is_shared:
            found.append(scaled(model.jnt_actfrcrange[limited[0]], 1.0))
        elif limited:
            self.losses.add("actuator limits", name)
        if self.is_on_tendon(k) and model.tendon_actfrclimited[self.target(k)]:
            if any(self.is_on_tendon(i) and self.target(i) == self.target(k) for i in others):
                self.losses.add("actuator limits", name)
            else:
                found.append(scaled(model.tendon_actfrcrange[self.target(k)], gear))
        return self.common(name, found)

    def common(self, name: str, ranges: list[Limits]) -> Limits | None:
        """Return the range that several limits permit; None: there are none, or they exclude each other."""
        if not ranges:
            return None
        lower, upper = max(pair[0] for pair in ranges), min(pair[1] for pair in ranges)
        if lower < upper:
            return lower, upper
        self.losses.add("actuator limits", name)
        return None

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

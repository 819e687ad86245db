"""Loops, couplings, drives, springs and points of a model of MuJoCo."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

import numpy as np

from mbfmu.util.errors import UserError, suggest

from .description import (
    CLOSURES,
    GROUND_NAME,
    Closure,
    Description,
    ImportedCoupling,
    ImportedCut,
    ImportedDrive,
    ImportedJoint,
    ImportedLift,
    ImportedPoint,
    ImportedSpring,
)
from .inertias import rotation_of
from .losses import Losses, listed
from .names import Names
from .tree import Tree

CONNECT, WELD, JOINT = range(3)  # mjtEq
UNITS = {"Revolute": "N.m", "Translational": "N"}
FORCES = {"Revolute": "torque", "Translational": "force"}


def positive_number(text: str) -> float:
    """Return a number of a file; zero if it is no positive finite number."""
    try:
        value = float(text)
    except ValueError:
        return 0.0
    return value if 0.0 < value < np.inf else 0.0


class Relations:
    """Adds to a description what connects, drives and observes the bodies of a tree."""

    def __init__(self, tree: Tree, description: Description, losses: Losses) -> None:
        self.tree, self.description, self.losses = tree, description, losses
        self.model, self.mujoco = tree.file.model, tree.file.mujoco
        self.names = Names(frozenset())
        self.followers: set[str] = set()
        self.add_equalities()
        self.add_drives()
        if tree.file.robot is not None:
            self.add_inputs_of_joints(tree.file.robot)
        self.add_tendons()
        self.add_lifts()
        self.add_sites()

    def place(self, body: int, point: Any) -> Any:
        """Return a point in the frame of a body of the description."""
        return np.asarray(point, float) + self.tree.shift[body]

    def add_equalities(self) -> None:
        """Add cut joints and couplings."""
        if self.tree.file.disables("EQUALITY", "CONSTRAINT"):
            return
        rigid = []
        for number in range(self.model.neq):
            kind = int(self.model.eq_type[number])
            name = self.tree.name_of("EQUALITY", number) or f"equality{number + 1}"
            if kind not in (CONNECT, WELD, JOINT) or (kind == JOINT and self.model.eq_obj2id[number] < 0):
                self.losses.add("equality", name)
            elif not self.model.eq_active0[number]:
                self.losses.add("inactive", name)
            else:
                name = self.tree.new_name(self.names, "EQUALITY", number, name)
                rigid.append(name)
                (self.add_coupling if kind == JOINT else self.add_cut)(number, name)
        if rigid:
            self.losses.note(
                f"equality constraints are rigid ({listed(rigid)})", "solref and solimp of MuJoCo are not used"
            )

    def add_cut(self, number: int, name: str) -> None:
        """Add a cut joint of two bodies or of the sites of two bodies."""
        model, data = self.model, self.model.eq_data[number]
        first, second = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
        is_weld = int(model.eq_type[number]) == WELD
        rotations = np.eye(3), np.eye(3)
        if int(model.eq_objtype[number]) == int(self.mujoco.mjtObj.mjOBJ_SITE):
            points = model.site_pos[first], model.site_pos[second]
            rotations = rotation_of(model.site_quat[first]), rotation_of(model.site_quat[second])
            first, second = int(model.site_bodyid[first]), int(model.site_bodyid[second])
        elif is_weld:  # the anchor is a point of the second body, and then there is its pose in the first one
            points, rotations = (data[3:6], data[0:3]), (rotation_of(data[6:10]), np.eye(3))
        else:
            points = data[0:3], data[3:6]
        bodies = self.tree.of_body[first], self.tree.of_body[second]
        if bodies[0] == bodies[1]:
            self.losses.add("equality", name)
            return
        cut = ImportedCut(
            name=name,
            kind="WeldCutJoint" if is_weld else "SphericalCutJoint",
            a=bodies[0],
            b=bodies[1],
            at_a=self.place(first, points[0]),
            at_b=self.place(second, points[1]),
        )
        if is_weld:
            cut.rotation_a, cut.rotation_b = rotations
        self.description.cuts.append(cut)

    def add_closures(self, closures: Sequence[Closure]) -> None:
        """Add cut joints between the frames of bodies that the user names; raises UserError for other names."""
        known = {self.tree.name_of("BODY", i): i for i in range(self.model.nbody)}
        for closure in closures:
            what = f"closing joint {' '.join(map(str, closure))!r}"
            if len(closure) not in (2, 3):
                raise UserError(f"{what}; allowed: two bodies, and the kind: {', '.join(CLOSURES)}")
            a, b, kind = (*closure, "spherical")[:3]
            for name in (a, b):
                if name not in known:
                    raise UserError(f"{what}: the file has no body {name!r}{suggest(name, filter(None, known))}")
            if kind not in CLOSURES:
                raise UserError(f"{what}: kind {kind!r}{suggest(kind, CLOSURES)}")
            if a == b:
                raise UserError(f"{what} connects a body to itself; it needs two bodies")
            first, second = self.tree.of_body[known[a]], self.tree.of_body[known[b]]
            cut = ImportedCut(
                name=self.names.unique(f"{first}_{second}".replace(GROUND_NAME, "ground")),
                kind=CLOSURES[kind],
                a=first,
                b=second,
                at_a=self.place(known[a], np.zeros(3)),
                at_b=self.place(known[b], np.zeros(3)),
            )
            self.description.cuts.append(cut)

    def add_coupling(self, number: int, name: str) -> None:
        """Add a coupling: y - y0 = polynomial of x - x0, y being the coordinate of the first joint."""
        model, coefficients = self.model, self.model.eq_data[number][:5].copy()
        numbers = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
        (a, follower), (b, leader) = (self.tree.of_joint[j] for j in numbers)
        if not (follower.has_one_coordinate and leader.has_one_coordinate) or not np.any(coefficients[1:]):
            self.losses.add("equality", name)
            return
        y0, x0 = (float(model.qpos0[model.jnt_qposadr[j]]) for j in numbers)
        coefficients[0] += y0
        follower.start = None
        self.followers.add(follower.name)
        self.description.couplings.append(ImportedCoupling(name=name, a=a, b=b, coefficients=coefficients, origin=x0))

    def add_drives(self) -> None:
        """Add actuators on hinges and slides whose force is gain * control + an affine function of the coordinate."""
        model = self.model
        if self.tree.file.disables("ACTUATION"):
            return
        for k in range(model.nu):
            name = self.tree.name_of("ACTUATOR", k) or f"actuator{k + 1}"
            law = int(model.actuator_dyntype[k]), int(model.actuator_gaintype[k])
            if law != (0, 0) or int(model.actuator_biastype[k]) > 1:
                self.losses.add("actuator", name)
                continue
            if int(model.actuator_trntype[k]) > 1 or not self.driven(k).has_one_coordinate:
                self.losses.add("transmission", name)
                continue
            self.add_drive(k, name)

    def driven(self, k: int) -> ImportedJoint:
        """Return the joint of an actuator."""
        return self.tree.of_joint[int(self.model.actuator_trnid[k][0])][1]

    def add_drive(self, k: int, name: str) -> None:
        """Add an actuator: gear (gain u + b0 + b1 gear q + b2 gear v) along the coordinate q."""
        model = self.model
        gear, gain = float(model.actuator_gear[k][0]), float(model.actuator_gainprm[k][0])
        bias = model.actuator_biasprm[k][:3] if int(model.actuator_biastype[k]) == 1 else np.zeros(3)
        body, joint = self.tree.of_joint[int(model.actuator_trnid[k][0])]
        if bias[1] > 0.0 or bias[2] > 0.0:
            self.losses.add("unstable servo", name)
        if np.any(model.actuator_armature[k]) or np.any(model.actuator_damping[k]):
            self.losses.add("actuator", f"armature and damping of {name}")
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
        model, j = self.model, int(self.model.actuator_trnid[k][0])
        found = []
        if model.actuator_ctrllimited[k] and not self.tree.file.disables("CLAMPCTRL"):
            found.append(gear * gain * model.actuator_ctrlrange[k])
        of_force = [gear * model.actuator_forcerange[k]] if model.actuator_forcelimited[k] else []
        if model.jnt_actfrclimited[j]:
            of_force.append(model.jnt_actfrcrange[j])
        others = np.count_nonzero(model.actuator_trnid[:, 0] == j) > 1
        if of_force and (has_bias or (others and model.jnt_actfrclimited[j])):
            self.losses.add("actuator limits", name)
        else:
            found += of_force
        if not found:
            return None
        return max(float(min(pair)) for pair in found), min(float(max(pair)) for pair in found)

    def add_inputs_of_joints(self, robot: ElementTree.Element) -> None:
        """Add an input on every joint of a URDF file that does not follow another one."""
        limits = {joint.get("name"): joint.find("limit") for joint in robot.findall("joint")}
        for number, (body, joint) in enumerate(self.tree.of_joint):
            original = self.tree.name_of("JOINT", number)
            limit = limits.get(original)
            given = {} if limit is None else limit.attrib
            if not joint.has_one_coordinate or joint.name in self.followers:
                continue
            effort, force = positive_number(given.get("effort", "")), FORCES[joint.kind]
            text = f"{force.capitalize()} of the drive of {joint.name}"
            if positive_number(given.get("velocity", "")):
                self.losses.add("velocity limits", joint.name)
            self.description.drives.append(
                ImportedDrive(
                    name=self.names.new(f"{joint.name}_drive", "drive"),
                    body=body,
                    joint=joint.name,
                    input=f"{joint.name}.{force}",
                    unit=UNITS[joint.kind],
                    description=text,
                    limits=(-effort, effort) if effort else None,
                )
            )
        mimics = [joint for joint in robot.findall("joint") if joint.find("mimic") is not None]
        moving = [joint for joint in mimics if joint.get("type") != "fixed"]
        for element in moving[len(self.description.couplings) :]:
            self.losses.add("mimic", element.get("name", ""))

    def add_tendons(self) -> None:
        """Add tendons between two sites as springs."""
        model, wrap_site = self.model, int(self.mujoco.mjtWrap.mjWRAP_SITE)
        for k in range(model.ntendon):
            name = self.tree.name_of("TENDON", k) or f"tendon{k + 1}"
            if model.tendon_limited[k] or model.tendon_frictionloss[k] or model.tendon_armature[k]:
                self.losses.add("tendon range", name)
            stiffness, damping = float(model.tendon_stiffness[k]), float(model.tendon_damping[k])
            if not (stiffness or damping):
                continue
            first, free = int(model.tendon_adr[k]), model.tendon_lengthspring[k]
            path = [int(kind) for kind in model.wrap_type[first : first + int(model.tendon_num[k])]]
            sites = [int(site) for site in model.wrap_objid[first : first + 2]]
            bodies = [int(model.site_bodyid[site]) for site in sites] if path == [wrap_site] * 2 else [0, 0]
            a, b = (self.tree.of_body[body] for body in bodies)
            if a == b or free[0] != free[1] or np.any(model.tendon_stiffnesspoly[k]):
                self.losses.add("tendon", name)
                continue
            at_a, at_b = (self.place(body, model.site_pos[site]) for body, site in zip(bodies, sites, strict=True))
            own = self.tree.new_name(self.tree.joint_names, "TENDON", k, name)
            self.description.springs.append(
                ImportedSpring(
                    name=own,
                    a=a,
                    b=b,
                    at_a=at_a,
                    at_b=at_b,
                    stiffness=stiffness,
                    damping=damping,
                    unloaded=float(free[0]),
                )
            )

    def add_lifts(self) -> None:
        """Add gravity compensation: a force against the weight at the center of mass."""
        for i in map(int, np.flatnonzero(self.model.body_gravcomp)):
            force = -self.model.body_gravcomp[i] * self.model.body_mass[i] * self.description.gravity
            if np.any(force):
                body = self.tree.of_body[i]
                name = self.names.new(f"{body}_gravity_compensation", "compensation")
                at = self.place(i, self.model.body_ipos[i])
                self.description.lifts.append(ImportedLift(name=name, body=body, at=at, force=force))

    def add_sites(self) -> None:
        """Add the sites of moving bodies as points."""
        names = Names(frozenset(self.description.ends))
        for k in range(self.model.nsite):
            body = int(self.model.site_bodyid[k])
            if body:
                name = self.tree.new_name(names, "SITE", k, f"site{k + 1}")
                at = self.place(body, self.model.site_pos[k])
                self.description.points.append(ImportedPoint(name=name, body=self.tree.of_body[body], at=at))

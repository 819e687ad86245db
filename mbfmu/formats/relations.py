"""Loops, couplings, drives, springs and points of a model of MuJoCo."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.util.errors import UserError, suggest

from .closures import CLOSURES, Closures, closures_of
from .description import (
    GROUND_NAME,
    Description,
    ImportedCoupling,
    ImportedCut,
    ImportedJoint,
    ImportedLift,
    ImportedPoint,
)
from .drives import Drives
from .inertias import rotation_of
from .losses import Losses, listed
from .names import Names
from .tendons import Tendons
from .tree import Tree

CONNECT, WELD, JOINT, TENDON = range(4)  # mjtEq
TORQUE_SCALE = 10  # number in the data of a weld


class Relations:
    """Adds to a description what connects, drives and observes the bodies of a tree."""

    def __init__(self, tree: Tree, description: Description, losses: Losses) -> None:
        self.tree, self.description, self.losses = tree, description, losses
        self.model, self.mujoco = tree.file.model, tree.file.mujoco
        self.names = Names(frozenset())
        self.undriven: set[str] = set()  # joints that follow others or are locked
        self.tendons = Tendons(tree, description, losses)
        self.add_equalities()
        Drives(tree, description, losses, self.names, self.undriven, self.tendons).add()
        self.tendons.add_forces()
        self.add_lifts()
        self.add_sites()

    def place(self, body: int, point: Any) -> Any:
        """Return a point in the frame of a body of the description."""
        return np.asarray(point, float) + self.tree.shift[body]

    def add_equalities(self) -> None:
        """Add cut joints and couplings."""
        if self.tree.file.disables("EQUALITY", "CONSTRAINT"):
            return
        for number in range(self.model.neq):
            kind = int(self.model.eq_type[number])
            name = self.tree.name_of("EQUALITY", number) or f"equality{number + 1}"
            if kind not in (CONNECT, WELD, JOINT, TENDON):
                self.losses.add("equality", name)
            elif not self.model.eq_active0[number]:
                self.losses.add("inactive", name)
            else:
                name = self.tree.new_name(self.names, "EQUALITY", number, name)
                add = {JOINT: self.add_coupling, TENDON: self.add_tendon_coupling}.get(kind, self.add_cut)
                add(number, name)
        rigid = [cut.name for cut in self.description.cuts] + [own.name for own in self.description.couplings]
        if rigid:
            self.losses.note(
                f"equality constraints are rigid ({listed(rigid)})", "solref and solimp of MuJoCo are not used"
            )

    def add_cut(self, number: int, name: str) -> None:
        """Add a cut joint of two bodies or of the sites of two bodies."""
        model, data = self.model, self.model.eq_data[number]
        first, second = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
        of_weld = int(model.eq_type[number]) == WELD
        is_weld = of_weld and data[TORQUE_SCALE] != 0.0  # without it a weld holds a point only
        rotations = np.eye(3), np.eye(3)
        if int(model.eq_objtype[number]) == int(self.mujoco.mjtObj.mjOBJ_SITE):
            points = model.site_pos[first], model.site_pos[second]
            rotations = rotation_of(model.site_quat[first]), rotation_of(model.site_quat[second])
            first, second = int(model.site_bodyid[first]), int(model.site_bodyid[second])
        elif of_weld:  # the anchor is a point of the second body, and then there is its pose in the first one
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

    def add_closures(self, closures: Closures) -> None:
        """Add cut joints between bodies that the user names; raises UserError for other names."""
        known = {self.tree.name_of("BODY", i): i for i in range(self.model.nbody)}
        for closure in closures_of(closures):
            for name in (closure.a, closure.b):
                if name not in known:
                    raise UserError(
                        f"closing joint {f'{closure.a} {closure.b}'!r}: the file has no body {name!r}"
                        f"{suggest(name, filter(None, known))}"
                    )
            first, second = self.tree.of_body[known[closure.a]], self.tree.of_body[known[closure.b]]
            rotations = closure.rotations()
            cut = ImportedCut(
                name=self.names.unique(f"{first}_{second}".replace(GROUND_NAME, "ground")),
                kind=CLOSURES[closure.joint],
                a=first,
                b=second,
                at_a=self.place(known[closure.a], closure.at_a),
                at_b=self.place(known[closure.b], closure.at_b),
                rotation_a=rotations[0],
                rotation_b=rotations[1],
            )
            self.description.cuts.append(cut)

    def add_coupling(self, number: int, name: str) -> None:
        """Add a coupling of joints: y - y0 = polynomial of x - x0, y being the coordinate of the first joint."""
        model, coefficients = self.model, self.model.eq_data[number][:5].copy()
        first, second = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
        coefficients[0] += float(model.qpos0[model.jnt_qposadr[first]])
        joints = [self.tree.of_joint[first], *([self.tree.of_joint[second]] if second >= 0 else [])]
        origin = float(model.qpos0[model.jnt_qposadr[second]]) if second >= 0 else 0.0
        self.couple(name, joints, coefficients, origin)

    def add_tendon_coupling(self, number: int, name: str) -> None:
        """Add an equality constraint of fixed tendons as a coupling of two joints."""
        model = self.model
        first, second = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
        found = self.tendons.equation(first, second, model.eq_data[number][:5])
        if found is None:
            self.losses.add("tendon equality", name)
            return
        terms, coefficients, origin = found
        self.couple(name, [(term.body, term.joint) for term in terms], coefficients, origin)

    def couple(self, name: str, joints: list[tuple[str, ImportedJoint]], coefficients: Any, origin: float) -> None:
        """Add a coupling: coordinate of the first joint = polynomial of (coordinate of the second - origin)."""
        a, follower = joints[0]
        if len(joints) == 1 or not np.any(coefficients[1:]):
            self.lock(follower, float(coefficients[0]), name)
            return
        b, leader = joints[1]
        if not (follower.has_one_coordinate and leader.has_one_coordinate):
            self.losses.add("equality", name)
            return
        if not follower.is_locked:
            follower.start = None
        self.undriven.add(follower.name)
        self.description.couplings.append(
            ImportedCoupling(name=name, a=a, b=b, coefficients=coefficients, origin=origin)
        )

    def lock(self, joint: ImportedJoint, position: float, name: str) -> None:
        """Lock a joint at a position; forces on it have no effect then."""
        if not joint.has_one_coordinate or joint.is_locked:
            self.losses.add("equality", name)
            return
        joint.is_locked, joint.start = True, np.array([position])
        joint.stiffness = joint.damping = joint.friction = joint.armature = 0.0
        joint.lower = joint.upper = None
        self.undriven.add(joint.name)
        self.losses.note(
            f"joint {joint.name} is locked by the equality constraint {name}",
            "Its springs, dampers, friction, ranges and drives are left out, since they have no effect",
        )

    def add_lifts(self) -> None:
        """Add gravity compensation: a force against the weight at the center of mass."""
        for i in map(int, np.flatnonzero(self.model.body_gravcomp)):
            with np.errstate(over="ignore"):  # which is reported as a number that is not finite
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

"""Tendons of a model of MuJoCo.

A fixed tendon is a linear combination of joint coordinates, L = sum of c_k q_k, on which springs, actuators and
equality constraints act. A spatial tendon between two sites is a spring or a range of their distance.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .description import (
    Description,
    ImportedDistanceRange,
    ImportedJoint,
    ImportedSpring,
    ImportedTransmission,
    Vector,
)
from .losses import Losses
from .tree import Tree, stiffness_of_range

MAX_TENDON_JOINTS = 3  # of a force with two sources for each joint, an input and a constant, see MAX_QUANTITIES


class Term(NamedTuple):
    """Term c q of a linear combination: body and joint of the coordinate q, its value in ``qpos0``, and c."""

    body: str
    joint: ImportedJoint
    origin: float
    factor: float


class Ends(NamedTuple):
    """Points of two bodies."""

    a: str
    b: str
    at_a: Vector
    at_b: Vector


class Tendons:
    """Reads tendons."""

    def __init__(self, tree: Tree, description: Description, losses: Losses) -> None:
        self.tree, self.description, self.losses = tree, description, losses
        self.model, mujoco = tree.file.model, tree.file.mujoco
        self.of_joint, self.of_site = int(mujoco.mjtWrap.mjWRAP_JOINT), int(mujoco.mjtWrap.mjWRAP_SITE)

    def name_of(self, k: int) -> str:
        """Return the name of a tendon."""
        return self.tree.name_of("TENDON", k) or f"tendon{k + 1}"

    def path_of(self, k: int) -> tuple[list[int], list[int], Vector]:
        """Return kinds, numbers and parameters of the elements of a tendon."""
        first = int(self.model.tendon_adr[k])
        own = slice(first, first + int(self.model.tendon_num[k]))
        kinds, numbers = ([int(i) for i in array[own]] for array in (self.model.wrap_type, self.model.wrap_objid))
        return kinds, numbers, self.model.wrap_prm[own]

    def terms(self, k: int) -> list[Term] | None:
        """Return the terms of a fixed tendon with factors other than zero; None: the tendon is spatial."""
        kinds, joints, factors = self.path_of(k)
        if any(kind != self.of_joint for kind in kinds):
            return None
        found = [(j, float(factor)) for j, factor in zip(joints, factors, strict=True) if factor]
        origins = {j: float(self.model.qpos0[self.model.jnt_qposadr[j]]) for j in joints}
        return [Term(*self.tree.of_joint[j], origins[j], factor) for j, factor in found]

    def driven_terms(self, k: int) -> list[Term] | None:
        """Return the terms of a fixed tendon on which a force can act; None: it cannot."""
        terms = self.terms(k)
        if not terms or len(terms) > MAX_TENDON_JOINTS or any(term.joint.is_locked for term in terms):
            return None
        return terms

    def add_forces(self) -> None:
        """Add springs and ranges."""
        model, file = self.model, self.tree.file
        has_springs, has_dampers = (not file.disables(flag) for flag in ("SPRING", "DAMPER"))
        for k in range(model.ntendon):
            stiffness = float(model.tendon_stiffness[k]) * has_springs
            damping = float(model.tendon_damping[k]) * has_dampers
            if stiffness and np.ptp(model.tendon_lengthspring[k]):
                self.losses.add("unloaded range", self.name_of(k))
            elif (stiffness or damping) and not self._add_spring(k, stiffness, damping):
                self.losses.add("tendon", self.name_of(k))
            is_limited = model.tendon_limited[k] and not file.disables("LIMIT", "CONSTRAINT")
            if is_limited and not self._add_range(k):
                self.losses.add("tendon range", self.name_of(k))

    def _add_spring(self, k: int, stiffness: float, damping: float) -> bool:
        """Add the spring of a tendon; return whether it has a counterpart."""
        unloaded = float(self.model.tendon_lengthspring[k][0])
        ends, terms = self._ends(k), self.driven_terms(k)
        if ends is not None:
            self.description.springs.append(
                ImportedSpring(
                    name=self._new_name(k),
                    stiffness=stiffness,
                    damping=damping,
                    unloaded=unloaded,
                    **ends._asdict(),
                )
            )
        elif terms is not None:
            self.description.transmissions.append(
                ImportedTransmission(
                    name=self._new_name(k),
                    description="",
                    bodies=[term.body for term in terms],
                    factors=tuple(term.factor for term in terms),
                    bias=stiffness * unloaded,
                    stiffness=stiffness,
                    damping=damping,
                )
            )
        return ends is not None or terms is not None

    def _add_range(self, k: int) -> bool:
        """Add the range of the length of a tendon; return whether it has a counterpart."""
        lower, upper = map(float, self.model.tendon_range[k])
        ends = self._ends(k)
        if ends is None or not lower < upper or upper <= 0.0:
            return False
        model = self.model
        self.description.distance_ranges.append(
            ImportedDistanceRange(
                name=self._new_name(k),
                lower=lower if lower > 0.0 else None,
                upper=upper,
                stiffness=stiffness_of_range(
                    model.tendon_solref_lim[k], model.tendon_solimp_lim[k], model.tendon_invweight0[k]
                ),
                **ends._asdict(),
            )
        )
        return True

    def _ends(self, k: int) -> Ends | None:
        """Return the points of a tendon between two sites of different bodies; None: it has another path."""
        kinds, sites, _ = self.path_of(k)
        if kinds != [self.of_site] * 2:
            return None
        bodies = [int(self.model.site_bodyid[site]) for site in sites]
        a, b = (self.tree.of_body[body] for body in bodies)
        at_a, at_b = (self.model.site_pos[i] + self.tree.shift[j] for i, j in zip(sites, bodies, strict=True))
        return Ends(a, b, at_a, at_b) if a != b else None

    def _new_name(self, k: int) -> str:
        return self.tree.new_name(self.tree.joint_names, "TENDON", k, self.name_of(k))

    def equation(self, first: int, second: int, polynomial: Any) -> tuple[list[Term], Vector, float] | None:
        """Return an equality constraint of one or two tendons as a polynomial between two joint coordinates.

        Parameters
        ----------
        first, second
            Numbers of the tendons; negative: there is no second one. The constraint is L1 - L1_0 = p(L2 - L2_0).
        polynomial
            Coefficients of p, in rising order (5,).

        Returns
        -------
        tuple or None
            Joints of the first coordinate and, if there is one, of the second; coefficients (5,) of the first
            coordinate as a polynomial of (second coordinate - origin), and the origin. None: it has no such form.
        """
        p = np.array(polynomial, float)
        own, others = self.terms(first), self.terms(second) if second >= 0 and np.any(p[1:]) else []
        if not own or others is None:
            return None
        if not others:
            p[1:] = 0.0
        constant = p[0] + sum(term.factor * term.origin for term in own)
        joined = {id(term.joint) for term in own} & {id(term.joint) for term in others}
        if others and len(own) == len(others) == 1 and not joined:
            (x,), c = others, own[0].factor
            with np.errstate(over="ignore", invalid="ignore"):  # which is reported as a number that is not finite
                coefficients = p * x.factor ** np.arange(5) / c
            return [own[0], x], coefficients + np.eye(5)[0] * (constant - p[0]) / c, x.origin
        if np.any(p[2:]) or joined:
            return None
        constant -= p[1] * sum(term.factor * term.origin for term in others)
        terms = [*own, *(term._replace(factor=-p[1] * term.factor) for term in others)]
        if len(terms) > 2:
            return None
        y, c = terms[-1], terms[-1].factor  # the last coordinate follows the first one
        slope = -terms[0].factor / c if len(terms) == 2 else 0.0
        return [y, *terms[:-1]], np.array((constant / c, slope, 0.0, 0.0, 0.0)), 0.0

"""Random trees by mbfmu."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.mechanics import (
    CompiledMechanism,
    Cylindrical,
    Mechanism,
    Planar,
    Revolute,
    Spherical,
    Translational,
    Universal,
)
from mbfmu.mechanics.joints import Joint

from .random_trees import Array, Dynamics, Link

AXIAL_JOINTS: dict[str, Any] = {
    "revolute": Revolute,
    "translational": Translational,
    "universal": Universal,
    "cylindrical": Cylindrical,
}


def joint_of(link: Link) -> Joint:
    """Return the joint of a link."""
    scalar = len(link.position) == 1
    frame: dict[str, Any] = {
        "at": tuple(link.place),
        "rotation": link.rotation,
        "fixed": True,
        "start": float(link.position[0]) if scalar else tuple(link.position),
        "rate": float(link.rate[0]) if scalar else tuple(link.rate),
    }
    if link.joint == "spherical":
        return Spherical(**frame)
    if link.joint == "planar":
        return Planar(axis="z", **frame)
    if link.joint == "universal":
        frame["second"] = tuple(link.second)
    made: Joint = AXIAL_JOINTS[link.joint](axis=tuple(link.axis), **frame)
    return made


def build(links: list[Link], gravity: Array) -> Mechanism:
    """Return the mechanism."""
    m = Mechanism(gravity=tuple(gravity))
    bodies: list[Any] = []
    for k, link in enumerate(links):
        parent = m.ground if link.parent < 0 else bodies[link.parent]
        solid: dict[str, Any] = {"mass": link.mass, "com": tuple(link.com), "inertia": link.inertia}
        bodies.append(m.body(f"link{k}", parent, joint_of(link), **solid))
    return m


def evaluate(links: list[Link], gravity: Array) -> Dynamics:
    """Return mass matrix and accelerations at the start."""
    compiled = CompiledMechanism(build(links, gravity))
    q, v = compiled.assemble()
    terms = compiled.system.allocate_terms()
    compiled.system.fill(0.0, q, v, terms)
    return Dynamics(np.array(terms.M), np.linalg.solve(terms.M, -terms.h))

"""Random trees by mbfmu."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.mechanics import CompiledMechanism, Mechanism, Revolute, Spherical, Translational

from .random_trees import Array, Dynamics, Link

AXIAL_JOINTS: dict[str, Any] = {"revolute": Revolute, "translational": Translational}


def build(links: list[Link], gravity: Array) -> Mechanism:
    """Return the mechanism."""
    m = Mechanism(gravity=tuple(gravity))
    bodies: list[Any] = []
    for k, link in enumerate(links):
        frame: dict[str, Any] = {"at": tuple(link.place), "rotation": link.rotation, "fixed": True}
        if link.joint == "spherical":
            joint = Spherical(start=tuple(link.position), rate=tuple(link.rate), **frame)
        else:
            state = {"start": float(link.position[0]), "rate": float(link.rate[0])}
            joint = AXIAL_JOINTS[link.joint](axis=tuple(link.axis), **state, **frame)
        parent = m.ground if link.parent < 0 else bodies[link.parent]
        bodies.append(m.body(f"link{k}", parent, joint, mass=link.mass, com=tuple(link.com), inertia=link.inertia))
    return m


def evaluate(links: list[Link], gravity: Array) -> Dynamics:
    """Return mass matrix and accelerations at the start."""
    compiled = CompiledMechanism(build(links, gravity))
    q, v = compiled.assemble()
    terms = compiled.system.allocate_terms()
    compiled.system.fill(0.0, q, v, terms)
    return Dynamics(np.array(terms.M), np.linalg.solve(terms.M, -terms.h))

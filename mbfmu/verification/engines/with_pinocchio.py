"""Random trees by Pinocchio (composite rigid-body and articulated-body algorithms)."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.util.extras import import_optional

from .random_trees import Array, Dynamics, Link


def evaluate(links: list[Link], gravity: Array) -> Dynamics:
    """Return mass matrix and accelerations at the start."""
    pin = import_optional("pinocchio", "bench")
    model = pin.Model()
    model.gravity.linear = gravity
    numbers: list[Any] = []
    q, v = [], []
    for k, link in enumerate(links):
        if link.joint == "spherical":
            joint = pin.JointModelSpherical()
        elif link.joint == "revolute":
            joint = pin.JointModelRevoluteUnaligned(link.axis)
        else:
            joint = pin.JointModelPrismaticUnaligned(link.axis)
        parent = 0 if link.parent < 0 else numbers[link.parent]
        place = pin.SE3(link.rotation, link.place)
        numbers.append(model.addJoint(parent, joint, place, f"link{k}"))
        model.appendBodyToJoint(numbers[-1], pin.Inertia(link.mass, link.com, link.inertia), pin.SE3.Identity())
        q.append(np.roll(link.position, -1))  # scalar last
        v.append(link.rate)
    data, positions, rates = model.createData(), np.concatenate(q), np.concatenate(v)
    M = np.triu(pin.crba(model, data, positions))
    acceleration = np.array(pin.aba(model, data, positions, rates, np.zeros(model.nv)))
    return Dynamics(M + np.triu(M, 1).T, acceleration)

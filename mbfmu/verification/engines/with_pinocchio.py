"""Random trees by Pinocchio (composite rigid-body and articulated-body algorithms)."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.util.extras import import_optional

from .random_trees import Array, Dynamics, Link


def depth_first(links: list[Link]) -> list[int]:
    """Return the order in which the links of a subtree follow each other, as the engine requires it."""
    order: list[int] = []
    waiting = [k for k, link in enumerate(links) if link.parent < 0]
    while waiting:
        order.append(waiting.pop())
        waiting += [k for k, link in enumerate(links) if link.parent == order[-1]]
    return order


def evaluate(links: list[Link], gravity: Array) -> Dynamics:
    """Return mass matrix and accelerations at the start."""
    pin = import_optional("pinocchio", "bench")
    model = pin.Model()
    model.gravity.linear = gravity
    numbers: dict[int, Any] = {-1: 0}
    q, v, places = [], [], [np.zeros(0, int)] * len(links)
    for k in depth_first(links):
        link = links[k]
        number, place = numbers[link.parent], pin.SE3(link.rotation, link.place)
        places[k] = model.nv + np.arange(len(link.rate))
        for i, (kind, axis) in enumerate(link.parts):
            if kind == "spherical":
                joint = pin.JointModelSpherical()
            elif kind == "revolute":
                joint = pin.JointModelRevoluteUnaligned(axis)
            else:
                joint = pin.JointModelPrismaticUnaligned(axis)
            number = model.addJoint(number, joint, place, f"link{k}.{i}")
            place = pin.SE3.Identity()
        numbers[k] = number
        model.appendBodyToJoint(number, pin.Inertia(link.mass, link.com, link.inertia), pin.SE3.Identity())
        q.append(np.roll(link.position, -1) if link.joint == "spherical" else link.position)  # scalar last
        v.append(link.rate)
    data, positions, rates = model.createData(), np.concatenate(q), np.concatenate(v)
    M = np.triu(pin.crba(model, data, positions))
    acceleration = np.array(pin.aba(model, data, positions, rates, np.zeros(model.nv)))
    order = np.concatenate(places)
    return Dynamics((M + np.triu(M, 1).T)[np.ix_(order, order)], acceleration[order])

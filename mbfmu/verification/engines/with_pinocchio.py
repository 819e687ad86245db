"""Random trees by Pinocchio (composite rigid-body and articulated-body algorithms)."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.util.extras import import_optional

from .random_trees import Array, Dynamics, Evaluator, Link


def depth_first(links: list[Link]) -> list[int]:
    """Return the order in which the links of a subtree follow each other, as the engine requires it."""
    order: list[int] = []
    waiting = [k for k, link in enumerate(links) if link.parent < 0]
    while waiting:
        order.append(waiting.pop())
        waiting += [k for k, link in enumerate(links) if link.parent == order[-1]]
    return order


def evaluator(links: list[Link], gravity: Array) -> Evaluator:
    """Return the function that evaluates the dynamics of a tree."""
    pin = import_optional("pinocchio", "bench")
    model = pin.Model()
    model.gravity.linear = gravity
    numbers: dict[int, Any] = {-1: 0}
    positions, rates = [np.zeros(0, int)] * len(links), [np.zeros(0, int)] * len(links)
    for k in depth_first(links):
        link = links[k]
        number, place = numbers[link.parent], pin.SE3(link.rotation, link.place)
        positions[k], rates[k] = model.nq + np.arange(len(link.position)), model.nv + np.arange(len(link.rate))
        if link.joint == "spherical":
            positions[k] = np.roll(positions[k], 1)  # scalar last
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
    data, q, v = model.createData(), np.zeros(model.nq), np.zeros(model.nv)
    q_order, v_order = np.concatenate(positions), np.concatenate(rates)

    def evaluate(position: Array, rate: Array) -> Dynamics:
        q[q_order], v[v_order] = position, rate
        M = np.triu(pin.crba(model, data, q))
        acceleration = np.array(pin.aba(model, data, q, v, np.zeros(model.nv)))
        return Dynamics((M + np.triu(M, 1).T)[np.ix_(v_order, v_order)], acceleration[v_order])

    return evaluate

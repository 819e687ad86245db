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


class Tree:
    """Model of Pinocchio.

    Attributes
    ----------
    pin, model, data
        Package, model and its data.
    numbers
        Number of the joint of each link; of the ground -1: 0.
    q_order, v_order
        Places of the positions and rates of all links, one after the other, in those of the model.
    """

    def __init__(self, links: list[Link], gravity: Array) -> None:
        self.pin = pin = import_optional("pinocchio", "bench")
        self.model = model = pin.Model()
        model.gravity.linear = gravity
        self.numbers: dict[int, Any] = {-1: 0}
        positions, rates = [np.zeros(0, int)] * len(links), [np.zeros(0, int)] * len(links)
        for k in depth_first(links):
            link = links[k]
            number, place = self.numbers[link.parent], pin.SE3(link.rotation, link.place)
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
            self.numbers[k] = number
            model.appendBodyToJoint(number, pin.Inertia(link.mass, link.com, link.inertia), pin.SE3.Identity())
        self.data = model.createData()
        self.q_order, self.v_order = np.concatenate(positions), np.concatenate(rates)

    def state(self, position: Array, rate: Array) -> tuple[Array, Array]:
        """Return positions and rates of all links in the order of the model."""
        q, v = np.zeros(self.model.nq), np.zeros(self.model.nv)
        q[self.q_order], v[self.v_order] = position, rate
        return q, v


def evaluator(links: list[Link], gravity: Array) -> Evaluator:
    """Return the function that evaluates the dynamics of a tree."""
    tree = Tree(links, gravity)
    pin, model, data, order = tree.pin, tree.model, tree.data, tree.v_order

    def evaluate(position: Array, rate: Array) -> Dynamics:
        q, v = tree.state(position, rate)
        M = np.triu(pin.crba(model, data, q))
        acceleration = np.array(pin.aba(model, data, q, v, np.zeros(model.nv)))
        return Dynamics((M + np.triu(M, 1).T)[np.ix_(order, order)], acceleration[order])

    return evaluate

"""Random trees by MuJoCo."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from xml.etree import ElementTree

import numpy as np

from mbfmu.util.extras import import_optional

from .random_trees import Array, Dynamics, Evaluator, Link

MJCF_JOINTS = {"revolute": "hinge", "translational": "slide", "spherical": "ball"}


def listed(numbers: Iterable[float]) -> str:
    """Return numbers as an attribute."""
    return " ".join(repr(float(x)) for x in numbers)


def as_mjcf(links: list[Link], gravity: Array) -> str:
    """Return the MJCF file of a tree; bodies have no shapes."""
    root = ElementTree.Element("mujoco")
    ElementTree.SubElement(root, "compiler", angle="radian")
    ElementTree.SubElement(root, "option", gravity=listed(gravity))
    world = ElementTree.SubElement(root, "worldbody")
    elements: list[Any] = []
    for k, link in enumerate(links):
        x, y = link.rotation[:, 0], link.rotation[:, 1]
        parent = world if link.parent < 0 else elements[link.parent]
        body = ElementTree.SubElement(parent, "body", name=f"link{k}", pos=listed(link.place), xyaxes=listed((*x, *y)))
        I = link.inertia
        full = listed((I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]))
        ElementTree.SubElement(body, "inertial", pos=listed(link.com), mass=repr(link.mass), fullinertia=full)
        for i, (kind, axis) in enumerate(link.parts):
            joint = ElementTree.SubElement(body, "joint", name=f"joint{k}.{i}", type=MJCF_JOINTS[kind])
            if kind != "spherical":
                joint.set("axis", listed(axis))
        elements.append(body)
    return ElementTree.tostring(root, encoding="unicode")


def evaluator(links: list[Link], gravity: Array) -> Evaluator:
    """Return the function that evaluates the dynamics of a tree."""
    mujoco = import_optional("mujoco", "import")
    model = mujoco.MjModel.from_xml_string(as_mjcf(links, gravity))
    data = mujoco.MjData(model)
    positions: list[int] = []
    rates: list[int] = []
    for k, link in enumerate(links):  # joints of a body follow each other
        number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT.value, f"joint{k}.0")
        q, v = int(model.jnt_qposadr[number]), int(model.jnt_dofadr[number])
        positions += range(q, q + len(link.position))
        rates += range(v, v + len(link.rate))

    def evaluate(position: Array, rate: Array) -> Dynamics:
        data.qpos[positions], data.qvel[rates] = position, rate
        mujoco.mj_forward(model, data)
        M = np.zeros((model.nv, model.nv))
        for column, unit in zip(M, np.eye(model.nv), strict=True):
            mujoco.mj_mulM(model, data, column, unit)
        return Dynamics(M[np.ix_(rates, rates)], np.array(data.qacc)[rates])

    return evaluate

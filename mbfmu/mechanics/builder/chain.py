"""A beam as a chain of nodal bodies with relative coordinates and beam elements between them: no modes.

Every node is connected to the previous one by two displacements and a rotation in the x-y plane (bodies without mass
carry the displacements), so the chain may bend as far as it likes and stretch. It is the check of :class:`Beam`, which
is cheaper by far: three coordinates a node, and a fastest motion along the axis that an explicit step must follow.
"""

from __future__ import annotations

from typing import Any

from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.checks import whole
from mbfmu.mechanics.joints import Joint, Revolute, Translational
from mbfmu.mechanics.loads import BeamElement
from mbfmu.mechanics.numbers import positive
from mbfmu.util.errors import UserError


def add_chain(
    m: Mechanism,
    name: str,
    parent: Body,
    joint: Joint,
    *,
    length: float,
    mass: float,
    axial: float,
    bending_stiffness: float,
    elements: int = 10,
    damping: float = 0.0,
) -> tuple[Body, ...]:
    """Add a beam of nodal bodies, along x of its first node, with bending along y.

    Parameters
    ----------
    m
        Mechanism to which the chain is added.
    name
        Name of the nodes ``name[0]``, ``name[1]`` and so on; the first is at x = 0.
    parent, joint
        Body and joint to which the first node is connected.
    length, mass
        Length, m, and mass, kg.
    axial, bending_stiffness
        Axial stiffness E A, N, and bending stiffness E I, N m^2.
    elements
        Number of elements, one less than the nodes.
    damping
        Damping time of the material, s.

    Returns
    -------
    The nodes. Each has the mass of its half elements and their rotary inertia as rigid rods.
    """
    for what, value in (("length", length), ("mass", mass), ("axial", axial), ("bending_stiffness", bending_stiffness)):
        positive(f"{what} of chain {name!r}", value)
    if whole(f"elements of chain {name!r}", elements) < 1:
        raise UserError(f"elements of chain {name!r} are {elements!r}; allowed: at least 1")
    h = length / elements
    nodes = [m.body(f"{name}[0]", parent, joint, **_half_elements(0, elements, length, mass))]
    for i in range(1, elements + 1):
        along = m.body(f"{name}[{i}].x", nodes[-1], Translational(axis="x", at=(h, 0.0, 0.0)))
        across = m.body(f"{name}[{i}].y", along, Translational(axis="y"))
        own = _half_elements(i, elements, length, mass)
        nodes.append(m.body(f"{name}[{i}]", across, Revolute(axis="z"), **own))
        element = BeamElement(length=h, axial=axial, bending_y=bending_stiffness, damping=damping)
        m.force(f"{name}[{i}].element", element, nodes[-2], nodes[-1])
    return tuple(nodes)


def _half_elements(i: int, elements: int, length: float, mass: float) -> dict[str, Any]:
    """Return the mass properties of node i: half an element to each side that has one, as a rigid rod."""
    half = 0.5 * length / elements
    left, right = (half if i > 0 else 0.0), (half if i < elements else 0.0)
    share = mass * (left + right) / length
    transverse = share * (left + right) ** 2 / 12.0
    return {"mass": share, "com": (0.5 * (right - left), 0.0, 0.0), "inertia": (0.0, transverse, transverse)}

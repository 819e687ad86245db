"""Mass properties of uniform solids, to hand to a body: ``m.body("link", m.ground, joint, **rod(mass=1, length=1))``.

Each function returns mass (kg), center of mass (m) and inertia about it (kg m^2) in the body's frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbfmu.mechanics.axes import ORIGIN, unit_axis
from mbfmu.mechanics.checks import Vector, lengths, vector
from mbfmu.mechanics.checks import rotation as rotation_matrix
from mbfmu.mechanics.numbers import finite, not_negative, positive
from mbfmu.util.errors import UserError

Axis = str | Sequence[float]


def rod(*, mass: float, length: float) -> dict[str, Any]:
    """Mass properties of a uniform slender rod along x from the body's origin.

    Parameters
    ----------
    mass
        Mass, kg.
    length
        Length, m; negative: the rod extends along -x.

    Returns
    -------
    dict
        ``mass`` (kg), ``com`` (3,) (m) and ``inertia`` about it (kg m^2), in the body's frame.

    Raises
    ------
    UserError
        A value is not finite.
    """
    mass, length = finite("mass of a rod", mass), finite("length of a rod", length)
    transverse = mass * length * length / 12.0
    return {"mass": mass, "com": (0.5 * length, 0.0, 0.0), "inertia": (0.0, transverse, transverse)}


def box(*, mass: float, size: Vector, com: Vector = ORIGIN, rotation: Any = None) -> dict[str, Any]:
    """Mass properties of a uniform box.

    Parameters
    ----------
    mass
        Mass, kg.
    size
        Lengths of the edges along x, y, z, m.
    com
        Center of the box in the body's frame, m; the body's origin by default.
    rotation
        3x3 rotation matrix whose columns are the directions of the edges; None: the body's axes.

    Returns
    -------
    dict
        ``mass`` (kg), ``com`` (3,) (m) and ``inertia`` about it (kg m^2), in the body's frame.

    Raises
    ------
    UserError
        A mass or a length is negative or not finite.
    """
    x, y, z = lengths("size of a box", size)
    R = rotation_matrix("rotation of a box", rotation)
    principal = not_negative("mass of a box", mass) / 12.0 * np.array((y * y + z * z, z * z + x * x, x * x + y * y))
    return {"mass": float(mass), "com": vector("com of a box", com), "inertia": R @ np.diag(principal) @ R.T}


def cylinder(*, mass: float, radius: float, length: float, axis: Axis = "z", com: Vector = ORIGIN) -> dict[str, Any]:
    """Mass properties of a uniform solid cylinder.

    Parameters
    ----------
    mass
        Mass, kg.
    radius, length
        Radius and length, m.
    axis
        Axis of the cylinder in the body's frame.
    com
        Center of the cylinder in the body's frame, m; the body's origin by default.

    Returns
    -------
    dict
        ``mass`` (kg), ``com`` (3,) (m) and ``inertia`` about it (kg m^2), in the body's frame.

    Raises
    ------
    UserError
        A mass or a length is negative or not finite.
    """
    return _round("cylinder", mass, radius, 0.0, length, axis, com)


def tube(
    *, mass: float, outer: float, inner: float, length: float, axis: Axis = "z", com: Vector = ORIGIN
) -> dict[str, Any]:
    """Mass properties of a uniform hollow cylinder.

    Parameters
    ----------
    mass
        Mass, kg.
    outer, inner
        Outer and inner radius, m; inner is less than outer, or equal for a thin wall.
    length
        Length, m.
    axis, com
        As for :func:`cylinder`.

    Returns
    -------
    dict
        ``mass`` (kg), ``com`` (3,) (m) and ``inertia`` about it (kg m^2), in the body's frame.

    Raises
    ------
    UserError
        A mass or a length is negative or not finite, or the inner radius is the larger one.
    """
    if positive("outer radius of a tube", outer) < positive("inner radius of a tube", inner):
        raise UserError(f"inner radius of a tube is {inner!r} m; allowed: no more than the outer one, {outer!r} m")
    return _round("tube", mass, outer, inner, length, axis, com)


def sphere(*, mass: float, radius: float, com: Vector = ORIGIN) -> dict[str, Any]:
    """Mass properties of a uniform solid sphere.

    Parameters
    ----------
    mass
        Mass, kg.
    radius
        Radius, m.
    com
        Center of the sphere in the body's frame, m; the body's origin by default.

    Returns
    -------
    dict
        ``mass`` (kg), ``com`` (3,) (m) and ``inertia`` about it (kg m^2), in the body's frame.

    Raises
    ------
    UserError
        A mass or a length is negative or not finite.
    """
    r = positive("radius of a sphere", radius)
    moment = 0.4 * not_negative("mass of a sphere", mass) * r * r
    return {"mass": float(mass), "com": vector("com of a sphere", com), "inertia": (moment, moment, moment)}


def _round(
    what: str, mass: float, outer: float, inner: float, length: float, axis: Axis, com: Vector
) -> dict[str, Any]:
    """Mass properties of a cylinder with a bore."""
    long, radius = positive(f"length of a {what}", length), positive(f"radius of a {what}", outer)
    n = unit_axis(axis, f"axis of a {what}")
    square = radius * radius + inner * inner
    about = 0.5 * not_negative(f"mass of a {what}", mass) * square
    across = mass * (3.0 * square + long * long) / 12.0
    inertia = across * np.eye(3) + (about - across) * np.outer(n, n)
    return {"mass": float(mass), "com": vector(f"com of a {what}", com), "inertia": inertia}

"""Random trees of rigid bodies, described by numbers alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
JOINT_NAMES = ("revolute", "translational", "spherical")
MAX_LINKS = 12


class Link(NamedTuple):
    """Rigid body with the joint that connects it to its parent.

    Attributes
    ----------
    parent
        Number of the parent among the links; -1: the ground.
    joint
        ``revolute``, ``translational`` or ``spherical``.
    axis
        Unit vector of the joint (3,), in the joint frame.
    place, rotation
        Position (3,), m, and orientation (3, 3) of the joint frame in the frame of the parent.
    mass, com, inertia
        Mass, kg; center of mass (3,), m; and inertia about it (3, 3), kg m^2, in the frame of the body.
    position, rate
        Coordinate of the joint and its velocity: m, rad, or a unit quaternion (4,), scalar first, and the angular
        velocity (3,) in the frame of the body.
    """

    parent: int
    joint: str
    axis: Array
    place: Array
    rotation: Array
    mass: float
    com: Array
    inertia: Array
    position: Array
    rate: Array


class Dynamics(NamedTuple):
    """Mass matrix (n, n) and accelerations (n,) without applied forces other than gravity, in the order of links."""

    mass_matrix: Array
    acceleration: Array


def random_tree(seed: int) -> tuple[list[Link], Array]:
    """Return the links of a random tree, and the acceleration of gravity (3,), m/s^2."""
    rng = np.random.default_rng(seed)
    links = []
    for k in range(int(rng.integers(1, MAX_LINKS + 1))):
        joint = str(rng.choice(JOINT_NAMES))
        axis = rng.normal(size=3)
        points = rng.normal(size=(5, 3))
        inertia = sum((p @ p) * np.eye(3) - np.outer(p, p) for p in points)
        size = 4 if joint == "spherical" else 1
        position = rng.normal(size=size)
        links.append(
            Link(
                parent=int(rng.integers(-1, k)),
                joint=joint,
                axis=axis / np.linalg.norm(axis),
                place=rng.normal(size=3),
                rotation=random_rotation(rng),
                mass=float(rng.uniform(0.5, 3.0)),
                com=0.5 * rng.normal(size=3),
                inertia=0.1 * np.asarray(inertia),
                position=position / np.linalg.norm(position) if size == 4 else position,
                rate=rng.normal(size=3 if size == 4 else 1),
            )
        )
    return links, rng.normal(size=3) * 5.0


def random_rotation(rng: np.random.Generator) -> Array:
    """Return a random rotation matrix (3, 3)."""
    quaternion = rng.normal(size=4)
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        (
            (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
            (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
            (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
        )
    )

"""Random trees of rigid bodies, described by numbers alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
POSITIONS = {"revolute": 1, "translational": 1, "spherical": 4, "universal": 2, "cylindrical": 2, "planar": 3}
MAX_LINKS = 12


class Link(NamedTuple):
    """Rigid body with the joint that connects it to its parent.

    Attributes
    ----------
    parent
        Number of the parent among the links; -1: the ground.
    joint
        Name of the joint, a key of ``POSITIONS``.
    axis, second
        Unit vector of the joint (3,), in the joint frame; and that of the second axis of a universal joint, in the
        frame that has turned about the first. The axis of a planar joint is z.
    place, rotation
        Position (3,), m, and orientation (3, 3) of the joint frame in the frame of the parent.
    mass, com, inertia
        Mass, kg; center of mass (3,), m; and inertia about it (3, 3), kg m^2, in the frame of the body.
    position, rate
        Coordinates of the joint and their rates: rad and m; of a cylindrical joint the angle and the displacement; of a
        planar joint x, y and the angle; of a spherical joint a unit quaternion (4,), scalar first, and the angular
        velocity (3,) in the frame of the body.
    """

    parent: int
    joint: str
    axis: Array
    second: Array
    place: Array
    rotation: Array
    mass: float
    com: Array
    inertia: Array
    position: Array
    rate: Array

    @property
    def parts(self) -> list[tuple[str, Array]]:
        """Simple joints in series, ``revolute``, ``translational`` or ``spherical``, with their axes."""
        x, y, z = np.eye(3)
        composed = {
            "universal": [("revolute", self.axis), ("revolute", self.second)],
            "cylindrical": [("revolute", self.axis), ("translational", self.axis)],
            "planar": [("translational", x), ("translational", y), ("revolute", z)],
        }
        return composed.get(self.joint, [(self.joint, self.axis)])


class Dynamics(NamedTuple):
    """Mass matrix (n, n) and accelerations (n,) under gravity, in the order of the links."""

    mass_matrix: Array
    acceleration: Array


Evaluator = Callable[[Array, Array], Dynamics]  # positions and rates of all links, one after the other


def start_of(links: list[Link]) -> tuple[Array, Array]:
    """Return positions and rates of all links."""
    return np.concatenate([link.position for link in links]), np.concatenate([link.rate for link in links])


def random_tree(seed: int) -> tuple[list[Link], Array]:
    """Return the links of a random tree, and the acceleration of gravity (3,), m/s^2."""
    rng = np.random.default_rng(seed)
    links = []
    for k in range(int(rng.integers(1, MAX_LINKS + 1))):
        joint = str(rng.choice(list(POSITIONS)))
        axis, second = random_rotation(rng)[:2]
        points = rng.normal(size=(5, 3))
        inertia = sum((p @ p) * np.eye(3) - np.outer(p, p) for p in points)
        size = POSITIONS[joint]
        position = rng.normal(size=size)
        links.append(
            Link(
                parent=int(rng.integers(-1, k)),
                joint=joint,
                axis=axis,
                second=second,
                place=rng.normal(size=3),
                rotation=random_rotation(rng),
                mass=float(rng.uniform(0.5, 3.0)),
                com=0.5 * rng.normal(size=3),
                inertia=0.1 * np.asarray(inertia),
                position=position / np.linalg.norm(position) if size == 4 else position,
                rate=rng.normal(size=3 if size == 4 else size),
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

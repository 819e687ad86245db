"""What sheets meet, as shapes of bodies: the surfaces that they contact, and the rollers and idlers of nips.

A body other than the ground that the model gives shapes looks as those say, and gets none here.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import Cylinder, Mechanism
from mbfmu.mechanics.axes import along
from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.checks import rotation
from mbfmu.mechanics.shapes import Shape
from mbfmu.sheets.contact.nip import RollerNip
from mbfmu.sheets.contact.surface_contact import SurfaceContact

from .picture import Poses

IDLER_RADIUS_RATIO = 0.6  # its radius against that of the roller
RUBBER, IDLE, MARK = "#565e6b", "#a3abb8", "#f2f4f7"
# lie in a roller's surface where its turning is to be seen: angles; radius to its own
MARK_ANGLES, MARK_RADIUS_RATIO = (0.0, np.pi), 0.12


def contact_shapes(mechanism: Mechanism, poses: Poses | None) -> Iterator[tuple[Body, Shape]]:
    """Yield bodies and shapes; without poses planes that have no end are left out."""
    own = {body.index for body, _ in mechanism.shapes if body.index}
    nips: dict[str, tuple[RollerNip, tuple[Body, ...]]] = {}
    contacts: dict[tuple[int, int], tuple[SurfaceContact, Body, set[int]]] = {}
    for acting in mechanism.others:
        load, bodies = acting.load, acting.bodies
        holder = bodies[4] if isinstance(load, RollerNip) else bodies[-1]
        if isinstance(load, RollerNip) and holder.index not in own:
            nips[load.name] = load, bodies[4:]
        elif isinstance(load, SurfaceContact) and holder.index not in own:
            nodes = contacts.setdefault((id(load.surface), holder.index), (load, holder, set()))[2]
            nodes.update(body.index for body in bodies[:-1])
    for contact, holder, nodes in contacts.values():
        near = np.zeros((1, 3)) if poses is None else relative(poses, sorted(nodes), holder.index)
        yield from ((holder, shape) for shape in contact.surface.shapes(near))
    for nip, (roller, *idlers) in nips.values():
        yield from rolling(nip, roller, nip.common["radius"], RUBBER)
        for idler in idlers:
            yield from rolling(nip, idler, nip.common["idler_radius"], IDLE)
        if not idlers and roller.parent == 0:  # where another carries it, its place is not known
            yield mechanism.ground, above(nip, roller)


def relative(poses: Poses, nodes: list[int], holder: int) -> NDArray[np.float64]:
    """Return where nodes come (k, 3), in the axes of a body, m; where a run fails its last poses may not be finite."""
    r, A = (array.astype(float) for array in poses)
    ways = r[:, nodes] - r[:, [holder]]
    near: NDArray[np.float64] = np.einsum("tji,tkj->tki", A[:, holder], ways).reshape(-1, 3)
    return near[np.isfinite(near).all(axis=1)]


def above(nip: RollerNip, roller: Body) -> Shape:
    """Return the idler that is no body, in the ground's axes."""
    axis = rotation(f"rotation of {roller.name!r}", roller.joint.rotation) @ roller.joint.direction
    radius, middle = IDLER_RADIUS_RATIO * nip.common["radius"], nip.common["place"]
    at = numbers(middle + radius * nip.common["n"])
    return Cylinder(radius=radius, length=nip.common["width"], axis=numbers(axis), at=at, color=IDLE)


def rolling(nip: RollerNip, roller: Body, radius: float, color: str) -> Iterator[tuple[Body, Shape]]:
    """Yield a roller of a nip with marks."""
    joint, width = roller.joint, nip.common["width"]
    axis, beside = np.asarray(joint.direction, float), 0.0
    if roller.parent == 0:
        turned = rotation(f"rotation of {roller.name!r}", joint.rotation)
        beside = float((nip.common["place"] - joint.at) @ turned @ axis)
    middle, across, axle = beside * axis, along(axis), numbers(axis)
    yield roller, Cylinder(radius=radius, length=width, axis=axle, at=numbers(middle), color=color)
    for angle in MARK_ANGLES:
        out = np.cos(angle) * across[:, 0] + np.sin(angle) * across[:, 1]
        at = numbers(middle + (1.0 - MARK_RADIUS_RATIO) * radius * out)
        yield (
            roller,
            Cylinder(radius=1.05 * MARK_RADIUS_RATIO * radius, length=1.02 * width, axis=axle, at=at, color=MARK),
        )


def numbers(values: NDArray[np.float64]) -> tuple[float, ...]:
    """Return plain floats."""
    return tuple(float(x) for x in values)

"""Check of the start of sheets in contact: not through a surface and not outside a nip.

A point that starts deep in a surface is thrown out with an energy that nobody gave it, and one beyond the middle of a
guide comes out on its other side. A little is no mistake: a sheet that rests on a table is in it. A thin guide may lie
between the contact points, which then never feel it: so near its middle nothing of the sheet may be.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.contact.nip import RollerNip
from mbfmu.mechanics.contact.surface_contact import SurfaceContact, find_max_penetration
from mbfmu.mechanics.records import State
from mbfmu.util.codes import coded
from mbfmu.util.errors import UserError

K = TypeVar("K", RollerNip, SurfaceContact)

# Depth in which a sheet may start, relative to the depth of the contact law, or to that which bears the sheet's weight
MAX_START_DEPTH_RATIO = 5.0
CORE_RATIO = 0.5  # radii of a guide, in which nothing of a sheet is, whether it is a contact point or not
MAX_SAMPLES = 200  # points of a cell one way that are looked at for that


def check_surface_contacts(
    mechanism: Mechanism, contacts: NDArray[Any], arrays: Any, state: Any, gravity: float
) -> None:
    """Raise UserError for a sheet that penetrates a contact surface, as ``state`` has placed the bodies.

    ``contacts`` are the records of all surface contacts; arrays and state are as kernels take them, ``gravity`` is in
    m/s^2.
    """
    if not len(contacts):
        return
    groups = list(_contact_groups(mechanism, SurfaceContact))
    cores = np.array([load.surface.core() for group in groups for load in group.loads])
    sides = np.array([load.sides for group in groups for load in group.loads])
    finer = np.clip(np.ceil(sides / (CORE_RATIO * cores[:, None])), 1, MAX_SAMPLES).astype(
        np.int64
    )  # a point in every half core
    points, within = (np.zeros((len(contacts), 4)) for _ in range(2))
    find_max_penetration(contacts, contacts["samples"].copy(), arrays, state, points)
    find_max_penetration(contacts, finer, arrays, state, within)
    first = 0
    for group in groups:
        load, own = group.loads[0], slice(first, first + len(group.loads))
        first = own.stop
        most = MAX_START_DEPTH_RATIO * max(load.depth, _resting_depth(group, gravity))
        for found, allowed in ((points[own], most), (within[own], max(most, CORE_RATIO * load.surface.core()))):
            depth, *place = found[found[:, 0].argmax()].tolist()
            if depth > allowed:
                raise UserError(
                    f"sheet {_sheet(mechanism, group.nodes)!r} penetrates {group.name!r} at the start by {depth:.3g} m "
                    f"at ({place[0]:.4g}, {place[1]:.4g}, {place[2]:.4g}) m; allowed: {allowed:.3g} m at most. Move "
                    "the sheet or the surface apart",
                    "contact-at-start",
                )


def undersampled_edges(mechanism: Mechanism, state: State) -> list[str]:
    """Return warnings about edges of guides that may lie between the contact points of a sheet."""
    messages = []
    for group in _contact_groups(mechanism, SurfaceContact):
        load, holder = group.loads[0], group.holder
        edges = load.surface.edges()
        if edges is None:
            continue
        radius, long, along = edges
        axes = state.bodies["A"][group.nodes[0].index][:, ::2]  # of the sheet as it starts
        lies = np.abs(axes.T @ (state.bodies["A"][holder.index] @ along))  # cosines
        apart = np.array(load.sides) / load.samples
        across, beside = apart * np.sqrt(np.clip(1.0 - lies**2, 0.0, 1.0)), apart * lies
        for size, what, gap in ((2.0 * radius, "thick", across.max()), (long, "wide", beside.max())):
            if size < gap:
                messages.append(
                    coded(
                        "contact-at-start",
                        f"surface of contact {group.name!r} is {size:.3g} m {what}, but the contact points of sheet "
                        f"{_sheet(mechanism, group.nodes)!r} are {gap:.3g} m apart: an edge between two points causes "
                        f"no contact force; use more points per cell than {tuple(load.samples)}",
                    )
                )
    return messages


def misplaced_nips(mechanism: Mechanism, state: State) -> list[str]:
    """Return messages on nips that are not on the sheet that they drive, in the position of ``state``."""
    messages = []
    for group in _contact_groups(mechanism, RollerNip):
        nip = group.loads[0].common
        across = state.bodies["r"][[body.index for body in group.nodes]] @ nip["e"]
        middle, half = float(nip["place"] @ nip["e"]), 0.5 * nip["width"]
        off = max(float(across.min()) - middle, middle - float(across.max())) - half
        if off > 0.0:
            messages.append(
                coded(
                    "contact-at-start",
                    f"nip {group.name!r} is {off:.3g} m away from the edge of sheet {_sheet(mechanism, group.nodes)!r} "
                    "at the start, across the feed direction; it drives the sheet only if the sheet moves sideways. "
                    "Check the position and width of the nip",
                )
            )
    return messages


@dataclass(frozen=True)
class _ContactGroup(Generic[K]):
    """A surface contact or a nip: the loads of its cells, the nodes of its sheet, and what those meet."""

    name: str
    loads: list[K]
    nodes: list[Body]
    holder: Body  # that has the surface, or the roller


def _contact_groups(mechanism: Mechanism, kind: type[K]) -> Iterator[_ContactGroup[K]]:
    """Yield every contact, or every nip."""
    own = ((name, load, bodies) for name, load, bodies in mechanism.others if isinstance(load, kind))
    for name, cells in groupby(own, key=itemgetter(0)):
        _, loads, corners = zip(*cells, strict=True)
        nodes = {id(body): body for four in corners for body in four[:4]}
        yield _ContactGroup(name, list(loads), list(nodes.values()), corners[0][4])


def _sheet(mechanism: Mechanism, nodes: Sequence[Body]) -> str:
    """Return the name of the sheet of these nodes."""
    node = nodes[0]
    own = (sheet.name for sheet in mechanism.sheets if any(node is body for row in sheet.nodes for body in row))
    return next(own, node.name)


def _resting_depth(group: _ContactGroup[SurfaceContact], gravity: float) -> float:
    """Return the depth at which a surface contact bears the weight of the sheet, m."""
    law = group.loads[0]
    area = law.sides[0] * law.sides[1] * len(group.loads)
    depth = sum(body.mass for body in group.nodes) * gravity / area / law.stiffness
    square = float(np.sqrt(2.0 * law.depth * depth))
    return square if square < law.depth else depth + 0.5 * law.depth

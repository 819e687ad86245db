"""Check of the start of sheets in contact: not through a surface and not outside a nip.

A point that starts deep in a surface is thrown out with an energy that nobody gave it, and one beyond the middle of a
guide comes out on its other side. A little is no mistake: a sheet that rests on a table is in it. A thin guide may lie
between the contact points, which then never feel it: so near its middle nothing of the sheet may be.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.builder.bodies import Body
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel

from .patch import evaluate_center, evaluate_line, evaluate_on_line, hull_radius
from .scratch import contact_scratch
from .surface_force import gap

if TYPE_CHECKING:
    from mbfmu.mechanics.arrays.load_groups import LoadGroup
    from mbfmu.mechanics.records import Arrays, State
    from mbfmu.sheets.contact.surface_force import SurfaceContactRecord
    from solvers.compiled.record import Reals, Table

# Depth in which a sheet may start, relative to the depth of the contact law, or to that which bears the sheet's weight
MAX_START_DEPTH_RATIO = 5.0
CORE_RATIO = 0.5  # radii of a guide, in which nothing of a sheet is, whether it is a contact point or not
MAX_CELL_SAMPLES = 200  # points of a cell one way that are looked at for that


def check_surface_contacts(group: LoadGroup) -> None:
    """Raise UserError for a sheet that penetrates a contact surface; ``group`` has all cells in contact with one."""
    contacts: Any = group.records
    arrays, state = group.kernel_data
    found_contacts = list(_contacts(group))
    cores = np.array([load.surface.core() for contact in found_contacts for load in contact.loads])
    sides = np.array([load.sides for contact in found_contacts for load in contact.loads])
    finer = np.clip(np.ceil(sides / (CORE_RATIO * cores[:, None])), 1, MAX_CELL_SAMPLES).astype(
        np.int64
    )  # a point in every half core
    points, within = (np.zeros((len(contacts), 4)) for _ in range(2))
    find_max_penetration(contacts, contacts["samples"].copy(), arrays, state, points)
    find_max_penetration(contacts, finer, arrays, state, within)
    first = 0
    for contact in found_contacts:
        load, own = contact.loads[0], slice(first, first + len(contact.loads))
        first = own.stop
        most = MAX_START_DEPTH_RATIO * max(load.depth, _resting_depth(contact, group.gravity))
        for found, allowed in ((points[own], most), (within[own], max(most, CORE_RATIO * load.surface.core()))):
            depth, *place = found[found[:, 0].argmax()].tolist()
            if depth > allowed:
                raise UserError(
                    f"sheet {_sheet(group, contact)!r} penetrates {contact.name!r} at the start by {depth:.3g} m "
                    f"at ({place[0]:.4g}, {place[1]:.4g}, {place[2]:.4g}) m; allowed: {allowed:.3g} m at most. Move "
                    "the sheet or the surface apart",
                    "element-at-start",
                )


def undersampled_edges(group: LoadGroup) -> list[str]:
    """Return warnings about edges of guides that may lie between the contact points of a sheet."""
    messages = []
    for contact in _contacts(group):
        load, holder = contact.loads[0], contact.holder
        edges = load.surface.edges()
        if edges is None:
            continue
        radius, long, along = edges
        axes = group.bodies["A"][contact.nodes[0].index][:, ::2]  # of the sheet as it starts
        lies = np.abs(axes.T @ (group.bodies["A"][holder.index] @ along))  # cosines
        apart = np.array(load.sides) / load.samples
        across, sideways = apart * np.sqrt(np.clip(1.0 - lies**2, 0.0, 1.0)), apart * lies
        for size, what, spacing in ((2.0 * radius, "thick", across.max()), (long, "wide", sideways.max())):
            if size < spacing:
                messages.append(
                    f"surface of contact {contact.name!r} is {size:.3g} m {what}, but the contact points of sheet "
                    f"{_sheet(group, contact)!r} are {spacing:.3g} m apart: an edge between two points causes "
                    f"no contact force. Use more points per cell than {tuple(load.samples)}"
                )
    return messages


def misplaced_nips(group: LoadGroup) -> list[str]:
    """Return messages on nips that are not on the sheet that they drive."""
    messages = []
    for contact in _contacts(group):
        nip = contact.loads[0].common
        across = group.bodies["r"][[body.index for body in contact.nodes]] @ nip["e"]
        middle, half = float(nip["place"] @ nip["e"]), 0.5 * nip["width"]
        off = max(float(across.min()) - middle, middle - float(across.max())) - half
        if off > 0.0:
            messages.append(
                f"nip {contact.name!r} is {off:.3g} m away from the edge of sheet {_sheet(group, contact)!r} "
                "at the start, across the feed direction; it drives the sheet only if the sheet moves sideways. "
                "Check the position and width of the nip"
            )
    return messages


@dataclass(frozen=True)
class _Contact:
    """A contact with a surface or a nip: the loads of its cells, the nodes of its sheet, and what those meet."""

    name: str
    loads: list[Any]
    nodes: list[Body]
    holder: Body  # that has the surface, or the roller


def _contacts(group: LoadGroup) -> Iterator[_Contact]:
    """Yield every contact of the type."""
    for name, found in groupby(group.acting, key=attrgetter("name")):
        cells = list(found)
        nodes = {id(body): body for acting in cells for body in acting.bodies[:4]}
        yield _Contact(name, [acting.load for acting in cells], list(nodes.values()), cells[0].bodies[4])


def _sheet(group: LoadGroup, contact: _Contact) -> str:
    """Return the name of the sheet of a contact."""
    mesh = group.mesh_of(contact.nodes[0])
    return contact.nodes[0].name if mesh is None else str(mesh.name)


def _resting_depth(contact: _Contact, gravity: float) -> float:
    """Return the depth at which a surface contact bears the weight of the sheet, m."""
    law = contact.loads[0]
    area = law.sides[0] * law.sides[1] * len(contact.loads)
    depth = sum(body.mass for body in contact.nodes) * gravity / area / law.stiffness
    square = float(np.sqrt(2.0 * law.depth * depth))
    return square if square < law.depth else depth + 0.5 * law.depth


@kernel
def find_max_penetration(
    contacts: Table[SurfaceContactRecord], points: Any, arrays: Arrays, state: State, found: Reals
) -> None:
    """found (k, 4) <- depth of the deepest point of each of k contacts, m, zero where none is in, and its place.

    ``points`` (k, 2) is their number along x and z.
    """
    bodies = state.bodies
    for e in range(found.shape[0]):
        contact, nx, nz = contacts[e], points[e, 0], points[e, 1]
        here = contact_scratch(contact, state)
        for j in range(4):
            found[e, j] = 0.0
        evaluate_center(contact, bodies, here.r)
        if gap(contact, arrays, state) > hull_radius(contact, bodies, here.r):
            continue
        for i in range(nx + 1):
            evaluate_line(contact, i / nx, bodies, here.line)
            for k in range(nz + 1):
                evaluate_on_line(here.line, k / nz, here.r)
                d = -gap(contact, arrays, state)
                if d > found[e, 0] and here.part > 0.0:
                    found[e, 0] = d
                    for j in range(3):
                        found[e, 1 + j] = here.r[j]

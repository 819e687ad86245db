"""Scratch memory of contact evaluation: a part of the state, so that it is complex if the state is."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from mbfmu.mechanics.dispatch import scratch_record
from solvers.compiled.kernel import inlined
from solvers.compiled.record import Reals, Record, Vec3, f8, i8

if TYPE_CHECKING:
    from mbfmu.mechanics.records import State

# Results are added up without forces on bodies: of the points that the cell owns; of all its points, those on borders
# with half their share. Or bristles of a nip are moved to the end of a step.
ALL_POINTS, OWN_SHARE, MOVE_ANCHORS = 1, 2, 3

CONTACT_REASON = "contact forces change within micrometers, and friction forces within millimeters per second"


class ContactScratch(Record):
    """Of one contact point."""

    c: Annotated[Reals, (4, 3)]  # weights (N, a Nx, b Nz) of the four nodes
    cx: Annotated[Reals, (4, 3)]  # ... derivatives by xi
    cz: Annotated[Reals, (4, 3)]  # ... by zeta
    line: Annotated[Reals, (4, 3)]  # cubic that the point is on: its ends, m, and its derivatives there
    r: Vec3  # point, m
    rx: Vec3  # ... derivatives by xi and zeta
    rz: Vec3
    v: Vec3  # velocity
    f: Vec3  # force on the sheet there
    p: Vec3  # point in the axes of the surface
    n: Vec3  # normal there, towards the sheet
    part: f8  # of the force that is left where the surface ends
    by: Annotated[Reals, (3, 6)]  # minus its derivatives by r and v
    dr: Annotated[Reals, (3, 6)]  # how it moves with the six motions of a body
    df: Annotated[Reals, (3, 6)]  # ... and minus what the force changes by
    result: Annotated[Reals, (8,)]  # sums over contact points; see the loads
    accumulate_only: i8  # ALL_POINTS, OWN_SHARE, MOVE_ANCHORS: apply no forces; see above


CONTACT_SCRATCH = ContactScratch.dtype


class NipScratch(Record):
    """Of a pair of stations."""

    at: Annotated[Reals, (2, 2)]  # xi, zeta
    part: Annotated[Reals, (2,)]
    y: Annotated[Reals, (2,)]  # off the plane of the nip as the rubber feels it, m
    gain: Annotated[Reals, (2,)]  # ... its derivative by where the surface is
    u: Annotated[Reals, (2,)]  # along the feed in the cell, 0 to 1
    f: Annotated[Reals, (2,)]  # force across, N
    lean: Annotated[Reals, (2,)]  # slope that the cell's own bending adds


NIP_SCRATCH = NipScratch.dtype


@inlined
def contact_scratch(item: Any, state: State) -> Any:
    """Scratch memory of the contact of a load or a sensor."""
    return scratch_record(item.scratch, CONTACT_SCRATCH, state)


@inlined
def nip_scratch(nip: Any, state: State) -> Any:
    """Scratch memory of a pair of stations."""
    return scratch_record(nip.pair_scratch, NIP_SCRATCH, state)

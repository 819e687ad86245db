"""Handles of the contacts of a sheet, with the sensors of surfaces and of nips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mbfmu.errors import UserError
from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.sensors import Jammed, Met, Pressed, axis_index

from .sheet import Sheet


@dataclass(frozen=True, eq=False)
class Contact:
    """A sheet that meets something, as loads of its cells."""

    name: str
    mechanism: Mechanism
    first: int  # of them among Mechanism.others
    count: int

    @property
    def index(self) -> int:
        """Number of its first load in a mechanism that is complete."""
        own = self.mechanism.others
        return sum(1 for _ in self.mechanism.loads()) - len(own) + self.first

    def _told(self, unit: str, component: int, over: int = -1, scale: float = 1.0) -> Met:
        return Met(unit=unit, item=self, component=component, count=self.count, over=over, scale=scale)


@dataclass(frozen=True, eq=False)
class SurfaceContactHandle(Contact):
    """Contact of a sheet with a surface, as returned by :func:`add_contact`."""

    sheet: Sheet

    def force(self, axis: str) -> Met:
        """Global component of the force on the sheet, N."""
        return self._told("N", axis_index(axis, f"of the force of contact {self.name!r}"))

    def depth(self) -> Met:
        """Largest penetration of the sheet into the surface, m; zero: no contact."""
        return self._told("m", 5)

    def heat(self) -> Met:
        """Power dissipated by friction and damping of the contact, W."""
        return self._told("W", 4, scale=-1.0)

    def pressure(self, i: int, k: int) -> Pressed:
        """As :func:`.contact_pressure` for this contact alone."""
        return contact_pressure([self], i, k)


@dataclass(frozen=True, eq=False)
class NipHandle(Contact):
    """Roller nip, as returned by :func:`add_nip`."""

    stations: int
    roller: Body
    radius: float  # m

    def slip(self) -> Met:
        """Speed of the sheet along the feed minus that of the roller, mean over the loaded part, m/s."""
        return self._told("m/s", 1, over=0)

    def traction(self) -> Met:
        """Force of the sheet on the roller along the feed, N."""
        return self._told("N", 2)

    def lateral(self) -> Met:
        """Force on the sheet across the feed, N."""
        return self._told("N", 3)

    def normal(self) -> Met:
        """Normal force that keeps the sheet in the plane of the nip, towards the idler, N."""
        return self._told("N", 4)

    def heat(self) -> Met:
        """Power dissipated by friction and damping of the nip, W."""
        return self._told("W", 5, scale=-1.0)

    def loaded(self) -> Met:
        """Part of the nip that the sheet covers, 0 to 1."""
        return self._told("1", 0, scale=1.0 / self.stations)


def contact_pressure(contacts: Sequence[SurfaceContactHandle], i: int, k: int) -> Pressed:
    """Return the pressure of contacts of one sheet on its cell (i, k), Pa: magnitudes of their forces divided by its
    area.

    Pressures from opposite sides are added. It is the pressure if there is no friction, and at most
    sqrt(1 + friction^2) of it.
    """
    if not contacts or not all(isinstance(contact, SurfaceContactHandle) for contact in contacts):
        raise UserError(f"contacts that press are {contacts!r}; allowed: a list of what add_contact returns")
    sheet = contacts[0].sheet
    for contact in contacts:
        if contact.sheet is not sheet:
            raise UserError(
                f"contact {contact.name!r} is one of sheet {contact.sheet.name!r}; allowed together with "
                f"{contacts[0].name!r}: contacts of {sheet.name!r}"
            )
    if (i, k) not in sheet.cells:
        raise UserError(f"sheet {sheet.name!r} has no cell {(i, k)}; allowed: {max(sheet.cells)} at most")
    cell = list(sheet.cells).index((i, k))
    own = [contact.first + cell for contact in contacts]
    return Pressed(unit="Pa", item=contacts[0], own=own, scale=1.0 / (sheet.a * sheet.b))


def jammed(nips: Sequence[NipHandle]) -> Jammed:
    """Return a sensor that is 1 while a sheet slips in one of these nips by more than half the surface speed of the
    roller.

    A nip less than half of which is covered by the sheet does not count. It has no memory: the reader decides on the
    duration.
    """
    if not nips or not all(isinstance(nip, NipHandle) for nip in nips):
        raise UserError(f"nips that jam are {nips!r}; allowed: a list of what add_nip returns")
    rollers = tuple(nip.roller for nip in nips)
    return Jammed(unit="1", item=nips[0], bodies=rollers, nips=[(nip, nip.radius, nip.stations) for nip in nips])

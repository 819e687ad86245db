"""Handles of the contacts of a sheet, with the sensors of surfaces and of nips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.sensors import axis_index
from mbfmu.sheets.sensors import ContactForceSum, ContactSum, Jammed
from mbfmu.sheets.sheet_handle import Sheet
from mbfmu.util.errors import UserError


@dataclass(frozen=True, eq=False)
class Contact:
    """Contact of a sheet, which consists of loads on its cells.

    Attributes
    ----------
    name
        Name of the loads.
    mechanism
        Mechanism to which they were added.
    first, count
        Number of the first load among ``Mechanism.others``, and number of loads.
    """

    name: str
    mechanism: Mechanism
    first: int
    count: int

    @property
    def index(self) -> int:
        """Number of its first load in a mechanism that is complete."""
        return self.mechanism.first_other + self.first

    def _sensor(self, unit: str, component: int, over: int = -1, scale: float = 1.0) -> ContactSum:
        return ContactSum(unit=unit, item=self, component=component, count=self.count, over=over, scale=scale)


@dataclass(frozen=True, eq=False)
class SurfaceContactHandle(Contact):
    """Contact of a sheet with a surface, as returned by :func:`add_contact`."""

    sheet: Sheet  # the sheet in contact

    def force(self, axis: str) -> ContactSum:
        """Global component of the force on the sheet, N.

        Parameters
        ----------
        axis
            Global axis: ``"x"``, ``"y"`` or ``"z"``.
        """
        return self._sensor("N", axis_index(axis, f"of the force of contact {self.name!r}"))

    def depth(self) -> ContactSum:
        """Largest penetration of the sheet into the surface, m; zero: no contact."""
        return self._sensor("m", 5)

    def heat(self) -> ContactSum:
        """Power dissipated by friction and damping of the contact, W."""
        return self._sensor("W", 4, scale=-1.0)

    def pressure(self, i: int, k: int) -> ContactForceSum:
        """Pressure of this contact on a cell of the sheet, Pa; see :func:`.contact_pressure`.

        Parameters
        ----------
        i, k
            Numbers of the cell along x and z, from 0.
        """
        return contact_pressure([self], i, k)


@dataclass(frozen=True, eq=False)
class NipHandle(Contact):
    """Roller nip, as returned by :func:`add_nip`."""

    stations: int  # number of contact points of one side
    roller: Body  # the driving roller
    radius: float  # m

    def slip(self) -> ContactSum:
        """Speed of the sheet along the feed minus that of the roller, mean over the loaded part, m/s."""
        return self._sensor("m/s", 1, over=0)

    def traction(self) -> ContactSum:
        """Force of the sheet on the roller along the feed, N."""
        return self._sensor("N", 2)

    def lateral(self) -> ContactSum:
        """Force on the sheet across the feed, N."""
        return self._sensor("N", 3)

    def normal(self) -> ContactSum:
        """Normal force that keeps the sheet in the plane of the nip, towards the idler, N."""
        return self._sensor("N", 4)

    def heat(self) -> ContactSum:
        """Power dissipated by friction and damping of the nip, W."""
        return self._sensor("W", 5, scale=-1.0)

    def loaded(self) -> ContactSum:
        """Part of the nip that the sheet covers, 0 to 1."""
        return self._sensor("1", 0, scale=1.0 / self.stations)


def contact_pressure(contacts: Sequence[SurfaceContactHandle], i: int, k: int) -> ContactForceSum:
    """Return a sensor of the pressure of several contacts on a cell of a sheet, Pa.

    It is the sum of the magnitudes of their forces divided by the area of the cell; forces on opposite faces are added.
    Without friction this is the normal pressure, with friction at most sqrt(1 + friction^2) times that.

    Parameters
    ----------
    contacts
        Contacts of one sheet, from :func:`add_contact`.
    i, k
        Numbers of the cell along x and z, from 0.

    Returns
    -------
    Sensor
        Sensor for :meth:`Mechanism.output`.
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
    return ContactForceSum(unit="Pa", item=contacts[0], own=own, scale=1.0 / (sheet.a * sheet.b))


def jammed(nips: Sequence[NipHandle]) -> Jammed:
    """Return a sensor that is 1 while the sheet slips in a nip by more than half the surface speed of its roller.

    Nips that are covered by the sheet to less than one half are ignored. The sensor has no memory: how long a slip must
    last to be a jam is decided by the controller that reads it.

    Parameters
    ----------
    nips
        Nips from :func:`add_nip`.

    Returns
    -------
    Sensor
        Sensor for :meth:`Mechanism.output`.
    """
    if not nips or not all(isinstance(nip, NipHandle) for nip in nips):
        raise UserError(f"nips that jam are {nips!r}; allowed: a list of what add_nip returns")
    rollers = tuple(nip.roller for nip in nips)
    return Jammed(unit="1", item=nips[0], bodies=rollers, nips=[(nip, nip.radius, nip.stations) for nip in nips])

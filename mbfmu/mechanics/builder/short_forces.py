"""Forces and cams by tables with narrow parts: events at which the solver restarts, so that no step passes them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.couplings import Cam
from mbfmu.mechanics.events import Event, Restart
from mbfmu.mechanics.loads import Damper, JointDamper, JointSpring, Spring
from mbfmu.mechanics.narrow_parts import places_of
from mbfmu.mechanics.sensors import Sensor
from mbfmu.mechanics.signals import Signal, Table

from .handles import ForceHandle

if TYPE_CHECKING:
    from .mechanism import Mechanism


def declare_short_forces(m: Mechanism) -> None:
    """Add the events of all tables with narrow parts, which are not listed; replace those of an earlier call.

    Included are tables of springs and dampers on a joint coordinate or between two points, with a free length that is a
    number, and of cams.
    """
    m.events[:] = [event for event in m.events if event.is_listed]
    found = []
    for what, table, sensor, origin in tables_over_coordinates(m):
        table.rows(f"the table of {what}")
        for k, place in enumerate(places_of(table), 1):
            name = f"{what}, place {k} of its table"
            found.append(Event(name, (Restart(),), sensor, place + origin, is_listed=False))
    m.events += found


def tables_over_coordinates(m: Mechanism) -> Iterator[tuple[str, Table, Sensor, float]]:
    """Yield the tables over coordinates, distances and their rates: their owners, the sensors of the abscissas, and
    what is added to an abscissa.
    """
    for k, (name, force, a, b) in enumerate(m.forces):
        table = getattr(force, "stiffness", getattr(force, "damping", None))
        if not isinstance(table, Table) or not is_number(getattr(force, "free", 0.0)):
            continue
        handle, what, origin = ForceHandle(name, k, force, a, b), f"force {name!r}", float(getattr(force, "free", 0.0))
        if isinstance(force, JointSpring):
            yield what, table, a.coordinate(), origin
        elif isinstance(force, Spring):
            yield what, table, handle.length(), origin
        elif isinstance(force, JointDamper):
            yield what, table, a.rate(), 0.0
        elif isinstance(force, Damper):
            yield what, table, handle.length_rate(), 0.0
    for c in m.couplings:
        if isinstance(c.coupling, Cam) and isinstance(c.coupling.law, Table):
            yield f"coupling {c.name!r}", c.coupling.law, c.b.coordinate(c.coordinate_b), 0.0


def is_number(free: Any) -> bool:
    """Whether a free length is constant."""
    return not (isinstance(free, Signal | str) or callable(free))

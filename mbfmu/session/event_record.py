"""What is reported of an event that has occurred."""

from __future__ import annotations

from typing import NamedTuple


class EventRecord(NamedTuple):
    """An event that has occurred.

    Attributes
    ----------
    name
        Name of the event.
    time
        Time, s, at which the crossing is located.
    direction
        ``"up"`` or ``"down"``; empty: an event of a given time.
    value
        Value of its sensor before the actions, in the unit of the sensor; NaN: it has none.
    after
        Value of its sensor after the actions of all events of this time.
    """

    name: str
    time: float
    direction: str
    value: float
    after: float

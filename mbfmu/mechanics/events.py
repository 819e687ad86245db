"""Events: instants at which a quantity crosses a value, or given times, and what happens at them."""

from __future__ import annotations

from dataclasses import dataclass

from mbfmu.mechanics.sensors import Sensor

DIRECTIONS = {"up": 1, "down": -1, "both": 0}  # by name: sign of the rate of the quantity; 0: any


@dataclass(frozen=True)
class EndRun:
    """Action of an event: the run ends at the event."""


@dataclass(frozen=True)
class SetInput:
    """Action of an event: set an input, as :meth:`.Simulation.set_input` does.

    Parameters
    ----------
    name
        Name of the input.
    value
        Value from the event on, in the unit of the input.
    """

    name: str
    value: float


Action = EndRun | SetInput


@dataclass(frozen=True)
class Event:
    """An event of a mechanism, which :meth:`.Mechanism.event` adds.

    Parameters
    ----------
    name
        Name, unique among the events.
    actions
        What happens, in this order.
    sensor
        Quantity that crosses a value; None: the event has a given time.
    value
        The value, in the unit of the sensor.
    direction
        Sign of the rate of the quantity at the crossing; 0: any.
    time
        Given time, s.
    within
        Longest time between two evaluations of the sensor, s; None: as the solver's steps need.
    """

    name: str
    actions: tuple[Action, ...]
    sensor: Sensor | None = None
    value: float = 0.0
    direction: int = 0
    time: float = 0.0
    within: float | None = None

"""Which signals a quantity depends on at a given motion, so that outputs declare the inputs that change them."""

from __future__ import annotations

from collections.abc import Set

from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.sensors import Sensor

from .compile import CompiledElements

OWN_PACKAGE = "mbfmu."  # its loads depend on positions, velocities and their own signals, and not on gravity


class SignalDependence:
    """The signals behind the loads of a compiled mechanism."""

    def __init__(self, mechanism: Mechanism, compiled: CompiledElements) -> None:
        _, _, couplings, loads, sensors, signals, parts = compiled.ends
        self._loads = [acting.load for acting in mechanism.loads()]
        self._of_loads = compiled.used[couplings:loads]
        self._sensors = compiled.sensors
        self._of_sensors, self._parts_of_sensors = compiled.used[loads:sensors], compiled.used_parts[loads:sensors]
        self._of_signals = compiled.used[sensors:signals]
        self._parts_of_loads = compiled.used_parts[couplings:loads]
        own = slice(signals, parts)
        self._of_parts, self._parts_of_parts = compiled.used[own], compiled.used_parts[own]

    def signals(self, sensor: Sensor) -> Set[int] | None:
        """Return the numbers of the signals that a quantity depends on; None: it may depend on all inputs."""
        numbers = sensor.loads()
        if numbers is None or not all(type(self._loads[k]).__module__.startswith(OWN_PACKAGE) for k in numbers):
            return None
        waiting = [signal for k in numbers for signal in self._of_loads[k]]
        parts, more = set[int](), [part for k in numbers for part in self._parts_of_loads[k]]
        for own, other in enumerate(self._sensors):
            if other is sensor:
                waiting += self._of_sensors[own]
                more += self._parts_of_sensors[own]
        while more:
            part = more.pop()
            if part not in parts:
                parts.add(part)
                waiting += self._of_parts[part]
                more += self._parts_of_parts[part]
        return self._with_members(waiting)

    def nonlinear_signals(self) -> Set[int]:
        """Return the numbers of the signals in which loads, sensors or blocks are not known to be linear."""
        both = zip(self._loads, self._of_loads, strict=True)
        waiting = [number for load, used in both if not load.is_linear_in_signals for number in used]
        waiting += [number for used in (*self._of_sensors, *self._of_parts) for number in used]
        return self._with_members(waiting)

    def _with_members(self, waiting: list[int]) -> Set[int]:
        """Return signals with those that they contain."""
        found: set[int] = set()
        while waiting:
            signal = waiting.pop()
            if signal not in found:
                found.add(signal)
                waiting += self._of_signals[signal]
        return found

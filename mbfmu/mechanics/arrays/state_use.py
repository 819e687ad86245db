"""What the laws and inputs of loads read: first-order states, joint coordinates, and bodies by sensors."""

from __future__ import annotations

from collections.abc import Iterator

from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.kind import ElementType
from mbfmu.mechanics.sensors import Sensor
from mbfmu.mechanics.sensors.coordinates import Coordinate, Rate, Turn
from mbfmu.mechanics.tangent import StateUse

from .compile import CompiledElements, observed_sensors


def find_state_use(mechanism: Mechanism, compiled: CompiledElements, first: int) -> list[StateUse]:
    """Return what each load reads; ``first`` is the place of the first state in State.v."""
    couplings, signals = compiled.ends[2], compiled.ends[5]
    states, parts, found = compiled.used_states, compiled.used_parts, []
    for k, acting in enumerate(mechanism.loads()):
        used, seen, more = set(states[couplings + k]), set[int](), list(parts[couplings + k])
        while more:
            part = more.pop()
            if part not in seen:
                seen.add(part)
                used.update(states[signals + part])
                more += parts[signals + part]
        sensors = [compiled.parts[part] for part in sorted(seen)]
        coordinates = {place for sensor in sensors for place in coordinates_of(mechanism, sensor)}
        bodies = {body.index for sensor in sensors for body in bodies_of(sensor)}
        if acting.load.on_joint:
            coordinates |= {(acting.bodies[0].index, c) for c in acting.load.coordinates}
        else:
            bodies |= {body.index for body in acting.bodies}
        found.append(StateUse(sorted(place - first for place in used), sorted(coordinates), sorted(bodies - {0})))
    return found


def coordinates_of(mechanism: Mechanism, sensor: ElementType) -> Iterator[tuple[int, int]]:
    """Yield the coordinates that a sensor reads, each as a body and its number in the joint of this body."""
    if isinstance(sensor, Coordinate | Rate):
        body = sensor.item
        if sensor.component < body.joint.nv:
            yield body.index, sensor.component
    elif isinstance(sensor, Turn):
        body = sensor.item
        while body.index > 0:
            yield from ((body.index, k) for k in range(body.joint.nv))
            body = mechanism.bodies[body.parent]


def bodies_of(sensor: ElementType) -> tuple[Body, ...]:
    """Return the bodies whose motions a sensor reads."""
    if not isinstance(sensor, Sensor) or isinstance(sensor, Coordinate | Rate | Turn):
        return ()
    return observed_sensors(sensor)

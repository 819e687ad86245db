"""Stops of a native FMU as arrays: which of them can hold what rests on them, and which of them do."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.arrays.compiled_mechanism import CompiledMechanism
from mbfmu.mechanics.arrays.numbering import joints_to_hold
from solvers.system import Array

if TYPE_CHECKING:
    from mbfmu.mechanics.events import Event

NO_STOP = -1  # in place of a number of a sensor that is at no stop, or that no stop can hold


class RestingMemory(NamedTuple):
    """The stops of a run, for each of its k sensors."""

    actions: NDArray[np.int64]  # (k,) place of its Bounce among the actions; NO_STOP: its value is no stop
    locks: NDArray[np.int64]  # (k,) number of the lock that holds it at its stop; NO_STOP: there is none
    held: NDArray[np.int64]  # (k,) 1: its stop holds it
    held_at: Array  # (k,) value at which it is held
    changes: NDArray[np.int64]  # (1,) 1: the events that are due may change velocities
    # scratch of impacts, (k,), 1: yes
    rested: NDArray[np.int64]  # its stop has held it before the event
    base: NDArray[np.int64]  # it takes part in the impact in any case
    touched: NDArray[np.int64]  # it is at its stop before the event, and takes part if it is slow
    slow: NDArray[np.int64]  # it takes part since it is touched
    pushed: NDArray[np.int64]  # it has taken part
    chosen: NDArray[np.int64]  # its stop is to hold it, or to release it
    resting: NDArray[np.int64]  # it rests
    # scratch, (k,)
    units: Array  # lengths of the slopes, in units of the coordinates
    rates: Array  # rates towards the stops before the event, in these units
    values: Array  # values of the stops before the actions of the event
    approach: Array  # accelerations towards the stops
    forces: Array  # by which the stops that hold push
    rounding: Array  # accelerations that are rounding errors

    @staticmethod
    def allocate(actions: list[int], locks: list[int]) -> RestingMemory:
        """Return stops that hold nothing."""
        k, z, i = len(actions), np.zeros, np.int64
        own = np.array(actions, i), np.array(locks, i), z(k, i), z(k), z(1, i)
        return RestingMemory._make((*own, *(z(k, i) for _ in range(7)), *(z(k) for _ in range(6))))

    def memory(self) -> list[NDArray[Any]]:
        """Return the arrays to save."""
        return [self.held, self.held_at]


def resting_memory(compiled: CompiledMechanism) -> RestingMemory:
    """Return the stops of a compiled mechanism."""
    events: list[Event] = compiled.mechanism.events
    joints, actions, locks, first = joints_to_hold(compiled.mechanism), list[int](), list[int](), 0
    for event in events:
        if event.sensor is not None:
            own = event.bounce
            actions.append(NO_STOP if own is None else first + list(event.actions).index(own))
            joint = event.holding_joint
            locks.append(NO_STOP if joint is None else joints.index(joint))
        first += len(event.actions)
    return RestingMemory.allocate(actions, locks)


def empty_resting_memory() -> RestingMemory:
    """Return stops of the types that all have, without any stop."""
    return RestingMemory.allocate([NO_STOP], [NO_STOP])

"""Events of a native FMU as arrays: what they are, and which of them have occurred."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.arrays.compiled_mechanism import CompiledMechanism
from mbfmu.mechanics.arrays.numbering import joints_to_hold
from mbfmu.mechanics.events import (
    Action,
    Bounce,
    EndRun,
    Event,
    Impulse,
    Lock,
    Release,
    Restart,
    SetInput,
    SetParameter,
)
from mbfmu.session.run_messages import RESTING_BOUNCES
from mbfmu.util.errors import UserError
from solvers.compiled.record import Record, f8, i8
from solvers.system import Array

if TYPE_CHECKING:
    from solvers.compiled.record import Table

SET_INPUT, IMPULSE, END_RUN, BOUNCE, LOCK, RELEASE, SET_PARAMETER, RESTART = range(8)  # kinds of actions
ACTION_KINDS: dict[type[Action], int] = {
    SetInput: SET_INPUT, SetParameter: SET_PARAMETER, Impulse: IMPULSE, Restart: RESTART, EndRun: END_RUN,
    Bounce: BOUNCE, Lock: LOCK, Release: RELEASE,
}  # fmt: skip
# Codes of a step in addition to those of solvers.outcome: an event has ended the run, or stops it with an error
RUN_ENDED_CODE, EVENT_FAILED = -10, -11
NEVER_LOCKED = -1  # in place of the number of a joint that no event locks
EVENT_REQUESTED_CODE = -12  # a completed step in model exchange has ended at an event
PARAMETER_CODE = -13  # an event sets a parameter; the step continues when it is called again
NO_ROW = -1  # in place of an action: none is left from an interrupted step
# Why an event stops a run
FAILURES = (
    "NONE",
    "TOO_MANY",
    "RESTING",
    "MASSLESS",
    "PRESCRIBED",
    "SINGULAR",
    "BEYOND",
    "NOT_LOCKED",
    "PRESCRIBED_LOCK",
)
NO_FAILURE, TOO_MANY, RESTING, MASSLESS, PRESCRIBED, SINGULAR, BEYOND, NOT_LOCKED, PRESCRIBED_LOCK = range(
    len(FAILURES)
)


class EventControlRecord(Record):
    """State of the events of a run."""

    ended: i8  # 1: an event has ended the run
    failure: i8  # one of FAILURES
    event: i8  # number of the event that has ended or stopped the run
    within: f8  # s, in which too many events have occurred
    first: f8  # s, time from which on events are counted
    count: i8  # number of events since then
    changed: i8  # 1: an input or a parameter was set by the last events
    row: i8  # action with which an interrupted step continues
    parameter: i8  # number, among those of events, of the parameter to be set
    value: f8  # its value
    restarts: i8  # 1: the solver restarts before the next step


class ActionRecord(Record):
    """An action of an event."""

    event: i8  # number of the event
    kind: i8
    # number of the input, or of the parameter among those of events; of the velocity on which an impulse acts; of the
    # sensor of a bounce; of the joint of a lock
    place: i8


class LockRecord(Record):
    """A joint that events lock, or stops."""

    body: i8
    position: i8  # place of its coordinate in the free positions, and in the free velocities
    velocity: i8
    signal: i8  # number of the signal that it follows while it is locked, and of the polynomial of this signal
    polynomial: i8
    is_locked: i8


class EventMemory(NamedTuple):
    """The events of a run, k of which have sensors and m given times, with a actions.

    Of ``lasting``, ``ways`` and ``since`` see :mod:`mbfmu.session.kernels.event_durations`.
    """

    control: Table[EventControlRecord]  # (1,)
    numbers: Array  # values of the sensors (k,), times (m,), s, values of actions (a,), ``lasting`` (k,)
    crossed: Array  # parts of it: (k,) values of the sensors
    times: Array  # (m,) s
    values: Array  # (a,) values of inputs and parameters, impulses, coefficients of restitution
    lasting: Array
    actions: Table[ActionRecord]  # (a,), in the order of the events and of their actions
    locks: Table[LockRecord]  # of the joints that events or stops lock
    nominals: Array  # (k,) typical sizes of the sensors
    sensed: NDArray[np.int64]  # (k,) numbers of the events that have sensors
    timed: NDArray[np.int64]  # (m,) numbers of the events of given times
    done: NDArray[np.int64]  # (m,) 1: this event has occurred, or is before the start
    due: NDArray[np.int64]  # (events,) 1: the event is at the reported state
    ways: NDArray[np.int64]
    since: Array
    parameters: Array  # values of the parameters that events set; nan: no event has set it since it was given
    bounces: Array  # (k, RESTING_BOUNCES + 1) s, times of the last bounces of each sensor
    beyond: NDArray[np.int64]  # (k,) number of bounces of each sensor since it was last before its stop
    depths: Array  # (k,) how far each was beyond its stop at the last of these
    # scratch of impacts: of k sensors, n velocities, nq positions
    hit: NDArray[np.int64]
    slopes: Array  # (k, n)
    responses: Array  # (k, n)
    effects: Array  # (k, k)
    demand: Array  # (k,) then the impulses
    impulses: Array
    rates: Array  # (k,)
    impulse: Array  # (n,)
    position_rate: Array  # (nq,)

    @staticmethod
    def allocate(
        actions: Any,
        locks: Any,
        numbers: Array,
        sensed: Sequence[int],
        timed: Sequence[int],
        events: int,
        nominals: Array,
        ways: Sequence[int],
        parameters: int,
        sizes: tuple[int, int],
    ) -> EventMemory:
        """Return events that have not begun and set ``parameters``; ``sizes`` are nq and n."""
        k, m, z, i = len(sensed), len(timed), np.zeros, np.int64
        nq, n = sizes
        parts = numbers, numbers[:k], numbers[k : k + m], numbers[k + m : len(numbers) - k], numbers[len(numbers) - k :]
        which = actions, locks, nominals, np.array(sensed, i), np.array(timed, i), z(m, i), z(events, i)
        lasting = np.array(ways, i), np.full(k, np.nan)
        history = np.full(parameters, np.nan), z((k, RESTING_BOUNCES + 1)), z(k, i), z(k)
        scratch = z(k, i), z((k, n)), z((k, n)), z((k, k)), z(k), z(k), z(k), z(n), z(nq)
        control = EventControlRecord.zeros(1)
        control["row"] = NO_ROW
        return EventMemory._make((control, *parts, *which, *lasting, *history, *scratch))

    def memory(self) -> list[NDArray[Any]]:
        """Return the arrays to save."""
        histories = self.since, self.parameters, self.bounces, self.beyond, self.depths
        return [self.control, self.numbers, self.locks, self.done, *histories]


class StepBegin(NamedTuple):
    """State of a solver at the begin of a step without dense output, which is repeated to the times that are examined,
    and of steps on trial after a restart.

    ``state`` is the memory in which the state of the solver is: the first part of the block of the instance.
    """

    is_kept: NDArray[np.int64]  # (1,) 1: the last step has no dense output
    target: Array  # (1,) s, time to which this step was to lead
    state: NDArray[np.int64]  # words
    copy: NDArray[np.int64]
    trial: NDArray[np.int64]  # the state before the trial; used only if events restart the solver
    sides: NDArray[np.int64]  # (k,) sides and bands of the search before the trial
    bands: Array

    @staticmethod
    def allocate(sensors: int = 1) -> StepBegin:
        """Return a place that has not got its memory, see :class:`.image.MemoryImage`."""
        z, i = np.zeros, np.int64
        return StepBegin(z(1, i), z(1), z(1, i), z(1, i), z(1, i), z(sensors, i), z(sensors))

    def snapshot(self, first: NDArray[Any], restarts: bool) -> Any:
        """Return what :class:`.image.MemoryImage` needs to give it its memory: that before the array ``first``."""
        return self.state, ([self.copy, self.trial] if restarts else [self.copy]), first


def event_numbers(mechanism: Any) -> Array:
    """Return the numbers of the events of a mechanism: see :class:`EventMemory`."""
    events: list[Event] = mechanism.events
    crossed = [event.value for event in events if event.sensor is not None]
    times = [event.time for event in events if event.sensor is None]
    values = [_value(action) for event in events for action in event.actions]
    lasting = [event.lasts for event in events if event.sensor is not None]
    return np.array([*crossed, *times, *values, *lasting], float)


def event_parameters(mechanism: Any) -> list[str]:
    """Return the names of the parameters that events of a mechanism set."""
    actions = (action for event in mechanism.events for action in event.actions)
    return list(dict.fromkeys(action.name for action in actions if isinstance(action, SetParameter)))


def _value(action: Action) -> float:
    if isinstance(action, Bounce):
        return action.restitution
    return float(action.value) if isinstance(action, SetInput | SetParameter | Impulse) else 0.0


def event_structure(mechanism: Any) -> list[tuple[Any, ...]]:
    """Return what native FMUs have of the events as it is at the export: all but their numbers."""
    return [
        (event.name, event.sensor is None, event.direction, event.lasts > 0.0, *map(_structure, event.actions))
        for event in mechanism.events
    ]


def _structure(action: Action) -> tuple[Any, ...]:
    if isinstance(action, Impulse):
        return Impulse, action.body.index, action.coordinate
    if isinstance(action, Lock | Release):
        return type(action), action.joint.index
    return type(action), getattr(action, "name", "")


def memory_of(compiled: CompiledMechanism) -> EventMemory:
    """Return the events of a compiled mechanism."""
    events, system = compiled.mechanism.events, compiled.system
    numbers = {variable.name: k for k, variable in enumerate(compiled.inputs.variables)}
    sensed = [k for k, event in enumerate(events) if event.sensor is not None]
    timed = [k for k, event in enumerate(events) if event.sensor is None]
    listed = [(k, action) for k, event in enumerate(events) for action in event.actions]
    actions, locks = ActionRecord.zeros(len(listed)), lock_records(compiled)
    locked, tuned = locks["body"].tolist(), event_parameters(compiled.mechanism)
    for row, (k, action) in zip(actions, listed, strict=True):
        row["event"], row["kind"] = k, ACTION_KINDS[type(action)]
        if isinstance(action, SetInput):
            row["place"] = numbers[action.name]
        elif isinstance(action, SetParameter):
            row["place"] = tuned.index(action.name)
        elif isinstance(action, Impulse):
            row["place"] = int(compiled.data.arrays.bodies["vf"][action.body.index]) + action.coordinate
        elif isinstance(action, Bounce):
            row["place"] = sensed.index(k)
        elif isinstance(action, Lock | Release):
            row["place"] = locked.index(action.joint.index) if action.joint.index in locked else NEVER_LOCKED
    own_events = event_numbers(compiled.mechanism), sensed, timed, len(events)
    units = [event.sensor.unit for event in events if event.sensor is not None]
    nominals = np.array([compiled.nominal(unit) for unit in units])
    ways = [event.direction for event in events if event.sensor is not None]
    return EventMemory.allocate(actions, locks, *own_events, nominals, ways, len(tuned), (system.nq, system.n))


def lock_records(compiled: CompiledMechanism) -> Any:
    """Return the joints that events or stops of a compiled mechanism lock."""
    arrays = compiled.data.arrays
    signals = {body: compiled.locks.signals[body] for body in joints_to_hold(compiled.mechanism)}
    polynomials, locks = compiled.inputs.own.polynomials, LockRecord.zeros(len(signals))
    first = polynomials.ctypes.data - arrays.memory.ctypes.data
    for record, (body, number) in zip(locks, signals.items(), strict=True):
        own = arrays.bodies[body]
        record["body"], record["position"], record["velocity"], record["signal"] = body, own["qf"], own["vf"], number
        record["polynomial"] = (int(arrays.signals[number]["at"]) - first) // polynomials.itemsize
    return locks


def empty_memory() -> EventMemory:
    """Return events of the types that all have, without any event."""
    records = ActionRecord.zeros(1), LockRecord.zeros(1)
    return EventMemory.allocate(*records, np.zeros(4), [0], [0], 1, np.zeros(1), [0], 1, (1, 1))


def refuse_unsupported(compiled: CompiledMechanism) -> None:
    """Raise UserError if native FMUs do not support one of the events of a compiled mechanism."""
    reasons: dict[type[Action], str] = {}
    if compiled.histories:  # steps on trial would change them
        reasons[Restart] = "models with friction of sheets that sticks"
    allowed = ", ".join(kind.__name__ for kind in ACTION_KINDS if kind not in reasons)
    for event in compiled.mechanism.events:
        for action in event.actions:
            if type(action) in reasons:
                raise UserError(
                    f"native FMUs do not support the action {type(action).__name__} of event {event.name!r} in "
                    f"{reasons[type(action)]}; allowed: {allowed}. Remove the action, or export the model with "
                    "--python",
                    "not-native",
                )


def refuse_constant_parameters(
    events: Sequence[Event], ranges: Mapping[str, tuple[float, float]], fixed: Mapping[str, str]
) -> None:
    """Raise UserError if an event sets a parameter that is constant in a native FMU, or a value that the export has not
    verified.

    ``ranges`` are the verified values of the parameters that can be set, ``fixed`` the reasons of the others.
    """
    for event in events:
        for action in event.actions:
            if not isinstance(action, SetParameter):
                continue
            name, value, why = action.name, action.value, fixed.get(action.name, "")
            low, high = ranges.get(name, (-np.inf, np.inf))
            if not why and not low <= value <= high:
                why = f"the export has verified the values {low:g} to {high:g}"
            if why:
                raise UserError(
                    f"event {event.name!r} sets the parameter {name!r} to {value!r}, which a native FMU does not "
                    f"support: {why}. Use another value or parameter, or export the model with --python",
                    "not-native",
                )

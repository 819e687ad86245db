"""Numbering of a mechanism: where coordinates, signals, parts, numbers and scratch memory of its elements are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np

from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.checks import signal_of
from mbfmu.mechanics.events import Lock
from mbfmu.mechanics.joints import Section
from mbfmu.mechanics.kind import ElementType, check_element_type, check_field_names
from mbfmu.mechanics.loads.base import FirstOrderState
from mbfmu.mechanics.loads.state_equation import StateEquation
from mbfmu.mechanics.signals import Input, Polynomial, Signal, SpeedInput
from mbfmu.mechanics.signals.followed import Followed
from mbfmu.util.errors import UserError
from solvers.compiled.record_view import round_up

from .given_inputs import GivenInputs


@dataclass(frozen=True)
class Variable:
    """Input or output of a mechanism."""

    name: str  # unique, structured as ``crank.angle``
    unit: str  # in the notation of FMI, such as ``rad/s``
    description: str = ""  # empty: none
    start: float = 0.0  # start value of an input
    nominal: float | None = None  # typical size in the unit; None: it follows from unit and mechanism


GRAVITY_SIGNAL = -1  # in place of a signal's number


@dataclass(frozen=True)
class Slot:
    """Where the value of an input is kept: a coefficient of a signal, or a component of gravity."""

    variable: Variable
    signal: int
    coefficient: int


class Numbering:
    """Offsets of every joint in the full and the free coordinates; signals in the order they are met.

    First-order states follow all velocities in both.

    Attributes
    ----------
    states
        First-order states with their full names, in the order of their numbers.
    state_places
        Their places in State.v, by full name.
    first_states
        Place of the first state of every load.
    holds
        Numbers of the constant signals that joints follow while they are locked, by the number of the body.
    numbers
        Contents of ``Arrays.numbers``.
    history
        Places in ``numbers`` that kernels change during the run.
    """

    def __init__(self, mechanism: Mechanism, given_inputs: GivenInputs | None = None) -> None:
        self._given_inputs = given_inputs
        self._shared = tuple(mechanism.gravity_signals.values())  # used by many loads, kept once
        self.signals: list[Signal] = []
        self.parts: list[ElementType] = []
        self.scratch_places: list[tuple[np.dtype[Any], int]] = []
        self.scratch_size = self.bearings = 0
        self.slots: list[Slot] = []
        self.q: list[int] = []
        self.v: list[int] = []
        self.qf: list[int] = []
        self.vf: list[int] = []
        self.drive: list[int] = []
        self.coordinate_names: list[str] = []
        self.numbers: list[float] = []
        self.history: list[int] = []
        self._shared_histories: dict[str, int] = {}
        self.nq_full = self.nv_full = self.nq = self.nv = 0
        for axis, gravity in mechanism.gravity_inputs.items():
            ((name, unit, description, start),) = gravity.variables()
            if given_inputs:
                given_inputs.hold(name, unit, "gravity is no signal of a mechanism")
            self._slot(Variable(name, unit, description, start), GRAVITY_SIGNAL, axis)
        for body in mechanism.bodies:
            self._count(body)
        self.holds = {k: self._number(Polynomial((0.0,))) for k in joints_to_hold(mechanism)}
        self.s = list(self.v)
        self.subspaces = self.nv_full
        for body in mechanism.bodies:
            if shares_coordinates(body):
                self.s[body.index] = self.subspaces
                self.subspaces += body.joint.nv
        self.states = list(states_of(mechanism))
        for name, _ in self.states:
            if name in self.coordinate_names:
                raise UserError(f"state {name!r} has the name of a joint coordinate; use another name")
        self.state_places = {name: self.nv_full + k for k, (name, _) in enumerate(self.states)}
        self.first_states = first_states(mechanism, self.nv_full)
        self.nv_full += len(self.states)
        self.nv += len(self.states)
        self.coordinate_names += [name for name, _ in self.states]

    def _count(self, body: Body) -> None:
        joint = body.joint
        if isinstance(joint, Section) and joint.frame is not None:
            for numbers in (self.q, self.v, self.qf, self.vf, self.drive):
                numbers.append(numbers[joint.frame.index])
            return
        driven = joint.drive is not None
        self.q.append(self.nq_full)
        self.v.append(self.nv_full)
        self.nq_full += joint.nq
        self.nv_full += joint.nv
        self.qf.append(-1 if driven else self.nq)
        self.vf.append(-1 if driven else self.nv)
        self.drive.append(self._number(self._drive(body), drive=True) if driven else -1)
        if not driven:
            self.nq += joint.nq
            self.nv += joint.nv
            name = body.coordinate_name
            self.coordinate_names += [f"{name}.{c}" if c else name for c in joint.coordinates]

    def _drive(self, body: Body) -> Signal:
        """Return the signal that a joint follows; UserError for one that jumps."""
        what = f"drive of body {body.name!r}"
        signal = self._given(signal_of(body.joint.drive, what, drive=True), what, drive=True)
        if not signal.drives:
            raise UserError(
                f"{what} is {signal!r}; its value or its rate is discontinuous, which no joint can "
                "follow. Use a smooth signal"
            )
        return signal

    def _given(self, signal: Signal, what: str, *, drive: bool = False) -> Signal:
        """Return what a signal is given by for the whole run, if it is an input that is, else itself."""
        if self._given_inputs is not None and isinstance(signal, Input | SpeedInput):
            signal = self._given_inputs.replace(signal, drive=drive)
        check_element_type(what, signal, Signal)
        return signal

    def signal(self, value: Any, what: str) -> int:
        """Number a signal and, if it is an input, its slots; one input object may load several things."""
        return self._number(self._given(signal_of(value, what), what))

    def scratch(self, dtype: np.dtype[Any]) -> int:
        """Return the place of scratch memory with these fields, bytes; equal fields share it."""
        for known, place in self.scratch_places:
            if known == dtype:
                return place
        place, self.scratch_size = self.scratch_size, self.scratch_size + round_up(dtype.itemsize)
        self.scratch_places.append((dtype, place))
        return place

    def keep(self, values: Any) -> int:
        """Keep numbers; return where they begin."""
        first = len(self.numbers)
        self.numbers.extend(np.ravel(values))
        return first

    def keep_history(self, count: int, shared: str) -> int:
        """Keep zeros that change during the run, once for each name that is ``shared``; return where they begin."""
        if shared in self._shared_histories:
            return self._shared_histories[shared]
        first = self.keep(np.zeros(count))
        self.history += range(first, first + count)
        if shared:
            self._shared_histories[shared] = first
        return first

    def _number(self, signal: Signal, *, drive: bool = False) -> int:
        if isinstance(signal, Input) and signal.acceleration_name and not drive:
            raise UserError(
                f"input {signal.name!r} has an acceleration, {signal.acceleration_name!r}, and does not drive a joint; "
                "leave out acceleration_name"
            )
        if isinstance(signal, Input | Followed) or any(signal is shared for shared in self._shared):
            for index, known in enumerate(self.signals):
                if known is signal:
                    return index
        index = len(self.signals)
        self.signals.append(signal)
        for coefficient, (name, unit, description, start) in enumerate(signal.variables()):
            if name:
                error = signal.force_error if drive and isinstance(signal, Input) and not coefficient else ""
                text = "; ".join(filter(None, (description, error)))
                self._slot(Variable(name, unit, text, start), index, coefficient)
        return index

    def _slot(self, variable: Variable, signal: int, coefficient: int) -> None:
        if variable.name in [slot.variable.name for slot in self.slots]:
            raise UserError(
                f"input {variable.name!r} is used twice; use one Input object for all loads and drives with this "
                "input, or choose other names"
            )
        self.slots.append(Slot(variable, signal, coefficient))


def lockable_joints(mechanism: Mechanism) -> list[int]:
    """Return the numbers of the bodies whose joints events lock."""
    actions = [action for event in mechanism.events for action in event.actions]
    return sorted({action.joint.index for action in actions if isinstance(action, Lock)})


def joints_to_hold(mechanism: Mechanism) -> list[int]:
    """Return the numbers of the bodies whose joints are locked in runs: by events, or at stops that are rested on."""
    stops = {event.holding_joint for event in mechanism.events} - {None}
    return sorted({*lockable_joints(mechanism), *(body for body in stops if body is not None)})


def shares_coordinates(body: Body) -> bool:
    """Whether the coordinates of a body's joint are another body's."""
    return isinstance(body.joint, Section) and body.joint.frame is not None


def states_of(mechanism: Mechanism) -> Iterator[tuple[str, FirstOrderState]]:
    """Yield the first-order states of all loads in the order of their numbers, with their full names; UserError for
    names that are used twice.
    """
    used: set[str] = set()
    for acting in mechanism.loads():
        alone = isinstance(acting.load, StateEquation)
        for state in acting.load.states:
            name = state.name if alone else f"{acting.name or acting.place}.{state.name}"
            if name in used:
                raise UserError(f"two first-order states are named {name!r}; use another name for one of them")
            used.add(name)
            yield name, state


def held_states(mechanism: Mechanism) -> list[bool]:
    """Return of each first-order state whether steady states without slip keep its start value."""
    return [state.is_held_at_rest for acting in mechanism.loads() for state in acting.load.states]


def first_states(mechanism: Mechanism, first: int) -> list[int]:
    """Return for every load where its first state is in State.v, from ``first`` on."""
    counts = [len(acting.load.states) for acting in mechanism.loads()]
    return list(accumulate(counts, initial=first))[: len(counts)]


class Magnitude(NamedTuple):
    """A signal of a load."""

    value: Any  # as the load gives it
    number: int


Magnitudes = dict[str, list[Magnitude]]  # signals of loads, by what each is in messages


class CompiledAttachment:
    """Where something of a kind is in a mechanism, see :class:`mbfmu.mechanics.kind.Attachment`."""

    def __init__(
        self, name: str, bodies: tuple[Body, ...], numbering: Numbering, known: Magnitudes, first_state: int = 0
    ) -> None:
        self.name, self.bodies, self.first_state = name, tuple(body.index for body in bodies), first_state
        self._numbering, self._known = numbering, known
        self.joint = bodies[0].joint if bodies else None
        first = self.bodies[0] if bodies else 0
        self.q, self.v, self.used, self.used_parts = numbering.q[first], numbering.v[first], list[int](), list[int]()
        self.used_states = list[int]()

    def signal(self, value: Any, what: str) -> int:
        """Number a signal; loads of one name that give the same object share it."""
        known = self._known.setdefault(what, [])
        number = next((own.number for own in known if own.value is value), None)
        if number is None:
            number = self._numbering.signal(value, what)
            known.append(Magnitude(value, number))
        self.used.append(number)
        return number

    def state_place(self, state: Any) -> int:
        """Return where a first-order state is in State.v."""
        self.used_states.append(self._numbering.state_places[state.name])
        return self.used_states[-1]

    def part(self, part: ElementType) -> int:
        """Number a part, each object once."""
        known = self._numbering.parts
        index = next((k for k, other in enumerate(known) if other is part), len(known))
        if index == len(known):
            known.append(part)
        self.used_parts.append(index)
        return index

    def scratch(self, dtype: np.dtype[Any]) -> int:
        """Return the place of scratch memory with these fields, bytes; raises UserError for their names."""
        if not isinstance(dtype, np.dtype) or not dtype.names:
            raise UserError(f"scratch memory of {self.name} is {dtype!r}; allowed: a NumPy dtype of named fields")
        check_field_names(f"scratch memory of {self.name}", dtype)
        return self._numbering.scratch(dtype)

    def bearing(self) -> int:
        """Return the number of a new record in ``State.bearings``."""
        self._numbering.bearings += 1
        return self._numbering.bearings - 1

    def numbers(self, values: Any) -> int:
        """Keep numbers; return where they begin."""
        return self._numbering.keep(values)

    def history(self, count: int, shared: str = "") -> int:
        """Keep zeros that kernels change during the run; return where they begin."""
        return self._numbering.keep_history(count, shared)

"""What moves and loads a plant from outside: its drives, and the inputs that a host sets."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.numbers import finite
from mbfmu.mechanics.sensors import Follows
from mbfmu.mechanics.signals import InUse, SpeedInput
from solvers.system import Array

from .compile import GRAVITY, Numbering
from .extrapolated import Extrapolated
from .motion import Departure, InputMotion, impulse
from .scale import joint_sizes


class Drives:
    """The signals that driven coordinates follow, each once.

    Attributes
    ----------
    signals
        Their numbers.
    sizes
        The unit of the coordinate that each drives, by its number.
    """

    def __init__(self, mechanism: Mechanism, numbering: Numbering, signals: list[InUse], length: float) -> None:
        self._signals = signals
        driven = [(b, numbering.drive[b.index]) for b in mechanism.bodies if b.joint.drive is not None]
        self._bodies = [(body.name, k) for body, k in driven]
        self._places = {body.index: k for body, k in driven}
        self.sizes = {k: float(joint_sizes(body.name, body.joint, length)[0]) for body, k in driven}
        self.signals = sorted(self.sizes)

    def speeds(self) -> list[tuple[str, float, bool]]:
        """Return name and speed of every driven body, and whether that is constant."""
        return [(name, *self._signals[k].steady()) for name, k in self._bodies]

    def rates(self) -> list[float]:
        """Return the constant speed of every drive, without sign, in units of its coordinate per second."""
        return [abs(self._signals[k].steady()[0]) / self.sizes[k] for k in self.signals]

    def paces(self, bodies: Iterable[int] | None = None) -> list[float]:
        """Return the pace of every drive that moves, s; of those of these bodies only, by their number, if given."""
        signals = self.signals if bodies is None else {self._places[b] for b in bodies if b in self._places}
        return [pace for pace in map(self.pace, signals) if pace]

    def pace(self, signal: int) -> float:
        """Return a time (s) in which a drive moves by about the unit of its coordinate; zero: it never moves."""
        return self._signals[signal].pace(self.sizes[signal])

    def finish_run_ups(self) -> None:
        """Let every drive that runs up have its full speed from now on."""
        for k in self.signals:
            own = self._signals[k]
            own.signal.run_on(own)

    def full_speeds(self) -> Array:
        """Return the constant speed of every signal that drives, sums by their parts, in their order."""
        return np.array([leaf.steady()[0] for leaf in self._moving(self._signals)])

    def run_at(self, speeds: Array, signals: list[InUse]) -> None:
        """Let those of all ``signals`` that drive have these constant speeds, in the order of :meth:`full_speeds`."""
        for leaf, speed in zip(self._moving(signals), speeds, strict=True):
            leaf.signal.run_at(leaf, speed)

    def _moving(self, signals: list[InUse]) -> list[InUse]:
        return [leaf for k in self.signals for leaf in signals[k].signal.moving(signals[k])]


class Inputs:
    """The inputs of a plant, by number.

    Attributes
    ----------
    variables
        Name, unit, meaning and start of each.
    signals
        Numbers of the signals they are kept in.
    """

    def __init__(self, numbering: Numbering, arrays: Any, signals: list[InUse], drives: Drives) -> None:
        self._slots, self._arrays = tuple(numbering.slots), arrays
        self._records = [signal.record for signal in signals]
        self.variables = tuple(slot.variable for slot in self._slots)
        self._names = [f"input {variable.name!r}" for variable in self.variables]
        inner = [slot for slot in self._slots if slot.signal != GRAVITY]
        self._courses = {slot.signal: self._records[slot.signal]["c"] for slot in inner}  # coefficients, in place
        self.signals = {slot.signal for slot in self._slots}
        self._motions: dict[int, InputMotion] = {}  # of every drive that is an input, by the number of its signal
        for slot in self._slots:
            k = slot.signal
            if k in drives.signals and k not in self._motions:
                speed = isinstance(numbering.signals[k], SpeedInput)
                self._motions[k] = InputMotion(slot.variable.name, self._records[k], speed=speed)
        self._extrapolated: dict[int, Extrapolated] = {}  # loads that change between points, by number of the input

    def extrapolate(self) -> None:
        """Extrapolate loads between points, see :mod:`.extrapolated`; not gravity, nor where the host gives a rate."""
        rated = {slot.signal for slot in self._slots if slot.coefficient}
        for index, slot in enumerate(self._slots):
            if slot.signal != GRAVITY and slot.signal not in rated and not self.moves_support(index):
                self._extrapolated[index] = Extrapolated(self._records[slot.signal])

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._slots)

    def places(self, arrays: Any, signals: list[InUse]) -> list[tuple[Any, int]]:
        """Return where the complex twin of the plant keeps every input: a vector and an index."""
        gravity = arrays.world["gravity"][0]
        return [(gravity if s.signal == GRAVITY else signals[s.signal].record["c"], s.coefficient) for s in self._slots]

    def moves_support(self, index: int) -> bool:
        """Whether an input is the position or the rate of a driven coordinate."""
        return self._slots[index].signal in self._motions

    def changes(self, index: int, follows: Follows) -> bool:
        """Whether an input changes, at the moment it is set, what follows so: a support and a rate take a step."""
        slot = self._slots[index]
        if slot.signal == GRAVITY:
            return follows >= Follows.GRAVITY
        return not slot.coefficient and not self.moves_support(index) and follows >= Follows.LOADS

    def weighs(self, index: int) -> bool:
        """Whether an input is gravity, which changes the potential energy where it is set."""
        return self._slots[index].signal == GRAVITY

    def start(self, index: int, value: float, t: float = 0.0) -> None:
        """Let an input (finite) have another value at the start, t."""
        self._hold(index, value, t)
        if self.moves_support(index):
            self._motions[self._slots[index].signal].start()
        elif index in self._extrapolated:
            self._extrapolated[index].start(value)

    def set(self, index: int, value: float, t: float = 0.0) -> None:
        """Take the value of an input at time t; raises UserError where that is not finite.

        What loads the mechanism holds from t on, or goes on; one with a rate goes on from what it has reached. What
        moves a support is noted, for :meth:`depart`.
        """
        if self.moves_support(index):
            slot = self._slots[index]
            self._motions[slot.signal].give(slot.coefficient, finite(self._names[index], value))
        elif index in self._extrapolated:
            self._extrapolated[index].give(t, finite(self._names[index], value))
        else:
            self._hold(index, value, t)

    def _hold(self, index: int, value: float, t: float) -> None:
        slot = self._slots[index]
        value = finite(self._names[index], value)
        if slot.signal == GRAVITY:
            self._arrays.world["gravity"][0, slot.coefficient] = value
            return
        signal, c = self._records[slot.signal], self._courses[slot.signal]
        c[0] += (t - signal["t0"]) * c[1]
        signal["t0"] = t
        c[slot.coefficient] = value

    @property
    def remember(self) -> bool:
        """Whether any of them remembers what it was at points before."""
        return bool(self._motions or self._extrapolated)

    @property
    def settled(self) -> bool:
        """Whether every support and every load goes on as it does until an input is set."""
        supports = all(motion.settled for motion in self._motions.values())
        return supports and all(load.settled for load in self._extrapolated.values())

    def load(self, t: float, end: float) -> bool:
        """Begin a step from t to ``end``; whether a load goes on otherwise than it did."""
        changed = [load.depart(t, end) for load in self._extrapolated.values()]
        return any(changed)

    def pass_by(self, t: float) -> None:
        """Note a communication point at which nothing changed."""
        for load in self._extrapolated.values():
            load.pass_by(t)

    def depart(self, t: float, end: float) -> list[Departure]:
        """Return the supports whose motion changes at t for a step until ``end`` (s), see :mod:`.motion`."""
        found = (motion.depart(t, end) for motion in self._motions.values())
        return [departure for departure in found if departure is not None]

    def set_out(self, t: float, departures: Sequence[Departure], accelerations: Callable[[], Array]) -> Array | None:
        """Let supports depart at t; return the jump of the free velocities (n,), or None where no rate jumps.

        ``accelerations`` returns v' (n,) at t; what it raises leaves the supports on their way.
        """
        dv = None
        if any(d.jump != 0.0 for d in departures):
            before = [d.motion.course() for d in departures]
            try:
                dv = impulse(t, departures, accelerations)
            finally:
                for departure, (begin, path) in zip(departures, before, strict=True):
                    departure.motion.follow(begin, path)
        for motion, segment, _ in departures:
            motion.set_out(segment)
        return dv

    def state(self) -> dict[str, list[Any]]:
        """Return what the inputs hold, to be given to :meth:`restore`."""
        held: list[Any] = []
        for slot in self._slots:
            if slot.signal == GRAVITY:
                held.append((0.0, [float(self._arrays.world["gravity"][0, slot.coefficient])]))
            else:
                signal = self._records[slot.signal]
                held.append((float(signal["t0"]), [float(x) for x in signal["c"]]))
        motions = [motion.state() for motion in self._motions.values()]
        return {"held": held, "motions": motions, "loads": [load.state() for load in self._extrapolated.values()]}

    def restore(self, state: dict[str, list[Any]]) -> None:
        """Let the inputs hold what they held when ``state`` was taken."""
        for slot, (t0, c) in zip(self._slots, state["held"], strict=True):
            if slot.signal == GRAVITY:
                self._arrays.world["gravity"][0, slot.coefficient] = c[0]
            else:
                signal = self._records[slot.signal]
                signal["t0"], signal["c"] = t0, c
        for motion, remembered in zip(self._motions.values(), state["motions"], strict=True):
            motion.restore(remembered)
        for load, known in zip(self._extrapolated.values(), state["loads"], strict=True):
            load.restore(known)

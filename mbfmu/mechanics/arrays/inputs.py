"""What moves and loads a compiled mechanism from outside: its drives, and the inputs that a host sets."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Set
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.numbers import finite
from mbfmu.mechanics.sensors import Follows
from mbfmu.mechanics.signals import InUse, SpeedInput, Step
from solvers.compiled.tuple_pointer import pin
from solvers.system import Array

from .input_kernels import (
    EXTRAPOLATED_LOAD,
    GRAVITY_LOAD,
    HELD_LOAD,
    SUPPORT_MOTION,
    InputRecords,
    all_finished,
    begin_inputs,
    skip_points,
    start_input,
)
from .numbering import GRAVITY_SIGNAL, Numbering
from .scale import joint_sizes

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays


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

    def terms(self) -> list[tuple[str, float, InUse]]:
        """Return the first body that each drive moves, the unit of its coordinate, and the drive; sums by terms."""
        own = [(k, self._signals[k]) for k in self.signals]
        return [(self.name(k), self.sizes[k], term) for k, drive in own for term in drive.signal.moving(drive)]

    def name(self, signal: int) -> str:
        """Return the first body that a signal drives."""
        return next(name for name, k in self._bodies if k == signal)

    def rates(self) -> list[float]:
        """Return the constant speed of every drive, without sign, in units of its coordinate per second."""
        return [abs(self._signals[k].steady()[0]) / self.sizes[k] for k in self.signals]

    def time_scales(self, bodies: Iterable[int] | None = None) -> list[float]:
        """Return the time scale of every drive that moves, s; of those of these bodies only, if given."""
        signals = self.signals if bodies is None else {self._places[b] for b in bodies if b in self._places}
        return [scale for scale in map(self.time_scale, signals) if scale]

    def time_scale(self, signal: int) -> float:
        """Return a time (s) in which a drive moves by about the unit of its coordinate; zero: it never moves."""
        return self._signals[signal].time_scale(self.sizes[signal])

    def full_speeds(self) -> Array:
        """Return the constant speed of every signal that drives, sums by their parts, in their order."""
        return np.array([leaf.steady()[0] for leaf in self._moving(self._signals)])

    def run_at(self, speeds: Array, signals: list[InUse]) -> None:
        """Let those of all ``signals`` that drive have these constant speeds, in the order of :meth:`full_speeds`."""
        for leaf, speed in zip(self._moving(signals), speeds, strict=True):
            leaf.signal.run_at(leaf, speed)

    def steps(self, signals: list[InUse]) -> list[InUse]:
        """Return those of all ``signals`` that are driving steps, in a fixed order."""
        return [leaf for leaf in self._moving(signals) if type(leaf.signal) is Step]

    def _moving(self, signals: list[InUse]) -> list[InUse]:
        return [leaf for k in self.signals for leaf in signals[k].signal.moving(signals[k])]


class Inputs:
    """The inputs of a compiled mechanism, by number; for communication points see :mod:`.input_kernels`.

    Attributes
    ----------
    variables
        Name, unit, meaning and start of each.
    signals
        Numbers of the signals they are kept in.
    own, pinned
        Their records; as kernels get them.
    """

    def __init__(
        self, numbering: Numbering, arrays: Arrays, signals: list[InUse], polynomials: NDArray[Any], drives: Drives
    ) -> None:
        self._slots, self._arrays = tuple(numbering.slots), arrays
        self._records = [signal.record for signal in signals]
        self.variables = tuple(slot.variable for slot in self._slots)
        self._names = [f"input {variable.name!r}" for variable in self.variables]
        self.signals = {slot.signal for slot in self._slots}
        self._rated = {  # signals whose rate is an input too
            slot.signal for slot in self._slots if slot.coefficient and slot.signal != GRAVITY_SIGNAL
        }
        self._supports: dict[int, str] = {}  # of drives that are inputs: signal, name of the first input
        for slot in self._slots:
            if slot.signal in drives.signals:
                self._supports.setdefault(slot.signal, slot.variable.name)
        self._roles = [self._role(slot.signal) for slot in self._slots]
        begin = polynomials.ctypes.data - arrays.memory.ctypes.data
        places = (arrays.signals["at"] - begin) // polynomials.itemsize  # of signals, where they are polynomials
        self._polynomials = [0 if slot.signal == GRAVITY_SIGNAL else int(places[slot.signal]) for slot in self._slots]
        own = InputRecords.allocate(len(self._slots), 0, len(self._supports), polynomials, arrays.world)
        for support, signal in zip(own.supports, self._supports, strict=True):
            support["polynomial"], support["size"] = places[signal], drives.sizes[signal]
            support["speed"] = isinstance(numbering.signals[signal], SpeedInput)
        self._begin(own)

    def _role(self, signal: int) -> int:
        if signal == GRAVITY_SIGNAL:
            return GRAVITY_LOAD
        return SUPPORT_MOTION if signal in self._supports else HELD_LOAD

    def _begin(self, own: InputRecords) -> None:
        """Take up records whose inputs are zero, and begin."""
        loads = 0
        for record, slot, role, polynomial in zip(own.inputs, self._slots, self._roles, self._polynomials, strict=True):
            record["role"], record["number"], record["coefficient"] = role, polynomial, slot.coefficient
            record["takes_rate"] = self._takes_rate(slot.signal)
            if role == SUPPORT_MOTION:
                record["number"] = list(self._supports).index(slot.signal)
            elif role == EXTRAPOLATED_LOAD:
                record["number"], own.loads[loads]["polynomial"] = loads, polynomial
                loads += 1
        self.own, self.pinned = own, pin(own)
        begin_inputs(self.pinned)

    def extrapolate(self) -> None:
        """Extrapolate loads, see :mod:`.load_extrapolation`; not gravity, nor where the host gives a rate."""
        for index, slot in enumerate(self._slots):
            if self._roles[index] == HELD_LOAD and slot.signal not in self._rated:
                self._roles[index] = EXTRAPOLATED_LOAD
        sizes = len(self._slots), self._roles.count(EXTRAPOLATED_LOAD), len(self._supports)
        own = InputRecords.allocate(*sizes, self.own.polynomials, self.own.world)
        self._begin(own._replace(supports=self.own.supports))

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._slots)

    def places(self, arrays: Arrays, signals: list[InUse]) -> list[tuple[Any, int]]:
        """Return where the complex copy of the compiled mechanism keeps every input: a vector and an index."""
        gravity = arrays.world["gravity"][0]
        return [
            (gravity if s.signal == GRAVITY_SIGNAL else signals[s.signal].record["c"], s.coefficient)
            for s in self._slots
        ]

    def number(self, signal: int, coefficient: int) -> int:
        """Return which input a coefficient of a signal is."""
        places = [(slot.signal, slot.coefficient) for slot in self._slots]
        return places.index((signal, coefficient))

    def scale(self, index: int) -> float:
        """Return what :meth:`places` changes by where an input does by one: a coefficient is half an acceleration."""
        slot = self._slots[index]
        return 0.5 if slot.signal != GRAVITY_SIGNAL and slot.coefficient == 2 else 1.0

    def supports(self) -> dict[int, tuple[str, set[int], bool]]:
        """Return every drive that is an input by the number of its signal: the name of its first input, the derivatives
        that are inputs, and whether its coordinate is the integral of a speed.
        """
        given: dict[int, set[int]] = {}
        for slot in self._slots:
            given.setdefault(slot.signal, set()).add(slot.coefficient)
        return {signal: (name, given[signal], 0 not in given[signal]) for signal, name in self._supports.items()}

    def moves_support(self, index: int) -> bool:
        """Whether an input is the position or the rate of a driven coordinate."""
        return self._roles[index] == SUPPORT_MOTION

    def positions(self) -> list[int]:
        """Return the numbers of the inputs that are the position of a driven coordinate."""
        return [k for k, slot in enumerate(self._slots) if self.moves_support(k) and not slot.coefficient]

    def of_loads(self, signals: Set[int]) -> list[int]:
        """Return the numbers of the inputs that are values of these signals, and not the motion of a joint."""
        slots = enumerate(self._slots)
        return [k for k, s in slots if s.signal in signals and not s.coefficient and not self.moves_support(k)]

    def changes(self, index: int, follows: Follows, signals: Set[int] | None = None) -> bool:
        """Whether an input changes, at the moment it is set, what follows so: a support and a rate take a step.

        ``signals`` are the numbers of those that the quantity depends on; None: on all, and on gravity.
        """
        slot = self._slots[index]
        if signals is not None and slot.signal not in signals:
            return False
        if slot.signal == GRAVITY_SIGNAL:
            return follows >= Follows.GRAVITY
        return not slot.coefficient and not self.moves_support(index) and follows >= Follows.LOADS

    def _takes_rate(self, signal: int) -> bool:
        """Whether the host may give the time derivative of an input of a signal: it is its only one."""
        return signal != GRAVITY_SIGNAL and sum(slot.signal == signal for slot in self._slots) == 1

    def takes_rate(self, index: int) -> bool:
        """Whether the host may give the time derivative of an input with its value: not of gravity, nor of one that has
        an input for its rate, or is that.
        """
        return self._takes_rate(self._slots[index].signal)

    def start(self, index: int, value: float, t: float = 0.0) -> None:
        """Set the value of an input at the start, t; raises UserError if it is not finite."""
        start_input(self.pinned, index, self.checked(index, value), t)

    def checked(self, index: int, value: float) -> float:
        """Return the value of an input; raises UserError if it is not finite."""
        return finite(self._names[index], value)

    def begin(self, t: float, given: Mapping[int, float]) -> None:
        """Let all inputs begin at t (s), with the values ``given`` by number or their start values.

        What they move has not moved before t.
        """
        for index, variable in enumerate(self.variables):
            self.start(index, given.get(index, variable.start), t)

    @property
    def motions_finished(self) -> bool:
        """Whether every support and every load continues unchanged until an input is set."""
        return bool(all_finished(self.pinned))

    def skip_points(self, t: float) -> None:
        """Note a communication point at which nothing changed."""
        skip_points(self.pinned, t)

    def jumping(self) -> list[str]:
        """Return the names of the supports that depart with a jump of their rate."""
        both = zip(self._supports.values(), self.own.supports, strict=True)
        return [name for name, support in both if support["departs"] and support["jump"] != 0.0]

    def jumped(self) -> list[tuple[str, float, str]]:
        """Return name, size and unit of every jump of a position with which a support motion has started, farther than
        its rate explains.
        """
        found, units = [], {v.name: v.unit for v in self.variables}
        for name, support, ahead in zip(self._supports.values(), self.own.supports, self.own.ahead, strict=True):
            size = float(ahead["position"] - ahead["path"][0])
            if support["departs"] and ahead["jumps"]:
                found.append((name, size, units[name]))
        return found

    def state(self) -> dict[str, list[Any]]:
        """Return what the inputs hold and remember, to be given to :meth:`restore`."""
        held: list[Any] = []
        for slot in self._slots:
            if slot.signal == GRAVITY_SIGNAL:
                held.append((0.0, [float(self._arrays.world["gravity"][0, slot.coefficient])]))
            else:
                signal = self._records[slot.signal]
                held.append((float(signal["t0"]), [float(x) for x in signal["c"]]))
        return {"held": held, "remembered": [array.tobytes().hex() for array in self.own.memory()]}

    def restore(self, state: dict[str, list[Any]]) -> None:
        """Let the inputs hold and remember what they did when ``state`` was taken."""
        for slot, (t0, c) in zip(self._slots, state["held"], strict=True):
            if slot.signal == GRAVITY_SIGNAL:
                self._arrays.world["gravity"][0, slot.coefficient] = c[0]
            else:
                signal = self._records[slot.signal]
                signal["t0"], signal["c"] = t0, c
        for array, remembered in zip(self.own.memory(), state["remembered"], strict=True):
            array[:] = np.frombuffer(bytes.fromhex(remembered), array.dtype)

"""Given force between two points, along the line that joins them: an actuator such as a cylinder or a cable.

Its stroke may have limits; see :mod:`.stops` for what acts beyond them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.dispatch import signal_value
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import not_negative, positive
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import inlined, jit_uncached, kernel
from solvers.compiled.record import i8

from .base import Force, PointPairRecord, Points, fill_points
from .distance_stop import DistanceStop
from .given import LINE_QUANTITIES, GivenForce, LawRecord
from .spring import line_of, pull_together, value_on_line
from .stops import LimitRecord, dissipated_power, stop_energy, stop_force

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State


class LineForceRecord(PointPairRecord):
    """Parameters of :class:`LineForce`."""

    signal: i8


class StrokeRecord(LimitRecord, LineForceRecord):
    """Parameters of :class:`LineForce` with limits of the stroke."""


@inlined
def push(force: Any, line: Any, f: Any, state: State) -> None:
    """Let a force ``f``, N, push its points apart. Points that coincide have no line of action: there is no force."""
    length = line[3]
    pull_together(state.bodies[force.a], state.bodies[force.b], line, -f if length != 0.0 else 0.0 * length)


@inlined
def push_limited(force: Any, line: Any, f: Any, state: State) -> None:
    """As :func:`push`, with the force of the end stops."""
    _, _, _, length, rate = line
    push(force, line, f + stop_force(force, length, rate), state)


@inlined
def power_along(line: Any, f: Any) -> Any:
    """Force times rate of the distance."""
    _, _, _, length, rate = line
    return f * rate if length != 0.0 else 0.0 * length


@inlined
def power_along_limited(force: Any, line: Any, f: Any) -> Any:
    """As :func:`power_along`, and what the end stops dissipate."""
    _, _, _, length, rate = line
    return power_along(line, f) + (dissipated_power(force, length, rate) if length != 0.0 else 0.0 * length)


@kernel
def apply(force: LineForceRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    push(force, line_of(force, state), signal_value(force.signal, t, arrays), state)


@kernel
def power(force: LineForceRecord, t: float, arrays: Arrays, state: State) -> float:
    """Force times rate of the distance."""
    return power_along(line_of(force, state), signal_value(force.signal, t, arrays))


@kernel
def apply_limited(force: StrokeRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    push_limited(force, line_of(force, state), signal_value(force.signal, t, arrays), state)


@kernel
def potential_limited(force: StrokeRecord, arrays: Arrays, state: State) -> float:
    """Energy of the stops."""
    _, _, _, length, _ = line_of(force, state)
    return stop_energy(force, length)


@kernel
def power_limited(force: StrokeRecord, t: float, arrays: Arrays, state: State) -> float:
    """Force times rate of the distance, and what the stops dissipate."""
    return power_along_limited(force, line_of(force, state), signal_value(force.signal, t, arrays))


class LimitedLineForce(Force):
    """Record and kernels of a :class:`LineForce` with limits of the stroke."""

    record = StrokeRecord
    apply = apply_limited
    potential = potential_limited
    power = power_limited


class LineLawRecord(LawRecord, PointPairRecord):
    """Parameters of :class:`LineForce` whose magnitude is a law."""


class StrokeLawRecord(LimitRecord, LineLawRecord):
    """Parameters of :class:`LineForce` whose magnitude is a law, with limits of the stroke."""


@cache
def kernels_of(value: Any) -> tuple[Any, Any]:
    """Return ``apply`` and ``power`` of a force that the kernel ``value`` computes."""
    evaluate = value_on_line(value)

    def apply(force: Any, t: float, arrays: Arrays, state: State) -> None:
        line = line_of(force, state)
        push(force, line, evaluate(force, t, arrays, state, line), state)

    def power(force: Any, t: float, arrays: Arrays, state: State) -> Any:
        line = line_of(force, state)
        return power_along(line, evaluate(force, t, arrays, state, line))

    return jit_uncached(apply), jit_uncached(power)


@cache
def limited_kernels_of(value: Any) -> tuple[Any, Any]:
    """Return ``apply`` and ``power`` of a force that the kernel ``value`` computes, with limits of the stroke."""
    evaluate = value_on_line(value)

    def apply(force: Any, t: float, arrays: Arrays, state: State) -> None:
        line = line_of(force, state)
        push_limited(force, line, evaluate(force, t, arrays, state, line), state)

    def power(force: Any, t: float, arrays: Arrays, state: State) -> Any:
        line = line_of(force, state)
        return power_along_limited(force, line, evaluate(force, t, arrays, state, line))

    return jit_uncached(apply), jit_uncached(power)


@dataclass(frozen=True, kw_only=True)
class LineForce(GivenForce):
    """Force between a point of body a and a point of body b, along the line that joins them.

    Its generalized force on a coordinate q is the force times the derivative of the distance of the points by q.

    Parameters
    ----------
    magnitude
        Force, N: number, signal or input; block such as a controller (:meth:`.Mechanism.pid`), state, or sensor of
        positions and velocities; function or expression of the time t (s), the distance x of the points (m) and its
        rate v (m/s): ``"200 * (0.8 - x) - 30 * v"``. With ``uses`` also of the names there. A function of one argument
        that is neither x nor v is one of the time. A positive force pushes the points apart, as the pressure in a
        cylinder does; a negative one pulls them together, as a cable does.
    uses
        Other quantities in a function or expression, by their names, see :class:`.JointForce`.
    at_a, at_b
        Points in the frames of bodies a and b, m.
    lower, upper
        Smallest and largest distance of the points, m: the ends of the stroke. None: no limit on that side.
    stop_stiffness, stop_damping
        Stiffness, N/m, and damping, s/m, of the end stops, as those of a :class:`.DistanceStop`. The stiffness is
        required if there is a limit.

    Notes
    -----
    The sensors ``force`` and ``moment`` contain the force of the end stops. Friction of the actuator is a
    :class:`.LineFriction` between the same points.
    Points that coincide have no line of action, and the force is omitted; a message reports this if it occurs at the
    start. Outputs of distance and rate: ``ForceHandle.length`` and ``ForceHandle.length_rate``.
    """

    record = LineForceRecord
    apply = apply
    power = power
    variants = (LimitedLineForce,)
    law_quantities = LINE_QUANTITIES
    law_record = LineLawRecord
    kernels_of_law = kernels_of

    at_a: Any = (0.0, 0.0, 0.0)
    at_b: Any = (0.0, 0.0, 0.0)
    lower: float | None = None
    upper: float | None = None
    stop_stiffness: float = 0.0
    stop_damping: float = 0.0

    def __post_init__(self) -> None:
        """Take the kernels of a limited stroke."""
        if self._is_limited:
            self.become(LimitedLineForce)
            object.__setattr__(self, "law_record", StrokeLawRecord)
            object.__setattr__(self, "kernels_of_law", limited_kernels_of)
        super().__post_init__()

    @property
    def _is_limited(self) -> bool:
        return self.lower is not None or self.upper is not None

    def _stop(self) -> DistanceStop:
        return DistanceStop(
            lower=self.lower,
            upper=self.upper,
            stiffness=self.stop_stiffness,
            damping=self.stop_damping,
            at_a=self.at_a,
            at_b=self.at_b,
        )

    def check(self, what: str) -> None:
        """Refuse what is no limit, limits without a stiffness, and stops without a limit."""
        if self._is_limited:
            positive(f"stop_stiffness of {what}", self.stop_stiffness)
            not_negative(f"stop_damping of {what}", self.stop_damping)
            self._stop().check(what)
        elif self.stop_stiffness or self.stop_damping:
            raise UserError(
                f"{what} has stop_stiffness {self.stop_stiffness!r} and stop_damping {self.stop_damping!r} without a "
                "limit; give it lower or upper, or leave them out"
            )

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the two points, the magnitude and the limits."""
        if self._is_limited:
            self._stop().fill(record, site)
        fill_points(self, record, site)
        self.fill_magnitude(record, site)

    def points(self) -> Points:
        """Return its two points."""
        return self.at_a, self.at_b

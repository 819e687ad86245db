"""A given force or torque along the coordinate of a joint, a motor between parent and child."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any

from mbfmu.mechanics import law
from mbfmu.mechanics.dispatch import signal_value
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.quantities import Quantity, QuantityLaw, is_motion_quantity, place_of, quantity_of
from mbfmu.mechanics.quantity_kinds import MAX_QUANTITIES, POSITION, TIME, VELOCITY
from mbfmu.mechanics.reading import read_quantity
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import jit_uncached, kernel
from solvers.compiled.record import Integers, Record, i8

from .base import Force

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State


FORCE_QUANTITIES = {"t": TIME, "q": POSITION, "v": VELOCITY}  # names in a law of a force


class JointForceRecord(Record):
    """Parameters of :class:`JointForce`."""

    q: i8
    v: i8
    signal: i8


class JointLawRecord(Record):
    """Parameters of :class:`JointForce` whose magnitude is a law of other quantities."""

    q: i8
    v: i8
    places: Annotated[Integers, (MAX_QUANTITIES,)]  # of the arguments, see mbfmu.mechanics.quantities


class JointQuantityRecord(Record):
    """Parameters of :class:`JointForce` whose magnitude is a block, a state or a sensor."""

    v: i8
    kind: i8  # of the quantity, and its place
    place: i8


@kernel
def apply(force: JointForceRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    state.Q[force.v] += signal_value(force.signal, t, arrays)


@kernel
def power(force: JointForceRecord, t: float, arrays: Arrays, state: State) -> float:
    """Force times rate of the coordinate."""
    return signal_value(force.signal, t, arrays) * state.v[force.v]


@kernel
def apply_quantity(force: JointQuantityRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    state.Q[force.v] += read_quantity(force.kind, force.place, t, arrays, state)


@kernel
def power_of_quantity(force: JointQuantityRecord, t: float, arrays: Arrays, state: State) -> float:
    """Force times rate of the coordinate."""
    return read_quantity(force.kind, force.place, t, arrays, state) * state.v[force.v]


@cache
def kernels_of(f: Any) -> tuple[Any, Any]:
    """Return ``apply`` and ``power`` of a force f(t, q, v)."""
    at = law.at

    def apply(force: Any, t: float, arrays: Arrays, state: State) -> None:
        state.Q[force.v] += at(f, t, state.q[force.q], state.v[force.v])

    def power(force: Any, t: float, arrays: Arrays, state: State) -> Any:
        return at(f, t, state.q[force.q], state.v[force.v]) * state.v[force.v]

    return jit_uncached(apply), jit_uncached(power)


@cache
def kernels_of_law(value: Any) -> tuple[Any, Any]:
    """Return ``apply`` and ``power`` of a force that the kernel ``value`` computes."""

    def apply(force: Any, t: float, arrays: Arrays, state: State) -> None:
        state.Q[force.v] += value(force, t, arrays, state)

    def power(force: Any, t: float, arrays: Arrays, state: State) -> Any:
        return value(force, t, arrays, state) * state.v[force.v]

    return jit_uncached(apply), jit_uncached(power)


class JointQuantityForce(Force):
    """Record and kernels of a :class:`JointForce` whose magnitude is a block, a state or a sensor."""

    record = JointQuantityRecord
    apply = apply_quantity
    power = power_of_quantity


@dataclass(frozen=True)
class JointForce(Force):
    """Torque (N m) or force (N) on a joint coordinate.

    Parameters
    ----------
    magnitude
        Number, signal, input, block such as a controller (:meth:`.Mechanism.pid`), state (:meth:`.Mechanism.state`), or
        sensor of positions and velocities; function or expression of the time t (s), or of t, the coordinate q (rad
        or m) and its rate v: ``lambda t, q, v: -3.0 * v * abs(v)`` or ``"-3 * v * abs(v)"``. With ``uses`` also of the
        names there, in any order: ``"gain * (target - q) + control"``.
    uses
        Other quantities in a function or expression, by their names: numbers, signals, inputs, states, blocks, and
        sensors of positions and velocities.
    """

    record = JointForceRecord
    on_joint = True
    is_linear_in_signals = True
    apply = apply
    power = power
    variants = (JointQuantityForce,)

    magnitude: Any
    uses: Mapping[str, Any] = field(default_factory=dict, kw_only=True, hash=False)

    def __post_init__(self) -> None:
        """Compile a function of the coordinate, and check the names in an expression."""
        if isinstance(self.magnitude, str) and not self.uses:
            law.check_names("magnitude of a JointForce", self.magnitude, tuple(FORCE_QUANTITIES))
        if is_motion_quantity(self.magnitude):
            if self.uses:
                raise UserError("a JointForce has uses, and its magnitude is no function or expression; leave out uses")
            object.__setattr__(self, "_quantity", quantity_of("a JointForce", "magnitude", self.magnitude))
            self.become(JointQuantityForce)
        elif self.uses:
            law_of_all = QuantityLaw("magnitude of a JointForce", self.magnitude, FORCE_QUANTITIES, self.uses)
            object.__setattr__(self, "_law", law_of_all)
            object.__setattr__(self, "record", JointLawRecord)
            object.__setattr__(self, "is_linear_in_signals", False)
            for name, function in zip(("apply", "power"), kernels_of_law(law_of_all.value_kernel()), strict=True):
                object.__setattr__(self, name, function)
        elif self._is_law():
            f = law.law_of("magnitude of a JointForce", self.magnitude, ("t", "q", "v"))
            for name, function in zip(("apply", "power"), kernels_of(f), strict=True):
                object.__setattr__(self, name, function)

    @property
    def quantities(self) -> Mapping[str, Any]:
        """Return the quantities that it uses, by their names."""
        return {"magnitude": self.magnitude} if is_motion_quantity(self.magnitude) else self.uses

    def _is_law(self) -> bool:
        """Whether the force depends on the coordinate or its rate."""
        if isinstance(self.magnitude, str):
            return bool(law.names_in(self.magnitude) & {"q", "v"})
        return callable(self.magnitude) and law.arguments_of("magnitude of a JointForce", self.magnitude) != 1

    def fill(self, record: Any, site: Attachment) -> None:
        """Write its coordinate and its signal."""
        record["v"] = site.v
        if "_quantity" in vars(self):
            quantity: Quantity = vars(self)["_quantity"]
            record["kind"], record["place"] = quantity.kind, place_of(quantity, site, site.name)
            return
        record["q"] = site.q
        if self.uses:
            law_of_all: QuantityLaw = vars(self)["_law"]
            law_of_all.fill(record, site, {"q": site.q, "v": site.v})
        elif not self._is_law():
            record["signal"] = site.signal(self.magnitude, f"magnitude of {site.name}")

"""Dampers without a spring: a force over the rate of a distance or of a joint coordinate, which may be a law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

from mbfmu.mechanics import law
from mbfmu.mechanics.curve import curve
from mbfmu.mechanics.kind import Attachment, kernel_of
from mbfmu.mechanics.numbers import not_negative
from mbfmu.mechanics.signals import Table
from solvers.compiled.kernel import jit_uncached, kernel
from solvers.compiled.record import Record, f8, i8

from .base import Force, PointPairRecord, Points, fill_points
from .joint_spring import kernels_of_quantities as kernels_of_joint_quantities
from .law_of_stretch import fill_law, use_law
from .spring import connecting_line, kernels_of_quantities, pull_together

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State


class DampingRecord(Record):
    """Parameters of :class:`DampingForce`."""

    damping: f8  # N s/m or N m s/rad
    first: i8  # of the numbers of a table, and how many rows it has; none: it is linear
    count: i8


class DamperRecord(DampingRecord, PointPairRecord):
    """Parameters of :class:`Damper`."""


class JointDamperRecord(DampingRecord):
    """Parameters of :class:`JointDamper`."""

    v: i8


@kernel
def damping_force(force: DampingRecord, rate: float, arrays: Arrays) -> float:
    """c v, or the force by the table."""
    if force.count == 0:
        return force.damping * rate
    f, _, _, _ = curve(arrays.numbers, force.first, force.count, rate)
    return f


@kernel
def apply(force: DamperRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    A, B = state.bodies[force.a], state.bodies[force.b]
    line = connecting_line(force, A, B)
    _, _, _, _, rate = line
    pull_together(A, B, line, damping_force(force, rate, arrays))


@kernel
def power(force: DamperRecord, t: float, arrays: Arrays, state: State) -> float:
    """Minus force times rate of the distance."""
    _, _, _, _, rate = connecting_line(force, state.bodies[force.a], state.bodies[force.b])
    return -damping_force(force, rate, arrays) * rate


@kernel
def apply_to_joint(force: JointDamperRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    state.Q[force.v] -= damping_force(force, state.v[force.v], arrays)


@kernel
def power_in_joint(force: JointDamperRecord, t: float, arrays: Arrays, state: State) -> float:
    """Minus force times rate of the coordinate."""
    return -damping_force(force, state.v[force.v], arrays) * state.v[force.v]


@cache
def as_law(f: Any) -> Any:
    """Return a function of the rate as one of the time, the distance and its rate."""

    def of_rate(t: float, x: float, rate: float) -> Any:
        return f(rate)

    return jit_uncached(of_rate)


@cache
def kernels_between(f: Any) -> tuple[Any, Any]:
    """Return ``apply`` and ``power`` of a damper between points whose force is a function."""
    at = law.at

    def apply(force: DamperRecord, t: float, arrays: Arrays, state: State) -> None:
        A, B = state.bodies[force.a], state.bodies[force.b]
        line = connecting_line(force, A, B)
        _, _, _, length, rate = line
        pull_together(A, B, line, at(f, t, length, rate))

    def power(force: DamperRecord, t: float, arrays: Arrays, state: State) -> Any:
        _, _, _, length, rate = connecting_line(force, state.bodies[force.a], state.bodies[force.b])
        return -at(f, t, length, rate) * rate

    return jit_uncached(apply), jit_uncached(power)


@cache
def kernels_in_joint(f: Any) -> tuple[Any, Any]:
    """Return ``apply`` and ``power`` of a damper in a joint whose force is a function."""
    at = law.at

    def apply(force: Any, t: float, arrays: Arrays, state: State) -> None:
        rate = state.v[force.v]
        state.Q[force.v] -= at(f, t, rate, rate)

    def power(force: Any, t: float, arrays: Arrays, state: State) -> Any:
        rate = state.v[force.v]
        return -at(f, t, rate, rate) * rate

    return jit_uncached(apply), jit_uncached(power)


@dataclass(frozen=True, kw_only=True)
class DampingForce(Force):
    """Base class of dampers; ``kernels_of_law`` returns ``apply`` and ``power`` of one with a function."""

    kernels_of_law: ClassVar[Any]

    damping: Any
    uses: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        """Take the kernels of a law or a function."""
        if self.uses:
            use_law(self, "damping", self.damping, self.uses)
        elif self._is_function():
            f = as_law(law.law_of(f"damping of a {type(self).__name__}", self.damping, ("v",)))
            for name, function in zip(("apply", "power"), kernel_of(self, "kernels_of_law")(f), strict=True):
                object.__setattr__(self, name, function)

    def _is_function(self) -> bool:
        return isinstance(self.damping, str) or callable(self.damping)

    def check(self, what: str) -> None:
        """Refuse what is no damping."""
        if not (isinstance(self.damping, Table) or self._is_function()):
            not_negative(f"damping of {what}", self.damping)

    def fill(self, record: Any, site: Attachment) -> None:
        """Write how much."""
        if self.uses:
            fill_law(self, record, site)
        elif isinstance(self.damping, Table):
            self.damping.write(f"damping of {site.name}", record, site)
        elif not self._is_function():
            record["damping"] = self.damping


@dataclass(frozen=True, kw_only=True)
class Damper(DampingForce):
    """Damper between a point of body a and a point of body b.

    Parameters
    ----------
    damping
        Damping, N s/m. A ``Table``, a function ``lambda v: ...`` or an expression ``"300 * v + 50 * v**3"`` gives the
        force (N) over the rate v of the distance of the points (m/s) instead: v is positive and a positive force
        pulls the points together if the distance increases (rebound). With ``uses`` also of the time t (s), the
        distance x (m) and the names there: ``"c * v * valve"``; such a law acts only if the points do not coincide.
    uses
        Other quantities in a function or expression, by their names, see :class:`.JointForce`.
    at_a, at_b
        Points in the frames of bodies a and b, m.

    Notes
    -----
    If the points coincide, v is their relative velocity, and the force acts along it. A force that is not zero at
    v = 0 has a jump there; use a steep law, such as ``"80 * tanh(v / 0.01)"``, or :class:`.JointFriction`.
    """

    record = DamperRecord
    apply = apply
    power = power
    kernels_of_law = kernels_between
    kernels_of_quantities = kernels_of_quantities

    at_a: Any = (0.0, 0.0, 0.0)
    at_b: Any = (0.0, 0.0, 0.0)

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the two points too."""
        super().fill(record, site)
        fill_points(self, record, site)

    def points(self) -> Points:
        """Return its two points."""
        return self.at_a, self.at_b


@dataclass(frozen=True, kw_only=True)
class JointDamper(DampingForce):
    """Damper on the joint coordinate of a body.

    Parameters
    ----------
    damping
        Damping, N m s/rad for an angle and N s/m for a displacement. A ``Table``, a function ``lambda v: ...`` or an
        expression of ``v`` gives the torque (N m) or force (N) over the velocity v of the coordinate (rad/s or m/s)
        instead; it acts against the coordinate if it is positive. With ``uses`` also of the time t (s), the coordinate
        x and the names there.
    uses
        Other quantities in a function or expression, by their names, see :class:`.JointForce`.
    """

    record = JointDamperRecord
    on_joint = True
    apply = apply_to_joint
    power = power_in_joint
    kernels_of_law = kernels_in_joint
    kernels_of_quantities = kernels_of_joint_quantities

    def fill(self, record: Any, site: Attachment) -> None:
        """Write where it acts too."""
        super().fill(record, site)
        record["v"] = site.v
        if self.uses:
            record["q"] = site.q

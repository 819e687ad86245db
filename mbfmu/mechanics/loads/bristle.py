"""An elasto-plastic bristle: dry friction with stick, with one state for each coordinate.

The state z is the force of the bristle over the Coulomb force F = coulomb N, with the normal force N. With the slip v,
the deflection d at |z| = 1, and g(v) = 1 + (static / coulomb - 1) exp(-(|v| / stribeck)^2):

    u     = |z| / g(v)
    alpha = 0 if v . z <= 0 or u <= beta;  1 if u >= 1;  s^2 (3 - 2 s) with s = (u - beta) / (1 - beta) between
    z'    = (v - alpha |v| z / g) / d
    force = -F (z + tau z' / (1 + (tau |v| / d)^2)) - viscous v,        tau = 2 xi (m d / F)^(1/2)

(Dupont, Hayward, Armstrong and Altpeter 2002, Single state elastoplastic friction models). Below beta times the
breakaway force x - d z is constant: the joint returns to its place when the load is removed, and does not creep. Three
things differ from the source. The bristle is scaled by the normal force, so that a joint slides when the normal force
is zero. beta refers to g(v). The damping of the bristle fades with the slip, so that it does not increase the force of
a joint that slides. v and z are numbers for one coordinate, and vectors for the rotation of a ball joint.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from mbfmu.mechanics.dispatch import signal_value
from mbfmu.mechanics.kind import Attachment, kernel_of
from mbfmu.mechanics.numbers import not_negative, positive
from mbfmu.mechanics.quantities import QuantityLaw
from mbfmu.mechanics.quantity_kinds import MAX_QUANTITIES, POSITION, TIME, VELOCITY
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.record import Integers, Record, Vec3, f8, i8

from .base import FirstOrderState, Force
from .reaction import Bearings, Reaction, bearings_of

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State

CREEP_LIMIT = 0.9  # beta: part of the breakaway force below which nothing creeps
BRISTLE_DAMPING_RATIO = 0.7  # xi
RELATIVE_DEFLECTION = 1e-5  # default of the deflection, relative to the size of the coordinate


class BristleRecord(Record):
    """Parameters of :class:`BristleFriction`."""

    v: i8
    state: i8  # place of z
    normal: i8  # signal
    places: Annotated[Integers, (MAX_QUANTITIES,)]  # of the arguments of a law, see mbfmu.mechanics.quantities
    coulomb: f8  # N or N m, per unit of the normal force
    static: f8
    stribeck: f8  # rad/s or m/s
    viscous: f8  # N m s/rad or N s/m
    deflection: f8  # rad or m; 0: the estimated one
    estimated_deflection: f8
    estimated_inertia: f8  # kg m^2 or kg, that the bristle moves


class CombinedRecord(BristleRecord):
    """Parameters of a friction on several coordinates that slide together."""

    count: i8  # of these coordinates, the first of which is v
    arms: Vec3  # slip per unit of each coordinate, 1 or m/rad


@kernel
def deflection_of(force: BristleRecord) -> float:
    """d, rad or m."""
    return force.deflection if force.deflection.real > 0.0 else force.estimated_deflection


@inlined
def stribeck_factor(coulomb: float, static: float, stribeck: float, square: float) -> float:
    """g = 1 + (static / coulomb - 1) exp(-(v / stribeck)^2) at the slip v whose square is given."""
    decay = np.exp(-square / (stribeck * stribeck))
    return 1.0 + (static / coulomb - 1.0) * decay


@kernel
def stribeck_ratio(force: BristleRecord, square: float) -> float:
    """g at the slip whose square is given."""
    if force.static.real > force.coulomb.real:
        return stribeck_factor(force.coulomb, force.static, force.stribeck, square)
    return 1.0 + 0.0 * square


@kernel
def yielding_part(u: float) -> float:
    """alpha of a bristle that is deflected further."""
    if u.real <= CREEP_LIMIT:
        return 0.0 * u
    if u.real >= 1.0:
        return 1.0 + 0.0 * u
    s = (u - CREEP_LIMIT) / (1.0 - CREEP_LIMIT)
    return s * s * (3.0 - 2.0 * s)


@kernel
def yielding_factor(force: BristleRecord, square: float, along: float, length: float) -> float:
    """Factor of z in d z' = v - factor z, given v . v, v . z and z . z."""
    factor = 0.0 * square
    if along.real > 0.0:
        g = stribeck_ratio(force, square)
        factor = yielding_part(np.sqrt(length) / g) * np.sqrt(square) / g
    return factor


@kernel
def bristle_factors(force: BristleRecord, normal: float, square: float) -> tuple[float, float]:
    """Factors of z and z' in the force against the slip whose square is given."""
    coulomb = force.coulomb * normal
    if coulomb.real <= 0.0:
        return 0.0 * (coulomb + square), 0.0 * (coulomb + square)
    d = deflection_of(force)
    tau = 2.0 * BRISTLE_DAMPING_RATIO * np.sqrt(force.estimated_inertia * d / coulomb)
    fading = tau / d
    return coulomb + 0.0 * square, coulomb * tau / (1.0 + fading * fading * square)


@inlined
def signal_of_normal(force: BristleRecord, t: float, arrays: Arrays, state: State) -> float:
    """Normal force that a signal gives."""
    return signal_value(force.normal, t, arrays)


def check_static(what: str, name: str, sliding: float, static: float | None, stribeck: float | None) -> None:
    """Raise UserError for invalid static friction; ``sliding`` is the friction of sliding, the parameter ``name``."""
    if stribeck is not None:
        positive(f"stribeck of {what}", stribeck)
    if static is not None and positive(f"static of {what}", static) < sliding:
        raise UserError(f"static of {what} is {static!r}; allowed: at least {name}, {sliding!r}")
    if static is not None and static > sliding and stribeck is None:
        raise UserError(
            f"stribeck of {what} is not given; give the velocity at which static friction decreases to {name}"
        )


def fill_static(record: Any, sliding: float, static: float | None, stribeck: float | None) -> None:
    """Write static friction and its velocity."""
    record["static"] = sliding if static is None else static
    record["stribeck"] = np.inf if stribeck is None else stribeck


@dataclass(frozen=True, kw_only=True)
class BristleFriction(Force):
    """Base class of dry friction with stick.

    ``variants`` contains the type with the kernels of a normal force that is a :class:`.Reaction`.
    ``kernels_of_normal`` returns ``apply`` and ``power`` with a normal force that a kernel (record, t, arrays, state)
    computes.
    """

    record = BristleRecord
    on_joint = True
    stick_reason = "the bristles of joints with friction are stiff"
    kernels_of_normal: ClassVar[Any]
    law_quantities: ClassVar[Mapping[str, int]] = {"t": TIME, "q": POSITION, "v": VELOCITY}  # names in a normal force

    coulomb: float
    static: float | None = None
    stribeck: float | None = None
    viscous: float = 0.0
    normal_force: Any = 1.0
    uses: Mapping[str, Any] = field(default_factory=dict, hash=False)
    deflection: float | None = None

    def __post_init__(self) -> None:
        """Compile a normal force that is a law, or take the kernels of one that follows the reaction."""
        if self.follows_reaction:
            self.become(self.variants[0])
        elif self.uses:
            law = QuantityLaw(
                f"normal_force of a {type(self).__name__}", self.normal_force, self.law_quantities, self.uses
            )
            object.__setattr__(self, "_law", law)
            for name, function in zip(
                ("apply", "power"), kernel_of(self, "kernels_of_normal")(law.value_kernel()), strict=True
            ):
                object.__setattr__(self, name, function)

    def check(self, what: str) -> None:
        """Refuse values that are no friction."""
        if self.follows_reaction and self.uses:
            raise UserError(
                f"normal_force of {what} is a Reaction and `uses` is given; allowed: a Reaction without `uses`. Leave "
                "out `uses`, or give the normal force as a law"
            )
        coulomb = positive(f"coulomb of {what}", self.coulomb)
        not_negative(f"viscous of {what}", self.viscous)
        if self.deflection is not None:
            positive(f"deflection of {what}", self.deflection)
        check_static(what, "coulomb", coulomb, self.static, self.stribeck)

    @property
    def follows_reaction(self) -> bool:
        """Whether the normal force follows the force and the moment that the joint transmits."""
        return isinstance(self.normal_force, Reaction)

    @property
    def states(self) -> tuple[FirstOrderState, ...]:
        """Return the force of the bristle over the Coulomb force."""
        return (FirstOrderState(name="bristle", is_held_at_rest=True),)

    def bearings(self, joint: Any) -> Bearings:
        """Return the bearings of a joint whose normal force may follow its reaction."""
        return bearings_of(joint)[self.coordinates[0]]

    def check_joint(self, what: str, joint: Any) -> None:
        """Refuse bearings that do not fit the joint."""
        if isinstance(self.normal_force, Reaction):
            self.normal_force.check(what, self.bearings(joint))

    def fill(self, record: Any, site: Attachment) -> None:
        """Write where it acts, and its bearings, too."""
        first = self.coordinates[0]
        record["v"], record["state"] = site.v + first, site.first_state
        if self.uses:
            law: QuantityLaw = vars(self)["_law"]
            law.fill(record, site, {"q": site.q + first, "v": site.v + first})
        elif isinstance(self.normal_force, Reaction):
            record["count"], record["arms"][: len(self.arms)] = len(self.arms), self.arms
            self.normal_force.fill(record, site, self.bearings(site.joint))
        else:
            record["normal"] = site.signal(self.normal_force, f"normal_force of {site.name}")
        record["coulomb"], record["viscous"] = self.coulomb, self.viscous
        fill_static(record, self.coulomb, self.static, self.stribeck)
        record["deflection"] = self.deflection or 0.0

    def fill_estimates(self, record: Any, inertia: float, size: float) -> None:
        """Write the inertia, which damps the bristle, and the default of the deflection."""
        record["estimated_inertia"], record["estimated_deflection"] = inertia, RELATIVE_DEFLECTION * size

    def nominal_displacement(self, record: Any, length: float) -> float:
        """Return the size of the coordinate, rad or m."""
        return float(record["estimated_deflection"]) / RELATIVE_DEFLECTION

    def resolved_displacement(self, record: Any) -> float:
        """Return the deflection of the bristle, rad or m."""
        return float(record["deflection"] or record["estimated_deflection"])

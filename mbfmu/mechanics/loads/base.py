"""Interface of loads: forces, elements between bodies, loads on surfaces.

Its kernels:

    apply(load, t, arrays, state)            adds wrenches to ``state.bodies[i].F`` (about the body's origin, global
                                             axes), or forces along coordinates to ``state.Q``, and the rates of its
                                             first-order states, see :attr:`Load.states`
    potential(load, arrays, state)           returns the energy it stores, J; None: it stores none
    power(load, t, arrays, state)            returns the power in W of what has no potential: dampers take it, given
                                             forces bring it; None: all it does is in its potential
    tangent(load, c1, arrays, state,         adds to K, six rows and columns a body, minus the derivative of what
            perturbed, K)                    ``apply`` adds by the motions of its bodies and c1 times that by their
                                             velocities, and returns 1.0, or 0.0 if there is none; ``perturbed`` is a
                                             complex state, scratch, for complex steps
    monitor(load, arrays, state)             returns how far it is from the limits of its theory, see
                                             :func:`limit_ratio`; None: it does not say
    misplacement(load, arrays, state)        returns how far its bodies are from where it requires them at the start:
                                             more than MAX_MISPLACEMENT is refused; None: it requires nothing
    clearance(load, arrays, state)           returns how far its bodies may be displaced, m, in the measure of
                                             :mod:`mbfmu.mechanics.recursions.active_loads` before it acts: a lower
                                             bound; 0.0 where it may act; None: it always may. Such a load sets
                                             ``state.search[0].has_acted`` to 1 where it acts: where what it applies, or
                                             its derivative, is not zero. Whether it acts depends on the placements of
                                             the bodies with :attr:`Load.levers` alone. It may set bits of its ``parts``
                                             that act, and evaluate these alone if ``is_repeated`` is 1
    longest_step(load, taken, arrays, state) returns how long the next step may be after one of ``taken``, s, such that
                                             its bodies do not pass a place where it acts; None: of any length. It is
                                             called once at the end of every accepted step, where it may change the
                                             numbers that ``fill`` got by ``site.history``, and at the start, with
                                             ``taken`` infinite
    extrapolate(loads, arrays, state)        writes to the records of all loads of its type the strains e + e', by
                                             positions and velocities; ``apply`` and ``tangent`` use them instead of
                                             e if the field ``is_extrapolated`` of the record is 1; None: they have
                                             no strains. Called by statics alone (:mod:`solvers.statics.newton`)

A load without ``tangent`` is differentiated by complex steps, so ``apply`` is analytic in every real
number it reads. A load whose tangent is negligible has ``zero_tangent``. A load that a scene does not call for has no
record, and so no cost.

A type of load may say more about itself, which the rest of the package asks for but does not know: loads that come with
it, why it is not smooth or stiff, and what to check of the positions and of the start. See :class:`Load`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from mbfmu.mechanics.checks import vector
from mbfmu.mechanics.kind import Attachment, ElementType
from mbfmu.mechanics.numbers import finite, positive
from mbfmu.mechanics.spatial import arm
from mbfmu.util.errors import UserError
from mbfmu.util.units import read_unit
from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.record import Record, Vec3, i8

if TYPE_CHECKING:
    from mbfmu.mechanics.arrays.load_groups import LoadGroup
    from mbfmu.mechanics.records import Arrays, MotionRecord, State
    from solvers.compiled.record import Reals

Points = tuple[Any, ...]
#: Largest value of a ``monitor`` at which results are accurate.
MAX_ACCURATE_RATIO = 1.0
#: Largest value of a ``monitor`` at which the theory of the element is valid: the run ends at a larger one.
MAX_VALID_RATIO = 2.0
MAX_MISPLACEMENT = 1.0  # of a ``misplacement``: beyond it the mechanism is refused
MIN_NOMINAL, MAX_NOMINAL = 1e-50, 1e50  # of first-order states: solvers take the squares
FIXED_IN = ("ground", "body")  # what the axis of a given force or torque is of


@dataclass(frozen=True, kw_only=True)
class FirstOrderState:
    """A quantity z with z' = g(t, q, v, z) that a load computes.

    Parameters
    ----------
    name
        Name, unique among the states of the mechanism; of several states of one load, among these.
    unit
        Unit of z in the notation of FMI, such as ``"A"`` or ``"rad"``; ``"1"``: none.
    start
        Value of z at the start of a run.
    nominal
        Typical size of z, 1e-50 to 1e50: the absolute tolerance of z is the tolerance of the solver times it.
    is_held_at_rest
        Whether z' is zero for every z if the joint of the load's first body is at rest, as of the bristle of a joint
        with friction. Steady states then keep the start value.

    Raises
    ------
    UserError
        The start value is not finite, the nominal value is none, or the unit is unknown.
    """

    name: str
    unit: str = "1"
    start: float = 0.0
    nominal: float = 1.0
    is_held_at_rest: bool = False

    def __post_init__(self) -> None:
        """Check the unit and the values."""
        read_unit(self.unit)
        what = f"state {self.name!r}"
        object.__setattr__(self, "start", finite(f"start of {what}", self.start))
        nominal = positive(f"nominal of {what}", self.nominal)
        if not MIN_NOMINAL <= nominal <= MAX_NOMINAL:
            raise UserError(
                f"nominal of {what} is {nominal!r}; allowed: {MIN_NOMINAL:g} to {MAX_NOMINAL:g}. Use another unit"
            )
        object.__setattr__(self, "nominal", nominal)


@kernel
def zero_tangent(load: Record, c1: float, arrays: Arrays, state: State, perturbed: State, K: Reals) -> float:
    """Tangent of a load whose stiffness is negligible in the implicit solvers of large trees."""
    return 0.0


@inlined
def limit_ratio(value: float, accurate: float, valid: float) -> float:
    """What a ``monitor`` returns of a measure: MAX_ACCURATE_RATIO at ``accurate``, its largest value with accurate
    results, and MAX_VALID_RATIO at ``valid``, beyond which results mean nothing.
    """
    if value <= accurate:
        return value / accurate * MAX_ACCURATE_RATIO
    return MAX_ACCURATE_RATIO + (value - accurate) / (valid - accurate) * (MAX_VALID_RATIO - MAX_ACCURATE_RATIO)


@kernel
def direction(force: Any, body: MotionRecord) -> tuple[float, float, float]:
    """Global components of the axis of a given force or torque."""
    if force.turns == 1:
        return arm(body, force.axis)
    one = 1.0 + 0.0 * body.r[0]  # of the type of the state
    return force.axis[0] * one, force.axis[1] * one, force.axis[2] * one


class PointPairRecord(Record):
    """Parameters of a force between points of two bodies."""

    a: i8
    b: i8
    Pa: Vec3  # body axes, m
    Pb: Vec3


def fill_points(force: Any, record: Any, site: Attachment) -> None:
    """Write the two bodies that a force is between, and ``at_a`` and ``at_b`` on them."""
    record["a"], record["b"] = site.bodies
    record["Pa"], record["Pb"] = vector(f"at_a of {site.name}", force.at_a), vector(f"at_b of {site.name}", force.at_b)


@dataclass(frozen=True, kw_only=True)
class Load(ElementType):
    """Base class of loads on a mechanism; the bodies are given to the builder."""

    kernels: ClassVar = {
        "apply": "time, arrays, state",
        "potential": "arrays, state -> number",
        "power": "time, arrays, state -> number",
        "tangent": "time, arrays, state, perturbed, matrix -> number",
        "monitor": "arrays, state -> number",
        "misplacement": "arrays, state -> number",
        "clearance": "arrays, state -> number",
        "longest_step": "time, arrays, state -> number",
    }
    apply: ClassVar[Any]
    potential: ClassVar[Any] = None
    power: ClassVar[Any] = None
    tangent: ClassVar[Any] = None
    monitor: ClassVar[Any] = None
    misplacement: ClassVar[Any] = None
    clearance: ClassVar[Any] = None
    longest_step: ClassVar[Any] = None
    extrapolate: ClassVar[Any] = None
    drawings: ClassVar = ("", "coil")
    drawn: ClassVar[str] = ""  # how pictures show it: one of these; a coil is between its points, or along its joint
    symmetric: ClassVar[bool] = True  # its tangent is, so nearly that who takes it to be so is corrected soon
    on_joint: ClassVar[bool] = False  # acts along the coordinate of the first body's joint, not on bodies
    # what it applies is linear in the signals it uses; derivatives by other inputs are differences over short steps
    is_linear_in_signals: ClassVar[bool] = False
    n_bodies: ClassVar[int | None] = None  # how many different bodies it acts on; None: any number
    title: ClassVar[str] = "an element"  # as messages call one that the mechanism gives no name
    nonsmooth_reason: ClassVar[str] = ""  # why its force changes sharply within the tolerance; empty: it does not
    stiffness_reason: ClassVar[str] = ""  # why it makes explicit solvers unsuitable; empty: it does not
    stick_reason: ClassVar[str] = ""  # why explicit solvers need many steps, but are allowed; empty: they do not

    @property
    def is_nonconservative(self) -> bool:
        """Whether it is non-conservative: it does work that no potential contains."""
        return self.power is not None

    @property
    def n_untied_bodies(self) -> int:
        """Number of trailing bodies whose coupling to the others is left out of the groups of the tangent (border)."""
        return 0

    @property
    def levers(self) -> tuple[float, ...]:
        """Distances (m) from the origins of its first bodies within which points of these determine its ``clearance``;
        where it is positive, it must not depend on other bodies.
        """
        return ()

    @property
    def slip_scale(self) -> float:
        """Slip at which its friction turns over, m/s; infinite: it has none."""
        return np.inf

    @property
    def states(self) -> tuple[FirstOrderState, ...]:
        """First-order states that it has. Their values are in ``State.v`` from ``site.first_state`` on, see
        :class:`mbfmu.mechanics.kind.Attachment`; ``apply`` adds their rates to ``State.Q`` there. A load of several
        names each of them, and its own name comes before in the mechanism.
        """
        return ()

    @property
    def coordinates(self) -> tuple[int, ...]:
        """Numbers of the coordinates of its joint along which it acts, if it is ``on_joint``."""
        return (0,)

    @property
    def arms(self) -> tuple[float, ...]:
        """Displacements of the bearing per unit of each of these coordinates, m/rad, or 1 if the load acts on it
        directly: its estimates are those of the bearing.
        """
        return (1.0,) * len(self.coordinates)

    def describe_joint_refusal(self, joint: Any) -> str:
        """Return what a load that is ``on_joint`` needs, if it cannot act on this joint; empty: it can."""
        return "" if joint.nv == 1 else "a joint of one coordinate"

    def check_joint(self, what: str, joint: Any) -> None:
        """Raise UserError if its parameters do not fit the joint on which it acts; ``what`` names the load."""

    def fill_estimates(self, record: Any, inertia: float, size: float) -> None:
        """Write what a load with ``stick_reason`` estimates into fields of its record that begin with ``estimated_``.
        In native FMUs these remain as they are at the export.

        Parameters
        ----------
        record
            Record that ``fill`` has written.
        inertia
            Inertia that the joint coordinate of the first body moves at the start, kg m^2 or kg; 0: a drive moves it.
            Of several coordinates it is the mean. Of a load that is not ``on_joint``: inertia that its :meth:`slip`
            moves, or mass of the first body, kg.
        size
            Size of this coordinate, to which tolerances refer, rad or m; of several the least. Else the length of the
            mechanism, m.
        """

    def slip(self, record: Any, bodies: Any) -> float | None:
        """Return the rate of the displacement against which it acts where ``bodies`` move so, m/s, if it sticks and is
        not ``on_joint``; None: there is no single one.
        """
        return None

    def nominal_displacement(self, record: Any, length: float) -> float:
        """Return the nominal value of that displacement, rad or m, in a mechanism of this length, m."""
        return length

    def resolved_displacement(self, record: Any) -> float:
        """Return the displacement of its joint coordinate that tolerances must resolve, rad or m; infinite: none."""
        return np.inf

    def companions(self) -> tuple[Load, ...]:
        """Return loads that come with it, on the same bodies."""
        return ()

    @classmethod
    def check_positions(cls, group: LoadGroup) -> None:
        """Raise UserError where bodies are not where the loads of this type need them; ``group`` has those."""

    @classmethod
    def check_start(cls, group: LoadGroup) -> list[str]:
        """Return warnings about the loads of this type at the start of a run, or raise UserError."""
        return []

    @classmethod
    def describe_limit(cls, group: LoadGroup, ratio: float, when: str = "") -> str:
        """Say which of the loads of this type has passed a limit, and what to do.

        Parameters
        ----------
        group
            Loads of this type, with the bodies where they are.
        ratio
            Largest value of ``monitor`` among them: more than 1.
        when
            Text about the time, such as ``" at t = 0.3 s"``.
        """
        return f"an element of type {cls.__name__} is deformed beyond the limits of its theory{when}"

    def points(self) -> Points:
        """Return its points on the bodies, m, body axes, as far as they indicate the size of the bodies."""
        return ()

    def extent(self) -> float:
        """Return its unloaded length, m; zero: none."""
        return 0.0


@dataclass(frozen=True, kw_only=True)
class Force(Load):
    """Base class of forces on one body or between two."""

    def points(self) -> Points:
        """Return a point on each body: its own, or the origin."""
        return () if self.on_joint else ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

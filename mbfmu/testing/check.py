"""Check of one user-defined element type in random mechanisms."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass, field
from math import isnan
from traceback import extract_tb
from typing import Any

import numpy as np

from mbfmu.mechanics import (
    CompiledMechanism,
    Coupling,
    CutJoint,
    Cylindrical,
    Force,
    Joint,
    Load,
    Mechanism,
    Revolute,
    Spherical,
    Translational,
)
from mbfmu.mechanics.checks import whole
from mbfmu.mechanics.numbers import positive
from mbfmu.sheets import Surface
from mbfmu.util.errors import UserError
from mbfmu.util.text_table import format_table
from solvers.compiled.kernel import COMPILED

from .identities import IDENTITIES, MAX_UNCERTAINTY, TOLERANCE, Deviation, State, random_state
from .load_identities import has_tangent, load_tangents, load_values
from .surface_identities import SURFACE_IDENTITIES, Probe

NAME = "element"  # of what is checked, in its mechanism
CAUSES = {
    "positions, velocities and accelerations": "kernel `place` (rel.S against the pose in rel.R and rel.p) or "
    "`bias` of a joint",
    "kinetic energy and mass matrix": "kernel `place` of a joint",
    "derivatives of constraints": "residual, axes or their rates of a cut joint; value and derivatives of a coupling",
    "energy, potential and power": "kernels `apply`, `potential` and `power` of a load: the power of what `apply` adds "
    "must be `power` minus the rate of `potential`",
    "complex steps": "a kernel that is not analytic: abs, min, max, arctan2, math, or a comparison without .real",
    "limits and scratch memory": "kernel `monitor` or `longest_step` that is negative or no number; a kernel that "
    "reads scratch memory before it writes there",
    "tangents of loads": "kernel `tangent`: it adds minus the derivative of what `apply` adds by the motions of its "
    "bodies, and c1 times that by their velocities, and returns 1.0, or adds nothing and returns 0.0",
    "distance from the surface": "kernel `gap`, which returns no distance to the nearest point, or method `core`",
    "normal of the surface": "kernel `gap`, which writes no gradient of the distance into contact.n",
    "shape of the surface": "methods `curvature` and `edges`, or the attribute `convex`",
    "outputs": "kernel `read` of a sensor that is not analytic, or that depends on an earlier call",
}


@dataclass
class Outcome:
    """Result of one identity.

    Attributes
    ----------
    examined, skipped
        Numbers of states that were compared, and of those at which the mechanism is not smooth.
    worst
        Largest deviation.
    error
        Exception of a kernel, with its file and line; empty: none.
    """

    examined: int = 0
    skipped: int = 0
    worst: Deviation = field(default_factory=lambda: Deviation(0.0, 0.0, 0.0, ""))
    error: str = ""

    @property
    def passed(self) -> bool:
        """Whether some state was compared, and none contradicts the identity."""
        return not self.error and self.examined > 0 and self.worst.size <= TOLERANCE

    def add(self, deviation: Deviation) -> None:
        """Take a deviation into account, unless its derivative cannot be trusted."""
        if deviation.uncertainty > MAX_UNCERTAINTY:
            self.skipped += 1
            return
        self.examined += 1
        size = deviation.size - 10.0 * deviation.uncertainty
        if not (size <= self.worst.size or isnan(self.worst.size)):  # a number that is none stays
            self.worst = deviation._replace(size=size)


@dataclass(frozen=True)
class ElementReport:
    """What :func:`check_element` found; ``print`` shows it as a table.

    Attributes
    ----------
    outcomes
        :class:`Outcome` by the name of the identity.
    interpreted
        Whether kernels ran as plain Python, which checks every index.
    """

    outcomes: dict[str, Outcome]
    interpreted: bool

    @property
    def passed(self) -> bool:
        """Whether all identities hold, and each was examined."""
        return all(outcome.passed for outcome in self.outcomes.values())

    def __str__(self) -> str:
        rows = [
            (
                name,
                "passed" if outcome.passed else "FAILED",
                str(outcome.examined),
                str(outcome.skipped),
                f"{max(0.0, outcome.worst.size):.1e}",
            )
            for name, outcome in self.outcomes.items()
        ]
        how = (
            "Kernels ran as plain Python: every index was checked."
            if self.interpreted
            else "Kernels were compiled, and their indices checked in one call; NUMBA_DISABLE_JIT=1 checks all."
        )
        head = ["identity", "result", "states", "not smooth", "deviation"]
        return "\n".join([format_table(head, rows), how, *self._reasons()])

    def _reasons(self) -> Iterator[str]:
        for name, outcome in self.outcomes.items():
            if outcome.error:
                yield f"{name}: {outcome.error}"
            elif not outcome.examined:
                yield (
                    f"{name}: nothing could be compared, because the element is not smooth or not there; change its "
                    "parameters, change `length` to its size, or examine more states"
                )
            elif not outcome.passed:
                worst = outcome.worst
                yield (
                    f"{name}: {worst.where} is {worst.found:.9g} instead of {worst.expected:.9g}. "
                    f"Possible cause: {CAUSES[name]}"
                )


def check_element(
    element: Any, *, bodies: int = 2, length: float = 1.0, states: int = 10, seed: int = 0
) -> ElementReport:
    """Check the kernels of a user-defined joint, cut joint, coupling, force, load or surface by identities.

    The element is placed in a random tree of bodies. At random states its kernels are compared with derivatives of
    each other: velocities with positions, Jacobians with residuals, power with the rate of the energy, and complex
    steps with differences. States at which the mechanism is not smooth (a stop is reached) are skipped.
    A surface is examined at random points near it.

    Parameters
    ----------
    element
        An instance of the type, with realistic parameters; or a mechanism that contains it (for a sensor, or an element
        that needs certain bodies), whose outputs are checked too.
    bodies
        Number of bodies to which a load is applied that is not a force.
    length
        Size of the random mechanism and of its displacements, or of the surface, m.
    states
        Number of random states, or of points of a surface.
    seed
        Of the random numbers.

    Returns
    -------
    ElementReport
        What was found.

    Raises
    ------
    AssertionError
        An identity does not hold. The message is the report: what deviates, by how much, and what may be the cause.
    UserError
        The element cannot be used at all, or an argument is not allowed.
    """
    length, states = positive("length", length), whole("states", states)
    if states < 1:
        raise UserError(f"states are {states}; allowed: one or more")
    rng = np.random.default_rng(seed)
    subject = Probe(element, length, rng) if isinstance(element, Surface) else compiled_of(element, bodies, length, rng)
    identities = SURFACE_IDENTITIES if isinstance(subject, Probe) else identities_of(subject.mechanism)
    outcomes = {name: Outcome() for name in identities}
    for _ in range(states):
        at = () if isinstance(subject, Probe) else (random_state(subject, rng, length),)
        examine(outcomes, identities, subject, *at)
    report = ElementReport(outcomes, interpreted=not COMPILED)
    if not report.passed:
        raise AssertionError(f"{type(element).__name__} contradicts itself\n{report}")
    return report


def compiled_of(element: Any, bodies: int, length: float, rng: np.random.Generator) -> CompiledMechanism:
    """Return a random mechanism that contains an element, or a copy of a mechanism, with outputs of all motions."""
    mechanism = deepcopy(element) if isinstance(element, Mechanism) else around(element, bodies, length, rng)
    for body in mechanism.bodies[1:]:
        for axis in "xyz":
            point = (0.3 * length, -0.2 * length, 0.5 * length)
            mechanism.output(f"_probe.{body.name}.r{axis}", body.position(axis, point))
            mechanism.output(f"_probe.{body.name}.v{axis}", body.velocity(axis, point))
            mechanism.output(f"_probe.{body.name}.a{axis}", body.point_acceleration(axis, point))
    return CompiledMechanism(mechanism)


def identities_of(mechanism: Mechanism) -> dict[str, Callable[[CompiledMechanism, State], Iterator[Deviation]]]:
    """Return the identities that concern a mechanism, by name."""
    loads, found = [acting.load for acting in mechanism.loads()], dict(IDENTITIES)
    if loads:
        found["limits and scratch memory"] = load_values
    if any(has_tangent(load) for load in loads):
        found["tangents of loads"] = load_tangents
    return found


def examine(outcomes: dict[str, Outcome], identities: dict[str, Callable[..., Iterator[Deviation]]], *at: Any) -> None:
    """Evaluate identities for these arguments, and add what deviates to the outcomes."""
    for name, identity in identities.items():
        if outcomes[name].error:
            continue
        try:
            with np.errstate(all="ignore"):
                for deviation in identity(*at):
                    outcomes[name].add(deviation)
        except (ArithmeticError, IndexError, TypeError, ValueError) as error:
            last = extract_tb(error.__traceback__)[-1]
            outcomes[name].error = f"{type(error).__name__}: {error} ({last.filename}, line {last.lineno})"


LOADED_BODIES = (5, 2, 4, 1, 3)  # numbers of bodies whose origins move, and change their distance, in this order


def around(element: Any, bodies: int, length: float, rng: np.random.Generator) -> Mechanism:
    """Return a random mechanism that contains an element; raises UserError if its role is unknown."""

    def vector(size: float = 1.0) -> tuple[float, float, float]:
        x, y, z = size * rng.normal(size=3)
        return float(x), float(y), float(z)

    m = Mechanism(gravity=vector())
    joints: tuple[Joint, ...] = (
        Revolute(at=vector(length), axis=vector()),
        Spherical(at=vector(length)),
        element if isinstance(element, Joint) else Cylindrical(at=vector(length), axis=vector()),
        Revolute(at=vector(length), axis=vector()),
        Translational(at=vector(length), axis=vector()),
    )
    chain = [m.ground]
    for k, joint in enumerate(joints):
        points = 0.3 * length * rng.normal(size=(5, 3))
        inertia = sum((p @ p) * np.eye(3) - np.outer(p, p) for p in points)
        mass = rng.uniform(0.5, 2.0)
        chain.append(m.body(f"b{k}", chain[-1], joint, mass=mass, com=vector(0.3 * length), inertia=inertia))
    _, b0, b1, _, b3, b4 = chain
    if isinstance(element, CutJoint):
        m.cut(NAME, element, b4, b0)
    elif isinstance(element, Coupling):
        m.couple(NAME, element, b0, b3)
    elif isinstance(element, Force):
        fitting = [body for body in (b3, *chain[1:]) if not element.describe_joint_refusal(body.joint)]
        m.force(NAME, element, fitting[0] if element.on_joint and fitting else b3, b1)
    elif isinstance(element, Load):
        m.load(NAME, element, *(chain[k] for k in LOADED_BODIES[:bodies]))
    elif not isinstance(element, Joint):
        raise UserError(
            f"element is {element!r}; allowed: an instance of a joint, cut joint, coupling, force, load or surface, or "
            "a mechanism that contains the element"
        )
    return m

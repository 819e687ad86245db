"""Interface of loads: forces, elements between bodies, loads on surfaces.

Its kernels:

    apply(load, t, arrays, state)            adds wrenches to ``state.bodies[i].F`` (about the body's origin, global
                                             axes), or forces along coordinates to ``state.Q``
    potential(load, arrays, state)           returns the energy it stores, J; None: it stores none
    power(load, t, arrays, state)            returns the power in W of what has no potential: dampers take it, given
                                             forces bring it; None: all it does is in its potential
    tangent(load, c1, arrays, state,         adds to K, six rows and columns a body, minus the derivative of what
            perturbed, K)                    ``apply`` adds by the motions of its bodies and c1 times that by their
                                             velocities, and returns 1.0, or 0.0 if there is none; ``perturbed`` is a
                                             complex state, scratch, for complex steps

A load without ``tangent`` is differentiated by complex steps, so ``apply`` is analytic in every real
number it reads. A load whose tangent is negligible has ``zero_tangent``. A load that a scene does not call for has no
record, and so no cost.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from mbfmu.mechanics.checks import vector
from mbfmu.mechanics.kind import Attachment, ElementType
from mbfmu.mechanics.spatial import arm
from solvers.compiled.kernel import kernel

Points = tuple[Any, ...]
FIXED_IN = ("ground", "body")  # what the axis of a given force or torque is of


@kernel
def zero_tangent(load: Any, c1: float, arrays: Any, state: Any, perturbed: Any, K: Any) -> float:
    """Tangent of a load whose stiffness is negligible in the implicit solvers of large trees."""
    return 0.0


@kernel
def direction(force: Any, body: Any) -> tuple[float, float, float]:
    """Global components of the axis of a given force or torque."""
    if force.turns == 1:
        return arm(body, force.axis)
    one = 1.0 + 0.0 * body.r[0]  # of the type of the state
    return force.axis[0] * one, force.axis[1] * one, force.axis[2] * one


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
    }
    apply: ClassVar[Any]
    potential: ClassVar[Any] = None
    power: ClassVar[Any] = None
    tangent: ClassVar[Any] = None
    drawings: ClassVar = ("", "coil")
    drawn: ClassVar[str] = ""  # how pictures show it: one of these; a coil is between its points, or along its joint
    symmetric: ClassVar[bool] = True  # its tangent is, so nearly that who takes it to be so is corrected soon
    on_joint: ClassVar[bool] = False  # acts along the coordinate of the first body's joint, not on bodies

    @property
    def is_nonconservative(self) -> bool:
        """Whether it is non-conservative: it does work that no potential contains."""
        return self.power is not None

    @property
    def n_untied_bodies(self) -> int:
        """Number of trailing bodies whose coupling to the others is left out of the groups of the tangent (border)."""
        return 0

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

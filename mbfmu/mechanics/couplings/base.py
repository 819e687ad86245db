"""Interface of couplings.

A coupling ties a coordinate of one joint to a coordinate of another, q_a = f(q_b), wherever in the tree they are. Its
kernel ``evaluate(coupling, x, arrays)`` returns f(x) and its first two derivatives, analytic in x. The constraint

    Phi = q_a - f(q_b),    Phi' = v_a - f' v_b,    Phi'' = v'_a - f' v'_b - f'' v_b^2

has one multiplier lambda: the coupling pushes along coordinate a with -lambda and along coordinate b with f' lambda, so
it does no work. The coordinates are relative, those of the joints: between a carrier and what it carries it is the
carrier that takes the reaction, by the joints themselves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from mbfmu.mechanics.kind import ElementType


@dataclass(frozen=True, kw_only=True)
class Coupling(ElementType):
    """Base class of couplings: one coordinate as a function of another."""

    kernels: ClassVar = {"evaluate": "coordinate, arrays -> three"}
    evaluate: ClassVar[Any]

    def check_unit(self, what: str, unit: str) -> None:
        """Refuse a second coordinate in ``unit``, m or rad, if the data of its law are not sufficient for it."""

    def steepness(self) -> float:
        """Return the approximate change of the first coordinate per unit of the second; zero: about one."""
        return 0.0

"""What every force says of itself.

Three kernels: ``apply(force, t, arrays, state)`` adds wrenches to ``bodies[i].F`` (about the body's origin, global
axes) or forces along coordinates to ``Q``; ``potential(force, arrays, state)`` returns stored energy in J;
``power(force, t, arrays, state)`` returns the power in W of what has no potential: dampers take it, given forces
bring it. A force that a scene does not call for has no record, and so no cost.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from solvers.kernel import kernel


@dataclass(frozen=True, kw_only=True)
class Force:
    """A force of the mechanism; the bodies it acts between are given to the builder."""

    apply: ClassVar[Any]
    potential: ClassVar[Any]
    power: ClassVar[Any]
    on_joint: ClassVar[bool] = False  # acts along the coordinate of a joint, not on bodies


@kernel
def nothing_stored(force: Any, arrays: Any, state: Any) -> float:
    """Potential of a force that stores no energy."""
    return 0.0

"""First-order state that a user defines: its rate is a law of time, signals, sensors and states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.quantities import QuantityLaw
from mbfmu.mechanics.quantity_kinds import MAX_QUANTITIES, TIME, VELOCITY
from solvers.compiled.kernel import jit_uncached
from solvers.compiled.record import Integers, Record, i8

from .base import FirstOrderState, Load

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State

RATE_QUANTITIES = {"t": TIME, "z": VELOCITY}  # names in the law of a rate


class StateEquationRecord(Record):
    """Parameters of :class:`StateEquation`."""

    state: i8  # place in State.v
    places: Annotated[Integers, (MAX_QUANTITIES,)]  # of the arguments of the law, see mbfmu.mechanics.quantities


@cache
def kernel_of_rate(value: Any) -> Any:
    """Return ``apply`` of a rate that the kernel ``value`` computes."""

    def apply(equation: Any, t: float, arrays: Arrays, state: State) -> None:
        state.Q[equation.state] += value(equation, t, arrays, state)

    return jit_uncached(apply)


@dataclass(frozen=True, kw_only=True)
class StateEquation(Load):
    """A first-order state z with the equation z' = g(t, z, ...); created by :meth:`.Mechanism.state`.

    Parameters
    ----------
    state
        Name, unit, start value and nominal value.
    rate
        Function or expression g of the time ``t`` (s), of the state's value ``z`` and of the names in ``uses``.
    uses
        Other quantities in the rate, by their names, see :class:`mbfmu.mechanics.quantities.QuantityLaw`.
    """

    record = StateEquationRecord
    n_bodies = 0

    state: FirstOrderState
    rate: Any
    uses: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        """Compile the rate."""
        law = QuantityLaw(f"rate of state {self.state.name!r}", self.rate, RATE_QUANTITIES, self.uses)
        object.__setattr__(self, "_law", law)
        object.__setattr__(self, "apply", kernel_of_rate(law.value_kernel()))

    @property
    def states(self) -> tuple[FirstOrderState, ...]:
        """Return the state."""
        return (self.state,)

    def fill(self, record: Any, site: Attachment) -> None:
        """Write where the state and the arguments of the rate are."""
        record["state"] = site.first_state
        law: QuantityLaw = vars(self)["_law"]
        law.fill(record, site, {"z": site.first_state})

"""Functions and expressions of other quantities as sensors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.quantities import QuantityLaw
from mbfmu.mechanics.quantity_kinds import BLOCK, MAX_QUANTITIES, SENSOR, SIGNAL, TIME
from solvers.compiled.kernel import jit_uncached
from solvers.compiled.record import Integers, Record, i8

from .base import Follows, Sensor

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from solvers.compiled.record import Reals

EXPRESSION_QUANTITIES = {"t": TIME}  # names in the law of a sensor


class ExpressionRecord(Record):
    """Parameters of :class:`Expression`."""

    places: Annotated[Integers, (MAX_QUANTITIES,)]  # of the arguments of the law, see mbfmu.mechanics.quantities
    count: i8  # number of the arguments


@cache
def kernels_of(value: Any, reading: Any) -> tuple[Any, Any]:
    """Return ``read`` and ``value`` of a law from its kernels, see :class:`.QuantityLaw`."""

    def read(sensor: Any, lam: Reals, arrays: Arrays, state: State) -> Any:
        return reading(sensor, lam, arrays, state)

    def value_at(sensor: Any, t: float, arrays: Arrays, state: State) -> Any:
        return value(sensor, t, arrays, state)

    return jit_uncached(read), jit_uncached(value_at)


@dataclass(frozen=True, kw_only=True, eq=False)
class Expression(Sensor):
    """A function or an expression of time, signals, states, blocks and sensors; created by
    :meth:`.Mechanism.expression`.

    As :class:`.BlockOutput` it has a second kernel ``value(sensor, t, arrays, state)``, if laws may use it.

    Parameters
    ----------
    law
        Function or expression of the time ``t`` (s) and of the names in ``uses``.
    uses
        Quantities by their names, see :class:`mbfmu.mechanics.quantities.QuantityLaw`; sensors of any kind.
    """

    kernels: ClassVar = {**Sensor.kernels, "value": "time, arrays, state -> number"}
    record = ExpressionRecord

    law: Any
    uses: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Compile the law."""
        law = QuantityLaw(self.what, self.law, EXPRESSION_QUANTITIES, self.uses, any_sensor=True)
        object.__setattr__(self, "_law", law)
        read, value = kernels_of(law.value_kernel(), law.reading_kernel())
        object.__setattr__(self, "stiff", any(own.stiff for own in self.arguments()))
        object.__setattr__(self, "read", read)
        object.__setattr__(self, "value", value if self.is_block_output else None)

    @property
    def what(self) -> str:
        """Name in messages."""
        return f"expression {self.law!r}" if isinstance(self.law, str) else "function of sensors"

    @property
    def quantities(self) -> QuantityLaw:
        """Return the law with its arguments."""
        law: QuantityLaw = vars(self)["_law"]
        return law

    def arguments(self) -> Iterator[Sensor]:
        """Yield the sensors and outputs of blocks that it contains."""
        return (own.source for own in self.quantities.quantities if own.kind in (SENSOR, BLOCK))

    def fill(self, record: Any, site: Attachment) -> None:
        """Write where the arguments are."""
        record["count"] = len(self.quantities.kinds)
        self.quantities.fill(record, site, {})

    @property
    def is_block_output(self) -> bool:
        """Whether positions, velocities, states, time and signals determine it: laws may use it, as outputs of
        blocks.
        """
        return all(own.is_kinematic or getattr(own, "is_block_output", False) for own in self.arguments())

    @property
    def is_kinematic(self) -> bool:  # type: ignore[override]
        """Whether positions, velocities and states determine it."""
        constant = all(own.kind != SIGNAL or isinstance(own.source, int | float) for own in self.quantities.quantities)
        return constant and TIME not in self.quantities.kinds and all(own.is_kinematic for own in self.arguments())

    @property
    def follows(self) -> Follows:  # type: ignore[override]
        """What it changes with at once: as the argument that changes with most."""
        of_time = TIME in self.quantities.kinds or SIGNAL in self.quantities.kinds
        own = Follows.MOTION if self.is_kinematic or not of_time else Follows.LOADS
        return max((own, *(sensor.follows for sensor in self.arguments())))

    @property
    def reads_energy(self) -> bool:  # type: ignore[override]
        """Whether an argument is an energy."""
        return any(own.reads_energy for own in self.arguments())

    def loads(self) -> Sequence[int] | None:
        """Return the numbers of the loads on which the arguments depend; None: all."""
        found: list[int] = []
        for own in self.arguments():
            if own.follows is not Follows.MOTION:
                numbers = own.loads()
                if numbers is None:
                    return None
                found += numbers
        return found


def with_arguments(sensor: Sensor) -> Iterator[Sensor]:
    """Yield a sensor, and those that it contains if it is an expression."""
    yield sensor
    if isinstance(sensor, Expression):
        for own in sensor.arguments():
            yield from with_arguments(own)

"""What given forces on bodies have in common: the force is a signal, or a law of time and of other quantities."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

from mbfmu.mechanics import law
from mbfmu.mechanics.kind import Attachment, RecordType, kernel_of
from mbfmu.mechanics.quantities import QuantityLaw, is_motion_quantity
from mbfmu.mechanics.quantity_kinds import LENGTH, LENGTH_RATE, MAX_QUANTITIES, TIME
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import is_kernel
from solvers.compiled.record import Integers, Record

from .base import Force

LINE_QUANTITIES = {"t": TIME, "x": LENGTH, "v": LENGTH_RATE}  # names in a law of a force between two points


class LawRecord(Record):
    """Where the arguments of a law are."""

    places: Annotated[Integers, (MAX_QUANTITIES,)]  # see mbfmu.mechanics.quantities


@dataclass(frozen=True, kw_only=True)
class GivenForce(Force):
    """Base class of forces and torques on bodies whose magnitude is given.

    Attributes
    ----------
    law_quantities
        Kinds of the names in a law of the force.
    law_record, kernels_of_law
        Record of a force whose magnitude is a law, and its ``apply`` and ``power``: a function of the kernel that
        :meth:`.QuantityLaw.value_kernel` returns.
    """

    law_quantities: ClassVar[Mapping[str, int]] = {"t": TIME}
    is_linear_in_signals: ClassVar[bool] = True
    law_record: ClassVar[RecordType]
    kernels_of_law: ClassVar[Any]

    magnitude: Any
    uses: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        """Compile a magnitude that is a law, a state, a block or a sensor, and check the names in an expression."""
        if isinstance(self.magnitude, str) and not self.uses:
            law.check_names(f"magnitude of a {type(self).__name__}", self.magnitude, tuple(self.law_quantities))
        if not self._is_law:
            return
        title = f"a {type(self).__name__}"
        if not is_motion_quantity(self.magnitude):
            found = QuantityLaw(f"magnitude of {title}", self.magnitude, self.law_quantities, self.uses)
        elif self.uses:
            raise UserError(f"{title} has uses, and its magnitude is no function or expression; leave out uses")
        else:
            found = QuantityLaw(title, "magnitude", self.law_quantities, {"magnitude": self.magnitude})
        object.__setattr__(self, "_law", found)
        object.__setattr__(self, "record", self.law_record)
        object.__setattr__(self, "is_linear_in_signals", False)
        for name, function in zip(
            ("apply", "power"), kernel_of(self, "kernels_of_law")(found.value_kernel()), strict=True
        ):
            object.__setattr__(self, name, function)
        object.__setattr__(self, "symmetric", False)  # the law may read motions of other bodies

    @property
    def quantities(self) -> Mapping[str, Any]:
        """Return the quantities that it uses, by their names."""
        return {"magnitude": self.magnitude} if is_motion_quantity(self.magnitude) else self.uses

    @property
    def _is_law(self) -> bool:
        """Whether the magnitude is no signal: it depends on more than the time."""
        given, own = self.magnitude, self.law_quantities
        if self.uses or is_motion_quantity(given):
            return True
        if isinstance(given, str):
            return bool(law.names_in(given) & {name for name in own if name != "t"})
        if not callable(given):
            return False
        count = law.arguments_of(f"magnitude of a {type(self).__name__}", given)
        names = inspect.signature(given.py_func if is_kernel(given) else given).parameters
        return len(own) > 1 and (count != 1 or (next(iter(names)) in own and "t" not in names))

    def fill_magnitude(self, record: Any, site: Attachment) -> None:
        """Write the signal, or where the arguments of the law are."""
        if self._is_law:
            found: QuantityLaw = vars(self)["_law"]
            found.fill(record, site, {})
        else:
            record["signal"] = site.signal(self.magnitude, f"magnitude of {site.name}")

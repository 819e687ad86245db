"""Springs and dampers whose law contains other quantities: law(t, x, v, ...) + c v with x = l - l0 or q - q0."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mbfmu.mechanics.kind import Attachment, kernel_of
from mbfmu.mechanics.quantities import QuantityLaw, is_motion_quantity
from mbfmu.mechanics.quantity_kinds import LENGTH, LENGTH_RATE, TIME
from mbfmu.util.errors import UserError
from solvers.compiled.record import f8, i8

from .base import Force, PointPairRecord
from .given import LawRecord

STRETCH_QUANTITIES = {"t": TIME, "x": LENGTH, "v": LENGTH_RATE}  # names in such a law


class StretchLawRecord(LawRecord, PointPairRecord):
    """Parameters of a spring or a damper between points with such a law."""

    damping: f8  # N s/m
    free: f8  # m


class JointStretchLawRecord(LawRecord):
    """Parameters of a spring or a damper on a joint coordinate with such a law."""

    q: i8
    v: i8
    damping: f8  # N m s/rad or N s/m
    free: f8  # rad or m


def use_law(force: Force, name: str, given: Any, uses: Mapping[str, Any]) -> None:
    """Let a force have the record and the kernels of a law, which is its parameter ``name``.

    Raises
    ------
    UserError
        It is none, or its type has no such law.
    """
    what = f"{name} of a {type(force).__name__}"
    if not hasattr(force, "kernels_of_quantities"):
        raise UserError(f"a {type(force).__name__} has no laws with uses; allowed: a number, a Table, or a law of x")
    if is_motion_quantity(given) or not (isinstance(given, str) or callable(given)):
        raise UserError(f"{what} is no function or expression, and uses is given; leave out uses")
    found = QuantityLaw(what, given, STRETCH_QUANTITIES, uses)
    apply, power = kernel_of(force, "kernels_of_quantities")(found.value_kernel())
    record = getattr(force, "quantity_record", JointStretchLawRecord if force.on_joint else StretchLawRecord)
    own = {"apply": apply, "power": power, "potential": None, "record": record, "symmetric": False, "_law": found}
    for attribute, value in own.items():
        object.__setattr__(force, attribute, value)


def fill_law(force: Force, record: Any, site: Attachment) -> None:
    """Write where the arguments of the law are."""
    found: QuantityLaw = vars(force)["_law"]
    found.fill(record, site, {})

"""What springs have in common: a stiffness, or a law of the force over the stretch, damping and a free length.

A table is integrated, so that such a spring stores energy as a linear one does. Of a function no integral is known: its
energy is in no potential, and the work it does is in the balance instead. This is also the case if
the free length is a signal.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

from mbfmu.mechanics import law
from mbfmu.mechanics.curve import curve
from mbfmu.mechanics.kind import Attachment, kernel_of
from mbfmu.mechanics.numbers import finite, not_negative
from mbfmu.mechanics.signals import Signal, Table
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import jit_uncached, kernel
from solvers.compiled.record import Record, f8, i8

from .base import Force
from .law_of_stretch import fill_law, use_law

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays


class ElasticRecord(Record):
    """Parameters of :class:`ElasticForce`."""

    stiffness: f8  # N/m or N m/rad
    damping: f8  # N s/m or N m s/rad
    free: f8  # m or rad
    first: i8  # of the numbers of a table, and how many rows it has; none: it is linear
    count: i8


@kernel
def elastic_force(force: ElasticRecord, stretch: float, arrays: Arrays) -> float:
    """k x, or the force by the table: without the damper."""
    if force.count == 0:
        return force.stiffness * stretch
    f, _, _, _ = curve(arrays.numbers, force.first, force.count, stretch)
    return f


@kernel
def elastic_energy(force: ElasticRecord, stretch: float, arrays: Arrays) -> float:
    """k x^2 / 2, or the integral of the table from no stretch on."""
    if force.count == 0:
        return 0.5 * force.stiffness * stretch * stretch
    _, _, _, stored = curve(arrays.numbers, force.first, force.count, stretch)
    _, _, _, unloaded = curve(arrays.numbers, force.first, force.count, 0.0 * stretch)
    return stored - unloaded


@cache
def as_law(f: Any) -> Any:
    """Return a function of the stretch as one of the time, the stretch and its rate."""

    def of_stretch(t: float, x: float, rate: float) -> Any:
        return f(x)

    return jit_uncached(of_stretch)


@dataclass(frozen=True, kw_only=True)
class ElasticForce(Force):
    """Spring and parallel damper.

    Its kernels are for a stiffness and for a table; ``kernels_of_law`` returns ``apply`` and ``power`` of one with a
    function of the time, the stretch and its rate, and ``kernels_of_quantities``, if there is one, those of a law of
    other quantities. ``moving`` has those of a free length that is a signal, and its
    record has the field ``signal``; None: this is not allowed.
    """

    kernels_of_law: ClassVar[Any]
    moving: ClassVar[type[Force] | None] = None

    stiffness: Any = 0.0
    damping: float = 0.0
    free: Any = 0.0
    uses: Mapping[str, Any] = field(default_factory=dict, kw_only=True, hash=False)

    def __post_init__(self) -> None:
        """Take the kernels of a law or a function, or of a free length that is a signal."""
        if self.uses:
            use_law(self, "stiffness", self.stiffness, self.uses)
        elif self._is_moving() and self.moving is not None:
            self.become(self.moving)
        elif self._is_function():
            f = as_law(law.law_of(f"stiffness of a {type(self).__name__}", self.stiffness, ("x",)))
            apply, power = kernel_of(self, "kernels_of_law")(f)
            for name, function in {"apply": apply, "power": power, "potential": None}.items():
                object.__setattr__(self, name, function)

    def _is_function(self) -> bool:
        return isinstance(self.stiffness, str) or callable(self.stiffness)

    def _is_moving(self) -> bool:
        return isinstance(self.free, Signal | str) or callable(self.free)

    def check(self, what: str) -> None:
        """Refuse what is no number, and what is below zero: a force that drives away is a function of the stretch."""
        if not (isinstance(self.stiffness, Table) or self._is_function()):
            not_negative(f"stiffness of {what}", self.stiffness)
        not_negative(f"damping of {what}", self.damping)
        if not self._is_moving() or self.moving is None:
            finite(f"free of {what}", self.free)
        elif self._is_function():
            raise UserError(
                f"{what} has a function as its stiffness and a signal as `free`; allowed: one of the two. Give it a "
                "number or a Table as its stiffness"
            )

    def fill(self, record: Any, site: Attachment) -> None:
        """Write how much."""
        record["damping"] = self.damping
        if self.uses:
            fill_law(self, record, site)
        if self._is_moving():
            record["signal"] = site.signal(self.free, f"free of {site.name}")
        else:
            record["free"] = self.free
        if isinstance(self.stiffness, Table):
            self.stiffness.write(f"stiffness of {site.name}", record, site)
        elif not self._is_function():
            record["stiffness"] = self.stiffness

    @property
    def is_nonconservative(self) -> bool:
        """Whether it is damped, its force a function, or its free length a signal."""
        return bool(self.damping) or self._is_function() or self._is_moving()

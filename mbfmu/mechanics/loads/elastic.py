"""What springs have in common: a stiffness, or a table of the force over the stretch, damping and a free length."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from mbfmu.mechanics.curve import curve, rows
from mbfmu.mechanics.kind import Site
from mbfmu.mechanics.numbers import finite
from mbfmu.mechanics.signals import Table
from solvers.compiled.kernel import kernel

from .base import Force


@kernel
def table_force(force: Any, stretch: Any, arrays: Any) -> Any:
    """The force at a stretch, by the table of a record with ``first`` and ``count``."""
    f, _, _, _ = curve(arrays.numbers, force.first, force.count, stretch)
    return f


@kernel
def table_energy(force: Any, stretch: Any, arrays: Any) -> Any:
    """The integral of the force, from no stretch on."""
    _, _, _, stored = curve(arrays.numbers, force.first, force.count, stretch)
    _, _, _, unloaded = curve(arrays.numbers, force.first, force.count, 0.0 * stretch)
    return stored - unloaded


@dataclass(frozen=True, kw_only=True)
class ElasticForce(Force):
    """A spring and a damper beside it; ``tabled`` are ``apply`` and ``potential`` of one with a table."""

    tabled: ClassVar[tuple[Any, Any]]

    stiffness: float | Table = 0.0
    damping: float = 0.0
    free: float = 0.0

    def __post_init__(self) -> None:
        """Take the kernels of a table."""
        if isinstance(self.stiffness, Table):
            for name, function in zip(("apply", "potential"), self.tabled, strict=True):
                object.__setattr__(self, name, function)

    def check(self, what: str) -> None:
        """Refuse what is no number."""
        for key in ("damping", "free") if isinstance(self.stiffness, Table) else ("stiffness", "damping", "free"):
            finite(f"{key} of {what}", getattr(self, key))

    def fill(self, record: Any, site: Site) -> None:
        """Write how much."""
        record["damping"], record["free"] = self.damping, self.free
        if isinstance(self.stiffness, Table):
            table = rows(f"stiffness of {site.name}", self.stiffness.x, self.stiffness.y, self.stiffness.kind)
            record["first"], record["count"] = site.numbers(table), len(table)
        else:
            record["stiffness"] = self.stiffness

    @property
    def works(self) -> bool:
        """Whether it is damped."""
        return bool(self.damping)

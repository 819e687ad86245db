"""Spring-damper in a joint of one coordinate: -(k (q - q0) + c q') along it, rotational or translational."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mbfmu.mechanics.curve import curve, rows
from mbfmu.mechanics.kind import Site
from mbfmu.mechanics.numbers import finite
from mbfmu.mechanics.signals import Table
from solvers.kernel import kernel

from .base import Force


@kernel
def apply(force: Any, t: float, arrays: Any, state: Any) -> None:
    """See :mod:`.base`."""
    stretch = state.q[force.q] - force.free
    state.Q[force.v] -= force.stiffness * stretch + force.damping * state.v[force.v]


@kernel
def potential(force: Any, arrays: Any, state: Any) -> float:
    """k (q - q0)^2 / 2."""
    stretch = state.q[force.q] - force.free
    return 0.5 * force.stiffness * stretch * stretch


@kernel
def power(force: Any, t: float, arrays: Any, state: Any) -> float:
    """-c q'^2."""
    return -force.damping * state.v[force.v] * state.v[force.v]


@kernel
def apply_table(force: Any, t: float, arrays: Any, state: Any) -> None:
    """See :mod:`.base`."""
    f, _, _, _ = curve(arrays.numbers, force.first, force.count, state.q[force.q] - force.free)
    state.Q[force.v] -= f + force.damping * state.v[force.v]


@kernel
def table_potential(force: Any, arrays: Any, state: Any) -> float:
    """The integral of the force, from no stretch on."""
    zero = 0.0 * force.free
    _, _, _, stored = curve(arrays.numbers, force.first, force.count, state.q[force.q] - force.free)
    _, _, _, unloaded = curve(arrays.numbers, force.first, force.count, zero)
    return stored - unloaded


@dataclass(frozen=True, kw_only=True)
class JointSpring(Force):
    """Spring-damper on the joint coordinate of a body.

    Parameters
    ----------
    stiffness, damping
        N m/rad and N m s/rad in a revolute, N/m and N s/m in a translational joint; a ``Table`` in place of a
        stiffness has the force over the stretch.
    free
        Unloaded coordinate, rad or m.
    """

    record = np.dtype(
        [
            ("q", np.int64),
            ("v", np.int64),
            ("first", np.int64),  # of the numbers of a table, and how many rows it has
            ("count", np.int64),
            ("stiffness", np.float64),  # N m/rad or N/m
            ("damping", np.float64),
            ("free", np.float64),
        ],
        align=True,
    )
    on_joint = True
    apply = apply
    potential = potential
    power = power

    stiffness: float | Table = 0.0
    damping: float = 0.0
    free: float = 0.0

    def __post_init__(self) -> None:
        """Take the kernels of a table."""
        if isinstance(self.stiffness, Table):
            object.__setattr__(self, "apply", apply_table)
            object.__setattr__(self, "potential", table_potential)

    def check(self, what: str) -> None:
        """Refuse what is no number."""
        for key in ("damping", "free") if isinstance(self.stiffness, Table) else ("stiffness", "damping", "free"):
            finite(f"{key} of {what}", getattr(self, key))

    def fill(self, record: Any, site: Site) -> None:
        """Write where it acts, and how much."""
        record["q"], record["v"] = site.q, site.v
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

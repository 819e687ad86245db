"""Where a wheel touches its profile, for the warnings of a run."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbfmu.mechanics.dispatch import cut_monitor
from solvers.compiled.kernel import kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Data
    from solvers.compiled.record import Reals


@kernel
def locate_contact(cut: int, data: Data, found: Reals) -> None:
    """Fill ``found`` (3,), m: x of the contact of cut joint number ``cut``, x of the place where its profile is deepest
    inside the wheel, and the depth there.
    """
    found[0], found[1], found[2] = cut_monitor(data.arrays.cuts[cut], data.arrays, data.state)

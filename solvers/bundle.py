"""A system's callbacks, data and terms as one named tuple for kernels."""

from __future__ import annotations

from typing import Any, NamedTuple

from .held import hold
from .system import System, Terms, audit_callbacks


class Equations(NamedTuple):
    """Callbacks and ``data`` as in :class:`solvers.system.System`, and the ``terms`` they fill."""

    dynamics: Any
    position: Any
    motion: Any
    retract: Any
    energy: Any
    power: Any
    exposure: Any
    data: Any
    terms: Any


def bundle(system: System, terms: Terms) -> Any:
    """Return the equations of a system and the terms they are to fill."""
    callbacks = (
        system.dynamics,
        system.position,
        system.motion,
        system.retract,
        system.energy,
        *audit_callbacks(system),
    )
    return hold(Equations(*callbacks, system.held_data, hold(terms)))

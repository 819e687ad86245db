"""Tree joints: one file a kind, and this registry."""

from __future__ import annotations

from typing import Any

from solvers.kernel import inlined

from . import floating, revolute, spherical, translational, weld
from .base import Joint
from .floating import Floating
from .revolute import Revolute
from .spherical import Spherical
from .translational import Translational
from .weld import Weld

REGISTRY: tuple[type[Joint], ...] = (Weld, Revolute, Translational, Spherical, Floating)

# A kernel cannot index a tuple of functions, so the registry's order is spelled out once more.
_weld, _revolute, _translational, _spherical, _floating = (
    weld.move,
    revolute.move,
    translational.move,
    spherical.move,
    floating.move,
)


@inlined
def move(kind: int, axis: Any, q: Any, qi: int, rel: Any) -> None:
    """Place the child of a joint of this kind; see :mod:`.base`."""
    if kind == 1:
        _revolute(axis, q, qi, rel)
    elif kind == 2:
        _translational(axis, q, qi, rel)
    elif kind == 3:
        _spherical(axis, q, qi, rel)
    elif kind == 4:
        _floating(axis, q, qi, rel)
    else:
        _weld(axis, q, qi, rel)


__all__ = ["REGISTRY", "Floating", "Joint", "Revolute", "Spherical", "Translational", "Weld", "move"]

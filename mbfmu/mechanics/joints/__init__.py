"""Tree joints: one file a kind, and this registry."""

from __future__ import annotations

from typing import Any

from solvers.kernel import inlined

from . import floating, geodesic, out_of_plane, revolute, spherical, translational, weld
from .base import Joint
from .floating import Floating
from .geodesic import Geodesic
from .out_of_plane import OutOfPlane
from .revolute import Revolute
from .section import Section
from .spherical import Spherical
from .translational import Translational
from .weld import Weld

REGISTRY: tuple[type[Joint], ...] = (Weld, Revolute, Translational, Spherical, Floating, OutOfPlane, Geodesic)

# A kernel cannot index a tuple of functions, so the registry's order is spelled out once more.
_weld, _revolute, _translational, _spherical, _floating, _out_of_plane, _geodesic = (
    weld.move,
    revolute.move,
    translational.move,
    spherical.move,
    floating.move,
    out_of_plane.move,
    geodesic.move,
)
_out_of_plane_bias, _geodesic_bias = out_of_plane.bias, geodesic.bias


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
    elif kind == 5:
        _out_of_plane(axis, q, qi, rel)
    elif kind == 6:
        _geodesic(axis, q, qi, rel)
    else:
        _weld(axis, q, qi, rel)


@inlined
def bias(kind: int, axis: Any, q: Any, qi: int, v: Any, vi: int, out: Any) -> bool:
    """What differentiating the joint's subspace adds, in ``out``; False: nothing. See :mod:`.base`."""
    if kind == 5:
        _out_of_plane_bias(axis, q, qi, v, vi, out)
        return True
    if kind == 6:
        _geodesic_bias(axis, q, qi, v, vi, out)
        return True
    return False


__all__ = [
    "REGISTRY",
    "Floating",
    "Geodesic",
    "Joint",
    "OutOfPlane",
    "Revolute",
    "Section",
    "Spherical",
    "Translational",
    "Weld",
    "bias",
    "move",
]

"""A system's callbacks, data and terms as one compiled object.

A callback handed from Python to a kernel costs 8 us to unpack, each time; the object made here costs 1 us for
all of them, and kernels reach its fields as attributes.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.experimental import structref

from .kernel import COMPILED, kernel
from .system import System, Terms

FIELDS = ("dynamics", "position", "retract", "jacobi", "data", "terms")


class Bundle(structref.StructRefProxy if COMPILED else object):  # type: ignore[misc]
    """Callbacks and ``data`` as in :class:`solvers.system.System`, and the ``terms`` they fill."""


@structref.register
class BundleType(types.StructRef):
    """Numba's type of a :class:`Bundle`."""


if COMPILED:
    structref.define_boxing(BundleType, Bundle)  # type: ignore[no-untyped-call]
    structref.define_constructor(Bundle, BundleType, list(FIELDS))  # type: ignore[no-untyped-call]


def bundle(system: System, terms: Terms) -> Any:
    """Return the bundle of a system and the terms it is to fill."""
    values = (system.dynamics, system.position, system.retract, system.jacobi, system.data, terms)
    if COMPILED:
        return make(*values)
    plain = Bundle()
    plain.__dict__.update(zip(FIELDS, values, strict=True))
    return plain


@kernel
def make(dynamics: Any, position: Any, retract: Any, jacobi: Any, data: Any, terms: Any) -> Any:
    """Allocate and fill a bundle."""
    return Bundle(dynamics, position, retract, jacobi, data, terms)

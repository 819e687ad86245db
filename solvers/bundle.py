"""Named tuples of arrays and callbacks, kept where a kernel reaches them.

Python hands a kernel each array and callback of a tuple anew, 0.3 us apiece; what is made here costs 1 us as a whole,
and kernels see the named tuple itself.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import typeof, types
from numba.extending import NativeValue, intrinsic, models, register_model, unbox

from .kernel import COMPILED, kernel
from .system import System, Terms


class Equations(NamedTuple):
    """Callbacks and ``data`` as in :class:`solvers.system.System`, and the ``terms`` they fill."""

    dynamics: Any
    position: Any
    retract: Any
    energy: Any
    data: Any
    terms: Terms


class HeldType(types.NamedTuple):
    """Numba's type of :class:`Held`: a named tuple that arrives by its address."""


register_model(HeldType)(models.TupleModel)


class Held:
    """A named tuple of arrays and callbacks, which stay where they are; what a kernel gets is the tuple."""

    def __init__(self, value: Any) -> None:
        self.value = value  # keeps the arrays alive
        self._numba_type_ = HeldType(typeof(value).types, type(value))  # type: ignore[no-untyped-call]
        self._place = np.zeros(size(value), np.uint8)
        self.address = self._place.ctypes.data
        put(value, self.address)


@unbox(HeldType)  # type: ignore[no-untyped-call, untyped-decorator]
def _unbox(typ: Any, held: Any, c: Any) -> Any:
    number = c.pyapi.object_getattr_string(held, "address")
    address = c.pyapi.long_as_voidptr(number)
    c.pyapi.decref(number)
    place = c.builder.bitcast(address, c.context.get_value_type(typ).as_pointer())
    return NativeValue(c.builder.load(place))  # type: ignore[no-untyped-call]


def _size(_: Any, value: Any) -> Any:
    def generate(context: Any, *_: Any) -> Any:
        return context.get_constant(types.int64, context.get_abi_sizeof(context.get_value_type(value)))

    return types.int64(value), generate


def _put(_: Any, value: Any, address: Any) -> Any:
    def generate(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        place = builder.inttoptr(arguments[1], context.get_value_type(value).as_pointer())
        builder.store(arguments[0], place)
        return context.get_dummy_value()

    return types.void(value, types.int64), generate


_size_of: Any = intrinsic(_size)
_store: Any = intrinsic(_put)


@kernel
def size(value: Any) -> int:
    """Bytes of a named tuple as kernels have it."""
    return _size_of(value)


@kernel
def put(value: Any, address: int) -> None:
    """Write a named tuple as kernels have it to an address."""
    _store(value, address)


def hold(value: Any) -> Any:
    """Return what Python hands to kernels in place of a named tuple."""
    return Held(value) if COMPILED else value


def bundle(system: System, terms: Terms) -> Any:
    """Return the equations of a system and the terms they are to fill."""
    return hold(Equations(system.dynamics, system.position, system.retract, system.energy, system.data, terms))

"""Pointers to named tuples of arrays and callbacks.

Python passes each array of a named tuple to a kernel at every call, 0.3 us each, and a kernel passes all their sizes
and strides, which costs more than small kernels do. What :func:`pin` makes is one address to both; kernels read the
tuple's fields as attributes all the same.
"""

from __future__ import annotations

from functools import cache
from hashlib import sha256
from typing import Any

import numpy as np
from numba import typeof, types
from numba.core import cgutils
from numba.core.registry import cpu_target
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    intrinsic,
    lower_getattr_generic,
    models,
    register_model,
    unbox,
)

from .code_files import name_of_type
from .kernel import COMPILED, kernel
from .symbols import Callback


class TuplePointerType(types.Type):
    """Numba's type of :class:`TuplePointer`."""

    def __init__(self, content: Any) -> None:
        self.content = content
        description = f"{content} {getattr(content, 'fields', ())}"
        for own in content.types:
            description = description.replace(str(own), name_of_type(own))
        super().__init__(name=f"Held_{sha256(description.encode()).hexdigest()[:16]}")  # it is part of every symbol


register_model(TuplePointerType)(models.OpaqueModel)


class TuplePointer:
    """A named tuple whose arrays stay where they are; ``value`` is the tuple, with pointers for those in it."""

    def __init__(self, value: Any) -> None:
        value = type(value)._make(pin(field) for field in value)
        self._numba_type_ = pointer_type(value)
        self.value = value  # keeps the arrays alive
        self._place = np.zeros(tuple_size(self._numba_type_), np.uint8)
        self.address = self._place.ctypes.data
        tuple_store(self._numba_type_)(value, self.address)


_array_types: dict[tuple[Any, ...], Any] = {}
# each keeps the types of its fields, so their identities stay
_tuple_types: dict[tuple[Any, ...], TuplePointerType] = {}


def pointer_type(example: Any) -> Any:
    """Return numba's type of the result of :func:`pin` for a value of this type."""
    if isinstance(example, np.ndarray):
        flags = example.flags
        array_kind = (type(example), example.dtype, example.dtype.isalignedstruct, example.ndim)
        key = (*array_kind, flags.c_contiguous, flags.f_contiguous, flags.writeable)
        if key not in _array_types:  # numba goes through all fields of a record every time
            _array_types[key] = typeof(example)  # type: ignore[no-untyped-call]
        return _array_types[key]
    if isinstance(example, TuplePointer):
        return example._numba_type_
    if isinstance(example, Callback):
        return _callback_type(example)
    if not isinstance(example, tuple):
        return typeof(example)  # type: ignore[no-untyped-call]
    fields = [pointer_type(field) for field in example]
    same = (type(example), *map(id, fields))
    if same not in _tuple_types:
        _tuple_types[same] = TuplePointerType(types.BaseTuple.from_types(fields, type(example)))  # type: ignore[no-untyped-call]
    return _tuple_types[same]


@cache
def _callback_type(callback: Callback) -> Any:
    """Return numba's type of a callback; numba would construct it at every call."""
    return typeof(callback)  # type: ignore[no-untyped-call]


def pin(value: Any) -> Any:
    """Return a pointer to a named tuple for kernels; any other value is returned unchanged."""
    return TuplePointer(value) if COMPILED and isinstance(value, tuple) else value


def unpin(pointer: Any) -> Any:
    """Return the tuple that :func:`pin` was given, with pointers for those in it."""
    return pointer.value if isinstance(pointer, TuplePointer) else pointer


@infer_getattr
class _Attributes(AttributeTemplate):
    key = TuplePointerType

    def generic_resolve(self, pointer: Any, name: str) -> Any:  # type: ignore[override]
        fields = pointer.content.fields
        return pointer.content.types[fields.index(name)] if name in fields else None


@lower_getattr_generic(TuplePointerType)  # type: ignore[no-untyped-call, untyped-decorator]
def _read(context: Any, builder: Any, pointer: Any, address: Any, name: str) -> Any:
    place = builder.bitcast(address, context.get_value_type(pointer.content).as_pointer())
    index = pointer.content.fields.index(name)
    field = builder.load(cgutils.gep_inbounds(builder, place, 0, index))  # type: ignore[no-untyped-call]
    field.set_metadata("invariant.load", builder.module.add_metadata([]))  # nothing moves once it is pinned
    return field


@unbox(TuplePointerType)  # type: ignore[no-untyped-call, untyped-decorator]
def _unbox(_: Any, pointer: Any, context: Any) -> Any:
    number = context.pyapi.object_getattr_string(pointer, "address")
    address = context.pyapi.long_as_voidptr(number)
    context.pyapi.decref(number)
    return NativeValue(address)  # type: ignore[no-untyped-call]


def _put(_: Any, value: Any, address: Any) -> Any:
    def generate(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        place = builder.inttoptr(arguments[1], context.get_value_type(value).as_pointer())
        builder.store(arguments[0], place)
        return context.get_dummy_value()

    return types.void(value, types.int64), generate


_store: Any = intrinsic(_put)


@cache
def tuple_size(pointer: Any) -> int:
    """Bytes of a tuple as kernels have it, from its type."""
    context: Any = cpu_target.target_context
    return int(context.get_abi_sizeof(context.get_value_type(pointer.content)))


@cache
def tuple_store(pointer: Any) -> Any:
    """Return :func:`store_tuple` for a type: a call that finds the types of all fields takes ten times as long."""
    arguments = pointer.content, types.int64
    store: Any = store_tuple
    store.compile(arguments)
    return store.callable_for(arguments)


@kernel
def store_tuple(value: Any, address: int) -> None:
    """Write a tuple as kernels have it to an address."""
    _store(value, address)

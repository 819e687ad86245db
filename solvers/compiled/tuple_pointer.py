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
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_getattr_generic,
    models,
    register_model,
    unbox,
)

from .code_files import name_of_type
from .kernel import COMPILED
from .symbols import Callback, Inlined


class TuplePointerType(types.Type):
    """Numba's type of :class:`TuplePointer`."""

    def __init__(self, content: Any) -> None:
        self.content = content
        description = f"{content} {getattr(content, 'fields', ())}"
        for own in content.types:
            description = description.replace(str(own), name_of_type(own))
        super().__init__(name=f"Held_{sha256(description.encode()).hexdigest()[:16]}")  # it is part of every symbol

    def __reduce__(self) -> Any:
        """Pickle it by its name: a description of all its fields is longer than the code of most kernels."""
        return pointer_type_by_name, (self.name,)


register_model(TuplePointerType)(models.OpaqueModel)


class TuplePointer:
    """A named tuple whose arrays stay where they are; ``value`` is the tuple, with pointers for those in it."""

    def __init__(self, value: Any) -> None:
        value = type(value)._make(pin(field) for field in value)
        self._numba_type_ = pointer_type(value)
        self.value = value  # keeps the arrays alive
        self._words = np.array([word for field in value for word in words_of(field)], np.int64)
        self.address = self._words.ctypes.data


def words_of(field: Any) -> tuple[int, ...]:
    """Return a field of a named tuple as the 64-bit integers that kernels have; TypeError for fields of other types.

    A compiled function that writes a tuple would have to be compiled or loaded for every type of tuple.
    """
    if isinstance(field, np.ndarray):  # counts of references, which kernels have not, then the array
        return 0, 0, field.size, field.itemsize, field.ctypes.data, *field.shape, *field.strides
    if isinstance(field, TuplePointer):
        return (field.address,)
    if isinstance(field, Callback):  # addresses of the function for C, of the object, and of that for kernels
        code: Any = field.address
        return code, id(field), 0
    if field is None or isinstance(field, Inlined):  # kernels have only its type
        return (0,)
    if isinstance(field, float):
        return (int(np.float64(field).view(np.int64)),)
    if isinstance(field, int | np.int64) and not isinstance(field, bool):
        return (int(field),)
    raise TypeError(f"field of a named tuple for kernels is {field!r}; allowed: arrays, tuples, kernels, numbers, None")


_array_types: dict[tuple[Any, ...], Any] = {}
# each keeps the types of its fields, so their identities stay
_tuple_types: dict[tuple[Any, ...], TuplePointerType] = {}
_types_by_name: dict[str, TuplePointerType] = {}


def pointer_type_by_name(name: str) -> TuplePointerType:
    """Return the type of this name; KeyError if there is none in this process, which then has no such arguments."""
    return _types_by_name[name]


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
        made = TuplePointerType(types.BaseTuple.from_types(fields, type(example)))  # type: ignore[no-untyped-call]
        _tuple_types[same] = _types_by_name[made.name] = made
    return _tuple_types[same]


@cache
def _callback_type(callback: Callback) -> Any:
    """Return numba's type of a callback: ``typeof`` fails before numba has compiled something."""
    return types.FunctionType(callback._sig)  # type: ignore[attr-defined]


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

"""Kernels called by their address, with a record of parameters: the recursions call kernels of any element type so.

A joint, a load or a signal is a number of a row in a table of addresses and a place among the bytes of all records. The
caller is compiled once for all element types; an element type is compiled for its record when it is first used.

    call_void(address, memory, place, (argument, ...))

calls a kernel ``f(record, argument, ...)`` that returns nothing; ``call_f``, ``call_ff`` and ``call_fff`` call one that
returns as many numbers, of the kind of those in the array ``like``: real, or complex where derivatives are taken. With
``NUMBA_DISABLE_JIT=1`` an address is a number in a list.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numba import from_dtype, types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import intrinsic
from numpy.typing import NDArray

from .kernel import COMPILED
from .pipeline import code_of

RECORD_ALIGNMENT = 16  # bytes, of every record: two real numbers, or one complex

# function, record and memory of calls without a compiler
_record_cache: dict[tuple[int, int, int], tuple[Any, Any, Any]] = {}
_functions: list[tuple[Any, Any]] = [(None, None)]  # without a compiler: what an address stands for; zero is none


def address_of(function: Any, dtype: np.dtype[Any], arguments: Sequence[Any], result: Any) -> int:
    """Return the address of a kernel compiled for a record of ``dtype``, argument types and a result, all numba's."""
    if not COMPILED:
        _functions.append((function, dtype))
        return len(_functions) - 1
    signature = result(record_type(dtype), *arguments)
    function.compile(signature)
    compiled = function.overloads[signature.args]
    return int(code_of(compiled).get_pointer_to_function(compiled.fndesc.llvm_func_name))


def record_type(dtype: np.dtype[Any]) -> Any:
    """Return numba's type of a record."""
    return from_dtype(dtype)


def pack_records(tables: Sequence[NDArray[Any]]) -> tuple[NDArray[np.uint8], list[NDArray[Any]], list[int]]:
    """Return the bytes of record arrays one behind the other, the arrays as they lie there, and where each begins."""
    starts, size = [], 0
    for table in tables:
        starts.append(size)
        size += -(-table.nbytes // RECORD_ALIGNMENT) * RECORD_ALIGNMENT
    memory = np.zeros(size // RECORD_ALIGNMENT + 1, np.complex128).view(np.uint8)  # aligned
    found = []
    for table, start in zip(tables, starts, strict=True):
        there = memory[start : start + table.nbytes].view(table.dtype)
        there[:] = table
        found.append(there if COMPILED else there.view(np.recarray))
    return memory, found, starts


def _interpreted(address: int, memory: Any, place: int, arguments: Any) -> Any:
    cached = _record_cache.get((address, id(memory), place))
    if cached is None:
        function, dtype = _functions[address]
        record = memory[place : place + dtype.itemsize].view(dtype).view(np.recarray)[0]
        cached = _record_cache[address, id(memory), place] = function, record, memory
    return cached[0](cached[1], *arguments)


def _called(result: Any, memory: Any, arguments: Any) -> Any:
    """Return the code that calls what returns ``result``."""
    if any(isinstance(argument, types.BaseNamedTuple) for argument in arguments.types):
        raise TypingError(
            "kernels that are called by address take named tuples by a pointer, see solvers.compiled.tuple_pointer"
        )
    kinds = [types.voidptr, *arguments.types]  # a record is handed on as a pointer to its bytes

    def generate(context: Any, builder: Any, _: Any, values: Any) -> Any:
        address, given, place = values[:3]
        first = builder.gep(context.make_helper(builder, memory, given).data, [place])
        function = context.call_conv.get_function_type(result, kinds)
        callee = builder.inttoptr(address, function.as_pointer())
        handed = [builder.bitcast(first, ir.IntType(8).as_pointer())]
        handed += cgutils.unpack_tuple(builder, values[-1])  # type: ignore[no-untyped-call]
        status, value = context.call_conv.call_function(builder, callee, result, kinds, handed)
        with cgutils.if_unlikely(builder, status.is_error):  # type: ignore[no-untyped-call]
            context.call_conv.return_status_propagate(builder, status)
        return value

    return generate


def _call_void(_: Any, address: Any, memory: Any, place: Any, arguments: Any) -> Any:
    return types.none(types.int64, memory, types.int64, arguments), _called(types.none, memory, arguments)


def _call_f(_: Any, address: Any, memory: Any, place: Any, like: Any, arguments: Any) -> Any:
    result = like.dtype
    return result(types.int64, memory, types.int64, like, arguments), _called(result, memory, arguments)


def _call_ff(_: Any, address: Any, memory: Any, place: Any, like: Any, arguments: Any) -> Any:
    result: Any = types.UniTuple(like.dtype, 2)  # type: ignore[no-untyped-call]
    return result(types.int64, memory, types.int64, like, arguments), _called(result, memory, arguments)


def _call_fff(_: Any, address: Any, memory: Any, place: Any, like: Any, arguments: Any) -> Any:
    result: Any = types.UniTuple(like.dtype, 3)  # type: ignore[no-untyped-call]
    return result(types.int64, memory, types.int64, like, arguments), _called(result, memory, arguments)


def _call_f_interpreted(address: int, memory: Any, place: int, like: Any, arguments: Any) -> Any:
    return _interpreted(address, memory, place, arguments)


call_void: Any = intrinsic(_call_void) if COMPILED else _interpreted
call_f: Any = intrinsic(_call_f) if COMPILED else _call_f_interpreted
call_ff: Any = intrinsic(_call_ff) if COMPILED else _call_f_interpreted
call_fff: Any = intrinsic(_call_fff) if COMPILED else _call_f_interpreted

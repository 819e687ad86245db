"""Kernels called by their address, with a record of parameters: how a recursion meets a kind that it does not know.

A joint, a load or a signal is a number of a row in a table of addresses and a place among the bytes of all records. The
caller is compiled once for all element types; an element type is compiled for its record when it is first used.

    call(address, memory, place, (argument, ...))

calls a kernel ``f(record, argument, ...)`` that returns nothing; ``number``, ``two`` and ``three`` call one that
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
from .linking import code_of

ALIGNED = 16  # bytes, of every record: two real numbers, or one complex

_met: dict[tuple[int, int, int], tuple[Any, Any, Any]] = {}  # function, record and memory of calls without a compiler
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


def side_by_side(tables: Sequence[NDArray[Any]]) -> tuple[NDArray[np.uint8], list[NDArray[Any]], list[int]]:
    """Return the bytes of record arrays one behind the other, the arrays as they lie there, and where each begins."""
    starts, size = [], 0
    for table in tables:
        starts.append(size)
        size += -(-table.nbytes // ALIGNED) * ALIGNED
    memory = np.zeros(size // ALIGNED + 1, np.complex128).view(np.uint8)  # aligned
    found = []
    for table, start in zip(tables, starts, strict=True):
        there = memory[start : start + table.nbytes].view(table.dtype)
        there[:] = table
        found.append(there if COMPILED else there.view(np.recarray))
    return memory, found, starts


def _interpreted(address: int, memory: Any, place: int, arguments: Any) -> Any:
    met = _met.get((address, id(memory), place))
    if met is None:
        function, dtype = _functions[address]
        record = memory[place : place + dtype.itemsize].view(dtype).view(np.recarray)[0]
        met = _met[address, id(memory), place] = function, record, memory
    return met[0](met[1], *arguments)


def _called(result: Any, memory: Any, arguments: Any) -> Any:
    """Return the code that calls what returns ``result``."""
    if any(isinstance(argument, types.BaseNamedTuple) for argument in arguments.types):
        raise TypingError("kernels that are called by address take named tuples held, see solvers.compiled.held")
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


def _call(_: Any, address: Any, memory: Any, place: Any, arguments: Any) -> Any:
    return types.none(types.int64, memory, types.int64, arguments), _called(types.none, memory, arguments)


def _number(_: Any, address: Any, memory: Any, place: Any, like: Any, arguments: Any) -> Any:
    result = like.dtype
    return result(types.int64, memory, types.int64, like, arguments), _called(result, memory, arguments)


def _two(_: Any, address: Any, memory: Any, place: Any, like: Any, arguments: Any) -> Any:
    result: Any = types.UniTuple(like.dtype, 2)  # type: ignore[no-untyped-call]
    return result(types.int64, memory, types.int64, like, arguments), _called(result, memory, arguments)


def _three(_: Any, address: Any, memory: Any, place: Any, like: Any, arguments: Any) -> Any:
    result: Any = types.UniTuple(like.dtype, 3)  # type: ignore[no-untyped-call]
    return result(types.int64, memory, types.int64, like, arguments), _called(result, memory, arguments)


def _number_interpreted(address: int, memory: Any, place: int, like: Any, arguments: Any) -> Any:
    return _interpreted(address, memory, place, arguments)


call: Any = intrinsic(_call) if COMPILED else _interpreted
number: Any = intrinsic(_number) if COMPILED else _number_interpreted
two: Any = intrinsic(_two) if COMPILED else _number_interpreted
three: Any = intrinsic(_three) if COMPILED else _number_interpreted

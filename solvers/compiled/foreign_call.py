"""C functions called by kernels through a table of addresses.

    call_int(address, (argument, ...))         calls a function that returns C's int
    call_pointer(address, (argument, ...))     calls one that returns a pointer

Arguments are real numbers (double), 32-bit integers (int), and 64-bit integers (pointers). With
``NUMBA_DISABLE_JIT=1`` there are no such calls.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


def _called(result: Any) -> Any:
    def typed(_: Any, address: Any, arguments: Any) -> Any:
        def generate(context: Any, builder: Any, _: Any, values: Any) -> Any:
            kinds = [context.get_value_type(argument) for argument in arguments.types]
            function = ir.FunctionType(context.get_value_type(result), kinds)
            callee = builder.inttoptr(values[0], function.as_pointer())
            return builder.call(callee, cgutils.unpack_tuple(builder, values[1]))  # type: ignore[no-untyped-call]

        return result(types.int64, arguments), generate

    return typed


def _address_of(_: Any, array: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, values[0]).data
        return builder.ptrtoint(data, context.get_value_type(types.int64))

    return types.int64(array), generate


call_int: Any = intrinsic(_called(types.int32))
call_pointer: Any = intrinsic(_called(types.int64))
address_of_array: Any = intrinsic(_address_of)  # (array): of its first number

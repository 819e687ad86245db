"""Dot products whose terms are added in a fixed order that vector instructions of every processor can follow.

Four partial sums take the terms in turn, and are added in pairs. A compiler may use vector instructions of any width
for them, and all give the same result to the last bit. A sum in the order of its terms cannot use them, and one in any
order depends on their width.

    dot_column(columns, at, count, x, first)             columns[at : at + count] . x[first : first + count]
    dot_four_columns(columns, at, stride, count, x, first)   the same of four columns, ``stride`` entries apart
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from .kernel import COMPILED

LANES = 4  # partial sums
ENTRY_BYTES = 8


def _generate(context: Any, builder: Any, columns: Any, count: Any, x: Any) -> list[Any]:
    """Return the dot products of ``count`` numbers at the pointer x and at each of the pointers ``columns``."""
    vector = ir.VectorType(ir.DoubleType(), LANES)

    def lanes_at(pointer: Any, index: Any) -> Any:
        place = builder.bitcast(builder.gep(pointer, [index]), vector.as_pointer())
        return builder.load(place, align=ENTRY_BYTES)

    sums = [cgutils.alloca_once_value(builder, ir.Constant(vector, [0.0] * LANES)) for _ in columns]  # type: ignore[no-untyped-call]
    zero, step = context.get_constant(types.intp, 0), context.get_constant(types.intp, LANES)
    whole = builder.and_(count, context.get_constant(types.intp, -LANES))
    with cgutils.for_range_slice(builder, zero, whole, step, whole.type) as (index, _):
        other = lanes_at(x, index)
        for place, column in zip(sums, columns, strict=True):
            builder.store(builder.fadd(builder.load(place), builder.fmul(lanes_at(column, index), other)), place)
    totals = []
    for place in sums:
        lanes = [builder.extract_element(builder.load(place), ir.Constant(ir.IntType(32), k)) for k in range(LANES)]
        total = builder.fadd(builder.fadd(lanes[0], lanes[1]), builder.fadd(lanes[2], lanes[3]))
        totals.append(cgutils.alloca_once_value(builder, total))  # type: ignore[no-untyped-call]
    one = context.get_constant(types.intp, 1)
    with cgutils.for_range_slice(builder, whole, count, one, whole.type) as (index, _):
        other = builder.load(builder.gep(x, [index]))
        for place, column in zip(totals, columns, strict=True):
            term = builder.fmul(builder.load(builder.gep(column, [index])), other)
            builder.store(builder.fadd(builder.load(place), term), place)
    return [builder.load(place) for place in totals]


def _dot_column(_: Any, columns: Any, at: Any, count: Any, x: Any, first: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        given, begin, size, other, start = values
        column = builder.gep(context.make_array(signature.args[0])(context, builder, given).data, [begin])
        against = builder.gep(context.make_array(signature.args[3])(context, builder, other).data, [start])
        return _generate(context, builder, [column], size, against)[0]

    return types.float64(columns, types.int64, types.int64, x, types.int64), generate


def _dot_four_columns(_: Any, columns: Any, at: Any, stride: Any, count: Any, x: Any, first: Any) -> Any:
    result = types.UniTuple(types.float64, 4)  # type: ignore[no-untyped-call]

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        given, begin, apart, size, other, start = values
        place = builder.gep(context.make_array(signature.args[0])(context, builder, given).data, [begin])
        found = [place]
        for _ in range(3):
            found.append(builder.gep(found[-1], [apart]))
        against = builder.gep(context.make_array(signature.args[4])(context, builder, other).data, [start])
        return context.make_tuple(builder, result, _generate(context, builder, found, size, against))

    return result(columns, types.int64, types.int64, types.int64, x, types.int64), generate


def _interpreted_column(columns: Any, at: int, count: int, x: Any, first: int) -> float:
    sums, whole = [0.0] * LANES, count - count % LANES
    for i in range(whole):
        sums[i % LANES] += columns[at + i] * x[first + i]
    total = (sums[0] + sums[1]) + (sums[2] + sums[3])
    for i in range(whole, count):
        total += columns[at + i] * x[first + i]
    return float(total)


def _interpreted_four_columns(columns: Any, at: int, stride: int, count: int, x: Any, first: int) -> Any:
    return tuple(_interpreted_column(columns, at + k * stride, count, x, first) for k in range(4))


dot_column: Any = intrinsic(_dot_column) if COMPILED else _interpreted_column
dot_four_columns: Any = intrinsic(_dot_four_columns) if COMPILED else _interpreted_four_columns

"""Matrices of any size in one array of numbers, for kernels that allocate nothing.

    matrix_at(numbers, first, rows, columns)

returns the matrix whose rows are contiguous from ``numbers[first]`` on. It shares its memory with ``numbers`` (k,).
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from .kernel import COMPILED


def _matrix_at(_: Any, numbers: Any, first: Any, rows: Any, columns: Any) -> Any:
    matrix, integer = types.Array(numbers.dtype, 2, "C"), types.int64

    def generate(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        flat, begin, m, n = arguments
        made, size = context.make_array(matrix)(context, builder), context.get_constant(types.intp, 8)
        data = builder.gep(context.make_array(numbers)(context, builder, flat).data, [begin])
        populate_array(made, data, [m, n], [builder.mul(n, size), size], size, None)  # type: ignore[no-untyped-call]
        return made._getvalue()

    return matrix(numbers, integer, integer, integer), generate


def _interpreted(numbers: Any, first: int, rows: int, columns: int) -> Any:
    return numbers[first : first + rows * columns].reshape(rows, columns)


matrix_at: Any = intrinsic(_matrix_at) if COMPILED else _interpreted

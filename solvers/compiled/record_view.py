"""A record at a place among bytes: scratch memory whose fields only the kernels that use it know.

    record_at(memory, place, dtype, like)

returns the record of ``dtype`` that begins at byte ``place``, with real numbers or, where those in the array ``like``
are complex, with complex ones. A complex record is at most twice as long as the real one, so it begins at twice the
place; memory for complex numbers is twice as long.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.core.types import Record
from numba.extending import intrinsic
from numba.np.numpy_support import as_dtype
from numpy.typing import NDArray

from .indirect_call import RECORD_ALIGNMENT, record_type
from .kernel import COMPILED

COMPLEX_FACTOR = 2  # length of a complex record relative to the real one, at most

# memory and record by place and dtype, of calls without a compiler
_views: dict[tuple[int, int, np.dtype[Any]], tuple[Any, Any]] = {}


def aligned_bytes(size: int) -> NDArray[np.uint8]:
    """Return zeroed memory of at least ``size`` bytes in which records may begin at multiples of the alignment."""
    return np.zeros(size // RECORD_ALIGNMENT + 1, np.complex128).view(np.uint8)


def round_up(size: int) -> int:
    """Return a length (bytes) behind which another record may begin."""
    return -(-size // RECORD_ALIGNMENT) * RECORD_ALIGNMENT


def complex_dtype(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Return the fields of a record with complex numbers for real ones."""
    fields = [(name, *_complex_field(dtype[name])) for name in dtype.names or ()]
    return np.dtype(fields, align=True)


def _complex_field(dtype: np.dtype[Any]) -> tuple[type, tuple[int, ...]]:
    return (np.complex128 if dtype.base == np.float64 else np.int64), dtype.shape


def _record_at(_: Any, memory: Any, place: Any, dtype: Any, like: Any) -> Any:
    record: Record = dtype.dtype
    factor = 1
    if like.dtype == types.complex128:
        record, factor = record_type(complex_dtype(as_dtype(record))), COMPLEX_FACTOR

    def generate(context: Any, builder: Any, _: Any, values: Any) -> Any:
        offset = builder.mul(values[1], context.get_constant(types.int64, factor))
        first = builder.gep(context.make_helper(builder, memory, values[0]).data, [offset])
        return builder.bitcast(first, context.get_value_type(record))

    return record(memory, types.int64, dtype, like), generate


def _record_at_interpreted(memory: Any, place: int, dtype: np.dtype[Any], like: Any) -> Any:
    key = (id(memory), int(place), dtype if like.dtype == np.float64 else complex_dtype(dtype))
    if key not in _views:
        own, first = key[2], int(place) * (1 if key[2] is dtype else COMPLEX_FACTOR)
        _views[key] = memory, memory[first : first + own.itemsize].view(own).view(np.recarray)[0]
    return _views[key][1]


record_at: Any = intrinsic(_record_at) if COMPILED else _record_at_interpreted

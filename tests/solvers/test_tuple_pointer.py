"""Named tuples as kernels have them: every kind of field."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from solvers.compiled.kernel import COMPILED, callback, jit_uncached, system_kernel, types
from solvers.compiled.tuple_pointer import pin, pointer_type, pointer_type_by_name, unpin


class Inner(NamedTuple):
    values: Any
    number: float


class Outer(NamedTuple):
    nothing: Any
    table: Any
    kernel: Any
    inner: Any
    callback: Any
    count: int
    factor: float
    bytes: Any


@system_kernel
def double(x: float) -> float:
    return 2.0 * x


def triple(x: float) -> float:
    return 3.0 * x


def collect(outer: Any, found: Any) -> None:
    found[0], found[1], found[2] = outer.table[0, 0], outer.table[1, 2], outer.table.shape[1]
    found[3], found[4] = outer.kernel(1.0), outer.callback(1.0)
    found[5], found[6] = outer.inner.values[1], outer.inner.number
    found[7], found[8], found[9] = outer.count, outer.factor, outer.bytes[2]
    outer.inner.values[0] = -1.0


def test_a_kernel_reads_every_kind_of_field() -> None:
    table, values = np.arange(24.0).reshape(2, 3, 4)[:, ::-1, 1], np.array([4.0, 5.0])
    called = callback(types.float64(types.float64))(triple)
    inner = Inner(values, -0.5)
    outer = pin(Outer(None, table, double, inner, called, -7, 1e300, np.array([1, 2, 250], np.uint8)))
    found = np.zeros(10)
    jit_uncached(collect)(outer, found)
    expected = [table[0, 0], table[1, 2], 3, 2, 3, 5, -0.5, -7, 1e300, 250]
    assert found.tolist() == expected
    assert values[0] == -1.0
    assert unpin(outer).count == -7


@pytest.mark.skipif(not COMPILED, reason="named tuples remain what they are")
def test_other_fields_are_refused_and_types_have_names() -> None:
    with pytest.raises(TypeError, match="field of a named tuple for kernels is True"):
        pin(Inner(np.zeros(1), True))
    own = pointer_type(pin(Inner(np.zeros(2), 1.0)))
    assert pointer_type_by_name(own.name) is own

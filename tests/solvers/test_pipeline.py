"""Compilation with fewer steps has the result of numba's."""

from __future__ import annotations

import gc
import math
from typing import Any

import numpy as np
import pytest
from numba.core import ir
from numba.core.compiler import Flags, run_frontend
from numba.core.registry import cpu_target
from numba.extending import overload

from solvers.compiled.kernel import COMPILED, jit_uncached
from solvers.compiled.pipeline import KernelLibrary, shortened

pytestmark = pytest.mark.skipif(not COMPILED, reason="without a compiler")


def branching(values: Any, pair: Any, scale: float = 2.0) -> Any:
    """Calls with and without names, tuples, subscripts, loops and conditions."""
    total, (first, second) = 0.0, pair
    for k in range(len(values)):
        if values[k] > 0.0 and not math.isnan(scale):
            values[k] = max(values[k], scale) * first
        else:
            values[k] += round(number=second, ndigits=3)
        total += values[-1]
    return total, values[1:3], {"scale": scale}, [total, -second]


def test_the_same_variables_are_found_in_statements() -> None:
    def found() -> list[list[str]]:
        represented: Any = run_frontend(branching)  # type: ignore[no-untyped-call]
        statements = [s for block in represented.blocks.values() for s in block.body]
        values = [s.value for s in statements if isinstance(s, ir.Assign) and isinstance(s.value, ir.Inst)]
        return [[v.name for v in own.list_vars()] for own in (*statements, *values)]

    expected = found()
    with shortened():
        assert found() == expected
    assert sum(map(len, expected)) > 100


def test_an_extension_that_is_registered_later_is_found() -> None:
    assert jit_uncached(lambda x: x + 1.0)(1.0) == 2.0

    def doubled(x: float) -> float:
        raise NotImplementedError

    def implement(x):  # type: ignore[no-untyped-def]  # numba compares signatures
        return lambda x: 2.0 * x

    overload(doubled)(implement)
    assert jit_uncached(lambda x: 1.0 + doubled(x))(3.0) == 7.0


def test_thresholds_of_the_garbage_collection_are_restored() -> None:
    before = gc.get_threshold()
    with shortened():
        assert gc.get_threshold() > before
        with shortened():
            pass
        assert gc.get_threshold() > before
    assert gc.get_threshold() == before
    with pytest.raises(ZeroDivisionError), shortened():
        1 / 0  # noqa: B018
    assert gc.get_threshold() == before


def test_a_finalizer_may_compile_while_it_begins_or_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    generator, libraries = type(cpu_target.target_context.codegen()), []
    set_threshold = gc.set_threshold

    def collect(*thresholds: int) -> None:
        set_threshold(*thresholds)
        monkeypatch.undo()  # a collection that executes the finalizer
        with shortened():
            libraries.append(generator._library_class)
        monkeypatch.setattr(gc, "set_threshold", collect)

    monkeypatch.setattr(gc, "set_threshold", collect)
    before = generator._library_class
    with shortened():
        assert generator._library_class is KernelLibrary
    assert libraries == [KernelLibrary, KernelLibrary]
    assert generator._library_class is before


@pytest.mark.parametrize("changes", [{}, {"nrt": False}, {"nrt": True}, {"error_model": "numpy"}, {"inline": "always"}])
def test_flags_are_equal_if_all_values_are(changes: dict[str, Any]) -> None:
    def make(**values: Any) -> Any:
        made: Any = Flags()  # type: ignore[no-untyped-call]
        for name, value in values.items():
            setattr(made, name, value)
        return made

    others: tuple[dict[str, Any], ...] = (
        {},
        {"nrt": False},
        {"nrt": True},
        {"error_model": "python"},
        {"error_model": "numpy"},
    )
    pairs = [(make(**changes), make(**other)) for other in others]
    expected = [one.values() == other.values() for one, other in pairs]
    assert np.any(expected) or "inline" in changes
    with shortened():
        assert [one == other for one, other in pairs] == expected

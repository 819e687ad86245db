"""The records of all kinds that are in a mechanism, and where their kernels are."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.kind import ElementType, kernel_of, record_of
from mbfmu.mechanics.records import (
    MAX_KERNELS,
    MotionRecord,
    empty_data,
    to_complex,
    to_complex_data,
    to_complex_state,
)
from mbfmu.util.errors import UserError
from solvers.compiled.indirect_call import address_of, pack_records, record_type
from solvers.compiled.kernel import COMPILED, records, types
from solvers.compiled.record_view import complex_dtype
from solvers.compiled.tuple_pointer import pointer_type


class NumberTypes(NamedTuple):
    """Which numbers kernels work on, and which kernels are not called with those."""

    arrays: type
    state: type
    left_out: frozenset[str]


# nothing is derived from these
UNMOVED = frozenset(("longest_step", "power", "monitor", "misplacement", "clearance"))
REAL = NumberTypes(float, float, frozenset(("tangent",)))
COMPLEX = NumberTypes(complex, complex, UNMOVED | {"tangent"})  # derivatives by all that is in both
TANGENT_NUMBERS = NumberTypes(float, complex, UNMOVED | {"bias", "potential", "read"})  # ... by the state alone
LINEARIZED = NumberTypes(float, complex, UNMOVED | {"tangent"})  # ... and of all that is computed from it
COMPLEX_STEP_NUMBERS = NumberTypes(
    float, complex, UNMOVED - {"clearance"} | {"potential", "read", "tangent"}
)  # ... along one direction


Words = tuple[tuple[str, np.dtype[Any]], ...]  # records that the words of a role stand for


class UsedType(NamedTuple):
    """A kind that is there: its record, and its kernels by name with what they are called with."""

    record: np.dtype[Any]
    kernels: tuple[tuple[str, str, Any], ...]
    words: Words


class CalledKernel(NamedTuple):
    """A kernel that is called by its address."""

    function: Any
    record: np.dtype[Any]
    signature: str  # the words of what it is called with after the record, and what it returns
    words: Words = ()
    state: type = float  # numbers of the state that it is called with


class Tables:
    """Records of everything that has a kind, those of one kind side by side.

    Parameters
    ----------
    items
        Joints, cut joints, couplings, loads, signals, parts and sensors.
    filled
        Their records, filled, one (1,) array each.
    parts
        Those of the items that are parts: loads call the kernels ``read`` of sensors among them.

    Attributes
    ----------
    kinds, places
        Of every item its row among the kernels and where its record is in ``memory``.
    tables
        The records of every kind, as they lie in ``memory``.
    """

    def __init__(
        self, items: Sequence[ElementType], filled: Sequence[NDArray[Any]], parts: Sequence[ElementType] = ()
    ) -> None:
        used = [used_type(item) for item in items]
        self._used = list(dict.fromkeys(used))
        self._of_parts = {used_type(part) for part in parts}
        number = {kind: k for k, kind in enumerate(self._used)}
        self.kinds = [number[kind] for kind in used]
        counts = np.bincount(np.array(self.kinds, np.int64), minlength=len(self._used))
        empty = [records(n, kind.record) for n, kind in zip(counts, self._used, strict=True)]
        self.memory, self.tables, starts = pack_records(empty)
        self.places = self._laid(self.tables, starts)
        for place, record in zip(self.places, filled, strict=True):
            self.memory[place : place + record.nbytes] = record.view(np.uint8)

    def _laid(self, tables: list[NDArray[Any]], starts: list[int]) -> list[int]:
        """Return of every item where its record is."""
        met, places = [0] * len(tables), []
        for kind in self.kinds:
            places.append(starts[kind] + met[kind] * tables[kind].itemsize)
            met[kind] += 1
        return places

    def table(self, kind: type[ElementType]) -> NDArray[Any]:
        """Return the records of a kind that has the same kernels wherever it is."""
        found = [k for k, used in enumerate(self._used) if used == used_type(kind)]
        return self.tables[found[0]] if found else records(0, record_of(kind))

    def kernels(self, numbers: NumberTypes = REAL) -> NDArray[np.int64]:
        """Return the addresses of all kernels, MAX_KERNELS for each kind, compiled for these numbers."""
        table = np.zeros((max(1, len(self._used)), MAX_KERNELS), np.int64)
        for own, kind in zip(table, self._used, strict=False):
            for k, called in enumerate(called_kernels(kind, numbers, is_part=kind in self._of_parts)):
                if called is not None:
                    own[k] = compiled(called, kind.kernels[k][0], numbers)
        return table.ravel()

    def called(self, numbers: NumberTypes = REAL) -> list[CalledKernel | None]:
        """Return what the addresses of :meth:`kernels` are of; None where there is none."""
        found: list[CalledKernel | None] = [None] * (max(1, len(self._used)) * MAX_KERNELS)
        for i, kind in enumerate(self._used):
            for k, called in enumerate(called_kernels(kind, numbers, is_part=kind in self._of_parts)):
                found[MAX_KERNELS * i + k] = called
        return found

    def complex_memory(self) -> tuple[NDArray[np.uint8], list[int]]:
        """Return the records as they are now with complex numbers for real ones, and where each is."""
        memory, tables, starts = pack_records([to_complex(table) for table in self.tables])
        return memory, self._laid(tables, starts)


def used_type(item: ElementType | type[ElementType]) -> UsedType:
    """Return what an item has in common with others of its kind."""
    kernels = tuple((name, signature, kernel_of(item, name)) for name, signature in item.kernels.items())
    return UsedType(record_of(item), kernels, tuple(item.records.items()))


def called_kernels(kind: UsedType, numbers: NumberTypes, *, is_part: bool = False) -> list[CalledKernel | None]:
    """Return the kernels of a kind that are called with these numbers; None where there is none.

    Loads call the kernel ``read`` of a part with all numbers.
    """
    analytic = any(name == "tangent" and function is not None for name, _, function in kind.kernels)
    left_out = numbers.left_out | ({"apply"} if analytic and numbers is TANGENT_NUMBERS else set())
    left_out -= {"read"} if is_part else set()
    return [
        None
        if function is None or name in left_out
        else CalledKernel(function, kind.record, signature, kind.words, _state_numbers(name, signature, kind, numbers))
        for name, signature, function in kind.kernels
    ]


def _state_numbers(name: str, signature: str, kind: UsedType, numbers: NumberTypes) -> type:
    return numbers.state if name != "tangent" and has_state(signature, kind.words) else float


def has_state(signature: str, words: Words) -> bool:
    """Whether a kernel is called with something that moves."""
    return not {"state", "coordinate", *dict(words)}.isdisjoint(signature.partition(" -> ")[0].split(", "))


@cache
def compiled(called: CalledKernel, name: str, numbers: NumberTypes) -> int:
    """Return the address of a kernel, compiled for the words of its signature."""
    function, record, signature, *_ = called
    own = record if numbers.arrays is float else complex_dtype(record)
    arguments, returned = types_of(called, numbers.arrays)
    try:
        return address_of(function, own, arguments, returned)
    except Exception as error:  # of numba's many, whatever a user's kernel meets
        where = f"{function.__module__}.{function.__qualname__}"
        words, _, result = signature.partition(" -> ")
        wanted = f"it is called with its record, {words}, and returns {result or 'nothing'}"
        lines = [line.strip() for line in str(error).splitlines() if line.strip() and "nopython mode" not in line]
        reason = f"{type(error).__name__}: {lines[0] if lines else ''}"
        raise UserError(f"kernel {name!r} ({where}) cannot be compiled: {reason}; {wanted}") from error


def types_of(called: CalledKernel, arrays: type = float) -> tuple[list[Any], Any]:
    """Return numba's types of what a signature's words stand for: arguments after the record, and what is returned."""
    (words, _, result), state = called.signature.partition(" -> "), called.state
    known = word_types(arrays, state) if COMPILED else {}
    for word, dtype in called.words if COMPILED else ():
        known = {**known, word: record_type(complex_dtype(dtype) if state is complex else dtype)}
    moving = has_state(called.signature, called.words)
    number = types.complex128 if (state if moving else arrays) is complex else types.float64
    pair, triple = (types.UniTuple(number, count) for count in (2, 3))  # type: ignore[no-untyped-call]
    returned = {"": types.void, "number": number, "two": pair, "three": triple}
    return [known.get(word) for word in words.split(", ")], returned[result]


@cache
def word_types(arrays: type, state: type) -> dict[str, Any]:
    """Return numba's types of what kernels are called with, by the words of a signature."""
    real = empty_data()
    number = types.complex128 if state is complex else types.float64
    return {
        "time": types.float64,
        "coordinate": number,
        "index": types.int64,
        "arrays": pointer_type((to_complex_data(real) if arrays is complex else real).arrays),
        "state": pointer_type(to_complex_state(real.state) if state is complex else real.state),
        "perturbed": pointer_type(to_complex_state(real.state)),
        "motion": record_type(complex_dtype(MotionRecord.dtype) if state is complex else MotionRecord.dtype),
        "lam": number[::1],
        "matrix": types.float64[:, ::1],
    }

"""All that one started model needs, in one block of memory: arrays, and the tuples by whose address kernels find them.

Machine code depends on types of arrays and not on sizes, so the same code serves every model; a model is such a block.
An instance is a copy of it in which the addresses are put right: of arrays and tuples within the block, and of the
kernels of joints, loads and the like in the code. What a motion is saved and restored by comes first, and has no
addresses.

An array that is part of another one is so in the block too, where the larger one comes first.

Numba lays a tuple out as words, one field after the other: of an array {0, 0, entries, bytes of one, address, shape,
strides}, of a held tuple its address, of a function that is called by its name one word that nobody reads.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.tuple_pointer import unpin

ALIGNMENT_BYTES = 64  # bytes
ADDRESS_WORD = 4  # word of an array that holds its address


class Relocation(NamedTuple):
    """A word that holds an address."""

    at: int  # bytes from the beginning of the block
    target: int  # bytes from the beginning of the block, or the number of a kernel


class MemoryImage:
    """The block of a tuple, of arrays, whole numbers, functions (zero) and other tuples that are held.

    Parameters
    ----------
    root
        Holds everything.
    state
        Arrays that are saved and restored.
    tables
        Arrays of addresses of kernels, which are other ones in the runtime, each with the numbers of those kernels in
        the runtime; -1: there is none.
    snapshot
        An array of words (1,), others, and an array of ``state``: in the block the first one is the memory of all
        arrays before that array of ``state``, and each of the others has the size of it. None: there are none.

    Attributes
    ----------
    size, saved
        Bytes of the block, and of its part that is saved.
    root
        Where the tuple is.
    relocations, kernels
        What is to be put right: addresses within the block, and of kernels.
    """

    def __init__(
        self,
        root: tuple[Any, ...],
        state: Sequence[NDArray[Any]],
        tables: Sequence[tuple[NDArray[np.int64], Sequence[int]]],
        snapshot: tuple[NDArray[np.int64], Sequence[NDArray[np.int64]], NDArray[Any]] | None = None,
    ) -> None:
        self.size = 0
        self._regions: dict[int, tuple[int, int]] = {}  # place and bytes of memory, by the identity of an array
        self._arrays: dict[int, tuple[int, NDArray[Any]]] = {}  # place and array, by address in this process
        self._tuples: dict[int, tuple[int, Any]] = {}  # place and tuple, by address
        self._words: list[tuple[int, bytes]] = []
        self.relocations: list[Relocation] = []
        for array in state:
            self._emit_array(array)
        self.saved = self.size
        if snapshot is not None:
            before, copies, first = snapshot
            extent = self.at(first)
            self._regions = {id(before): (0, extent), **{id(copy): (self._grow(extent), extent) for copy in copies}}
        self.root = self._emit_tuple(root)
        self.kernels = [
            Relocation(self.at(addresses) + 8 * k, number)
            for addresses, numbers in tables
            for k, number in enumerate(numbers)
            if number >= 0
        ]

    def at(self, array: NDArray[Any], field: str | None = None) -> int:
        """Return where an array is, or a field of its first record; 0 for an empty array, which has no place."""
        if not array.nbytes:
            return 0
        within = array.dtype.fields[field][1] if field and array.dtype.fields else 0
        return self._arrays[array.ctypes.data][0] + within

    def block(self) -> bytes:
        """Return the block, zero where addresses are to be."""
        block = bytearray(self.size)
        for at, array in self._arrays.values():
            block[at : at + array.nbytes] = array.tobytes()
        for at, words in self._words:
            block[at : at + len(words)] = words
        for relocation in self.kernels:
            block[relocation.at : relocation.at + 8] = bytes(8)
        return bytes(block)

    def _emit_array(self, array: NDArray[Any]) -> int:
        if not array.flags.c_contiguous:
            raise ValueError("kernels take arrays without gaps")
        if not array.nbytes:
            return 0
        first, last = array.ctypes.data, array.ctypes.data + array.nbytes
        for known, (at, other) in self._arrays.items():
            if known <= first and last <= known + other.nbytes:
                return at + first - known
            if first < known + other.nbytes and known < last:
                raise ValueError("an array shares memory with one that came first, and is no part of it")
        self._arrays[first] = self._grow(array.nbytes), array
        return self._arrays[first][0]

    def _grow(self, count: int) -> int:
        at = self.size
        self.size += -(-count // ALIGNMENT_BYTES) * ALIGNMENT_BYTES
        return at

    def _emit_tuple(self, held: tuple[Any, ...]) -> int:
        """Lay a tuple and all it holds; return where it is."""
        if id(held) not in self._tuples:
            at = self._grow(8 * sum(words_of(field) for field in held))
            self._tuples[id(held)] = at, held
            words: list[bytes] = []
            for field in held:
                here = at + sum(map(len, words))
                words.append(self._emit_field(here, field))
            self._words.append((at, b"".join(words)))
        return self._tuples[id(held)][0]

    def _emit_field(self, at: int, field: Any) -> bytes:
        """Return the words of a field, and note its address."""
        own = unpin(field)
        if isinstance(own, tuple):
            self.relocations.append(Relocation(at, self._emit_tuple(own)))
            return bytes(8)
        if id(own) in self._regions:
            place, extent = self._regions[id(own)]
            self.relocations.append(Relocation(at + 8 * ADDRESS_WORD, place))
            return struct.pack(f"={words_of(own)}q", 0, 0, extent // 8, 8, 0, extent // 8, 8)
        if isinstance(own, np.ndarray):
            self.relocations.append(Relocation(at + 8 * ADDRESS_WORD, self._emit_array(own)))
            return struct.pack(f"={words_of(own)}q", 0, 0, own.size, own.itemsize, 0, *own.shape, *own.strides)
        return struct.pack("=q", own or 0)


def words_of(field: Any) -> int:
    """Return how many words a field of a tuple takes."""
    return ADDRESS_WORD + 1 + 2 * field.ndim if isinstance(field, np.ndarray) else 1

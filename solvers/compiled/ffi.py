"""C functions of a shared library: called from Python, from kernels, and kernels that they call back.

Return value and arguments of a function are given by letters: a pointer ``p``, a whole number ``i`` (C's int), a real
number ``d``; the return value is first, such as ``"i pd"``.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

from llvmlite import binding
from numba import types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from .kernel import callback

C_TYPES = {"p": ctypes.c_void_p, "i": ctypes.c_int, "d": ctypes.c_double}
KERNEL_TYPES: dict[str, Any] = {"p": types.int64, "i": types.int32, "d": types.float64}


class Library:
    """Functions of a library that is loaded already, or of one it is linked to.

    Parameters
    ----------
    path
        Of the library.
    functions
        By name, in letters.
    symbols
        Names that kernels call by :func:`external_function`.

    Attributes
    ----------
    complete
        Whether they are all there.
    """

    def __init__(self, path: str, functions: Mapping[str, str], symbols: tuple[str, ...] = ()) -> None:
        library = ctypes.PyDLL(path)
        self._letters, self._functions = functions, {}
        for name, letters in functions.items():
            function = getattr(library, name, None)
            if function is not None:
                function.restype, *function.argtypes = (C_TYPES[letter] for letter in letters.replace(" ", ""))
                self._functions[name] = function
        self.complete = len(self._functions) == len(functions)
        for name in symbols:
            if name in self._functions:
                binding.add_symbol(name, self.address(name))

    def address(self, name: str) -> int:
        """Return where a function is."""
        return int(ctypes.cast(self._functions[name], ctypes.c_void_p).value or 0)

    def call(self, name: str, *arguments: Any) -> Any:
        """Call a function; raise MemoryError where it should return a pointer and has none."""
        result = self._functions[name](*arguments)
        if self._letters[name].startswith("p") and not result:
            raise MemoryError(f"{name} returned nothing")
        return result

    def value(self, name: str) -> ForeignFunction:
        """Return a function as it is handed to kernels."""
        return ForeignFunction(self.address(name), self._letters[name])


class ForeignFunction(types.WrapperAddressProtocol):
    """A C function that kernels are given as an argument; pointers are whole numbers to them."""

    def __init__(self, address: int, letters: str) -> None:
        result, *arguments = (KERNEL_TYPES[letter] for letter in letters.replace(" ", ""))
        self._address, self._signature = address, result(*arguments)

    def __wrapper_address__(self) -> int:
        """Return where it is."""
        return self._address

    def signature(self) -> Any:
        """Return its signature."""
        return self._signature


def external_function(name: str) -> Any:
    """Return what kernels call for a C function that takes one pointer and returns another."""
    return types.ExternalFunction(name, types.voidptr(types.voidptr))


@cache
def compile_c_callback(function: Callable[..., int], letters: str, data: Any) -> Any:
    """Compile a function that C calls: ``*`` is a pinned tuple of the type ``data``; it returns an int."""
    known = {"d": types.float64, "p": types.voidptr, "*": data}
    return callback(types.int32(*(known[letter] for letter in letters)))(function)


def _array_at(_: Any, place: Any, count: Any) -> Any:
    array = types.Array(types.float64, 1, "C")

    def generate(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        made, eight = context.make_array(array)(context, builder), context.get_constant(types.intp, 8)
        data = builder.bitcast(arguments[0], made.data.type)
        populate_array(made, data, [arguments[1]], [eight], eight, None)  # type: ignore[no-untyped-call]
        return made._getvalue()

    return array(types.voidptr, types.int64), generate


array_at: Any = intrinsic(_array_at)  # (pointer, count): real numbers that lie there, (count,)

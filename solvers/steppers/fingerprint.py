"""Fingerprint of a class of a solver from outside the package: a state belongs to the class that has saved it.

Two classes of one name may have other coefficients or steps. A fingerprint contains the full names of a class and of
its bases outside this package, their attributes, the byte code of their methods, and the functions and numbers of their
modules that the methods use. It does not depend on the process, but on the version of Python.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from hashlib import blake2b
from types import CodeType, ModuleType
from typing import Any

import numpy as np

SKIPPED_PACKAGES = ("solvers", "abc", "builtins")  # whose classes are not part of a fingerprint
# what Python adds to a class
ADDED_ATTRIBUTES = {"__dict__", "__doc__", "__firstlineno__", "__module__", "__static_attributes__", "__weakref__"}
ADDRESS = re.compile(r" at 0x[0-9a-fA-F]+")
DIGEST_BYTES = 16


def fingerprint_of_class(cls: type) -> str:
    """Return the fingerprint of a class (32 hexadecimal digits)."""
    digest, seen = blake2b(digest_size=DIGEST_BYTES), set[int]()
    for base in cls.__mro__:
        if base.__module__.partition(".")[0] in SKIPPED_PACKAGES:
            continue
        digest.update(f"{base.__module__}.{base.__qualname__}\n".encode())
        for name in sorted(vars(base).keys() - ADDED_ATTRIBUTES):
            if not name.startswith("_abc_"):
                digest.update(f"{name}\n".encode())
                for part in _parts_of(vars(base)[name], seen):
                    digest.update(part)
    return digest.hexdigest()


def _parts_of(value: Any, seen: set[int]) -> Iterator[bytes]:
    """Yield what distinguishes a value from others; a function that was ``seen`` yields nothing."""
    if isinstance(value, property):
        for function in (value.fget, value.fset):
            yield from _parts_of(function, seen)
        return
    function = getattr(value, "__func__", value)  # of a class method or static method
    function = getattr(function, "py_func", getattr(function, "__wrapped__", function))  # of a kernel, or decorated
    code = getattr(function, "__code__", None)
    if isinstance(code, CodeType):
        if id(function) not in seen:
            seen.add(id(function))
            yield from _parts_of_code(code, function.__globals__, seen)
        return
    if isinstance(value, np.ndarray):
        yield f"{value.dtype}{value.shape}".encode() + value.tobytes()
    elif isinstance(value, list | tuple):
        yield type(value).__name__.encode()
        for item in value:
            yield from _parts_of(item, seen)
    elif isinstance(value, set | frozenset):
        yield repr(sorted(map(repr, value))).encode()  # whose order differs between processes
    elif isinstance(value, dict):
        yield from _parts_of(list(value.items()), seen)
    elif isinstance(value, ModuleType):
        yield value.__name__.encode()
    else:
        yield ADDRESS.sub("", repr(value)).encode()


def _parts_of_code(code: CodeType, known: dict[str, Any], seen: set[int]) -> Iterator[bytes]:
    yield code.co_code
    yield repr((code.co_varnames, code.co_names)).encode()
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _parts_of_code(constant, known, seen)
        else:
            yield from _parts_of(constant, seen)
    for name in code.co_names:
        used = known.get(name)
        if getattr(used, "__module__", known["__name__"]) == known["__name__"] and not isinstance(used, type):
            yield from _parts_of(used, seen)

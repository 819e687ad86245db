"""What makes a kernel callable from Python: made when it is first called so, since nine of ten kernels never are.

The code that reads the arguments from Python objects takes as long to compile as a small kernel. Here it is compiled as
a library that refers to the kernel by its symbol, and stored in a file next to the kernel.
"""

from __future__ import annotations

import zlib
from typing import Any, NamedTuple

from llvmlite import ir
from numba import _dynfunc  # type: ignore[attr-defined]
from numba.core.caching import CacheImpl
from numba.core.callwrapper import PyCallWrapper
from numba.core.registry import cpu_target
from numba.core.serialize import dumps, loads

from .cache import Cache, Locator
from .pipeline import code_of

_PyCallWrapper: Any = PyCallWrapper  # a part of numba without types


class Wrapper(NamedTuple):
    """Code that calls a kernel with Python objects.

    Attributes
    ----------
    signature
        Of the kernel.
    symbol
        Of the kernel, in the process that has compiled it.
    constants
        What it reads from the environment of the kernel: how many were there before, and those that are its own.
    code
        Object file.
    """

    signature: Any
    symbol: str
    constants: tuple[int, tuple[Any, ...]]
    code: bytes

    @property
    def codegen(self) -> Any:
        """The machine that it is for, as numba's cache looks it up."""
        return cpu_target.target_context.codegen()


class WrapperLocator(Locator):
    """The folder of one module, where files of wrappers have other names than those of kernels."""

    def get_disambiguator(self) -> str:
        """Return what distinguishes a wrapper from its kernel, and from those of functions of one name."""
        return super().get_disambiguator() + "p"


class WrapperEntry(CacheImpl):
    """How a wrapper is written: with a checksum."""

    _locator_classes: Any = (WrapperLocator,)

    def reduce(self, wrapper: Any) -> Any:
        """Return what is written."""
        data: bytes = dumps(tuple(wrapper))  # type: ignore[no-untyped-call]
        return zlib.crc32(data), data

    def rebuild(self, _: Any, written: Any) -> Any:
        """Return the wrapper again; None where it is damaged."""
        checksum, data = written
        return Wrapper(*loads(data)) if zlib.crc32(data) == checksum else None

    def check_cachable(self, _: Any) -> bool:
        """Return that it may be stored."""
        return True


class WrapperCache(Cache):
    """A cache of wrappers."""

    _impl_class: Any = WrapperEntry


def make_callable(compiled: Any, stored: Any, releases_gil: bool) -> Any:
    """Return what Python calls to call a compiled kernel; ``stored`` is the cache of the kernel's wrappers."""
    context: Any = cpu_target.target_context
    described, environment = compiled.fndesc, compiled.environment
    wrapper = stored.load_overload(compiled.signature, context)
    if wrapper is not None and _is_valid(wrapper, described.llvm_func_name, environment):
        environment.consts.extend(wrapper.constants[1])
        library = _load(context, described, wrapper.code)
    else:
        before = len(environment.consts)
        library = _compile(context, described, environment, releases_gil)
        constants = before, tuple(environment.consts[before:])
        code = library._get_compiled_object()
        stored.save_overload(compiled.signature, Wrapper(compiled.signature, described.llvm_func_name, constants, code))
    address = context.codegen()._engine._ee.get_function_address(described.llvm_cpython_wrapper_name)
    name, kept_alive = described.qualname.split(".")[-1], (code_of(compiled), library)
    return _dynfunc.make_function(described.lookup_module(), name, "", address, environment, kept_alive)


def _is_valid(wrapper: Wrapper, symbol: str, environment: Any) -> bool:
    """Whether a wrapper from disk is of the kernel as it is here: another process may have compiled it again."""
    return wrapper.symbol == symbol and wrapper.constants[0] == len(environment.consts)


def _compile(context: Any, described: Any, environment: Any, releases_gil: bool) -> Any:
    library = context.codegen().create_library(described.llvm_cpython_wrapper_name)
    library.enable_object_caching()
    module = context.create_module("wrapper")
    kind = context.call_conv.get_function_type(described.restype, described.argtypes)
    kernel = ir.Function(module, kind, described.llvm_func_name)
    _PyCallWrapper(context, module, kernel, described, environment, None, releases_gil).build()
    constants = module.globals[context.get_env_name(described)]
    constants.linkage, constants.initializer = "external", None  # those of the kernel
    library.add_ir_module(module)
    library.finalize()
    return library


def _load(context: Any, described: Any, code: bytes) -> Any:
    library = context.codegen().create_library(described.llvm_cpython_wrapper_name)
    library.enable_object_caching()
    library._set_compiled_object(code)
    library._finalize_final_module()
    return library

"""Symbols by which compiled kernels call each other.

Numba compiles a function together with all that it calls, at every level again: of a chain of calls ten deep the last
is compiled ten times. A :class:`Kernel` is compiled once for a signature and called by the name of a symbol, which is
the same in every process; only what is small goes into its callers as well, where it may be worth more than a call.
What a function on disk calls is written next to it and exists before it is loaded.
"""

from __future__ import annotations

import copy
import importlib
import sys
import zlib
from pathlib import Path
from typing import Any

from llvmlite import binding
from numba.core import sigutils, types
from numba.core.caching import CompileResultCacheImpl, NullCache
from numba.core.ccallback import CFunc
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher
from numba.core.serialize import dumps, loads
from numba.core.typing.templates import make_concrete_template
from numba.core.typing.typeof import typeof_impl

from .cache import Cache, CacheOnDemand, Locator, source_hash
from .code_files import hash_of
from .pipeline import code_of, shortened
from .python_call import WrapperCache, make_callable
from .turns import turns

SYMBOL_PREFIX = "mbfmu_"
MAX_INLINED_LENGTH = 300  # lines of code of LLVM up to which a kernel goes into its callers

_kernels: dict[tuple[str, str], Kernel] = {}  # by module and name
_symbols: dict[str, tuple[tuple[str, str], Any]] = {}  # kernel and argument types of a symbol


def compiled_kernel_of(symbol: str) -> Any:
    """Return the compiled kernel of a symbol."""
    key, arguments = _symbols[symbol]
    return _kernels[key].overloads[arguments]


class CacheEntry(CompileResultCacheImpl):
    """How a compiled function is written: with a checksum, and with what it calls."""

    _locator_classes: Any = (Locator,)

    def reduce(self, compiled: Any) -> Any:
        """Return what is written."""
        code = code_of(compiled)
        code._ensure_finalized()
        functions = code._final_module.functions
        called = [f.name for f in functions if f.is_declaration and f.name.startswith(SYMBOL_PREFIX)]
        data = dumps(super().reduce(compiled._replace(type_annotation="")))  # a text that nothing here prints
        return [(name, *_symbols[name]) for name in called], zlib.crc32(data), data

    def rebuild(self, context: Any, written: Any) -> Any:
        """Return the function again, after what it calls; None where it is damaged."""
        called, checksum, data = written
        for name, (module, function), arguments in called:
            if name not in _symbols:
                importlib.import_module(module)
                _kernels[module, function].compile(arguments)
            if name not in _symbols:
                return None
        return super().rebuild(context, loads(data)) if zlib.crc32(data) == checksum else None


class LinkedCache(Cache):
    """A cache of such entries."""

    _impl_class: Any = CacheEntry


class CallbackLocator(Locator):
    """The folder of one module, where files of callbacks have other names than those of kernels."""

    def get_disambiguator(self) -> str:
        """Return what distinguishes a callback from a kernel of the same function, and functions of one name."""
        return super().get_disambiguator() + "c"


class CallbackEntry(CacheEntry):
    """How a callback is written."""

    _locator_classes: Any = (CallbackLocator,)


class CallbackCache(Cache):
    """A cache of callbacks, whose code contains the function that C calls."""

    _impl_class: Any = CallbackEntry


def kernel_by_name(module: str, name: str) -> Any:
    """Return the kernel that a module has by this name."""
    return getattr(importlib.import_module(module), name)


_Dispatcher: Any = CPUDispatcher  # a part of numba without types


class Inlined(_Dispatcher):  # type: ignore[misc]
    """A function that is compiled into its callers."""

    _wrappers: Any = NullCache()
    _is_called = False  # whether what is compiled next is called from Python

    def __init__(self, function: Any, *options: Any, **named: Any) -> None:
        super().__init__(function, *options, **named)
        self._entries: dict[Any, Any] = {}  # what Python calls, by types of arguments; numba does not keep it alive

    def __reduce__(self) -> Any:
        """Pickle it by its name; numba writes the byte code of the function, and of all that it calls."""
        module, name = self.py_func.__module__, self.py_func.__qualname__
        if getattr(sys.modules.get(module), name, None) is self:
            return kernel_by_name, (module, name)
        return super().__reduce__()

    def enable_caching(self) -> None:
        """Store machine code on disk."""
        self._cache = CacheOnDemand(self.py_func, LinkedCache)
        self._wrappers = CacheOnDemand(self.py_func, WrapperCache)

    def compile(self, signature: Any) -> Any:
        """Compile or load it."""
        is_called, self._is_called = self._is_called, False
        with global_compiler_lock, shortened(), turns():
            entry = super().compile(signature)
        return self.callable_for(signature) if is_called else entry

    def add_overload(self, compiled: Any) -> None:
        """Record what has been compiled; it cannot be called from Python yet."""
        self.overloads[tuple(compiled.signature.args)] = compiled

    def callable_for(self, signature: Any) -> Any:
        """Return what Python calls for arguments of these types, for which it has been compiled."""
        arguments = tuple(sigutils.normalize_signature(signature)[0])
        with global_compiler_lock, shortened(), turns():
            if arguments not in self._entries:
                compiled = self.overloads[arguments]
                entry = make_callable(compiled, self._wrappers, bool(self.targetoptions.get("nogil")))
                self._insert([argument._code for argument in arguments], entry, False)
                self._entries[arguments] = entry
            return self._entries[arguments]

    def _compile_for_args(self, *arguments: Any, **named: Any) -> Any:
        """Compile or load it for a call from Python."""
        with global_compiler_lock:  # else another thread that compiles it would take the flag
            self._is_called = True
            try:
                return super()._compile_for_args(*arguments, **named)
            finally:
                self._is_called = False

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Type a call of these types alone; constants have no literal types, for which all would be compiled again."""
        _, parameters, folded, named = super().get_call_template([types.unliteral(a) for a in args], kws)
        exact = self.overloads[tuple(folded)].signature
        name = self.py_func.__name__
        return make_concrete_template(name, key=name, signatures=[exact]), parameters, folded, named


class Kernel(Inlined):
    """A function that is compiled once for a signature."""

    _is_copied_if_short = True  # into its callers

    def __init__(self, function: Any, *options: Any, **named: Any) -> None:
        super().__init__(function, *options, **named)
        _kernels.setdefault(self._key, self)

    @property
    def _key(self) -> tuple[str, str]:
        return self.py_func.__module__, self.py_func.__qualname__

    def compile(self, signature: Any) -> Any:
        """Compile or load it, and give it a symbol."""
        arguments = tuple(sigutils.normalize_signature(signature)[0])
        with global_compiler_lock:
            known = arguments in self.overloads
            entry = super().compile(signature)
            if not known and "<locals>" not in self.py_func.__qualname__:  # several of that name may be at work
                self._name(arguments)
        return entry

    def _name(self, arguments: Any) -> None:
        compiled: Any = self.overloads[arguments]
        source = self.py_func.__code__.co_filename
        version = source_hash(source) if Path(source).is_file() else ""
        key = hash_of(arguments, self._key, version, str(compiled.signature.return_type))
        name = f"{SYMBOL_PREFIX}{self.py_func.__name__}_{key[:16]}"
        code = code_of(compiled)
        binding.add_symbol(name, code.get_pointer_to_function(compiled.fndesc.llvm_func_name))
        _symbols[name] = self._key, arguments
        if code.length > MAX_INLINED_LENGTH or not self._is_copied_if_short:
            called = copy.copy(compiled.fndesc)
            called.mangled_name = name
            self.targetctx.remove_user_function(compiled.entry_point)
            self.targetctx.insert_user_function(compiled.entry_point, called, [])


class SystemKernel(Kernel):
    """A kernel that solvers receive as a function of a system, and that they always call by its symbol.

    Files of machine code of a solver depend on the names of these kernels, but not on their sources, which the modules
    of the solver do not import. Thus they must not contain copies of them.
    """

    _is_copied_if_short = False


class Callback(CFunc):
    """A kernel of one signature that is handed on by its address."""

    def enable_caching(self) -> None:
        """Store machine code on disk."""
        self._cache = CacheOnDemand(self.__wrapped__, CallbackCache)

    def compile(self) -> None:
        """Compile or load it."""
        with global_compiler_lock, shortened(), turns():
            super().compile()


@typeof_impl.register(Callback)
def type_of_callback(callback: Callback, _: Any) -> Any:
    """Return the type of a callback; numba's own function exists only after numba has compiled something."""
    return types.FunctionType(callback._sig)  # type: ignore[attr-defined]

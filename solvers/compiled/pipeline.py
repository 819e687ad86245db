"""Compilation in less time, with the same result.

Numba optimizes every function three times: alone, with what it calls by cheap passes, and with what it calls by all of
them. The first two are for counts of references, of which kernels have none. Its types are found, its variables
analyzed and its extensions searched more often than kernels need, and Python collects garbage more often than pays.
While a kernel is compiled these steps are left out or shortened; what others compile in the same process is not
affected.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from operator import attrgetter
from types import BuiltinFunctionType, FunctionType
from typing import Any, cast

from llvmlite import binding as llvm
from numba.core import base, imputils, ir, postproc, targetconfig, transforms, types
from numba.core.codegen import JITCodeLibrary
from numba.core.registry import cpu_target
from numba.core.typing import context, templates

# parts of numba without types
_Flags: Any = targetconfig.TargetConfig
_Library: Any = JITCodeLibrary
_Function: Any = types.BaseFunction
_PostProcessor: Any = postproc.PostProcessor
_Instruction: Any = ir.Inst
_LoweringContext: Any = base.BaseContext
_TypingContext: Any = context.BaseContext
_REGISTRIES: tuple[Any, ...] = templates.builtin_registry, imputils.builtin_registry  # of all extensions
_find_lifetimes: Any = postproc.VariableLifetime
_canonicalize: Any = transforms.canonicalize_cfg
_find_call_type: Callable[..., Any] = _Function.get_call_type
_run_postprocessor: Callable[..., None] = _PostProcessor.run
_find_variables: Callable[[Any, Any], list[Any]] = _Instruction._rec_list_vars
_refresh_lowering: Callable[[Any], None] = _LoweringContext.refresh
_refresh_typing: Callable[[Any], None] = _TypingContext.refresh

code_of = attrgetter("library")  # of what numba has compiled

OPTIMIZATION_LEVEL = 3  # of LLVM
GARBAGE_COLLECTION_THRESHOLDS = 500_000, 10, 10  # with Python's, collections take a tenth of the time of compilation
NOT_VARIABLES = frozenset({str, int, float, bool, type(None), ir.Loc, FunctionType, BuiltinFunctionType})
NUMBERS = types.Float, types.Integer, types.Boolean, types.Complex

_call_types: dict[tuple[Any, ...], Any] = {}  # of operators and functions of numbers
_is_shortened = [False]  # whether numba is replaced in part now
_registered: dict[Any, list[int]] = {}  # number of registered extensions at the last refresh of a context


class KernelLibrary(_Library):  # type: ignore[misc]
    """Machine code of a kernel and of what is inlined into it."""

    _shared_module: Any
    _loaded: tuple[bytes, int] | None = None  # bitcode and length of a module that has been loaded

    @property
    def bitcode(self) -> bytes:
        """The module as others link it."""
        return self._loaded[0] if self._loaded else bytes(self._get_module_for_linking().as_bitcode())

    @property
    def length(self) -> int:
        """Number of lines of the module, which is the same in every process; names and bitcode are not."""
        return self._loaded[1] if self._loaded else str(self._get_module_for_linking()).count("\n")

    def get_pointer_to_function(self, name: str) -> int:
        """Return the address of a function, whose module need not be parsed for it."""
        self._ensure_finalized()
        return int(self._codegen._engine.get_function_address(name))

    def serialize_using_object_code(self) -> tuple[str, bytes, bytes, int]:
        """Return name and contents for a file."""
        self._ensure_finalized()
        return self.name, self._get_compiled_object(), self.bitcode, self.length

    @classmethod
    def _unserialize(cls, codegen: Any, state: tuple[str, bytes, bytes, int]) -> KernelLibrary:
        name, code, bitcode, length = state
        library: Any = codegen.create_library(name)
        library.enable_object_caching()
        library._set_compiled_object(code)
        library._loaded = bitcode, length
        library._finalize_final_module()
        return cast(KernelLibrary, library)

    def _get_module_for_linking(self) -> Any:
        """Return the module for others to link; one that has been loaded is parsed here, since few are linked."""
        if self._shared_module is None and self._loaded:
            self._shared_module = llvm.parse_bitcode(self._loaded[0])
        return super()._get_module_for_linking()

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        builder = llvm.create_pass_builder(_oldest_machine(), llvm.create_pipeline_tuning_options(OPTIMIZATION_LEVEL))
        builder.getModulePassManager().run(self._final_module, builder)


@cache
def _oldest_machine() -> Any:
    """Return the oldest processor of this architecture, for which all code is optimized; it is emitted for this one."""
    target = llvm.Target.from_triple(llvm.get_process_triple())
    return target.create_target_machine(cpu="generic", features="", opt=OPTIMIZATION_LEVEL)


@contextmanager
def shortened() -> Iterator[None]:
    """Shorten what is compiled in this block, in which the lock of the compiler is held.

    A finalizer may compile a kernel while this block begins or ends: it counts as shortened only if all is replaced.
    """
    if _is_shortened[0]:
        yield
        return
    with ExitStack() as stack:
        stack.callback(gc.set_threshold, *gc.get_threshold())
        gc.set_threshold(*GARBAGE_COLLECTION_THRESHOLDS)
        for place, name, value in _replacements():
            stack.callback(setattr, place, name, vars(place)[name])
            setattr(place, name, value)
        stack.callback(_is_shortened.__setitem__, 0, False)
        _is_shortened[0] = True
        yield


@cache
def _replacements() -> tuple[tuple[Any, str, Any], ...]:
    """Return what is replaced in numba: place, name and value."""
    return (
        (type(cpu_target.target_context.codegen()), "_library_class", KernelLibrary),
        (_Flags, "__eq__", _are_flags_equal),
        (_Flags, "__hash__", _hash_flags),
        (_Function, "get_call_type", _get_call_type),
        (_PostProcessor, "run", _process),
        (_Instruction, "_rec_list_vars", _list_variables),
        (_LoweringContext, "refresh", _refresh_lowering_context),
        (_TypingContext, "refresh", _refresh_typing_context),
    )


def _are_flags_equal(own: Any, other: Any) -> Any:
    """Compare flags of a compilation by those that are set; numba goes through all of them."""
    if not isinstance(other, _Flags):
        return NotImplemented
    return own._values == other._values or _changed_flags(own) == _changed_flags(other)


def _changed_flags(flags: Any) -> dict[str, Any]:
    """Return the flags that differ from their defaults."""
    options = flags.options
    return {name: value for name, value in flags._values.items() if value != options[name].default}


def _hash_flags(own: Any) -> int:
    """Return numba's hash, which is one for all flags of a kind."""
    kind: Any = type(own)
    return _hash_kind(kind)


@cache
def _hash_kind(kind: Any) -> int:
    return hash(tuple(sorted(kind.options)))


def _get_call_type(function: Any, context: Any, arguments: Any, named: Any) -> Any:
    """Find the type of an operator or function of numbers once; numba tries dozens of implementations at every call."""
    if named or not all(type(argument) in NUMBERS for argument in arguments):
        return _find_call_type(function, context, arguments, named)
    key = function, *arguments
    if key not in _call_types:
        _call_types[key] = _find_call_type(function, context, arguments, named)
    return _call_types[key]


def _process(own: Any, emit_dels: bool = False, extend_lifetimes: bool = False) -> None:
    """Do not find lifetimes of variables after every pass; only generators and deletions of variables need them."""
    if emit_dels or own.func_ir.is_generator:
        _run_postprocessor(own, emit_dels, extend_lifetimes)
        return
    own.func_ir.blocks = _canonicalize(own.func_ir.blocks)
    own.func_ir.variable_lifetime = _find_lifetimes(own.func_ir.blocks)
    own.func_ir.generator_info = None


def _list_variables(own: Any, operands: Any) -> list[Any]:
    """Return the variables among operands by their exact types; numba asks abstract base classes for each."""
    kind = type(operands)
    if kind is ir.Var:
        return [operands]
    if kind in NOT_VARIABLES:
        return []
    if kind is not dict:
        return _find_variables(own, operands)
    found: list[Any] = []
    for operand in operands.values():
        if type(operand) is ir.Var:
            found.append(operand)
        elif type(operand) not in NOT_VARIABLES:
            found += _find_variables(own, operand)
    return found


def _refresh_lowering_context(own: Any) -> None:
    """Refresh a context if an extension has been registered since; numba goes through all of them at every function."""
    if _has_new_extensions(own):
        _refresh_lowering(own)


def _refresh_typing_context(own: Any) -> None:
    if _has_new_extensions(own):
        _refresh_typing(own)


def _has_new_extensions(context_: Any) -> bool:
    """Whether the number of registered extensions of numba differs from that of the last call."""
    found = [len(entries) for registry in _REGISTRIES for entries in vars(registry).values()]
    if _registered.get(context_) == found:
        return False
    _registered[context_] = found
    return True

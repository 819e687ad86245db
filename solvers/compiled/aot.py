"""Kernels as machine code that needs no Python, for this machine or another: one closed module.

Numba's own functions can be called from C, ``int32 f(result *, void **, arguments ...)``; what it wraps around them for
Python is left out, and so is what no entry point reaches. Kernels are linked as they were compiled, so that the module
does what they do in Python, bit for bit, where it was compiled for the same processor and the same C library serves
``sin`` and its like. For other processors compile in a separate process with ``NUMBA_CPU_NAME=generic``, and without
a cache of its results (``NUMBA_CACHE_DIR`` at an empty folder): types of entry points are those of one process.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

from llvmlite import binding as llvm
from numba import _dynfunc  # type: ignore[attr-defined]
from numba.core.registry import cpu_target

from .cache import Cache
from .pipeline import KernelLibrary, code_of, shorten_all
from .symbols import SYMBOL_PREFIX, compiled_kernel_of

OPTIMIZATION_LEVEL = 3  # level of optimization of what is emitted

Module = Any  # of llvmlite


class CodeLibrary(KernelLibrary):
    """LLVM code of a function that this process does not execute."""

    def _finalize_specific(self) -> None:
        """Make no machine code."""

    def get_pointer_to_function(self, _: str) -> int:
        """Return that there is no machine code."""
        return 0


def compile_only(report: Callable[[], None]) -> None:
    """Let kernels be compiled to LLVM code from now on, which this process cannot execute; it has no way back.

    Machine code for this process, what wraps functions for Python, and the cache take half of the time of numba.
    ``report`` is called for every function that has been compiled.
    """

    def get_executable(library: Any, described: Any, environment: Any) -> Any:
        library._ensure_finalized()  # optimizes the code
        report()
        return _dynfunc.make_function(described.lookup_module(), described.qualname, "", 1, environment, (library,))

    context = cpu_target.target_context
    context.codegen()._library_class = CodeLibrary
    context.codegen()._add_module = lambda _: None
    context.create_cpython_wrapper = lambda *_, **__: None
    context.get_executable = get_executable
    Cache.is_enabled = False
    shorten_all()


def link_module(
    entries: Mapping[str, tuple[Any, Any]],
    tables: Mapping[str, Iterable[str]],
    elsewhere: Collection[str] = (),
    *,
    exports_kernels: bool = False,
) -> Module:
    """Return a module of kernels and all they call.

    Parameters
    ----------
    entries
        Kernel and types of arguments of every entry point, by its symbol.
    tables
        Symbols of entry points by the symbol of an array of their addresses.
    elsewhere
        Symbols of kernels that another module exports, which are called there.
    exports_kernels
        Whether other modules of the same library call the kernels of this one, see :func:`kernel_symbols`.
    """
    whole = _tables(tables)
    wanted, done = {name: kernel.overloads[arguments] for name, (kernel, arguments) in entries.items()}, set()
    while wanted:
        symbol, compiled = wanted.popitem()
        done.add(symbol)
        part = llvm.parse_bitcode(code_of(compiled)._get_module_for_linking().as_bitcode())
        own = part.get_function(compiled.fndesc.llvm_func_name)
        own.name, own.linkage = symbol, "external"  # what nothing calls yet would not be linked in
        for function in part.functions:
            name = function.name
            is_known = any(name in symbols for symbols in (done, wanted, elsewhere))
            if function.is_declaration and name.startswith(SYMBOL_PREFIX) and not is_known:
                wanted[name] = compiled_kernel_of(name)
        whole.link_in(part)
    kept = {*entries, *tables}
    known = [s for symbols in (whole.functions, whole.global_variables) for s in symbols if not s.is_declaration]
    for number, symbol in enumerate(known):
        if exports_kernels and symbol.name.startswith(SYMBOL_PREFIX):
            symbol.linkage, symbol.visibility = "external", "hidden"
        elif symbol.name in kept:
            symbol.linkage = "external"
        else:
            symbol.linkage = "internal"
            symbol.name = f"inside_{number}"  # numba's names contain addresses of this process
    whole.verify()
    return whole


def kernel_symbols(module: Module) -> set[str]:
    """Return the symbols of the kernels that a module contains and exports."""
    return {f.name for f in module.functions if not f.is_declaration and f.name.startswith(SYMBOL_PREFIX)}


def _tables(tables: Mapping[str, Iterable[str]]) -> Module:
    """Return a module of arrays of addresses."""
    lines = []
    for name, symbols in tables.items():
        known = list(symbols)
        lines += [f"declare void @{symbol}()" for symbol in known]
        places = ", ".join(f"ptr @{symbol}" for symbol in known)
        lines.append(f"@{name} = constant [{len(known)} x ptr] [{places}]")
    return llvm.parse_assembly("\n".join(lines))


def emit_object(module: Module, triple: str, cpu: str) -> bytes:
    """Return an object file of a module for a machine, in LLVM's words."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine = llvm.Target.from_triple(triple).create_target_machine(
        cpu=cpu, features="", opt=OPTIMIZATION_LEVEL, reloc="pic", codemodel="default"
    )
    own = llvm.parse_bitcode(module.as_bitcode())
    own.triple, own.data_layout = machine.triple, str(machine.target_data)
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.run(own, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=0)))
    own.verify()
    return bytes(machine.emit_object(own))

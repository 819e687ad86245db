"""Kernels as machine code that needs no Python, for this machine or another: one closed module.

Numba's own functions can be called from C, ``int32 f(result *, void **, arguments ...)``; what it wraps around them for
Python is left out, and so is what no entry point reaches. Kernels are linked as they were compiled, so that the module
does what they do in Python, bit for bit, where the same C library serves ``sin`` and its like: they are optimized for
every processor of an architecture (:mod:`.pipeline`), and machine code is made of that for each target.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

from llvmlite import binding as llvm

from .pipeline import OPTIMIZATION_LEVEL, code_of
from .symbols import SYMBOL_PREFIX, compiled_kernel_of

Module = Any  # of llvmlite


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
        part = llvm.parse_bitcode(code_of(compiled).bitcode)
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

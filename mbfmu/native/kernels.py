"""``python -m mbfmu.native.kernels FOLDER TARGETS PART ...``: kernels of the runtime as object files.

A part is a family, or the kernels of all element types. Each part has one or several object files for each target. The
module runs in a separate process, see :mod:`.runtime`: everything is recompiled for another processor, and this process
cannot execute it. Child processes share the work if there is more than one processor. The files do not depend on it.
"""

from __future__ import annotations

import gc
import os
import sys
import traceback
from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from mbfmu.mechanics.arrays.tables import types_of
from solvers.compiled.aot import compile_only, emit_object, kernel_symbols, link_module
from solvers.compiled.indirect_call import record_type
from solvers.compiled.kernel import jit_uncached, types
from solvers.compiled.tuple_pointer import pointer_type

from .entries import entries, example
from .families import FAMILIES
from .kernel_table import DERIVATIVE_TABLE_SYMBOL, KERNEL_TABLE_SYMBOL, shipped_kernels
from .sundials import CALLBACK_TYPES, SUNDIALS_FAMILIES, callback_symbol
from .targets import TARGETS

ELEMENTS = "elements"  # the part that all families call by addresses
# Its files: tables of kernels for a real state, and for a complex one, by which derivatives are taken
TABLES = {"elements": (KERNEL_TABLE_SYMBOL, float), "derivatives": (DERIVATIVE_TABLE_SYMBOL, complex)}
# Entry points of a family by the object file that they are in. Those of the first file contain most of what the others
# call, which is not compiled twice then; the last file has the entry points that are not listed.
FILES = {"equations": ("assemble", "exchange_evaluate"), "begin": ("begin",), "steps": ()}
PROGRESS = b"."  # on standard output, for every function that has been compiled

Compiled = dict[str, tuple[Any, Any]]  # kernel and types of arguments, by symbol


def object_names(part: str, target: str) -> list[str]:
    """Return the names of the object files of a part for a target."""
    files = TABLES if part == ELEMENTS else (f"{part}-{file}" for file in FILES)
    return [f"{target}-{file}.o" for file in files]


class Workers:
    """Child processes that compile, one for each processor but that of this process."""

    def __init__(self) -> None:
        self._children: set[int] = set()

    def run(self, work: Callable[[], None]) -> None:
        """Run work in a child process if a processor is free, else now."""
        for child in list(self._children):
            self._wait(child, os.WNOHANG)
        if not hasattr(os, "fork") or len(self._children) + 1 >= (os.cpu_count() or 1):
            work()
            return
        child = os.fork()
        if child:
            self._children.add(child)
            return
        code = 1
        try:
            work()
            code = 0
        except BaseException:  # reported by the exit code
            traceback.print_exc()
        finally:
            os._exit(code)

    def finish(self) -> None:
        """Wait for all children."""
        for child in list(self._children):
            self._wait(child, 0)

    def _wait(self, child: int, options: int) -> None:
        ended, status = os.waitpid(child, options)
        if ended:
            self._children.discard(child)
            if status:
                sys.exit(1)  # the child has printed why


class Builder:
    """What writes object files for some targets."""

    def __init__(self, folder: Path, targets: Collection[str]) -> None:
        self._folder, self._targets = folder, targets

    def write(self, module: Any, name: str) -> None:
        """Write a module as ``TARGET-name.o`` for every target."""
        for target in self._targets:
            own = TARGETS[target]
            (self._folder / f"{target}-{name}.o").write_bytes(emit_object(module, own.triple, own.processor))

    def write_elements(self, name: str) -> None:
        """Write the kernels of all element types for a real or a complex state, with a table of their addresses."""
        (table, state), found = TABLES[name], Compiled()
        for i, kind in enumerate(shipped_kernels(state)):
            words, returned = types_of(kind)
            arguments = record_type(kind.record), *words
            kind.function.compile(returned(*arguments))
            found[f"{table}_{i}"] = kind.function, arguments
        self.write(link_module(found, {table: list(found)}), name)

    def write_family(self, family: str, instance: Any, workers: Workers) -> None:
        """Write the files of a family; ``instance`` is the type of its instances."""
        known = {f"mb_{family}_{name}": (entry.function, entry.more) for name, entry in entries(family).items()}
        if family in SUNDIALS_FAMILIES:
            callbacks = zip(SUNDIALS_FAMILIES[family], CALLBACK_TYPES.items(), strict=True)
            known |= {callback_symbol(family, name): (function, more) for function, (name, more) in callbacks}
        first, begin, _ = ([f"mb_{family}_{name}" for name in names] for names in FILES.values())
        shared = link_module(_compile(known, first, instance), {}, exports_kernels=True)
        rest = [symbol for symbol in known if symbol not in (*first, *begin)]
        for name, symbols in (("begin", begin), ("steps", rest)):
            work = partial(self._write_calling, shared, known, symbols, instance, f"{family}-{name}")
            workers.run(work)
        self.write(shared, f"{family}-equations")

    def _write_calling(
        self, shared: Any, known: Mapping[str, tuple[Any, Any]], symbols: Collection[str], instance: Any, name: str
    ) -> None:
        """Write entry points that call kernels of another module."""
        found = _compile(known, symbols, instance)
        self.write(link_module(found, {}, kernel_symbols(shared)), name)


def _compile(known: Mapping[str, tuple[Any, Any]], symbols: Collection[str], instance: Any) -> Compiled:
    """Compile entry points, which are given by functions and types of their arguments after the instance."""
    found = {}
    for symbol in symbols:
        function, more = known[symbol]
        kernel, arguments = jit_uncached(function), (instance, *more)
        kernel.compile(types.int64(*arguments))
        found[symbol] = kernel, arguments
    return found


def report_function() -> None:
    """Print that a function has been compiled."""
    os.write(sys.stdout.fileno(), PROGRESS)


def main(folder: Path, targets: Collection[str], parts: Collection[str]) -> None:
    """Write the object files."""
    instances = {name: pointer_type(example(name)) for name in FAMILIES if name in parts}  # kernels make examples
    gc.set_threshold(200_000, 20, 20)  # a tenth of the time
    compile_only(report_function)
    workers, builder = Workers(), Builder(folder, targets)
    for name in TABLES if ELEMENTS in parts else ():
        workers.run(partial(builder.write_elements, name))
    for family, instance in instances.items():
        builder.write_family(family, instance, workers)
    workers.finish()


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2].split(","), sys.argv[3:])

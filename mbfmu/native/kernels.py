"""``python -m mbfmu.native.kernels FOLDER TARGETS OBJECT ...``: kernels of the runtime as object files.

The object files are those of :mod:`.contents`. The module runs in a separate process, see :mod:`.runtime`: a caller may
have no compiler. Kernels that have been compiled for Python are taken from the cache, and those that are compiled here
are stored there. Child processes share the work if there is more than one processor. The files do not depend on it.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from mbfmu.mechanics.arrays.tables import types_of
from solvers.compiled.aot import emit_object, kernel_symbols, link_module
from solvers.compiled.cache import when_compiled
from solvers.compiled.indirect_call import record_type
from solvers.compiled.kernel import jit_uncached, types
from solvers.compiled.tuple_pointer import pointer_type

from .contents import ENTRY_PARTS, EQUATIONS, STEPS, entry_part
from .entries import entries, example
from .families import FAMILIES
from .kernel_table import KernelTable, kernel_tables
from .sundials import CALLBACK_TYPES, SUNDIALS_FAMILIES, callback_symbol
from .targets import TARGETS

PROGRESS = b"."  # on standard output, for every function that has been compiled

Compiled = dict[str, tuple[Any, Any]]  # kernel and types of arguments, by symbol


class Workers:
    """Child processes that compile, one for each processor: this process has less to do than they have."""

    def __init__(self) -> None:
        self._children: set[int] = set()

    def run(self, work: Callable[[], None]) -> None:
        """Run work in a child process unless there are as many of them as processors, else now."""
        for child in list(self._children):
            self._wait(child, os.WNOHANG)
        if not hasattr(os, "fork") or len(self._children) >= (os.cpu_count() or 1):
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

    def write_table(self, name: str, table: KernelTable) -> None:
        """Write kernels of element types, with a table of their addresses."""
        found = Compiled()
        for i, kind in enumerate(table.kernels):
            words, returned = types_of(kind)
            arguments = record_type(kind.record), *words
            kind.function.compile(returned(*arguments))
            found[f"{table.symbol}_{i}"] = kind.function, arguments
        self.write(link_module(found, {table.symbol: list(found)}), name)

    def write_family(self, family: str, names: Collection[str], instance: Any, workers: Workers) -> None:
        """Write files of a family by their names; ``instance`` is the type of its instances."""
        parts: dict[str, dict[str, tuple[Any, Any]]] = {part: {} for part in ENTRY_PARTS}
        for name, entry in entries(family).items():
            parts[entry_part(name)][f"mb_{family}_{name}"] = entry.function, entry.more
        if family in SUNDIALS_FAMILIES:
            callbacks = zip(SUNDIALS_FAMILIES[family], CALLBACK_TYPES.items(), strict=True)
            parts[STEPS] |= {callback_symbol(family, name): (function, more) for function, (name, more) in callbacks}
        file, equations = f"{family}-{EQUATIONS}", parts.pop(EQUATIONS)
        shared = link_module(_compile(equations, instance), {}, exports_kernels=True)
        elsewhere = kernel_symbols(shared)
        for part, known in parts.items():
            if f"{family}-{part}" in names:
                workers.run(partial(self._write_calling, elsewhere, known, instance, f"{family}-{part}"))
        if file in names:
            self.write(shared, file)

    def _write_calling(
        self, elsewhere: Collection[str], known: Mapping[str, tuple[Any, Any]], instance: Any, name: str
    ) -> None:
        """Write entry points that call kernels of another module."""
        found = _compile(known, instance)
        self.write(link_module(found, {}, elsewhere), name)


def _compile(known: Mapping[str, tuple[Any, Any]], instance: Any) -> Compiled:
    """Compile entry points, which are given by functions and types of their arguments after the instance."""
    found = {}
    for symbol, (function, more) in known.items():
        kernel, arguments = jit_uncached(function), (instance, *more)
        kernel.compile(types.int64(*arguments))
        found[symbol] = kernel, arguments
    return found


def report_function() -> None:
    """Print that a function has been compiled."""
    os.write(sys.stdout.fileno(), PROGRESS)


def main(folder: Path, targets: Collection[str], names: Collection[str]) -> None:
    """Write the object files."""
    families = [family for family in FAMILIES if any(f"{family}-{part}" in names for part in ENTRY_PARTS)]
    instances = {family: pointer_type(example(family)) for family in families}  # kernels make examples
    workers, builder = Workers(), Builder(folder, targets)
    with when_compiled(report_function):
        for name, table in kernel_tables().items():
            if name in names:
                workers.run(partial(builder.write_table, name, table))
        for family, instance in instances.items():
            builder.write_family(family, names, instance, workers)
        workers.finish()


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2].split(","), sys.argv[3:])

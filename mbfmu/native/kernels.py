"""``python -m mbfmu.native.kernels FOLDER TARGET ...``: the runtime's kernels as object files, one for each target.

It runs in a separate process, see :mod:`.runtime`: everything is recompiled for another processor.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from mbfmu.mechanics.arrays.tables import types_of
from solvers.compiled.aot import emit_object, link_module
from solvers.compiled.indirect_call import record_type
from solvers.compiled.kernel import jit_uncached, types
from solvers.compiled.tuple_pointer import pointer_type

from .element_kernels import shipped_kernels
from .entries import KERNEL_TABLE_SYMBOL, entries, example
from .families import FAMILIES
from .sundials import CALLBACK_TYPES, SUNDIALS_FAMILIES, callback_symbol
from .targets import TARGETS


def compiled() -> tuple[dict[str, tuple[Any, Any]], list[str]]:
    """Return kernel and argument types of every entry point by its symbol, and the symbols of the kinds in order."""
    found: dict[str, tuple[Any, Any]] = {}
    for family in FAMILIES:
        instance = pointer_type(example(family))
        for name, entry in entries(family).items():
            kernel: Any = jit_uncached(entry.function)
            arguments = instance, *entry.more
            kernel.compile(types.int64(*arguments))
            found[f"mb_{family}_{name}"] = kernel, arguments
        for function, (name, more) in zip(SUNDIALS_FAMILIES.get(family, ()), CALLBACK_TYPES.items(), strict=False):
            kernel, arguments = jit_uncached(function), (instance, *more)
            kernel.compile(types.int64(*arguments))
            found[callback_symbol(family, name)] = kernel, arguments
    numbered = []
    for i, kind in enumerate(shipped_kernels()):
        words, returned = types_of(kind)
        arguments = record_type(kind.record), *words
        kind.function.compile(returned(*arguments))
        numbered.append(f"mb_kind_{i}")
        found[numbered[-1]] = kind.function, arguments
    return found, numbered


def main(folder: Path, targets: list[str]) -> None:
    """Write the object files."""
    found, numbered = compiled()
    module = link_module(found, {KERNEL_TABLE_SYMBOL: numbered})
    for name in targets:
        target = TARGETS[name]
        (folder / f"{name}.o").write_bytes(emit_object(module, target.triple, target.processor))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])

"""``python -m mbfmu.native.user_kernels SCENE FOLDER TARGET FAMILY DERIVATIVES``: the user-defined kernels of a model
as an object file; DERIVATIVES is 1 if it contains those for derivatives.

Kernels of user-defined elements, and functions of time and laws of forces that a model defines in Python, are not in
the runtime, which is the same for all models. They are compiled into a library of the FMU, which the runtime loads
from the folder in which it lies. As the kernels of the runtime they are compiled in a separate process (see
:mod:`.kernels`), which builds the model again and finds the same kernels in the same order.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from mbfmu.mechanics.arrays.compile import CompiledElements
from mbfmu.mechanics.arrays.numbering import Numbering
from mbfmu.mechanics.arrays.tables import CalledKernel, types_of
from mbfmu.modeling.registry import reference_of
from mbfmu.modeling.replaced_inputs import given_for
from mbfmu.modeling.scene import Scene, as_toml, read_scene
from mbfmu.util.errors import UserError
from mbfmu.util.processes import run_program
from solvers.compiled.aot import emit_object, link_module
from solvers.compiled.fingerprint import fingerprint_of_function
from solvers.compiled.indirect_call import record_type

from .entries import called_in_fmu
from .kernel_table import USER_LIBRARY, USER_TABLE_SYMBOL, user_kernels
from .runtime import compiler, link_arguments
from .targets import TARGETS

EXPORTED_TABLE = f"{{ global: {USER_TABLE_SYMBOL}; local: *; }};"  # for linkers of Linux
MAX_ERROR_LINES = 3  # of a linker


def fingerprints(called: Iterable[CalledKernel | None]) -> list[str]:
    """Return the fingerprints of the user-defined kernels of a mechanism: their code and the values they capture."""
    return [fingerprint_of_function(own.function) for own in user_kernels(called)]


def user_library(scene: Scene, target: str, family: str, differentiates: bool) -> bytes:
    """Return the library of the user-defined kernels that a family calls for a scene's model, for a target; with those
    of a complex state if the FMU ``differentiates``.

    Raises
    ------
    UserError
        The model is not in a file, or a kernel cannot be compiled without Python.
    """
    reference = scene.reference or reference_of(type(scene.model))
    if not reference:
        raise UserError(
            f"model {scene.model.name!r} has user-defined kernels, which a separate process compiles for a native FMU; "
            "put its class at the top level of a file that is imported and not run, or export it with --python",
            "not-native",
        )
    with tempfile.TemporaryDirectory(prefix="mbfmu_") as work:
        file = Path(work) / "scene.toml"
        file.write_text(as_toml(replace(scene, reference=reference)), encoding="utf-8")
        own = {
            "NUMBA_DISABLE_JIT": "0",
            "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
        }
        command = [sys.executable, "-P", "-m", "mbfmu.native.user_kernels", str(file), work, target, family]
        command.append(str(int(differentiates)))
        code, errors = run_program(command, own)
        if code:
            raise UserError(f"the user-defined kernels of model {scene.model.name!r}: {_last(errors)}", "not-native")
        made = Path(work) / f"{USER_LIBRARY}{TARGETS[target].suffix}"
        command = [
            *compiler(target),
            f"{work}/{target}.o",
            *link_arguments(target, Path(work), EXPORTED_TABLE),
            "-o",
            str(made),
            "-lm",
        ]
        code, errors = run_program(command)
        if code:
            raise UserError(
                f"the user-defined kernels of model {scene.model.name!r} cannot be linked without Python: "
                f"{_last(errors)}; export the model with --python",
                "not-native",
            )
        return made.read_bytes()


def _last(lines: list[str]) -> str:
    return "; ".join(lines[-MAX_ERROR_LINES:])


def kernels_of(scene: Scene, family: str, differentiates: bool) -> tuple[CalledKernel, ...]:
    """Return the user-defined kernels that a family calls for a scene's model; its elements are laid out, nothing else
    is compiled.
    """
    mechanism: Any = scene.model.build()
    elements = CompiledElements(mechanism, Numbering(mechanism, given_for(scene.model.replaced_inputs)))
    return user_kernels(called_in_fmu(elements, family, differentiates))


def main(scene_file: str, folder: str, name: str, family: str, differentiates: bool) -> int:
    """Write the object file; return the exit code: 2 if a kernel cannot be compiled."""
    try:
        found, numbered = {}, []
        for i, called in enumerate(kernels_of(read_scene(Path(scene_file)), family, differentiates)):
            words, returned = types_of(called)
            arguments = record_type(called.record), *words
            called.function.compile(returned(*arguments))
            numbered.append(f"mb_user_kernel_{i}")
            found[numbered[-1]] = called.function, arguments
        module = link_module(found, {USER_TABLE_SYMBOL: numbered})
        target = TARGETS[name]
        (Path(folder) / f"{name}.o").write_bytes(emit_object(module, target.triple, target.processor))
    except UserError as error:
        print(error, file=sys.stderr)  # noqa: T201
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2], sys.argv[3], sys.argv[4], sys.argv[5] == "1"))

"""The front of FMUs that call Python: a library that loads PythonFMU's after it has examined what that one requires.

It is the same for all models, and is compiled by the first export. Its sources are in the folder ``c``.
"""

from __future__ import annotations

import tempfile
from hashlib import sha256
from pathlib import Path

import fmpy

import mbfmu.native
from mbfmu.native.runtime import (
    COMPILER_FLAGS,
    EXPORTED_SYMBOLS,
    compiler,
    install_atomically,
    is_intact,
    link_arguments,
)
from mbfmu.util.errors import UserError
from mbfmu.util.processes import run_program
from solvers.compiled.cache import shared_cache_dir

from .guards import WRAPPER

PLATFORM = "x86_64-linux"  # for which PythonFMU has a library, and mbfmu is supported
OWN_FOLDER = Path(__file__).parent / "c"
NATIVE_FOLDER = Path(mbfmu.native.__file__).parent / "c"
SOURCES = (*sorted(OWN_FOLDER.glob("*.c")), NATIVE_FOLDER / "location.c")
HEADERS = (OWN_FOLDER / "front.h", NATIVE_FOLDER / "location.h")


def front_library() -> bytes:
    """Return the library of the front; it is compiled if there is none of these sources.

    Raises
    ------
    UserError
        No installed program compiles C for the platform, or it reports an error.
    """
    digest = sha256(b"".join(path.read_bytes() for path in (*SOURCES, *HEADERS))).hexdigest()[:16]
    path = shared_cache_dir() / f"front-{digest}" / f"{PLATFORM}.so"
    if not is_intact(path):
        command = compiler(PLATFORM)
        with tempfile.TemporaryDirectory(prefix="mbfmu_") as folder:
            made = Path(folder) / path.name
            places = (OWN_FOLDER, NATIVE_FOLDER, Path(fmpy.__file__).parent / "c-code")
            arguments = [*COMPILER_FLAGS, *(f"-I{place}" for place in places), *map(str, SOURCES)]
            linked = link_arguments(PLATFORM, Path(folder), EXPORTED_SYMBOLS)
            code, errors = run_program([*command, *arguments, *linked, "-o", str(made), "-ldl", "-lpthread"])
            if code:
                last = errors[-1] if errors else f"exit code {code}"
                raise UserError(f"the front cannot be compiled: {Path(command[0]).name} reports {last!r}", "no-front")
            install_atomically(made, path)
    return path.read_bytes()


def put_front(content: dict[str, bytes], identifier: str, version: str, guid: str) -> None:
    """Put the front before PythonFMU's library in the files of an FMU, by their names.

    Raises
    ------
    UserError
        There is no front: see :func:`front_library`. The files are as before.
    """
    folder = "binaries/linux64"
    front = front_library()
    content[f"{folder}/{WRAPPER}"] = content.pop(f"{folder}/{identifier}.so")
    content[f"{folder}/{identifier}.so"] = front
    content["resources/mbfmu.txt"] = f"{version}\n{guid}\n".encode()
    content |= {f"documentation/source/{path.name}": path.read_bytes() for path in (*SOURCES, *HEADERS)}

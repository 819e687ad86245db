"""The runtime: kernels as machine code, built once for these sources and a machine, kept beside what Python compiles.

Kernels are compiled anew in a process of its own, for the oldest processor of a kind and without a cache. Zig links for
every machine; for this one any C compiler does.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import cache
from hashlib import sha256
from pathlib import Path

from mbfmu.errors import UserError
from solvers.compiled.cache import folder

from .targets import TARGETS, host

COMPILERS = ("cc", "gcc", "clang")


@cache
def place() -> Path:
    """Return the folder of what is built of these sources."""
    told = sha256()
    for source in sorted(Path(__file__).parent.glob("*.py")):
        told.update(source.read_bytes())
    return folder() / f"native-{told.hexdigest()[:16]}"


def objects(names: Sequence[str]) -> dict[str, Path]:
    """Return the kernels' object file for each target by its name; those that are not there are built, in minutes.

    Raises
    ------
    UserError
        There is no such target, or it cannot be built.
    """
    for name in names:
        if name not in TARGETS:
            raise UserError(f"target {name!r} is not known; allowed: {', '.join(TARGETS)}")
    found = {name: place() / f"{name}.o" for name in names}
    missing = [name for name, path in found.items() if not path.is_file()]
    if missing:
        with tempfile.TemporaryDirectory(prefix="mbfmu_") as work:
            _run(
                [sys.executable, "-m", "mbfmu.native.kernels", work, *missing],
                {"NUMBA_CPU_NAME": "generic", "NUMBA_CACHE_DIR": f"{work}/cache"},
            )
            for name in missing:
                _keep(Path(work) / found[name].name, found[name])
    return found


def library(name: str) -> Path:
    """Return the runtime of a target as a shared library; see :func:`objects`."""
    path = place() / f"{name}{TARGETS[name].suffix}" if name in TARGETS else Path()
    if not path.is_file():
        code = objects([name])[name]
        with tempfile.TemporaryDirectory(prefix="mbfmu_") as work:
            made = Path(work) / path.name
            _run([*linker(name), "-shared", "-fPIC", str(code), "-o", str(made), "-lm", "-Wl,-Bsymbolic"], {})
            _keep(made, path)
    return path


def linker(name: str) -> list[str]:
    """Return the command that links for a target; UserError where there is none."""
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc", "-target", TARGETS[name].zig]
    own = next(filter(None, map(shutil.which, COMPILERS)), None)
    if own is None or name != host():
        raise UserError(f"nothing here links for {name}: pip install ziglang")
    return [own]


def _run(command: list[str], more: dict[str, str]) -> None:
    done = subprocess.run(command, env={**os.environ, **more}, capture_output=True, text=True, check=False)
    if done.returncode:
        said = done.stderr.strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
        raise UserError(f"the runtime cannot be built: {Path(command[0]).name} says {said[0]!r}")


def _keep(made: Path, path: Path) -> None:
    """Put a file in its place at once: two processes may build it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
        file.write(made.read_bytes())
    Path(file.name).replace(path)

"""The runtime: kernels as machine code and FMI around them, built once for these sources and a machine.

Kernels are recompiled in a separate process, for the oldest processor of an architecture and without a cache. The
result is stored next to the code that Python compiles. Zig compiles C for every machine; for this one any C compiler
does.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from hashlib import sha256
from pathlib import Path

import fmpy

try:
    import fcntl
except ImportError:  # on Windows: two processes may build at once
    fcntl = None  # type: ignore[assignment]

from mbfmu.util.errors import UserError
from mbfmu.util.files import write_bytes
from solvers.compiled.cache import notify_listeners, shared_cache_dir

from .entries import entries
from .families import FAMILIES
from .layout import declarations
from .targets import TARGETS, host

COMPILERS = ("cc", "gcc", "clang")
PACKAGE_DIR = Path(__file__).parent
PACKED_RUNTIMES = PACKAGE_DIR / "runtimes"  # that a wheel brings along
# sources of the machine code, in addition to the kernels of other packages
KERNEL_SOURCES = (
    "element_kernels.py", "entries.py", "families.py", "kernels.py", "model_exchange.py", "start_checks.py",
    "sundials.py", "targets.py",
)  # fmt: skip
COMPILER_FLAGS = ("-std=c2x", "-O2", "-Wall", "-Wextra", "-Werror", "-fvisibility=hidden", "-fPIC")
EXPORTED_SYMBOLS = "{ global: fmi2*; fmi3*; local: *; };"  # for linkers of Linux; runtimes of two FMUs must not meet


@cache
def build_dir(*sources: str) -> Path:
    """Return the folder of what is built of these sources, and of all kernels."""
    digest = sha256()
    for source in sources:
        digest.update((PACKAGE_DIR / source).read_bytes())
    return shared_cache_dir() / f"native-{digest.hexdigest()[:16]}"


def _runtime_sources() -> tuple[str, ...]:
    """Return all sources of a runtime."""
    found = sorted([*PACKAGE_DIR.glob("*.py"), *PACKAGE_DIR.glob("c/*")])
    return tuple(path.relative_to(PACKAGE_DIR).as_posix() for path in found)


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
    found = {name: build_dir(*KERNEL_SOURCES) / f"{name}.o" for name in names}
    if not all(path.is_file() for path in found.values()):
        notify_listeners()
        with build_lock(build_dir(*KERNEL_SOURCES)):
            _build([path for path in found.values() if not path.is_file()])
    return found


def _build(paths: Sequence[Path]) -> None:
    """Compile the kernels for targets by the names of their object files."""
    if not paths:
        return  # another process has
    with tempfile.TemporaryDirectory(prefix="mbfmu_") as work:
        # machine code is made by a compiler, also if this process has none
        own = {"NUMBA_CPU_NAME": "generic", "NUMBA_CACHE_DIR": f"{work}/cache", "NUMBA_DISABLE_JIT": "0"}
        _run([sys.executable, "-m", "mbfmu.native.kernels", work, *(path.stem for path in paths)], own)
        for path in paths:
            install_atomically(Path(work) / path.name, path)


@contextmanager
def build_lock(folder: Path) -> Iterator[None]:
    """Let one process at a time build what goes into a folder: it takes minutes of every processor."""
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / "lock", "w") as lock:  # noqa: PTH123  # it is locked as a file
        if fcntl is not None:
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def library(name: str) -> Path:
    """Return the runtime of a target as a shared library; see :func:`objects`."""
    return cached_library(name) or _linked(name)


def cached_library(name: str) -> Path | None:
    """Return the runtime of a target if it has been built for these sources."""
    built = build_dir(*_runtime_sources())
    paths = (PACKED_RUNTIMES / f"{shared_cache_dir().name}-{built.name}" / _file(name), built / _file(name))
    return next((path for path in paths if path.is_file()), None)


def pack(name: str) -> Path:
    """Put the runtime of a target into the package, and return its place there."""
    path = PACKED_RUNTIMES / f"{shared_cache_dir().name}-{build_dir(*_runtime_sources()).name}" / _file(name)
    if not path.is_file():
        install_atomically(library(name), path)
    return path


def _file(name: str) -> str:
    return f"{name}{TARGETS[name].suffix}"


def compiler_arguments(name: str, work: Path) -> list[str]:
    """Return the arguments of a C compiler for a runtime's sources; generated headers are written to ``work``."""
    code = objects([name])[name]
    (work / "layout.h").write_text(declarations(FAMILIES, entries(next(iter(FAMILIES))).items()))
    include_dirs = (work, PACKAGE_DIR / "c", Path(fmpy.__file__).parent / "c-code")
    sources = sorted(PACKAGE_DIR.glob("c/*.c"))
    return [*COMPILER_FLAGS, *(f"-I{place}" for place in include_dirs), *map(str, (*sources, code))]


def _linked(name: str) -> Path:
    command, path = compiler(name), build_dir(*_runtime_sources()) / _file(name)
    with tempfile.TemporaryDirectory(prefix="mbfmu_") as folder:
        work = Path(folder)
        made = work / path.name
        linked = link_arguments(name, work, EXPORTED_SYMBOLS)
        libraries = ["-lm", *(["-ldl"] if path.suffix == ".so" else [])]  # libdl: up to glibc 2.33
        _run([*command, *compiler_arguments(name, work), *linked, "-o", str(made), *libraries], {})
        install_atomically(made, path)
    return path


def link_arguments(name: str, work: Path, exported: str) -> list[str]:
    """Return the arguments of a C compiler that makes a shared library, which exports some symbols and misses none."""
    if TARGETS[name].suffix != ".so":
        return ["-shared", "-s"]
    (work / "exported").write_text(exported)
    return ["-shared", "-s", f"-Wl,--version-script={work}/exported", "-Wl,-z,defs"]


def compiler(name: str) -> list[str]:
    """Return the command that compiles C for a target; UserError where there is none."""
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc", "-target", TARGETS[name].zig]
    own = next(filter(None, map(shutil.which, COMPILERS)), None)
    if own is None or name != host():
        raise UserError(f"nothing here compiles C for {name}: pip install ziglang")
    return [own]


def _run(command: list[str], more: dict[str, str]) -> None:
    done = subprocess.run(command, env={**os.environ, **more}, capture_output=True, text=True, check=False)
    if done.returncode:
        errors = done.stderr.strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
        raise UserError(f"the runtime cannot be built: {Path(command[0]).name} reports {errors[0]!r}")


def install_atomically(made: Path, path: Path) -> None:
    """Put a file in its place at once: two processes may build it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, made.read_bytes())
    path.chmod(0o644)  # it may go into a package

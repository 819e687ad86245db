"""The runtime: kernels as machine code and FMI around them, built once for these sources and a machine.

A library has one family of solvers (:mod:`.families`) and what its model can call (:mod:`.contents`), so that the first
FMU has to wait for this only. Kernels are recompiled in a separate process, for the oldest processor of an architecture
and without a cache. The result is stored next to the code that Python compiles. Zig compiles C for every machine; for
this one any C compiler does. Where there is none, zig is downloaded for the time of the build.
"""

from __future__ import annotations

import importlib.util
import shutil
import sys
import tempfile
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
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
from mbfmu.util.processes import run_program
from mbfmu.util.progress import announce, report_progress
from solvers.compiled.cache import notify_listeners, shared_cache_dir

from .contents import Contents, complete
from .entries import entries
from .layout import declarations
from .targets import TARGETS, host

COMPILERS = ("cc", "gcc", "clang")
ZIG = "ziglang>=0.13"  # as in pyproject.toml
COMPILER_ADVICE = "Install a C compiler, or run: pip install ziglang"
PACKAGE_DIR = Path(__file__).parent
PACKED_RUNTIMES = PACKAGE_DIR / "runtimes"  # that a wheel brings along
COMPILER_FLAGS = ("-std=c2x", "-O2", "-Wall", "-Wextra", "-Werror", "-fvisibility=hidden", "-fPIC")
FUNCTIONS_OF_OBJECT = 150  # approximate number of functions that are compiled for one, for the bar of progress
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


def objects(names: Collection[str], contents: Collection[Contents]) -> dict[str, list[Path]]:
    """Return the object files of the contents of libraries for each target by its name.

    Those that are not there are built, in about a minute for one library.

    Raises
    ------
    UserError
        There is no such target, or it cannot be built.
    """
    for name in names:
        if name not in TARGETS:
            raise UserError(f"target {name!r} is not known; allowed: {', '.join(TARGETS)}")
    folder, parts = build_dir(), list(dict.fromkeys(own for each in contents for own in each.objects()))
    found = {name: [_object_file(folder, name, part) for part in parts] for name in names}
    if not all(is_intact(path) for paths in found.values() for path in paths):
        notify_listeners()
        with build_lock(folder):
            _build(folder, names, parts)
    return found


def _object_file(folder: Path, name: str, part: str) -> Path:
    return folder / f"{name}-{part}.o"


def _build(folder: Path, names: Collection[str], parts: Collection[str]) -> None:
    """Compile those object files for targets that do not exist."""
    missing = {name: [part for part in parts if not is_intact(_object_file(folder, name, part))] for name in names}
    together = list(dict.fromkeys(part for own in missing.values() for part in own))
    targets = [name for name, own in missing.items() if own]
    if not together:
        return  # another process has
    with tempfile.TemporaryDirectory(prefix="mbfmu_") as work:
        # machine code is made by a compiler, also if this process has none
        command = [sys.executable, "-m", "mbfmu.native.kernels", work, ",".join(targets), *together]
        _run(command, {"NUMBA_DISABLE_JIT": "0"}, FUNCTIONS_OF_OBJECT * len(together))
        for path in sorted(Path(work).glob("*.o")):
            install_atomically(path, folder / path.name)


@contextmanager
def build_lock(folder: Path) -> Iterator[None]:
    """Let one process at a time build what goes into a folder: it takes minutes of every processor."""
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / "lock", "w") as lock:  # noqa: PTH123  # it is locked as a file
        if fcntl is not None:
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def library(name: str, contents: Contents) -> Path:
    """Return the runtime of a target with some contents as a shared library; see :func:`build`."""
    found = cached_library(name, contents)
    if found is None:
        build([name], [contents])
        found = build_dir(*_runtime_sources()) / _file(name, contents)
    return found


def build(names: Collection[str], contents: Collection[Contents]) -> None:
    """Build the runtimes of targets with these contents that do not exist.

    Raises
    ------
    UserError
        There is no such target, or it cannot be built.
    """
    missing = {name: [own for own in contents if cached_library(name, own) is None] for name in names}
    with c_compilers([name for name, own in missing.items() if own]) as commands:
        objects(list(commands), [own for own in contents if any(own in needed for needed in missing.values())])
        for name, command in commands.items():
            for own in missing[name]:
                _link(name, own, command)


def cached_library(name: str, contents: Contents) -> Path | None:
    """Return the runtime of a target with some contents, or a complete one, if it has been built for these sources."""
    whole, built = _file(name, complete(contents.family)), build_dir(*_runtime_sources())
    paths = _packed_dir() / whole, built / _file(name, contents), built / whole
    return next((path for path in paths if is_intact(path)), None)


def cached_libraries(name: str) -> list[Path]:
    """Return all runtimes of a target that have been built for these sources."""
    return [path for folder in (_packed_dir(), build_dir(*_runtime_sources())) for path in folder.glob(f"{name}-*-*")]


def family_of_library(name: str, path: Path) -> str:
    """Return the family of a runtime of a target."""
    return path.name.removeprefix(f"{name}-").partition("-")[0]


def pack(name: str, family: str) -> Path:
    """Put the complete runtime of a target and a family into the package, and return its place there."""
    path = _packed_dir() / _file(name, complete(family))
    if not is_intact(path):
        install_atomically(library(name, complete(family)), path)
    return path


def _packed_dir() -> Path:
    return PACKED_RUNTIMES / f"{shared_cache_dir().name}-{build_dir(*_runtime_sources()).name}"


def _file(name: str, contents: Contents) -> str:
    return f"{name}-{contents.name}{TARGETS[name].suffix}"


def compiler_arguments(name: str, contents: Contents, work: Path) -> list[str]:
    """Return the arguments of a C compiler for a runtime's sources; generated headers are written to ``work``."""
    code = objects([name], [contents])[name]
    (work / "layout.h").write_text(declarations(contents, entries(contents.family)))
    include_dirs = (work, PACKAGE_DIR / "c", Path(fmpy.__file__).parent / "c-code")
    sources = sorted(PACKAGE_DIR.glob("c/*.c"))
    return [*COMPILER_FLAGS, *(f"-I{place}" for place in include_dirs), *map(str, (*sources, *code))]


def _link(name: str, contents: Contents, command: list[str]) -> None:
    path = build_dir(*_runtime_sources()) / _file(name, contents)
    with tempfile.TemporaryDirectory(prefix="mbfmu_") as folder:
        work = Path(folder)
        made = work / path.name
        linked = link_arguments(name, work, EXPORTED_SYMBOLS)
        libraries = ["-lm", *(["-ldl"] if path.suffix == ".so" else [])]  # libdl: up to glibc 2.33
        _run([*command, *compiler_arguments(name, contents, work), *linked, "-o", str(made), *libraries], {})
        install_atomically(made, path)


def link_arguments(name: str, work: Path, exported: str) -> list[str]:
    """Return the arguments of a C compiler that makes a shared library, which exports some symbols and misses none."""
    if TARGETS[name].suffix != ".so":
        return ["-shared", "-s"]
    (work / "exported").write_text(exported)
    return ["-shared", "-s", f"-Wl,--version-script={work}/exported", "-Wl,-z,defs"]


def has_zig() -> bool:
    """Whether zig is installed, which compiles C for all targets."""
    return importlib.util.find_spec("ziglang") is not None


def compiler(name: str) -> list[str]:
    """Return the command that compiles C for a target; UserError where there is none."""
    if has_zig():
        return [sys.executable, "-m", "ziglang", "cc", "-target", TARGETS[name].zig]
    own = next(filter(None, map(shutil.which, COMPILERS)), None)
    if own is None or name != host():
        raise UserError(f"nothing here compiles C for {name}. {COMPILER_ADVICE}", "no-runtime")
    return [own]


@contextmanager
def c_compilers(names: Collection[str]) -> Iterator[dict[str, list[str]]]:
    """Yield the command that compiles C for each target; if there is none, zig is downloaded for this block."""
    with ExitStack() as stack:
        try:
            found = {name: compiler(name) for name in names}
        except UserError as error:
            zig = download_zig(Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="mbfmu_"))), error)
            found = {name: [str(zig), "cc", "-target", TARGETS[name].zig] for name in names}
        yield found


def download_zig(folder: Path, why: UserError) -> Path:
    """Install zig into a folder with pip, and return its program; ``why`` is the reason."""
    announce(f"{why.diagnostic.text}: zig is downloaded (100 MB) and removed after the build")
    options = (
        "--disable-pip-version-check",
        "--no-deps",
        "--no-compile",
        "--only-binary=:all:",
        "--retries=1",
        "--timeout=15",
    )
    command = [sys.executable, "-m", "pip", "install", "--quiet", *options, "--target", str(folder), ZIG]
    try:
        _run(command, {})
    except UserError as error:
        reason = error.diagnostic.text.partition(" reports ")[2]
        text = f"{why.diagnostic.text}, and zig cannot be downloaded: pip reports {reason}. {COMPILER_ADVICE}"
        raise UserError(text, "no-runtime") from error
    return folder / "ziglang" / "zig"


def _run(command: list[str], more: dict[str, str], functions: int = 0) -> None:
    """Run a command, which may print a character for each function that it compiles; ``functions``: their number."""
    done = 0

    def printed(new: bytes) -> None:
        nonlocal done
        done += len(new)
        if functions:
            report_progress(min(done / functions, 1.0))

    # children of the process end when nothing reads what they print
    code, errors = run_program(command, more, printed=printed)
    if code:
        last = errors[-1] if errors else f"exit code {code}"
        text = f"the runtime cannot be built: {Path(command[0]).name} reports {last!r}"
        raise UserError(text, "no-runtime")


def install_atomically(made: Path, path: Path) -> None:
    """Put a file in its place at once, since two processes may build it, with a checksum in a folder next to it."""
    record, data = _checksum_file(path), made.read_bytes()
    record.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(record, sha256(data).hexdigest().encode())
    write_bytes(path, data)
    path.chmod(0o644)  # it may go into a package


def is_intact(path: Path) -> bool:
    """Whether a file that was installed is there and undamaged: a damaged library can end the process."""
    record = _checksum_file(path)
    if not path.is_file() or not record.is_file():
        return path.is_file()
    return sha256(path.read_bytes()).hexdigest() == record.read_text("utf-8", errors="replace")


def _checksum_file(path: Path) -> Path:
    return path.parent / "checksums" / path.name

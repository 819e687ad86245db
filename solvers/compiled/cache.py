"""Cache of machine code between processes.

Numba alone would go on using a cached caller after its callee was edited. So the folder of a module is named by a
fingerprint of its source and of all sources that it imports, directly or through others:
``mbfmu/kernels/<module>-<fingerprint>`` under ``NUMBA_CACHE_DIR`` or the user's cache. Every environment with these
sources uses the same folders, and an edit recompiles only the modules that import what was edited. Damaged files are
compiled again. If nothing can be written, every process compiles for itself. So does a process whose sources are edited
while it runs, as by an update of the checkout: what it has imported may not be what the fingerprint is of.
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache, cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

import numba
from numba.core import sigutils
from numba.core.caching import FunctionCache, NullCache, _CacheLocator
from numba.core.event import Listener, TimingListener, install_listener

from .code_files import CodeFiles, hash_of
from .turns import take_turn

SOLVERS_DIR = Path(__file__).resolve().parent.parent
PACKAGE_DIR = SOLVERS_DIR.parent / "mbfmu"
# of the kernels
KERNEL_DIRS = (SOLVERS_DIR, *(PACKAGE_DIR / name for name in ("mechanics", "sheets", "session/kernels", "native")))
IMPORT_STATEMENT = re.compile(
    r"^[ \t]*(?:from[ \t]+([.\w]+)[ \t]+import[ \t]+(\([^)]*\)|.*)|import[ \t]+(.*))", re.MULTILINE
)

_listeners: list[Callable[[], None]] = []  # functions to call before compilation begins
_blocks: list[Callable[[], None]] = []  # of enclosing blocks, the innermost last
_unwritable: list[str] = []  # warnings of this process


@cache
def cache_root() -> Path:
    """Return the folder of all machine code."""
    given = (os.environ.get(name) for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "LOCALAPPDATA"))
    place = next(filter(None, given), "")
    return (Path(place) if place else Path(os.path.expanduser("~/.cache"))) / "mbfmu"  # noqa: PTH111  # never raises


@cache
def shared_cache_dir() -> Path:
    """Return the folder for what is made of all these sources together."""
    return cache_root() / fingerprint_of(kernel_sources())


@cache
def module_cache_dir(module: str) -> Path:
    """Return the folder of the machine code of one module; a user's module depends on all sources."""
    sources = kernel_sources()
    found: set[str] = set()
    waiting = [module] if module in sources else list(sources)
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += imports_of(name)
    return cache_root() / "kernels" / f"{module}-{fingerprint_of({name: sources[name] for name in found})}"


@cache
def kernel_sources() -> dict[str, str]:
    """Return the source of every module that may hold kernels, by its name."""
    found = {}
    for source in record_source_states():
        parts = source.relative_to(SOLVERS_DIR.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = source.read_text("utf-8")
    return found


@cache
def record_source_states() -> dict[Path, tuple[int, int]]:
    """Return the sources of kernels with their states, as this process has found them first."""
    return {source: state_of(source) for place in KERNEL_DIRS for source in place.rglob("*.py")}


def state_of(source: Path) -> tuple[int, int]:
    """Return the time of the last change (ns) and the size (bytes) of a file; zeros: there is none."""
    try:
        status = source.stat()
    except OSError:
        return 0, 0
    return status.st_mtime_ns, status.st_size


def are_sources_unchanged() -> bool:
    """Whether no source has been edited since this process has read them."""
    return all(state_of(source) == state for source, state in record_source_states().items())


def fingerprint_of(sources: Mapping[str, str]) -> str:
    """Return a fingerprint of the names and contents of sources (16 hexadecimal digits)."""
    digest = sha256(numba.__version__.encode())
    for name in sorted(sources):
        digest.update(f"{name}\n{sources[name]}".encode())
    return digest.hexdigest()[:16]


@cache
def imports_of(module: str) -> list[str]:
    """Return the modules among ours that a module imports itself, at its top or within a function."""
    sources = kernel_sources()
    is_package = any(name.startswith(module + ".") for name in sources)
    found = []
    for base, names, plain in IMPORT_STATEMENT.findall(sources[module]):
        if plain:
            found += re.findall(r"[.\w]+", plain)
            continue
        up = len(base) - len(base.lstrip("."))
        parts = module.split(".")
        package = parts[: len(parts) - up + is_package] if up else []
        origin = ".".join([*package, *filter(None, [base.lstrip(".")])])
        inner = [f"{origin}.{name}" for name in re.findall(r"\w+", re.sub(r"#.*", "", names))]
        found += inner if inner and all(name in sources for name in inner) else [origin, *inner]
    return sorted({name for name in found if name in sources})


@contextmanager
def when_compiling(notify: Callable[[], None]) -> Iterator[None]:
    """Call ``notify`` once in this block before the first compilation, unless the enclosing block, which
    waits meanwhile, has been notified.
    """
    around = _listeners.copy()
    _listeners[:] = [notify] if around or not _blocks else []
    _blocks.append(notify)
    try:
        yield
    finally:
        _blocks.pop()
        _listeners[:] = around if _listeners else []


class CompilationNeeded(BaseException):
    """Raised where code must be compiled; not an Exception, so that no handler of errors catches it."""


@contextmanager
def forbid_compilation() -> Iterator[None]:
    """Have :class:`CompilationNeeded` raised in this block before anything is compiled. Enclosing blocks are not
    notified of it, but when something is compiled later.
    """

    def refuse() -> None:
        raise CompilationNeeded

    around = _listeners.copy()
    _listeners[:] = [refuse]
    try:
        yield
    finally:
        _listeners[:] = around


@contextmanager
def measure_compilation_time() -> Iterator[Callable[[], float]]:
    """Yield a function that returns the compilation time of this block so far, s."""
    timer = TimingListener()
    with install_listener("numba:compile", timer):
        yield lambda: float(timer.duration) if timer.done else 0.0


class _Report(Listener):
    """Calls a function whenever a kernel has been compiled."""

    def __init__(self, report: Callable[[], None]) -> None:
        self._report = report

    def on_start(self, _: Any) -> None:
        """Do nothing."""

    def on_end(self, _: Any) -> None:
        """Report it."""
        self._report()


@contextmanager
def when_compiled(report: Callable[[], None]) -> Iterator[None]:
    """Call ``report`` in this block whenever a kernel has been compiled."""
    with install_listener("numba:compile", _Report(report)):
        yield


def notify_listeners() -> None:
    """Notify the waiting block that compilation begins."""
    while _listeners:
        _listeners.pop()()


def is_notified() -> bool:
    """Whether an enclosing block of :func:`when_compiling` has been notified: something has been compiled in it."""
    return bool(_blocks) and not _listeners


class Locator(_CacheLocator):
    """The folder of one module, whose functions are identified by their lines."""

    def __init__(self, function: Any, source: str) -> None:
        self._line = str(function.__code__.co_firstlineno)
        self._stamp = source_hash(source)
        ours = any(Path(source).resolve().is_relative_to(place) for place in KERNEL_DIRS)
        other = "" if ours else "-" + sha256(str(Path(source).resolve()).encode()).hexdigest()[:8]
        self._path = str(module_cache_dir(function.__module__)) + other

    def get_cache_path(self) -> str:
        """Return the folder."""
        return self._path

    def get_source_stamp(self) -> str:
        """Return what changes with the source."""
        return self._stamp

    def get_disambiguator(self) -> str:
        """Return what distinguishes functions of one name."""
        return self._line

    @classmethod
    def from_function(cls, function: Any, source: str) -> Locator | None:
        """Return the place of a function; None where it cannot be written."""
        try:
            place = cls(function, source)
            if not Path(place.get_cache_path()).is_dir():  # one that is there may be read at least
                place.ensure_cache_path()
        except OSError:
            return None
        return place


def source_hash(source: str) -> str:
    """Return what identifies the version of a source, independent of its location."""
    status = Path(source).stat()
    return _content(source, status.st_mtime_ns, status.st_size)


@cache
def _content(source: str, _changed: int, _size: int) -> str:
    return sha256(Path(source).read_bytes()).hexdigest()


class Cache(FunctionCache):
    """The machine code of one function, for every signature."""

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        self._cache_file: Any = CodeFiles(Path(self._cache_path), self._impl.filename_base)

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return the stored code of a signature; None if there is none, or it is damaged or of another signature.

        A process that compiles it is waited for. Then it is the turn of this process to compile it, until the end of
        the block of :func:`.turns.turns`.
        """
        if (found := self._stored(signature, context)) is not None:
            return found
        notify_listeners()
        take_turn(Path(self._cache_path), self._index_key(signature, context.codegen()))
        return self._stored(signature, context)

    def _stored(self, signature: Any, context: Any) -> Any:
        try:
            found = self._load_overload(signature, context)
            if found is not None and tuple(found.signature.args) == tuple(sigutils.normalize_signature(signature)[0]):
                return found
        except Exception:  # what is damaged unpickles to anything
            pass
        return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Store compiled code if the folder can be written and the sources are those of the fingerprint."""
        if not are_sources_unchanged():
            return
        try:
            super().save_overload(signature, compiled)
        except OSError as error:
            warn_unwritable(error)

    def _index_key(self, signature: Any, codegen: Any) -> str:
        """Return the hash of all that the code depends on, with the function."""
        given, machine, contents = super()._index_key(sigutils.normalize_signature(signature)[0], codegen)
        return hash_of(given, machine, contents, self._impl.filename_base, self._impl.locator.get_source_stamp())


class UncachedFunction(NullCache):
    """Cache of a function whose code cannot be stored."""

    def load_overload(self, signature: Any, context: Any) -> None:
        """Find nothing."""
        notify_listeners()


class CacheOnDemand:
    """The cache of a function, which is opened when it is used: most processes call few of all functions."""

    def __init__(self, function: Any, kind: type[Cache]) -> None:
        kernel_sources()  # as they are while modules are imported
        self._function, self._kind = function, kind

    def __getattr__(self, name: str) -> Any:
        return getattr(self._opened, name)

    @cached_property
    def _opened(self) -> Any:
        return _open(self._function, self._kind)


def _open(function: Any, kind: type[Cache]) -> Any:
    """Return the cache of a function; one that stores nothing if no folder can be written."""
    try:
        return kind(function)
    except RuntimeError as error:  # no place was found
        warn_unwritable(error)
        return UncachedFunction()


def warn_unwritable(error: Exception) -> None:
    """Warn once in a process that machine code cannot be stored."""
    if not _unwritable:
        _unwritable.append(str(error))
        warnings.warn(
            f"machine code cannot be kept ({error}), so every process compiles for a minute or more; set "
            "NUMBA_CACHE_DIR to a folder that can be written",
            RuntimeWarning,
            stacklevel=2,
        )

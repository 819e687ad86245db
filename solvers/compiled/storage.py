"""The machine code on disk: how much there is, and its removal.

The folder of the cache may hold other files, as the sources of a checkout do if ``NUMBA_CACHE_DIR`` is set to it.
So a folder counts as machine code only if its name ends in a fingerprint
(:func:`solvers.compiled.cache.module_cache_dir`), and in it only the kinds of files that the compiler and the linker
write. Symbolic links are not followed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from . import cache
from .turns import FILE_NAME

FINGERPRINT = "[0-9a-f]{16}"
KERNEL_FOLDER = re.compile(rf".+-({FINGERPRINT})(-[0-9a-f]{{8}})?")  # in kernels/
SHARED_FOLDER = re.compile(FINGERPRINT)  # of what is made of all sources
RUNTIME_FOLDER = re.compile(rf"native-{FINGERPRINT}")
KERNEL_FILE = re.compile(rf".+\.nb[ic](\.tmp\.\w+)?|{FILE_NAME}")
RUNTIME_FILE = re.compile(r"lock|tmp\w+|\.unfinished-\w+(\.\w+)?|.+\.(o|so|dylib|dll)")


class CodeFolder(NamedTuple):
    """One folder of machine code.

    Attributes
    ----------
    files
        The files in it that hold machine code.
    size
        Their size, bytes.
    is_current
        Whether it belongs to the sources and the numba of this process.
    """

    path: Path
    files: tuple[Path, ...]
    size: int
    is_current: bool


class Removal(NamedTuple):
    """What :func:`clear` did.

    Attributes
    ----------
    files, size
        Number of files that were removed, and their size in bytes.
    failures
        Files that could not be removed, with the reason.
    """

    files: int
    size: int
    failures: tuple[tuple[Path, str], ...]


def find_code_folders() -> list[CodeFolder]:
    """Return every folder of machine code, those of other versions of the sources and of numba included."""
    current = {place.name for place in map(cache.module_cache_dir, cache.kernel_sources())}
    fingerprints = {cache.shared_cache_dir().name} | {name.rpartition("-")[2] for name in current}
    found = []
    for path, fingerprint, pattern in _candidates():
        files, size = [], 0
        for file in _entries(path):
            with suppress(OSError):  # another process replaces or removes it
                if pattern.fullmatch(file.name) and file.is_file() and not file.is_symlink():
                    size += file.stat().st_size
                    files.append(file)
        if files:
            found.append(CodeFolder(path, tuple(files), size, fingerprint in fingerprints))
    return found


def _candidates() -> Iterator[tuple[Path, str, re.Pattern[str]]]:
    """Yield folders whose names are those of machine code, with their fingerprint and the names of the files."""
    for path in _entries(cache.cache_root() / "kernels"):
        if found := KERNEL_FOLDER.fullmatch(path.name):
            yield path, found[1], KERNEL_FILE
    for shared in _entries(cache.cache_root()):
        if SHARED_FOLDER.fullmatch(shared.name):
            for path in _entries(shared):  # up to version 0.2.0 kernels were kept there too
                yield path, shared.name, RUNTIME_FILE if RUNTIME_FOLDER.fullmatch(path.name) else KERNEL_FILE


def _entries(folder: Path) -> list[Path]:
    """Return what is in a folder; nothing if there is none, or a symbolic link."""
    if folder != cache.cache_root() and folder.is_symlink():
        return []
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []


def clear(*, keep_current: bool = False) -> Removal:
    """Remove the machine code, and the folders that are empty afterwards.

    Parameters
    ----------
    keep_current
        Keep what belongs to the sources and the numba of this process.
    """
    count, size, failures = 0, 0, []
    for folder in find_code_folders():
        if keep_current and folder.is_current:
            continue
        for file in folder.files:
            try:
                length = file.stat().st_size
                file.unlink()
            except FileNotFoundError:  # another process removed it
                continue
            except OSError as error:
                failures.append((file, error.strerror or str(error)))
            else:
                count, size = count + 1, size + length
    for empty in (*(path for path, *_ in list(_candidates())), *_entries(cache.cache_root())):
        if not empty.is_symlink():
            with suppress(OSError):  # it is no folder, or not empty
                empty.rmdir()
    with suppress(OSError):
        cache.cache_root().rmdir()
    return Removal(count, size, tuple(failures))


def find_foreign() -> list[Path]:
    """Return what is in the folder of the cache and is no machine code: files and symbolic links at any depth."""
    own = {file for folder in find_code_folders() for file in folder.files}
    return sorted(
        path for path in cache.cache_root().rglob("*") if path not in own and (path.is_symlink() or path.is_file())
    )

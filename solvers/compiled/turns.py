"""Turns of processes that need the same function: one compiles it, and the others load what it has stored.

A turn is a lock on one byte of a file in the folder of a module in the cache. The system ends it with the process, and
a process that is forked does not inherit it. Functions call each other without cycles, so no two processes wait for
each other.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: processes compile for themselves
    fcntl = None  # type: ignore[assignment]

LONGEST_WAIT = 60.0  # s: a process that has been stopped must not stop others
POLLING_INTERVAL = 0.02  # s
FILE_NAME = "turns"

_taken: list[tuple[int, int]] = []  # file and place of the turns of this process, the innermost last


def take_turn(folder: Path, key: str) -> None:
    """Wait until no other process compiles a function of a folder, and begin to; ``key``: its hexadecimal hash."""
    file, place = _turn_file(folder), int(key[:15], 16)
    end = time.monotonic() + LONGEST_WAIT
    while file is not None and time.monotonic() < end:
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, place)
        except BlockingIOError:
            time.sleep(POLLING_INTERVAL)
        except OSError:  # a file system without locks
            return
        else:
            _taken.append((file, place))
            return


@contextmanager
def turns() -> Iterator[None]:
    """End the turns that are taken in this block at its end."""
    before = len(_taken)
    try:
        yield
    finally:
        while len(_taken) > before:
            file, place = _taken.pop()
            with suppress(OSError):  # the file system has been lost; the turn ends with the process
                fcntl.lockf(file, fcntl.LOCK_UN, 1, place)


@cache
def _turn_file(folder: Path) -> int | None:
    """Return the open file of the turns of a folder; None if there can be none. Closing it would end all turns."""
    if fcntl is None:
        return None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return os.open(folder / FILE_NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError:
        return None

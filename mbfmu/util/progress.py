"""Progress of long work that is done far below what shows it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

_listeners: list[tuple[Callable[[float], None], Callable[[str], None]]] = []


@contextmanager
def when_progressing(show: Callable[[float], None], write: Callable[[str], None]) -> Iterator[None]:
    """Call ``show`` in this block with the part (0 to 1) of long work that is done, ``write`` with announcements."""
    listener = show, write
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


def report_progress(part: float) -> None:
    """Report the part (0 to 1) that is done of long work."""
    for show, _ in _listeners:
        show(part)


def announce(text: str) -> None:
    """Report what is done in addition, and why."""
    for _, write in _listeners:
        write(text)

"""Progress of long work that is done far below what shows it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

_listeners: list[Callable[[float], None]] = []


@contextmanager
def when_progressing(show: Callable[[float], None]) -> Iterator[None]:
    """Call ``show`` with the part (0 to 1) that is done of long work in this block."""
    _listeners.append(show)
    try:
        yield
    finally:
        _listeners.remove(show)


def report_progress(part: float) -> None:
    """Report the part (0 to 1) that is done of long work."""
    for show in _listeners:
        show(part)

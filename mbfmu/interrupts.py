"""Ctrl-C in a run: it ends between two steps, where nothing is half done."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread


@contextmanager
def interrupts_held(*, fatal: bool = False) -> Iterator[Callable[[], None]]:
    """Yield what raises the KeyboardInterrupt that Ctrl-C asked for meanwhile.

    Raised inside a callback of SUNDIALS it would be lost, and PythonFMU's wrapper does not survive it. A second Ctrl-C
    is not held; ``fatal``: it ends the process.
    """
    if current_thread() is not main_thread():  # signals go to the main thread alone
        yield lambda: None
        return
    asked: list[int] = []

    def hold(number: int, _frame: object) -> None:
        asked.append(number)
        signal.signal(signal.SIGINT, signal.SIG_DFL if fatal else before)

    def interrupt() -> None:
        if asked:
            raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, hold)
    try:
        yield interrupt
    finally:
        signal.signal(signal.SIGINT, before)

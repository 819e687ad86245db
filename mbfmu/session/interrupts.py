"""Ctrl-C in a run: it ends between two steps, where nothing is half done."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread
from typing import Any

TERMINATED_EXIT_CODE = 143  # exit code of a process that was asked to end, as shells have it


@contextmanager
def interrupts_held(*, fatal: bool = False) -> Iterator[Callable[[], None]]:
    """Yield a function that raises the KeyboardInterrupt of a Ctrl-C that has occurred meanwhile.

    Raised inside a callback of SUNDIALS it would be lost, and PythonFMU's wrapper would crash. A second Ctrl-C
    is not held; ``fatal``: it ends the process.
    """
    if current_thread() is not main_thread():  # signals go to the main thread alone
        yield lambda: None
        return
    received: list[int] = []
    numbers = [n for n in (signal.SIGINT, signal.SIGTERM) if n == signal.SIGINT or callable(signal.getsignal(n))]

    def hold(number: int, _frame: object) -> None:
        received.append(number)
        signal.signal(number, signal.SIG_DFL if fatal else before[number])

    def interrupt() -> None:
        if signal.SIGTERM in received:
            raise SystemExit(TERMINATED_EXIT_CODE)
        if received:
            raise KeyboardInterrupt

    before: dict[int, Any] = {number: signal.signal(number, hold) for number in numbers}
    try:
        yield interrupt
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def termination_raised() -> Iterator[None]:
    """Let a request to end the process (SIGTERM) raise SystemExit in this block, so that unfinished files are removed.

    A second request ends the process at once.
    """
    own = current_thread() is main_thread() and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    if not own:
        yield
        return

    def leave(_number: int, _frame: object) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        raise SystemExit(TERMINATED_EXIT_CODE)

    signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)

"""Ctrl-C in a run: it ends between two steps, where nothing is half done. Requests to end a command (SIGTERM)."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Timer, current_thread, main_thread
from types import FrameType
from typing import Any

TERMINATED_EXIT_CODE = 143  # exit code of a process that was asked to end, as shells have it
REPETITION_TIME = 0.01  # s, until a request to end the process is repeated
# functions whose exceptions Python discards: callbacks of LLVM (llvmlite calls them when code is compiled), finalizers
DISCARDING = frozenset({"_raw_object_cache_notify", "_raw_object_cache_getbuffer", "__del__"})


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


def is_exception_discarded(frame: FrameType | None) -> bool:
    """Return whether Python discards what is raised in this frame, since a finalizer or LLVM has called it."""
    while frame is not None:
        if frame.f_code.co_name in DISCARDING:
            return True
        frame = frame.f_back
    return False


@contextmanager
def termination_raised() -> Iterator[None]:
    """Let a request to end the process (SIGTERM) raise SystemExit in this block, so that unfinished files are removed.

    A second request ends the process at once. A request where Python discards exceptions is repeated until it is
    outside: LLVM would continue without the code that it has compiled.
    """
    own = current_thread() is main_thread() and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    if not own:
        yield
        return

    def leave(number: int, frame: FrameType | None) -> None:
        if is_exception_discarded(frame):
            repetition = Timer(REPETITION_TIME, os.kill, (os.getpid(), number))
            repetition.daemon = True
            repetition.start()
            return
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        raise SystemExit(TERMINATED_EXIT_CODE)

    signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)

"""Say that something is compiled before it is, and how long that took afterwards."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from numba.core.event import TimingListener, install_listener
from tqdm import tqdm

from solvers.compiled.cache import when_compiling

BEFORE = "compiling, once on this machine: a minute or two; later runs start at once"


@contextmanager
def compilation(tells: bool) -> Iterator[None]:
    """Tell on standard error, where that is wanted, that this block waits for the compiler, and how long it did."""
    timer = TimingListener()  # type: ignore[no-untyped-call]
    try:
        with install_listener("numba:compile", timer), when_compiling(lambda: say(BEFORE, tells)):
            yield
    finally:
        if timer.done:
            say(f"compiled for {timer.duration:.1f} s; that is kept", tells)


def say(text: str, tells: bool) -> None:
    """Write a line, above the bar where there is one."""
    if tells:
        tqdm.write(text, file=sys.stderr)

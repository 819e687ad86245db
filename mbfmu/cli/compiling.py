"""Report that something is compiled before it is, and how long that took afterwards."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from tqdm import tqdm

from mbfmu.util.progress import when_progressing
from solvers.compiled.cache import measure_compilation_time, when_compiling

from .common import bar

COMPILING_TEXT = "compiling; this takes up to three minutes, once per machine"


@contextmanager
def report_compilation(*, reported: bool) -> Iterator[None]:
    """Report on standard error, if requested, that this block waits for the compiler, and how long it took."""
    with measure_compilation_time() as taken, Build(reported) as build:
        try:
            with (
                when_compiling(lambda: print_if(COMPILING_TEXT, reported)),
                when_progressing(build.show, lambda text: print_if(text, reported)),
            ):
                yield
        finally:
            if taken():
                print_if(f"compiled in {taken():.1f} s", reported)


def print_if(text: str, shown: bool) -> None:
    """Write a line, above the bar where there is one."""
    if shown:
        tqdm.write(text, file=sys.stderr)


class Build:
    """A bar on a terminal while a runtime of native FMUs is built."""

    def __init__(self, shown: bool) -> None:
        self._shown = shown
        self._bar: tqdm | None = None

    def __enter__(self) -> Build:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def show(self, part: float) -> None:
        """Show the part (0 to 1) that is built; the bar disappears when all is."""
        if self._bar is None:
            self._bar = bar(100.0, "runtime", not self._shown, "%")
        self._bar.update(100.0 * part - self._bar.n)
        if part >= 1.0:
            self._close()

    def _close(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None

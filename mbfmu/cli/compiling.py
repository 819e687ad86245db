"""Report that something is compiled before it is, and how long that took afterwards."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from tqdm import tqdm

from solvers.compiled.cache import measure_compilation_time, when_compiling

COMPILING_TEXT = "compiling; this takes one to three minutes, for native FMUs up to six, once per machine"


@contextmanager
def report_compilation(*, reported: bool) -> Iterator[None]:
    """Report on standard error, if requested, that this block waits for the compiler, and how long it took."""
    with measure_compilation_time() as taken:
        try:
            with when_compiling(lambda: print_if(COMPILING_TEXT, reported)):
                yield
        finally:
            if taken():
                print_if(f"compiled in {taken():.1f} s", reported)


def print_if(text: str, shown: bool) -> None:
    """Write a line, above the bar where there is one."""
    if shown:
        tqdm.write(text, file=sys.stderr)

"""SUNDIALS without its messages: what it has to say is in the status of a step."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from io import StringIO

LOGS = ("SUNLOGGER_ERROR_FILENAME", "SUNLOGGER_WARNING_FILENAME")  # where SUNDIALS writes to; else to the console


def silent() -> redirect_stdout[StringIO]:
    """Discard printed text: scikit-sundae prints the content of a step's status."""
    return redirect_stdout(StringIO())


@contextmanager
def nowhere() -> Iterator[None]:
    """Discard logs that are opened now and remain open, unless the environment sets their path."""
    given = [name for name in LOGS if name not in os.environ]
    os.environ.update(dict.fromkeys(given, os.devnull))
    try:
        yield
    finally:
        for name in given:
            del os.environ[name]

"""SUNDIALS without its messages: what it has to say is in the status of a step."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from io import StringIO

# environment variables with the files that SUNDIALS writes to; without them it writes to the console
LOG_VARIABLES = ("SUNLOGGER_ERROR_FILENAME", "SUNLOGGER_WARNING_FILENAME")


def discard_output() -> redirect_stdout[StringIO]:
    """Discard printed text: scikit-sundae prints the content of a step's status."""
    return redirect_stdout(StringIO())


@contextmanager
def discard_logs() -> Iterator[None]:
    """Discard logs that are opened now and remain open, unless the environment sets their path."""
    given = [name for name in LOG_VARIABLES if name not in os.environ]
    os.environ.update(dict.fromkeys(given, os.devnull))
    try:
        yield
    finally:
        for name in given:
            del os.environ[name]

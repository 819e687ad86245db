"""SUNDIALS without its messages: what it has to say is in the status of a step."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from io import StringIO

LOGS = ("SUNLOGGER_ERROR_FILENAME", "SUNLOGGER_WARNING_FILENAME")  # where SUNDIALS writes to; else to the console


def silent() -> redirect_stdout[StringIO]:
    """Let what is printed go nowhere: scikit-sundae prints what the status of a step says."""
    return redirect_stdout(StringIO())


@contextmanager
def nowhere() -> Iterator[None]:
    """Let logs that are opened now, and stay open, go nowhere, unless the environment says where."""
    given = [name for name in LOGS if name not in os.environ]
    os.environ.update(dict.fromkeys(given, os.devnull))
    try:
        yield
    finally:
        for name in given:
            del os.environ[name]

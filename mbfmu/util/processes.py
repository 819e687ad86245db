"""Programs that this process starts, such as compilers, and that end with it; processors."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence


def run_program(
    command: Sequence[str],
    variables: Mapping[str, str] | None = None,
    *,
    printed: Callable[[bytes], None] | None = None,
) -> tuple[int, list[str]]:
    """Run a program; return its exit code and the lines of its error stream that are not empty.

    An exception meanwhile, such as that of Ctrl-C, ends the program and all processes that it has started: none of them
    writes into a folder that the caller removes.

    Parameters
    ----------
    command : sequence of str
        Program and arguments.
    variables : mapping, optional
        Environment variables in addition to those of this process.
    printed : callable, optional
        Called with what the program has printed since the last call.
    """
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as errors:
        environment = {**os.environ, **(variables or {})}
        with subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=errors, start_new_session=True
        ) as process:
            assert process.stdout is not None
            try:
                while new := os.read(process.stdout.fileno(), 4096):
                    if printed is not None:
                        printed(new)
            except BaseException:
                _end(process)
                raise
        errors.seek(0)
        return process.returncode, [line for line in errors.read().splitlines() if line.strip()]


def count_processors() -> int:
    """Return how many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):  # not on every system
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a process that leads a session, and its children, and wait until none of them is left."""
    assert process.stdout is not None
    if hasattr(os, "killpg"):
        os.killpg(process.pid, signal.SIGKILL)
    else:  # Windows
        process.kill()
    process.stdout.read()  # ends when no process can write to it any more

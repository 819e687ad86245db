"""Mistakes a user can make; the message names the thing, its value and what is allowed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

LONGEST_MESSAGE = 3000  # characters that the command prints of an error
LONGEST = 200  # characters of a value in a message


class UserError(ValueError):
    """Base of every error the command line prints without a traceback."""


class AssemblyError(UserError):
    """The loops of a mechanism cannot be closed, or its start is not consistent."""


class EquilibriumError(UserError):
    """No steady state was found, or what was found is none; the message gives the residual."""


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Raise UserError if a file, or one in a folder, cannot be written."""
    try:
        yield
    except BrokenPipeError:  # of what is printed meanwhile
        raise
    except OSError as error:
        inside = error.filename is not None and path in Path(error.filename).parents
        where = str(error.filename if inside else path)
        raise UserError(f"{where!r} cannot be written: {error.strerror or error}") from error


def short(value: object) -> str:
    """Return what a sentence calls a value: as Python writes it, or its class where that is long."""
    text = repr(value)
    return text if len(text) <= LONGEST and "\n" not in text else f"a {type(value).__name__}"


def shorten(text: str) -> str:
    """Return a message without its middle if it is long, as one that repeats what was given is."""
    if len(text) <= LONGEST_MESSAGE:
        return text
    head, tail = 2 * LONGEST_MESSAGE // 3, LONGEST_MESSAGE // 3
    return f"{text[:head]} [... {len(text) - head - tail} characters left out ...] {text[-tail:]}"

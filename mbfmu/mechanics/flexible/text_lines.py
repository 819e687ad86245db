"""Lines of the text files of finite element programs, and errors that name them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from mbfmu.util.errors import UserError

Place = tuple[int, int]  # number of a node, direction from 1
MAX_DIRECTIONS = 6  # displacements, then rotations


class Entry(NamedTuple):
    """An entry of a matrix, with the number and the text of its line."""

    row: Place
    column: Place
    value: float
    line: int
    text: str


def text_lines(path: str | Path) -> Iterator[tuple[int, str]]:
    """Yield the lines that are not empty, with their numbers, from 1.

    Raises
    ------
    UserError
        The file cannot be read.
    """
    try:
        with Path(path).open(encoding="utf-8", errors="replace") as file:
            for number, line in enumerate(file, 1):
                if line.strip():
                    yield number, line.rstrip("\r\n")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UserError(f"file {str(path)!r} cannot be read ({reason}); allowed: a text file") from error


def wrong_line(path: str | Path, number: int, text: str, allowed: str) -> UserError:
    """Return the error of a line."""
    return UserError(f"line {number} of {str(path)!r} is {text.strip()[:60]!r}; allowed: {allowed}")


def integer_of(text: str) -> int | None:
    """Return a whole number; None: the text is none. Python also accepts ``1_0`` and digits of other scripts."""
    return int(text) if re.fullmatch(r"[+-]?[0-9]{1,18}", text) else None


def real_of(text: str) -> float:
    """Return a number such as 1.5E+3; nan: the text is none."""
    return float(text) if re.fullmatch(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?", text) else float("nan")

"""TOML files that users write: read in one place, so that every mistake in them becomes one kind of message."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from .errors import UserError

INTEGER_LIMIT = 2**63  # of whole numbers; TOML asks for no larger ones, and tables of results hold none


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Return the content of a TOML file in UTF-8, with or without a byte order mark.

    Parameters
    ----------
    path
        The file.
    what
        What a message calls the file, such as ``"scene file"``.

    Raises
    ------
    UserError
        The file cannot be read, it is not valid TOML, or a whole number in it does not fit into 64 bits.
    """
    try:
        content = tomllib.loads(path.read_bytes().decode("utf-8-sig").replace("\r\n", "\n"))
    except OSError as error:
        raise UserError(f"{what} {str(path)!r} cannot be read: {error.strerror}") from error
    except RecursionError as error:
        raise UserError(f"{what} {str(path)!r} is not valid TOML: it is nested too deeply; use fewer levels") from error
    except ValueError as error:  # of tomllib, of decoding, and of numbers with thousands of digits
        raise UserError(f"{what} {str(path)!r} is not valid TOML: {error}") from error
    _check_numbers(content, f"{what} {str(path)!r}")
    return content


def _check_numbers(content: Any, where: str) -> None:
    """Refuse whole numbers that do not fit into 64 bits."""
    waiting = [(content, "")]
    while waiting:
        value, name = waiting.pop()
        if isinstance(value, dict):
            waiting += [(own, f"{name}.{key}" if name else key) for key, own in value.items()]
        elif isinstance(value, list):
            waiting += [(own, name) for own in value]
        elif isinstance(value, int) and not -INTEGER_LIMIT <= value < INTEGER_LIMIT:
            raise UserError(f"{where}: {name} has a whole number of more than 64 bits; write it with an exponent")

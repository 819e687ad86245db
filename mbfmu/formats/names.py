"""Python identifiers from the names of files, which may be any text."""

from __future__ import annotations

import builtins
import keyword
import re
import unicodedata

MAX_IDENTIFIER_LENGTH = 60  # characters of an identifier
RESERVED = frozenset(
    {*keyword.kwlist, *keyword.softkwlist, *dir(builtins), "m", "mb", "self", "ground", "Rotation", "Path", "FOLDER"}
)
SPELLINGS = {"ß": "ss", "æ": "ae", "Æ": "Ae", "ø": "o", "Ø": "O", "ł": "l", "Ł": "L", "đ": "d", "Đ": "D"}


def identifier(text: str) -> str:
    """Return text as an identifier of ASCII letters: accents are removed, other characters become underscores."""
    spelled = unicodedata.normalize("NFKD", "".join(SPELLINGS.get(letter, letter) for letter in text))
    plain = "".join(letter for letter in spelled if not unicodedata.combining(letter))
    found = re.sub(r"_*[^A-Za-z0-9_]+_*", "_", plain).strip("_")[:MAX_IDENTIFIER_LENGTH].rstrip("_")
    return f"_{found}" if found[:1].isdigit() else found


class Names:
    """Identifiers that are given out, each once."""

    def __init__(self, taken: frozenset[str] = RESERVED) -> None:
        self._taken = set(taken)
        self._numbers: dict[str, int] = {}

    def new(self, text: str, default: str) -> str:
        """Return an identifier for a name; for ``default`` if nothing remains of it, with a number if it is taken."""
        return self.unique(identifier(text) or identifier(default) or "unnamed")

    def unique(self, base: str) -> str:
        """Return an identifier, with a number if it is taken."""
        name, number = base, self._numbers.get(base, 2)
        while name in self._taken:
            name, number = f"{base}_{number}", number + 1
        self._numbers[base] = number
        self._taken.add(name)
        return name

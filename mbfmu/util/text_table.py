"""Tables for people.

``tabulate`` would save ten lines for a further dependency, and removes leading and trailing blanks of cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest


def format_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return rows as aligned text; a cell of several lines makes its row as high."""
    cells = [[cell.split("\n") for cell in line] for line in [header, *rows]]
    widths = [max(len(part) for line in cells for part in line[i]) for i in range(len(header))]
    lines = [
        "  ".join(part.ljust(w) for part, w in zip(parts, widths, strict=True)).rstrip()
        for line in cells
        for parts in zip_longest(*line, fillvalue="")
    ]
    return "\n".join([lines[0], "  ".join("-" * w for w in widths), *lines[1:]])


def format_tolerance(number: float) -> str:
    """Return a tolerance as people write it: ``1e-6``."""
    digits, exponent = f"{number:.6e}".split("e")
    return f"{float(digits):g}e{int(exponent)}"


def format_count(number: int, what: str) -> str:
    """Return how many there are of a thing: ``1 state``, ``2 states``."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"

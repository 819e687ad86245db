"""Matrices and nodes in files of CalculiX and Abaqus.

CalculiX writes ``job.sti``, ``job.mas`` and ``job.dof`` with ``*FREQUENCY, SOLVER=MATRIXSTORAGE``: entries "row column
value" of one triangle, rows counted from 1, and for every row "node.direction" (G. Dhondt: CalculiX CrunchiX user's
manual). Abaqus writes ``job_STIF1.mtx`` and ``job_MASS1.mtx`` with ``*MATRIX OUTPUT, FORMAT=MATRIX INPUT``: entries
"node, direction, node, direction, value" of one triangle or of both (Abaqus keywords guide, *MATRIX INPUT).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from .text_lines import MAX_DIRECTIONS, Entry, Place, integer_of, real_of, text_lines, wrong_line


def read_node_blocks(deck: str | Path) -> dict[int, list[float]]:
    """Return the positions of the nodes in the blocks ``*NODE`` of an input deck, by their numbers."""
    found: dict[int, list[float]] = {}
    is_block = False
    for number, text in _lines(deck):
        if text.startswith("*"):
            is_block = text[1:].split(",")[0].strip().upper() == "NODE"
        elif is_block:
            words = text.replace(",", " ").split()
            node, place = integer_of(words[0]) or 0, [real_of(word) for word in words[1:]]
            if node < 1 or not 2 <= len(place) <= 3 or not np.all(np.isfinite(place)):
                raise wrong_line(deck, number, text, "number of a node, x, y, z")
            if node in found:
                raise wrong_line(deck, number, text, f"each node once, and {node} was given before")
            found[node] = [*place, 0.0][:3]
    return found


def read_rows(path: str | Path) -> list[Place]:
    """Return the node and the direction of every row of the matrices of CalculiX."""
    allowed = f"node.direction, with a direction of 1 to {MAX_DIRECTIONS}"
    found = []
    for number, text in _lines(path):
        node, direction = (integer_of(part) for part in text.partition(".")[::2])
        if node is None or direction is None or node < 1 or not 1 <= direction <= MAX_DIRECTIONS:
            raise wrong_line(path, number, text, allowed)
        found.append((node, direction))
    return found


def read_entries(path: str | Path, rows: list[Place] | None) -> Iterator[Entry]:
    """Yield the entries of a matrix; ``rows`` are those of CalculiX, None: the file is of Abaqus."""
    for number, text in _lines(path):
        yield _entry(path, number, text, text.replace(",", " ").split(), rows)


def _lines(path: str | Path) -> Iterator[tuple[int, str]]:
    """Yield the lines with their numbers, without comments (``**``)."""
    for number, line in text_lines(path):
        text = line.strip()
        if not text.startswith("**"):
            yield number, text


def _entry(path: str | Path, number: int, text: str, words: list[str], rows: list[Place] | None) -> Entry:
    allowed = "node, direction, node, direction, value" if rows is None else "row, column, value"
    count = 4 if rows is None else 2
    own = [found for word in words[:count] if (found := integer_of(word)) is not None]
    if len(words) != count + 1 or len(own) != count:
        raise wrong_line(path, number, text, allowed)
    value = real_of(words[count])
    if not np.isfinite(value):
        raise wrong_line(path, number, text, f"{allowed}, finite")
    if rows is not None:
        if not all(1 <= k <= len(rows) for k in own):
            raise wrong_line(path, number, text, f"rows and columns of 1 to {len(rows)}, those of the file of nodes")
        return Entry(rows[own[0] - 1], rows[own[1] - 1], value, number, text)
    if not all(1 <= k <= MAX_DIRECTIONS for k in own[1::2]):
        raise wrong_line(path, number, text, f"directions of 1 to {MAX_DIRECTIONS}")
    return Entry((own[0], own[1]), (own[2], own[3]), value, number, text)

"""Matrices (DMIG) and nodes (GRID) in bulk data files of Nastran, such as punch files.

An entry of bulk data is a name and fields, in three formats: eight fields of eight characters in a line; with ``*``
after the name or at the beginning of the line four fields of sixteen characters; or fields separated by commas. Lines
that begin with a blank, ``+`` or ``*`` continue it. ``DMIG NAME 0 IFO TIN TOUT POLAR - NCOL`` begins a matrix,
``DMIG NAME GJ CJ - G1 C1 A1 B1 G2 ...`` gives the entries Ai + i Bi of the column of node GJ and direction CJ (MSC
Nastran Quick Reference Guide, DMIG and GRID).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mbfmu.util.errors import UserError

from .text_lines import MAX_DIRECTIONS, Entry, Place, integer_of, real_of, text_lines, wrong_line

NAME_WIDTH, SMALL_WIDTH, LARGE_WIDTH = 8, 8, 16  # characters
SMALL_COUNT, LARGE_COUNT = 8, 4  # fields in a line
SQUARE, SYMMETRIC = 1, 6  # IFO of a header
REAL_TYPES = (1, 2)  # TIN, of single and double precision; the others are complex
EXPONENT_WITHOUT_LETTER = re.compile(r"(?<=[\d.])([+-]\d+)$")  # 1.5+3 is 1.5E+3
FIRST_ENTRY = 4  # field of DMIG in which the entries of a column begin
ENTRY_WIDTH = 4  # node, direction, real and imaginary part
GRID_FIELDS = 6  # number, system, x, y, z, system of the displacements


class Field(NamedTuple):
    """A field of bulk data with its line."""

    text: str
    line: int
    whole: str  # text of the line


class Card(NamedTuple):
    """Entry of bulk data with its continuation lines."""

    name: str
    fields: list[Field]

    def text(self, k: int) -> str:
        """Return the text of a field; empty: it is not given."""
        return self.fields[k].text if k < len(self.fields) else ""


def has_cards(path: str | Path, name: str) -> bool:
    """Whether a file has bulk data with a name."""
    return any(line[:NAME_WIDTH].upper().startswith(name) for _, line in text_lines(path))


def read_grids(path: str | Path) -> dict[int, list[float]]:
    """Return the positions of all GRID entries by their numbers.

    Raises
    ------
    UserError
        A number cannot be read, a node is given twice, or is not in the basic coordinate system.
    """
    found: dict[int, list[float]] = {}
    for card in _cards(path, "GRID"):
        first = card.fields[0]
        node = _integer(path, first, "number of a node")
        place = [_real(path, card, k) for k in (2, 3, 4)]
        for k in (1, 5):
            if card.text(k) not in ("", "0"):
                raise wrong_line(
                    path, first.line, first.whole, "nodes in the basic coordinate system (0) with displacements in it"
                )
        if node in found:
            raise wrong_line(path, first.line, first.whole, f"each node once, and {node} was given before")
        found[node] = place
    return found


def read_dmig(path: str | Path, letter: str) -> Iterator[Entry]:
    """Yield the entries of the matrix whose name begins with a letter: M of the mass, K of the stiffness matrix.

    Raises
    ------
    UserError
        The file has no such matrix, or several; it is complex or not square; a field is wrong.
    """
    cards = list(_cards(path, "DMIG"))
    name = _name_of_matrix(path, cards, letter)
    header = None
    halves: dict[tuple[Place, Place], Entry] = {}  # entries of a square matrix whose counterpart is not given
    for card in cards:
        first = card.fields[0]
        if first.text.upper() != name:
            continue
        node = _integer(path, card.fields[1], "DMIG, name, number of a node") if len(card.fields) > 1 else -1
        if node == 0:
            header = card
            _check_header(path, card)
        elif header is None:
            raise wrong_line(path, first.line, first.whole, f"DMIG {name} 0 as the first line of the matrix")
        else:
            for entry in _column(path, card):
                if header.text(2) == str(SQUARE) and entry.row != entry.column and entry.value:
                    if halves.pop((entry.column, entry.row), None) is None:
                        halves[entry.row, entry.column] = entry
                yield entry
    for entry in halves.values():
        raise wrong_line(path, entry.line, entry.text, "a symmetric matrix; the counterpart of this entry is missing")


def _name_of_matrix(path: str | Path, cards: list[Card], letter: str) -> str:
    names = dict.fromkeys(card.text(0).upper() for card in cards)
    fitting = [name for name in names if name.startswith(letter) and not name[1:2].isdigit()]
    if len(fitting) != 1:
        raise UserError(
            f"file {str(path)!r} has the matrices {', '.join(names) or 'none'}; allowed: one whose name begins with "
            f"{letter}, such as {letter}AAX"
        )
    return fitting[0]


def _check_header(path: str | Path, card: Card) -> None:
    first = card.fields[0]
    if card.text(2) not in (str(SQUARE), str(SYMMETRIC)):
        raise wrong_line(path, first.line, first.whole, f"IFO of {SQUARE} (square) or {SYMMETRIC} (symmetric)")
    if card.text(3) not in map(str, REAL_TYPES):
        raise wrong_line(path, first.line, first.whole, "real matrices, TIN of 1 or 2")


def _column(path: str | Path, card: Card) -> Iterator[Entry]:
    """Yield the entries of a column."""
    column = _place(path, card.fields[1], card.text(2))
    fields = card.fields[FIRST_ENTRY:]
    for k in range(0, len(fields), ENTRY_WIDTH):
        own = fields[k : k + ENTRY_WIDTH]
        if not any(field.text for field in own):
            continue
        if len(own) > 3 and own[3].text:
            raise wrong_line(path, own[3].line, own[3].whole, "real entries, without an imaginary part")
        if len(own) < 3:
            raise wrong_line(path, own[0].line, own[0].whole, "node, direction, value")
        row = _place(path, own[0], own[1].text)
        value = _number(own[2].text)
        if not np.isfinite(value):
            raise wrong_line(path, own[2].line, own[2].whole, "node, direction, value, finite")
        yield Entry(row, column, value, own[0].line, own[0].whole)


def _place(path: str | Path, field: Field, direction: str) -> Place:
    node = _integer(path, field, "number of a node")
    if (integer_of(direction) or 0) not in range(1, MAX_DIRECTIONS + 1):
        raise wrong_line(
            path,
            field.line,
            field.whole,
            f"nodes with directions of 1 to {MAX_DIRECTIONS}. Scalar points, such as those of component modes, are not "
            "supported: write the matrices of the nodes",
        )
    return node, int(direction)


def _integer(path: str | Path, field: Field, allowed: str) -> int:
    found = integer_of(field.text)
    if found is None or found < 0:
        raise wrong_line(path, field.line, field.whole, allowed)
    return found


def _real(path: str | Path, card: Card, k: int) -> float:
    """Return a coordinate; an empty field is zero."""
    value = _number(card.text(k) or "0.0")
    if not np.isfinite(value):
        raise wrong_line(path, card.fields[0].line, card.fields[0].whole, "GRID, number of a node, 0, x, y, z")
    return value


def _number(text: str) -> float:
    """Return a number as Nastran writes it (1.5D+3, 1.5+3); nan: it is none."""
    return real_of(EXPONENT_WITHOUT_LETTER.sub(r"E\1", text.upper().replace("D", "E")))


def _cards(path: str | Path, name: str) -> Iterator[Card]:
    """Yield the entries of bulk data with a name, whole."""
    card: Card | None = None
    for number, line in text_lines(path):
        text = line.partition("$")[0].expandtabs(SMALL_WIDTH)
        if not text.strip():
            continue
        first, fields = _fields(number, text)
        if first.strip("*+ ") and first[0] not in "+*":
            if card is not None:
                yield card
            found = first.rstrip("* ").upper()
            card = Card(found, fields) if found == name else None
        elif card is not None:
            card.fields.extend(fields)
    if card is not None:
        yield card


def _fields(number: int, text: str) -> tuple[str, list[Field]]:
    """Return the first field of a line and its data."""
    if "," in text:
        parts = [part.strip() for part in text.split(",")]
        first, count = parts[0], LARGE_COUNT if "*" in parts[0] else SMALL_COUNT
        data = [*parts[1 : count + 1], *[""] * count][:count]
    else:
        first = text[:NAME_WIDTH].rstrip()
        width, count = (LARGE_WIDTH, LARGE_COUNT) if "*" in first else (SMALL_WIDTH, SMALL_COUNT)
        begins = [NAME_WIDTH + width * k for k in range(count)]
        data = [text[begin : begin + width].strip() for begin in begins]
    return first, [Field(part, number, text) for part in data]

"""Matrices of finite element programs, read from text files: CalculiX and Abaqus.

CalculiX writes ``job.sti``, ``job.mas`` and ``job.dof`` with ``*FREQUENCY, SOLVER=MATRIXSTORAGE``: entries "row column
value" of one triangle, rows counted from 1, and for every row "node.direction" (G. Dhondt: CalculiX CrunchiX user's
manual). Abaqus writes ``job_STIF1.mtx`` and ``job_MASS1.mtx`` with ``*MATRIX OUTPUT, FORMAT=MATRIX INPUT``: entries
"node, direction, node, direction, value" of one triangle or of both (Abaqus keywords guide, *MATRIX INPUT).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.mechanics.checks import one_of
from mbfmu.util.errors import UserError

from .fe_model import WRITTEN_DIGITS
from .interfaces import Interface

Array = NDArray[np.float64]
METERS_OF_SYSTEM = {"m": 1.0, "mm": 1e-3}  # forces are in N, so that masses are in kg and in t
Place = tuple[int, int]  # number of a node, direction from 1

MAX_DIRECTIONS = 6  # displacements, then rotations


class FileModel(NamedTuple):
    """Finite element model of files, in kg, m and N."""

    M: Any  # (dof n, dof n)
    K: Any
    nodes: Array  # (n, 3) m
    numbers: dict[int, int]  # place of a node by its number

    def interface(self, name: str, given: Any) -> Interface:
        """Return an interface whose nodes are given by numbers of the files, or by a function of positions."""
        interface = given if isinstance(given, Interface) else Interface(nodes=given)
        chosen: Any = interface.nodes
        if callable(chosen):
            return replace(interface, nodes=np.flatnonzero(np.asarray(chosen(self.nodes))))
        unknown = [node for node in np.ravel(chosen).tolist() if node not in self.numbers]
        if unknown:
            raise UserError(
                f"nodes of interface {name!r} contain {unknown[0]!r}; allowed: numbers of nodes of elements"
            )
        return replace(interface, nodes=[self.numbers[node] for node in np.ravel(chosen).tolist()])


def read_model(
    mass: str | Path, stiffness: str | Path, deck: str | Path, rows: str | Path | None, length_unit: str
) -> FileModel:
    """Return the model of files; arguments as for :meth:`FlexibleBody.from_files`.

    Raises
    ------
    UserError
        A file cannot be read or has a line that is not as described above; the deck does not contain a node.
    """
    one_of("length_unit", length_unit, tuple(METERS_OF_SYSTEM))
    places = None if rows is None else list(_places(rows))
    numbers, positions = read_nodes(deck)
    found = [_entries(path, places) for path in (mass, stiffness)]
    used = {node for entries in found for pair in entries for node, _ in pair}
    kept = [k for k, number in enumerate(numbers) if number in used]
    index = {numbers[k]: place for place, k in enumerate(kept)}
    directions = max((way for entries in found for pair in entries for _, way in pair), default=0)
    dof = 3 if directions <= 3 else MAX_DIRECTIONS
    meters = METERS_OF_SYSTEM[length_unit]
    scale = scipy.sparse.diags_array(np.tile([1.0] * 3 + [meters] * (dof - 3), len(kept)))
    M, K = (
        scale @ _matrix(path, entries, index, dof) @ scale / meters
        for path, entries in zip((mass, stiffness), found, strict=True)
    )
    return FileModel(M, K, meters * positions[kept], index)


def read_nodes(deck: str | Path) -> tuple[list[int], Array]:
    """Return the numbers and the positions (n, 3) of the nodes in the blocks ``*NODE`` of an input deck."""
    found: dict[int, list[float]] = {}
    is_block = False
    for number, text in _lines(deck):
        if text.startswith("*"):
            is_block = text[1:].split(",")[0].strip().upper() == "NODE"
        elif is_block:
            words = text.replace(",", " ").split()
            try:
                node, place = int(words[0]), [float(word) for word in words[1:]]
            except ValueError:
                node, place = 0, []
            if node < 1 or not 2 <= len(place) <= 3 or not np.all(np.isfinite(place)):
                raise _wrong(deck, number, text, "number of a node, x, y, z")
            if node in found:
                raise _wrong(deck, number, text, f"each node once, and {node} was given before")
            found[node] = [*place, 0.0][:3]
    if not found:
        raise UserError(f"file {str(deck)!r} has no nodes; allowed: an input deck with a block *NODE")
    return list(found), np.array(list(found.values()))


def _lines(path: str | Path) -> Iterator[tuple[int, str]]:
    """Yield the lines with their numbers, without comments (``**``) and empty lines."""
    try:
        with Path(path).open(encoding="utf-8", errors="replace") as file:
            for number, line in enumerate(file, 1):
                text = line.strip()
                if text and not text.startswith("**"):
                    yield number, text
    except OSError as error:
        raise UserError(f"file {str(path)!r} cannot be read ({error.strerror}); allowed: a text file") from error


def _wrong(path: str | Path, number: int, text: str, allowed: str) -> UserError:
    return UserError(f"line {number} of {str(path)!r} is {text[:60]!r}; allowed: {allowed}")


def _places(path: str | Path) -> Iterator[Place]:
    allowed = f"node.direction, with a direction of 1 to {MAX_DIRECTIONS}"
    for number, text in _lines(path):
        node, point, direction = text.partition(".")
        if not point or not (node.isdecimal() and direction.isdecimal()) or not 1 <= int(direction) <= MAX_DIRECTIONS:
            raise _wrong(path, number, text, allowed)
        yield int(node), int(direction)


def _entries(path: str | Path, places: list[Place] | None) -> dict[tuple[Place, Place], tuple[float, int]]:
    """Return values and numbers of lines by pairs of places, the smaller place first."""
    found: dict[tuple[Place, Place], tuple[float, int]] = {}
    repeated: list[tuple[int, str, float, tuple[float, int]]] = []
    for number, text in _lines(path):
        words = text.replace(",", " ").split()
        row, column, value = _entry(path, number, text, words, places)
        pair = (row, column) if row <= column else (column, row)
        if pair in found:
            repeated.append((number, text, value, found[pair]))
        found[pair] = (value, number)
    largest = max((abs(value) for value, _ in found.values()), default=0.0)
    for number, text, value, (other, line) in repeated:
        if abs(other - value) > WRITTEN_DIGITS * largest:
            raise _wrong(path, number, text, f"one value for an entry and its counterpart; line {line} has {other:g}")
    return found


def _entry(
    path: str | Path, number: int, text: str, words: list[str], places: list[Place] | None
) -> tuple[Place, Place, float]:
    allowed = "node, direction, node, direction, value" if places is None else "row, column, value"
    count = 4 if places is None else 2
    try:
        own, value = [int(word) for word in words[:count]], float(words[count])
    except (ValueError, IndexError):
        raise _wrong(path, number, text, allowed) from None
    if len(words) != count + 1 or not np.isfinite(value):
        raise _wrong(path, number, text, f"{allowed}, finite")
    if places is not None:
        if not all(1 <= k <= len(places) for k in own):
            raise _wrong(path, number, text, f"rows and columns of 1 to {len(places)}, those of the file of nodes")
        return places[own[0] - 1], places[own[1] - 1], value
    if not all(1 <= k <= MAX_DIRECTIONS for k in own[1::2]):
        raise _wrong(path, number, text, f"directions of 1 to {MAX_DIRECTIONS}")
    return (own[0], own[1]), (own[2], own[3]), value


def _matrix(
    path: str | Path, entries: dict[tuple[Place, Place], tuple[float, int]], index: dict[int, int], dof: int
) -> Any:
    rows, columns, values = [], [], []
    for pair, (value, number) in entries.items():
        for node, _ in pair:
            if node not in index:
                raise UserError(
                    f"line {number} of {str(path)!r} has the node {node}, which the deck does not contain; "
                    "allowed: positions of all nodes of the matrices, without internal nodes (negative numbers)"
                )
        i, j = (dof * index[node] + direction - 1 for node, direction in pair)
        rows += [i] if i == j else [i, j]
        columns += [j] if i == j else [j, i]
        values += [value] if i == j else [value, value]
    size = dof * len(index)
    return scipy.sparse.csc_array((values, (rows, columns)), shape=(size, size))

"""Finite element models in the text files of Abaqus, CalculiX and Nastran.

The content of a file decides by which reader it is read: bulk data of Nastran by :mod:`.nastran_files`, other files by
:mod:`.abaqus_files`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.mechanics.checks import one_of
from mbfmu.util.errors import UserError

from .abaqus_files import read_entries, read_node_blocks, read_rows
from .fe_model import WRITTEN_DIGITS
from .interfaces import Interface
from .nastran_files import has_cards, read_dmig, read_grids
from .text_lines import MAX_DIRECTIONS, Entry, Place, wrong_line

Array = NDArray[np.float64]
METERS_OF_SYSTEM = {"m": 1.0, "mm": 1e-3}  # forces are in N, so that masses are in kg and in t
Pairs = dict[tuple[Place, Place], tuple[float, int]]  # values and numbers of lines, the smaller place first


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
        A file cannot be read or has a line that is wrong; the deck does not contain a node.
    """
    one_of("length_unit", length_unit, tuple(METERS_OF_SYSTEM))
    places = None if rows is None else read_rows(rows)
    numbers, positions = read_nodes(deck)
    found = [_pairs(path, _entries(path, letter, places)) for path, letter in ((mass, "M"), (stiffness, "K"))]
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
    """Return the numbers and the positions (n, 3) of the nodes of an input deck."""
    is_nastran = has_cards(deck, "GRID") and not has_cards(deck, "*NODE")
    found = read_grids(deck) if is_nastran else read_node_blocks(deck)
    if not found:
        raise UserError(
            f"file {str(deck)!r} has no nodes; allowed: an input deck with a block *NODE, or with GRID entries"
        )
    return list(found), np.array(list(found.values()))


def _entries(path: str | Path, letter: str, places: list[Place] | None) -> Iterator[Entry]:
    """Yield the entries of a matrix by the reader for the file."""
    if places is None and has_cards(path, "DMIG"):
        return read_dmig(path, letter)
    return read_entries(path, places)


def _pairs(path: str | Path, entries: Iterable[Entry]) -> Pairs:
    """Return values and numbers of lines by pairs of places; of entries that are given twice the values must agree."""
    found: Pairs = {}
    repeated: list[tuple[Entry, tuple[float, int]]] = []
    for entry in entries:
        pair = (entry.row, entry.column) if entry.row <= entry.column else (entry.column, entry.row)
        if pair in found:
            repeated.append((entry, found[pair]))
        found[pair] = (entry.value, entry.line)
    largest = max((abs(value) for value, _ in found.values()), default=0.0)
    for entry, (other, line) in repeated:
        if abs(other - entry.value) > WRITTEN_DIGITS * largest:
            raise wrong_line(
                path,
                entry.line,
                entry.text,
                f"one value for an entry and its counterpart; line {line} has {other:g}",
            )
    return found


def _matrix(path: str | Path, entries: Pairs, index: dict[int, int], dof: int) -> Any:
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

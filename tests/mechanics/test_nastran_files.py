"""Bodies from DMIG matrices and GRID entries, in files that are written as the manual of Nastran describes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fe_models import block, bracket

import mbfmu as mb
from mbfmu.mechanics.flexible.matrix_files import read_nodes
from mbfmu.mechanics.flexible.nastran_files import read_dmig
from mbfmu.util.errors import UserError

BLOCK, BRACKET = block(), bracket()
LARGE, FREE, SMALL = "large", "free", "small"


def number(node: int) -> int:
    """Numbers in another order than that of the nodes in the file."""
    return 1000 - 7 * node


def real(value: float, width: int) -> str:
    """Return a number in a field: 1.5D+03 in large fields, 1.5+3 in small ones."""
    if width == 16:
        return f"{value:.8E}".replace("E", "D")
    mantissa, exponent = f"{value:.2E}".split("E")
    return f"{mantissa}{int(exponent):+d}"


def card(name: str, fields: list[Any], kind: str) -> list[str]:
    """Return the lines of bulk data in one of the three formats."""
    width, count = {LARGE: (16, 4), FREE: (0, 8), SMALL: (8, 8)}[kind]
    texts = [real(x, width) if isinstance(x, float) and width else str(x) for x in fields]
    star = "*" if kind == LARGE else ""
    lines = []
    for first in range(0, len(texts), count):
        head = f"{name}{star}" if first == 0 else star or "+"
        part = texts[first : first + count]
        if kind == FREE:
            lines.append(",".join([head, *part]))
        else:
            lines.append(f"{head:<8}" + "".join(f"{text:>{width}}" for text in part))
    return lines


def dmig(name: str, matrix: Any, dof: int, kind: str, form: int = 6) -> list[str]:
    """One triangle for the form 6, both for the form 1; the header is in small fields, as in punch files."""
    lines = [f"$ matrix {name}", f"DMIG    {name:<8}{0:>8}{form:>8}{2:>8}{0:>8}{'':>16}{len(matrix):>8}"]
    for j in range(len(matrix)):
        rows = [int(i) for i in np.flatnonzero(matrix[:, j]) if form == 1 or i >= j]
        entries = [x for i in rows for x in (number(i // dof), i % dof + 1, float(matrix[i, j]), "")]
        lines += card("DMIG", [name, number(j // dof), j % dof + 1, "", *entries], kind)
    return lines


def written(matrix: Any, kind: str) -> Any:
    """Return the numbers with the digits of a format."""
    return np.vectorize(lambda x: float(f"{x:.8E}"))(matrix) if kind == LARGE else matrix


def grids(nodes: Any, kind: str) -> list[str]:
    return [line for k, x in enumerate(nodes) for line in card("GRID", [number(k), "", *(float(c) for c in x)], kind)]


def write(path: Path, *lines: list[str]) -> None:
    path.write_text("\n".join(["SOL 103", "TITLE = GRID, a title", "BEGIN BULK", *(x for own in lines for x in own)]))


@pytest.mark.parametrize("kind", [LARGE, FREE])
@pytest.mark.parametrize(("model", "dof", "form"), [(BLOCK, 3, 6), (BRACKET, 6, 1)])
def test_a_body_of_a_punch_file_is_that_of_its_matrices(
    tmp_path: Path, kind: str, model: Any, dof: int, form: int
) -> None:
    """Both matrices and damping are in one file with the nodes; a comment, and blanks at the end of a line."""
    path = tmp_path / "job.pch"
    matrices = [dmig(name, A, dof, kind, form) for name, A in (("KAAX", model.K), ("MAAX", model.M))]
    write(path, grids(model.nodes, kind), *matrices, dmig("K4AAX", model.K, dof, kind))
    ends = [0] if dof == 6 else [int(k) for k in model.face(0, False)]
    interfaces = {"foot": [number(k) for k in ends]}
    found = mb.FlexibleBody.from_files(path, path, path, interfaces, modes=4)
    M, K, nodes = (written(A, kind) for A in (model.M, model.K, model.nodes))
    exact = mb.FlexibleBody.from_fe(M, K, nodes, {"foot": ends}, modes=4)
    np.testing.assert_allclose(found.frequencies, exact.frequencies, rtol=1e-9)
    np.testing.assert_allclose(found.com, exact.com, atol=1e-12 * exact.size)
    np.testing.assert_allclose(found.inertia, exact.inertia, atol=1e-12 * np.abs(exact.inertia).max())


def test_small_fields_have_two_entries_in_a_line(tmp_path: Path) -> None:
    matrix = np.array([[1.5e3, -2.5e-4, 7.0], [-2.5e-4, 3.0, 0.0], [7.0, 0.0, -1.25e11]])
    write(tmp_path / "job.dat", dmig("MAAX", matrix, 3, SMALL), grids([[1.0, -2.5e-4, 3e6]], SMALL))
    found = np.zeros((3, 3))
    for entry in read_dmig(tmp_path / "job.dat", "M"):
        found[entry.row[1] - 1, entry.column[1] - 1] = entry.value
    np.testing.assert_array_equal(found, np.tril(matrix))
    numbers, places = read_nodes(tmp_path / "job.dat")
    assert numbers == [1000]
    np.testing.assert_array_equal(places, [[1.0, -2.5e-4, 3e6]])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("       6       2", "       6       4", "line 10 of '.*real matrices, TIN of 1 or 2"),
        ("       6       2", "       2       2", "line 10 of '.*IFO of 1"),
        ("       6       2", "       1       2", "line 13 of '.*the counterpart of this entry is missing"),
        ("DMIG    KAAX           0", "$", "DMIG KAAX 0 as the first line of the matrix"),
        ("KAAX", "LAAX", "has the matrices LAAX; allowed: one whose name begins with K, such as KAAX"),
        ("3.00000000D+00", "3.0x", "line 15 of '.*node, direction, value, finite"),
        ("               2  2.00000000D+00", "               0  2.00000000D+00", "line 13 of '.*Scalar points"),
        ("               2  2.00000000D+00", "               7  2.00000000D+00", "line 13 of '.*directions of 1 to 6"),
        ("2.00000000D+00", "2.00000000D+00  1.00000000D+00", "line 13 of '.*without an imaginary part"),
    ],
)
def test_wrong_lines_are_refused_with_their_number(tmp_path: Path, old: str, new: str, message: str) -> None:
    matrix = np.array([[4.0, 2.0, 0.0], [2.0, 3.0, 0.0], [0.0, 0.0, 1.0]])
    path = tmp_path / "job.pch"
    write(path, grids([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], LARGE), [""], dmig("KAAX", matrix, 3, LARGE))
    text = path.read_text()
    assert text.count(old) >= 1
    path.write_text(text.replace(old, new))
    with pytest.raises(UserError, match=message):
        list(read_dmig(path, "K"))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ([1000, 3, 0.0, 0.0, 0.0], "nodes in the basic coordinate system"),
        ([1000, "", 0.0, 0.0, 0.0, 2], "nodes in the basic coordinate system"),
        ([1000, "", "x", 0.0, 0.0], "GRID, number of a node, 0, x, y, z"),
        (["node", "", 0.0, 0.0, 0.0], "allowed: number of a node"),
        ([993, "", 0.0, 0.0, 0.0], "each node once, and 993 was given before"),
    ],
)
def test_wrong_nodes_are_refused(tmp_path: Path, fields: list[Any], message: str) -> None:
    write(tmp_path / "job.dat", card("GRID", [993, "", 1.0, "", 2.0], FREE), card("GRID", fields, LARGE))
    with pytest.raises(UserError, match=f"line [56] of '.*{message}"):
        read_nodes(tmp_path / "job.dat")

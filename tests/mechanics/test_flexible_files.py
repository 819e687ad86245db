"""Bodies from files of finite element programs, and saved bodies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fe_models import block, bracket

import mbfmu as mb
from mbfmu.util.errors import UserError

BLOCK, BRACKET = block(), bracket()
CALCULIX = Path(__file__).parents[1] / "data" / "calculix"
FIRST, STEP = 11, 7  # numbers of nodes: 11, 18, 25, ...


def number(node: int) -> int:
    return FIRST + STEP * node


def write_deck(path: Path, nodes: Any, meters: float) -> None:
    lines = [f"{number(k)}, " + ", ".join(f"{x / meters:.12g}" for x in place) for k, place in enumerate(nodes)]
    loose = f"{number(len(nodes))}, 1.0, 2.0, 3.0"
    path.write_text(
        "\n".join(["** a comment", "*Heading", "text", "*Node, NSET=all", *lines, loose, "*Element", "1, 2"])
    )


def write_abaqus(path: Path, matrix: Any, dof: int, factor: Any, both: bool) -> None:
    lines = []
    for i, j in np.argwhere(matrix != 0.0):
        if both or i >= j:
            (a, p), (b, r) = divmod(int(i), dof), divmod(int(j), dof)
            lines.append(f"{number(a)},{p + 1}, {number(b)},{r + 1}, {matrix[i, j] * factor(p) * factor(r):.15e}")
    path.write_text("\n".join(lines))


def write_calculix(folder: Path, M: Any, K: Any, factor: float) -> None:
    """Rows in another order than that of the nodes."""
    order = np.random.default_rng(2).permutation(len(M))
    (folder / "job.dof").write_text("\n".join(f"{number(int(k) // 3)}.{k % 3 + 1}" for k in order))
    for ending, matrix in (("mas", M), ("sti", K)):
        own = matrix[np.ix_(order, order)]
        lines = [f"{i + 1:10d} {j + 1:10d} {factor * own[i, j]:.13e}" for i, j in np.argwhere(own != 0.0) if i <= j]
        (folder / f"job.{ending}").write_text("\n".join(lines))


def check_same(found: mb.FlexibleBody, exact: mb.FlexibleBody) -> None:
    np.testing.assert_allclose(found.frequencies, exact.frequencies, rtol=1e-8)
    np.testing.assert_allclose(found.com, exact.com, atol=1e-10 * exact.size)
    np.testing.assert_allclose(found.inertia, exact.inertia, atol=1e-10 * np.abs(exact.inertia).max())


@pytest.mark.parametrize("unit", ["m", "mm"])
@pytest.mark.parametrize("both", [False, True])
def test_matrices_of_abaqus_with_rotations(tmp_path: Path, unit: str, both: bool) -> None:
    """In t, mm, N a force of 1 N by 1 mm is 1e3 N/m; rotations are in rad in both systems."""
    meters = 1.0 if unit == "m" else 1e-3
    write_deck(tmp_path / "job.inp", BRACKET.nodes, meters)
    for name, matrix in (("MASS1", BRACKET.M), ("STIF1", BRACKET.K)):

        def factor(direction: int) -> float:
            return meters**0.5 if direction < 3 else meters**-0.5

        write_abaqus(tmp_path / f"{name}.mtx", matrix, 6, factor, both)
    ends = {"foot": [number(0)], "tip": [number(5)]}
    files = tmp_path / "MASS1.mtx", tmp_path / "STIF1.mtx", tmp_path / "job.inp"
    found = mb.FlexibleBody.from_files(*files, ends, length_unit=unit, modes=4)
    check_same(found, mb.FlexibleBody.from_fe(BRACKET.M, BRACKET.K, BRACKET.nodes, {"foot": [0], "tip": [5]}, modes=4))


def calculix(folder: Path, **interfaces: Any) -> mb.FlexibleBody:
    files = [folder / name for name in ("job.mas", "job.sti", "job.inp")]
    own = interfaces or {"left": lambda x: x[:, 0] < 1e-9}
    return mb.FlexibleBody.from_files(*files, own, rows=folder / "job.dof", length_unit="mm", modes=4)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_deck(tmp_path / "job.inp", BLOCK.nodes, 1e-3)
    write_calculix(tmp_path, BLOCK.M, BLOCK.K, 1e-3)
    return tmp_path


def test_matrices_of_calculix(folder: Path) -> None:
    exact = mb.FlexibleBody.from_fe(BLOCK.M, BLOCK.K, BLOCK.nodes, {"left": BLOCK.face(0, False)}, modes=4)
    check_same(calculix(folder), exact)
    check_same(calculix(folder, left=[number(int(k)) for k in BLOCK.face(0, False)]), exact)


def test_files_that_calculix_has_written_have_its_frequencies() -> None:
    """Described in ``tests/data/calculix``; CalculiX writes seven digits."""
    files = [CALCULIX / f"block.{ending}" for ending in ("mas", "sti", "inp")]
    rest: dict[str, Any] = {"rows": CALCULIX / "block.dof", "length_unit": "mm", "modes": 4}
    for wall in ([1, 4, 11, 14], lambda x: x[:, 0] < 1e-9):
        body = mb.FlexibleBody.from_files(*files, {"wall": wall}, **rest)
        np.testing.assert_allclose(
            body.frequencies, [0.3410993e5, 0.3818945e5, 0.8405359e5, 0.1465560e6], rtol=2e-7, atol=0.0
        )
        assert body.mass == pytest.approx(7850.0 * 0.06 * 0.02 * 0.015, rel=1e-12)
        np.testing.assert_allclose(body.com, (0.03, 0.0, 0.0), atol=1e-14)


@pytest.mark.parametrize(
    ("name", "line", "message"),
    [
        ("job.sti", "1 1", "line 3 of '.*job.sti' is '1 1'; allowed: row, column, value"),
        ("job.sti", "1 1 nan", "line 3 of '.*allowed: row, column, value, finite"),
        ("job.sti", "1 1 1_0", "line 3 of '.*allowed: row, column, value, finite"),
        ("job.sti", "1 1 \u0661.5", "line 3 of '.*allowed: row, column, value, finite"),
        ("job.sti", "1 \u0661 1.5", "line 3 of '.*allowed: row, column, value"),
        ("job.sti", "1 9999 1.0", "line 3 of '.*rows and columns of 1 to"),
        ("job.sti", "2 2 5e9\n2 2 6e9", "one value for an entry"),
        ("job.dof", "12.7", r"line 3 of '.*job.dof' is '12.7'; allowed: node.direction"),
        ("job.dof", "4", "line 3 of '.*node.direction"),
        ("job.mas", "\x00\x01 text", "line 3 of '.*job.mas'"),
    ],
)
def test_damaged_lines_are_refused_with_their_number(folder: Path, name: str, line: str, message: str) -> None:
    lines = (folder / name).read_text().splitlines()
    (folder / name).write_text("\n".join([*lines[:2], line, *lines[3:]]))
    with pytest.raises(UserError, match=message):
        calculix(folder)


def test_saved_bodies_with_any_wrong_byte_are_read_or_refused(tmp_path: Path) -> None:
    """Also wrong versions, methods and flags of the archive, in which another kind of exception is raised."""
    path = tmp_path / "body.npz"
    mb.FlexibleBody.from_fe(BLOCK.M, BLOCK.K, BLOCK.nodes, {"left": BLOCK.face(0, False)}, modes=1).save(path)
    whole = path.read_bytes()
    central = whole.index(b"PK\x01\x02")
    refused = 0
    for k in (*range(30), *range(central, central + 46)):
        for value in (0, 9, 99, 255):
            path.write_bytes(whole[:k] + bytes([value]) + whole[k + 1 :])
            try:
                mb.FlexibleBody.load(path)
            except UserError:
                refused += 1
    assert refused > 50


def test_nodes_that_are_wrong_or_missing_are_refused(folder: Path) -> None:
    with pytest.raises(UserError, match="nodes of interface 'left' contain 3"):
        calculix(folder, left=[3, 11, 18])
    text = (folder / "job.inp").read_text()
    for wrong, message in (
        (text.replace("\n18, ", "\n18, x", 1), "line 6 of '.*number of a node, x, y, z"),
        (text.replace("\n18, ", "\n11, ", 1), "line 6 of '.*each node once"),
        (text.replace("\n18, ", "\n19, ", 1), "line [0-9]+ of '.*has the node 18"),
        ("*Element\n1, 2", "has no nodes"),
    ):
        (folder / "job.inp").write_text(wrong)
        with pytest.raises(UserError, match=message):
            calculix(folder)
    (folder / "job.inp").unlink()
    with pytest.raises(UserError, match=r"job.inp' cannot be read \(No such file"):
        calculix(folder)


def saved(path: Path) -> mb.FlexibleBody:
    body = mb.FlexibleBody.from_fe(
        BRACKET.M,
        BRACKET.K,
        BRACKET.nodes,
        {"foot": [0], "tip": [5]},
        modes=3,
        damping=0.02,
        geometric_stiffness=BRACKET.geometric_stiffness,
    )
    body.save(path)
    return body


class Recorder:
    """Record and numbers that kernels get."""

    def __init__(self, body: mb.FlexibleBody) -> None:
        self.numbers: list[Any] = []
        record: dict[str, Any] = {}
        body.fill(record, self.keep)
        for name in body.interfaces:
            body.fill_node(name, record, self.keep)

    def keep(self, numbers: Any) -> int:
        self.numbers.append(np.array(numbers))
        return 0


def test_a_saved_body_is_the_same_bit_by_bit(tmp_path: Path) -> None:
    body = saved(tmp_path / "body.npz")
    found = mb.FlexibleBody.load(tmp_path / "body.npz")
    assert (found.frame, list(found.interfaces), found.stiffening) == (body.frame, list(body.interfaces), True)
    for one, other in zip(Recorder(found).numbers, Recorder(body).numbers, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(found.displaced(np.ones(found.modes)), body.displaced(np.ones(body.modes)))


def test_damaged_files_of_bodies_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "body.npz"
    saved(path)
    content = dict(np.load(path))
    for changed, message in (
        ({"version": 99}, "has the version 99; allowed: 1"),
        ({"format": "other"}, "contains no flexible body"),
        ({"J2": content["J2"][:5]}, r"array 'J2' .* has the shape"),
        ({"com": np.full(3, np.nan)}, "array 'com' .* not finite"),
    ):
        np.savez(path, **(content | changed))
        with pytest.raises(UserError, match=message):
            mb.FlexibleBody.load(path)
    np.savez(path, **{name: own for name, own in content.items() if name != "motion"})
    with pytest.raises(UserError, match=r"array 'motion' .* is missing"):
        mb.FlexibleBody.load(path)
    saved(path)
    whole = path.read_bytes()
    for part in (0, 10, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:part])
        with pytest.raises(UserError, match="cannot be read"):
            mb.FlexibleBody.load(path)
    with pytest.raises(UserError, match="cannot be read"):
        mb.FlexibleBody.load(tmp_path / "none.npz")

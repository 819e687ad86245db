"""Study and scene files with what no reader expects, and rows that no table holds as they are."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

import mbfmu as mb
from mbfmu.ensemble.definition import define, read_study
from mbfmu.ensemble.records import Records, read_table, storable
from mbfmu.ensemble.variation import toleranced
from mbfmu.ensemble.worker import STATUS_FAILED, Outcome
from mbfmu.modeling.scene import load_scene
from mbfmu.studies.error_target import read_target
from mbfmu.util.errors import UserError

ODD = {
    "deep nesting": ("a = " + 5000 * "[" + 5000 * "]", "nested too deeply"),
    "a number of 5000 digits": (f"a = {5000 * '1'}", "not valid TOML: Exceeds the limit"),
    "a number of 65 bits": (
        "[fixed]\na = [1, {b = 9223372036854775808}]",
        "fixed.a.b has a whole number of more than 64",
    ),
    "no UTF-8": (b"a = '\xff'", "not valid TOML: 'utf-8' codec"),
    "a carriage return": ("a = 1\rb = 2", "not valid TOML"),
}


@pytest.mark.parametrize("name", ODD)
@pytest.mark.parametrize("read", [read_study, lambda path: load_scene(str(path))], ids=["study", "scene"])
def test_odd_files_are_refused_with_a_message(read: Any, name: str, tmp_path: Path) -> None:
    content, why = ODD[name]
    path = tmp_path / "odd.toml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(UserError, match=why) as told:
        read(path)
    assert "odd.toml" in str(told.value)
    assert len(str(told.value)) < 500


@pytest.mark.parametrize("text", ["\ufeff{}", "\ufeff# é\r\n{}\r\n"])
def test_a_byte_order_mark_is_no_part_of_a_file(text: str, tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    path.write_bytes(text.format('model = "fourbar"').encode())
    assert load_scene(str(path)).name == "fourbar/own"
    path.write_bytes(text.format('scene = "fourbar"').encode())
    assert read_study(path) == {"scene": "fourbar"}


@pytest.mark.parametrize(
    "text",
    [
        "1" * 100_000,
        "1" * 50_000 + " m +- " + "1" * 50_000 + "x y",
        100_000 * "1.",
        "-" * 100_000,
        "1 m" + 100_000 * " ",
    ],
)  # fmt: skip
def test_long_texts_are_refused_at_once(text: str) -> None:
    begin = time.process_time()
    for read in (lambda: toleranced("x", text, "m"), lambda: read_target(text)):
        with pytest.raises(UserError) as told:
            read()
        assert len(str(told.value)) < 500
    assert time.process_time() - begin < 1.0


@pytest.mark.parametrize("text", ["1 m +- 1 mm", "1.5e0m+-.1%", "1. m +/- 1.e-3 m", "-2 m ± 1 mm"])
def test_tolerances_are_read_as_before(text: str) -> None:
    center = {"1 m +- 1 mm": 1.0, "1.5e0m+-.1%": 1.5, "1. m +/- 1.e-3 m": 1.0, "-2 m ± 1 mm": -2.0}[text]
    assert toleranced("x", text, "m").distribution.mean() == pytest.approx(center)


LARGE = [2**63 - 1, 2**63, 2**64, -(2**70), 10**400, 7]


@pytest.mark.parametrize("value", LARGE)
def test_a_row_that_a_table_cannot_hold_does_not_end_a_study(value: int, tmp_path: Path) -> None:
    """Numbers beyond 64 bits and halves of characters: written, and taken up at a resume."""
    study = define({"scene": "fourbar", "vary": {"gravity": [1.0, 2.0, 3.0]}, "measure": {"a": "end crank.angle"}})
    records = Records(tmp_path / "a", study)
    records.begin(resume=False)
    points: list[dict[str, Any]] = [{"gravity": 1.0}, {"gravity": value}, {"gravity": 3}]
    outcomes = [Outcome(k, (1.0,), STATUS_FAILED, f"half of a pair: \udc80 {k}", 0.0, 0.0, None) for k in range(3)]
    records.add(outcomes[:2], points[:2])
    records.write()
    records.add(outcomes[2:], points[2:])
    records.close()
    again = Records(tmp_path / "a", study)
    again.begin(resume=True)
    again.finish([again.key(point) for point in points])
    again.close()
    rows = read_table(tmp_path / "a").to_pylist()
    assert [row["message"] for row in rows] == [f"half of a pair: \\udc80 {k}" for k in range(3)]
    assert rows[1]["gravity"] == (float(value) if abs(value) < 10**308 else float("inf"))


def test_columns_that_a_table_holds_are_left_as_they_are() -> None:
    for column in ([1, 2, None], [1.5, None], ["a", "é"], [True, False], [2**63 - 1, -(2**63)]):
        assert storable(column) == column
        assert [type(x) for x in storable(column)] == [type(x) for x in column]
    assert storable([1, 2**63, None]) == [1.0, 2.0**63, None]


def test_a_study_without_its_scheduler_leaves_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mbfmu.ensemble.engine.SCHEDULER_TIMEOUT", 0.5)
    told: dict[str, Any] = {"stop_time": 0.1, "scheduler": "tcp://127.0.0.1:9"}
    for _ in range(2):  # the second time nothing is in its way
        with pytest.raises(UserError, match="does not answer"):
            mb.study("fourbar", {"gravity": [1.0]}, {"a": "end crank.angle"}, folder=tmp_path / "new" / "a", **told)
        assert list(tmp_path.iterdir()) == []
    own = tmp_path / "own"
    own.mkdir()
    with pytest.raises(UserError, match="does not answer"):
        mb.study("fourbar", {"gravity": [1.0]}, {"a": "end crank.angle"}, folder=own, **told)
    assert list(tmp_path.iterdir()) == [own], "a folder that was there stays, empty"
    assert list(own.iterdir()) == []

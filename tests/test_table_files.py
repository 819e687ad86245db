"""Tables of CSV and Parquet files: units, interpolation, and messages that name the line."""

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import mbfmu as mb
from mbfmu.mechanics import Variable
from mbfmu.mechanics.curve import curve
from solvers.options import Statistics

TIMES, HEIGHTS = np.array([0.0, 100.0, 250.0, 400.0, 600.0]), np.array([0.0, 12.0, -3.0, 5.0, 8.0])  # ms and mm


def written(folder: Path, text: str | bytes) -> Path:
    path = folder / "road.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def rows_of(*columns: np.ndarray) -> str:
    return "\n".join(",".join(repr(float(x)) for x in row) for row in zip(*columns, strict=True))


def value(table: mb.Table, t: float) -> float:
    rows = table.rows("a table")
    return float(curve(rows.ravel(), 0, len(rows), t)[0])


def test_units_of_the_header_are_converted_and_the_interpolation_is_chosen(tmp_path: Path) -> None:
    """Byte order mark, lines of Windows and empty lines included."""
    text = "time [min],note,road.height [mm],angle [deg]\r\n\r\n" + "\r\n".join(
        f"{t / 6e4},dry,{x},{x}" for t, x in zip(TIMES, HEIGHTS, strict=True)
    )
    path = written(tmp_path, b"\xef\xbb\xbf" + text.encode())
    spline, line = (mb.read_table(path, "road.height", kind=kind) for kind in ("spline", "linear"))
    seconds, meters = 1e-3 * TIMES, 1e-3 * HEIGHTS
    exact = CubicSpline(seconds, meters, bc_type="natural")
    for t in (0.03, 0.2, 0.55):
        assert value(spline, t) == pytest.approx(float(exact(t)), abs=1e-15)
        assert value(line, t) == pytest.approx(np.interp(t, seconds, meters), abs=1e-15)
    assert np.allclose(mb.read_table(path, "angle").y, np.deg2rad(HEIGHTS), rtol=1e-15)


@pytest.mark.parametrize("header", ["time (ms),force [N]", "time [s],force (kN)", "time [s],force(lbf),left"])
def test_units_in_round_brackets_are_refused(tmp_path: Path, header: str) -> None:
    """They were part of the name, so that the values were not converted; an index in a name is allowed."""
    rows = "\n".join(",".join("01"[k] for _ in header.split(",")) for k in range(2))
    with pytest.raises(mb.UserError, match=r"road.csv': the name of a column is '.*\)'; allowed: units in square"):
        mb.read_table(written(tmp_path, f"{header}\n{rows}"))
    table = mb.read_table(written(tmp_path, "time [s],stress(12),angle (0)\n0,0,0\n1,5,0"), "stress(12)")
    assert np.array_equal(table.y, [0.0, 5.0])


def test_outputs_of_a_run_are_read_again(tmp_path: Path) -> None:
    outputs = (Variable("arm.angle", "rad", "Angle"),)
    result = mb.Result(
        t=TIMES, values=np.sin(TIMES)[:, np.newaxis], variables=outputs, statistics=Statistics(), wall_time=0.0
    )
    result.write_csv(tmp_path / "outputs.csv")
    table = mb.read_table(tmp_path / "outputs.csv", "arm.angle")
    assert np.array_equal(table.x, result.t)
    assert np.array_equal(table.y, result["arm.angle"])


def test_a_parquet_file_is_read_as_a_text_file_is(tmp_path: Path) -> None:
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "road.parquet"
    columns = {"time [s]": TIMES, "height [mm]": HEIGHTS, "note": ["dry"] * 5}
    parquet.write_table(arrow.table(columns), path)
    table = mb.read_table(path, "height", kind="linear", beyond="hold")
    assert np.array_equal(table.x, TIMES)
    assert np.allclose(table.y, 1e-3 * HEIGHTS, rtol=1e-15)
    assert (table.kind, table.beyond) == ("linear", "hold")
    parquet.write_table(arrow.table({"time": [0.0, 1.0, 2.0], "height": [1.0, None, 2.0]}), path)
    with pytest.raises(mb.UserError, match=r"row 2: column 'height' is nan; allowed: finite numbers"):
        mb.read_table(path)
    path.write_text("no table")
    with pytest.raises(mb.UserError, match="is not a Parquet file"):
        mb.read_table(path)


@pytest.mark.parametrize(
    ("text", "column", "message"),
    [
        ("", "", r"is empty; allowed: a line of names such as 'time \[s\],road.height \[mm\]'"),
        ("time,h\n", "", "has 0 rows of numbers; allowed: at least two"),
        ("time,h\n0,1\n", "", "has 1 rows of numbers; allowed: at least two"),
        ("time\n0\n1\n", "", "allowed: times in the first column, and one column or more"),
        ("0,1\n1,2\n", "", "the first line is '0,1'; allowed: names of the columns"),
        ("t;h\n0,0;1,5\n", "", "is separated by semicolons; allowed: commas, and points in decimal fractions"),
        ("t\th\n0\t1\n", "", "is separated by tabs"),
        ("t,h\n0,1\n1,2,5\n", "h", "line 3: the line has 3 cells; allowed: 2, .*points, not commas"),
        ("t,h\n0,1\n\n1,\n", "h", "line 4: column 'h' is ''; allowed: a number"),
        ("t,h [m]\n0,1\n1,dry\n", "h", "line 3: column 'h.*is 'dry'; allowed: a number"),
        ("t,h\n0,1\n1,nan\n", "h", "line 3: column 'h' is nan; allowed: finite numbers"),
        ("t,h\n0,1\n1,2\n1,3\n", "h", "line 4: the time is 1 after 1; allowed: times that increase from row to row"),
        ("t,h,g\n0,1,2\n1,2,3\n", "", "has the columns 'h', 'g'; give the name of one of them"),
        ("t,height,g\n0,1,2\n1,2,3\n", "heigth", "has no column 'heigth'; did you mean 'height'?"),
        ("t,h\n0,1\n1,2\n", "t", "has no column 't'"),
        ("t,h,h\n0,1,2\n1,2,3\n", "h", "allowed: a different name for each column"),
        ("t,h [furlong]\n0,1\n1,2\n", "h", "column 'h' of file .*unit is 'furlong'; allowed: such as 'N.m'"),
        ("t [m],h\n0,1\n1,2\n", "h", "the unit of the first column, 't', is 'm'; allowed: a unit of time"),
        ("t,h [m\n0,1\n1,2\n", "h", "the name of a column is 'h .m'; allowed: such as 'road.height .mm.'"),
        (b"t,h\xff\n0,1\n", "h", "is not text in UTF-8"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_table_is_refused_with_its_line(
    tmp_path: Path, text: str | bytes, column: str, message: str
) -> None:
    with pytest.raises(mb.UserError, match=message):
        mb.read_table(written(tmp_path, text), column)


def test_a_file_that_is_missing_and_a_kind_that_is_none_are_refused(tmp_path: Path) -> None:
    for name in ("none.csv", "none.parquet"):
        with pytest.raises(mb.UserError, match=f"{name}.*cannot be read"):
            mb.read_table(tmp_path / name)
    path = written(tmp_path, "t,h\n0,1\n1,2\n")
    with pytest.raises(
        mb.UserError, match=r"kind of column 'h' of file .*road.csv' is 'cubic'; allowed: 'spline', 'monotone'"
    ):
        mb.read_table(path, kind="cubic")


def test_many_rows_are_read_in_a_time_proportional_to_their_number(tmp_path: Path) -> None:
    times = 1e-3 * np.arange(100_000)
    table = mb.read_table(written(tmp_path, "t,h\n" + rows_of(times, np.sin(times))), kind="linear")
    assert np.array_equal(table.x, times)

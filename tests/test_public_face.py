"""What ``import mbfmu`` gives, and the objects that answer."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import mbfmu as mb
from mbfmu.mechanics import Variable
from mbfmu.session.run import communication_points, run
from solvers import Statistics


def swing(load: object = 0.0) -> mb.Mechanism:
    """A rod of 1 kg and 1 m that a torque turns, without weight: 3 t / m l^2 in rad/s2."""
    m = mb.Mechanism(gravity=(0.0, 0.0, 0.0))
    arm = m.body("arm", m.ground, mb.Revolute(start=0.0, fixed=True), **mb.rod(mass=1.0, length=1.0))
    m.force("motor", mb.JointForce(magnitude=load), arm)
    m.output("arm.angle", arm.angle(), "angle of the arm")
    m.output("arm.rate", arm.rate(), "its rate")
    return m


@pytest.fixture(scope="module")
def result() -> mb.Result:
    return mb.simulate(swing(1.0), 1.0, interval=0.1, solver="adams", tolerance=1e-8)


def test_every_name_is_there_and_nothing_is_loaded_before_it_is_used() -> None:
    assert {"Mechanism", "simulate", "export", "compare", "equilibrium", "linearize", "modes", "view"} <= set(dir(mb))
    for name in mb.__all__:
        assert getattr(mb, name) is not None
    heavy = "import sys, mbfmu; print([m for m in ('numba', 'matplotlib', 'fmpy', 'scipy') if m in sys.modules])"
    assert subprocess.check_output([sys.executable, "-c", heavy], text=True).strip() == "[]"


def test_the_command_imports_no_package_before_it_is_needed() -> None:
    """Each of these packages takes 0.1 s or more to import; all commands would need this time."""
    code = """
import contextlib, io, sys
from mbfmu.cli import main
with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()):
    main(["--help"])
heavy = ("matplotlib", "fmpy", "pandas", "pyarrow", "sksundae", "dask")
parts = ("integrate", "interpolate", "io", "linalg", "optimize", "sparse", "spatial", "special", "stats")
print([m for m in (*heavy, *(f"scipy.{part}" for part in parts)) if m in sys.modules])
"""
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"


def test_a_mechanism_is_simulated_as_it_is(result: mb.Result) -> None:
    assert not result.failure
    np.testing.assert_allclose(result["arm.angle"], 1.5 * result.t**2, atol=1e-7)
    assert result.unit("arm.rate") == "rad/s"
    assert result.names[:2] == ("arm.angle", "arm.rate")
    with pytest.raises(mb.UserError, match=r"no output 'arm\.angel'; did you mean 'arm\.angle'"):
        result["arm.angel"]


def test_inputs_are_numbers_or_functions_of_time() -> None:
    """A function is evaluated at the solver's times."""
    m, h = swing(mb.Input(name="torque", unit="N.m")), 0.1
    held = mb.simulate(m, 1.0, interval=h, solver="adams", tolerance=1e-9, inputs={"torque": 2.0})
    np.testing.assert_allclose(held["arm.rate"], 6.0 * held.t, atol=1e-7)
    rising = mb.simulate(m, 1.0, interval=h, solver="adams", tolerance=1e-9, inputs={"torque": lambda t: 2.0 * t})
    np.testing.assert_allclose(rising["arm.rate"], 3.0 * rising.t**2, atol=1e-7)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"solvr": "ida"}, "has no argument 'solvr'; did you mean 'solver'"),
        ({"solver": "id"}, "solver is 'id'"),
        ({"interval": 0.0}, r"interval is .*; allowed: finite and greater than zero"),
        ({"inputs": {"force": 1.0}}, "there is no input 'force'"),
        ({"inputs": [1.0]}, r"inputs are \[1\.0\]; allowed: numbers or functions of time"),
    ],
)
def test_what_is_wrong_is_reported(given: dict[str, object], message: str) -> None:
    with pytest.raises(mb.UserError, match=message):
        mb.simulate(swing(), 1.0, **given)  # type: ignore[arg-type]
    with pytest.raises(mb.UserError, match="model is 3; allowed: a Mechanism, or an instance of a subclass"):
        mb.simulate(3, 1.0)  # type: ignore[arg-type]


def test_a_result_is_saved_and_loaded_whole(result: mb.Result, tmp_path: Path) -> None:
    result.save(tmp_path / "run.npz")
    again = mb.Result.load(tmp_path / "run.npz")
    np.testing.assert_array_equal(again.values, result.values)
    np.testing.assert_array_equal(again.t, result.t)
    for name in ("variables", "statistics", "settings", "name", "failure", "diagnostics", "title"):
        assert getattr(again, name) == getattr(result, name)
    for content in (b"", b"no archive"):
        (tmp_path / "bad.npz").write_bytes(content)
        with pytest.raises(mb.UserError, match="is not a saved result"):
            mb.Result.load(tmp_path / "bad.npz")


@pytest.mark.parametrize("change", [{"t": np.zeros(3)}, {"values": np.zeros(11)}, {"t": np.array(["a"] * 11)}])
def test_arrays_that_do_not_belong_together_are_no_result(result: mb.Result, tmp_path: Path, change: Any) -> None:
    result.save(tmp_path / "run.npz")
    with np.load(tmp_path / "run.npz") as file:
        arrays = dict(file) | change
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(mb.UserError, match=r"is not a saved result: times .* do not belong together"):
        mb.Result.load(tmp_path / "bad.npz")


def test_an_unwritable_folder_is_reported(result: mb.Result, tmp_path: Path) -> None:
    for write in (result.save, result.write_csv):
        for path in (tmp_path, tmp_path / "none" / "run.npz"):
            with pytest.raises(mb.UserError, match="cannot be written"):
                write(path)


@pytest.mark.parametrize(("start", "said"), [(5, "start is 5; allowed: positions"), ({0: 1.0}, "has no coordinate 0")])
def test_a_start_that_is_none_is_refused(start: Any, said: str) -> None:
    with pytest.raises(mb.UserError, match=said):
        mb.equilibrium(swing(), start=start)


def test_what_moves_no_mass_is_not_linearized() -> None:
    m = mb.Mechanism()
    m.body("b", m.ground, mb.Planar(), mass=1.0)
    for ask in (mb.linearize, mb.modes, lambda m: mb.equilibrium(m).stability):
        with pytest.raises(mb.UserError, match=r"no inertia: coordinate\(s\) 'b.angle'"):
            ask(m)


@pytest.mark.parametrize("solver", ["adams", "radau", "ida"])
def test_outputs_do_not_depend_on_how_many_are_recorded_at_once(solver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    reported: list[list[float]] = []
    values = []
    for rows, brief in ((7, 0.0), (100, np.inf)):
        monkeypatch.setattr("mbfmu.session.run.FIRST_BATCH_SIZE", rows)
        monkeypatch.setattr("mbfmu.session.run.SHORT_BATCH_TIME", brief)
        reported.append([])
        times = communication_points(2.0, 0.005)
        values.append(run(swing(), mb.Settings(solver=solver), times, progress=reported[-1].append).values)
    np.testing.assert_array_equal(values[0], values[1])
    assert [len(told) for told in reported] == [58, 3]  # of 7 each, and of 100, 200 and what is left


def test_a_result_shows_itself(result: mb.Result) -> None:
    assert repr(result) == "<Result of mechanism, adams, tolerance 1e-8: 11 times from 0 to 1 s, 4 outputs>"
    page = result._repr_html_()
    assert "<td>arm.angle</td><td>rad</td><td>0</td><td>1.5</td>" in page
    figure = result.plot()
    assert [ax.get_ylabel() for ax in figure.axes] == [
        "angle [rad]", "angular velocity [rad/s]",
    ]  # fmt: skip
    checks = result.plot("energy_*").axes
    assert [ax.get_ylabel() for ax in checks] == ["energy error [J]", "energy [J]"]
    assert [ax.get_yscale() for ax in checks] == ["log", "linear"]
    assert figure.get_suptitle() == "mechanism, adams, tolerance 1e-8"
    assert len(result.plot("arm.rate").axes) == 1


def made(columns: dict[str, Any], **how: Any) -> mb.Result:
    """A result of outputs in m by name, at ten times."""
    values = np.column_stack([np.broadcast_to(column, 10) for column in columns.values()])
    variables = tuple(Variable(name, "m", "") for name in columns)
    return mb.Result(np.arange(10.0), values, variables, Statistics(), 1.0, name="a/b", settings=mb.Settings(), **how)


def test_curves_that_lie_on_each_other_are_distinguishable() -> None:
    """Also where they do not move: the second is dashed, over the wide first."""
    four = mb.simulate(mb.models()["fourbar"](), 0.2, solver="adams")
    still = made({"x": -5.718, "y": -5.718 + 1e-11 * np.arange(10.0)})
    for result, names in ((four, ("crank.angle", "rocker.angle")), (still, ("x", "y"))):
        below, above = result.plot(*names).axes[0].lines
        assert (below.get_linestyle(), above.get_linestyle()) == ("-", "--")
        assert below.get_linewidth() > 2.0 * above.get_linewidth()
    apart = made({"x": 0.0, "y": 1.0}).plot().axes[0].lines
    assert [line.get_linestyle() for line in apart] == ["-", "-"]
    for level in (0.0, 1.0):  # all on each other, and all apart: colors begin again after ten
        dozen = made({f"y{k}": level * k for k in range(12)}).plot().axes[0].lines
        looks = {
            (line.get_color(), line.get_linestyle(), line.get_linewidth(), str(line._dash_pattern)) for line in dozen
        }
        assert len(looks) == 12
    assert [line.get_linestyle() for line in dozen] == ["-"] * 10 + ["--"] * 2


def test_a_panel_does_not_show_rounding() -> None:
    low, high = made({"x": -5.718 + 1e-11 * np.arange(10.0)}).plot().axes[0].get_ylim()
    assert (low, high) == pytest.approx((-6.0, -5.43), abs=0.01)


def test_a_logarithmic_panel_begins_where_a_residual_does() -> None:
    ax = made({"residual": np.array([0.0, *np.logspace(-40, -6, 9)])}).plot().axes[0]
    assert ax.get_yscale() == "log"
    assert ax.get_ylim() == pytest.approx((1e-15, 2e-6))
    assert np.isnan(ax.lines[0].get_ydata()[0]), "zero has no logarithm"


def test_a_dozen_curves_are_drawn_in_a_panel_and_the_rest_on_request() -> None:
    result = made({f"node[{k}].x": float(k) for k in range(15)} | {"tip.y": 3.0})
    ax = result.plot().axes[0]
    assert len(ax.lines) == 12
    assert ax.get_legend().get_title().get_text() == "4 more not shown"
    assert len(result.plot("*").axes[0].lines) == 16
    assert len(result.plot("node[1?].x", "tip.y", "tip.*", "node[3].x").axes[0].lines) == 7
    with pytest.raises(mb.UserError, match=r"no output 'top\.\*'"):
        result.plot("top.*")


@pytest.mark.parametrize(
    ("found", "word"),
    [
        (mb.Diagnostic.error("collapsed-step", "it broke", "Try again"), "FAILED at 9 s"),
        (mb.Diagnostic.warning("energy-balance", "it broke", "Try again"), "INACCURATE: the energy err"),
    ],
)
def test_a_picture_shows_that_a_run_failed(found: mb.Diagnostic, word: str) -> None:
    figure = made({"x": 1.0}, diagnostics=[found]).plot()
    lines = figure.get_suptitle().splitlines()
    assert lines[0] == "a/b, ida, tolerance 1e-6"
    assert lines[1].startswith(word)
    assert lines[2] == "it broke"
    assert len(figure.axes[0].lines) == 1 + (found.severity == "error")


def test_a_picture_of_many_units_has_a_limited_height() -> None:
    units = ("m", "m/s", "m/s2", "rad", "rad/s", "rad/s2", "N", "N.m")
    values, variables = np.ones((10, 8)), tuple(Variable(f"x{k}", unit, "") for k, unit in enumerate(units))
    result = mb.Result(np.arange(10.0), values, variables, Statistics(), 1.0)
    figure = result.plot()
    assert len(figure.axes) == 6
    assert figure.get_figheight() < 25.4 / 2.54 + 1.0
    assert figure.axes[-1].get_xlabel() == "time [s]\nnot shown: outputs in N, N.m"
    assert len(result.plot("*").axes) == 8


def test_drawing_leaves_the_backend_alone() -> None:
    script = (
        "import matplotlib as mpl; mpl.use('svg'); import mbfmu.plotting.steady_states, mbfmu.viewer.images; "
        "import matplotlib.pyplot; print(mpl.get_backend())"
    )
    assert subprocess.check_output([sys.executable, "-c", script], text=True).strip() == "svg"


def test_tables_of_other_tools(result: mb.Result) -> None:
    for name, make in (("pandas", result.to_dataframe), ("xarray", result.to_xarray)):
        try:
            __import__(name)
        except ImportError:
            with pytest.raises(mb.UserError, match=f"pip install {name}"):
                make()
        else:
            np.testing.assert_array_equal(np.asarray(make()["arm.angle"]), result["arm.angle"])


def test_a_mechanism_is_linearized_compared_and_shown(tmp_path: Path) -> None:
    """A pendulum of a rod: omega^2 = 3 g / 2 l."""
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    arm = m.body("arm", m.ground, mb.Revolute(start=-1.5), **mb.rod(mass=1.0, length=1.0))
    m.force("motor", mb.JointForce(magnitude=mb.Input(name="torque", unit="N.m")), arm)
    m.output("arm.angle", arm.angle(), "angle")
    omega = np.sqrt(1.5 * 9.81)
    assert mb.equilibrium(m).outputs["arm.angle"] == pytest.approx(-0.5 * np.pi)
    assert mb.modes(m, 1)[0].mode.frequency == pytest.approx(omega)
    space = mb.linearize(m)
    np.testing.assert_allclose(sorted(np.linalg.eigvals(space.A).imag), [-omega, omega], rtol=1e-10)
    assert space.to_scipy().B.shape == (2, 1)
    page = mb.view(m, tmp_path / "arm.html", 0.1, solver="adams")
    assert page.read_text().startswith("<!doctype html>") or "<html" in page.read_text()[:200].lower()
    for count in (0, "two"):
        with pytest.raises(mb.UserError, match="allowed: a whole number from 1 on"):
            mb.modes(m, count)  # type: ignore[arg-type]
    for what in (m, 3):
        with pytest.raises(mb.UserError, match=r"cannot be exported as it is|model is 3; allowed"):
            mb.export(what, tmp_path / "arm.fmu", native=False)  # type: ignore[arg-type]
    with pytest.raises(mb.UserError, match="does not exist"):
        mb.view(m, tmp_path / "nowhere" / "arm.html", 0.1, solver="adams")


def test_images_and_films_are_written_by_the_name_of_the_file(tmp_path: Path) -> None:
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    m.body("arm", m.ground, mb.Revolute(start=-1.0), **mb.rod(mass=1.0, length=1.0))
    how: dict[str, Any] = {"solver": "adams", "interval": 0.01}
    first, last, side = (
        np.asarray(Image.open(mb.view(m, tmp_path / f"arm{k}.png", 0.2, **how, **given)).convert("RGB"), float)
        for k, given in enumerate(({}, {"time": 0.2}, {"camera": (80.0, 10.0)}))
    )
    assert first.shape == (720, 960, 3)
    assert np.abs(last - first).mean() > 0.5
    assert np.abs(side - first).mean() > 0.5
    with Image.open(mb.view(m, tmp_path / "arm.gif", 0.2, **how)) as film:
        assert film.n_frames == 6
    for name, given, message in (
        ("arm.jpg", {}, "must end in .html, .glb, .png, .gif or .mp4"),
        ("arm.png", {"against": "adams"}, "against requires an HTML page"),
        ("arm.gif", {"time": 0.1}, "time requires an image"),
        ("arm.html", {"camera": (0.0, 0.0)}, "camera requires an image or a film"),
        ("arm.png", {"camera": (0.0, float("nan"))}, "allowed: azimuth and elevation in degrees"),
        ("arm.png", {"time": 3.0}, "time 3 s is outside the motion"),
    ):
        with pytest.raises(mb.UserError, match=message):
            mb.view(m, tmp_path / name, 0.2, **how, **given)

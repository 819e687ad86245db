"""What accuracy costs: what runs are compared by, how they are timed, resolutions, and the choice for a target."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from spinning_arm import SpinningArm

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from fmus.sheet import Sheet
from mbfmu.mechanics import Mechanism, Revolute, RunUp, rod
from mbfmu.modeling.scene import Scene, default_scene, load_scene
from mbfmu.modeling.settings import Settings
from mbfmu.session.run import run
from mbfmu.studies import work_precision
from mbfmu.studies.compare import Comparison, Row, compare, solvers_of
from mbfmu.studies.comparison_report import as_text
from mbfmu.studies.error_target import read_target
from mbfmu.studies.recommendation import recommend_solver, round_to_digit
from mbfmu.studies.reference import driven_outputs
from mbfmu.studies.resolution import limit, moving_places, resolutions_of
from mbfmu.studies.timing import Budget, BudgetExceeded, CpuTimes, time_interleaved
from mbfmu.util.errors import UserError
from mbfmu.util.text_table import format_tolerance


def short(model: Any, stop_time: float, interval: float = 0.01) -> Scene:
    return default_scene(model).changed(stop_time=stop_time, output_interval=interval)


@pytest.fixture(scope="module")
def swings() -> Comparison:
    """The four-bar till LU has failed in its second singular configuration."""
    return compare(
        short(FourBar(), 1.2), solvers=["adams", "adams-lu"], tolerances=[1e-4, 1e-6, 1e-8], repeats=3, budget=60.0
    )


def row(found: Comparison, solver: str, rtol: float) -> Row:
    return next(row for row in found.rows if (row.solver, row.rtol) == (solver, rtol))


# ---- reference runs --------------------------------------------------------------------------------------------------


def test_errors_are_those_of_all_outputs_over_their_ranges(swings: Comparison) -> None:
    own = row(swings, "adams", 1e-4)
    times = np.arange(121) * 0.01
    result = run(FourBar(), Settings(solver="adams", tolerance=1e-4), times)
    exact = FourBar().exact(times)
    assert exact is not None
    wrong = np.abs(result["crank.angle"] - exact["crank.angle"]).max()
    assert own.errors["crank.angle"] == pytest.approx(wrong, rel=1e-6)
    assert own.error is not None
    assert own.error >= wrong / np.ptp(exact["crank.angle"])
    assert own.worst in own.errors
    assert {"pivot.force.y", "crank.rate", "energy"} <= set(own.errors)  # not angles alone


def test_a_run_that_ends_early_has_no_error_and_is_not_drawn(swings: Comparison, monkeypatch: Any) -> None:
    failed = [r for r in swings.rows if r.failed]
    assert failed
    assert {r.solver for r in failed} == {"adams-lu"}
    assert all(r.error is None and not r.errors and not r.trusted for r in failed)
    figure = drawn(monkeypatch, work_precision.plot_work_precision, swings)
    points = np.concatenate([line.get_xydata() for line in figure.axes[0].lines])
    for r in failed:
        assert not np.any(points[:, 0] == r.cpu_s)
        assert f"adams-lu {format_tolerance(r.rtol)}" in figure.axes[0].get_xlabel()


def drawn(monkeypatch: Any, plot: Any, found: Comparison) -> Any:
    """Return the figure a plot finishes."""
    kept: list[Any] = []
    monkeypatch.setattr(work_precision, "finish", lambda figure, _path: kept.append(figure))
    plot(found, "title", Path("unused.png"))
    return kept[0]


def test_pictures_state_the_tolerance_and_omit_the_start(swings: Comparison, monkeypatch: Any) -> None:
    figure = drawn(monkeypatch, work_precision.plot_energy, swings)
    assert "tolerance 1e-6" in figure.axes[0].get_title()
    assert all(line.get_xdata()[0] == pytest.approx(0.01) for line in figure.axes[0].lines)


def test_the_best_choices_are_a_front(swings: Comparison) -> None:
    best = swings.best()
    assert best
    for one, next_one in pairwise(best):
        assert one.cpu_s <= next_one.cpu_s
        assert one.error > next_one.error  # type: ignore[operator]
    for other in (r for r in swings.rows if r.trusted and r not in best):
        assert any(one.cpu_s <= other.cpu_s and one.error <= other.error for one in best)  # type: ignore[operator]


def test_driven_outputs_are_not_compared() -> None:
    assert driven_outputs(SpinningArm().compile()) == {"hub.angle", "hub.speed"}
    assert {"crank.angle", "crank.speed"} <= driven_outputs(SwingPendulum().compile())
    assert "rod.angle" not in driven_outputs(SwingPendulum().compile())
    found = compare(short(SpinningArm(), 2.0), solvers=["adams"], tolerances=[1e-4], resolutions=[{}], repeats=1)
    assert {name for name, why in found.reference.not_evaluated.items() if why == "driven"} == {
        "hub.angle",
        "hub.speed",
    }
    assert found.rows[0].error > 1e-9  # type: ignore[operator]


def test_a_mechanism_without_degrees_of_freedom_is_reported() -> None:
    m = Mechanism()
    arm = m.body("arm", m.ground, Revolute(drive=RunUp(speed=1.0, duration=1.0)), **rod(mass=1.0, length=1.0))
    m.output("arm.angle", arm.angle())
    with pytest.raises(UserError, match=r"no output of model 'mechanism' distinguishes the runs \(arm.angle: driven\)"):
        compare(m, repeats=1)


def test_an_output_that_allows_no_comparison_is_named() -> None:
    with pytest.raises(
        UserError, match=r"output 'hub.angle' of model 'spinning_arm' cannot be compared: driven; allowed: "
    ):
        compare(short(SpinningArm(), 1.0), resolutions=[{}], outputs=["hub.angle"], repeats=1)


def test_a_run_without_energy_check_has_no_energy_error() -> None:
    scene = short(SwingPendulum(), 0.1).changed(energy_check=False)
    found = compare(scene, solvers=["adams"], tolerances=[1e-6], repeats=1)
    assert found.rows[0].energy_error is None
    assert "NaN" not in json.dumps([r.as_dict() for r in found.rows])


def test_solvers_that_do_the_same_run_once() -> None:
    assert solvers_of(SwingPendulum().compile()) == ("ida", "adams", "radau")
    assert solvers_of(Governor().compile()) == ("ida", "adams", "hybrid", "radau")
    assert solvers_of(Sheet(nx=7, nz=5).compile()) == ("ida", "esdirk", "adams")


# ---- times -----------------------------------------------------------------------------------------------------------


def test_runs_are_timed_in_turn() -> None:
    said: list[str] = []

    def timed(name: str) -> Any:
        def call() -> float:
            said.append(name)
            return float(len(said))

        return call

    spent = time_interleaved([timed("a"), timed("b")], 3)
    assert said == ["a", "b", "a", "b", "a", "b"]
    assert spent[0].times == (1.0, 3.0, 5.0)


def test_dear_runs_are_timed_once_where_little_time_is_left() -> None:
    spent = time_interleaved([lambda: 5.0, lambda: 0.1], 4, expected=[5.0, 0.1], left=lambda: 1.0)
    assert [len(own.times) for own in spent] == [1, 4]


def test_median_and_spread() -> None:
    spent = CpuTimes((1.0, 2.0, 3.0, 4.0, 100.0))
    assert spent.median == 3.0
    assert spent.spread == pytest.approx(2.0 / 3.0)


def test_a_run_that_takes_too_long_is_stopped() -> None:
    account = Budget(10.0)
    times = np.arange(1001) * 0.01
    with pytest.raises(BudgetExceeded):
        account.run(FourBar(), Settings(solver="ida", tolerance=1e-10), times, 0.02)
    assert 0.02 < account.spent < 1.0


def test_what_takes_too_long_is_omitted_and_reported() -> None:
    scene = short(SwingPendulum(), 6.0, 0.1)
    found = compare(scene, solvers=["adams", "ida"], tolerances=[1e-9, 1e-10], repeats=1, budget=2.0)
    assert {r.solver for r in found.rows} == {"adams"}
    assert [d.text for d in found.diagnostics if d.code == "omitted-run"] == [
        "omitted: ida 1e-9: took more than 0.1 s",
        "omitted: ida 1e-10: a run with a larger tolerance or coarser mesh took too long",
    ]
    assert "omitted: ida 1e-9: took more than 0.1 s" in as_text(found)


def test_the_bar_of_a_search_comes_near_its_end() -> None:
    shares: list[float] = []
    scene = short(FourBar(), 0.5)
    recommend_solver(scene, 1e-3, solvers=["adams", "radau"], progress=lambda _, share: shares.append(share))
    assert 0.7 <= sum(shares) <= 1.0 + 1e-12
    assert sum(share > 0.0 for share in shares[1:]) >= 1


# ---- resolutions -----------------------------------------------------------------------------------------------------


def test_resolutions_are_declared_or_asked_for() -> None:
    assert resolutions_of(FourBar(), None) == [{}]  # the coupler is rigid
    assert resolutions_of(FourBar(coupler_modes=2), None)[0] == {"coupler_modes": 1, "coupler_elements": 5}
    assert resolutions_of(Sheet(), None) == [{"nx": 7, "nz": 5}, {"nx": 10, "nz": 7}, {"nx": 15, "nz": 11}]
    assert resolutions_of(Sheet(), [{"nx": 9, "nz": 7}, {"nx": "5", "nz": "3"}])[0] == {"nx": 5, "nz": 3}
    assert resolutions_of(Sheet(), [{}]) == [{}]


@pytest.mark.parametrize("order", [1.0, 2.0, 3.7])
def test_the_limit_is_found_with_its_order(order: float) -> None:
    t = np.linspace(0.0, 1.0, 20)
    exact, part = np.sin(t), t**2
    sizes = (1.0 / 6.0, 1.0 / 9.0, 1.0 / 14.0)
    values = [exact + 0.1 * h**order * part for h in sizes]
    found, doubt, observed = limit(values, sizes)
    assert observed == pytest.approx(order, rel=1e-9)
    np.testing.assert_allclose(found, exact, atol=1e-13)
    assert doubt == pytest.approx(0.1 * sizes[-1] ** order)


def test_without_an_order_nothing_is_extrapolated() -> None:
    sizes = (1.0, 0.5, 0.25)
    values = [np.array([0.0, x]) for x in (1.0, 0.0, 0.5)]  # to and fro
    found, doubt, observed = limit(values, sizes)
    assert observed is None
    assert found[1] == 0.5
    assert doubt == pytest.approx(1.5)


def test_outputs_with_other_places_at_each_resolution() -> None:
    coarse, fine = ["tip", "edge[0]", "edge[1]"], ["tip", "edge[0]", "edge[1]", "edge[2]"]
    assert moving_places([coarse, fine]) == {"edge[0]", "edge[1]", "edge[2]"}
    assert moving_places([fine, fine]) == set()


def test_errors_are_split_into_time_and_space() -> None:
    found = compare(
        short(SpinningArm(), 4.0, 0.05), solvers=["adams"], tolerances=[1e-3, 1e-6], repeats=1,
        resolutions=[{"modes": m} for m in (1, 2, 4)], outputs=["tip.deflection"],
    )  # fmt: skip
    assert len(found.rows) == 6
    coarse = next(r for r in found.rows if r.resolution == {"modes": 1} and r.rtol == 1e-6)
    fine = next(r for r in found.rows if r.resolution == {"modes": 4} and r.rtol == 1e-6)
    loose = next(r for r in found.rows if r.resolution == {"modes": 4} and r.rtol == 1e-3)
    assert coarse.space_error > 3.0 * fine.space_error  # type: ignore[operator]
    assert coarse.time_error < 1e-2 * coarse.space_error  # type: ignore[operator]
    assert loose.time_error > 10.0 * fine.time_error  # type: ignore[operator]
    assert loose.space_error == fine.space_error
    for r in found.rows:
        assert r.error <= r.time_error + r.space_error + 1e-15  # type: ignore[operator]
    text = as_text(found)
    assert "in space" in text
    assert "modes=4" in text


def test_large_trees_are_compared_with_the_shell_code() -> None:
    found = compare(
        short(Sheet(), 0.05, 0.005), solvers=["esdirk"], tolerances=[1e-3], resolutions=[{"nx": 7, "nz": 5}], repeats=1
    )
    assert found.reference.motion.source.startswith("independent data for tip.x, tip.y")
    tip = run(Sheet(nx=7, nz=5), Settings(solver="esdirk", tolerance=1e-3), np.arange(11) * 0.005)["tip.y"]
    told = Sheet().independent(np.arange(11) * 0.005)
    assert told is not None
    assert found.rows[0].errors["tip.y"] == pytest.approx(np.abs(tip - told["tip.y"][0]).max(), rel=1e-6)
    assert found.rows[0].space_error > 0.0  # type: ignore[operator]


def test_the_refusal_of_a_solver_has_a_reason() -> None:
    with pytest.raises(UserError, match=r"nothing can be compared: .*esdirk.* is for large models only"):
        compare(short(FourBar(), 0.1), solvers=["esdirk"], tolerances=[1e-4], repeats=1)


# ---- targets ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "value", "unit"),
    [(1e-4, 1e-4, ""), ("1e-4", 1e-4, ""), ("0.2 mm", 0.2, "mm"), ("1e-3rad", 1e-3, "rad"), ("3m/s2", 3.0, "m/s2")],
)
def test_targets_are_read(text: Any, value: float, unit: str) -> None:
    target = read_target(text)
    assert (target.value, target.unit) == (value, unit)


def test_an_absolute_target_is_a_part_of_a_range() -> None:
    assert read_target("0.2 mm").of_range("m", 0.1) == pytest.approx(2e-3)
    assert read_target("1 deg").of_range("rad", np.pi) == pytest.approx(1.0 / 180.0)
    assert not read_target("1 mm").suits("rad")


@pytest.mark.parametrize(("tolerance", "said"), [(3.7e-5, 3e-5), (1e-6, 1e-6), (9.99e-3, 9e-3)])
def test_tolerances_that_are_tried_have_one_digit(tolerance: float, said: float) -> None:
    assert round_to_digit(tolerance) == said


@pytest.mark.parametrize(("target", "output"), [(1e-5, "crank.rate"), ("0.01 mm", "coupler.position.x")])
def test_what_is_chosen_keeps_the_target(target: Any, output: str) -> None:
    scene = short(FourBar(), 1.0)
    found = recommend_solver(scene, target, solvers=["adams", "ida"], outputs=[output])
    assert found.scene.settings.solver == "adams"  # thirty times as cheap here
    times = np.arange(101) * 0.01
    own = run(scene.model, found.scene.settings, times)[output]
    right = run(scene.model, Settings(solver="adams", tolerance=1e-12), times)[output]
    error = np.abs(own - right).max()
    assert error <= (1e-5 if target == "0.01 mm" else 1e-5 * np.ptp(right))
    assert found.row.errors[output] == pytest.approx(error, rel=1e-3)
    assert found.sentence.startswith(f"recommended: solver adams, tolerance {format_tolerance(found.row.rtol)} ")
    assert f"in {output}, target" in found.sentence
    assert len(found.rows) >= 2


def test_a_coarse_grid_is_chosen_where_it_does() -> None:
    scene = short(SpinningArm(), 4.0, 0.05)
    steps = [{"modes": 1}, {"modes": 2}, {"modes": 4}]
    rough = recommend_solver(scene, 0.05, solvers=["adams"], resolutions=steps, outputs=["tip.deflection"])
    fine = recommend_solver(scene, 2e-3, solvers=["adams"], resolutions=steps, outputs=["tip.deflection"])
    assert rough.row.resolution == {"modes": 1}
    assert fine.row.resolution["modes"] > 1
    assert any("at any tolerance" in d.text for d in fine.diagnostics)
    assert fine.scene.model.modes == fine.row.resolution["modes"]  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("target", "more", "message"),
    [
        (
            1e-8,
            {"tolerances": [1e-4]},
            "no run reached the target 1e-8 of the range. The nearest is",
        ),
        ("1 kg", {}, "target 1 kg does not suit crank.angle .rad., .*; allowed: a unit of theirs, or none"),
        ("1 mm", {"outputs": ["crank.angle"]}, "target 1 mm does not suit crank.angle .rad."),
        (
            1e-15,
            {"outputs": ["crank.rate"]},
            "target 1e-15 of the range is smaller than the uncertainty of the reference: crank",
        ),
    ],
)
def test_targets_that_are_not_reached(target: Any, more: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        recommend_solver(short(FourBar(), 0.5), target, solvers=["adams"], **more)


def test_command_prints_one_message_and_saves_a_scene(command: Any, tmp_path: Path) -> None:
    saved, rows = tmp_path / "quick.toml", tmp_path / "rows.json"
    code, out, _ = command(
        "compare", "fourbar", "--stop-time", "0.5", "--target", "1e-3", "--output", "crank.angle", "--solver", "adams",
        "--save", str(saved), "--json", str(rows),
    )  # fmt: skip
    assert code == 0
    assert out.startswith("recommended: solver adams, tolerance ")
    _, held, written = out.splitlines()
    assert "not examined" in held
    assert "crank.torque" in held
    assert written.startswith("wrote ")
    scene = load_scene(str(saved))
    assert scene.settings.solver == "adams"
    assert scene.stop_time == 0.5
    assert all(r["solver"] == "adams" for r in json.loads(rows.read_text()))
    times = np.arange(51) * 0.01
    exact = FourBar().exact(times)
    assert exact is not None
    error = np.abs(run(scene.model, scene.settings, times)["crank.angle"] - exact["crank.angle"]).max()
    assert error <= 1e-3 * np.ptp(exact["crank.angle"])


def test_command_takes_several_solvers_and_tolerances(command: Any, tmp_path: Path) -> None:
    code, out, _ = command(
        "compare", "fourbar", "--stop-time", "0.2", "--solver", "hybrid", "--solver", "adams", "--tolerance", "1e-5",
        "--tolerance", "1e-3", "--repeats", "1", "-o", str(tmp_path),
    )  # fmt: skip
    assert code == 0
    body = [line.split() for line in out.split("\n\n")[0].splitlines()[2:]]
    assert [tuple(cell for cell in line if cell != "*")[:2] for line in body] == [
        ("hybrid", "1e-3"), ("adams", "1e-3"), ("hybrid", "1e-5"), ("adams", "1e-5"),
    ]  # fmt: skip
    assert "compared outputs: " in out
    assert "reference: the exact motion" in out


def test_one_number_is_no_list_of_tolerances() -> None:
    with pytest.raises(UserError, match=r"tolerances are 0\.0001; allowed: a list of them, such as"):
        compare(FourBar(), tolerances=1e-4)  # type: ignore[arg-type]
    with pytest.raises(UserError, match="solvers are 'adams'; allowed: a list"):
        compare(FourBar(), solvers="adams")
    with pytest.raises(UserError, match="budget is 'x' s; allowed"):
        compare(FourBar(), budget="x")  # type: ignore[arg-type]

"""Orders that a run can be limited to: those of the methods, by every way in which a setting is given."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbfmu as mb
from fmus.pendulum import SwingPendulum
from fmus.sheet import Sheet
from mbfmu.fmi import Fmu
from mbfmu.modeling.scene import load_scene
from mbfmu.native.data import native_model
from mbfmu.util.diagnostics import without_details
from solvers import Options
from solvers.steppers import SOLVER_NAMES, stepper

RANGES = {  # BDF of SUNDIALS IDA, Adams of Shampine and Gordon, Radau IIA of three stages, the ESDIRK formula
    "ida": (1, 5),
    "adams": (1, 12),
    "hybrid": (1, 12),
    "adams-lu": (1, 12),
    "radau": (5, 5),
    "esdirk": (3, 3),
}
WRONG = [(name, k) for name, (low, high) in RANGES.items() for k in (1, 2, 4, 5, 6, 8, 12) if not low <= k <= high]


def by_settings(solver: str, order: int, _: Path) -> None:
    mb.Settings(solver=solver, max_order=order)


def by_simulate(solver: str, order: int, _: Path) -> None:
    mb.simulate(SwingPendulum(), 0.1, solver=solver, max_order=order)


def by_scene(solver: str, order: int, folder: Path) -> None:
    file = folder / "scene.toml"
    file.write_text(f'model = "pendulum"\nsolver = "{solver}"\nmax_order = {order}\n')
    load_scene(str(file))


def by_stepper(solver: str, order: int, _: Path) -> None:
    compiled = (Sheet(nx=7, nz=5) if solver == "esdirk" else SwingPendulum()).compile()
    try:
        stepper(solver, compiled.system, 0.0, *compiled.assemble(), Options(max_order=order))
    except ValueError as error:
        raise mb.UserError(str(error)) from error


@pytest.mark.parametrize("way", [by_settings, by_simulate, by_scene, by_stepper])
@pytest.mark.parametrize(("solver", "order"), WRONG)
def test_an_order_that_a_solver_does_not_have_is_refused(
    way: Callable[..., None], solver: str, order: int, tmp_path: Path
) -> None:
    low, high = RANGES[solver]
    allowed = f"{low} to {high}" if low < high else f"{high}"
    with pytest.raises(
        mb.UserError, match=re.escape(f"max_order is {order}; allowed for solver {solver!r}: {allowed},")
    ):
        way(solver, order, tmp_path)


@pytest.mark.parametrize("solver", sorted(set(SOLVER_NAMES) - {"esdirk"}))
def test_an_order_that_it_has_is_kept(solver: str) -> None:
    low, high = RANGES[solver]
    for order in {low, high}:
        result = mb.simulate(SwingPendulum(), 1.0, solver=solver, max_order=order)
        assert not result.failure
        assert result.statistics.order <= order


def test_the_table_has_every_solver() -> None:
    assert set(RANGES) == set(SOLVER_NAMES)
    assert mb.Settings(solver="auto", max_order=12).max_order == 12
    assert not mb.simulate(SwingPendulum(), 0.1, solver="auto", max_order=12).failure


def test_the_command_and_a_comparison(command: Callable[..., Any], tmp_path: Path) -> None:
    out = str(tmp_path / "out")
    code, _, err = command("run", "pendulum", "--direct", "--solver", "ida", "--max-order", "8", "-o", out)
    assert (code, "max_order is 8; allowed for solver 'ida': 1 to 5" in err) == (2, True)
    scene = load_scene("pendulum").changed(solver="adams", max_order=8, stop_time=0.2)
    compared = mb.compare(scene, tolerances=[1e-4])
    assert {row.solver for row in compared.rows} <= {"adams", "hybrid", "adams-lu"}
    assert any("max_order is 8; allowed for solver 'ida'" in d.text for d in compared.diagnostics)


def test_an_fmu_checks_its_parameters_together(fourbar_fmu: Path) -> None:
    """In any order: 8 belongs to 'adams', with which it was exported."""
    with Fmu(fourbar_fmu, {"max_order": 8}) as fmu:
        fmu.step(0.01)
    for given in ({"max_order": 8, "solver": "ida"}, {"solver": "ida", "max_order": 8}):
        with pytest.raises(mb.UserError, match="max_order is 8; allowed for solver 'ida': 1 to 5"):
            Fmu(fourbar_fmu, given)


@pytest.mark.parametrize(("solver", "high"), [("adams", 12), ("hybrid", 12), ("radau", None)])
def test_a_native_fmu_offers_the_orders_of_its_solver(solver: str, high: int | None) -> None:
    made = native_model(SwingPendulum(), mb.Settings(solver=solver), for_one_run=True)
    (order,) = (v for v in made.variables if v.name == "max_order")
    assert order.settable == (high is not None)
    if high is not None:
        assert (order.min, order.max) == (0, high)
        assert f"1 to 12 with solver {solver!r}" in order.allowed


def stiff_joints(others: int = 69) -> mb.Mechanism:
    """A pendulum, and masses on undamped springs of 1000 rad/s."""
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    m.body("bob", m.ground, mb.Revolute(start=0.5), **mb.rod(mass=1.0, length=1.0))
    for k in range(others):
        slide = m.body(f"mass{k}", m.ground, mb.Translational(axis="x"), mass=1.0)
        m.force(f"spring{k}", mb.JointSpring(stiffness=1e6), slide)
    return m


def codes(model: Any, **settings: Any) -> list[str]:
    return [d.code for d in without_details(mb.Simulation(model, mb.Settings(**settings)).diagnostics)]


@pytest.mark.parametrize(("model", "default"), [(stiff_joints(), "limited-order"), (Sheet(nx=7, nz=5), "large-error")])
def test_an_order_that_would_have_been_lowered_is_reported(model: Any, default: str) -> None:
    assert default in codes(model, solver="ida")
    for order in (1, 2):
        assert "unstable-order" not in codes(model, solver="ida", max_order=order)
    for order in (3, 5):
        assert "unstable-order" in codes(model, solver="ida", max_order=order)
    assert "unstable-order" not in codes(stiff_joints(5), solver="ida", max_order=5)


def test_a_low_order_that_was_set_is_reported_with_its_error() -> None:
    """Against SciPy: with order 1 thousands of tolerances, with order 2 hundreds, without a limit few."""
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    bar = m.body("rod", m.ground, mb.Revolute(start=-1.0, rate=0.5), **mb.rod(mass=1.0, length=1.0))
    m.output("angle", bar.angle())
    errors = []
    for order in (1, 2, 0):
        found = mb.simulate(m, 10.0, interval=0.1, solver="ida", tolerance=1e-6, max_order=order)
        exact = solve_ivp(
            lambda t, y: (y[1], -1.5 * 9.81 * np.cos(y[0])), (0.0, 10.0), (-1.0, 0.5), "DOP853", found.t,
            rtol=1e-12, atol=1e-13,
        )  # fmt: skip
        errors.append(np.abs(found["angle"] - exact.y[0]).max() / 1e-6)
        told = [str(d) for d in found.diagnostics if d.code == "limited-order"]
        assert len(told) == (order > 0)
        assert all(f"max_order is {order}, so that 'ida' uses order" in text for text in told)
    assert 1000.0 < errors[0] < 10_000.0
    assert 100.0 < errors[1] < 1000.0
    assert errors[2] < 20.0


@pytest.mark.parametrize("order", [1, 2])
def test_only_orders_below_those_of_a_model_are_reported(order: int) -> None:
    """A sheet is integrated with orders 1 and 2 in any case, other solvers have other formulas."""
    assert ("limited-order" in codes(Sheet(nx=7, nz=5), solver="ida", max_order=order)) == (order == 1)
    assert "limited-order" in codes(stiff_joints(), solver="ida", max_order=order)
    assert "limited-order" in codes(stiff_joints(5), solver="ida", max_order=order)
    assert "limited-order" not in codes(stiff_joints(5), solver="adams", max_order=order)
    assert "limited-order" not in codes(stiff_joints(5), solver="ida", max_order=3)

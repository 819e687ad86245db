"""The four-bar with an elastic coupler against independent models; described in ``tests/data/fourbar``."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.fourbar import FourBar
from mbfmu.mechanics import CompiledMechanism, Mechanism, Revolute, RevoluteCutJoint, add_chain, rod
from mbfmu.modeling import Model
from mbfmu.session.run import Result, run
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.errors import UserError

DATA = Path(__file__).parent / "data" / "fourbar"
BETA = 5.8115e-4  # s: 1 % of the first mode
SOLVERS = ("ida", "adams", "hybrid")


@cache
def reference(name: str) -> Any:
    """A table of the data by column."""
    return np.genfromtxt(DATA / f"{name}.csv", delimiter=",", names=True)


def swing(solver: str, tolerance: float, **parameters: Any) -> Result:
    """A run of two modes to the times of the data, or of other parameters."""
    values = {"coupler_modes": 2} | parameters
    times = np.asarray(reference("fine")["t_s"])
    result = run(FourBar(**values), Settings(solver=solver, tolerance=tolerance), times)
    assert not result.failure
    return result


def off(result: Result, name: str, table: Any, column: str, until: float = 2.5) -> float:
    """Largest difference of an output from a column."""
    early = result.t <= until + 1e-9
    return float(np.abs(result[name] - table[column])[early].max())


@pytest.mark.parametrize("solver", SOLVERS)
def test_two_modes_are_the_two_sines_of_the_reference(solver: str) -> None:
    exact = reference("two_linear_modes")
    result = swing(solver, 1e-9)
    for name, column in (("crank.angle", "crank_rad"), ("coupler.deflection", "w_mid_m")):
        assert off(result, name, exact, column, 1.2) < 1e-6
        assert off(result, name, exact, column) < 1e-5
    assert off(result, "coupler.acceleration.y", exact, "ay_mid_m_s2") < 2e-3
    assert off(result, "energy", exact, "energy_J") < 2e-4
    assert np.abs(result["crank.angle"] - result["rocker.angle"]).max() < 1e-6
    assert np.abs(result["coupler.mode[2].amplitude"]).max() < 5e-5


def test_more_elements_leave_what_the_solver_leaves() -> None:
    exact = reference("two_linear_modes")
    errors = [off(swing("adams", 1e-10, coupler_elements=n), "crank.angle", exact, "crank_rad") for n in (10, 20, 40)]
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.1)  # fourth order
    assert errors[2] < 1e-8


@pytest.mark.parametrize("solver", SOLVERS)
def test_errors_fall_with_the_tolerance(solver: str) -> None:
    tight = swing("adams", 1e-11)["coupler.deflection"]
    errors = [np.abs(swing(solver, rtol)["coupler.deflection"] - tight).max() for rtol in (1e-4, 1e-6, 1e-8)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 1e-7


@pytest.mark.parametrize("solver", SOLVERS)
def test_damped_modes_are_those_of_the_reference(solver: str) -> None:
    exact = reference("damped_two_linear_modes")
    result = swing(solver, 1e-8, coupler_damping=BETA)
    assert off(result, "coupler.deflection", exact, "w_mid_m") < 1e-5
    assert off(result, "crank.angle", exact, "crank_rad") < 1e-5


def test_two_modes_are_near_the_fine_beam() -> None:
    fine, result = reference("fine"), swing("adams", 1e-8)
    assert off(result, "coupler.deflection", fine, "w_mid_m") < 4e-4
    assert off(result, "crank.angle", fine, "crank_rad") < 1e-3
    fine, result = reference("damped_fine"), swing("adams", 1e-8, coupler_damping=BETA)
    assert off(result, "coupler.deflection", fine, "w_mid_m") < 2.5e-4
    difference = result["coupler.acceleration.y"] - fine["ay_mid_m_s2"]
    assert np.sqrt(np.mean(difference**2)) < 0.1


def test_four_modes_are_nearer() -> None:
    fine = reference("damped_fine")
    errors = [
        off(swing("adams", 1e-8, coupler_damping=BETA, coupler_modes=n), "coupler.deflection", fine, "w_mid_m")
        for n in (1, 2, 4)
    ]
    assert errors[2] < 0.2 * errors[1]
    assert errors[0] == pytest.approx(errors[1], rel=1e-3)  # the second mode is zero by symmetry


def test_lu_fails_at_a_singular_position_as_published() -> None:
    times = np.linspace(0.0, 10.0, 101)
    result = run(FourBar(coupler_modes=2), Settings(solver="adams-lu", tolerance=1e-8), times)
    assert "the time no longer changes" in result.failure
    assert result.t[-1] <= 0.1813


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("damping", [0.0, BETA])
def test_ten_seconds_end_well_and_stay_on_the_branch(solver: str, damping: float) -> None:
    times, drifts = np.linspace(0.0, 10.0, 501), []
    for tolerance in (1e-5, 1e-7, 1e-9):
        model = FourBar(coupler_modes=2, coupler_damping=damping)
        result = run(model, Settings(solver=solver, tolerance=tolerance), times)
        assert not result.failure
        assert np.abs(result["crank.angle"] - result["rocker.angle"]).max() < 1e-3
        drifts.append(np.abs(result["energy"] - result["energy"][0]).max())
    if damping == 0.0:
        assert drifts == sorted(drifts, reverse=True)
        assert drifts[-1] < 1e-4


@pytest.mark.parametrize("solver", ["adams", "ida"])
def test_a_stiff_coupler_moves_as_the_rigid_one(solver: str) -> None:
    """The deflection falls with the stiffness, and with its square root the fastest period that must be resolved."""
    times = np.linspace(0.0, 1.5, 151)
    exact = FourBar().exact(times)
    assert exact is not None
    errors = []
    for factor in (10.0, 100.0, 1000.0):
        model = FourBar(coupler_modes=1, youngs_modulus=117e9 * factor, coupler_damping=BETA / np.sqrt(factor))
        result = run(model, Settings(solver=solver, tolerance=1e-8), times)
        errors.append(np.abs(result["crank.angle"] - exact["crank.angle"]).max())
    assert errors[1] < 0.2 * errors[0]
    assert errors[2] < 0.2 * errors[1]


def test_without_modes_the_mechanism_is_the_rigid_one() -> None:
    arrays: Any = CompiledMechanism(FourBar(coupler_modes=0, coupler_elements=50).build()).data.arrays
    assert len(arrays.flexibles) == len(arrays.nodes) == 0
    assert len(arrays.bodies) == 4


def chain(elements: int, damping: float) -> type[Model]:
    """The same four-bar whose coupler is a chain of nodal bodies that stretches."""

    class Chained(Model):
        name = "chained"

        def build(self) -> Mechanism:
            angle = np.radians(10.0)
            m = Mechanism(gravity=(0.0, -9.81, 0.0))
            crank = m.body("crank", m.ground, Revolute(start=angle, fixed=True), **rod(mass=8.019, length=1.0))
            nodes = add_chain(
                m, "coupler", crank, Revolute(at=(1.0, 0.0, 0.0), start=-angle), length=3.0, mass=24.057,
                axial=117e9 * 9e-4, bending_stiffness=7897.5, elements=elements, damping=damping,
            )  # fmt: skip
            rocker = m.body("rocker", nodes[-1], Revolute(start=angle), **rod(mass=8.019, length=-1.0))
            m.cut("pivot", RevoluteCutJoint(at_a=(-1.0, 0.0, 0.0), at_b=(3.0, 0.0, 0.0)), rocker, m.ground)
            for name, body in (("a", nodes[0]), ("middle", nodes[elements // 2]), ("b", nodes[-1])):
                m.output(f"{name}.x", body.position("x"))
                m.output(f"{name}.y", body.position("y"))
            m.output("crank.angle", crank.angle())
            m.output("acceleration", nodes[elements // 2].point_acceleration("y"))
            return m

    return Chained


def test_a_chain_of_nodal_bodies_passes_by_stretching_and_agrees() -> None:
    fine = reference("damped_fine")
    result = run(chain(20, BETA)(), Settings(solver="ida", tolerance=1e-5), np.asarray(fine["t_s"]))
    assert not result.failure
    x, y = result["b.x"] - result["a.x"], result["b.y"] - result["a.y"]
    across = (result["middle.y"] - result["a.y"]) * x - (result["middle.x"] - result["a.x"]) * y
    assert np.abs(across / np.hypot(x, y) - fine["w_mid_m"]).max() < 2.5e-4
    assert np.abs(result["crank.angle"] - fine["crank_rad"]).max() < 1e-3
    assert np.sqrt(np.mean((result["acceleration"] - fine["ay_mid_m_s2"]) ** 2)) < 0.1


def test_the_static_sag_is_that_of_a_pinned_beam() -> None:
    """Hanging still the coupler is level: w = 5 q L^4 / (384 E I), of which the first sine has 4 / pi^5 * 384 / 5."""
    compiled: CompiledMechanism = CompiledMechanism(FourBar(coupler_modes=1, coupler_elements=40).build())
    from mbfmu.steady.equilibrium import build_problem

    model = FourBar(coupler_modes=1, coupler_elements=40, start_angle=-1.5)
    sag = build_problem(model).solve().outputs["coupler.deflection"]
    assert compiled.system.n == 4
    assert sag == pytest.approx(-4.0 / np.pi**5 * 24.057 / 3.0 * 9.81 * 3.0**4 / 7897.5, rel=1e-6)


@pytest.mark.parametrize(
    ("parameter", "value", "said"),
    [
        ("coupler_modes", 13, "coupler_modes"),
        ("coupler_modes", -1, "coupler_modes"),
        ("coupler_elements", 0, "coupler_elements"),
        ("coupler_height", 0.0, "coupler_height"),
        ("coupler_width", -0.1, "coupler_width"),
        ("youngs_modulus", 0.0, "youngs_modulus"),
        ("coupler_damping", -1.0, "coupler_damping"),
    ],
)
def test_bad_parameters_are_named(parameter: str, value: float, said: str) -> None:
    with pytest.raises(UserError, match=said):
        FourBar(**{"coupler_modes": 2, parameter: value})


def test_more_modes_than_the_elements_have_are_refused() -> None:
    with pytest.raises(UserError, match="modes of a beam are 6; allowed: 1 to 4 with 2 elements"):
        Simulation(FourBar(coupler_modes=6, coupler_elements=2), Settings())


def test_an_elastic_coupler_without_mass_is_refused() -> None:
    with pytest.raises(UserError, match=r"coupler_mass is 0.0 kg; with coupler_modes = 1"):
        Simulation(FourBar(coupler_modes=1, coupler_mass=0.0), Settings())


STIFF = {
    "coupler_modes": 1,
    "youngs_modulus": 117e9 * (1e4 * 2.87 / 34.4145) ** 2,
    "coupler_damping": 2e-2 / (1e4 * 2.87),
}


def test_ida_pays_for_accuracy_and_not_for_stiffness() -> None:
    """First elastic frequency 1e4 times that of the swing (2.87 rad/s at its middle), damped by 1 %."""
    times, settings = np.linspace(0.0, 2.5, 26), Settings(solver="ida", tolerance=1e-5)
    stiff, rigid = run(FourBar(**STIFF), settings, times), run(FourBar(), settings, times)
    assert not stiff.failure
    assert stiff.statistics.rhs_evals < 3 * rigid.statistics.rhs_evals
    np.testing.assert_allclose(stiff["crank.angle"], rigid["crank.angle"], atol=1e-3)


@pytest.mark.parametrize("solver", ["adams", "hybrid"])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-8])
def test_adams_reports_that_stability_limits_it(solver: str, tolerance: float) -> None:
    times, settings = np.linspace(0.0, 0.05, 3), Settings(solver=solver, tolerance=tolerance)
    stiff, rigid = run(FourBar(**STIFF), settings, times), run(FourBar(), settings, np.linspace(0.0, 10.0, 3))
    assert stiff.statistics.stability_limited > 0.9 * stiff.statistics.steps > 1000
    assert rigid.statistics.stability_limited == 0

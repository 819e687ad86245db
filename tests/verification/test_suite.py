"""The verification suite: its references, its verdicts, and the command."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mbfmu.cli import main
from mbfmu.util.errors import UserError
from mbfmu.verification import suite
from mbfmu.verification.engines.compare import Difference
from mbfmu.verification.engines.compare import as_dict as differences_as_dict
from mbfmu.verification.problem import Exact, Motion, Reference, Value
from mbfmu.verification.problems import (
    flexible_bodies,
    friction,
    pendulums,
    planar_loops,
    rotors,
    spatial_beams,
    spatial_loops,
    steady,
)
from mbfmu.verification.problems.spatial_loops import CUBE_RODS, bricard_second, rotation
from mbfmu.verification.suite import PROBLEMS, select
from mbfmu.verification.verdict import check_motion, check_value, run_motion

MOTIONS = [p for p in PROBLEMS if isinstance(p, Motion)]


def named(name: str) -> Motion:
    (found,) = (p for p in MOTIONS if p.name == name)
    return found


# ---- references, against equations that they do not contain ----------------------------------------------------------


def test_bricard_closes() -> None:
    for x in (-0.9, -0.3, 0.2, 0.4):
        R, end = np.eye(3), np.zeros(3)
        for i in range(5):
            R = R @ rotation(np.cross(CUBE_RODS[i - 1], CUBE_RODS[i]), x if i % 2 == 0 else bricard_second(x))
            end = end + R @ CUBE_RODS[i]
        np.testing.assert_allclose(end, (0.0, 0.0, 1.0), atol=1e-13)
        hinge = np.cross(CUBE_RODS[4], CUBE_RODS[5])
        np.testing.assert_allclose(R @ hinge, hinge, atol=1e-13)


def test_rocker_of_the_spatial_linkage_keeps_its_distance() -> None:
    crank = np.linspace(0.0, 6.0, 13)
    angle = spatial_loops.rocker_angle(crank)
    end = np.array(spatial_loops.PIVOT)[:, None] + spatial_loops.ROCKER * np.array(
        (np.cos(angle), 0.0 * angle, -np.sin(angle))
    )
    pin = spatial_loops.CRANK * np.array((np.cos(crank), np.sin(crank), 0.0 * crank))
    np.testing.assert_allclose(np.linalg.norm(end - pin, axis=0), spatial_loops.COUPLER, rtol=1e-14)


def test_closed_forms_satisfy_their_differential_equations() -> None:
    times = np.linspace(0.0, 3.0, 30001)
    h = times[1]

    def derivative(x: np.ndarray) -> np.ndarray:
        return (x[:-4] - 8.0 * x[1:-3] + 8.0 * x[3:-1] - x[4:]) / (12.0 * h)

    top = rotors.free_body_exact()
    w = top.solution(np.array(top.start), times)
    torque = derivative(w) * rotors.INERTIA + np.cross(w, rotors.INERTIA * w)[2:-2]
    np.testing.assert_allclose(torque, 0.0, atol=1e-8)
    np.testing.assert_allclose(w[0], rotors.SPIN, atol=1e-12)
    pendulum = pendulums.pendulum_exact()
    x, y = pendulum.solution(np.array(pendulum.start), times).T
    angle = np.unwrap(np.arctan2(x, -y))
    np.testing.assert_allclose(derivative(derivative(angle)), -9.81 * np.sin(angle[4:-4]), atol=1e-6)
    heavy = rotors.heavy_top_exact()
    u = heavy.solution(np.array(heavy.start), times)[:, 0]
    a, beta = (
        rotors.ALONG * rotors.TOP_SPIN / rotors.ACROSS,
        2.0 * rotors.TOP_MASS * 9.81 * rotors.TOP_ARM / rotors.ACROSS,
    )
    c = np.cos(rotors.LEAN)
    right = (1.0 - u**2) * beta * (c - u) - (a * (c - u)) ** 2
    np.testing.assert_allclose(derivative(u) ** 2, right[2:-2], atol=1e-7)


def test_absolute_coordinates_conserve_energy_and_keep_pins_closed() -> None:
    bodies = planar_loops.squeezer_bodies()
    x, v = bodies.motion(np.linspace(0.0, 0.005, 3))
    gaps, J, _ = bodies.constraints(x[-1], v[-1])
    np.testing.assert_allclose(gaps, 0.0, atol=1e-15)
    np.testing.assert_allclose(J @ v[-1], 0.0, atol=1e-12)

    def energy(x: np.ndarray, v: np.ndarray) -> float:
        (a, b, stiffness, free), (body, torque) = bodies.springs[0], bodies.torques[0]
        length = np.hypot(*(bodies.place(x, a)[0] - bodies.place(x, b)[0]))
        return float(
            0.5 * bodies.mass_matrix @ v**2 + 0.5 * stiffness * (length - free) ** 2 - torque * x[3 * body + 2]
        )

    kinetic = 0.5 * bodies.mass_matrix @ v[-1] ** 2
    assert energy(x[-1], v[-1]) == pytest.approx(energy(x[0], v[0]), abs=1e-9 * kinetic)


def test_frequencies_of_a_cantilever_by_polynomials() -> None:
    """First root of cos(b) cosh(b) = -1; table of Wright (1982) for the rotating beam; zero at the critical load."""
    assert steady.polynomial_beam(0.0, 0.0) == pytest.approx(1.8751040687119611**2, rel=1e-9)
    for speed, published in ((1.0, 3.6816), (4.0, 5.5850), (8.0, 9.2568)):
        assert steady.polynomial_beam(0.0, speed) == pytest.approx(published, abs=6e-5)
    low = steady.polynomial_beam(0.25 * np.pi**2 * (1.0 - 1e-6), 0.0)
    assert low < 1e-2


def test_elastica_satisfies_published_values() -> None:
    """Tip of the cantilever at P L^2 / E I = 1 and 10 (Mattiasson 1981, table 1)."""
    for load, u, w in ((1.0, 0.05643, 0.30172), (10.0, 0.55500, 0.81061)):
        np.testing.assert_allclose(steady.elastica_tip(load), (1.0 - u, -w), atol=6e-6)


def test_friction_comes_to_rest_between_its_bounds() -> None:
    end = friction.rubbing_exact().solution(np.array((friction.RELEASE,)), np.array((10.0,)))[0, 0]
    assert abs(end) < friction.SPRING_FRICTION / friction.SPRING_STIFFNESS


# ---- verdicts --------------------------------------------------------------------------------------------------------


def test_a_reference_that_differs_is_wrong() -> None:
    problem = named("geared shafts")
    exact = pendulums.gears_exact()
    times = np.linspace(0.0, problem.stop_time, 81)
    right = check_motion(problem, exact.at(times), "adams", 1e-6)
    assert (right.verdict, right.reason) == ("right", "")
    assert right.error is not None
    assert right.allowed is not None
    assert right.error < right.allowed
    result, *_ = run_motion(problem, "adams", 1e-6)
    at = int(np.argmin(np.abs(times - (right.time or 0.0))))
    assert right.value == result[right.output][at]
    assert right.reference == exact.at(times).values[at, problem.outputs.index(right.output)]
    assert right.error == abs(right.value - right.reference)
    shifted = Exact(lambda s, t: 1.001 * exact.solution(s, t), exact.start, exact.scales, exact.uncertainty)
    wrong = check_motion(problem, shifted.at(times), "adams", 1e-6)
    assert wrong.verdict == "WRONG"
    assert "without a warning" in wrong.reason


def test_a_run_that_stops_is_stopped_if_it_was_right() -> None:
    problem = replace(named("geared shafts"), settings={"max_steps": 1})
    reference = pendulums.gears_exact().at(np.linspace(0.0, problem.stop_time, 81))
    line = check_motion(problem, reference, "adams", 1e-6)
    assert line.verdict in ("stopped", "warned")
    assert "[too-many-steps]" in line.reason


@pytest.mark.parametrize(("tolerance", "used"), [(1e-10, 1e-9), (1e-8, 1e-8)])
def test_a_run_is_compared_at_the_tolerance_that_the_solver_used(tolerance: float, used: float) -> None:
    """`ida` uses at least 1e-9 in models with loops; S(t) is one, so that the allowed error is 100 tolerances."""
    problem = replace(named("sprung four-bar"), stop_time=0.05)
    exact = np.ones((81, len(problem.outputs)))
    line = check_motion(problem, Reference(1e3 * exact * np.linspace(0, 1, 81)[:, None], exact, 0.0), "ida", tolerance)
    assert line.allowed == pytest.approx(100.0 * used)


def test_numbers_that_are_not_finite_are_none_in_json() -> None:
    (whirl,) = (p for p in PROBLEMS if p.name == "whirl")
    line = check_value(replace(whirl, measure=lambda _: np.full(2, np.nan)))
    assert line.verdict == "WRONG"
    json.dumps(line.as_dict(), allow_nan=False)
    assert not Difference("an engine", 1, np.nan, 0.0, np.nan).is_right
    json.dumps(differences_as_dict([Difference("an engine", 1, np.nan, 0.0, np.nan)]), allow_nan=False)


def test_a_number_that_differs_is_wrong() -> None:
    (whirl,) = (p for p in PROBLEMS if p.name == "whirl")
    assert isinstance(whirl, Value)
    assert check_value(whirl).verdict == "right"
    assert check_value(replace(whirl, reference=lambda: 1.001 * steady.whirl_reference())).verdict == "WRONG"


def test_every_motion_is_compared_over_most_of_its_time() -> None:
    """References are evaluated for problems of the quick part that are compared for less than the whole time."""
    for problem in (named("cart-pole"), named("A02 two four-bars")):
        reference = problem.exact().at(np.linspace(0.0, problem.stop_time, 81))
        allowed = 100.0 * 1e-6 * reference.sensitivity
        assert (allowed < 0.1 * np.ptp(reference.values, axis=0)).mean() > 0.5, problem.name


PUBLISHED_BEND = {300.0: (59.2, 22.5, 39.5), 600.0: (47.2, 15.9, 53.4)}  # Bathe and Bolourchi, with eight elements


@pytest.mark.parametrize("load", PUBLISHED_BEND)
def test_spatial_rod_agrees_with_published_coordinates(load: float) -> None:
    tip = spatial_beams.rod_tip(replace(spatial_beams.BEND, load=(0.0, 0.0, load)))
    np.testing.assert_allclose(tip, PUBLISHED_BEND[load], atol=0.8)  # in: 1.5 % of the deflection


@pytest.mark.parametrize("axis", [1, 2])
def test_spatial_rod_that_bends_in_a_plane_is_the_elastica(axis: int) -> None:
    load = [0.0, 0.0, 0.0]
    load[axis] = -5.0 if axis == 1 else 10.0
    tip = spatial_beams.rod_tip(spatial_beams.Rod(1.0, (1e9, 0.3, 1.0, 2.0), (load[0], load[1], load[2])))
    expected = steady.elastica_tip(5.0)
    np.testing.assert_allclose((tip[0], abs(tip[axis]), tip[3 - axis]), (expected[0], -expected[1], 0.0), atol=1e-7)


def test_flexible_slider_crank_agrees_with_published_values() -> None:
    """Published values of the IVP test set; the reference and the simulation differ from them by less than 1e-9 m."""
    end = flexible_bodies.SliderCrankMotion().motion(np.array((0.0, 0.1)), 0.0, 1e-8)[-1]
    np.testing.assert_allclose(end, flexible_bodies.PUBLISHED_ROD, rtol=0, atol=1e-9)
    result, *_ = run_motion(named("flexible slider-crank"), "radau", 1e-8)
    found = [result[name][-1] for name in ("q1", "q2", "length", "x")]
    np.testing.assert_allclose(found, flexible_bodies.PUBLISHED_ROD, rtol=0, atol=1e-9)


# ---- selection and command -------------------------------------------------------------------------------------------


def test_names_are_unique_and_sources_have_authors() -> None:
    assert len({p.name for p in PROBLEMS}) == len(PROBLEMS)
    for problem in PROBLEMS:
        assert problem.derivation
        for source in problem.sources:
            assert source.authors
            assert source.title
            assert 1600 < source.year < 2030
            assert not source.link or re.match("https?://", source.link)
    assert len(select(quick=True)) >= 15


def test_problems_are_selected_by_name_and_pattern() -> None:
    assert [p.name for p in select(["A0*"])] == [p.name for p in PROBLEMS if p.name.startswith("A0")]
    assert [p.name for p in select(["whirl"])] == ["whirl"]
    with pytest.raises(UserError, match="there is no problem 'pendulm'"):
        select(["pendulm"])
    with pytest.raises(UserError, match="name of a problem is empty"):
        select([""])


def test_the_command_writes_a_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ["verify", "--only", "geared shafts", "--only", "whirl", "--solver", "adams", "--quick"]
    assert main([*arguments, "--report", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert "2 problems, 2 results: 2 right, 0 stopped, 0 warned, 0 WRONG" in printed
    content = json.loads((tmp_path / "out/report.json").read_text())
    assert [line["verdict"] for line in content["results"]] == ["right", "right"]
    page = (tmp_path / "out/report.html").read_text()
    assert "geared shafts" in page
    assert "<script" not in page
    assert not re.search(r"(src|<link)[ =]", page)
    wrong = tuple(replace(p, reference=lambda: 1.1 * steady.whirl_reference()) for p in PROBLEMS if p.name == "whirl")
    monkeypatch.setattr(suite, "PROBLEMS", wrong)
    assert main(["verify", "--only", "whirl", "-q"]) == 1


@pytest.mark.campaign
def test_all_results_of_the_quick_part_are_right() -> None:
    lines = list(suite.verify(select(quick=True), tolerances=suite.QUICK_TOLERANCES))
    assert [line for line in lines if line.verdict != "right"] == []

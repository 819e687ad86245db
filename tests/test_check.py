"""Whether a scene is hard, and why: mechanisms with known singular configurations, eigenvalues and equations."""

from __future__ import annotations

import json
from collections.abc import Callable
from math import cos, pi, radians, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from fmus.sheet import Sheet

SCALES = (1e-3, 1.0, 1e3)
START, RATE = radians(40.0), 2.0


def parallelogram(scale: float = 1.0, longer: float = 0.0, cranks: int = 2) -> mb.Mechanism:
    """Cranks of 1 m on a ground of 2.5 m, the first one driven at 2 rad/s, the coupler 2.5 (1 + ``longer``) m."""
    m = mb.Mechanism(gravity=(0.0, -9.81 * scale, 0.0))
    l, c, way = scale, 2.5 * scale, 2.5 - complex(cos(START), sin(START))
    whole = 2.5 * (1.0 + longer)
    knee = np.arccos((whole**2 + abs(way) ** 2 - 1.0) / (2.0 * whole * abs(way)))
    along = min((np.angle(way) + s * knee for s in (1.0, -1.0)), key=abs)
    back = np.angle(whole * np.exp(1j * along) - way)
    crank = m.body("crank1", m.ground, mb.Revolute(drive=mb.Polynomial((START, RATE))), **mb.rod(mass=1.0, length=l))
    pin = mb.Revolute(at=(l, 0.0, 0.0), start=float(along) - START)
    coupler = m.body("coupler", crank, pin, **mb.rod(mass=2.0, length=whole * scale))
    for k in range(2, cranks + 1):
        x = c / (cranks - 1) * (k - 1)
        on = mb.Revolute(at=(x, 0.0, 0.0), start=float(back) if cranks == 2 else START)
        own = m.body(f"crank{k}", m.ground, on, **mb.rod(mass=1.0, length=l))
        at = whole * scale if k == cranks else x
        m.cut(f"pin{k}", mb.RevoluteCutJoint(at_a=(at, 0.0, 0.0), at_b=(l, 0.0, 0.0)), coupler, own)
    return m


@pytest.mark.parametrize("scale", SCALES)
def test_a_singular_position_is_found_when_the_drive_gets_there(scale: float) -> None:
    found = mb.check(parallelogram(scale), 2.0, solver="adams")
    near = found.nearest
    assert near is not None
    assert near.t == pytest.approx((pi - START) / RATE, abs=1e-6)
    assert (near.gap, near.loops, near.passes) == (0.0, ("pin2",), 1)
    assert near.ratio < 1e-6
    assert found.hard[0] == "it passes through a singular configuration"
    assert set(found.hard[1:]) <= {"its steps are rejected near singular configurations"}  # 5 of 22 of this short run
    assert (
        f"(branches of the motion cross); smallest singular value of the constraint Jacobian {near.ratio:.1e}"
        in found.as_text()
    )
    assert (found.coordinates, found.rows, found.freedom, found.failure) == (2, 2, 0, "")
    (loop,) = found.loops
    assert loop.size == pytest.approx(2.5 * scale)
    assert set(loop.bodies) == {"ground", "crank1", "coupler", "crank2"}
    assert 0.0 < loop.gap < 1e-10


def test_a_missed_configuration_is_distinguished_from_one_that_is_passed() -> None:
    near = mb.check(parallelogram(longer=1e-5), 2.0, solver="adams").nearest
    assert near is not None
    assert near.t == pytest.approx((pi - START) / RATE, abs=1e-3)
    assert 1e-6 < near.gap < 1e-4
    assert 1e-4 < near.ratio < 0.05


@pytest.mark.parametrize("cranks", [2, 3, 4])
def test_redundant_rows_of_planar_loops_in_space_are_counted(cranks: int) -> None:
    found = mb.check(parallelogram(cranks=cranks), 0.2, solver="adams")
    assert len(found.redundant) == cranks - 2  # every crank beyond the second adds dependent equations
    assert len(found.vanishing) == 3 * (cranks - 1)  # of the five equations of a hinge, three
    assert sum(len(loop.redundant) for loop in found.loops) == cranks - 2
    assert f"redundant constraints: {cranks - 2 or 'none'} of {2 * (cranks - 1)}" in found.as_text()
    assert any("redundant" in text for text in found.hard) == (cranks > 2)


def pendulum(scale: float, stiffness: float, damping: float, stretch: float = 0.0) -> mb.Mechanism:
    """A bob of 1 kg on a spring of length 1 in a swinging guide, stretched by its weight, and by ``stretch`` more."""
    m, g, angle = mb.Mechanism(gravity=(0.0, -9.81 * scale, 0.0)), 9.81 * scale, 0.1
    down = g * cos(angle) / stiffness + scale * stretch
    arm = m.body("arm", m.ground, mb.Revolute(start=angle, fixed=True))
    slide = mb.Translational(axis="y", at=(0.0, -scale, 0.0), start=-down)
    bob = m.body("bob", arm, slide, mass=1.0)
    m.force("spring", mb.JointSpring(stiffness=stiffness, damping=damping), bob)
    return m


@pytest.mark.parametrize("scale", SCALES)
def test_the_eigenvalue_of_a_stiff_spring_is_found_and_the_solver_that_does_not_mind_it(scale: float) -> None:
    k, c = 1e8, 2e3  # sqrt(k/m) = 1e4, damped by a tenth
    found = mb.check(pendulum(scale, k, c), 0.1, solver="adams")
    stiff = found.stiffness
    assert stiff is not None
    assert stiff.eigenvalue == pytest.approx(complex(-0.5 * c, sqrt(k - 0.25 * c**2)), rel=1e-5)
    assert stiff.coordinate == "bob"
    swing = sqrt(9.81)
    assert 0.2 * swing < stiff.followed < 2.0 * swing
    assert stiff.ratio == pytest.approx(abs(stiff.eigenvalue) / stiff.followed)
    assert found.limit == "stability"
    assert found.suits is not None
    assert found.suits.solver == "radau"
    assert found.hard == ("it is stiff", "its step size is limited by stability")


def test_what_swings_must_be_followed_and_is_not_stiff() -> None:
    found = mb.check(pendulum(1.0, 1e4, 0.0, stretch=0.2), 1.0, solver="adams")
    assert found.stiffness is not None
    assert found.stiffness.followed == pytest.approx(100.0, rel=0.05)
    assert found.suits is not None
    assert found.suits.solver == "adams"
    assert found.hard == ()
    assert "no numerical difficulties" in found.as_text()


def open_loop() -> mb.Mechanism:
    m = mb.Mechanism()
    a = m.body("a", m.ground, mb.Revolute(), **mb.rod(mass=1.0, length=1.0))
    m.cut("pin", mb.RevoluteCutJoint(at_a=(5.0, 0.0, 0.0), at_b=(1.0, 0.0, 0.0)), m.ground, a)
    return m


def test_a_scene_that_cannot_start_is_an_error_with_the_reason() -> None:
    found = mb.check(open_loop(), 1.0)
    assert found.failure.startswith("loop cannot close: constraint 'pin.x'")
    assert found.freedom is None
    assert found.hard == ("it does not start",)
    assert "does not start: loop cannot close: constraint 'pin.x'" in found.as_text()
    assert [loop.name for loop in found.loops] == ["pin"]
    assert found.diagnostics[-1].text == (
        "not examined: singular configurations, stiffness and steps, because the run does not start"
    )
    assert mb.check(mb.Mechanism(), 1.0).failure.startswith("the mechanism has no bodies")


def test_a_run_that_stops_reports_time_and_reason() -> None:
    found = mb.check(parallelogram(longer=-0.1), 2.0, solver="adams")  # shorter than it needs to stretch out
    assert 0.1 < found.reached < 2.0
    assert found.hard[0] == "it stops early"
    assert f"stopped at {found.reached:.6g} s: " in found.as_text()
    assert found.nearest is not None
    assert found.nearest.t == pytest.approx(found.reached, abs=0.02)


def test_forced_time_scales_and_the_largest_step_are_seen_to_set_the_steps() -> None:
    m = mb.Mechanism()
    drive = mb.Harmonic(amplitude=1e-9, frequency=1e3)
    wheel = m.body("wheel", m.ground, mb.Revolute(start=0.0), mass=1.0, inertia=(1.0, 1.0, 1.0))
    m.force("shake", mb.JointForce(magnitude=drive), wheel)
    assert mb.check(m, 0.1, solver="adams").limit == "drives"
    assert mb.check(parallelogram(), 0.2, solver="adams", max_step=1e-3).limit == "max_step"
    assert mb.check(pendulum(1.0, 1e3, 0.0), 0.2, solver="adams").limit == "accuracy"


def test_the_fastest_motion_of_a_large_tree_is_found_and_what_is_not_checked_is_reported() -> None:
    found = mb.check(Sheet(nx=7, nz=5, damping=0.01), 0.01, solver="esdirk", tolerance=1e-4)
    assert found.tree
    assert found.stiffness is not None
    assert found.stiffness.ratio > 50.0
    assert found.suits is not None
    assert found.suits.solver == "esdirk"
    assert any("(large model)" in d.text for d in found.diagnostics)


def test_a_run_that_takes_too_long_is_ended_and_reported() -> None:
    found = mb.check(parallelogram(), 2.0, patience=1e-6, solver="adams")
    assert found.reached < 2.0
    assert "the run takes longer than 1e-06 s" in next(d.text for d in found.diagnostics if d.code == "not-examined")
    assert not found.failure


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"solvr": "ida"}, "has no argument 'solvr'; did you mean 'solver'"),
        ({"solver": "id"}, "solver is 'id'"),
        ({"patience": 0.0}, r"patience is 0\.0 s; allowed: greater than zero"),
        ({"stop_time": -1.0}, r"stop_time is -1\.0; allowed: a number of seconds greater than zero"),
    ],
)
def test_odd_arguments_are_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(mb.UserError, match=message):
        mb.check(parallelogram(), **given)
    with pytest.raises(mb.UserError, match="model is 3; allowed"):
        mb.check(3)  # type: ignore[arg-type]


def test_the_command_prints_the_same(command: Callable[..., Any], tmp_path: Path) -> None:
    given = ("check", "fourbar", "--solver", "adams", "--stop-time", "1")
    code, out, err = command(*given)
    assert (code, err) == (0, "")
    assert out.startswith("fourbar/default: numerically difficult: it passes through a singular configuration\n")
    code, printed, _ = command(*given, "--json")
    found = json.loads(printed)
    assert code == 0
    assert found["nearest"]["t"] == pytest.approx(0.1816187, abs=1e-6)
    assert found["hard"] == ["it passes through a singular configuration"]
    assert found["suits"]["solver"] == "adams"
    assert found["stiffness"]["eigenvalue"][0] == pytest.approx(0.0, abs=2.0)
    path = tmp_path / "findings.json"
    code, again, _ = command(*given, "--json", str(path))
    assert again == out
    assert json.loads(path.read_text())["nearest"] == found["nearest"]
    code, _, err = command("check", "fourbar", "--patience", "-1")
    assert code == 2
    assert "patience is -1.0 s" in err


def test_numbers_that_are_none_are_null_in_json() -> None:
    found = mb.check(open_loop(), 1.0).as_dict()
    assert found["loops"][0]["gap"] is None
    assert json.loads(json.dumps(found, allow_nan=False)) == json.loads(json.dumps(found))


def test_where_stability_sets_the_steps_an_implicit_solver_is_tried() -> None:
    """A rotor at constant speed with something stiff and damped on it: the speed need not be followed."""
    m = mb.Mechanism()
    hub = m.body("hub", m.ground, mb.Revolute(rate=314.0, fixed=True), mass=1.0, inertia=(1.0, 1.0, 1.0))
    disk = m.body("disk", hub, mb.Revolute(start=1e-3, fixed=True), mass=1e-3, inertia=(0.01, 0.01, 0.01))
    m.force("shaft", mb.JointSpring(stiffness=1e3, damping=100.0), disk)
    found = mb.check(m, 1.0, solver="adams")
    assert found.limit == "stability"
    assert found.suits is not None
    assert found.suits.solver == "radau"
    assert "it is stiff" in found.hard


@pytest.mark.parametrize("decay", [0.1, 20.0])
def test_a_motion_that_dies_out_is_not_stiff_if_nothing_is_faster(decay: float) -> None:
    """An oscillator of 5 rad/s that is damped by ``decay``: 0.1 swings, 20 has the rates 200 and 0.125 1/s.

    In both cases radau takes fewer evaluations, since the motion dies out.
    """
    m = mb.Mechanism()
    cart = m.body("cart", m.ground, mb.Translational(axis="x", start=0.1, fixed=True, nominal=1.0), mass=2.0)
    m.force("spring", mb.JointSpring(stiffness=50.0, damping=20.0 * decay), cart)
    found = mb.check(m, 40.0, solver="adams")
    assert found.suits is not None
    assert found.suits.solver == "radau"
    assert found.stiffness is not None
    fastest = 5.0 if decay < 1.0 else 5.0 * (decay + sqrt(decay**2 - 1.0))
    assert abs(found.stiffness.eigenvalue) == pytest.approx(fastest, rel=1e-5)
    assert ("it is stiff" in found.hard) == (decay > 1.0)
    assert ("stiffness: none" in found.as_text()) == (decay < 1.0)


def test_every_loop_of_a_singular_position_is_named_one_of_redundant_rows_too() -> None:
    near = mb.check(parallelogram(cranks=4), 2.0, solver="adams").nearest
    assert near is not None
    assert near.loops == ("pin2", "pin3", "pin4")


@pytest.mark.parametrize("scale", SCALES)
def test_eigenvalues_that_are_rounding_are_zero(scale: float) -> None:
    m = mb.Mechanism()
    m.body("rotor", m.ground, mb.Revolute(rate=3.0), **mb.rod(mass=1.0, length=scale))
    found = mb.check(m, 1.0, solver="adams")
    assert found.stiffness is not None
    assert found.stiffness.eigenvalue == 0.0
    assert "all eigenvalues are zero; the motion changes at 3 1/s (5 states examined)" in found.as_text()
    assert "size: 1 joint coordinate, 0 constraints, 1 degree of freedom" in found.as_text()


def door(floating: bool) -> mb.Mechanism:
    """A door on two hinges in line, the first of which is its joint, or a cut joint too."""
    m = mb.Mechanism()
    own = mb.Floating() if floating else mb.Revolute(axis="y")
    leaf = m.body("leaf", m.ground, own, mass=1.0, com=(0.5, 0.0, 0.0), inertia=(0.1, 0.1, 0.1))
    if floating:
        m.cut("lower", mb.RevoluteCutJoint(axis="y"), m.ground, leaf)
    m.cut("upper", mb.RevoluteCutJoint(axis="y", at_a=(0.0, 1.0, 0.0), at_b=(0.0, 1.0, 0.0)), m.ground, leaf)
    return m


def test_a_second_hinge_is_reported_in_one_way() -> None:
    assert "redundant constraints: 5 of 10 (" in mb.check(door(floating=True), 0.1).as_text()
    expected = "redundant constraints: none (5 constraints always satisfied and removed)"
    assert expected in mb.check(door(floating=False), 0.1).as_text()


def test_quiet_prints_no_findings(command: Callable[..., Any], tmp_path: Path) -> None:
    assert command("check", "fourbar", "--stop-time", "0.1", "-q")[:2] == (0, "")
    path = tmp_path / "findings.json"
    assert command("check", "fourbar", "--stop-time", "0.1", "-q", "--json", str(path))[:2] == (0, "")
    assert json.loads(path.read_text())["name"] == "fourbar/default"

"""Equilibrium paths: through limit points against closed forms, onto bent branches against shooting by SciPy."""

from __future__ import annotations

import csv
from math import cos, hypot, pi, sin, sqrt, tan
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import null_space
from scipy.optimize import brentq

import mbfmu as mb
from fmus.governor import Governor
from mbfmu.cli import main
from mbfmu.steady.path import PathBranch, PathProblem
from mbfmu.verification.mechanisms.plates import PLATES, ROOTS, compressed_plate, ritz_buckling_load
from mbfmu.verification.mechanisms.shells import hinged_roof
from solvers.statics.linearized import TreeLinearized
from solvers.statics.matrices import MAX_ASSEMBLED_COORDINATES

RISE = 0.3  # of the truss, over half its span


def truss(span: float = 1.0, stiffness: float = 100.0) -> mb.Mechanism:
    """Von Mises' truss: two springs from the ground to an apex that slides up and down."""
    m = mb.Mechanism()
    apex = m.body("apex", m.ground, mb.Translational(axis="y", start=RISE * span), mass=1.0)
    for side, name in ((-1.0, "left"), (1.0, "right")):
        free = hypot(span, RISE * span)
        m.force(name, mb.Spring(stiffness=stiffness, free=free, at_a=(side * span, 0.0, 0.0)), m.ground, apex)
    m.force("load", mb.PointForce(magnitude=mb.Input(name="force", unit="N"), axis="y"), apex)
    m.output("y", apex.position("y"))
    return m


def changes(branch: PathBranch, kind: str = "limit point") -> list[float]:
    """Loads of the singular points of one kind."""
    return [state.value for state in branch.of_kind(kind)]


@pytest.mark.parametrize(("span", "force"), [(1.0, 1.0), (1e-3, 1e-6), (1e3, 1e6), (1e-3, 1e6)])
def test_a_truss_snaps_through_both_limit_points(span: float, force: float) -> None:
    k, free = 100.0 * force / span, hypot(span, RISE * span)
    found = mb.equilibrium_path(truss(span, k), "force", (0.0, -5.0 * force))
    (branch,) = found.branches
    y, p = np.array(branch.output("y")), np.array(branch.values)
    np.testing.assert_allclose(p, 2.0 * k * (1.0 - free / np.hypot(span, y)) * y, atol=1e-11 * force)
    assert p[-1] == -5.0 * force
    assert np.all(np.diff(y) < 0.0)
    turn = sqrt((free * span**2) ** (2.0 / 3.0) - span**2)  # where dp/dy = 0
    load = 2.0 * k * (1.0 - free / hypot(span, turn)) * turn
    assert [s.outputs["y"] / span for s in found.limit_points] == pytest.approx([turn / span, -turn / span], abs=1e-6)
    assert [s.value for s in found.limit_points] == pytest.approx([load, -load], rel=1e-10)
    assert found.bifurcations == []
    for state in branch.states:
        if not state.kind:
            inside = abs(state.outputs["y"]) < turn
            assert state.unstable == int(inside)
            assert state.stability == ("unstable" if inside else "undamped")


def test_a_path_ends_where_an_output_has_its_value() -> None:
    (branch,) = mb.equilibrium_path(truss(), "force", (0.0, -5.0), until=("y", 0.05)).branches
    assert branch.output("y")[-1] == pytest.approx(0.05, abs=1e-7)
    assert branch.ended == ""


def test_a_path_that_turns_back_ends_as_far_on_the_other_side() -> None:
    (branch,) = mb.equilibrium_path(truss(), "force", (0.0, 0.5)).branches  # upwards there is no limit
    assert branch.values[-1] == 0.5
    (branch,) = mb.equilibrium_path(truss(), "force", (-0.8, -1.5)).branches  # back to -0.1
    assert branch.values[-1] == pytest.approx(-0.1)
    assert branch.states[-1].stability == "unstable"


def toggle(bar: float, start: float, stiffness: float, angle: float) -> mb.Mechanism:
    """Two rigid bars between a hinge and a slider on a spring, drawn with the line of the hinges at an angle."""
    m = mb.Mechanism()
    frame = m.body("frame", m.ground, mb.Weld(rotation=about_z(angle)))
    left = m.body("left", frame, mb.Revolute(start=start, fixed=True), **mb.rod(mass=1.0, length=bar))
    right = m.body("right", left, mb.Revolute(at=(bar, 0.0, 0.0), start=-2.0 * start), **mb.rod(mass=1.0, length=bar))
    span = 2.0 * bar * cos(start)
    slider = m.body("slider", frame, mb.Translational(axis="x", start=span), mass=1.0)
    m.cut("pin", mb.RevoluteCutJoint(at_a=(bar, 0.0, 0.0)), right, slider)
    m.force("spring", mb.JointSpring(stiffness=stiffness, free=span), slider)
    load = mb.Input(name="force", unit="N")
    for axis, part in (("x", sin(angle)), ("y", -cos(angle))):
        m.force(axis, mb.PointForce(magnitude=mb.Product(load, part), axis=axis, at_a=(bar, 0.0, 0.0)), left)
    m.output("angle", left.angle())
    return m


def about_z(angle: float) -> NDArray[np.float64]:
    """Rotation about z."""
    return np.array([[cos(angle), -sin(angle), 0.0], [sin(angle), cos(angle), 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_a_toggle_with_a_cut_joint_snaps_through(size: float) -> None:
    start, k = 0.5, 10.0 / size
    found = mb.equilibrium_path(toggle(size, start, k, 0.7), "force", (0.0, 4.0))
    (branch,) = found.branches
    a, p = np.array(branch.output("angle")), np.array(branch.values)
    np.testing.assert_allclose(p, 4.0 * k * size * (np.cos(a) - cos(start)) * np.tan(a), atol=1e-9)
    turn = np.arccos(cos(start) ** (1.0 / 3.0))  # d/da of (cos a - cos b) tan a: cos^3 a = cos b
    load = 4.0 * k * size * (cos(turn) - cos(start)) * tan(turn)
    assert [s.value for s in found.limit_points] == pytest.approx([load, -load], rel=1e-9)
    assert p[-1] == 4.0
    assert max(s.unstable for s in branch.states) == 1


def column(n: int, *, guided: bool = False, length: float = 1.0, spring: float = 1.0) -> mb.Mechanism:
    """Straight chain of n bars with torsion springs, compressed along x: clamped and free, or hinged and guided."""
    m, bar = mb.Mechanism(), length / n
    body, force = m.ground, mb.Input(name="force", unit="N")
    for k in range(n):
        body = m.body(f"bar{k}", body, mb.Revolute(at=(bar if k else 0.0, 0.0, 0.0)), **mb.rod(mass=1.0, length=bar))
        if k or not guided:
            m.force(f"spring{k}", mb.JointSpring(stiffness=spring), body)
    tip = (bar, 0.0, 0.0)
    m.force("load", mb.PointForce(magnitude=mb.Product(force, -1.0), axis="x", at_a=tip), body)
    if guided:
        m.cut("guide", mb.PlaneCutJoint(at_b=tip, axis="y"), m.ground, body)
    m.output("x", body.position("x", point=tip))
    m.output("y", body.position("y", point=tip))
    return m


def buckling_loads(n: int, guided: bool) -> NDArray[np.float64]:
    """Loads at which the chain of unit length and springs buckles, from its absolute angles."""
    D = np.diff(np.eye(n), axis=0)
    K = n * D.T @ D
    if not guided:
        K[0, 0] += n
        return np.linalg.eigvalsh(K)
    free = null_space(np.ones((1, n)))
    return np.linalg.eigvalsh(free.T @ K @ free)


def bent_tip(n: int, load: float) -> tuple[float, float]:
    """Tip of the clamped chain on its first bent branch, by shooting from the tip: moments add up bar by bar."""

    def angles(tip: float) -> list[float]:
        found, bend = [tip], 0.0
        for _ in range(n):
            bend += load / n * sin(found[-1])
            found.append(found[-1] - bend)
        return found

    tip = brentq(lambda a: angles(a)[-1], 1e-6, pi - 1e-9, xtol=1e-14, rtol=1e-14)
    return sum(map(cos, angles(tip)[:-1])) / n, sum(map(sin, angles(tip)[:-1])) / n


@pytest.mark.parametrize(("n", "length"), [(6, 1.0), (6, 1e-3), (6, 1e3), (70, 1.0)])
def test_a_column_buckles_and_bends_as_by_shooting(n: int, length: float) -> None:
    """Of 6 bars with dense matrices, of 70 as a large tree."""
    first, second, *_ = buckling_loads(n, guided=False)
    found = mb.equilibrium_path(column(n, length=length), "force", (0.0, 0.9 * second / length), second=True)
    assert [s.value * length for s in found.bifurcations] == pytest.approx([first], rel=1e-8)
    straight, *bent = found.branches
    assert np.abs(straight.output("y")).max() == 0.0
    assert [s.unstable for s in straight.states] == [int(v > 1.0001 * first / length) for v in straight.values]
    assert len(bent) == 2
    for branch, side in zip(bent, np.sign([branch.output("y")[-1] for branch in bent]), strict=True):
        assert branch.values[-1] == 0.9 * second / length
        for state in branch.states[1:]:
            x, y = bent_tip(n, state.value * length)
            assert state.outputs["x"] / length == pytest.approx(x, abs=1e-8)
            assert state.outputs["y"] / length == pytest.approx(side * y, abs=1e-8)
            assert state.unstable == 0
    assert bent[0].output("y")[-1] * bent[1].output("y")[-1] < 0.0


@pytest.mark.parametrize("n", [6, 110])
def test_a_guided_column_buckles_at_the_loads_of_its_eigenvalues(n: int) -> None:
    loads = buckling_loads(n, guided=True)
    found = mb.equilibrium_path(column(n, guided=True), "force", (0.0, 1.1 * loads[1]), second=True)
    assert [s.value for s in found.bifurcations] == pytest.approx(loads[:2], rel=1e-7)
    assert [s.unstable for s in found.bifurcations] == [0, 1]
    assert len(found.branches) == 5
    for branch in found.branches[1:]:
        assert min(branch.output("x")) < 0.9
        np.testing.assert_allclose(branch.output("y"), 0.0, atol=1e-12)


@pytest.mark.parametrize(("n", "guided"), [(70, False), (110, True)])
@pytest.mark.parametrize("load", [0.5, 1.5, 10.0, 60.0])
def test_unstable_motions_of_a_large_tree_are_the_buckling_loads_that_are_passed(
    n: int, guided: bool, load: float
) -> None:
    loads = buckling_loads(n, guided)
    problem = PathProblem(column(n, guided=guided), "force")
    problem.apply(load * loads[0])
    equations = problem.problem.linearized()
    assert isinstance(equations, TreeLinearized)
    q, none = problem.problem.start(), np.zeros(problem.compiled.system.m)
    assert equations.inspect(q, none) == np.sum(loads < load * loads[0])


@pytest.mark.parametrize(("guided", "load"), [(False, 0.5), (False, 10.0), (True, 10.0), (False, 2000.0)])
def test_unstable_motions_of_a_very_large_tree_that_turns_are_counted(guided: bool, load: float) -> None:
    """A disk that turns next to the column changes nothing, but its matrix is assembled and factored no more."""
    n = 320
    loads, m = buckling_loads(n, guided), column(n, guided=guided)
    speed = mb.SpeedInput(name="speed", unit="rad/s", start=1.0)
    m.body("disk", m.ground, mb.Revolute(axis="y", drive=speed), **mb.rod(mass=1.0, length=1.0))
    problem = PathProblem(m, "force")
    problem.apply(load * loads[0])
    equations = problem.problem.linearized()
    assert problem.compiled.system.n > MAX_ASSEMBLED_COORDINATES
    none = np.zeros(problem.compiled.system.m)
    assert equations.inspect(problem.problem.start(), none) == np.sum(loads < load * loads[0])


@pytest.mark.parametrize("n", [4, 35])
def test_a_column_that_may_buckle_to_all_sides_has_a_double_bifurcation(n: int) -> None:
    m, body, force = mb.Mechanism(), None, mb.Input(name="force", unit="N")
    for k in range(n):
        for axis in "yz":
            own = mb.rod(mass=1.0, length=1.0 / n) if axis == "z" else {}
            at = (1.0 / n if k and axis == "y" else 0.0, 0.0, 0.0)
            body = m.body(f"bar{k}.{axis}", body or m.ground, mb.Revolute(axis=axis, at=at), **own)
            m.force(f"spring{k}.{axis}", mb.JointSpring(stiffness=1.0), body)
    push = mb.PointForce(magnitude=mb.Product(force, -1.0), axis="x", at_a=(1.0 / n, 0.0, 0.0))
    m.force("load", push, body)
    first, second, *_ = buckling_loads(n, guided=False)
    (branch,) = mb.equilibrium_path(m, "force", (0.0, 0.9 * second)).branches
    assert changes(branch, "bifurcation") == pytest.approx([first], rel=1e-7)
    assert [s.unstable for s in branch.states if not s.kind] == [
        2 * (s.value > first) for s in branch.states if not s.kind
    ]


@pytest.mark.parametrize("load", [0.5, 1.5, 10.0])
def test_redundant_guides_of_a_large_tree_change_nothing(load: float) -> None:
    n, tip = 110, (1.0 / 110, 0.0, 0.0)
    loads, m = buckling_loads(n, guided=True), column(n, guided=True)
    m.cut("again", mb.PlaneCutJoint(at_b=tip, axis="y"), m.ground, m.bodies[-1])
    problem = PathProblem(m, "force")
    problem.apply(load * loads[0])
    equations = problem.problem.linearized()
    assert isinstance(equations, TreeLinearized)
    passed = int(np.sum(loads < load * loads[0]))
    assert equations.inspect(problem.problem.start(), np.zeros(2)) == passed


def test_a_moved_support_carries_a_slider_along() -> None:
    stiffness, free = (100.0, 60.0), hypot(1.0, RISE)
    m = mb.Mechanism()
    lift = mb.Translational(axis="y", drive=mb.Input(name="height", unit="m", start=RISE))
    slider = m.body("slider", m.body("lift", m.ground, lift), mb.Translational(axis="x"), mass=1.0)
    for k, x in zip(stiffness, (-1.0, 1.0), strict=True):
        m.force(f"spring{x}", mb.Spring(stiffness=k, free=free, at_a=(x, 0.0, 0.0)), m.ground, slider)
    m.output("x", slider.position("x"))
    (branch,) = mb.equilibrium_path(m, "height", (0.5, -0.9)).branches
    assert branch.values[-1] == -0.9
    for state in branch.states:

        def pull(x: float, height: float = state.value) -> float:
            return sum(
                k * (1.0 - free / hypot(x - end, height)) * (x - end)
                for k, end in zip(stiffness, (-1.0, 1.0), strict=True)
            )

        assert state.outputs["x"] == pytest.approx(brentq(pull, -0.5, 0.5, xtol=1e-14), abs=1e-10)
    assert max(np.abs(branch.output("x"))) > 0.01


def test_a_pendulum_on_a_spindle_leaves_the_vertical_at_the_critical_speed() -> None:
    g, length = 9.81, 0.5
    m = mb.Mechanism(gravity=(0.0, -g, 0.0))
    spindle = m.body("spindle", m.ground, mb.Revolute(axis="y", drive=mb.SpeedInput(name="speed", unit="rad/s")))
    arm = m.body("arm", spindle, mb.Revolute(axis="z"), mass=1.0, com=(0.0, -length, 0.0))
    m.output("angle", arm.angle())
    found = mb.equilibrium_path(m, "speed", (1.0, 12.0), second=True)
    assert [s.value for s in found.bifurcations] == pytest.approx([sqrt(g / length)], rel=1e-9)
    hanging, *raised = found.branches
    assert np.abs(hanging.output("angle")).max() < 1e-12
    assert hanging.states[0].stability == "undamped"
    assert hanging.states[-1].stability == "unstable"
    assert sorted(branch.output("angle")[-1] > 0.0 for branch in raised) == [False, True]
    for branch in raised:
        for state in branch.states[1:]:
            assert cos(state.outputs["angle"]) == pytest.approx(g / (length * state.value**2), rel=1e-9)
            assert state.stability == "undamped"


def test_a_governor_follows_its_closed_form_over_the_speed() -> None:
    (branch,) = mb.equilibrium_path(Governor(), "spindle.drive", (5.0, 20.0)).branches
    assert branch.values[-1] == 20.0
    for state in branch.states:
        model = Governor(spindle_speed=state.value)
        phi = state.outputs["arm1.angle"]
        stiffness = abs(model.minimal(0.0, [phi + 1e-6, 0.0])[1]) / 1e-6
        assert model.minimal(0.0, [phi, 0.0])[1] == pytest.approx(0.0, abs=1e-10 * max(1.0, stiffness))


@pytest.mark.parametrize(("thickness", "end", "published"), [(12.7e-3, 3000.0, 0.7421), (6.35e-3, 1000.0, 0.1953)])
def test_a_hinged_roof_snaps_through(thickness: float, end: float, published: float) -> None:
    """The largest tabulated load on the way up, over 3000 N: Sze, Liu and Lo, table 9, as another program cites it.

    The thin one snaps back too: its middle rises while the load falls.
    """
    coarse, fine = (mb.equilibrium_path(hinged_roof((n, n), thickness), "force", (0.0, end)) for n in (4, 8))
    (branch,) = fine.branches
    upper, lower = fine.limit_points
    assert upper.value == pytest.approx(3000.0 * published, rel=0.01)
    assert abs(upper.value / 3000.0 - published) < abs(coarse.limit_points[0].value / 3000.0 - published)
    assert lower.value < upper.value
    assert branch.values[-1] == end
    between = branch.states[branch.states.index(upper) + 1 : branch.states.index(lower)]
    assert {state.unstable for state in between} == {1}
    assert {state.unstable for state in branch.states if state not in between} == {0}
    falls = np.all(np.diff(branch.output("y")) < 0.0)
    assert falls == (thickness > 0.01)


@pytest.mark.parametrize("edges", PLATES)
def test_a_compressed_plate_buckles_at_one_load_whatever_the_tree(edges: str) -> None:
    loads = []
    for root in ROOTS:
        m = compressed_plate(edges, 16, mb.Input(name="load", unit=""), root)
        m.output("energy", m.energy)
        found = mb.equilibrium_path(m, "load", (0.0, 1.2), second=root == ROOTS[0])
        loads.append(found.bifurcations[0].value)
        for branch in found.branches[1:]:
            assert min(branch.values) >= (1.0 - 1e-9) * loads[0]
            assert branch.values[-1] == 1.2
            assert branch.states[1].unstable == 0
    np.testing.assert_allclose(loads, loads[0], rtol=1e-7)
    assert loads[0] == pytest.approx(ritz_buckling_load(edges), rel=0.02)


def test_what_cannot_be_followed_is_refused() -> None:
    with pytest.raises(mb.UserError, match=r"no input 'forc'; did you mean 'force'"):
        mb.equilibrium_path(truss(), "forc", (0.0, 1.0))
    with pytest.raises(mb.UserError, match=r"'arm_length' is a parameter .* allowed: spindle.drive"):
        mb.equilibrium_path(Governor(), "arm_length", (0.1, 0.2))
    with pytest.raises(mb.UserError, match="two different values"):
        mb.equilibrium_path(truss(), "force", (1.0, 1.0))
    with pytest.raises(mb.UserError, match="end of 'force' is nan"):
        mb.equilibrium_path(truss(), "force", (1.0, float("nan")))
    with pytest.raises(mb.UserError, match=r"until 'z': model .* has no such output"):
        mb.equilibrium_path(truss(), "force", (0.0, 1.0), until=("z", 1.0))
    with pytest.raises(mb.UserError, match="steps is 0"):
        mb.equilibrium_path(truss(), "force", (0.0, 1.0), steps=0)


def test_a_path_that_ended_early_has_the_reason() -> None:
    (branch,) = mb.equilibrium_path(truss(), "force", (0.0, -5.0), steps=3).branches
    assert branch.ended == "the maximum of 3 steps was reached"
    assert len(branch.states) == 4


def test_the_command_leaves_a_picture_and_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        main(["path", "governor", "--over", "spindle.drive=5:12", "--plot", "collar.height", "-o", str(tmp_path)]) == 0
    )
    assert "collar.height [m]" in capsys.readouterr().out
    folder = tmp_path / "governor" / "default-path-spindle.drive"
    assert (folder / "path.png").stat().st_size > 10_000
    with (folder / "path.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert float(rows[0]["spindle.drive [rad/s]"]) == 5.0
    assert float(rows[-1]["spindle.drive [rad/s]"]) == 12.0
    assert {row["stability"] for row in rows} == {"undamped"}


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--over", "spindle.drive=5"], "allowed: INPUT=FROM:TO"),
        (["--over", "spindle.drive=5:x"], "'x' is not a number"),
        (["--over", "spindle.drive=5:9", "--until", "collar.heigth=1"], "did you mean 'collar.height'"),
        (["--over", "gravity=5:9"], "is a parameter"),
    ],
)
def test_the_command_reports_what_is_wrong(
    arguments: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["path", "governor", *arguments, "-o", str(tmp_path)]) == 2
    assert told in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []

"""Starts and rates that are given: next to no turn of a ball, and what the loops leave of given values."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism, Floating, Mechanism, Revolute, RevoluteCutJoint, Spherical, rod

COM, MASS, INERTIA = np.array((0.0, 0.1, 0.05)), 1.0, np.diag((0.01, 0.01, 0.02))


def turned(angle: float) -> tuple[float, ...]:
    return (float(np.cos(0.5 * angle)), float(np.sin(0.5 * angle)), 0.0, 0.0)


def top(angle: float, size: float = 1.0) -> Mechanism:
    m = Mechanism(gravity=(0, -9.81 * size, 0))
    body = {"mass": MASS, "com": tuple(size * COM), "inertia": np.diag(INERTIA) * size**2}
    b = m.body("b", m.ground, Spherical(start=turned(angle)), **body)
    m.output("y", b.position("y", (0, 0.1 * size, 0)))
    return m


def height_of_top(angle: float, end: float) -> float:
    """Height of the point by Euler's equations and the rotation matrix, in SciPy."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    about_pivot = INERTIA + MASS * (COM @ COM * np.eye(3) - np.outer(COM, COM))

    def slope(t: float, x: Any) -> Any:
        A, w = x[:9].reshape(3, 3), x[9:]
        moment = np.cross(COM, MASS * A.T @ (0.0, -9.81, 0.0)) - np.cross(w, about_pivot @ w)
        turn = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        return np.concatenate(((A @ turn).ravel(), np.linalg.solve(about_pivot, moment)))

    run = solve_ivp(slope, (0.0, end), np.concatenate((R.ravel(), np.zeros(3))), rtol=1e-11, atol=1e-12)
    return float(run.y[:9, -1].reshape(3, 3)[1] @ (0.0, 0.1, 0.0))


@pytest.mark.parametrize("solver", ["adams", "hybrid", "radau", "ida"])
@pytest.mark.parametrize("angle", [1e-18, 1e-12, 1e-8])
def test_a_ball_joint_that_starts_turned_by_next_to_nothing_runs(solver: str, angle: float) -> None:
    run = mb.simulate(top(angle), 0.3, interval=0.1, solver=solver, tolerance=1e-8)
    assert not run.failure
    assert run["y"][-1] == pytest.approx(height_of_top(angle, 0.3), abs=1e-6)


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_it_does_so_at_other_sizes(size: float) -> None:
    run = mb.simulate(top(1e-12, size), 0.3, interval=0.1, solver="adams", tolerance=1e-8)
    assert run["y"][-1] == pytest.approx(size * height_of_top(1e-12, 0.3), abs=1e-6 * size)


@pytest.mark.parametrize("attitude", [(1.0, 0, 0, 0), turned(1e-12), turned(1.0), (0, 0, 1.0, 0), (0.5, 0.5, 0.5, 0.5)])
def test_units_of_a_quaternion_follow_from_its_joint_and_not_from_the_attitude(attitude: Any) -> None:
    from solvers.steppers import stepper

    m = Mechanism()
    joint = Floating(start=(0, 0, 0, *attitude), nominal=(2.0, 3.0, 4.0, 0.5, 0.2, 0.4))
    m.body("b", m.ground, joint, mass=1, inertia=(1, 1, 1))
    arm = m.body("arm", m.ground, Revolute(nominal=7.0), **rod(mass=1, length=1))
    m.output("angle", arm.angle())
    compiled = CompiledMechanism(m)
    motion: Any = stepper("adams", compiled.system, 0.0, *compiled.assemble())
    np.testing.assert_array_equal(motion.formulation.workspace.size_q, [2.0, 3.0, 4.0, 0.1, 0.1, 0.1, 0.1, 7.0])


def four_bar(size: float = 1.0, **joints: dict[str, Any]) -> Mechanism:
    """A parallelogram whose coordinates are a, -a, a."""
    m = Mechanism(gravity=(0, -9.81, 0))
    of = {name: joints.get(name, {}) for name in ("crank", "coupler", "rocker")}
    crank = m.body("crank", m.ground, Revolute(**of["crank"]), **rod(mass=1, length=size))
    coupler = m.body("coupler", crank, Revolute(at=(size, 0, 0), **of["coupler"]), **rod(mass=3, length=3 * size))
    rocker = m.body("rocker", coupler, Revolute(at=(3 * size, 0, 0), **of["rocker"]), **rod(mass=1, length=-size))
    m.cut("pivot", RevoluteCutJoint(at_a=(-size, 0, 0), at_b=(3 * size, 0, 0)), rocker, m.ground)
    m.output("angle", crank.angle())
    return m


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_given_values_are_kept_where_the_others_can_follow(size: float) -> None:
    given = {"crank": {"start": 0.3, "rate": 0.5}, "coupler": {"start": -0.31}, "rocker": {"start": 0.28}}
    compiled = CompiledMechanism(four_bar(size, **given))
    q, v = compiled.assemble()
    np.testing.assert_allclose(v, [0.5, -0.5, 0.5], rtol=1e-9)  # of a parallelogram
    only = CompiledMechanism(four_bar(size, crank={"start": 0.3, "rate": 0.5}))
    q, v = only.assemble()
    assert (q[0], v[0]) == (0.3, 0.5)
    assert max(only.residuals(0.0, q, v)) < 1e-10 * size
    assert only.assembly.changes(q, v, 1e-9) == []


def test_what_is_not_given_changes_first_where_given_values_contradict_each_other() -> None:
    """Crank and coupler do not fit together; the rocker is free. The change of the given ones is the least there is."""
    compiled = CompiledMechanism(four_bar(crank={"start": 0.3}, coupler={"start": -0.35}, rocker={"rate": 0.2}))
    q, v = compiled.assemble()
    a = q[0]
    np.testing.assert_allclose(q, [a, -a, a], atol=1e-9)
    np.testing.assert_allclose(v, [0.2, -0.2, 0.2], rtol=1e-9)
    assert a == pytest.approx(0.325, abs=5e-3)  # halfway, as both weigh the same; a third less if all did
    told = list(map(str, compiled.assembly.changes(q, v, 1e-6)))
    assert [text.partition(" is changed from ")[0] for text in told] == [
        "start of body 'crank'",
        "start of body 'coupler'",
    ]
    assert f"from 0.3 to {a:.6g} rad," in told[0]


@pytest.mark.parametrize(
    ("joints", "told"),
    [
        ({"crank": {"start": 0.3, "fixed": True}}, ()),
        ({"crank": {"start": 0.3}, "coupler": {"start": -0.3}, "rocker": {"start": 0.3}}, ()),
        ({"crank": {"start": 0.3, "fixed": True}, "coupler": {"start": -0.4}}, ("start of body 'coupler'",)),
        (
            {"crank": {"start": 0.3, "rate": 1.0}, "rocker": {"rate": 2.0}},
            ("rate of body 'crank'", "rate of body 'rocker'"),
        ),
    ],
)
def test_a_run_reports_given_values_that_were_changed_and_nothing_else(joints: Any, told: Any) -> None:
    run = mb.simulate(four_bar(**joints), 0.01, solver="adams")
    said = [text.partition(" is changed from ")[0] for text in map(str, run.diagnostics) if " is changed from " in text]
    assert tuple(said) == told


def test_a_check_of_a_far_start_ends_in_findings() -> None:
    """The check has a second solver, which must accept what the run accepts; the loop is too coarse to be closed."""
    turns = 2.0 * np.pi * 1e9
    joints = {"crank": {"start": 0.3 + turns}, "coupler": {"start": -0.3}, "rocker": {"start": 0.3}}
    found = mb.check(four_bar(**joints), 0.05, tolerance=1e-2, solver="adams")
    assert found.freedom == 1
    assert found.failure

"""Loops that close by parallel axes, whose axes are off by a rounding: they move as exact ones do, or are refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbfmu as mb
from mbfmu.mechanics import (
    CompiledMechanism,
    CylindricalCutJoint,
    Mechanism,
    Revolute,
    RevoluteCutJoint,
    SphericalCutJoint,
    Translational,
    Weld,
    rod,
)

CRANK, COUPLER, ROCKER, BASE, MASSES = 0.3, 0.8, 0.6, 0.7, (1.0, 2.0, 1.5)
ROUNDED = 1.5708 - 0.5 * np.pi


def turn(angle: float, axis: str) -> Any:
    c, s = np.cos(angle), np.sin(angle)
    turns = {
        "x": ((1, 0, 0), (0, c, -s), (0, s, c)), "y": ((c, 0, s), (0, 1, 0), (-s, 0, c)),
        "z": ((c, -s, 0), (s, c, 0), (0, 0, 1)),
    }  # fmt: skip
    return np.array(turns[axis], float)


ASKEW = turn(0.7, "x") @ turn(-1.1, "y") @ turn(0.4, "z")


def cut_of(kind: str, size: float) -> Any:
    at: Any = {"at_a": (COUPLER * size, 0, 0), "at_b": (ROCKER * size, 0, 0)}
    if kind == "ball":
        return SphericalCutJoint(**at)
    role = {"sleeve": CylindricalCutJoint, "hinge": RevoluteCutJoint}[kind]
    return role(axis="z", rotation_b=turn(0.5 * np.pi, "x"), **at)


def four_bar(tilt: float, kind: str, size: float = 1.0, attitude: Any = None, **given: Any) -> Mechanism:
    """Hinges along y; that of the coupler is turned there from z, by a right angle that is off by ``tilt``."""
    R = np.eye(3) if attitude is None else attitude
    m = Mechanism(gravity=tuple(R @ (0.0, 0.0, -9.81 * size)), **given)
    base = m.body("base", m.ground, Weld(rotation=R))
    crank = m.body(
        "crank", base, Revolute(axis="y", start=-1.0, fixed=True), **rod(mass=MASSES[0], length=CRANK * size)
    )
    hinge = Revolute(axis="z", at=(CRANK * size, 0, 0), rotation=turn(0.5 * np.pi + tilt, "x"), start=-0.6)
    coupler = m.body("coupler", crank, hinge, **rod(mass=MASSES[1], length=COUPLER * size))
    pivot = Revolute(axis="y", at=(BASE * size, 0, 0), start=-1.7)
    rocker = m.body("rocker", base, pivot, **rod(mass=MASSES[2], length=ROCKER * size))
    m.cut("pin", cut_of(kind, size), coupler, rocker)
    m.output("angle", crank.angle())
    return m


def centers(angle: float) -> Any:
    """x and z of the rods' centers, and their angles, of the exact four-bar, by intersecting circles."""
    A, B = CRANK * np.array((np.cos(angle), -np.sin(angle))), np.array((BASE, 0.0))
    d = np.linalg.norm(B - A)
    along = (COUPLER**2 - ROCKER**2 + d**2) / (2.0 * d)
    e = (B - A) / d
    C = A + along * e + np.sqrt(COUPLER**2 - along**2) * np.array((-e[1], e[0]))
    turned = np.arctan2(-A[1], A[0]), np.arctan2(A[1] - C[1], C[0] - A[0]), np.arctan2(B[1] - C[1], C[0] - B[0])
    return np.array((0.5 * A, 0.5 * (A + C), 0.5 * (B + C))), np.array(turned)


def angle_of_crank(end: float) -> float:
    """By Lagrange's equation of the one angle, its inertia and weight by differences, in SciPy."""
    lengths, masses, h = np.array((CRANK, COUPLER, ROCKER)), np.array(MASSES), 1e-4

    def inertia(angle: float) -> float:
        (ahead, turned), (behind, before) = centers(angle + h), centers(angle - h)
        speed = np.linalg.norm(ahead - behind, axis=1) / (2.0 * h)
        spin = np.remainder(turned - before + np.pi, 2.0 * np.pi) - np.pi
        return float(masses @ (speed**2 + lengths**2 / 12.0 * (spin / (2.0 * h)) ** 2))

    def weight(angle: float) -> float:
        return float(9.81 * masses @ centers(angle)[0][:, 1])

    def slope(t: float, x: Any) -> Any:
        q, v = x
        bend = (inertia(q + h) - inertia(q - h)) / (2.0 * h)
        force = (weight(q + h) - weight(q - h)) / (2.0 * h)
        return v, -(0.5 * bend * v * v + force) / inertia(q)

    return float(solve_ivp(slope, (0.0, end), (-1.0, 0.0), rtol=1e-9, atol=1e-10).y[0, -1])


MOVED = angle_of_crank(0.5)


@pytest.mark.parametrize("kind", ["ball", "sleeve", "hinge"])
@pytest.mark.parametrize("tilt", [1e-9, ROUNDED, -1e-5])
def test_a_loop_with_a_rounded_right_angle_moves_as_the_exact_one(kind: str, tilt: float) -> None:
    run = mb.simulate(four_bar(tilt, kind), 0.5, interval=0.1, solver="adams", tolerance=1e-8)
    assert not run.failure
    assert run["angle"][-1] == pytest.approx(MOVED, abs=2e-5)
    told = [text for text in map(str, run.diagnostics) if "is left out" in text]
    assert told or tilt == 1e-9  # closed to rounding
    assert all("within the assembly tolerance" in text and "rad from parallel" in text for text in told)


@pytest.mark.parametrize("size", [1e-3, 1e3])
@pytest.mark.parametrize("attitude", [np.eye(3), ASKEW])
def test_it_does_so_at_every_size_and_attitude(size: float, attitude: Any) -> None:
    for kind in ("ball", "hinge"):
        mechanism = four_bar(ROUNDED, kind, size, attitude)
        run = mb.simulate(mechanism, 0.5, interval=0.1, solver="adams", tolerance=1e-8)
        assert run["angle"][-1] == pytest.approx(MOVED, abs=2e-5)


def test_an_exact_loop_is_not_reported() -> None:
    run = mb.simulate(four_bar(0.0, "ball"), 0.1, solver="adams")
    assert not any("is left out" in text or "cannot move" in text for text in map(str, run.diagnostics))
    assert CompiledMechanism(four_bar(0.0, "ball")).rounded_rows == {}


@pytest.mark.parametrize(
    ("tilt", "given", "angle"),
    [(1e-3, {}, "0.001"), (1e-4, {}, "0.0001"), (ROUNDED, {"assembly_tolerance": 0.0}, "3.67e-06")],
)
@pytest.mark.parametrize("kind", ["ball", "sleeve", "hinge"])
def test_what_is_further_off_is_refused_by_the_axes(tilt: float, given: Any, angle: str, kind: str) -> None:
    with pytest.raises(
        mb.UserError, match=rf"'coupler' and .*'(crank|pin|rocker)'.* are {angle} rad from parallel"
    ) as said:
        CompiledMechanism(four_bar(tilt, kind, **given)).assemble()
    assert "drive" not in str(said.value)
    run = mb.simulate(four_bar(tilt, kind, assembly_tolerance=5e-3), 0.1, solver="adams")
    assert not run.failure


@pytest.mark.parametrize("value", [-1e-6, 0.1, float("nan"), "fine"])
def test_the_tolerance_is_checked(value: Any) -> None:
    with pytest.raises(mb.UserError, match="assembly_tolerance"):
        Mechanism(assembly_tolerance=value)


def door(tilt: float, size: float = 1.0, offset: float = 0.0, **given: Any) -> Mechanism:
    """A door on two hinges, the axis of the upper one off by ``tilt``."""
    m = Mechanism(gravity=(0, 0, -9.81 * size), **given)
    joint = Revolute(axis="z", start=0.3, rate=0.5)
    leaf = m.body("door", m.ground, joint, mass=10, com=(0.4 * size, 0, size), inertia=np.array((1, 1, 1)) * size**2)
    top = (offset, 0, 2 * size)
    m.cut(
        "upper", RevoluteCutJoint(axis="z", at_a=(0, 0, 2 * size), at_b=top, rotation_b=turn(tilt, "y")), leaf, m.ground
    )
    m.output("angle", leaf.angle())
    return m


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("tilt", [1e-8, 1e-5])
def test_a_door_on_hinges_that_are_not_in_line_turns(size: float, tilt: float) -> None:
    run = mb.simulate(door(tilt, size, 2.0 * tilt * size), 1.0, interval=0.1, solver="adams")
    np.testing.assert_allclose(run["angle"], 0.3 + 0.5 * run.t, rtol=1e-9)
    assert any("'upper.zx' is left out" in text for text in map(str, run.diagnostics))


@pytest.mark.parametrize(("tilt", "offset"), [(1e-3, 0.0), (0.0, 1e-3), (1e-7, 1e-3)])
def test_a_door_whose_hinges_do_not_meet_is_refused(tilt: float, offset: float) -> None:
    with pytest.raises(mb.UserError, match=r"'upper\.(x|y|zx|zy)' is violated by (0\.001|0\.00095)"):
        CompiledMechanism(door(tilt, offset=offset)).assemble()


def skewed(tilt: float, count: int = 1) -> Mechanism:
    """Parallelograms in the plane of x and z, closed at their start; the axes of their rockers are off by ``tilt``."""
    m = Mechanism(gravity=(3.0, 0, -9.81))
    for k in (str(i) if i else "" for i in range(count)):
        crank = m.body(f"crank{k}", m.ground, Revolute(axis="y"), mass=1, com=(0, 0, 0.5), inertia=(0.1, 0.1, 0.1))
        coupler = m.body(f"coupler{k}", crank, Revolute(axis="y", at=(0, 0, 1)), **rod(mass=1, length=2))
        axis = np.array((tilt / 3.0, 1.0, tilt))
        pivot = Revolute(axis=tuple(axis / np.linalg.norm(axis)), at=(2, 0, 0))
        rocker = m.body(f"rocker{k}", m.ground, pivot, mass=1, com=(0, 0, 0.5), inertia=(0.1, 0.1, 0.1))
        m.cut(f"pin{k}", SphericalCutJoint(at_a=(2, 0, 0), at_b=(0, 0, 1)), coupler, rocker)
        m.output(f"angle{k}", crank.angle())
    return m


def swing(end: float) -> float:
    """Angle of the exact parallelogram: cranks of the same inertia, and a coupler that keeps its direction."""
    inertia = 2.0 * (0.1 + 0.25) + 1.0

    def slope(t: float, x: Any) -> Any:
        lever, height = np.cos(x[0]), np.sin(x[0])
        return x[1], (3.0 * lever + 9.81 * height) * (0.5 + 0.5 + 1.0) / inertia

    return float(solve_ivp(slope, (0.0, end), (0.0, 0.0), rtol=1e-10, atol=1e-12).y[0, -1])


@pytest.mark.parametrize("tilt", [0.0, 1e-12, 1e-8, 1e-6, 1e-5])
def test_a_ball_that_closes_a_planar_loop_does_not_lock_it(tilt: float) -> None:
    run = mb.simulate(skewed(tilt), 0.5, interval=0.1, solver="adams", tolerance=1e-8)
    assert run["angle"][-1] == pytest.approx(swing(0.5), abs=1e-5)
    assert not any("cannot move" in text for text in map(str, run.diagnostics))


@pytest.mark.parametrize("tilt", [2e-4, 1e-3])
def test_where_it_does_the_axes_are_named(tilt: float) -> None:
    run = mb.simulate(skewed(tilt), 0.1, solver="adams")
    (told,) = [text for text in map(str, run.diagnostics) if "cannot move" in text]
    assert "3 constraint equations leave no degree of freedom of its 3 joint coordinates" in told
    assert "joint 'rocker'" in told
    assert f"are {tilt * np.sqrt(10.0) / 3.0:.3g} rad from parallel" in told
    assert told in map(str, mb.check(skewed(tilt), 0.1, solver="adams").diagnostics)


@pytest.mark.parametrize("solver", ["ida", "esdirk", "adams"])
def test_large_systems_that_are_locked_name_the_axes_too(solver: str) -> None:
    """35 loops have 105 coordinates, which are solved by recursions."""
    assert not CompiledMechanism(skewed(1e-3, 35)).system.has_matrices
    run = mb.simulate(skewed(1e-3, 35), 0.1, solver=solver)
    (told,) = [text for text in map(str, run.diagnostics) if "cannot move" in text]
    assert "105 constraint equations leave no degree of freedom of its 105 joint coordinates" in told
    assert "joint 'rocker'" in told
    assert "rad from parallel" in told
    free = mb.simulate(skewed(0.0, 35), 0.5, interval=0.5, solver=solver, tolerance=1e-5)
    assert not any("cannot move" in text for text in map(str, free.diagnostics))
    assert free["angle34"][-1] == pytest.approx(swing(0.5), abs=1e-3)


def test_a_truss_is_reported_as_immobile_and_a_driven_loop_is_not() -> None:
    def triangle(**crank: Any) -> Mechanism:
        m = Mechanism()
        a = m.body("a", m.ground, Revolute(**crank), **rod(mass=1, length=1))
        b = m.body("b", a, Revolute(at=(1, 0, 0), start=-2.0), **rod(mass=1, length=1))
        if crank.get("drive") is not None:
            slide = m.body("slide", m.ground, Translational(start=1.0, axis="x"), mass=1)
            m.cut("pin", RevoluteCutJoint(at_a=(1, 0, 0)), b, slide)
        else:
            m.cut("pin", RevoluteCutJoint(at_a=(1, 0, 0), at_b=(1, 0, 0)), b, m.ground)
        m.output("angle", b.angle())
        return m

    said = [
        [text for text in map(str, mb.simulate(m, 0.1, solver="adams").diagnostics) if "cannot move" in text]
        for m in (triangle(start=1.0), triangle(drive="1 + 0.1 * sin(t)"))
    ]
    assert [len(texts) for texts in said] == [1, 0]
    assert "parallel" not in said[0][0]


@pytest.mark.parametrize("small", [1e-3, 1e-6])
def test_small_loops_of_large_mechanisms_are_kept(small: float) -> None:
    """A four-bar of a millionth of the arm that carries it: no row of it is a rounding."""
    m = Mechanism(gravity=(0, -9.81, 0))
    arm = m.body("arm", m.ground, Revolute(start=0.2), **rod(mass=1, length=1))
    crank = m.body("crank", arm, Revolute(at=(1, 0, 0), start=0.3), **rod(mass=1e-3, length=small))
    coupler = m.body("coupler", crank, Revolute(at=(small, 0, 0), start=-0.3), **rod(mass=1e-3, length=3 * small))
    rocker = m.body("rocker", coupler, Revolute(at=(3 * small, 0, 0), start=0.3), **rod(mass=1e-3, length=-small))
    m.cut("pivot", RevoluteCutJoint(at_a=(-small, 0, 0), at_b=(1 + 3 * small, 0, 0)), rocker, arm)
    compiled = CompiledMechanism(m)
    assert compiled.rounded_rows == {}
    assert compiled.system.constraint_names == ("pivot.x", "pivot.y")

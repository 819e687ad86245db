"""Closing loops, refusing what cannot close or has no inertia, and the builder's messages."""

from __future__ import annotations

from math import pi, sqrt
from typing import Any

import numpy as np
import pytest

from mbfmu.mechanics import (
    CompiledMechanism,
    DistanceCutJoint,
    Floating,
    Harmonic,
    Input,
    JointForce,
    Mechanism,
    PointForce,
    Polynomial,
    Revolute,
    RevoluteCutJoint,
    Spherical,
    SphericalCutJoint,
    Spring,
    Torque,
    Translational,
    WeldCutJoint,
    rod,
)
from mbfmu.mechanics.arrays.rows import find_dependent_rows
from mbfmu.mechanics.joints import Joint
from mbfmu.util.errors import AssemblyError, UserError


def four_bar(*, ground: float = 3.0, angle: float = 0.3, guess: float = 0.0) -> Mechanism:
    m = Mechanism(gravity=(0, -9.81, 0))
    crank = m.body("crank", m.ground, Revolute(start=angle, fixed=True), **rod(mass=1, length=1))
    coupler = m.body("coupler", crank, Revolute(at=(1, 0, 0), start=-angle + guess), **rod(mass=3, length=3))
    rocker = m.body("rocker", coupler, Revolute(at=(3, 0, 0), start=angle), **rod(mass=1, length=-1))
    m.cut("pivot", RevoluteCutJoint(at_a=(-1, 0, 0), at_b=(ground, 0, 0)), rocker, m.ground)
    return m


def test_vanishing_rows_are_dropped_and_named() -> None:
    compiled = CompiledMechanism(four_bar())
    assert compiled.vanishing_rows == ["pivot.z", "pivot.zx", "pivot.zy"]
    assert compiled.system.constraint_names == ("pivot.x", "pivot.y")


def test_closes_from_a_bad_guess_and_holds_what_is_fixed() -> None:
    compiled = CompiledMechanism(four_bar(guess=0.2))
    q, v = compiled.assemble()
    assert q[0] == 0.3
    np.testing.assert_allclose(q, [0.3, -0.3, 0.3], atol=1e-10)
    assert max(compiled.residuals(0.0, q, v)) < 1e-11


def test_a_loop_that_cannot_close_is_reported_with_its_gap() -> None:
    with pytest.raises(AssemblyError, match=r"'pivot\.[xy]' is violated by"):
        CompiledMechanism(four_bar(ground=10.0)).assemble()


def test_out_of_plane_gap_cannot_close() -> None:
    m = Mechanism()
    a = m.body("a", m.ground, Revolute(), **rod(mass=1, length=1))
    b = m.body("b", a, Revolute(at=(1, 0, 0)), **rod(mass=1, length=1))
    m.cut("pin", RevoluteCutJoint(at_a=(1, 0, 0), at_b=(2, 0, 0.5)), b, m.ground)
    with pytest.raises(AssemblyError, match=r"'pin\.z' is violated by 0\.5"):
        CompiledMechanism(m)


def test_parallelogram_with_three_cranks_reports_its_redundant_row() -> None:
    m = Mechanism()
    crank = m.body("crank", m.ground, Revolute(start=0.5, fixed=True), **rod(mass=1, length=1))
    coupler = m.body("coupler", crank, Revolute(at=(1, 0, 0), start=-0.5), **rod(mass=2, length=2))
    for i, x in enumerate((1.0, 2.0)):
        follower = m.body(f"f{i}", coupler, Revolute(at=(x, 0, 0), start=0.5), **rod(mass=1, length=-1))
        m.cut(f"pin{i}", RevoluteCutJoint(at_a=(-1, 0, 0), at_b=(x, 0, 0)), follower, m.ground)
    compiled = CompiledMechanism(m)
    q, _ = compiled.assemble()
    first, second, third = map(
        str, compiled.assembly.notes(0.0, q)
    )  # either loop may name the row that both have in common
    first, second, third = map(str, compiled.assembly.notes(0.0, q))
    assert first.startswith("loop 'pin0': 3 of its 5 constraints are trivially satisfied (z, zx, zy)")
    assert second.startswith("loop 'pin1': 3 of its 5 constraints are trivially satisfied (z, zx, zy)")
    assert ": 1 of its 5 constraints is redundant (" in third
    assert third.endswith(" [redundant-constraints]")
    q[:] = 0.0
    assert str(compiled.assembly.notes(0.0, q)[3]) == (
        "the start is a singular configuration: 1 more constraint equation depends on the others there [singular-start]"
    )


def test_zero_mass_is_refused_where_inertia_is_needed_and_welcome_where_not() -> None:
    m = Mechanism()
    a = m.body("a", m.ground, Revolute(), **rod(mass=1, length=1))
    m.body("b", a, Revolute(at=(1, 0, 0)))
    with pytest.raises(AssemblyError, match=r"no inertia: coordinate.* 'b'"):
        CompiledMechanism(m).assemble()
    m = Mechanism()
    a = m.body("a", m.ground, Revolute())
    m.body("b", a, Revolute(at=(1, 0, 0)), **rod(mass=1, length=1))
    CompiledMechanism(m).assemble()


def test_driven_joint_moves_as_prescribed_and_its_effort_is_an_output() -> None:
    """A point mass on a driven slide: effort = m (a + g)."""
    m = Mechanism(gravity=(0, -9.81, 0))
    slide = m.body("slide", m.ground, Translational(axis="y", drive=Harmonic(amplitude=0.2, frequency=1.5)), mass=2.0)
    m.output("y", slide.position("y"))
    m.output("effort", slide.effort())
    compiled = CompiledMechanism(m)
    out, none = np.zeros(2), np.zeros(0)
    t, w = 0.123, 2 * pi * 1.5
    compiled.observe(t, none, none, none, none, out)
    y = 0.2 * np.sin(w * t)
    np.testing.assert_allclose(out, [y, 2.0 * (9.81 - w * w * y)], rtol=1e-13)


def test_reactions_of_a_hanging_chain_carry_the_weight_below() -> None:
    m = Mechanism(gravity=(0, -10, 0))
    a = m.body("a", m.ground, Revolute(start=-pi / 2), **rod(mass=1, length=1))
    b = m.body("b", a, Revolute(at=(1, 0, 0)), **rod(mass=3, length=1))
    m.output("top", a.joint_force("y"))
    m.output("middle", b.joint_force("y"))
    compiled = CompiledMechanism(m)
    q, v = compiled.assemble()
    out = np.zeros(2)
    compiled.observe(0.0, q, v, np.zeros(2), np.zeros(0), out)
    np.testing.assert_allclose(out, [40.0, 30.0], rtol=1e-13)


def test_inputs_are_written_and_must_be_finite() -> None:
    m = Mechanism()
    a = m.body("a", m.ground, Revolute(), **rod(mass=3, length=1))
    m.force("motor", JointForce(magnitude=Input(name="a.torque", unit="N.m")), a)
    compiled = CompiledMechanism(m)
    terms = compiled.system.allocate_terms()
    q, v = compiled.assemble()
    compiled.inputs.start(0, 5.0)
    compiled.system.fill(0.0, q, v, terms)
    np.testing.assert_allclose(terms.h, [-5.0])
    with pytest.raises(UserError, match=r"'a\.torque' is nan"):
        compiled.inputs.start(0, float("nan"))


def falling(x: float, gravity: Any) -> Any:
    """A point mass of 2 kg at (0, 3, 0); gravity is x along x, and an input along y."""
    m = Mechanism(gravity=(x, gravity, 0.0))
    m.body("a", m.ground, Floating(start=(0, 3, 0, 1, 0, 0, 0)), mass=2, inertia=(1, 1, 1))
    return CompiledMechanism(m)


def test_gravity_by_an_input_loads_and_stores_energy() -> None:
    compiled = falling(0.5, Input(name="g", unit="m/s2", start=-10.0))
    terms, (q, v) = compiled.system.allocate_terms(), compiled.assemble()
    for g in (-10.0, 4.0):
        compiled.inputs.start(0, g)
        compiled.system.fill(0.0, q, v, terms)
        np.testing.assert_allclose(terms.h[:3], [-1.0, -2.0 * g, 0.0], atol=1e-15)
        assert compiled.energy(0.0, q, v) == pytest.approx(-6.0 * g)
    saved = compiled.inputs.state()
    compiled.inputs.start(0, 1.0)
    compiled.inputs.restore(saved)
    assert compiled.data.arrays.world["gravity"][0] == pytest.approx([0.5, 4.0, 0.0])
    compiled.adopt(falling(0.7, Input(name="g", unit="m/s2")))  # other numbers; what the input holds stays
    assert compiled.data.arrays.world["gravity"][0] == pytest.approx([0.7, 4.0, 0.0])


def test_an_input_of_gravity_with_a_rate_is_refused() -> None:
    with pytest.raises(UserError, match=r"gravity is Input\(.*rate_name='dg'"):
        falling(0.0, Input(name="g", unit="m/s2", rate_name="dg"))


def test_adopt_takes_numbers_and_refuses_another_structure() -> None:
    def spring(k: float) -> Any:
        m = Mechanism()
        a = m.body("a", m.ground, Floating(), mass=1, inertia=(1, 1, 1))
        m.force("spring", Spring(stiffness=k, free=1.0), m.ground, a)
        m.output("x", a.position("x", (k, 0, 0)))
        return CompiledMechanism(m)

    compiled = spring(1.0)
    q = np.array([3.0, 0, 0, 1, 0, 0, 0])
    assert compiled.energy(0.0, q, np.zeros(6)) == pytest.approx(2.0)
    compiled.adopt(spring(2.0))
    assert compiled.energy(0.0, q, np.zeros(6)) == pytest.approx(4.0)
    out = np.zeros(1)
    compiled.observe(0.0, q, np.zeros(6), np.zeros(6), np.zeros(0), out)
    assert out[0] == pytest.approx(5.0)  # the point that is observed moves along
    with pytest.raises(UserError, match="structure"):
        compiled.adopt(CompiledMechanism(four_bar()))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mass": -1.0}, r"mass of body 'b' is -1\.0"),
        ({"mass": float("nan")}, "mass of body 'b' is nan"),
        ({"inertia": (1, 1, 3)}, "inertia of body 'b'"),
        ({"com": (0, 0)}, "com of body 'b'"),
        ({"mass": "heavy"}, "mass of body 'b' is 'heavy'"),
        ({"com": "far"}, "com of body 'b' is 'far'; it needs numbers"),
        ({"inertia": "some"}, "inertia of body 'b' is 'some'; it needs numbers"),
    ],
)
def test_builder_names_what_is_wrong(options: dict[str, Any], message: str) -> None:
    m = Mechanism()
    with pytest.raises(UserError, match=message):
        m.body("b", m.ground, Revolute(), **options)


def test_builder_refuses_strangers_twins_and_loops_on_themselves() -> None:
    m, other = Mechanism(), Mechanism()
    a = m.body("a", m.ground, Spherical(), mass=1, inertia=(1, 1, 1))
    with pytest.raises(UserError, match="that is no other body's name"):
        m.body("a", m.ground, Revolute())
    with pytest.raises(UserError, match="not a body of this mechanism"):
        m.body("b", other.ground, Revolute())
    with pytest.raises(UserError, match="to itself"):
        m.cut("c", SphericalCutJoint(), a, a)
    with pytest.raises(UserError, match=r"length of cut 'd' is 0\.0 m"):
        m.cut("d", DistanceCutJoint(length=0.0), a, m.ground)
    with pytest.raises(UserError, match="length of cut 'd' is '1' m"):
        m.cut("d", DistanceCutJoint(length="1"), a, m.ground)  # type: ignore[arg-type]
    with pytest.raises(UserError, match="has 3 coordinates and cannot be driven"):
        m.body("s", m.ground, Spherical(drive=1.0))
    with pytest.raises(UserError, match="one coordinate"):
        m.force("f", JointForce(magnitude=1.0), a)
    with pytest.raises(UserError, match=r"has no component 'q'"):
        m.cut("w", WeldCutJoint(), a, m.ground).force("q")
    with pytest.raises(UserError, match="axis of joint of body 'r' is 'w'"):
        m.body("r", m.ground, Revolute(axis="w"))


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_an_open_angle_counts_as_the_path_of_a_point_one_length_away(size: float) -> None:
    m = Mechanism()
    arm = m.body("arm", m.ground, Revolute(), **rod(mass=1.0, length=2.0 * size))
    m.cut("glue", WeldCutJoint(), arm, m.ground)
    compiled = CompiledMechanism(m)
    assert compiled.length == pytest.approx(size)  # from the joint to the center of mass
    gap, rate = compiled.residuals(0.0, np.array([0.1]), np.array([0.3]))
    assert gap == pytest.approx(size * np.sin(0.1))
    assert rate == pytest.approx(size * 0.3 * np.cos(0.1))


@pytest.mark.parametrize("force", [Spring(stiffness=1.0), PointForce(magnitude=1.0), Torque(magnitude=1.0)])
def test_a_force_needs_two_bodies(force: Any) -> None:
    m = Mechanism()
    a = m.body("a", m.ground, Revolute(), mass=1.0)
    with pytest.raises(UserError, match="force 'f' acts between body 'a' and itself; it needs two bodies"):
        m.force("f", force, a, a)


@pytest.mark.parametrize(
    ("joint", "message"),
    [
        (Spherical(start=(2.0, 0.0, 0.0, 0.0)), r"quaternion \[2.0, 0.0, 0.0, 0.0\] of length 2; its length must be 1"),
        (Floating(start=(1.0, 0, 0, 0, 0, 0, 0)), "of length 0; its length must be 1"),
        (Revolute(start="up"), "start of body 'b' is 'up'; it needs numbers"),
        (Revolute(drive=Polynomial(0.0)), "polynomial coefficients are 0.0; allowed: one to four finite numbers"),  # type: ignore[arg-type]
        (Revolute(drive=Polynomial(("a",))), "polynomial coefficients are"),  # type: ignore[arg-type]
        (Revolute(drive=Harmonic(amplitude=1.0, frequency="a")), "frequency of a Harmonic is 'a'; it must be a finite"),  # type: ignore[arg-type]
        (Revolute(drive="fast"), "drive of body 'b' is 'fast', where 'fast' is not known; allowed: t, sin"),
    ],
)
def test_joints_name_what_is_wrong(joint: Joint, message: str) -> None:
    m = Mechanism()
    m.body("b", m.ground, joint, mass=1.0, inertia=(1.0, 1.0, 1.0))
    with pytest.raises(UserError, match=message):
        CompiledMechanism(m).assemble()


def test_distance_multiplier_is_the_rod_force() -> None:
    """A mass on a rod under gravity, hanging still: the rod pulls with the weight."""
    m = Mechanism(gravity=(0, -10, 0))
    bob = m.body("bob", m.ground, Floating(start=(0, -2, 0, 1, 0, 0, 0)), mass=3, inertia=(1, 1, 1))
    rod_ = m.cut("rod", DistanceCutJoint(length=2.0), m.ground, bob)
    m.output("pull", rod_.force())
    compiled = CompiledMechanism(m)
    q, v = compiled.assemble()
    terms = compiled.system.allocate_terms()
    compiled.system.fill(0.0, q, v, terms)
    lam = np.linalg.lstsq(terms.J.T, -terms.h, rcond=None)[0]
    out = np.zeros(1)
    compiled.observe(0.0, q, v, np.zeros(6), lam, out)
    assert out[0] == pytest.approx(-30.0)  # on bob, along the line from the ground to bob: inward
    assert sqrt(q[:3] @ q[:3]) == 2.0


@pytest.mark.parametrize("speed", [2.0, 0.01])
def test_rounding_in_what_a_drive_moves_opens_no_redundant_loop(speed: float) -> None:
    """A table on four cranks on a post that turns, at an angle whose sine is no round number."""
    m = Mechanism()
    post = m.body("post", m.ground, Revolute(axis="y", drive=Polynomial((0.1, speed))), mass=1.0)
    feet, lean = [(0, 0, 0), (2, 0, 0), (0, 0, 1), (2, 0, 1)], 1.2217304763960306
    cranks = [
        m.body(f"crank{k}", post, Revolute(at=p, start=lean, fixed=k == 0), **rod(mass=2, length=0.8))
        for k, p in enumerate(feet)
    ]
    slab = {"mass": 5, "com": (1, 0, 0.5), "inertia": (1, 2, 1)}
    table = m.body("table", cranks[0], Revolute(at=(0.8, 0, 0), start=-lean), **slab)
    for k in (1, 2, 3):
        m.cut(f"pin{k}", RevoluteCutJoint(at_a=(0.8, 0, 0), at_b=feet[k]), cranks[k], table)
    _, v = CompiledMechanism(m).assemble()
    np.testing.assert_allclose(v, 0.0, atol=1e-12)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_dependent_rows_are_as_many_as_the_rank_requires(scale: float) -> None:
    """The other rows are independent, by the singular values; more rows than columns, and rows near to dependent."""
    random = np.random.default_rng(7)
    for m, n, rank in ((1, 1, 1), (3, 5, 3), (4, 5, 2), (6, 4, 4), (5, 3, 1), (20, 30, 20), (20, 30, 17)):
        J = scale * random.normal(size=(m, rank)) @ random.normal(size=(rank, n))
        dependent = find_dependent_rows(J)
        kept = np.delete(J, dependent, axis=0)
        assert len(kept) == rank
        assert np.linalg.matrix_rank(kept, tol=1e-9 * scale) == rank
    for ratio, expected in ((1e-2, []), (1e-6, [1])):
        assert find_dependent_rows(scale * np.array([[1.0, 0.0, 0.0], [0.5, ratio, 0.0]])).tolist() == expected

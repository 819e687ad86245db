"""The characteristic length and the units of coordinates and constraints."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mbfmu import equilibrium, simulate
from mbfmu.mechanics import (
    Beam,
    CompiledMechanism,
    DistanceCutJoint,
    Floating,
    Harmonic,
    JointSpring,
    Mechanism,
    PointForce,
    Revolute,
    RevoluteCutJoint,
    Spring,
    Translational,
    rod,
)
from mbfmu.util.errors import UserError


def slider_crank(scale: float, origin: float) -> Any:
    """A crank of 0.1 m, a rod of 0.4 m, a slider; ``scale`` times as large, drawn ``origin`` m away."""
    m, at = Mechanism(), (origin, 0.0, 0.0)
    crank = m.body("crank", m.ground, Revolute(at=at, start=0.5), **rod(mass=1.0, length=0.1 * scale))
    link = m.body("link", crank, Revolute(at=(0.1 * scale, 0, 0)), **rod(mass=1.0, length=0.4 * scale))
    slider = m.body("slider", m.ground, Translational(axis="x", at=at, start=0.4 * scale), mass=1.0)
    m.cut("pin", RevoluteCutJoint(at_a=(0.4 * scale, 0, 0)), link, slider)
    return CompiledMechanism(m)


@pytest.mark.parametrize(("scale", "origin"), [(1.0, 0.0), (1e-3, 0.0), (1e3, 5.0), (1.0, -1e4)])
def test_length_is_of_the_parts_and_not_of_where_they_are(scale: float, origin: float) -> None:
    compiled = slider_crank(scale, origin)
    assert compiled.length == pytest.approx(0.4 * scale)
    np.testing.assert_allclose(compiled.system.size, [1.0, 1.0, 0.4 * scale])
    np.testing.assert_allclose(compiled.system.row_size, [0.4 * scale, 0.4 * scale])  # x, y; z, zx, zy are zero


@pytest.mark.parametrize("length", [1e-3, 1.0, 1e3])
def test_an_elastic_body_without_sections_counts_with_its_length(length: float) -> None:
    m = Mechanism()
    own = Beam(length=length, mass=1.0, bending_stiffness=5.0 * length**3, modes=2, ends=("clamped", "free"))
    m.flexible_body("beam", m.ground, Translational(axis="y"), own)
    compiled = CompiledMechanism(m)
    assert compiled.length == length
    assert compiled.system.size == pytest.approx(np.full(3, length))


def test_rows_of_turns_are_measured_in_radians() -> None:
    m = Mechanism()
    bar = m.body("bar", m.ground, Floating(), **rod(mass=1.0, length=2.0))
    m.cut("hinge", RevoluteCutJoint(), m.ground, bar)
    m.cut("tie", DistanceCutJoint(length=5.0), m.ground, bar)
    system = CompiledMechanism(m).system
    np.testing.assert_array_equal(system.row_size, [5.0, 5.0, 5.0, 1.0, 1.0, 5.0])
    np.testing.assert_array_equal(system.size, [5.0, 5.0, 5.0, 1.0, 1.0, 1.0])


def test_without_arms_springs_and_gyration_measure_and_last_a_meter() -> None:
    def ball(**options: Any) -> Any:
        m = Mechanism()
        m.body("ball", m.ground, Floating(), mass=2.0, **options)
        return m

    assert CompiledMechanism(ball()).length == 1.0
    assert CompiledMechanism(ball(inertia=(0.02, 0.02, 0.02))).length == pytest.approx(np.sqrt(0.015))
    for pushed in (False, True):
        m = ball(inertia=(0.02, 0.02, 0.02))
        m.force("spring", Spring(stiffness=1.0, free=0.3), m.ground, m.bodies[1])
        if pushed:
            m.force("push", PointForce(magnitude=1.0, axis="x", at_a=(0, 0, 0.07)), m.bodies[1])
        assert CompiledMechanism(m).length == pytest.approx(0.07 if pushed else 0.3)


def test_the_size_of_a_joint_may_be_given() -> None:
    def floating(size: Any) -> Any:
        m = Mechanism()
        m.body("b", m.ground, Floating(nominal=size), **rod(mass=1.0, length=1.0))
        return CompiledMechanism(m).system.size

    np.testing.assert_array_equal(floating(0.25), np.full(6, 0.25))
    np.testing.assert_array_equal(floating((3, 3, 3, 1, 1, 2)), [3, 3, 3, 1, 1, 2])
    for wrong in (0.0, -1.0, float("nan"), (1.0, 2.0)):
        with pytest.raises(UserError, match=r"nominal of body 'b' is .*; allowed: one number greater than zero, or 6"):
            floating(wrong)


def masses(joint: Any, **options: Any) -> Mechanism:
    """Two masses on the ground, each with a spring."""
    m = Mechanism()
    for name in ("first", "second"):
        body = m.body(name, m.ground, joint(**options), mass=1.0)
        m.force(f"{name}.spring", JointSpring(stiffness=100.0), body)
        m.output(f"{name}.q", body.coordinate())
    return m


def test_a_length_that_is_assumed_for_displacements_is_reported() -> None:
    found = simulate(masses(Translational, start=1e-3), 0.1).diagnostics
    (note,) = [d for d in found if d.code == "assumed-length"]
    assert note.severity == "note"
    assert "A length of 1 m is assumed for the tolerances of the displacements of body 'first' and 1 more" in note.text
    assert "`nominal`" in note.remedy
    (note,) = [d for d in equilibrium(masses(Translational)).diagnostics if d.code == "assumed-length"]
    assert note.subject == "first"


@pytest.mark.parametrize(
    "mechanism",
    [
        masses(Revolute),
        masses(Translational, nominal=1e-3),
        slider_crank(1.0, 0.0).mechanism,
        masses(Translational, drive=Harmonic(amplitude=0.1, frequency=1.0)),
    ],
    ids=["rotations", "nominal", "points", "drives"],
)
def test_no_length_is_reported_where_none_is_assumed_for_free_displacements(mechanism: Mechanism) -> None:
    assert CompiledMechanism(mechanism).describe_assumed_length() == []

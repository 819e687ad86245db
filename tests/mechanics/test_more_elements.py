"""Universal cut joints and coupled bushings: identities, closed forms, and SciPy on other formulations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from random_mechanisms import random_rotation
from scipy.linalg import block_diag, eigh
from scipy.spatial.transform import Rotation

import mbfmu as mb
from mbfmu.mechanics import Bushing, CompiledMechanism, Floating, Mechanism, Revolute, UniversalCutJoint
from mbfmu.testing import check_element
from mbfmu.util.errors import UserError

SIZES = (1e-3, 1.0, 1e3)  # m


# -- universal cut joint -------------------------------------------------------------------------------------------


def test_a_universal_cut_joint_has_the_identities_of_cut_joints() -> None:
    report = check_element(UniversalCutJoint(axis=(1.0, 2.0, 0.5), second="z"))
    assert report.passed, report


@pytest.mark.parametrize("size", SIZES)
def test_two_shafts_turn_as_those_of_a_cardan_joint(size: float) -> None:
    """tan(second) = cos(beta) tan(first) with the angle beta between the shafts, and the energy is constant."""
    beta, inertia = 0.6, (0.7 * size**2, 0.3 * size**2)
    tilt = Rotation.from_euler("x", beta).as_matrix()
    m = Mechanism()
    first = m.body("first", m.ground, Revolute(start=0.2, rate=3.0, fixed=True), inertia=3 * (inertia[0],))
    second = m.body("second", m.ground, Revolute(rotation=tilt), inertia=3 * (inertia[1],))
    at = (0.0, 0.0, 0.0)
    joint = m.cut("cross", UniversalCutJoint(axis="x", second="y", at_a=at, at_b=at), first, second)
    m.output("first", first.angle())
    m.output("second", second.angle())
    m.output("rate", first.rate())
    m.output("moment", joint.force("xy"))
    m.output("acceleration", second.acceleration())
    result = mb.simulate(m, 2.0, solver="adams", tolerance=1e-9)
    assert not result.failure
    a, b = result["first"], result["second"]
    np.testing.assert_allclose(np.sin(b) * np.cos(a), np.cos(beta) * np.sin(a) * np.cos(b), atol=1e-7)
    slope = np.cos(beta) / (np.cos(a) ** 2 + np.cos(beta) ** 2 * np.sin(a) ** 2)  # of the second angle
    energy = 0.5 * (inertia[0] + inertia[1] * slope**2) * result["rate"] ** 2
    np.testing.assert_allclose(energy, energy[0], rtol=1e-6)
    # the cross transmits a moment along its normal, whose part along the second shaft turns that
    pin_a = np.column_stack((np.cos(a), np.sin(a), np.zeros_like(a)))
    pin_b = np.column_stack((-np.sin(b), np.cos(b), np.zeros_like(b))) @ tilt.T
    share = np.cross(pin_a, pin_b) @ tilt[:, 2]
    np.testing.assert_allclose(
        np.abs(result["moment"] * share), np.abs(inertia[1] * result["acceleration"]), atol=1e-7 * inertia[1]
    )


def test_a_universal_joint_of_a_graph_can_close_a_loop() -> None:
    beta = 0.6
    m = Mechanism()
    first, second = (m.body(name, inertia=(0.5, 0.5, 0.5)) for name in ("first", "second"))
    crank = m.joint("crank", m.ground, first, Revolute(start=0.2, rate=3.0, fixed=True))
    driven = m.joint("driven", m.ground, second, Revolute(rotation=Rotation.from_euler("x", beta).as_matrix()))
    m.joint("cross", first, second, mb.Universal(axis="x", second="y"))
    m.output("first", crank.angle())
    m.output("second", driven.angle())
    result = mb.simulate(m, 0.5, solver="adams", tolerance=1e-9)
    a, b = result["first"], result["second"]
    assert np.ptp(a) > 1.0
    np.testing.assert_allclose(np.sin(b) * np.cos(a), np.cos(beta) * np.sin(a) * np.cos(b), atol=1e-7)


def test_the_moment_of_a_universal_cut_joint_is_named_by_both_axes() -> None:
    assert UniversalCutJoint().rows == ("y", "z", "x", "xy")
    assert UniversalCutJoint(axis="z", second=(0.0, 1.0, 1.0)).rows == ("x", "y", "z", "zn")
    assert UniversalCutJoint(axis=(1.0, 0.0, 1.0)).rows == ("s", "t", "n", "ny")
    m = Mechanism()
    body = m.body("b", m.ground, Floating(), mass=1.0)
    with pytest.raises(UserError, match="second axis of cut 'c' is"):
        m.cut("c", UniversalCutJoint(second=(0.0, 0.0, 0.0)), m.ground, body)


# -- coupled bushing -----------------------------------------------------------------------------------------------


def positive_matrix(rng: np.random.Generator, size: float) -> Any:
    """A random stiffness for forces and moments of bodies of a size."""
    root, unit = rng.normal(size=(6, 6)), np.diag([1.0] * 3 + [size] * 3)
    return unit @ (root @ root.T + np.eye(6)) @ unit


def test_a_coupled_bushing_has_the_identities_of_forces() -> None:
    rng = np.random.default_rng(5)
    bushing = Bushing(
        stiffness=positive_matrix(rng, 1.0),
        damping=positive_matrix(rng, 1.0),
        preload=rng.normal(size=6),
        rotation_a=random_rotation(rng),
    )
    report = check_element(bushing)
    assert report.passed, report


@pytest.mark.parametrize("size", SIZES)
def test_a_body_on_a_coupled_bushing_has_the_frequencies_of_its_matrices(size: float) -> None:
    rng = np.random.default_rng(3)
    at, R, inertia = size * rng.normal(size=3), random_rotation(rng), np.array((1.0, 1.4, 2.1)) * size**2
    stiffness = 40.0 * positive_matrix(rng, size)
    m = Mechanism()
    start = np.r_[at, Rotation.from_matrix(R).as_quat(scalar_first=True)]
    body = m.body("block", m.ground, Floating(start=start), mass=2.0, inertia=inertia)
    m.force("bushing", Bushing(stiffness=stiffness, at_a=at, rotation_a=R), m.ground, body)
    expected = np.sqrt(eigh(stiffness, block_diag(2.0 * np.eye(3), np.diag(inertia)), eigvals_only=True))
    found = [shape.mode.frequency for shape in mb.modes(m)]
    np.testing.assert_allclose(np.sort(found), expected, rtol=1e-7)


@pytest.mark.parametrize("size", SIZES)
def test_a_preload_is_the_force_at_zero_displacement_and_moves_the_equilibrium(size: float) -> None:
    """K s = preload, with the displacement and twice the sine of half the rotation angle in s."""
    rng = np.random.default_rng(8)
    unit = np.r_[np.ones(3), size * np.ones(3)]
    stiffness, preload = 30.0 * positive_matrix(rng, size), size * unit * rng.normal(size=6)
    m = Mechanism()
    body = m.body("block", m.ground, Floating(), mass=2.0, inertia=np.array((1.0, 1.4, 2.1)) * size**2)
    handle = m.force("bushing", Bushing(stiffness=stiffness, damping=stiffness, preload=preload), m.ground, body)
    for axis in "xyz":
        m.output(f"force.{axis}", handle.force(axis, on="b"))
    for axis in "xyz":
        m.output(f"moment.{axis}", handle.moment(axis, on="b"))
    compiled, out = CompiledMechanism(m), np.zeros(6)
    compiled.observe(0.0, compiled.assembly.start_positions(), np.zeros(6), np.zeros(6), np.zeros(0), out)
    np.testing.assert_allclose(out, preload, rtol=1e-12)
    rest = np.asarray(mb.equilibrium(m).q)
    quaternion = rest[3:] * np.sign(rest[3])
    np.testing.assert_allclose(
        np.r_[rest[:3], 2.0 * quaternion[1:]] * unit / size,
        np.linalg.solve(stiffness, preload) * unit / size,
        atol=1e-7,
    )


def test_a_diagonal_matrix_is_the_bushing_of_its_diagonal() -> None:
    rng = np.random.default_rng(4)
    k, c, frames = rng.uniform(1.0, 2.0, 6), rng.uniform(1.0, 2.0, 6), {"rotation_a": random_rotation(rng)}
    loads = []
    for bushing in (
        Bushing(stiffness=np.diag(k), damping=np.diag(c), **frames),
        Bushing(stiffness=k[:3], rotational_stiffness=k[3:], damping=c[:3], rotational_damping=c[3:], **frames),
    ):
        m = Mechanism()
        body = m.body("block", m.ground, Floating(), mass=2.0, inertia=(1.0, 1.4, 2.1))
        m.force("bushing", bushing, m.ground, body)
        system = CompiledMechanism(m).system
        terms = system.allocate_terms()
        e = np.array((-0.2, 0.4, 0.5, 0.6))
        system.fill(0.0, np.r_[0.1, 0.2, -0.4, e / np.linalg.norm(e)], np.linspace(-1.0, 1.0, 6), terms)
        loads.append(terms.h.copy())
    np.testing.assert_allclose(*loads, rtol=1e-12)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"stiffness": np.eye(5)}, "stiffness of force 'bush' is"),
        ({"damping": np.diag([1.0] * 5 + [-1.0])}, "damping of force 'bush' is"),
        ({"stiffness": np.eye(6) + np.eye(6, k=1)}, "which is not symmetric"),
        ({"stiffness": np.ones((6, 6)) - 0.5 * np.eye(6)}, "which drives some displacements away from zero"),
        ({"stiffness": np.eye(6), "rotational_stiffness": 2.0}, "leave out rotational_stiffness"),
        ({"preload": (1.0, 2.0, 3.0)}, "preload of force 'bush' is .*six finite numbers"),
    ],
)
def test_what_is_no_coupled_bushing_is_refused(options: Any, message: str) -> None:
    m = Mechanism()
    body = m.body("b", m.ground, Floating(), mass=1.0)
    with pytest.raises(UserError, match=message):
        m.force("bush", Bushing(**options), m.ground, body)

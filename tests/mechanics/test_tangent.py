"""The structured tangent of random trees in groups against differences of the inverse dynamics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbfmu as mb
from fmus.sheet import Sheet
from mbfmu.mechanics import (
    Bushing,
    CompiledMechanism,
    Cylindrical,
    Floating,
    Harmonic,
    JointFriction,
    Mechanism,
    Revolute,
    Spherical,
    SphericalFriction,
    Translational,
    Weld,
)
from mbfmu.mechanics.joints import Joint
from mbfmu.mechanics.recursions import dynamics as dy
from mbfmu.mechanics.recursions.kinematics import update_accelerations
from mbfmu.mechanics.recursions.rnea import inverse_dynamics
from mbfmu.mechanics.tangent import Groups, find_groups, groups
from mbfmu.mechanics.tangent.layout import OUTER
from mbfmu.sheets import Geodesic, Stretching, Support, add_sheet
from solvers.system import TreeSystem

from .random_mechanisms import Case, build, cases


def inverse(compiled: CompiledMechanism, q: Any, a: Any) -> Any:
    """Joint forces (n,) at rest with accelerations a (n,); leaves the state there."""
    arrays, state = compiled.data
    free = [(b, k) for b in arrays.bodies if b["vf"] >= 0 for k in range(b["nv"])]
    dy.update_kinematics(0.0, q, np.zeros(compiled.system.n), *compiled.kernel_data)
    for b, k in free:
        state.a[b["vi"] + k] = a[b["vf"] + k]
    update_accelerations(arrays, state)
    inverse_dynamics(arrays, state)
    return np.array([state.tau[b["vi"] + k] for b, k in free])


def differences(compiled: CompiledMechanism, q: Any, c2: float, h: float = 1e-5) -> Any:
    """Derivative of the joint forces at rest by positions, and c2 times by accelerations; leaves the state at q."""
    n = compiled.system.n
    T = np.zeros((n, n))
    for k, e in enumerate(h * np.eye(n)):
        there, back = q.copy(), q.copy()
        compiled.system.apply(there, e)
        compiled.system.apply(back, -e)
        T[:, k] = (inverse(compiled, there, c2 * e) - inverse(compiled, back, -c2 * e)) / (2.0 * h)
    inverse(compiled, q, np.zeros(n))
    return T


def loaded(compiled: CompiledMechanism, q: Any, lam: Any) -> Any:
    """Joint forces (n,) at rest with multipliers lam (m,); leaves the state there."""
    n, tau = compiled.system.n, np.zeros(compiled.system.n)
    dy.inverse_dynamics_at_solution(0.0, q, np.zeros(n), np.zeros(n), lam, compiled.kernel_data)
    dy.gather_free(compiled.data.state.tau, compiled.data.arrays, tau)
    return tau


def groups_of(compiled: CompiledMechanism, how: int | None) -> Groups:
    """All bodies in one group, or groups of the program with blocks of at most ``how`` bodies."""
    if how is None:
        return Groups(np.zeros(len(compiled.mechanism.bodies), np.int64), np.array([-1]))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(groups, "MAX_BLOCK_BODIES", how)
        return find_groups(compiled.mechanism)


@pytest.mark.parametrize("how", [None, 1, 2])
@given(case=cases(forces=True), c2=st.floats(0.5, 50.0))
def test_solves_the_linearized_inverse_dynamics(case: Case, c2: float, how: int | None) -> None:
    compiled = case.compiled
    T, tangent = differences(compiled, case.q, c2), compiled.tangent(groups_of(compiled, how))
    if np.linalg.cond(T) > 1e6:
        return
    assert tangent.factor(0.0, c2)
    x = tangent.solve(case.a)
    np.testing.assert_allclose(T @ x, case.a, atol=1e-6 * (1.0 + np.abs(T).max() * np.abs(x).max()))
    moved, rest = inverse(compiled, case.q, case.a), inverse(compiled, case.q, 0.0 * case.a)
    np.testing.assert_allclose(tangent.inertia(case.a), moved - rest, atol=1e-12 * np.abs((moved, rest)).max())


@pytest.mark.parametrize("how", [None, 1, 2])
@given(kinds=st.permutations([Floating, Stretching, Geodesic, Revolute]), seed=st.integers(0, 2**32 - 1))
def test_joints_of_six_coordinates_with_others(kinds: list[type[Joint]], seed: int, how: int | None) -> None:
    """In a group or between two, above and below joints that lock directions, with forces."""
    case = build(seed, [Revolute, *kinds, Weld], [], driven=False, forces=True)
    compiled = case.compiled
    tangent = compiled.tangent(groups_of(compiled, how))
    for body in compiled.mechanism.bodies[2:]:
        if body.joint.nv == 6 and body.parent > 0:
            assert tangent.layout.role[body.index] == OUTER
    T = differences(compiled, case.q, 5.0)
    if np.linalg.cond(T) > 1e6:
        return
    assert tangent.factor(0.0, 5.0)
    x = tangent.solve(case.a)
    np.testing.assert_allclose(T @ x, case.a, atol=1e-6 * (1.0 + np.abs(T).max() * np.abs(x).max()))


@pytest.mark.parametrize("how", [None, 1, 2])
def test_a_sheet_that_stretches(how: int | None) -> None:
    """A thick one, so that differences resolve all of it; bent and strained."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    add_sheet(
        m, "sheet", length=0.3, width=0.2, thickness=0.03, youngs_modulus=1e6, density=1000.0, grid=(4, 3),
        supports=[Support("x1")], stretch=True,
    )  # fmt: skip
    compiled, rng = CompiledMechanism(m), np.random.default_rng(1)
    n, q = compiled.system.n, compiled.assembly.start_positions()
    compiled.system.apply(q, 0.02 * rng.normal(size=n))
    T = differences(compiled, q, 1e4)
    tangent, x = compiled.tangent(groups_of(compiled, how)), rng.normal(size=n)
    assert np.count_nonzero(tangent.layout.role == OUTER) >= 6
    assert tangent.factor(0.0, 1e4)
    np.testing.assert_allclose(tangent.solve(T @ x), x, rtol=0.0, atol=1e-5 * np.abs(x).max())


def test_a_carrier_without_mass_stays_with_what_it_carries() -> None:
    """The carrier is farther from the root than what it carries, and its block of one unknown would be empty."""
    m, mass = Mechanism(), {"mass": 1.0, "inertia": (1.0, 1.0, 1.0)}
    first = m.body("first", m.ground, Floating(), **mass)
    slide = m.body("slide", m.ground, Translational(axis="x"))
    tilt = m.body("tilt", slide, Revolute(axis="y"))
    last = m.body("last", tilt, Revolute(axis="z"), **mass)
    m.force("bushing", Bushing(stiffness=5.0, rotational_stiffness=3.0), first, last)
    compiled = CompiledMechanism(m)
    T = differences(compiled, compiled.assembly.start_positions(), 2.0)
    tangent, a = compiled.tangent(groups_of(compiled, 1)), np.random.default_rng(0).normal(size=9)
    assert tangent.factor(0.0, 2.0)
    np.testing.assert_allclose(T @ tangent.solve(a), a, atol=1e-6)


def moving_differences(compiled: CompiledMechanism, q: Any, v: Any, c1: float, c2: float, h: float = 1e-6) -> Any:
    """T of forces along all coordinates and states at (q, v), by central differences; leaves the state there."""
    n = compiled.system.n
    T, tau = np.zeros((n, n)), np.zeros((2, n))
    for k, e in enumerate(h * np.eye(n)):
        for side, step in zip(tau, (e, -e), strict=True):
            there = q.copy()
            compiled.system.apply(there, step)
            inverse_at(compiled, there, v + c1 * step, c2 * step, side)
        T[:, k] = (tau[0] - tau[1]) / (2.0 * h)
    inverse_at(compiled, q, v, np.zeros(n), tau[0])
    return T


def inverse_at(compiled: CompiledMechanism, q: Any, v: Any, a: Any, tau: Any) -> None:
    """tau (n,) <- forces along all coordinates and states at (q, v, a); leaves the state there."""
    dy.inverse_dynamics_at_solution(0.0, q, v, a, np.zeros(0), compiled.kernel_data)
    dy.gather_free(compiled.data.state.tau, compiled.data.arrays, tau)


def expect_exact(compiled: CompiledMechanism, v: Any, c1: float, c2: float) -> None:
    """The structured tangent at the start with velocities and states v (n,) is that of differences."""
    q, x = compiled.assembly.start_positions(), np.random.default_rng(3).normal(size=compiled.system.n)
    tangent = compiled.tangent(groups_of(compiled, 1))
    T = moving_differences(compiled, q, v, c1, c2)
    assert tangent.factor(c1, c2)
    np.testing.assert_allclose(tangent.solve(T @ x), x, rtol=0.0, atol=1e-6 * np.abs(x).max())


def test_bristles_of_joints_at_rest() -> None:
    """One and three first-order states, along a second coordinate, and of a joint that a drive moves."""
    m, body = Mechanism(), {"mass": 1.0, "inertia": (1.0, 2.0, 3.0), "com": (0.3, 0.1, 0.2)}
    friction = {"coulomb": 2.0, "viscous": 0.3, "deflection": 0.1}
    slide = m.body("slide", m.ground, Translational(axis="x"), **body)
    driven = m.body("driven", slide, Revolute(axis="y", drive=Harmonic(amplitude=0.0, frequency=1.0)), **body)
    guide = m.body("guide", driven, Cylindrical(axis="z"), **body)
    ball = m.body("ball", guide, Spherical(at=(0.5, 0.0, 0.0)), **body)
    for name, load, on in (
        ("slide", JointFriction(static=3.0, stribeck=2.0, **friction), slide),
        ("driven", JointFriction(**friction), driven),
        ("guide", JointFriction(coordinate=1, **friction), guide),
        ("ball", SphericalFriction(**friction), ball),
    ):
        m.force(name, load, on)
    compiled = CompiledMechanism(m)
    v = np.zeros(compiled.system.n)
    v[compiled.system.states] = 0.4, 0.1, -0.5, 0.2, 0.3, -0.4  # elastic: they are below the breakaway force
    expect_exact(compiled, v, 3.0, 20.0)


def test_bristles_of_joints_that_slide() -> None:
    """Sliders on sliders, which have no velocity products: the derivatives of what slides are exact, too."""
    m, parent = Mechanism(), None
    for k in range(4):
        parent = m.body(f"slider{k}", parent or m.ground, Translational(axis="x"), mass=1.0 + k)
        law = JointFriction(coulomb=2.0, static=3.0, stribeck=0.7, viscous=0.2, deflection=0.1)
        m.force(f"friction{k}", law, parent)
    compiled = CompiledMechanism(m)
    v = np.array([0.5, -0.3, 0.8, 0.2, 1.1, -1.2, 1.3, -0.9])  # the last bristle is deflected against the slip
    expect_exact(compiled, v, 3.0, 20.0)


def test_states_of_controllers_motors_wheels_and_laws() -> None:
    """They read coordinates, bodies and each other, act along coordinates and on bodies, and set a normal force."""
    m, body = Mechanism(gravity=(0.3, -9.81, 2.0)), {"mass": 1.0, "inertia": (1.0, 2.0, 3.0), "com": (0.3, 0.1, 0.2)}
    base = m.body("base", m.ground, Floating(at=(0.1, 0.5, 0.2)), **body)
    arm = m.body("arm", base, Revolute(at=(0.2, 0.1, 0.0), start=0.4), **body)
    ball = m.body("ball", arm, Spherical(at=(0.5, 0.0, 0.1)), **body)
    slide = m.body("slide", ball, Translational(axis="y", at=(0.1, 0.2, 0.3)), **body)
    control = m.pid(
        "control", m.lag("target", 0.7, time_constant=0.2), arm.angle(), proportional=30.0, integral=20.0,
        derivative=3.0, filter_time=0.1,
    )  # fmt: skip
    m.dc_motor("motor", arm, control, resistance=2.0, inductance=0.1, torque_constant=0.3, ratio=10.0)
    height = m.state("height", "3 * (y - z) + 0.2 * w * z", uses={"y": slide.position("y"), "w": ball.rate(1)})
    m.force("push", mb.JointForce("h * h - 4 * v", uses={"h": height}), slide)
    grip = m.state("grip", "2 - z + s", uses={"s": slide.rate()})
    friction = {"coulomb": 2.0, "deflection": 0.1}
    m.force("brake", JointFriction(normal_force="1 + g", uses={"g": grip}, **friction), slide)
    m.force("joint", SphericalFriction(**friction), ball)
    wheel = mb.SlippingWheel(
        radius=0.6, stiffness=300.0, damping=0.1, friction=0.7, deflection=0.2, axis="z", normal="y"
    )
    m.force("wheel", wheel, base)
    compiled = CompiledMechanism(m)
    v = np.zeros(compiled.system.n)
    v[compiled.system.states] = 0.3 * np.random.default_rng(5).normal(size=compiled.system.n_states)
    expect_exact(compiled, v, 3.0, 20.0)


@given(case=cases(forces=True))
def test_damping_of_forces(case: Case) -> None:
    """c1 times the derivative of the joint forces by the velocities, at rest; inertia for regularity."""
    compiled, n, c1, c2 = case.compiled, case.compiled.system.n, 3.0, 20.0
    still, D = np.zeros(n), np.zeros((2, n, n))
    for k, e in enumerate(np.eye(n)):
        for side, v in zip(D, (c1 * e, -c1 * e), strict=True):
            dy.inverse_dynamics_at_solution(0.0, case.q, v, still, np.zeros(0), compiled.kernel_data)
            dy.gather_free(compiled.data.state.tau, compiled.data.arrays, side[k])
    T = 0.5 * (D[0] - D[1]).T  # velocity products are even
    first = {c: compiled.tangent(groups_of(compiled, None)) for c in (0.0, c1)}
    inverse(compiled, case.q, np.zeros(n))
    assert all(tangent.factor(c, c2) for c, tangent in first.items())
    x = first[c1].solve(case.a)
    y = first[0.0].solve(case.a - T @ x)  # (T0 + c1 D) x = a
    np.testing.assert_allclose(x, y, atol=1e-8 * (1.0 + np.abs(x).max()))


@pytest.mark.parametrize("how", [None, 1, 2])
@given(case=cases(cuts=True))
def test_reactions_of_constraints_and_their_springs(case: Case, how: int | None) -> None:
    """M + d(h + J^T lambda)/dq + J^T alpha J."""
    compiled, n, m, h = case.compiled, case.compiled.system.n, case.compiled.system.m, 1e-5
    rng, T = np.random.default_rng(0), np.zeros((n, n))
    lam, alpha = rng.normal(size=m), rng.uniform(0.5, 2.0, m)
    for k, e in enumerate(np.eye(n)):
        there, back = case.q.copy(), case.q.copy()
        compiled.system.apply(there, h * e)
        compiled.system.apply(back, -h * e)
        T[:, k] = (loaded(compiled, there, lam) - loaded(compiled, back, lam)) / (2.0 * h)
    terms = compiled.system.allocate_terms()
    compiled.system.fill(0.0, case.q, np.zeros(n), terms)
    T += 50.0 * terms.M + terms.J.T @ (alpha[:, None] * terms.J)
    if np.linalg.cond(T) > 1e6:
        return
    loaded(compiled, case.q, lam)
    tangent = compiled.tangent(groups_of(compiled, how))
    assert tangent.factor(0.0, 50.0, alpha)
    x = tangent.solve(case.a)
    np.testing.assert_allclose(T @ x, case.a, atol=1e-6 * (1.0 + np.abs(T).max() * np.abs(x).max()))


def test_it_is_symmetric_at_rest() -> None:
    """A flat sheet without weight."""
    compiled = CompiledMechanism(Sheet(nx=7, nz=5, gravity_y=0.0).build())
    system, rng = compiled.system, np.random.default_rng(0)
    assert isinstance(system, TreeSystem)
    q, still = compiled.assembly.start_positions(), np.zeros(system.n)
    system.residual(0.0, q, still, still)
    b, tangent = rng.normal(size=system.n), system.tangent
    assert tangent.factor(0.0, 1e4)
    x = tangent.solve(b)
    assert tangent.factor(0.0, 1e4, symmetric=True)
    y = tangent.solve(b)
    assert not np.array_equal(x, y)
    np.testing.assert_allclose(x, y, atol=1e-6 * np.abs(x).max())

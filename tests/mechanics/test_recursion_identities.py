"""Identities of the recursions of large trees: efforts of drives, mobility, and Coriolis terms against dM/dt."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from random_mechanisms import MOVING, build
from scipy.spatial.transform import Rotation

from mbfmu.mechanics import (
    CompiledMechanism,
    Harmonic,
    JointForce,
    JointSpring,
    Mechanism,
    Revolute,
    Spherical,
    Translational,
)
from mbfmu.mechanics.recursions.aba import apply_inverse_mass_matrix, drive_efforts, forward_dynamics
from mbfmu.mechanics.recursions.dynamics import inverse_dynamics_at_solution, update_kinematics
from mbfmu.mechanics.recursions.energy import evaluate_energy_bound, inertia_parts

SEVERAL = [joint for joint in MOVING if joint.nv >= 2]
PLAIN = [joint for joint in MOVING if joint.nv == joint.nq]
STEP = 1e-3
STENCIL = {-3: -1 / 60, -2: 9 / 60, -1: -45 / 60, 1: 45 / 60, 2: -9 / 60, 3: 1 / 60}  # first derivative, sixth order


def driven_tree(*, driven: bool = True) -> CompiledMechanism:
    """Three driven joints with a spring and a force on them, and free joints between; or the same, all free."""

    def drive(amplitude: float, frequency: float) -> dict[str, Any]:
        return {"drive": Harmonic(amplitude=amplitude, frequency=frequency)} if driven else {}

    m = Mechanism(gravity=(0.3, -9.81, 2.0))
    inertia = np.array(((2.0, 0.3, -0.2), (0.3, 1.5, 0.1), (-0.2, 0.1, 1.1)))
    solid: dict[str, Any] = {"mass": 1.3, "com": (0.2, -0.1, 0.3), "inertia": inertia}
    first = m.body("first", m.ground, Revolute(axis=(1, 2, 3), armature=0.7, **drive(0.4, 0.7)), **solid)
    ball = m.body("ball", first, Spherical(at=(0.3, 0.1, 0)), **solid)
    slide = Translational(axis=(2, -1, 1), at=(0, 0.2, 0.1), armature=0.4, **drive(0.3, 0.4))
    second = m.body("second", ball, slide, **solid)
    last = m.body("last", second, Revolute(axis="y", at=(0.1, 0.4, 0), armature=0.9), **solid)
    m.body("tip", last, Revolute(axis=(3, -1, 2), at=(0.2, 0.3, -0.1), **drive(0.5, 0.6)), **solid)
    m.output("jacobi", m.jacobi_integral)
    m.force("spring", JointSpring(stiffness=3.0, damping=0.7, free=-0.5), first)
    m.force("push", JointForce(magnitude=2.5), second)
    return CompiledMechanism(m)


def test_efforts_of_drives_by_articulated_bodies_are_those_of_inverse_dynamics() -> None:
    compiled, random = driven_tree(), np.random.default_rng(5)
    q = compiled.assembly.start_positions()
    compiled.system.apply(q, random.normal(size=compiled.system.n))
    v = random.normal(size=compiled.system.n)
    arrays, state = compiled.kernel_data
    update_kinematics(0.4, q, v, arrays, state)
    assert forward_dynamics(arrays, state) == 0
    drive_efforts(arrays, state)
    bodies, held = compiled.data.arrays.bodies, compiled.data.state
    driven = [int(b["vi"]) for b in bodies[1:] if b["drive"] >= 0]
    free = np.concatenate([np.arange(b["vi"], b["vi"] + b["nv"]) for b in bodies[1:] if b["vf"] >= 0])
    efforts, a = held.tau[driven].copy(), held.a[free].copy()
    inverse_dynamics_at_solution(0.4, q, v, a, np.zeros(0), compiled.kernel_data)
    assert len(driven) == 3
    np.testing.assert_allclose(efforts, held.tau[driven], rtol=1e-11)
    np.testing.assert_allclose(held.tau[free], 0.0, atol=1e-11 * np.abs(efforts).max())


def test_momenta_along_driven_coordinates_are_derivatives_of_the_kinetic_energy() -> None:
    """Energy less the Jacobi integral is the sum of p v, p = dT/dv of the same tree without drives."""
    t, compiled, free = 0.4, driven_tree(), driven_tree(driven=False)
    random, q, v = np.random.default_rng(6), free.assembly.start_positions(), np.zeros(free.system.n)
    free.system.apply(q, random.normal(size=free.system.n))
    v[:] = random.normal(size=free.system.n)
    own, twin = compiled.data.arrays.bodies, free.data.arrays.bodies
    mine = [k for k in range(1, len(own)) if own[k]["vf"] >= 0]
    wanted, motions = 0.0, {1: (0.4, 0.7), 3: (0.3, 0.4), 5: (0.5, 0.6)}
    for k, (amplitude, frequency) in motions.items():
        rate = 2.0 * np.pi * frequency
        q[twin[k]["qf"]], v[twin[k]["vf"]] = amplitude * np.sin(rate * t), amplitude * rate * np.cos(rate * t)
    for k in motions:
        e = np.eye(free.system.n)[twin[k]["vf"]]
        wanted += v @ e * 0.5 * (free.energy(t, q, v + e) - free.energy(t, q, v - e))
    q0 = np.concatenate([q[twin[k]["qf"] : twin[k]["qf"] + twin[k]["nq"]] for k in mine])
    v0 = np.concatenate([v[twin[k]["vf"] : twin[k]["vf"] + twin[k]["nv"]] for k in mine])
    out = np.zeros(1)
    compiled.observe(t, q0, v0, np.zeros(compiled.system.n), np.zeros(0), out)
    assert compiled.energy(t, q0, v0) == pytest.approx(free.energy(t, q, v), rel=1e-12)
    assert compiled.energy(t, q0, v0) - out[0] == pytest.approx(wanted, rel=1e-10)


def test_positions_are_products_of_rotations_and_offsets() -> None:
    """Bodies on hinges anywhere, r = r_parent + A_parent s: identities of dynamics hold for wrong offsets, too."""
    random, m = np.random.default_rng(8), Mechanism()
    body, A, r, wanted = m.ground, np.eye(3), np.zeros(3), []
    for k in range(4):
        at, axis, angle, point = (
            random.normal(size=3),
            random.normal(size=3),
            random.uniform(-3.0, 3.0),
            (0.3, -0.7, 1.1),
        )
        joint = Revolute(axis=tuple(axis), at=tuple(at), start=angle, fixed=True)
        body = m.body(f"b{k}", body, joint, mass=1.0, inertia=(1.0, 1.0, 1.0))
        r = r + A @ at
        A = A @ Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
        wanted += [*r, *(r + A @ point)]
        for place in ((0.0, 0.0, 0.0), point):
            for direction in "xyz":
                m.output(f"{k} {place} {direction}", body.position(direction, point=place))
    compiled = CompiledMechanism(m)
    out = np.zeros(len(wanted))
    compiled.observe(0.0, *compiled.assemble(), np.zeros(compiled.system.n), np.zeros(0), out)
    np.testing.assert_allclose(out, wanted, atol=1e-13)


def test_the_effort_of_a_drive_has_what_acts_along_its_coordinate() -> None:
    """A disc on a driven axis with a spring and a damper: I q'' + d q' + k (q - free)."""
    m = Mechanism()
    amplitude, rate, t = 0.4, 2.0 * np.pi * 0.7, 0.3
    disc = m.body("disc", m.ground, Revolute(drive=Harmonic(amplitude=0.4, frequency=0.7)), mass=1, inertia=(1, 1, 2.0))
    m.force("spring", JointSpring(stiffness=3.0, damping=0.7, free=-0.5), disc)
    compiled = CompiledMechanism(m)
    arrays, state = compiled.kernel_data
    update_kinematics(t, np.zeros(0), np.zeros(0), arrays, state)
    assert forward_dynamics(arrays, state) == 0
    drive_efforts(arrays, state)
    q, speed = amplitude * np.sin(rate * t), amplitude * rate * np.cos(rate * t)
    wanted = -2.0 * rate**2 * q + 0.7 * speed + 3.0 * (q + 0.5)
    assert compiled.data.state.tau[0] == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("joint", SEVERAL)
@pytest.mark.parametrize("driven", [False, True])
def test_mobility_is_the_inverse_of_the_mass_matrix(joint: Any, driven: bool) -> None:
    kinds = [Revolute, joint, Translational, joint]
    case = build(11, kinds, [], driven, True)
    system, random = case.compiled.system, np.random.default_rng(3)
    terms = system.allocate_terms()
    system.fill(case.t, case.q, case.v, terms)
    M = terms.M.copy()
    arrays, state = case.compiled.kernel_data
    update_kinematics(case.t, case.q, case.v, arrays, state)
    assert forward_dynamics(arrays, state) == 0
    for _ in range(3):
        r, x = random.normal(size=system.n), np.zeros(system.n)
        apply_inverse_mass_matrix(arrays, state, r, x)
        np.testing.assert_allclose(M @ x, r, atol=1e-10 * np.linalg.cond(M))


@pytest.mark.parametrize("seed", range(8))
def test_the_rate_of_the_mass_matrix_less_twice_the_coriolis_matrix_is_skew(seed: int) -> None:
    """C v are the terms of second order in v of h; C by polarization is that of Christoffel where q' = v."""
    random = np.random.default_rng(seed)
    kinds = [PLAIN[k] for k in random.integers(0, len(PLAIN), 4)]
    case = build(seed, kinds, [], False, False)
    system, n = case.compiled.system, case.compiled.system.n
    terms = system.allocate_terms()

    def bias(v: Any) -> Any:
        system.fill(case.t, case.q, v, terms)
        return terms.h.copy()

    def mass(way: float) -> Any:
        q = case.q.copy()
        system.apply(q, way * case.v)
        system.fill(case.t, q, case.v, terms)
        return terms.M.copy()

    rest, own = bias(np.zeros(n)), bias(case.v)
    columns = [0.5 * (bias(case.v + e) - own - bias(e) + rest) for e in np.eye(n)]
    slope = sum(weight * mass(k * STEP) for k, weight in STENCIL.items()) / STEP
    skew = slope - 2.0 * np.array(columns).T
    np.testing.assert_allclose(skew, -skew.T, atol=1e-8 * max(1.0, float(np.abs(slope).max())))
    assert np.abs(slope).max() > 1e-3


@pytest.mark.parametrize("joint", MOVING)
def test_kinetic_energy_and_diagonal_of_the_mass_matrix_without_the_matrix(joint: Any) -> None:
    case = build(4, [joint, Revolute, joint], [], False, False)
    system = case.compiled.system
    terms, parts = system.allocate_terms(), np.zeros(1 + system.n)
    system.fill(case.t, case.q, case.v, terms)
    inverse_dynamics_at_solution(case.t, case.q, case.v, case.a, np.zeros(0), case.compiled.kernel_data)
    inertia_parts(*case.compiled.kernel_data, parts)
    np.testing.assert_allclose(parts[0], case.v @ terms.M @ case.v, rtol=1e-11)
    np.testing.assert_allclose(parts[1:], np.diag(terms.M), rtol=1e-11)


@pytest.mark.parametrize("joint", MOVING)
def test_extent_of_a_motion_is_measured_in_tolerances(joint: Any) -> None:
    """Two states one after the other: displacement, velocity, and the momentum times the velocity before."""
    case = build(9, [Revolute, joint], [], False, False)
    compiled, random = case.compiled, np.random.default_rng(2)
    system, n = compiled.system, compiled.system.n
    terms, place, rate = system.allocate_terms(), random.uniform(0.5, 2.0, n), random.uniform(0.5, 2.0, n)
    found = np.concatenate((np.zeros(5), np.full(n, np.nan), np.zeros(n)))
    q, v = case.q.copy(), 2.0 * case.v
    system.apply(q, random.normal(size=n))
    for at, speed in ((case.q, case.v), (q, v)):
        system.fill(case.t, at, speed, terms)
        evaluate_energy_bound(1e-3, place, rate, *compiled.kernel_data, found)
        assert found[3] == pytest.approx(np.max(np.abs(speed) / rate), rel=1e-12)
        assert found[2] == pytest.approx(
            np.max(np.abs(along(compiled, at) - along(compiled, case.q)) / place), rel=1e-12
        )
    assert found[4] == pytest.approx(v @ terms.M @ case.v, rel=1e-10)
    np.testing.assert_array_equal(found[5 + n :], v)


def along(compiled: CompiledMechanism, q: Any) -> Any:
    """Displacements (n,) of the free coordinates; of a quaternion twice its vector part."""
    found: list[float] = []
    for body in compiled.data.arrays.bodies[1:]:
        plain = int(body["nq"] - 4 * body["quaternion"])
        here = q[int(body["qf"]) :][: int(body["nq"])]
        found += [*here[:plain], *(2.0 * here[plain + 1 :])]
    return np.array(found)

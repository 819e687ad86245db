"""dE/dt along a motion is the power of drives, dampers and given forces: what the balance of a run adds up."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from random_mechanisms import Case, cases
from test_identities import observed

from mbfmu.mechanics import Beam, CompiledMechanism, Harmonic, Input, Mechanism, Revolute, rod
from mbfmu.mechanics.arrays import systems
from mbfmu.sheets import Support, add_sheet
from mbfmu.testing.identities import State, energy_rate
from solvers.compiled.kernel import kernel
from solvers.system import TreeSystem

TOLERANCE = 1e-9


@kernel
def call_power(function: Any, t: float, q: Any, v: Any, a: Any, lam: Any, data: Any) -> float:
    return function(t, q, v, a, lam, data)


@kernel
def call_energy_bound(function: Any, rtol: float, place: Any, rate: Any, data: Any, out: Any) -> None:
    function(rtol, place, rate, data, out)


@kernel
def call_forward(function: Any, t: float, q: Any, v: Any, data: Any, qdot: Any, a: Any) -> int:
    return function(t, q, v, data, qdot, a)


def check(case: Case, lam: Any) -> None:
    """dE/dt = power + what moves the free coordinates as they are moved + what a cut joint that opens gives."""
    for deviation in energy_rate(case.compiled, State(case.t, case.q, case.v, case.a, lam)):
        assert deviation.size < TOLERANCE, deviation


@settings(deadline=None)
@given(cases(driven=True, forces=True))
def test_power_of_a_tree_is_the_rate_of_its_energy(case: Case) -> None:
    check(case, np.zeros(0))


@settings(deadline=None)
@given(cases(cuts=True, driven=True, forces=True))
def test_power_of_loops_is_the_rate_of_their_energy(case: Case) -> None:
    check(case, np.random.default_rng(1).normal(size=case.compiled.system.m))


@settings(deadline=None)
@given(cases(forces=True))
def test_energy_bound_is_momentum_and_bias_by_tolerance(case: Case) -> None:
    compiled, system = case.compiled, case.compiled.system
    terms, out, zero = system.allocate_terms(), np.zeros(2), np.zeros(system.n)
    energy, turned = compiled.energy(case.t, case.q, case.v), turns(compiled)
    close = {"rel": 1e-8, "abs": 1e-10 * max(1.0, abs(energy))}
    for i, e in enumerate(np.eye(system.n)):
        p = 0.5 * (compiled.energy(case.t, case.q, case.v + e) - compiled.energy(case.t, case.q, case.v - e))
        system.fill(case.t, case.q, case.v, terms)
        call_energy_bound(system.evaluate_energy_bound, 0.0, zero, e, system.pinned_data, out)
        assert out[0] == pytest.approx(abs(p), **close)
        system.fill(case.t, case.q, case.v, terms)
        call_energy_bound(system.evaluate_energy_bound, 0.0, e, zero, system.pinned_data, out)
        assert out[0] == pytest.approx(abs(terms.h[i]), **close)
    assert out[1] == pytest.approx(0.5 * case.v @ terms.M @ case.v, **close)
    system.fill(case.t, case.q, case.v, terms)
    call_energy_bound(system.evaluate_energy_bound, 1e-3, zero, zero, system.pinned_data, out)
    reach = np.array([abs(case.q[k]) if k >= 0 else 2.0 for k in turned])
    expected = np.concatenate((terms.h * reach, (terms.M @ case.v) * case.v))
    assert out[0] == pytest.approx(1e-3 * np.linalg.norm(expected), **close)


def turns(compiled: CompiledMechanism) -> list[int]:
    """Where in q each free coordinate is; -1: in a quaternion."""
    found = []
    for body in compiled.data.arrays.bodies[1:]:
        plain = int(body["nq"] - 4 * body["quaternion"])
        found += [int(body["qf"]) + k if k < plain else -1 for k in range(int(body["nv"]))]
    return found


@settings(deadline=None)
@given(cases(driven=True))
def test_energy_bound_counts_a_drive_by_its_effort_and_momentum(case: Case) -> None:
    system, out, n = case.compiled.system, np.zeros(2), case.compiled.system.n
    terms = system.allocate_terms()
    found = observed(case, case.t, case.q, case.v, np.zeros(n), np.zeros(0))
    energy = case.compiled.energy(case.t, case.q, case.v)
    action = energy - found["jacobi"]  # p v of the drive
    p = [
        0.5 * (case.compiled.energy(case.t, case.q, case.v + e) - case.compiled.energy(case.t, case.q, case.v - e))
        for e in np.eye(n)
    ]
    close = {"rel": 1e-7, "abs": 1e-9 * max(1.0, abs(energy))}
    system.fill(case.t, case.q, case.v, terms)
    call_energy_bound(system.evaluate_energy_bound, 0.0, np.ones(n), np.zeros(n), system.pinned_data, out)
    assert out[0] == pytest.approx(np.linalg.norm([*terms.h, found["b0.effort"]]), **close)
    system.fill(case.t, case.q, case.v, terms)
    call_energy_bound(system.evaluate_energy_bound, 0.0, np.zeros(n), np.ones(n), system.pinned_data, out)
    speed = found["b0.drive_rate"]
    assert out[0] * abs(speed) == pytest.approx(np.linalg.norm([*(speed * np.array(p)), action]), **close)


def beams(driven: bool) -> Mechanism:
    m = Mechanism(gravity=(0.3, -9.81, 0.2))
    hinge = Revolute(drive=Harmonic(amplitude=0.4, frequency=0.7)) if driven else Revolute(start=0.2)
    beam = Beam(length=2.0, mass=3.0, bending_stiffness=400.0, modes=2, ends=("clamped", "free"), damping=1e-2,
                stiffening=True)  # fmt: skip
    arm = m.flexible_body("arm", m.ground, hinge, beam)
    m.body("flap", arm.section(2.0), Revolute(start=0.4), **rod(mass=0.4, length=0.3))
    m.output("energy", m.energy)
    return m


def sheet(driven: bool) -> Mechanism:
    m = Mechanism(gravity=(0.3, -9.81, 0.2))
    hinge = Revolute(axis="x", drive=Harmonic(amplitude=0.4, frequency=0.7)) if driven else Revolute(axis="x")
    arm = m.body("arm", m.ground, hinge, **rod(mass=0.2, length=0.1))
    add_sheet(
        m, "paper", length=0.3, width=0.2, thickness=1e-3, youngs_modulus=3e7, density=800.0, grid=(4, 3),
        supports=[Support("x0", "clamped", body=arm)], membrane=True, damping=1e-3, drag=1.3,
        pressure=Input(name="p", unit="Pa", start=40.0),
    )  # fmt: skip
    m.output("energy", m.energy)
    return m


@pytest.mark.parametrize("driven", [False, True])
@pytest.mark.parametrize("make", [beams, sheet])
def test_power_of_elastic_bodies_is_the_rate_of_their_energy(make: Any, driven: bool, monkeypatch: Any) -> None:
    """Modes, plates, drag, pressure and their damping, on a hinge that swings and on one that is driven."""
    rng = np.random.default_rng(5)
    monkeypatch.setattr(systems, "MAX_DENSE_TREE_COORDINATES", 10**6)
    compiled = CompiledMechanism(make(driven))
    q = compiled.assembly.start_positions()
    n = compiled.system.n
    compiled.system.apply(q, 0.05 * rng.normal(size=n))
    check(Case(compiled, 0.3, q, 0.2 * rng.normal(size=n), rng.normal(size=n)), np.zeros(0))


@pytest.mark.parametrize("driven", [False, True])
def test_power_of_a_large_tree_is_that_of_the_dense_system(driven: bool, monkeypatch: Any) -> None:
    """After the articulated-body recursion as after inverse dynamics."""
    rng = np.random.default_rng(6)
    monkeypatch.setattr(systems, "MAX_DENSE_TREE_COORDINATES", 10**6)
    dense = CompiledMechanism(sheet(driven))
    monkeypatch.setattr(systems, "MAX_DENSE_TREE_COORDINATES", 0)
    tree = CompiledMechanism(sheet(driven))
    assert isinstance(tree.system, TreeSystem)
    n, none = tree.system.n, np.zeros(0)
    q = tree.assembly.start_positions()
    tree.system.apply(q, 0.05 * rng.normal(size=n))
    v = rng.normal(size=n)
    terms = dense.system.allocate_terms()
    dense.system.fill(0.3, q, v, terms)
    a = np.linalg.solve(terms.M, -terms.h)
    expected = call_power(dense.system.power, 0.3, q, v, a, none, dense.system.pinned_data)
    s = tree.system
    s.residual(0.3, q, v, a)
    assert call_power(s.power, 0.3, q, v, a, none, s.pinned_data) == pytest.approx(expected, rel=1e-9)
    found = np.zeros(n)
    assert call_forward(s.forward, 0.3, q, v, s.pinned_data, np.zeros(s.nq), found) == 0
    assert call_power(s.power, 0.3, q, v, found, none, s.pinned_data) == pytest.approx(expected, rel=1e-8)


def test_nothing_works_where_all_has_a_potential() -> None:
    m = Mechanism(gravity=(0, -9.81, 0))
    m.body("bar", m.ground, Revolute(), **rod(mass=1.0, length=1.0))
    assert not CompiledMechanism(m).system.works()
    assert CompiledMechanism(beams(driven=False)).system.works()

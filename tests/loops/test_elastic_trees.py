"""Flexible bodies in recursions and in the elimination of constraints, against dense linear algebra of NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from test_elimination import Solved, turned

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism
from solvers.compiled.kernel import kernel


@kernel
def _forward(eqs: Any, t: float, q: Any, v: Any, qdot: Any, a: Any) -> int:
    return eqs.forward(t, q, v, eqs.data, qdot, a)


@kernel
def _multiply_inverse(eqs: Any, r: Any, x: Any) -> None:
    eqs.mobility(r, eqs.data, x)


@kernel
def _parts(eqs: Any, out: Any) -> None:
    eqs.inertia_parts(eqs.data, out)


def straight_beam() -> mb.FlexibleBody:
    """Three nodes with six degrees of freedom in a row, unequal stiffnesses."""
    n, x = 3, np.array([0.0, 0.4, 1.0])
    M, K = np.zeros((6 * n, 6 * n)), np.zeros((6 * n, 6 * n))
    for e in range(n - 1):
        h, own = x[e + 1] - x[e], np.r_[6 * e : 6 * e + 12]
        rigid = np.zeros((12, 6))  # motions without deformation, about the first node
        for node, at in ((0, 0.0), (1, h)):
            rigid[6 * node : 6 * node + 6] = np.eye(6)
            rigid[6 * node + 1, 5], rigid[6 * node + 2, 4] = at, -at
        strain = np.hstack((-rigid[6:], np.eye(6)))
        K[np.ix_(own, own)] += strain.T @ np.diag([900.0, 80.0, 50.0, 30.0, 20.0, 25.0]) @ strain
        M[np.ix_(own, own)] += np.diag(np.tile([0.4 * h] * 3 + [0.01, 0.02, 0.015], 2))
    nodes = np.column_stack((x, 0.0 * x, 0.0 * x))
    return mb.FlexibleBody.from_fe(M, K, nodes, {"a": [0], "b": [1], "c": [2]}, modes=0)


SOLID = straight_beam()
CANTILEVER = mb.Beam(
    length=1.2, mass=0.7, bending_stiffness=40.0, modes=3, ends=("clamped", "free"), stiffening=True, damping=0.01
)
CHORD = mb.Beam(length=0.8, mass=0.3, bending_stiffness=15.0, modes=2)


def random_tree(seed: int, loops: bool) -> mb.Mechanism:
    """Rigid and flexible bodies on each other, at random attitudes, on a base that a drive turns."""
    rng = np.random.default_rng(seed)
    m = mb.Mechanism(gravity=rng.normal(size=3))
    drive = mb.Harmonic(amplitude=0.6, frequency=0.4, phase=rng.normal())
    base = m.body("base", m.ground, mb.Revolute(axis=rng.normal(size=3), drive=drive), mass=1.0, inertia=(1, 2, 1.5))
    places = [base]
    kinds = mb.Revolute, mb.Spherical, mb.Universal, mb.Floating, mb.Weld
    for i in range(7):
        kind = kinds[rng.integers(len(kinds))]
        options: dict[str, Any] = {"at": rng.normal(size=3), "rotation": turned(rng)}
        if kind is mb.Revolute:
            options["armature"] = 0.3
        parent, joint = places[rng.integers(len(places))], kind(**options)
        if i % 3 == 0:
            rigid = {"com": rng.normal(size=3), "mass": rng.uniform(0.5, 2.0), "inertia": (1.0, 1.2, 0.9)}
            places.append(m.body(f"rigid{i}", parent, joint, **rigid))
            continue
        elastic = (SOLID, CANTILEVER, CHORD)[rng.integers(3)]
        handle = m.flexible_body(f"elastic{i}", parent, joint, elastic)
        places += [handle.section(key) for key in (("b", "c") if elastic is SOLID else (0.3, 0.7))]
        places.append(m.body(f"mass{i}", handle.body, mb.Weld(), mass=0.5, inertia=(0.3, 0.2, 0.4)))
    for i, place in enumerate(places[1:]):
        spring = mb.Spring(stiffness=3.0, damping=0.2, at_a=rng.normal(size=3), free=0.4)
        m.force(f"spring{i}", spring, place, base)
    if loops:  # with bodies that are free to close them; the last connects two sections of one body
        for i, kind in enumerate((mb.SphericalCutJoint, mb.RevoluteCutJoint, mb.WeldCutJoint)):
            a, b = (places[k] for k in rng.integers(0, len(places), 2))
            free = m.body(f"free{i}", a, mb.Floating(), com=rng.normal(size=3), mass=1.0, inertia=(1.0, 1.5, 2.0))
            m.cut(f"cut{i}", kind(at_a=rng.normal(size=3), at_b=rng.normal(size=3)), free, b)
        a, b = handle.sections()
        m.cut("within", mb.DistanceCutJoint(at_a=(0.1, 0.2, 0.3), length=0.9), a, b)
    return m


def random_state(compiled: CompiledMechanism, seed: int) -> tuple[float, Any, Any]:
    rng, system = np.random.default_rng(seed), compiled.system
    q = compiled.assembly.start_positions()
    system.apply(q, rng.normal(size=system.n) * np.where(system.size == 1.0, 1.0, 0.02))
    return 0.3, q, rng.normal(size=system.n)


@pytest.mark.parametrize("seed", range(12))
def test_recursions_are_the_solution_with_the_mass_matrix(seed: int) -> None:
    """M a + h = 0, M x = r, v . M v and the diagonal of M."""
    compiled = CompiledMechanism(random_tree(seed, False))
    (t, q, v), system, rng = random_state(compiled, seed), compiled.system, np.random.default_rng(seed)
    terms = system.allocate_terms()
    system.fill(t, q, v, terms)
    M, h, eqs, n = terms.M.copy(), terms.h.copy(), system.recursions().equations, system.n
    rounding = 1e-15 * np.linalg.cond(M)
    qdot, a, x, r, parts = np.zeros(system.nq), np.zeros(n), np.zeros(n), rng.normal(size=n), np.zeros(1 + n)
    assert _forward(eqs, t, q, v, qdot, a) == 0
    _multiply_inverse(eqs, r, x)
    np.testing.assert_allclose(M @ a, -h, rtol=0, atol=rounding * np.abs(h).max())
    np.testing.assert_allclose(M @ x, r, rtol=0, atol=rounding)
    np.testing.assert_array_equal(qdot, terms.qdot)
    _parts(eqs, parts)
    assert parts[0] == pytest.approx(v @ M @ v, rel=1e-12)
    np.testing.assert_allclose(parts[1:], np.diag(M), rtol=1e-12)


@pytest.mark.parametrize("seed", range(12))
def test_elimination_is_the_solution_with_matrices(seed: int) -> None:
    compiled = CompiledMechanism(random_tree(seed, True))
    Solved(compiled, *random_state(compiled, seed)).check(1e-9)

"""Impulses on coordinates of large models with loops, which are found by the elimination of their constraints."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from mechanisms import n_four_bar
from scipy.linalg import lstsq
from scipy.spatial.transform import Rotation
from test_elimination import random_mechanism

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism
from mbfmu.modeling.model import as_model
from mbfmu.session.impulses import EliminatedJumps, UndeterminedJumpError, velocity_jump

LINKS, REACH = 72, 5  # number of links; difference of the numbers of those that are connected
LOOPS = 31  # of a row of four-bars, which moves as one rod
INERTIA = (LOOPS + 1) / 3.0 + LOOPS  # kg m2, of its rods of 1 m and 1 kg


@dataclass
class Chain:
    """Links in space in series. Every third is connected to the fifth before it by a spherical cut joint, one twice."""

    seed: int
    scale: float
    places: list[Any] = field(default_factory=list)  # m, of the joints
    turns: list[Any] = field(default_factory=list)  # rotation matrices of the links
    axes: list[Any] = field(default_factory=list)  # of the joints, in space
    centers: list[Any] = field(default_factory=list)  # m, centers of mass
    masses: list[float] = field(default_factory=list)  # kg
    inertias: list[float] = field(default_factory=list)  # kg m2
    cuts: list[tuple[int, int, Any]] = field(default_factory=list)  # links and the point that they share, m

    def __post_init__(self) -> None:
        rng, scale = np.random.default_rng(self.seed), self.scale
        self.mechanism = m = mb.Mechanism()
        body, R, r = m.ground, np.eye(3), np.zeros(3)
        for k in range(LINKS):
            axis, at, start = "xyz"[k % 3], scale * rng.uniform(-0.3, 0.3, 3), float(rng.uniform(-1.0, 1.0))
            mass, com = float(rng.uniform(0.5, 2.0)), scale * rng.uniform(-0.2, 0.2, 3)
            J = 0.05 * mass * scale**2
            r = r + R @ at
            R = R @ Rotation.from_euler(axis, start).as_matrix()
            joint = mb.Revolute(axis=axis, at=at, start=start)
            body = m.body(f"link{k}", body, joint, mass=mass, com=com, inertia=(J, J, J))
            self.places.append(r)
            self.turns.append(R)
            self.axes.append(R[:, "xyz".index(axis)])
            self.centers.append(r + R @ com)
            self.masses.append(mass)
            self.inertias.append(J)
        for k in range(REACH, LINKS, 3):
            point = self.places[k] + scale * rng.uniform(-0.3, 0.3, 3)
            for copy in range(2 if k == REACH else 1):
                ends = [self.turns[i].T @ (point - self.places[i]) for i in (k, k - REACH)]
                cut = mb.SphericalCutJoint(at_a=ends[0], at_b=ends[1])
                m.cut(f"loop{k}.{copy}", cut, m.bodies[k + 1], m.bodies[k + 1 - REACH])
            self.cuts.append((k, k - REACH, point))

    def jump(self, p: Any) -> Any:
        """Jump of the rates of the joints by angular impulses p (LINKS,) in these, N m s.

        Unknowns are the velocities of the centers of mass and the angular velocities, in units of the scale, and the
        impulses of the constraints.
        """
        rows = []
        for k in range(LINKS):
            place, axis = self.places[k], self.axes[k]
            rows += self.apart(k, k - 1, place)
            for across in np.linalg.svd(axis[np.newaxis])[2][1:]:
                row = np.zeros((LINKS, 6))
                row[k, 3:] = across
                if k:
                    row[k - 1, 3:] = -across
                rows.append(row.ravel())
        for k, other, point in self.cuts:
            rows += self.apart(k, other, point)
        G, n = np.array(rows), 6 * LINKS
        J = np.array(self.inertias) / self.scale**2
        M, load = np.repeat(np.column_stack([self.masses, J]), 3, axis=1), np.zeros((LINKS, 6))
        for k in range(LINKS):
            load[k, 3:] += p[k] / self.scale**2 * self.axes[k]
            if k:
                load[k - 1, 3:] -= p[k] / self.scale**2 * self.axes[k]
        A = np.block([[np.diag(M.ravel()), G.T], [G, np.zeros((len(G), len(G)))]])
        x = lstsq(A, np.append(load.ravel(), np.zeros(len(G))), cond=1e-12)[0][:n].reshape(LINKS, 6)
        spins = x[:, 3:] - np.vstack([np.zeros((1, 3)), x[:-1, 3:]])
        return np.sum(spins * np.array(self.axes), axis=1)

    def apart(self, a: int, b: int, point: Any) -> list[Any]:
        """Three rows: the velocity of links a and b at a point; b < 0 is the ground."""
        found = np.zeros((3, LINKS, 6))
        for body, sign in ((a, 1.0), (b, -1.0)):
            if body >= 0:
                x, y, z = (point - self.centers[body]) / self.scale
                found[:, body, :3] += sign * np.eye(3)
                found[:, body, 3:] += sign * np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
        return list(found.reshape(3, -1))


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e3])
def test_the_jump_is_that_in_absolute_coordinates(scale: float) -> None:
    """Reference: the velocities of all bodies, with every joint and every cut joint as a constraint, by SciPy.

    The work of an impulse is that of the mean velocity.
    """
    chain = Chain(3, scale)
    compiled = as_model(chain.mechanism).compile()
    q, v = compiled.assemble(0.0)
    assert compiled.system.m == 3 * (len(chain.cuts) + 1)
    np.testing.assert_allclose(q, [body.joint.start for body in chain.mechanism.bodies[1:]], rtol=0.0, atol=1e-12)
    rng = np.random.default_rng(7)
    p = scale**2 * rng.normal(size=(2, LINKS))
    jumps = velocity_jump(compiled, 0.0, q, v, p)
    expected = np.array([chain.jump(row) for row in p])
    np.testing.assert_allclose(jumps, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())
    energies = [compiled.energy(0.0, q, rates) for rates in (jumps[0], jumps.sum(axis=0))]
    assert energies[1] - energies[0] == pytest.approx(p[1] @ (jumps[0] + 0.5 * jumps[1]), rel=1e-8)


@pytest.mark.parametrize("seed", range(20))
def test_the_jump_of_random_mechanisms(seed: int) -> None:
    """All kinds of joints and cut joints, one joint driven, equations that depend on each other, and a gear, at any
    velocities. Reference: a basis of the allowed motions from the singular value decomposition of J.
    """
    compiled, rng = CompiledMechanism(random_mechanism(seed)), np.random.default_rng(seed)
    system = compiled.system
    q, v, p = compiled.assembly.start_positions(), rng.normal(size=system.n), rng.normal(size=(2, system.n))
    system.apply(q, rng.normal(size=system.n))
    terms = system.allocate_terms()
    system.fill(0.3, q, v, terms)
    _, sigma, rows = np.linalg.svd(terms.J * system.size)
    free = system.size[:, np.newaxis] * rows[np.count_nonzero(sigma > 1e-9 * sigma[0]) :].T
    expected = p @ free @ np.linalg.inv(free.T @ terms.M @ free) @ free.T
    jumps = EliminatedJumps(system, 0.3, q, v).find(0.3, q, v, p, 1e-7)
    np.testing.assert_allclose(jumps, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


def row(angle: float) -> tuple[Any, Any, Any, Any]:
    """Return a row of four-bars whose columns are at an angle, rad, with a wheel of 2 kg m2: compiled; its closed
    positions, velocities, and directions of the rods.
    """
    m = n_four_bar(LOOPS).mechanism
    m.body("wheel", m.ground, mb.Revolute(), inertia=(1.0, 1.0, 2.0))
    compiled = as_model(m).compile()
    signs = np.append(np.tile([1.0, -1.0], LOOPS + 1)[:-1], 0.0)
    return compiled, angle * signs, -signs, signs


def test_an_impulse_on_a_row_of_fourbars() -> None:
    """Closed form: the row moves as one rod, next to a singular configuration of all loops, too."""
    for angle in (1.0, 1e-2, 1e-5):
        compiled, q, v, signs = row(angle)
        p = np.zeros(len(q))
        p[-2], p[-1] = 7.0, 3.0
        expected = 7.0 / INERTIA * signs
        expected[-1] = 1.5
        np.testing.assert_allclose(velocity_jump(compiled, 0.0, q, v, p), expected, rtol=0.0, atol=1e-8 / angle)


def test_an_impulse_in_a_singular_configuration_is_refused() -> None:
    """That on the wheel is not: it moves no loop."""
    compiled, q, v, signs = row(0.0)
    p = np.eye(len(q))[[-2, -1]]
    with pytest.raises(UndeterminedJumpError):
        velocity_jump(compiled, 0.0, q, v, p[0])
    np.testing.assert_allclose(velocity_jump(compiled, 0.0, q, v, p[1]), 0.5 * (signs == 0.0), rtol=0.0, atol=1e-15)
    compiled, q, v, _ = row(1e-5)
    with pytest.raises(UndeterminedJumpError):
        velocity_jump(compiled, 0.0, q, v, p[0], 1e-4)


def test_an_impulse_on_driven_loops_has_no_effect() -> None:
    m = mb.Mechanism()
    crank, below = mb.rod(mass=1.0, length=1.0), m.ground
    for k in range(24):
        drive = {"drive": mb.Harmonic(mean=1.2, amplitude=0.1, frequency=1.0)} if k == 0 else {"start": 1.2}
        first = m.body(f"a{k}", below, mb.Revolute(**drive), **crank)
        second = m.body(f"b{k}", below, mb.Revolute(at=(1.0, 0.0, 0.0), start=1.2), **crank)
        start = {"at": (1.0, 0.0, 0.0), "start": -1.2}
        below = m.body(f"coupler{k}", first, mb.Revolute(**start), **mb.rod(mass=1.0, length=1.0))
        m.cut(f"end{k}", mb.RevoluteCutJoint(at_a=(1.0, 0.0, 0.0), at_b=(1.0, 0.0, 0.0)), second, below)
        if k:
            m.couple(f"gear{k}", mb.Gear(ratio=1.0, offset=0.0), m.bodies[2], first)
    compiled = as_model(m).compile()
    q, v = compiled.assemble(0.0)
    assert compiled.system.n > 60
    jump = velocity_jump(compiled, 0.0, q, v, np.ones(compiled.system.n))
    np.testing.assert_array_equal(jump, 0.0)

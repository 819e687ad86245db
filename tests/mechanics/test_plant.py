"""The public calls of a compiled mechanism: poses, mass matrix, inverse dynamics."""

from __future__ import annotations

import numpy as np
import pytest

from mbfmu.mechanics import DistanceCut, Mechanism, Plant, Revolute, rod


def chain(links: int, *, loop: bool = False) -> Plant:
    """Links of 0.5 m that hang from the ground, their tip on a rod to the ground or free."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    body = m.ground
    for k in range(links):
        at = (0.5, 0.0, 0.0) if k else (0.0, 0.0, 0.0)
        body = m.body(
            f"link{k}", body, Revolute(at=at, start=0.3 - 0.02 * k, rate=0.1 * k), **rod(mass=1.0 + k, length=0.5)
        )
    if loop:
        m.cut("rod", DistanceCut(at_a=(0.5, 0.0, 0.0), at_b=(0.2 * links, 1.0, 0.0), length=1.0), body, m.ground)
    return Plant(m)


def test_poses_of_two_links() -> None:
    plant, q = chain(2), np.array([0.3, -1.1])
    r, A = plant.poses(0.0, q)
    np.testing.assert_allclose(r[2], [0.5 * np.cos(0.3), 0.5 * np.sin(0.3), 0.0], atol=1e-15)
    np.testing.assert_allclose(A[2][:, 0], [np.cos(-0.8), np.sin(-0.8), 0.0], atol=1e-15)
    plant.poses(0.0, q + 1.0)
    assert r[2][0] == pytest.approx(0.5 * np.cos(0.3))  # a copy


@pytest.mark.parametrize("links", [3, 70])  # by matrices; as a large tree
@pytest.mark.parametrize("loop", [False, True])
def test_mass_matrix_is_that_of_the_kinetic_energy(links: int, loop: bool) -> None:
    plant, random = chain(links, loop=loop), np.random.default_rng(3)
    q, v = plant.assembly.start_positions(), random.normal(size=links)
    kinetic = plant.energy(0.0, q, v) - plant.energy(0.0, q, 0.0 * v)
    assert 0.5 * v @ plant.mass_matrix(0.0, q) @ v == pytest.approx(kinetic, rel=1e-12)


@pytest.mark.parametrize("links", [3, 70])
def test_inverse_dynamics_is_affine_in_accelerations_and_multipliers(links: int) -> None:
    plant, random = chain(links, loop=True), np.random.default_rng(4)
    q, v, a = plant.assembly.start_positions(), random.normal(size=links), random.normal(size=links)
    bias = plant.inverse_dynamics(0.0, q, v, np.zeros(links))
    inertia = plant.mass_matrix(0.0, q) @ a
    scale = np.abs(inertia).max()
    np.testing.assert_allclose(plant.inverse_dynamics(0.0, q, v, a) - bias, inertia, atol=1e-11 * scale)
    # a force along the rod on the tip: by virtual work, how far each coordinate moves the tip along it
    lam, step, pull = np.array([2.0]), 1e-6, np.zeros(links)

    def length(q: np.ndarray) -> float:
        r, A = plant.poses(0.0, q)
        return float(np.linalg.norm(r[-1] + 0.5 * A[-1][:, 0] - [0.2 * links, 1.0, 0.0]))

    for k in range(links):
        ahead, behind = q.copy(), q.copy()
        ahead[k] += step
        behind[k] -= step
        pull[k] = 0.5 * (length(ahead) ** 2 - length(behind) ** 2) / (2.0 * step)  # of (d.d - L^2) / (2 L), L = 1 m
    found = plant.inverse_dynamics(0.0, q, v, a, lam) - plant.inverse_dynamics(0.0, q, v, a)
    np.testing.assert_allclose(found, 2.0 * pull, atol=1e-7 * np.abs(pull).max())

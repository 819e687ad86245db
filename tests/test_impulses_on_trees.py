"""Impulses on coordinates of large trees, which are found by recursions: against the mass matrix by the energy."""

from __future__ import annotations

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.modeling.model import as_model
from mbfmu.session.impulses import UndeterminedJumpError, velocity_jump

LINKS = 70


def chain(scale: float, last_mass: float = 1.0) -> mb.Mechanism:
    """Return a chain of links in space about axes of all directions; a spherical joint and a guide are among them."""
    m, body = mb.Mechanism(), None
    for k in range(LINKS):
        axis = ("x", "y", "z")[k % 3]
        at = (0.3 * scale, 0.1 * scale, 0.0) if k else (0.0, 0.0, 0.0)
        kind = mb.Spherical(at=at) if k == 30 else mb.Revolute(axis=axis, at=at, start=0.4 * (-1) ** k)
        joint = mb.Translational(axis="x", at=at, start=0.1 * scale) if k == 40 else kind
        mass = (1.0 + 0.1 * k) * (last_mass if k == LINKS - 1 else 1.0)
        J = 0.02 * mass * scale**2
        body = m.body(f"link{k}", body or m.ground, joint, mass=mass, com=(0.1 * scale, 0.0, 0.0), inertia=(J, J, J))
    return m


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e3])
def test_the_jump_is_that_of_the_mass_matrix(scale: float) -> None:
    """Reference: the kinetic energy of unit velocities gives the mass matrix; M dv = p is solved with it."""
    compiled = as_model(chain(scale)).compile()
    system = compiled.system
    assert not system.has_matrices
    q, v = compiled.assemble(0.0)
    n, rest, unit = system.n, compiled.energy(0.0, q, np.zeros(system.n)), system.size
    energies = np.zeros((n, n))
    basis = np.diag(unit)
    single = np.array([compiled.energy(0.0, q, row) - rest for row in basis])
    for i in range(n):
        for j in range(i):
            energies[i, j] = energies[j, i] = (
                compiled.energy(0.0, q, basis[i] + basis[j]) - rest - single[i] - single[j]
            )
        energies[i, i] = 2.0 * single[i]
    M = energies / np.outer(unit, unit)
    p = np.random.default_rng(5).normal(size=(3, n)) / unit
    jumps = velocity_jump(compiled, 0.0, q, v + 0.3 * unit, p)
    np.testing.assert_allclose(jumps @ M * unit, p * unit, rtol=0.0, atol=1e-8 * np.abs(p * unit).max())
    np.testing.assert_array_equal(velocity_jump(compiled, 0.0, q, v + 0.3 * unit, p[1]), jumps[1])


def test_an_impulse_on_what_has_no_mass_is_refused() -> None:
    m = chain(1.0)
    m.body("massless", m.bodies[LINKS], mb.Revolute(axis="x"))
    compiled = as_model(m).compile()
    q = compiled.assembly.start_positions()
    n = compiled.system.n
    with pytest.raises(UndeterminedJumpError):
        velocity_jump(compiled, 0.0, q, np.zeros(n), np.eye(n)[-1])

"""Stresses of plates and shells by linearized strains, with which statics factor their tangent."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fmus.sheet import Sheet
from mbfmu.mechanics import CompiledMechanism


def forces(compiled: CompiledMechanism, q: Any, v: Any = 0.0) -> Any:
    """h (n,) at rest, or with velocities."""
    system = compiled.system
    return system.residual(0.0, q, v + np.zeros(system.n), np.zeros(system.n))


def imposed(compiled: CompiledMechanism, at: Any, step: Any, q: Any) -> Any:
    """h at q with the stresses of strains that are linearized about another position, a correction from there."""
    stress = compiled.system.stress_extrapolation
    forces(compiled, at, step)
    stress.extrapolate()
    with stress.imposed():
        return forces(compiled, q)


@pytest.mark.parametrize("stretch", [False, True])
def test_extrapolated_stress_is_linear_in_the_correction(stretch: bool) -> None:
    """h + B^T K B dq: without a correction the forces themselves, symmetric in two corrections, positive, and from the
    natural shape the derivative of h, since there is no stress that turns with the elements.
    """
    compiled = CompiledMechanism(Sheet(nx=7, nz=5, gravity_y=0.0, stretch=stretch).build())
    system, random = compiled.system, np.random.default_rng(3)
    flat = compiled.assembly.start_positions()
    bent = flat.copy()
    system.apply(bent, 0.05 * system.size * random.uniform(-1.0, 1.0, system.n))
    before = forces(compiled, bent)
    assert np.abs(imposed(compiled, bent, np.zeros(system.n), bent) - before).max() <= 1e-12 * np.abs(before).max()
    x, y = (system.size * random.uniform(-1.0, 1.0, system.n) for _ in range(2))
    by_x, by_y, by_both = (imposed(compiled, bent, step, bent) - before for step in (x, y, x + y))
    np.testing.assert_allclose(by_both, by_x + by_y, rtol=0.0, atol=1e-11 * np.abs(by_both).max())
    assert y @ by_x == pytest.approx(x @ by_y, rel=1e-10)
    assert x @ by_x > 0.0
    ahead, behind = flat.copy(), flat.copy()
    system.apply(ahead, 1e-6 * x)
    system.apply(behind, -1e-6 * x)
    derivative = (forces(compiled, ahead) - forces(compiled, behind)) / 2e-6
    stiff = imposed(compiled, flat, x, flat)
    np.testing.assert_allclose(stiff, derivative, rtol=0.0, atol=1e-5 * np.abs(derivative).max())


def test_extrapolated_stress_ends_with_its_context() -> None:
    """Also if that ends with an error."""
    compiled = CompiledMechanism(Sheet(nx=7, nz=5, stretch=True).build())
    system = compiled.system
    q = compiled.assembly.start_positions()
    system.apply(q, 0.05 * system.size)
    before = forces(compiled, q)
    forces(compiled, q, 0.1 * system.size)
    system.stress_extrapolation.extrapolate()
    found = []

    def interrupt() -> None:
        with system.stress_extrapolation.imposed():
            found.append(forces(compiled, q))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupt()
    assert np.abs(found[0] - before).max() > 1e-3 * np.abs(before).max()
    np.testing.assert_array_equal(forces(compiled, q), before)

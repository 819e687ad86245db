"""Bricard's loop: six equal rods, six hinges; of five constraints on five coordinates one is redundant everywhere."""

from __future__ import annotations

import numpy as np
import pytest

from mbfmu.mechanics import CompiledMechanism, Mechanism, Revolute, RevoluteCutJoint
from mbfmu.mechanics.arrays.rows import dependent_rows
from solvers import Options, stepper

G = 9.81
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, -1, 0], [1, -1, 1], [0, -1, 1], [0, 0, 1]], float)  # of the unit cube


def bricard() -> CompiledMechanism:
    """Five rods of 1 m and 1 kg on the ground, the sixth, along edges of a cube; every hinge normal to its two rods."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    rods = np.roll(CORNERS, -1, axis=0) - CORNERS
    body = m.ground
    for i in range(5):
        joint = Revolute(axis=tuple(np.cross(rods[i - 1], rods[i])), at=rods[i - 1] if i > 0 else (0.0, 0.0, 0.0))
        inertia = (np.eye(3) - np.outer(rods[i], rods[i])) / 12.0
        body = m.body(f"rod{i}", body, joint, mass=1.0, com=0.5 * rods[i], inertia=inertia)
    hinge = np.cross(rods[4], rods[5])
    frame = np.column_stack((rods[4], np.cross(hinge, rods[4]), hinge))
    cut = RevoluteCutJoint(at_a=rods[4], at_b=CORNERS[5], rotation_a=frame, rotation_b=frame)
    m.cut("hinge", cut, body, m.ground)
    m.output("energy", m.energy)
    return CompiledMechanism(m)


def test_the_redundant_row_is_reported() -> None:
    compiled = bricard()
    q, _ = compiled.assemble()
    assert (compiled.system.n, compiled.system.m) == (5, 5)
    assert len(dependent_rows(compiled.system, 0.0, q)) == 1
    (line,) = map(str, compiled.assembly.notes(0.0, q))
    assert line.startswith("loop 'hinge': 1 of its 5 constraints is redundant (")


@pytest.mark.parametrize(("solver", "bound"), [("ida", 1e-4), ("adams", 1e-6), ("hybrid", 1e-6), ("adams-lu", 1e-6)])
def test_it_swings_with_threefold_symmetry_and_keeps_its_energy(solver: str, bound: float) -> None:
    compiled = bricard()
    motion = stepper(solver, compiled.system, 0.0, *compiled.assemble(), Options(rtol=1e-8))
    samples = motion.sample(np.linspace(0.01, 10.0, 1000))
    assert motion.status.ok, motion.status.message
    assert np.ptp(samples.q[:, 0]) > 1.0  # it does swing
    for i in range(2, 5):
        np.testing.assert_allclose(samples.q[:, i], samples.q[:, i - 2], atol=1e-7)
    energy = np.zeros((len(samples.q), 1))
    compiled.observe_all(np.linspace(0.01, 10.0, 1000), *samples[:4], energy)
    np.testing.assert_allclose(energy, -3.0 * G, atol=bound)  # at rest on the cube

"""Undamped random mechanisms with closed loops keep their energy, the better the tighter the tolerance."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from random_mechanisms import random_inertia, random_joint

from mbfmu.mechanics import (
    CompiledMechanism,
    DistanceCutJoint,
    Mechanism,
    Revolute,
    RevoluteCutJoint,
    SphericalCutJoint,
)
from mbfmu.mechanics.joints import Floating, Joint, Spherical, Translational
from solvers import SOLVERS, Options

TREES: dict[str, list[type[Joint]]] = {
    "revolutes": [Revolute, Revolute, Revolute, Revolute, Revolute, Revolute],
    "ball joints": [Spherical, Spherical, Spherical],
    "floating": [Floating, Revolute, Spherical],
    "mixed": [Translational, Spherical, Revolute, Spherical],
}


def loop(seed: int, kinds: list[type[Joint]], cut: type) -> CompiledMechanism:
    """A chain from the ground whose end is tied to it, closed exactly at a random start position."""
    rng = np.random.default_rng(seed)
    joints = [random_joint(kind, rng, False) for kind in kinds]
    masses = [
        {"mass": rng.uniform(0.5, 2.0), "com": 0.3 * rng.normal(size=3), "inertia": random_inertia(rng)} for _ in kinds
    ]
    tree = CompiledMechanism(chain(joints, masses))
    q = tree.assembly.start_positions()
    tree.system.apply(q, 0.5 * rng.normal(size=tree.system.n))
    tree.energy(0.0, q, np.zeros(tree.system.n))  # places the bodies
    end = tree.data.state.bodies[-1]
    p = rng.normal(size=3)
    on_ground = end["r"] + end["A"] @ p
    offsets = np.cumsum([0] + [joint.nq for joint in joints])
    starts = [replace(j, start=q[a:b]) for j, a, b in zip(joints, offsets[:-1], offsets[1:], strict=True)]
    m = chain(starts, masses)
    options: dict[str, Any] = {"at_a": p, "at_b": on_ground}
    if cut is DistanceCutJoint:
        options |= {"at_b": on_ground + np.array([0.0, 0.0, 1.5]), "length": 1.5}
    if cut is RevoluteCutJoint:
        options |= {"rotation_a": np.array(end["A"]).T}
    m.cut("tie", cut(**options), m.bodies[-1], m.ground)
    return CompiledMechanism(m)


def chain(joints: list[Joint], masses: list[dict[str, Any]]) -> Mechanism:
    """Bodies one after the other under gravity."""
    m = Mechanism(gravity=(0.0, 0.0, -9.81))
    for i, (joint, mass) in enumerate(zip(joints, masses, strict=True)):
        m.body(f"b{i}", m.bodies[-1], joint, **mass)
    return m


def drift(compiled: CompiledMechanism, solver: str, rtol: float) -> float:
    """Largest change of the energy within half a second, J."""
    q, v = compiled.assemble()
    stepper = SOLVERS[solver](compiled.system, 0.0, q, v, Options(rtol=rtol))
    start, worst = compiled.energy(0.0, q, v), 0.0
    for t in np.linspace(0.05, 0.5, 10):
        status = stepper.advance(float(t))
        assert status.ok, status.message
        worst = max(worst, abs(compiled.energy(stepper.t, stepper.q, stepper.v) - start))
        assert max(compiled.residuals(stepper.t, stepper.q, stepper.v)) < 1e-8
    return worst


@pytest.mark.parametrize("cut", [DistanceCutJoint, SphericalCutJoint, RevoluteCutJoint])
@pytest.mark.parametrize("tree", TREES)
@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
def test_energy_drift_falls_with_the_tolerance(solver: str, tree: str, cut: type) -> None:
    compiled = loop(3, TREES[tree], cut)
    loose, tight = (
        drift(compiled, solver, 1e-5),
        drift(compiled, solver, 1e-10),
    )  # far apart: one drift may be small by luck
    assert tight < 1e-3 * loose
    assert tight < 1e-7

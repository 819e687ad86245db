"""Sheets do not pass through thin surfaces within a step."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism, Mechanism, Polynomial, Revolute
from mbfmu.mechanics.recursions.dynamics import longest_load_step, update_kinematics
from mbfmu.sheets import Guide, Sheet, add_contact, add_sheet
from solvers.compiled.tuple_pointer import unpin

from .random_mechanisms import random_rotation

RADIUS = 5e-3  # of guides, relative to the size


def add_strip(m: Mechanism, size: float, nodes: int = 9, **placement: Any) -> Sheet:
    """A free strip of paper, 0.3 times the size long."""
    length = 0.3 * size
    return add_sheet(
        m, "strip", length=length, width=0.3 * length, thickness=length / 300, youngs_modulus=4e9 * size, density=800.0,
        grid=(nodes, 3), tree="master", membrane=True, damping=5e-4, **placement,
    )  # fmt: skip


def falling(size: float) -> Mechanism:
    """A strip that falls on a guide from 0.3 times the size: it arrives at 2.4 m/s for a size of 1 m."""
    m = Mechanism(gravity=(0.0, -9.81 * size, 0.0))
    sheet = add_strip(m, size, at=(0.0, 0.3 * size, -0.045 * size))
    guide = Guide(start=(-0.1 * size, 0, 0), end=(0.4 * size, 0, 0), radius=RADIUS * size, width=0.5 * size)
    add_contact(m, "guide", sheet, guide)
    m.output("y", sheet.node(4, 1).position("y"))
    return m


def swept(size: float) -> Mechanism:
    """A strip at rest without gravity, and a paddle that arrives from below at 3 rad/s after 0.5 s."""
    m = Mechanism(gravity=(0.0, 0.0, 0.0))
    sheet = add_strip(m, size, at=(0.0, 0.0, -0.045 * size))
    axle = Revolute(at=(-0.1 * size, 0.0, 0.0), drive=Polynomial((-1.5, 3.0)))
    hub = m.body("hub", m.ground, axle, mass=1.0, inertia=(1.0, 1.0, 1.0))
    paddle = Guide(start=(0, 0, 0), end=(0.6 * size, 0, 0), radius=RADIUS * size, width=0.5 * size)
    add_contact(m, "paddle", sheet, paddle, body=hub)
    for way in "xy":
        m.output(way, sheet.node(4, 1).position(way))
    return m


@pytest.mark.parametrize("size", [1e-2, 1.0, 100.0])
@pytest.mark.parametrize("solver", ["esdirk", "ida"])
def test_a_falling_sheet_stays_above_a_thin_guide(solver: str, size: float) -> None:
    """The largest steps of a free fall are longer than the guide is thick: 50 ms, 60 mm at the size of 1 m."""
    found = mb.simulate(falling(size), 0.4, interval=0.02, solver=solver, tolerance=1e-3)
    assert not found.failure
    early = found.t < 0.2
    np.testing.assert_allclose(found["y"][early] / size, 0.3 - 4.905 * found.t[early] ** 2, atol=1e-3)
    assert found["y"].min() > 0.0


@pytest.mark.parametrize("size", [1e-2, 1.0, 100.0])
@pytest.mark.parametrize("solver", ["esdirk", "ida"])
def test_a_paddle_does_not_pass_a_sheet_at_rest(solver: str, size: float) -> None:
    """Nothing moves the sheet before, so that no error limits the step of the solver."""
    found = mb.simulate(swept(size), 0.8, interval=0.1, solver=solver, tolerance=1e-3)
    assert not found.failure
    x, y = found["x"] / size + 0.1, found["y"] / size
    paddle = 3.0 * found.t - 1.5
    ahead = y * np.cos(paddle) - x * np.sin(paddle)  # distance from the middle of the paddle
    assert ahead.min() > 0.0
    assert y[-1] > 0.1  # it was met


def largest_depth(m: Mechanism, compiled: Any, q: Any, v: Any, times: Any, depth: Any) -> float:
    """Largest depth of the nodes of a sheet in uniform motion from (q, v) on."""
    data, deepest = unpin(compiled.system.pinned_data), -np.inf
    body = compiled.data.state.bodies
    update_kinematics(0.0, q, v, data.arrays, data.state)
    nodes = [node.index for row in m.meshes[0].nodes for node in row]
    r, u = body["r"][nodes].copy(), body["Y"][nodes][:, :3].copy()
    for t in times:
        update_kinematics(t, q, v, data.arrays, data.state)
        deepest = max(deepest, depth(r + t * u, body))
    return deepest


def test_the_longest_step_keeps_points_before_the_middle_of_a_guide() -> None:
    """Uniform motions of a small sheet past a guide that turns, against the distance from its segment."""
    rng, used = np.random.default_rng(5), 0
    for _ in range(60):
        rate, radius = rng.normal() * 3.0, 10.0 ** rng.uniform(-3, -1)
        ends = rng.uniform(-0.3, 0.3, size=(2, 2))
        m = Mechanism(gravity=(0.0, 0.0, 0.0))
        sheet = add_sheet(
            m, "s", length=4e-3, width=4e-3, thickness=1e-4, youngs_modulus=4e9, density=800.0, grid=(2, 2),
            at=rng.uniform(-0.3, 0.3, size=3) * (1.0, 1.0, 0.1), rotation=random_rotation(rng), tree="master",
        )  # fmt: skip
        hub = m.body("hub", m.ground, Revolute(drive=Polynomial((0.0, rate))), mass=1.0, inertia=(1.0, 1.0, 1.0))
        guide = Guide(start=(*ends[0], 0.0), end=(*ends[1], 0.0), radius=radius, width=10.0)
        way, long = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0]), np.linalg.norm(ends[1] - ends[0])
        add_contact(m, "guide", sheet, guide, body=hub)

        def depth(r: Any, body: Any, way: Any = way, long: float = long, radius: float = radius, ends: Any = ends,
                  hub: Any = hub) -> float:  # fmt: skip
            own = r @ body["A"][hub.index]
            along = np.clip((own[:, :2] - ends[0]) @ way, 0.0, long)
            away = np.linalg.norm(own[:, :2] - ends[0] - np.outer(along, way), axis=1)
            return float((radius - away).max())

        compiled = CompiledMechanism(m)
        q, _ = compiled.assemble()
        v = rng.normal(size=compiled.system.n)
        data = compiled.system.pinned_data
        update_kinematics(0.0, q, v, unpin(data).arrays, unpin(data).state)
        if depth(compiled.data.state.bodies["r"][[n.index for row in m.meshes[0].nodes for n in row]],
                 compiled.data.state.bodies) > -4e-3:  # fmt: skip
            continue
        longest = longest_load_step(np.inf, data)
        used += 1
        if np.isfinite(longest):
            assert largest_depth(m, compiled, q, v, np.linspace(0.0, longest, 400), depth) <= 0.5 * radius
    assert used > 30

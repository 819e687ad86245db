"""Contact evaluates cells that may touch, and no others: forces are those of all cells, in every state."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mbfmu.mechanics import CompiledMechanism, Mechanism, Polynomial, Revolute
from mbfmu.mechanics.records import Data, MotionRecord
from mbfmu.mechanics.recursions.dynamics import update_kinematics
from mbfmu.sheets import Drum, Guide, Trough, Wall, add_contact, add_nip, add_sheet
from mbfmu.sheets.contact.nip import NipRecord
from mbfmu.sheets.contact.patch import evaluate_ruled_weights, interpolate_point
from mbfmu.sheets.contact.stations import bound_cell, edge_margins
from solvers.compiled.tuple_pointer import pin

SIZES = [1e-3, 1.0, 1e3]


def surrounded(size: float) -> CompiledMechanism:
    """A sheet among surfaces of every kind, one of them on a moving body, and in a nip; lengths in ``size``."""
    m = Mechanism()
    sheet = add_sheet(
        m, "s", length=0.3 * size, width=0.2 * size, thickness=1e-3 * size, youngs_modulus=1e6, density=100.0,
        grid=(6, 5), tree="master", membrane=True,
    )  # fmt: skip
    flywheel = m.body("flywheel", m.ground, Revolute(at=(0.1 * size, -0.3 * size, 0.0)), mass=1.0, inertia=(1, 1, 1))
    axle = Revolute(at=(0.2 * size, -0.01 * size, 0.1 * size), drive=Polynomial((0.0, -1.0)))
    roller = m.body("roller", m.ground, axle, mass=0.1, inertia=(1e-5, 1e-5, 1e-5))
    law: dict[str, Any] = {"depth": 1e-3 * size, "friction": 0.3}
    wall = Wall(at=(0.0, -0.03 * size, 0.0))
    add_contact(m, "wall", sheet, wall, **law)
    guide = Guide(
        start=(0.05 * size, 0.03 * size, 0.1 * size), end=(0.12 * size, 0.05 * size, 0.1 * size), radius=0.01 * size,
        width=size,
    )  # fmt: skip
    add_contact(m, "guide", sheet, guide, **law)
    trough = Trough(
        radius=0.2 * size, length=size, angle=2.0, towards=(1.0, 0.0, 0.0), at=(0.15 * size, 0.0, 0.1 * size)
    )
    add_contact(m, "trough", sheet, trough, **law)
    add_contact(m, "drum", sheet, Drum(radius=0.25 * size, length=size, at=(0.0, 0.0, 0.0)), body=flywheel, **law)
    at = (0.2 * size, 0.0, 0.1 * size)
    add_nip(m, "nip", sheet, roller, radius=0.01 * size, at=at, width=0.05 * size, force=2.0)
    return CompiledMechanism(m)


def forces(data: Data, q: Any, v: Any) -> Any:
    """Applied wrenches on all bodies (nb, 6), and the power of loads, last."""
    update_kinematics(0.0, q, v, pin(data.arrays), pin(data.state))
    return np.append(data.state.bodies["F"], data.state.cached_power)


@pytest.mark.parametrize("size", SIZES)
def test_forces_and_products_are_those_of_all_loads(size: float) -> None:
    """To the last bit, on a walk in small steps that bends the sheet strongly. The list of a search serves many of
    them, and that of an evaluation other velocities and imaginary steps.
    """
    compiled, rng = surrounded(size), np.random.default_rng(3)
    data, system = compiled.data, compiled.system
    moved = system.complex_step().data
    state, world, q, way = data.state, data.arrays.world, compiled.assembly.start_positions(), np.zeros(system.n)
    assert world["has_clearances"][0] == 1
    repeated, kept, few = 0, 0, 0
    for k in range(400):
        if k % 20 == 0:
            way = rng.normal(size=system.n)
        system.apply(q, 0.004 * way * system.size)
        v, w, dq = rng.normal(size=(3, system.n)) * system.size
        stepped = q.astype(complex)
        stepped.imag = 1e-20 * dq[: len(q)] if len(q) == system.n else 0.0
        calls = (data, q, v), (data, q, w), (moved, stepped, v + 1e-20j * w)
        before = state.searched["r"].copy()
        found = [forces(*call) for call in calls]
        is_new = k == 0 or bool(np.any(before != state.searched["r"]))
        repeated += is_new
        kept += not is_new and state.search["active"][0] < len(state.active)
        few += 0 < state.search["acting"][0] < state.search["active"][0]
        world["has_clearances"] = 0
        for call, own in zip(calls, found, strict=True):
            np.testing.assert_array_equal(own, forces(*call))
        world["has_clearances"] = 1
    assert repeated > 3
    assert min(kept, few) > 100


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("way", [0, 1])
def test_a_cell_in_a_nip_is_within_its_bounds(way: int, size: float) -> None:
    """However it is bent, and with what continues it at an edge. Of a flat one the bounds are exact."""
    rng, a, b = np.random.default_rng(6), 0.02 * size, 0.03 * size
    corners = np.array([(0.0, 0.0, 0.0), (a, 0.0, 0.0), (a, 0.0, b), (0.0, 0.0, b)])
    nip, bodies = NipRecord.zeros(1), MotionRecord.zeros(4)
    nip["node"], nip["a"], nip["b"], nip["way"], nip["entry"] = range(4), a, b, way, 0.01 * size
    c, cx, cz = np.zeros((3, 4, 3))
    for turn in (0.0, 0.3, 1.0, 3.0):
        for _ in range(20):
            nip["ends"], nip["place"] = rng.integers(0, 2, (1, 2, 2)), 0.05 * size * rng.normal(size=3)
            bodies["r"] = corners + 0.01 * size * turn * rng.uniform(-1.0, 1.0, (4, 3))
            bodies["A"] = Rotation.from_rotvec(turn * rng.uniform(-1.0, 1.0, (4, 3))).as_matrix()
            direction, r, found = rng.normal(size=3), np.zeros(3), []
            direction /= np.linalg.norm(direction)
            before, after, left, right = edge_margins(nip[0])
            for u in np.linspace(-before, 1.0 + after, 31):
                for w in (-left, 1.0 + right):  # straight between these
                    xi, zeta = (u, w) if way == 0 else (w, u)
                    evaluate_ruled_weights(nip[0], way, xi, zeta, c, cx, cz)
                    interpolate_point(nip[0], c, bodies, r)
                    found.append((r - nip["place"][0]) @ direction)
            low, high = bound_cell(nip[0], direction, bodies)
            assert low <= min(found) + 1e-13 * size
            assert high >= max(found) - 1e-13 * size
            if turn == 0.0:
                np.testing.assert_allclose((low, high), (min(found), max(found)), atol=1e-13 * size)

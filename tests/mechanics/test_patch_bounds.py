"""Bounds of a cell's patch, by which contact leaves out cells that are separated."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mbfmu.mechanics.records import MotionRecord
from mbfmu.sheets.contact.patch import evaluate_center, evaluate_line, evaluate_on_line, hull_radius, sagitta
from mbfmu.sheets.contact.surface_force import SurfaceContactRecord


def cell_of(positions: Any, turns: Any, sides: tuple[float, float]) -> tuple[Any, Any]:
    """A cell whose nodes are at these positions (4, 3) with rotation vectors (4, 3), and its bodies."""
    cell, bodies = SurfaceContactRecord.zeros(1), MotionRecord.zeros(4)
    cell["node"], cell["a"], cell["b"] = range(4), *sides
    bodies["r"], bodies["A"] = positions, Rotation.from_rotvec(turns).as_matrix()
    return cell[0], bodies


def sampled(cell: Any, bodies: Any) -> Any:
    """Points of the patch (k, 3), corners among them."""
    line, r, found = np.zeros((4, 3)), np.zeros(3), []
    for xi in np.linspace(0.0, 1.0, 21):
        evaluate_line(cell, xi, bodies, line)
        for zeta in np.linspace(0.0, 1.0, 21):
            evaluate_on_line(line, zeta, r)
            found.append(r.copy())
    return np.array(found)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("turn", [0.0, 0.3, 1.0, 3.0])
def test_a_patch_is_within_its_bounds(turn: float, size: float) -> None:
    """However it is bent: each node turned and moved at random. Of a flat one the bounds are exact."""
    random, sides = np.random.default_rng(5), (0.02 * size, 0.03 * size)
    flat = size * np.array([(0.0, 0.0, 0.0), (0.02, 0.0, 0.0), (0.02, 0.0, 0.03), (0.0, 0.0, 0.03)])
    for _ in range(20):
        turns, shifts = (random.uniform(-1.0, 1.0, (4, 3)) for _ in range(2))
        cell, bodies = cell_of(flat + 0.01 * size * turn * shifts, turn * turns, sides)
        center, n = np.zeros(3), random.normal(size=3)
        evaluate_center(cell, bodies, center)
        n /= np.linalg.norm(n)
        points = sampled(cell, bodies) - center
        farthest, deepest = np.linalg.norm(points, axis=1).max(), (-points @ n).max()
        radius, depth = hull_radius(cell, bodies, center), sagitta(cell, bodies, center, n)
        assert farthest <= radius * (1.0 + 1e-14)
        assert deepest <= depth + 1e-14 * radius
        if turn == 0.0:
            assert (farthest, deepest) == pytest.approx((radius, depth), rel=1e-12)

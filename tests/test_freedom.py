"""Text of a motion: rigid ones by axis, point and pitch, others by the coordinates that move most."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fmus.sheet import Sheet
from mbfmu.mechanics import CompiledMechanism
from mbfmu.steady.rigid_body_modes import describe_motions


@pytest.fixture(scope="module")
def compiled() -> CompiledMechanism:
    """A free sheet; its master node 3, 2 lies at x = 0.15, z = 0.105 m, its coordinates come first."""
    return CompiledMechanism(Sheet(nx=7, nz=5, support="free", gravity_y=0.0).build())


def described(compiled: CompiledMechanism, *twists: Any) -> str:
    """The motions of the master node alone, (velocity, angular velocity) each."""
    motions = np.zeros((compiled.system.n, len(twists)))
    motions[:6] = np.transpose(twists)
    return describe_motions(compiled, compiled.assembly.start_positions(), motions)


@pytest.mark.parametrize(
    ("twists", "words"),
    [
        ([(0, 2, 0, 0, 0, 0)], "translation along y"),
        ([(3, 0, 4, 0, 0, 0)], "translation along (0.6, 0, 0.8)"),
        ([(1, 1, 0, 0, 0, 0), (1, -1, 0, 0, 0, 0)], "translation along x; translation along y"),
        ([(0, 0, 0, 0, 5, 0)], "rotation about y through (0.15, 0, 0.105) m"),
        ([(0, 0.3, 0, 0, 0, 2)], "rotation about z through (0, 0, 0.105) m"),
        ([(0, 0.5, 0, 0, 2, 0)], "rotation about y through (0.15, 0, 0.105) m, with 0.25 m along it a radian"),
        ([(0, 2, 0, 0, 0, 1), (0, 1, 0, 0, 0, 0)], "translation along y; rotation about z through (0.15, 0, 0.105) m"),
    ],
)
def test_rigid_motions(compiled: CompiledMechanism, twists: Any, words: str) -> None:
    assert described(compiled, *twists) == words


def test_other_motions_are_reported_by_their_coordinates(compiled: CompiledMechanism) -> None:
    motion = np.zeros((compiled.system.n, 1))
    names = compiled.system.coordinate_names
    moving = [names.index(name) for name in ("sheet.0.0.alpha", "sheet.0.4.alpha", "sheet.1.1.theta_x")]
    motion[moving, 0] = 1.0, -2.0, 0.5
    assert describe_motions(compiled, compiled.assembly.start_positions(), motion) == (
        "a motion that is largest in 'sheet.1.1.theta_x', 'sheet.0.0.alpha', 'sheet.0.4.alpha'"
    )

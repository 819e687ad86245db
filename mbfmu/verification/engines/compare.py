"""Comparison of mass matrices and accelerations with those of other engines."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from mbfmu.util.text_table import format_table
from mbfmu.verification.verdict import finite

from . import with_mbfmu, with_mujoco, with_pinocchio
from .random_trees import random_tree, start_of

ENGINES = {"mujoco": ("MuJoCo", with_mujoco), "pinocchio": ("Pinocchio", with_pinocchio)}  # by their packages
ROUNDING_FACTOR = 1e4  # allowed difference, in units of rounding errors and of the condition of the mass matrix


@dataclass(frozen=True)
class Difference:
    """Largest differences between mbfmu and an engine over random mechanisms.

    Attributes
    ----------
    engine
        Name of the engine.
    count
        Number of mechanisms.
    mass_matrix
        Largest difference of an entry, relative to the largest entry; None: it is not compared.
    acceleration
        Largest difference of an acceleration, relative to the largest one.
    worst
        Largest difference by the allowed one: rounding errors times the condition number of the mass matrix, and of the
        constraints.
    """

    engine: str
    count: int
    mass_matrix: float | None
    acceleration: float
    worst: float

    @property
    def is_right(self) -> bool:
        """Whether all differences are allowed; a number that is not finite is not."""
        return self.worst <= 1.0


def installed_engines() -> list[str]:
    """Return the packages of engines that are installed."""
    return [name for name in ENGINES if find_spec(name) is not None]


def compare_engines(count: int, progress: Callable[[str], None] | None = None) -> list[Difference]:
    """Compare random mechanisms with all engines that are installed.

    Parameters
    ----------
    count
        Number of mechanisms.
    progress
        Called with the title of an engine after each mechanism.
    """
    found = []
    for name in installed_engines():
        title, engine = ENGINES[name]
        largest = np.zeros(3)
        for seed in range(count):
            links, gravity = random_tree(seed)
            ours, theirs = with_mbfmu.evaluate(links, gravity), engine.evaluator(links, gravity)(*start_of(links))
            size = np.abs(ours.mass_matrix).max()
            mass = np.abs(theirs.mass_matrix - ours.mass_matrix).max() / size
            rates = np.abs(theirs.acceleration - ours.acceleration).max() / np.abs(ours.acceleration).max()
            rounding = ROUNDING_FACTOR * np.finfo(float).eps
            worst = max(mass / rounding, rates / (rounding * np.linalg.cond(ours.mass_matrix)))
            largest = np.maximum(largest, (mass, rates, worst))
            if progress is not None:
                progress(title)
        found.append(Difference(title, count, *map(float, largest)))
    return found


def as_text(found: Sequence[Difference]) -> str:
    """Return a table of the differences."""
    rows = [
        (
            d.engine,
            str(d.count),
            "-" if d.mass_matrix is None else f"{d.mass_matrix:.1e}",
            f"{d.acceleration:.1e}",
            "right" if d.is_right else f"WRONG: {d.worst:.2g} times the allowed difference",
        )
        for d in found
    ]
    return format_table(("engine", "mechanisms", "mass matrix", "accelerations", "verdict"), rows)


def as_dict(found: Sequence[Difference]) -> list[dict[str, Any]]:
    """Return the differences by engine; numbers that are not finite are None."""
    return [{name: finite(value) for name, value in asdict(difference).items()} for difference in found]

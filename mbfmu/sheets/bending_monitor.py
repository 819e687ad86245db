"""How far the cells of sheets bend in a run: too far for their grid is a warning, a folded cell ends it."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.mechanics import Plant
from mbfmu.mechanics.arrays.bending import MAX_ACCURATE_ANGLE, MAX_VALID_ANGLE, BendingAngles
from mbfmu.util.codes import coded
from solvers.system import Array

ADVICE = "Move it more slowly, damp it or make it stiffer; if the motion is intended, use a finer grid"
Sharpest = tuple[BendingAngles | None, float, Array]


class Folds:
    """Watches the plates of a plant; one without plates costs nothing.

    Attributes
    ----------
    sharpest
        How the plates were bent most so far, when (s), and at which positions (nq,).
    folded
        That a cell is folded at the positions looked at last, and what to do; empty: none is.
    """

    def __init__(self, plant: Plant, t: float, q: Array) -> None:
        self._plant, self.folded = plant, ""
        self.sharpest: Sharpest = (plant.measure_bending(t, q), t, q)

    @property
    def coarse(self) -> str:
        """Where, when and how far cells have bent most, if too far for their grid; empty: they have not."""
        bend, t, _ = self.sharpest
        if bend is None or not bend.largest > MAX_ACCURATE_ANGLE:
            return ""
        return coded("coarse-mesh", f"the mesh is too coarse at t = {t:.9g} s: {bend}")

    def look(self, t: float, q: Array) -> bool:
        """Note how sharply plates bend at positions q (nq,); False where a cell is folded."""
        here, (most, *_) = self._plant.measure_bending(t, q), self.sharpest
        if here is None or most is None:
            return True
        if here.largest > most.largest:
            self.sharpest = here, t, q
        self.folded = self._describe_fold(here, t) if here.largest > MAX_VALID_ANGLE else ""
        return not self.folded

    def _describe_fold(self, bend: BendingAngles, t: float) -> str:
        return coded("folded-cell", f"a cell is folded at t = {t:.9g} s: {bend}. {ADVICE}")

    def unfolded(self, times: Array, q: Array) -> int:
        """Return how many of the positions q (k, nq) at ``times`` come before the first with a folded cell."""
        if self.sharpest[0] is None:
            return len(q)
        return next((i for i in range(len(q)) if not self.look(float(times[i]), q[i])), len(q))

    def rewind(self, sharpest: Sharpest) -> None:
        """Forget what came after ``sharpest`` was the sharpest."""
        self.sharpest, self.folded = sharpest, ""

    def state(self) -> list[Any]:
        """Return time and positions of a bend that is worth a warning, for JSON; empty: there was none."""
        _, t, q = self.sharpest
        return [t, q.tolist()] if self.coarse else []

    def restore(self, state: list[Any], t: float, q: Array) -> None:
        """Take up a :meth:`state` at the positions q (nq,) of time t."""
        then, there = (state[0], np.array(state[1])) if state else (t, q)
        self.sharpest = self._plant.measure_bending(then, there), then, there
        self.look(t, q)

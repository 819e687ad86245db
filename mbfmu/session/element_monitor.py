"""How far elements are from the limits of their theory in a run: results past the first limit carry a warning, and
past the second, beyond which they mean nothing, the run ends.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.arrays.joint_locks import without_locks
from mbfmu.mechanics.loads.base import MAX_ACCURATE_RATIO, MAX_VALID_RATIO
from mbfmu.util.diagnostics import Diagnostic
from solvers.system import Array

Furthest = tuple[float, float, Array]


class ElementMonitor:
    """Watches the elements of a compiled mechanism; one whose elements have no limits costs nothing.

    Attributes
    ----------
    furthest
        Largest ratio so far, when (s), and at which positions (nq,), without locked joints.
    folded
        Error if an element is invalid at the positions looked at last; None: none is.
    """

    def __init__(self, compiled: CompiledMechanism, ratio: float, t: float, q: Array) -> None:
        self._compiled_mechanism = compiled
        self.folded: Diagnostic | None = None
        self.furthest: Furthest = ratio, t, q

    @property
    def coarse(self) -> Diagnostic | None:
        """Warning about where, when and how far elements have been beyond what is accurate; None: they have not."""
        ratio, t, q = self.furthest
        return Diagnostic.parse(self._describe(t, q), "warning", "coarse-mesh") if ratio > MAX_ACCURATE_RATIO else None

    def note(self, ratio: float, t: float, q: Array) -> None:
        """Note that elements are as far as ``ratio`` at positions q (nq,) without locked joints at time t, s."""
        if not ratio <= self.furthest[0]:
            self.furthest = ratio, t, q
        is_valid = ratio <= MAX_VALID_RATIO
        self.folded = None if is_valid else Diagnostic.parse(self._describe(t, q), "error", "folded-cell")

    def _describe(self, t: float, q: Array) -> str:
        with without_locks(self._compiled_mechanism):
            return self._compiled_mechanism.describe_limit(t, q, f" at t = {t:.9g} s")

    def note_samples(self, ratios: Array, times: Array, q: Array) -> None:
        """:meth:`note` k ratios (k,) at positions q (k, nq), the last of which may be invalid."""
        if not len(self._compiled_mechanism.monitored):
            return
        for ratio, t, there in zip(ratios.tolist(), times.tolist(), q, strict=True):
            self.note(ratio, t, there)

    def rewind(self, furthest: Furthest) -> None:
        """Forget what came after ``furthest``."""
        self.furthest, self.folded = furthest, None

    def state(self) -> list[Any]:
        """Return time and positions of what is worth a warning, for JSON; empty: there was none."""
        ratio, t, q = self.furthest
        return [t, q.tolist()] if ratio > MAX_ACCURATE_RATIO else []

    def restore(self, state: list[Any], t: float, q: Array) -> None:
        """Take up a :meth:`state` at the positions q (nq,) of time t."""
        then, there = (state[0], np.array(state[1])) if state else (t, q)
        with without_locks(self._compiled_mechanism):
            self.furthest = self._compiled_mechanism.limit_ratio(then, there), then, there
            self.note(self._compiled_mechanism.limit_ratio(t, q), t, q)

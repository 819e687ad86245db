"""Whether rolling wheels stay on their planes: their constraints are bilateral, but a real plane does not pull."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.cuts import RollingWheel
from mbfmu.util.diagnostics import Diagnostic
from solvers.system import Array

from .run_messages import LIFTING_WHEEL, filled

State = tuple[float, Array, Array]  # t (s), q (nq,), v (n,)


class WheelMonitor:
    """Watches the normal forces of the rolling wheels of a compiled mechanism; without wheels it costs nothing.

    Attributes
    ----------
    wheels
        Names of the wheels, by the numbers of their normal constraint equations.
    """

    def __init__(self, compiled: CompiledMechanism, tolerance: float) -> None:
        self._compiled, self._tolerance = compiled, tolerance
        rows = {name: k for k, name in enumerate(compiled.system.constraint_names)}
        names = [c.name for c in compiled.mechanism.cuts if isinstance(c.cut, RollingWheel)]
        self.wheels = {rows[f"{name}.normal"]: name for name in names if f"{name}.normal" in rows}

    def describe(self, states: Iterable[State]) -> list[Diagnostic]:
        """Return a warning about each wheel that the plane would have to pull in one of the states, the first one.

        A force counts if it exceeds the tolerance times the largest normal force.
        """
        found: dict[str, Diagnostic] = {}
        for t, q, v in states if self.wheels else ():
            if len(v) != self._compiled.system.n:  # joints are locked
                continue
            forces = -self._multipliers(t, q, v)[list(self.wheels)]
            least = -self._tolerance * float(np.abs(forces).max())
            for name, force in zip(self.wheels.values(), forces, strict=True):
                if force < least and name not in found:
                    found[name] = filled(LIFTING_WHEEL, time=t, subject=name, name=name, t=t, force=-float(force))
        return list(found.values())

    def _multipliers(self, t: float, q: Array, v: Array) -> Array:
        """Return the shortest multipliers (m,) of the motion at a state, in units of the rows."""
        system = self._compiled.system
        terms, m = system.allocate_terms(), system.m
        system.fill(t, q, v, terms)
        size, row = system.size, system.row_size
        M, J = terms.M * np.outer(size, size), terms.J * size / row[:, np.newaxis]
        scale = float(np.abs(M).max(initial=0.0)) or 1.0
        K = np.block([[M / scale, J.T], [J, np.zeros((m, m))]])
        right = np.concatenate((-terms.h * size / scale, terms.gamma / row))
        found: Array = np.linalg.lstsq(K, right, rcond=None)[0][system.n :] * scale / row
        return found

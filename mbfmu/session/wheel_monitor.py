"""Whether rolling wheels stay on their planes and do not slip: the constraints are bilateral and transmit any force."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import hypot
from typing import NamedTuple

import numpy as np

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.cuts import RollingWheel
from mbfmu.mechanics.cuts.rolling import GRIPS
from mbfmu.util.diagnostics import Diagnostic
from solvers.system import Array

from .run_messages import LIFTING_WHEEL, SLIPPING_WHEEL, filled

State = tuple[float, Array, Array]  # t (s), q (nq,), v (n,)


class WatchedWheel(NamedTuple):
    """A rolling wheel whose forces are compared.

    Attributes
    ----------
    name
        Name of the cut joint.
    number
        Number among the cut joints.
    normal
        Number of its normal constraint equation.
    tangential
        Numbers of its longitudinal and its lateral constraint equation; -1: it has none.
    """

    name: str
    number: int
    normal: int
    tangential: tuple[int, int]


def watched_wheels(compiled: CompiledMechanism) -> list[WatchedWheel]:
    """Return the rolling wheels of a compiled mechanism."""
    rows = {name: k for k, name in enumerate(compiled.system.constraint_names)}
    return [
        WatchedWheel(c.name, c.index, rows[f"{c.name}.normal"], (first, second))
        for c in compiled.mechanism.cuts
        if isinstance(c.cut, RollingWheel) and f"{c.name}.normal" in rows
        for first, second in [[rows.get(f"{c.name}.{direction}", -1) for direction in GRIPS["both"]]]
    ]


class WheelMonitor:
    """Watches the forces of the rolling wheels of a compiled mechanism; without wheels it costs nothing.

    Attributes
    ----------
    wheels
        The wheels.
    """

    def __init__(self, compiled: CompiledMechanism, tolerance: float) -> None:
        self._compiled, self._tolerance = compiled, tolerance
        self.wheels = watched_wheels(compiled)
        numbers = [c.index for c in compiled.mechanism.cuts if isinstance(c.cut, RollingWheel)]
        self._records = dict(zip(numbers, compiled.records(RollingWheel) if self.wheels else (), strict=False))

    def describe(self, states: Iterable[State]) -> list[Diagnostic]:
        """Return a warning about each wheel that the plane would have to pull in one of the states, or that would slip
        in one: about the first one.

        A difference of forces counts if it exceeds the tolerance times the largest normal force.
        """
        found: dict[tuple[str, str], Diagnostic] = {}
        for t, q, v in states if self.wheels else ():
            if len(v) != self._compiled.system.n:  # joints are locked
                continue
            for own in self._compare(t, -self._multipliers(t, q, v)):
                found.setdefault((own.code, own.subject), own)
        return list(found.values())

    def _compare(self, t: float, forces: Array) -> Iterator[Diagnostic]:
        """Yield warnings of wheels that would lift or slip by the forces (m,) along the constraint equations."""
        error = self._tolerance * float(np.abs(forces[[wheel.normal for wheel in self.wheels]]).max())
        for wheel in self.wheels:
            name, normal, record = wheel.name, float(forces[wheel.normal]), self._records[wheel.number]
            if normal < -error:
                yield filled(LIFTING_WHEEL, time=t, subject=name, name=name, t=t, force=-normal)
                continue
            friction = [float(forces[row]) if row >= 0 else 0.0 for row in wheel.tangential]
            limits = [float(record[f"{direction}_friction"]) for direction in GRIPS["both"]]
            if 0.0 in limits:
                continue
            needed = hypot(*(force / mu for force, mu in zip(friction, limits, strict=True)))
            if needed > normal + error:  # else the force is within the ellipse of friction
                force, carried = hypot(*friction), max(normal, 0.0)
                numbers = {"t": t, "force": force, "limit": force * carried / needed, "normal": carried}
                yield filled(SLIPPING_WHEEL, time=t, subject=name, name=name, **numbers)

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

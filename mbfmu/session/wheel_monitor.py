"""Whether rolling wheels stay on their surfaces and do not slip: the constraints are bilateral and transmit any force.
On a profile a wheel may touch a second place, or leave the interval of the profile.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import hypot
from typing import Any, NamedTuple

import numpy as np

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.cuts import RollingWheel
from mbfmu.mechanics.cuts.profile import Profile
from mbfmu.mechanics.cuts.rolling import GRIPS
from mbfmu.mechanics.kind import record_of
from mbfmu.util.diagnostics import Diagnostic
from solvers.system import Array

from .kernels.profile_contacts import locate_contact
from .run_messages import LIFTING_WHEEL, PROFILE_END, SECOND_CONTACT, SLIPPING_WHEEL, TIGHT_TROUGH, filled

PLACE_ROUNDING = 1e-13  # error of the place where a wheel touches its profile due to rounding, relative to its x
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
    surface
        Profile that it rolls on; None: a plane.
    """

    name: str
    number: int
    normal: int
    tangential: tuple[int, int]
    surface: Profile | None


def watched_wheels(compiled: CompiledMechanism) -> list[WatchedWheel]:
    """Return the rolling wheels of a compiled mechanism."""
    rows = {name: k for k, name in enumerate(compiled.system.constraint_names)}
    return [
        WatchedWheel(c.name, c.index, rows[f"{c.name}.normal"], (first, second), c.cut.surface)
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
        self._records = {wheel.number: self._record(wheel) for wheel in self.wheels}

    def _record(self, wheel: WatchedWheel) -> Any:
        """Return the record of a wheel, as it lies in the memory of the mechanism."""
        arrays = self._compiled.data.arrays
        dtype = record_of(self._compiled.mechanism.cuts[wheel.number].cut)
        at = int(arrays.cuts["at"][wheel.number])
        return arrays.memory[at : at + dtype.itemsize].view(dtype)[0]

    def describe(self, states: Iterable[State]) -> list[Diagnostic]:
        """Return a warning about each wheel that its surface would have to pull in one of the states, or that would
        slip, touch its profile at a second place or leave it in one: about the first one.

        A difference of forces counts if it exceeds the tolerance times the largest normal force.
        """
        found: dict[tuple[str, str], Diagnostic] = {}
        for t, q, v in states if self.wheels else ():
            if len(v) != self._compiled.system.n:  # joints are locked
                continue
            forces = -self._multipliers(t, q, v)  # bodies are then where they are at the state
            for own in (*self._compare(t, forces), *self._locate(t)):
                found.setdefault((own.code, own.subject), own)
        return list(found.values())

    def explain_failure(self, t: float) -> list[Diagnostic]:
        """Return a warning about each wheel whose outline, where it is inclined at the end of a run, t, does not fit
        into a trough of its profile within one diameter.
        """
        found, place = [], np.zeros(3)
        for wheel in self.wheels:
            if wheel.surface is None:
                continue
            locate_contact(wheel.number, self._compiled.kernel_data, place)
            own, record, axes = self._compiled.data.arrays.cuts[wheel.number], self._records[wheel.number], self._axes
            near = float(place[0]), 2.0 * float(record["radius"] + record["crown"])
            x, curvature, outline = wheel.surface.tightest(record, axes[int(own["a"])], axes[int(own["b"])], *near)
            if curvature * outline >= 1.0:
                values = {"t": t, "x": float(place[0]), "trough": x, "radius": 1.0 / curvature, "outline": outline}
                found.append(filled(TIGHT_TROUGH, time=t, subject=wheel.name, name=wheel.name, **values))
        return found

    @property
    def _axes(self) -> Any:
        return self._compiled.data.state.bodies["A"]

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

    def _locate(self, t: float) -> Iterator[Diagnostic]:
        """Yield warnings of wheels that touch their profiles at two places or beyond an end, as the bodies are."""
        compiled, place = self._compiled, np.zeros(3)
        for wheel in self.wheels:
            if wheel.surface is None:
                continue
            locate_contact(wheel.number, compiled.kernel_data, place)
            (x, second, depth), record = place.tolist(), self._records[wheel.number]
            radius, name = float(record["radius"] + record["crown"]), wheel.name
            distance = abs(float(compiled.data.state.rows["Phi"][compiled.data.arrays.cuts["row"][wheel.number]]))
            error = self._tolerance * radius + PLACE_ROUNDING * abs(x)
            if depth > distance + error:
                yield filled(SECOND_CONTACT, time=t, subject=name, name=name, t=t, second=second, depth=depth, x=x)
            low, high = float(record["lower"]), float(record["upper"])
            if not low - error <= x <= high + error:
                yield filled(PROFILE_END, time=t, subject=name, name=name, t=t, x=x, low=low, high=high)

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

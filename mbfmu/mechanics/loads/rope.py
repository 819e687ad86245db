"""Elastic rope over points of any number of bodies, without friction: one tension T along the whole path.

With the points p_0 ... p_n the length of the path is L = sum |p_i+1 - p_i|. Beyond the unloaded length the rope is a
stop of L, see :mod:`.stops`: T = k x (1 + c x'), x = L - L_0; it does not push. The virtual work -T dL gives T times
the sum of the unit vectors to the two neighbors at every point.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import not_negative, positive
from mbfmu.mechanics.spatial import add_force, point_offset, point_offset_rate
from solvers.compiled.kernel import kernel
from solvers.compiled.record import i8

from .base import Load, Points
from .stops import LimitRecord, dissipated_power, stop_energy, stop_force

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State

POINT_SIZE = 4  # numbers of a point: its body, and its place on it


class RopeRecord(LimitRecord):
    """Parameters of :class:`Rope`."""

    first: i8  # of the numbers of its points in Arrays.numbers: number of the body and place (3,), body axes, m
    count: i8  # of points


@kernel
def segment(rope: RopeRecord, k: int, arrays: Arrays, state: State) -> Any:
    """Two bodies, unit vector from point k to the next one, arms of both, length and its rate; points that coincide
    have the direction zero.
    """
    at, numbers = rope.first + POINT_SIZE * k, arrays.numbers
    to = at + POINT_SIZE
    i, j = int(numbers[at].real), int(numbers[to].real)
    A, B, Pa, Pb = state.bodies[i], state.bodies[j], numbers[at + 1 : to], numbers[to + 1 : to + POINT_SIZE]
    (x, y, z), (ax, ay, az), b = point_offset(A, B, Pa, Pb)
    u, v, w = point_offset_rate(A, B, Pa, Pb)
    length = np.sqrt(x * x + y * y + z * z)
    a, inverse = (ax - x, ay - y, az - z), 1.0 / length if length.real > 0.0 else 0.0 * length
    return i, j, (inverse * x, inverse * y, inverse * z), a, b, length, inverse * (x * u + y * v + z * w)


@kernel
def path_length(rope: RopeRecord, arrays: Arrays, state: State) -> tuple[float, float]:
    """Length of the path and its rate."""
    _, _, _, _, _, length, rate = segment(rope, 0, arrays, state)
    for k in range(1, rope.count - 1):
        _, _, _, _, _, more, faster = segment(rope, k, arrays, state)
        length, rate = length + more, rate + faster
    return length, rate


@kernel
def rope_tension(rope: RopeRecord, arrays: Arrays, state: State) -> float:
    """T, N."""
    length, rate = path_length(rope, arrays, state)
    return -stop_force(rope, length, rate)


@kernel
def apply(rope: RopeRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    f = rope_tension(rope, arrays, state)
    if f.real > 0.0:
        for k in range(rope.count - 1):
            i, j, (x, y, z), (ax, ay, az), (bx, by, bz), _, _ = segment(rope, k, arrays, state)
            add_force(state.bodies[i].F, ax, ay, az, f * x, f * y, f * z)
            add_force(state.bodies[j].F, bx, by, bz, -f * x, -f * y, -f * z)


@kernel
def potential(rope: RopeRecord, arrays: Arrays, state: State) -> float:
    """k x^2 / 2."""
    length, _ = path_length(rope, arrays, state)
    return stop_energy(rope, length)


@kernel
def power(rope: RopeRecord, t: float, arrays: Arrays, state: State) -> float:
    """-(T - k x) x'."""
    length, rate = path_length(rope, arrays, state)
    return dissipated_power(rope, length, rate)


@dataclass(frozen=True, kw_only=True)
class Rope(Load):
    """Elastic rope over points of bodies; created by :meth:`.Mechanism.rope`.

    Parameters
    ----------
    path
        Points in their order along the rope: pairs of the number of a body among those the load is given, from 0, and
        a point in the frame of this body (3,), m.
    length
        Unloaded length, m.
    stiffness
        Stiffness of the whole rope, N/m: axial stiffness E A divided by the unloaded length.
    damping
        Damping c (Hunt and Crossley), s/m; see :class:`.JointStop`.
    """

    record = RopeRecord
    apply = apply
    potential = potential
    power = power

    path: tuple[tuple[int, Any], ...]
    length: float
    stiffness: float
    damping: float = 0.0

    def check(self, what: str) -> None:
        """Refuse what is no length, stiffness or damping."""
        positive(f"length of {what}", self.length)
        positive(f"stiffness of {what}", self.stiffness)
        not_negative(f"damping of {what}", self.damping)

    def fill(self, record: Any, site: Attachment) -> None:
        """Write its points and how it pulls."""
        record["lower"], record["upper"] = -np.inf, self.length
        record["stiffness"], record["damping"] = self.stiffness, self.damping
        points = [(float(site.bodies[k]), *np.asarray(point, float)) for k, point in self.path]
        record["first"], record["count"] = site.numbers(points), len(points)

    @property
    def is_nonconservative(self) -> bool:
        """Whether it is damped."""
        return bool(self.damping)

    def points(self) -> Points:
        """Return the outermost of its points on every body."""
        outermost = dict(sorted(self.path, key=lambda own: float(np.linalg.norm(own[1]))))
        return tuple(outermost[k] for k in sorted(outermost))

    def extent(self) -> float:
        """Return its unloaded length."""
        return self.length

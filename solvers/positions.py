"""Layout of positions and velocities, and the map q' = N(q) v between slopes and velocities.

Velocities are those of coordinates and, after them, first-order states: quantities z with z' = g(t, q, v, z), which
have no position. An orientation may be a unit quaternion, four positions for three velocities. So the numbers of
positions and velocities may be equal although they do not correspond, see :func:`has_quaternions`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import inlined, kernel

if TYPE_CHECKING:
    from solvers.compiled.record import Integers, Reals


class Positions(NamedTuple):
    """Layout of positions and velocities in q and v."""

    in_q: NDArray[np.int64]  # (k,) places of positions that are no quaternions, in q and in v
    in_v: NDArray[np.int64]
    turning: NDArray[np.int64]  # (k, 2) first place of each quaternion in q, of its angular velocity in v
    states: NDArray[np.int64]  # (k,) places of first-order states in v: the last ones


@inlined
def has_quaternions(nq: int, n: int, states: Integers) -> bool:
    """Whether some of ``nq`` positions are quaternions, with ``n`` velocities; ``states`` (k,) are first-order states.

    Otherwise q' are the first ``nq`` velocities.
    """
    return nq + states.shape[0] != n


def place_states(n: int, count: int) -> NDArray[np.int64]:
    """Return the places (count,) of first-order states among ``n`` velocities."""
    return np.arange(n - count, n)


@inlined
def quaternion_slope(q: Reals, i: int, v: Reals, j: int, out: Reals) -> None:
    """out[i:] <- e o (0, w) / 2 of the quaternion e = q[i:] and the angular velocity w = v[j:], body axes."""
    w, x, y, z = q[i], q[i + 1], q[i + 2], q[i + 3]
    a, b, c = 0.5 * v[j], 0.5 * v[j + 1], 0.5 * v[j + 2]
    out[i] = -x * a - y * b - z * c
    out[i + 1] = w * a - z * b + y * c
    out[i + 2] = z * a + w * b - x * c
    out[i + 3] = -y * a + x * b + w * c


@inlined
def angular_velocity(q: Reals, i: int, slope: Reals, scale: float, v: Reals, j: int) -> None:
    """v[j:] <- scale times the w of :func:`quaternion_slope`, q[i:] of unit length."""
    w, x, y, z = q[i], q[i + 1], q[i + 2], q[i + 3]
    a, b, c, d = slope[i], slope[i + 1], slope[i + 2], slope[i + 3]
    v[j] = 2.0 * scale * (-x * a + w * b + z * c - y * d)
    v[j + 1] = 2.0 * scale * (-y * a - z * b + w * c + x * d)
    v[j + 2] = 2.0 * scale * (-z * a + y * b - x * c + w * d)


@kernel
def as_motion(q: Reals, slope: Reals, layout: Positions, v: Reals) -> None:
    """v (n,) with N v = slope, as far as there is one."""
    for k in range(layout.in_q.shape[0]):
        v[layout.in_v[k]] = slope[layout.in_q[k]]
    for k in range(layout.turning.shape[0]):
        angular_velocity(q, layout.turning[k, 0], slope, 1.0, v, layout.turning[k, 1])


@kernel
def as_slope(q: Reals, v: Reals, layout: Positions, slope: Reals) -> None:
    """slope (nq,) = N v."""
    for k in range(layout.in_q.shape[0]):
        slope[layout.in_q[k]] = v[layout.in_v[k]]
    for k in range(layout.turning.shape[0]):
        quaternion_slope(q, layout.turning[k, 0], v, layout.turning[k, 1], slope)


@kernel
def set_coordinate_rates(layout: Positions, rate: float, out: Reals) -> None:
    """out (n,) <- the rate of the coordinates, 1/s, and 1 of first-order states: the absolute tolerances of these are
    those of their nominal values.
    """
    for k in range(out.shape[0]):
        out[k] = rate
    for k in range(layout.states.shape[0]):
        out[layout.states[k]] = 1.0


@inlined
def count_velocities(layout: Positions, n: int) -> int:
    """Number of the ``n`` velocities that are not first-order states: the first ones."""
    return n - layout.states.shape[0]


@kernel
def position_sizes(layout: Positions, sizes: Reals, out: Reals) -> None:
    """out (nq,) = sizes of positions, from those of motions (n,)."""
    for k in range(layout.in_q.shape[0]):
        out[layout.in_q[k]] = sizes[layout.in_v[k]]
    for k in range(layout.turning.shape[0]):
        i, j = layout.turning[k, 0], layout.turning[k, 1]
        for part in range(4):
            out[i + part] = 0.5 * min(sizes[j], sizes[j + 1], sizes[j + 2])

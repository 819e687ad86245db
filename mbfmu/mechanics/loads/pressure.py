"""Pressure on the surface between four bodies, along its normal wherever that turns (a follower load).

The corners r1 (0, 0), r2 (a, 0), r3 (a, b), r4 (0, b) span the bilinear surface

    r = r_c + g1 x + g2 z + 4 t x z,    -1/2 <= x, z <= 1/2,
    g1 = ((r2 - r1) + (r3 - r4)) / 2,    g2 = ((r4 - r1) + (r3 - r2)) / 2,    t = (r1 - r2 + r3 - r4) / 4.

Its virtual work, p times the volume that the surface sweeps, gives the forces on the corners

    f_i = p Int N_i dA = p [(g2 x g1) / 4 + z_i (g2 x t) / 3 + x_i (t x g1) / 3],    x_i, z_i = -1/2, 1/2.

They add up to p times the vector area whatever the shape, and their moment is that of the pressure. No energy is
stored: the work depends on how the edges move.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from mbfmu.mechanics.dispatch import signal_value
from mbfmu.mechanics.kind import Attachment
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Integers, Record, i8

from .base import Load

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State
    from solvers.compiled.record import Reals, Table


class PressureRecord(Record):
    """Parameters of :class:`Pressure`."""

    node: Annotated[Integers, (4,)]
    signal: i8


@kernel
def corner_forces(
    load: PressureRecord, p: float, bodies: Table[MotionRecord], k: int
) -> tuple[float, float, float, float]:
    """Component k of f_1 ... f_4 for the pressure p, Pa; positive along the normal g2 x g1."""
    r1, r2, r3, r4 = bodies[load.node[0]].r, bodies[load.node[1]].r, bodies[load.node[2]].r, bodies[load.node[3]].r
    i, j = (k + 1) % 3, (k + 2) % 3
    # g1 = (u - v) / 2, g2 = (u + v) / 2 with the diagonals u = r3 - r1, v = r4 - r2
    ui, uj = r3[i] - r1[i], r3[j] - r1[j]
    vi, vj = r4[i] - r2[i], r4[j] - r2[j]
    ti, tj = 0.25 * (r1[i] - r2[i] + r3[i] - r4[i]), 0.25 * (r1[j] - r2[j] + r3[j] - r4[j])
    gi, gj, hi, hj = 0.5 * (ui - vi), 0.5 * (uj - vj), 0.5 * (ui + vi), 0.5 * (uj + vj)
    mean = 0.25 * p * (hi * gj - hj * gi)
    by_z = p * (hi * tj - hj * ti) / 6.0
    by_x = p * (ti * gj - tj * gi) / 6.0
    return mean - by_x - by_z, mean + by_x - by_z, mean + by_x + by_z, mean - by_x + by_z


@kernel
def apply(load: PressureRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    p, bodies = signal_value(load.signal, t, arrays), state.bodies
    for k in range(3):
        f1, f2, f3, f4 = corner_forces(load, p, bodies, k)
        bodies[load.node[0]].F[k] += f1
        bodies[load.node[1]].F[k] += f2
        bodies[load.node[2]].F[k] += f3
        bodies[load.node[3]].F[k] += f4


@kernel
def power(load: PressureRecord, t: float, arrays: Arrays, state: State) -> float:
    """p times the rate of the volume that the surface sweeps, W."""
    p, bodies = signal_value(load.signal, t, arrays), state.bodies
    n1, n2, n3, n4 = bodies[load.node[0]], bodies[load.node[1]], bodies[load.node[2]], bodies[load.node[3]]
    total = 0.0 * p
    for k in range(3):
        f1, f2, f3, f4 = corner_forces(load, p, bodies, k)
        total += f1 * n1.Y[k] + f2 * n2.Y[k] + f3 * n3.Y[k] + f4 * n4.Y[k]
    return total


@kernel
def tangent(load: PressureRecord, c1: float, arrays: Arrays, state: State, perturbed: State, K: Reals) -> float:
    """See :mod:`.base`."""
    p, bodies = signal_value(load.signal, state.time[0], arrays), state.bodies
    r1, r2, r3, r4 = bodies[load.node[0]].r, bodies[load.node[1]].r, bodies[load.node[2]].r, bodies[load.node[3]].r
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        g1i, g1j = 0.5 * (r2[i] - r1[i] + r3[i] - r4[i]), 0.5 * (r2[j] - r1[j] + r3[j] - r4[j])
        g2i, g2j = 0.5 * (r4[i] - r1[i] + r3[i] - r2[i]), 0.5 * (r4[j] - r1[j] + r3[j] - r2[j])
        ti, tj = 0.25 * (r1[i] - r2[i] + r3[i] - r4[i]), 0.25 * (r1[j] - r2[j] + r3[j] - r4[j])
        for c in range(4):  # the body that moves: its share of g1, g2, t
            x = 0.5 if 1 <= c <= 2 else -0.5
            z = 0.5 if c >= 2 else -0.5
            s = 0.25 if c % 2 == 0 else -0.25
            for row in range(4):
                by_x, by_z = (0.5 if 1 <= row <= 2 else -0.5) / 3.0, (0.5 if row >= 2 else -0.5) / 3.0
                # by r_i, then by r_j, of f_k = (g2_i g1_j - g2_j g1_i) / 4 + ...
                di = 0.25 * (z * g1j - x * g2j) + by_z * (z * tj - s * g2j) + by_x * (s * g1j - x * tj)
                dj = 0.25 * (x * g2i - z * g1i) + by_z * (s * g2i - z * ti) + by_x * (x * ti - s * g1i)
                K[6 * row + k, 6 * c + i] -= p * di
                K[6 * row + k, 6 * c + j] -= p * dj
    return 1.0


@dataclass(frozen=True, kw_only=True)
class Pressure(Load):
    """Pressure of ``magnitude`` (Pa: number, signal or input) along y of a flat face."""

    record = PressureRecord
    is_linear_in_signals = True
    apply = apply
    power = power
    tangent = tangent

    magnitude: Any

    def fill(self, record: Any, site: Attachment) -> None:
        """Write its corners, and the signal that all faces share."""
        record["node"], record["signal"] = site.bodies, site.signal(self.magnitude, f"magnitude of {site.name}")

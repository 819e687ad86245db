"""Touch: a cell of a sheet against a rigid surface, by points that are fixed in the cell.

A point stands for its share w of the area. Where it is deeper than the surface by d, the pressure of Hunt and Crossley
(1975) on a law without a corner, and Coulomb's friction, regularized at the slip v_r:

    N = w k phi(d) max(0, 1 - chi v_n),    phi = d^2 / (2 d0) up to d0, d - d0 / 2 beyond,
    f = N n - mu N v_t / sqrt(v_t^2 + v_r^2),

v the velocity relative to the surface, v_n > 0 where it leaves. An impact so loses (4/3) chi v of its energy to first
order, whatever phi is. Points lie on edges of the sheet too, with half their share: an edge that no point is on would
pass through a wall.

``told`` of State.meeting: the force on the sheet (0..2), N; stored energy (3), J; power of what is not stored (4), W;
depth of the deepest point (5), m.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mbfmu.mechanics.dispatch import surface_gap
from mbfmu.mechanics.kind import Site
from mbfmu.mechanics.loads.base import Load
from solvers.compiled.kernel import kernel

from .patch import drift, locate, middle, press, reach, react, weigh
from .surfaces import Surface

TOUCH = np.dtype(
    [
        ("body", np.int64),  # that the surface is fixed to
        ("surface", np.int64),  # its number
        ("samples", np.int64, (2,)),  # along x and z of the cell
        ("ends", np.int64, (2, 2)),  # along x, along z: 1 where the cell begins, where it ends on an edge of the sheet
        ("node", np.int64, (4,)),
        ("a", np.float64),  # sides of the cell, m
        ("b", np.float64),
        ("half", np.float64),  # thickness of the sheet, m
        ("stiffness", np.float64),  # k, N/m^3
        ("depth", np.float64),  # d0, m
        ("damping", np.float64),  # chi, s/m
        ("friction", np.float64),  # mu
        ("creep", np.float64),  # v_r, m/s
    ],
    align=True,
)


@kernel
def gap(touch: Any, arrays: Any, state: Any) -> Any:
    """Distance of the sheet's face at here.r from the surface; the normal in global axes is left in here.f."""
    here, body = state.meeting[0], state.bodies[touch.body]
    x, y, z = here.r[0] - body.r[0], here.r[1] - body.r[1], here.r[2] - body.r[2]
    for k in range(3):
        here.p[k] = body.A[0, k] * x + body.A[1, k] * y + body.A[2, k] * z
    here.part = 1.0
    found = surface_gap(touch.surface, arrays, state) - touch.half
    for k in range(3):
        here.f[k] = body.A[k, 0] * here.n[0] + body.A[k, 1] * here.n[1] + body.A[k, 2] * here.n[2]
    return found


@kernel
def meet(touch: Any, arrays: Any, state: Any) -> None:
    """Add what all points feel to the bodies, unless here.silent, and to here.told."""
    here, bodies = state.meeting[0], state.bodies
    middle(touch, bodies, here.r)
    if gap(touch, arrays, state).real > reach(touch):
        return
    nx, nz = touch.samples[0], touch.samples[1]
    for i in range(nx + touch.ends[0, 1]):
        for k in range(nz + touch.ends[1, 1]):
            share = touch.a * touch.b / (nx * nz)
            if (i == 0 and touch.ends[0, 0] == 1) or i == nx:
                share *= 0.5
            if (k == 0 and touch.ends[1, 0] == 1) or k == nz:
                share *= 0.5
            weigh(touch, i / nx, k / nz, here.c)
            locate(touch, here.c, bodies, here.r)
            d = -gap(touch, arrays, state)
            if d.real > 0.0 and here.part.real > 0.0:
                push(touch, share, d, bodies, here)


@kernel
def push(touch: Any, share: float, d: Any, bodies: Any, here: Any) -> None:
    """What one point feels, the normal of the surface in here.f."""
    drift(touch, here.c, bodies, here.v)
    body, r, v, f, told = bodies[touch.body], here.r, here.v, here.f, here.told
    x, y, z = r[0] - body.r[0], r[1] - body.r[1], r[2] - body.r[2]
    v[0] -= body.Y[0] + body.Y[4] * z - body.Y[5] * y
    v[1] -= body.Y[1] + body.Y[5] * x - body.Y[3] * z
    v[2] -= body.Y[2] + body.Y[3] * y - body.Y[4] * x
    k, d0 = touch.stiffness * share * here.part, touch.depth
    if d.real < d0:
        spring, stored = k * d * d / (2.0 * d0), k * d * d * d / (6.0 * d0)
    else:
        spring, stored = k * (d - 0.5 * d0), k * (0.5 * d * d - 0.5 * d0 * d + d0 * d0 / 6.0)
    leaving = f[0] * v[0] + f[1] * v[1] + f[2] * v[2]
    N = spring * (1.0 - touch.damping * leaving)
    if N.real < 0.0:
        N = 0.0 * N
    told[3] += stored
    told[4] += (N - spring) * leaving
    if d.real > told[5].real:
        told[5] = d
    rub = 0.0 * N
    if touch.friction > 0.0:
        for j in range(3):
            v[j] -= leaving * f[j]
        square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
        rub = touch.friction * N / np.sqrt(square + touch.creep * touch.creep)
        told[4] -= rub * square
    for j in range(3):
        f[j] = N * f[j] - rub * v[j]
        told[j] += f[j]
    if here.silent == 0:
        press(touch, here.c, bodies, f)
        if touch.body > 0:
            react(body, r, f)


@kernel
def tell(load: Any, arrays: Any, state: Any, k: int) -> Any:
    """Entry k of ``told`` by one cell alone, the bodies left as they are."""
    here = state.meeting[0]
    for j in range(8):
        here.told[j] = 0.0
    here.silent = 1
    meet(load, arrays, state)
    here.silent = 0
    return here.told[k]


@kernel
def apply(touch: Any, t: float, arrays: Any, state: Any) -> None:
    """See :mod:`mbfmu.mechanics.loads.base`."""
    meet(touch, arrays, state)


@kernel
def potential(touch: Any, arrays: Any, state: Any) -> float:
    """Energy that the law of pressure stores, J."""
    return tell(touch, arrays, state, 3)


@kernel
def power(touch: Any, t: float, arrays: Any, state: Any) -> float:
    """Power of friction and of what is lost as the sheet leaves, W."""
    return tell(touch, arrays, state, 4)


@dataclass(frozen=True, kw_only=True)
class Touch(Load):
    """One cell of a sheet against a surface; :func:`.add_touch` makes those of a sheet."""

    record = TOUCH
    apply = apply
    potential = potential
    power = power

    surface: Surface
    sides: tuple[float, float]
    ends: tuple[tuple[bool, bool], tuple[bool, bool]]
    thickness: float
    samples: tuple[int, int]
    stiffness: float
    depth: float
    damping: float
    friction: float
    creep: float

    def fill(self, record: Any, site: Site) -> None:
        """Write the nodes, the surface and the law; the last of its bodies has the surface."""
        record["node"], record["body"] = site.bodies[:4], site.bodies[4]
        record["surface"] = site.surface(self.surface)
        record["samples"], record["ends"] = self.samples, self.ends
        record["a"], record["b"] = self.sides
        record["half"] = 0.5 * self.thickness
        for key in ("stiffness", "depth", "damping", "friction", "creep"):
            record[key] = getattr(self, key)

"""What bodies, elements, forces and cut joints contribute to the structured tangent, added to the rows of a group and
its neighbour inward.
"""

from __future__ import annotations

from typing import Any

from mbfmu.mechanics.cuts import tangent as cut_tangent
from mbfmu.mechanics.elastic import pressure
from mbfmu.mechanics.elastic.tangent import damping, stiffness
from mbfmu.mechanics.forces import tangent as force_tangent
from mbfmu.mechanics.signals import value
from solvers.kernel import kernel

from .joints import handed_down, outer_joint
from .layout import FIXED, OUTER

_pressure, _cut, _force = pressure.stiffness, cut_tangent.stiffness, force_tangent.stiffness


@kernel
def bodily(i: int, at: int, c2: float, arrays: Any, state: Any, F: Any) -> None:
    """A body's own rows: c2 times its inertia about its origin, and its inertia force and weight turning with it."""
    mass, here = arrays.bodies[i].mass, state.bodies[i]
    c, Jc, dY = here.com, here.Jc, here.dY
    square = c[0] * c[0] + c[1] * c[1] + c[2] * c[2]
    for k in range(3):
        F[at + k, at + k] += c2 * mass
        F[at + 3 + k, at + 3 + k] += c2 * mass * square
        for j in range(3):
            F[at + 3 + k, at + 3 + j] += c2 * (Jc[k, j] - mass * c[k] * c[j])
    for k in range(3):
        p, q = (k + 1) % 3, (k + 2) % 3  # (c x)_pq = -c_k
        F[at + 3 + p, at + q] -= c2 * mass * c[k]
        F[at + 3 + q, at + p] += c2 * mass * c[k]
        F[at + p, at + 3 + q] += c2 * mass * c[k]
        F[at + q, at + 3 + p] -= c2 * mass * c[k]
    # d(c x f) = (dphi x c) x f = c (dphi.f) - dphi (c.f), f the inertia force less the weight
    f0 = mass * (dY[0] + dY[4] * c[2] - dY[5] * c[1])
    f1 = mass * (dY[1] + dY[5] * c[0] - dY[3] * c[2])
    f2 = mass * (dY[2] + dY[3] * c[1] - dY[4] * c[0])
    along = c[0] * f0 + c[1] * f1 + c[2] * f2
    for k in range(3):
        F[at + 3 + k, at + 3] += c[k] * f0
        F[at + 3 + k, at + 4] += c[k] * f1
        F[at + 3 + k, at + 5] += c[k] * f2
        F[at + 3 + k, at + 3 + k] -= along


@kernel
def plate_element(e: int, group: int, size: int, c1: float, L: Any, arrays: Any, state: Any, s: Any) -> None:
    """Stiffness and c1 times the damping of a plate element between bodies of a group and its neighbour."""
    plate = arrays.plates[e]
    stiffness(plate, state.bodies, state.element[0], s.K)
    if plate.damped == 1 and c1 != 0.0:
        damping(plate, state.bodies, state.element[0], s.D)
        for row in range(24):
            for column in range(24):
                s.K[row, column] += c1 * s.D[row, column]
    add_element(plate.node, group, size, L, s)


@kernel
def pressed_surface(e: int, group: int, size: int, L: Any, arrays: Any, state: Any, s: Any) -> None:
    """How a pressure turns and grows with its surface."""
    load = arrays.pressures[e]
    for row in range(24):
        for column in range(24):
            s.K[row, column] = 0.0
    _pressure(load, value(arrays.signals[load.signal], state.time[0]), state.bodies, s.K)
    add_element(load.node, group, size, L, s)


@kernel
def cut_joint(c: int, group: int, size: int, L: Any, arrays: Any, state: Any, s: Any) -> None:
    """How the reactions of a cut joint turn, and the springs that hold it."""
    cut = arrays.cuts[c]
    end = arrays.cuts[c + 1].row if c + 1 < arrays.cuts.shape[0] else state.rows.shape[0]
    _cut(cut, end, arrays.kept, s.weight, state, s.twins, s.rows, s.K)
    s.pair[0], s.pair[1] = cut.a, cut.b
    add_element(s.pair, group, size, L, s)


@kernel
def force_on_bodies(
    f: int, group: int, size: int, c1: float, L: Any, arrays: Any, state: Any, twin: Any, s: Any
) -> None:
    """Stiffness and c1 times the damping of a force between two bodies."""
    force = arrays.forces[f]
    _force(force, c1, arrays, state, twin, s.K)
    s.pair[0], s.pair[1] = force.a, force.b
    add_element(s.pair, group, size, L, s)


@kernel
def add_element(node: Any, group: int, size: int, L: Any, s: Any) -> None:
    """Add s.K to s.F, between bodies ``node`` of a group and its neighbour (offset ``size``), six rows a body."""
    for p in range(node.shape[0]):
        i = node[p]
        if L.role[i] == FIXED:
            continue
        ati = L.slot[i] + (size if L.group[i] != group else 0)
        for q in range(node.shape[0]):
            j = node[q]
            if L.role[j] == FIXED:
                continue
            atj = L.slot[j] + (size if L.group[j] != group else 0)
            for a in range(6):
                for b in range(6):
                    s.F[ati + a, atj + b] += s.K[6 * p + a, 6 * q + b]


@kernel
def fill(
    group: int, size: int, c1: float, c2: float, L: Any, arrays: Any, state: Any, twin: Any, dual: Any, s: Any
) -> None:
    """Add to s.F what starts in a group: bodies, elements, joints within it and to its neighbour (offset ``size``)."""
    for k in range(L.first_plate[group], L.first_plate[group + 1]):
        plate_element(L.plates[k], group, size, c1, L, arrays, state, s)
    for k in range(L.first_pressure[group], L.first_pressure[group + 1]):
        pressed_surface(L.pressures[k], group, size, L, arrays, state, s)
    for k in range(L.first_cut[group], L.first_cut[group + 1]):
        cut_joint(L.cuts[k], group, size, L, arrays, state, s)
    for k in range(L.first_force[group], L.first_force[group + 1]):
        force_on_bodies(L.forces[k], group, size, c1, L, arrays, state, twin, s)
    own, inner = L.first[group + 1] - L.first[group], L.inward[group]
    for k in range(own + (L.first[inner + 1] - L.first[inner] if inner >= 0 else 0)):
        i = L.members[L.first[group] + k if k < own else L.first[inner] + k - own]
        j = arrays.bodies[i].parent
        ati = L.slot[i] + (size if L.group[i] != group else 0)
        if L.group[i] == group:
            bodily(i, ati, c2, arrays, state, s.F)
        if L.role[j] == FIXED or min(L.group[i], L.group[j]) != group:
            continue
        atj = L.slot[j] + (size if L.group[j] != group else 0)
        handed_down(i, ati, atj, arrays, state, s.F)
        if L.role[i] == OUTER:
            lock = L.lock[i] + (size if L.group[i] != group else 0)
            outer_joint(i, ati, atj, lock, arrays, state, dual, s.F, s)

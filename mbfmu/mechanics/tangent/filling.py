"""What bodies, loads, cut joints and couplings contribute to the structured tangent, added to the rows of a group and
its neighbor inward.
"""

from __future__ import annotations

from typing import Any

from mbfmu.mechanics.dispatch import load_tangent
from solvers.compiled.kernel import inlined, kernel

from . import couplings, cuts, loads
from .border import keep_apart
from .joints import handed_down, outer_joint
from .layout import FIXED, OUTER

_cut, _coupling, _load = cuts.stiffness, couplings.stiffness, loads.stiffness


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


@inlined
def clear(count: int, K: Any) -> None:
    """K <- 0 for the given numbers of rows and columns."""
    for row in range(count):
        for column in range(count):
            K[row, column] = 0.0


@kernel
def analytic(e: int, group: int, size: int, c1: float, L: Any, arrays: Any, state: Any, twin: Any, s: Any) -> None:
    """A load with a tangent between bodies of a group and its neighbor; s.K is zero before and after."""
    if load_tangent(arrays.loads[e], c1, arrays, state, twin, s.K) == 0.0:
        return
    inner = L.inward[group] if L.home[e] == group else -1  # of a loose body away from home, its own rows alone
    add_element(L.first_body[e], L.first_body[e + 1], group, inner, size, L, s)
    if L.home[e] == group:
        keep_apart(L.first_body[e], L.first_body[e + 1], group, inner, L, arrays, state, s)
    clear(6 * (L.first_body[e + 1] - L.first_body[e]), s.K)


@kernel
def cut_joint(c: int, group: int, size: int, L: Any, arrays: Any, state: Any, twin: Any, s: Any) -> None:
    """How the reactions of a cut joint turn, and the springs that hold it."""
    _cut(arrays.cuts[c], s.weight, arrays, state, twin, s.K)
    e = arrays.loads.shape[0] + c
    add_element(L.first_body[e], L.first_body[e + 1], group, L.inward[group], size, L, s)


@kernel
def coupling(c: int, group: int, size: int, L: Any, arrays: Any, state: Any, dual: Any, s: Any) -> None:
    """How the efforts of a coupling change, and the spring that holds it."""
    _coupling(c, arrays, state, dual, s)
    e = arrays.loads.shape[0] + arrays.cuts.shape[0] + c
    add_element(L.first_body[e], L.first_body[e + 1], group, L.inward[group], size, L, s)


@kernel
def stepped(e: int, group: int, size: int, c1: float, L: Any, arrays: Any, state: Any, twin: Any, s: Any) -> None:
    """A load that does not know it."""
    _load(e, c1, L, arrays, state, twin, s.K)
    add_element(L.first_body[e], L.first_body[e + 1], group, L.inward[group], size, L, s)


@kernel
def add_element(first: int, end: int, group: int, inner: int, size: int, L: Any, s: Any) -> None:
    """Add s.K to s.F, between the bodies ``first`` to ``end`` of the layout that are in a group or its neighbor
    ``inner`` (offset ``size``), six rows a body.
    """
    for p in range(end - first):
        i = L.bodies[first + p]
        if L.role[i] == FIXED or (L.group[i] != group and L.group[i] != inner):
            continue
        ati = L.slot[i] + (size if L.group[i] != group else 0)
        for q in range(end - first):
            j = L.bodies[first + q]
            if L.role[j] == FIXED or (L.group[j] != group and L.group[j] != inner):
                continue
            atj = L.slot[j] + (size if L.group[j] != group else 0)
            for a in range(6):
                for b in range(6):
                    s.F[ati + a, atj + b] += s.K[6 * p + a, 6 * q + b]


@kernel
def fill(
    group: int, size: int, c1: float, c2: float, L: Any, arrays: Any, state: Any, twin: Any, dual: Any, s: Any
) -> None:
    """Add to s.F what starts in a group: bodies, elements, joints within it and to its neighbor (offset ``size``)."""
    clear(s.K.shape[0], s.K)
    for k in range(L.first_load[group], L.first_load[group + 1]):
        analytic(L.loads[k], group, size, c1, L, arrays, state, twin, s)
    for k in range(L.first_cut[group], L.first_cut[group + 1]):
        cut_joint(L.cuts[k], group, size, L, arrays, state, twin, s)
    for k in range(L.first_coupling[group], L.first_coupling[group + 1]):
        coupling(L.couplings[k], group, size, L, arrays, state, dual, s)
    for k in range(L.first_step[group], L.first_step[group + 1]):
        stepped(L.steps[k], group, size, c1, L, arrays, state, twin, s)
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
            outer_joint(i, ati, atj, lock, arrays, state, twin, dual, s.F, s)

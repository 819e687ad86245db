"""What bodies, loads, cut joints and couplings contribute to the structured tangent, added to the rows of a group and
its neighbor inward.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbfmu.mechanics.dispatch import load_tangent
from mbfmu.mechanics.recursions.active_loads import is_idle
from solvers.compiled.kernel import inlined, kernel

from . import couplings, cuts, loads
from .border import store_coupling
from .joints import add_moment_arm_stiffness, add_outer_joint
from .layout import FIXED, OUTER

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from mbfmu.mechanics.tangent.assembly import TangentScratch
    from mbfmu.mechanics.tangent.layout import Layout
    from solvers.compiled.record import Reals

_cut_stiffness, _coupling_stiffness, _load_stiffness = cuts.stiffness, couplings.stiffness, loads.stiffness


@kernel
def add_inertia_rows(i: int, at: int, c2: float, arrays: Arrays, state: State, F: Reals) -> None:
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
def clear_matrix(count: int, K: Reals) -> None:
    """K <- 0 for the given numbers of rows and columns."""
    for row in range(count):
        for column in range(count):
            K[row, column] = 0.0


@kernel
def add_analytic_tangent(
    e: int,
    group: int,
    size: int,
    c1: float,
    layout: Layout,
    arrays: Arrays,
    state: State,
    perturbed: State,
    scratch: TangentScratch,
) -> None:
    """A load with a tangent between bodies of a group and its neighbor; scratch.K is zero before and after."""
    if is_idle(e, arrays, state) or load_tangent(arrays.loads[e], c1, arrays, state, perturbed, scratch.K) == 0.0:
        return
    inner = (
        layout.inward[group] if layout.home[e] == group else -1
    )  # of a loose body away from home, its own rows alone
    add_element(layout.first_body[e], layout.first_body[e + 1], group, inner, size, layout, scratch)
    if layout.home[e] == group:
        store_coupling(layout.first_body[e], layout.first_body[e + 1], group, inner, layout, arrays, state, scratch)
    clear_matrix(6 * (layout.first_body[e + 1] - layout.first_body[e]), scratch.K)


@kernel
def add_cut_joint(
    c: int,
    group: int,
    size: int,
    layout: Layout,
    arrays: Arrays,
    state: State,
    perturbed: State,
    scratch: TangentScratch,
) -> None:
    """How the reactions of a cut joint turn, and the springs that hold it."""
    _cut_stiffness(arrays.cuts[c], scratch.weight, arrays, state, perturbed, scratch.K)
    e = arrays.loads.shape[0] + c
    add_element(layout.first_body[e], layout.first_body[e + 1], group, layout.inward[group], size, layout, scratch)


@kernel
def add_coupling(
    c: int, group: int, size: int, layout: Layout, arrays: Arrays, state: State, dual: Reals, scratch: TangentScratch
) -> None:
    """How the efforts of a coupling change, and the spring that holds it."""
    _coupling_stiffness(c, arrays, state, dual, scratch)
    e = arrays.loads.shape[0] + arrays.cuts.shape[0] + c
    add_element(layout.first_body[e], layout.first_body[e + 1], group, layout.inward[group], size, layout, scratch)


@kernel
def add_complex_step_tangent(
    e: int,
    group: int,
    size: int,
    c1: float,
    layout: Layout,
    arrays: Arrays,
    state: State,
    perturbed: State,
    scratch: TangentScratch,
) -> None:
    """A load that does not know it."""
    _load_stiffness(e, c1, layout, arrays, state, perturbed, scratch.K)
    add_element(layout.first_body[e], layout.first_body[e + 1], group, layout.inward[group], size, layout, scratch)


@kernel
def add_element(
    first: int, end: int, group: int, inner: int, size: int, layout: Layout, scratch: TangentScratch
) -> None:
    """Add scratch.K to scratch.F, between the bodies ``first`` to ``end`` of the layout that are in a group or its
    neighbor ``inner`` (offset ``size``), six rows a body.
    """
    for p in range(end - first):
        i = layout.bodies[first + p]
        if layout.role[i] == FIXED or (layout.group[i] != group and layout.group[i] != inner):
            continue
        ati = layout.slot[i] + (size if layout.group[i] != group else 0)
        for q in range(end - first):
            j = layout.bodies[first + q]
            if layout.role[j] == FIXED or (layout.group[j] != group and layout.group[j] != inner):
                continue
            atj = layout.slot[j] + (size if layout.group[j] != group else 0)
            for a in range(6):
                for b in range(6):
                    scratch.F[ati + a, atj + b] += scratch.K[6 * p + a, 6 * q + b]


@kernel
def fill(
    group: int,
    size: int,
    c1: float,
    c2: float,
    layout: Layout,
    arrays: Arrays,
    state: State,
    perturbed: State,
    dual: Reals,
    scratch: TangentScratch,
) -> None:
    """Add to scratch.F what starts in a group: bodies, elements, joints in it and to its neighbor (offset ``size``)."""
    clear_matrix(scratch.K.shape[0], scratch.K)
    for k in range(layout.first_load[group], layout.first_load[group + 1]):
        add_analytic_tangent(layout.loads[k], group, size, c1, layout, arrays, state, perturbed, scratch)
    for k in range(layout.first_cut[group], layout.first_cut[group + 1]):
        add_cut_joint(layout.cuts[k], group, size, layout, arrays, state, perturbed, scratch)
    for k in range(layout.first_coupling[group], layout.first_coupling[group + 1]):
        add_coupling(layout.couplings[k], group, size, layout, arrays, state, dual, scratch)
    for k in range(layout.first_step[group], layout.first_step[group + 1]):
        add_complex_step_tangent(layout.steps[k], group, size, c1, layout, arrays, state, perturbed, scratch)
    own, inner = layout.first[group + 1] - layout.first[group], layout.inward[group]
    for k in range(own + (layout.first[inner + 1] - layout.first[inner] if inner >= 0 else 0)):
        i = layout.members[layout.first[group] + k if k < own else layout.first[inner] + k - own]
        j = arrays.bodies[i].parent
        ati = layout.slot[i] + (size if layout.group[i] != group else 0)
        if layout.group[i] == group:
            add_inertia_rows(i, ati, c2, arrays, state, scratch.F)
        if layout.role[j] == FIXED or min(layout.group[i], layout.group[j]) != group:
            continue
        atj = layout.slot[j] + (size if layout.group[j] != group else 0)
        add_moment_arm_stiffness(i, ati, atj, arrays, state, scratch.F)
        if layout.role[i] == OUTER:
            lock = layout.lock[i] + (size if layout.group[i] != group else 0)
            add_outer_joint(i, ati, atj, lock, arrays, state, perturbed, dual, scratch.F, scratch)

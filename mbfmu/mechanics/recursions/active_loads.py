"""Loads that can act where the bodies are: the others are not evaluated.

A load whose kernel ``clearance`` returns c > 0 applies nothing as long as its bodies are displaced by less than c, in

    |r - r0| + l |A - A0|,

r0 and A0 the placement of a body when c was evaluated, l its lever (:attr:`mbfmu.mechanics.loads.base.Load.levers`),
|A - A0| the root of the sum of squares of the entries. No point at a distance of l or less from the origin of the body
is displaced by more. A search evaluates all clearances and lists the loads with a clearance of less than the margin.
The list is complete until a body is displaced by the margin. Then the search is repeated, and if the records of loads
have changed (:func:`discard_lists`). The method is that of the neighbor lists of molecular dynamics (Verlet 1967).

Of the listed loads few act. Which ones is recorded in every evaluation, by ``has_acted`` of
:class:`mbfmu.mechanics.records.SearchRecord`, and others are left out of the next evaluations as long as the bodies are
where they were to the last bit: in a product of Newton's matrix, an imaginary step of the state, and in the structured
tangent. A load may set bits of ``parts`` that act, such as points, and gets them back if ``is_repeated`` is 1.

Loads are evaluated in their order, so that results are those without a list to the last bit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbfmu.mechanics.dispatch import CLEARANCE, apply_load, load_clearance, load_longest_step
from solvers.compiled.kernel import inlined, kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, PlacementRecord, State
    from solvers.compiled.record import Table


@inlined
def store_placements(state: State, places: Table[PlacementRecord]) -> None:
    """Copy where all bodies are."""
    for i in range(state.bodies.shape[0]):
        here, there = state.bodies[i], places[i]
        for k in range(3):
            there.r[k] = here.r[k].real
            for j in range(3):
                there.A[k, j] = here.A[k, j].real


@kernel
def is_list_complete(arrays: Arrays, state: State) -> bool:
    """Whether no load can act that is not in the list of the last search."""
    margin = arrays.world[0].search_margin.real
    if state.search[0].is_searched == 0:
        return False
    for i in range(arrays.bodies.shape[0]):
        lever = arrays.bodies[i].lever.real
        if lever < 0.0:
            continue
        here, there, moved, turned = state.bodies[i], state.searched[i], 0.0, 0.0
        for k in range(3):
            moved += (here.r[k].real - there.r[k]) ** 2
            for j in range(3):
                turned += (here.A[k, j].real - there.A[k, j]) ** 2
        # (a + b)^2 <= 2 (a^2 + b^2)
        if not 2.0 * (moved + lever * lever * turned) < margin * margin:
            return False
    return True


@kernel
def is_evaluated(arrays: Arrays, state: State) -> bool:
    """Whether the bodies are where they were in the last evaluation, to the last bit."""
    if state.search[0].is_evaluated == 0:
        return False
    for i in range(arrays.bodies.shape[0]):
        if arrays.bodies[i].lever.real < 0.0:
            continue
        here, there = state.bodies[i], state.evaluated[i]
        for k in range(3):
            if here.r[k].real != there.r[k]:
                return False
            for j in range(3):
                if here.A[k, j].real != there.A[k, j]:
                    return False
    return True


@kernel
def search_active_loads(arrays: Arrays, state: State) -> None:
    """List the loads whose clearance is less than the margin where the bodies are."""
    count, margin = 0, arrays.world[0].search_margin.real
    for e in range(arrays.loads.shape[0]):
        if not load_clearance(arrays.loads[e], arrays, state).real >= margin:
            state.active[count] = e
            count += 1
    store_placements(state, state.searched)
    state.search[0].active, state.search[0].is_searched = count, 1


@kernel
def discard_lists(state: State) -> None:
    """Discard the lists: the records of loads may have changed."""
    state.search[0].is_searched, state.search[0].is_evaluated = 0, 0


@kernel
def apply_active_loads(t: float, arrays: Arrays, state: State) -> None:
    """Let every load act that can."""
    search = state.search[0]
    if is_evaluated(arrays, state):
        search.is_repeated = 1
        for k in range(search.acting):
            search.parts = state.acting_parts[k]
            apply_load(arrays.loads[state.acting[k]], t, arrays, state)
        search.is_repeated = 0
        return
    if not is_list_complete(arrays, state):
        search_active_loads(arrays, state)
    for k in range(search.acting):
        state.is_acting[state.acting[k]] = 0
    acting = 0
    for k in range(search.active):
        e = state.active[k]
        search.has_acted = 1 if arrays.kernels[arrays.loads[e].kind + CLEARANCE] == 0 else 0
        search.parts = 0
        apply_load(arrays.loads[e], t, arrays, state)
        if search.has_acted == 1:
            state.acting[acting], state.acting_parts[acting], state.is_acting[e] = e, search.parts, 1
            acting += 1
    store_placements(state, state.evaluated)
    search.acting, search.is_evaluated = acting, 1


@inlined
def is_idle(e: int, arrays: Arrays, state: State) -> bool:
    """Whether load e did not act where the bodies are; the loads were evaluated there."""
    return arrays.world[0].has_clearances == 1 and state.is_acting[e] == 0


@kernel
def longest_load_step(taken: float, arrays: Arrays, state: State) -> float:
    """The longest step after one of ``taken``, s, in which bodies do not pass a place where a load acts; they move."""
    longest = np.inf
    for e in range(arrays.loads.shape[0]):
        longest = min(longest, load_longest_step(arrays.loads[e], taken, arrays, state))
    return longest

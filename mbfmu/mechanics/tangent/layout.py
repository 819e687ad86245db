"""Where the unknowns of every body go in the rows of its group: see the package."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.kind import kernel_of
from mbfmu.mechanics.loads.base import zero_tangent

from .groups import Groups

if TYPE_CHECKING:
    from mbfmu.mechanics.builder.loading import Acting
    from mbfmu.mechanics.loads.base import Load
    from mbfmu.mechanics.records import Arrays

FIXED, INNER, OUTER = 0, 1, 2  # does not move; condensed onto its parent, in its group; tied to it by its own motion


class Layout(NamedTuple):
    """Where everything of a body goes in its group's rows, and which elements start in a group."""

    role: NDArray[np.int64]  # (nb,) FIXED, INNER, OUTER
    group: NDArray[np.int64]  # (nb,)
    inward: NDArray[np.int64]  # (groups,) neighbor inward; -1: none
    slot: NDArray[np.int64]  # (nb,) first of the body's six rows
    condensed: NDArray[np.int64]  # (groups,) 1: some of its bodies are inner
    kept: NDArray[np.int64]  # (nb,) first of those that stay after condensation, among all that stay
    lock: NDArray[np.int64]  # (nb,) first of its joint's multipliers, outer bodies
    first: NDArray[np.int64]  # (groups + 1,) into ``members``
    members: NDArray[np.int64]  # bodies of every group, parents first
    home: NDArray[np.int64]  # (loads,) the first group that has one of the bodies that a load ties; -1: none
    first_load: NDArray[np.int64]  # (groups + 1,) into ``loads``
    loads: NDArray[np.int64]  # those with a tangent, at home, and where a loose body is elsewhere
    first_cut: NDArray[np.int64]  # (groups + 1,) into ``cuts``
    cuts: NDArray[np.int64]  # cut joints, at home and elsewhere
    first_coupling: NDArray[np.int64]  # (groups + 1,) into ``couplings``
    couplings: NDArray[np.int64]  # couplings, at home and elsewhere
    first_step: NDArray[np.int64]  # (groups + 1,) into ``steps``
    steps: NDArray[np.int64]  # loads that are differentiated by complex steps, at home and elsewhere
    first_body: NDArray[np.int64]  # (loads + cuts + couplings + 1,) into ``bodies``
    bodies: NDArray[np.int64]  # of every load, every cut joint and every coupling: a, its parent, b, its parent
    along: NDArray[np.int64]  # (k, 4) loads along coordinates of joints: load, body, number of the coordinate, number
    # of the first-order state that belongs to it; -1: none
    column: NDArray[np.int64]  # (nb,) first in the border, of a loose body that is away from home somewhere; -1: none
    columns: NDArray[np.int64]  # (nb,) how many: its coordinate alone where its parent rests, else its six motions


def lay_out(
    arrays: Arrays, found: Groups, acting: Sequence[Acting]
) -> tuple[Layout, list[NDArray[np.int64]], list[int]]:
    """Return where everything goes, and for every group the rows that stay unknown after condensation, and its size."""
    nb, groups, inward = len(arrays.bodies), found.of, found.inward
    role, slot, place, lock = (np.zeros(nb, np.int64) for _ in range(4))
    members: list[list[int]] = [[] for _ in inward]
    for i in range(1, nb):
        body = arrays.bodies[i]
        parent = int(body["parent"])
        free = body["vf"] >= 0 and body["nv"] > 0
        if role[parent] == FIXED:
            role[i] = INNER if free else FIXED
        else:
            locked = not free or body["nv"] < 6
            role[i] = INNER if locked and groups[parent] == groups[i] else OUTER
            if not neighbors(groups[[parent, i]], inward):
                raise ValueError(f"body {i} and its parent {parent} are in groups {groups[i]} and {groups[parent]}")
        if role[i] != FIXED:
            members[groups[i]].append(i)
    kept, sizes = [], []
    for own in members:
        rows: list[int] = []
        for k, i in enumerate(own):
            slot[i], place[i] = 6 * k, len(rows)
            free = int(arrays.bodies[i]["nv"]) if arrays.bodies[i]["vf"] >= 0 else 0
            rows += range(6 * k, 6 * k + (6 if role[i] == OUTER else free))
        size = 6 * len(own)
        for i in own:
            if role[i] == OUTER:
                lock[i] = size
                free = int(arrays.bodies[i]["nv"]) if arrays.bodies[i]["vf"] >= 0 else 0
                rows += range(size, size + 6 - free)
                size += 6 - free
        kept.append(np.array(rows, np.int64))
        sizes.append(size)
    flat = flat_list(members)
    on = [[] if a.load.on_joint else [body.index for body in a.bodies] for a in acting]
    tangents = [kernel_of(a.load, "tangent") for a in acting]
    tied = [own[: len(own) - a.load.n_untied_bodies] for a, own in zip(acting, on, strict=True)]
    loads = by_group(
        [[] if t in (None, zero_tangent) else own for t, own in zip(tangents, tied, strict=True)], role, found
    )
    home, column, columns = np.full(len(acting), -1), np.full(nb, -1), np.zeros(nb, np.int64)
    for g, own in enumerate(loads):
        home[own] = g
    for e, (all_of, own) in enumerate(zip(on, tied, strict=True)):
        if tangents[e] not in (None, zero_tangent):
            at_home = {home[e], inward[home[e]]} if home[e] >= 0 else set()
            away = [i for i in all_of[len(own) :] if role[i] != FIXED and groups[i] not in at_home]
            for g in {int(groups[i]) for i in away}:
                loads[g].append(e)
            for i in away if home[e] >= 0 else ():
                if column[i] < 0:
                    column[i] = columns.sum()
                    alone = arrays.bodies[i]["nv"] == 1 and role[arrays.bodies[i]["parent"]] == FIXED
                    columns[i] = 1 if alone else 6
    steps = by_group([[] if t is not None else own for t, own in zip(tangents, on, strict=True)], role, found)
    ties = [[int(cut["a"]), int(cut["b"])] for cut in arrays.cuts]
    cuts = by_group(ties, role, found)
    pairs = [[i for end in "ab" for i in coupled_bodies(arrays, coupling, end)] for coupling in arrays.couplings]
    couplings = by_group(pairs, role, found)
    along = loads_along_coordinates(acting)
    layout = Layout(
        role=role,
        group=groups,
        inward=inward,
        slot=slot,
        condensed=np.array([any(role[i] == INNER for i in own) for own in members], np.int64),
        kept=place,
        lock=lock,
        first=offsets(members),
        members=flat,
        home=home,
        first_load=offsets(loads),
        loads=flat_list(loads),
        first_cut=offsets(cuts),
        cuts=flat_list(cuts),
        first_coupling=offsets(couplings),
        couplings=flat_list(couplings),
        first_step=offsets(steps),
        steps=flat_list(steps),
        first_body=offsets(on + ties + pairs),
        bodies=flat_list(on + ties + pairs),
        along=np.array(along, np.int64).reshape(-1, 4),
        column=column,
        columns=columns,
    )
    return layout, kept, sizes


def is_local(load: Load) -> bool:
    """Whether a load acts along the coordinates of a joint, with a first-order state for each."""
    return load.on_joint and len(load.states) == len(load.coordinates)


def loads_along_coordinates(acting: Sequence[Acting]) -> list[tuple[int, int, int, int]]:
    """Return the rows of :attr:`Layout.along`."""
    rows, first = [], 0
    for k, a in enumerate(acting):
        if a.load.on_joint:
            local = is_local(a.load)
            rows += [(k, a.bodies[0].index, c, first + j if local else -1) for j, c in enumerate(a.load.coordinates)]
        first += len(a.load.states)
    return rows


def coupled_bodies(arrays: Arrays, coupling: Any, end: str) -> list[int]:
    """Return the two bodies whose motions say what a coupled coordinate does; the ground where it is driven."""
    i = int(coupling[end])
    return [i, int(arrays.bodies[i]["parent"])] if coupling["f" + end] >= 0 else [0, 0]


def neighbors(groups: Any, inward: Any) -> bool:
    """Whether some groups are one, or one and its neighbor inward."""
    first, *others = sorted({int(group) for group in groups})
    return not others or (len(others) == 1 and inward[first] == others[0])


def by_group(elements: Sequence[Sequence[int]], role: Any, groups: Groups) -> list[list[int]]:
    """Return the elements, each a row of bodies, by the first group that has one of their moving bodies."""
    found: list[list[int]] = [[] for _ in groups.inward]
    for e, nodes in enumerate(elements):
        own = [int(groups.of[i]) for i in nodes if role[i] != FIXED]
        if own:
            if not neighbors(own, groups.inward):
                raise ValueError(f"element {e} spans groups {sorted(set(own))}")
            found[min(own)].append(e)
    return found


def offsets(lists: Sequence[Sequence[Any]]) -> NDArray[np.int64]:
    """Return where each list starts in :func:`flat_list`, and the end."""
    return np.concatenate(([0], np.cumsum([len(own) for own in lists]))).astype(np.int64)


def flat_list(lists: list[list[int]]) -> NDArray[np.int64]:
    """Return all lists as one array."""
    return np.array([i for own in lists for i in own], np.int64)

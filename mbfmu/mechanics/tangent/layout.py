"""Where the unknowns of every body go in the rows of its group: see the package."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .groups import Groups

FIXED, INNER, OUTER = 0, 1, 2  # does not move; folded onto a parent in its group; tied to a parent in another


class Layout(NamedTuple):
    """Where everything of a body goes in its group's rows, and which elements start in a group."""

    role: NDArray[np.int64]  # (nb,) FIXED, INNER, OUTER
    group: NDArray[np.int64]  # (nb,)
    inward: NDArray[np.int64]  # (groups,) neighbour inward; -1: none
    slot: NDArray[np.int64]  # (nb,) first of the body's six rows
    lock: NDArray[np.int64]  # (nb,) first of its joint's multipliers, outer bodies
    first: NDArray[np.int64]  # (groups + 1,) into ``members``
    members: NDArray[np.int64]  # bodies of every group, parents first
    first_plate: NDArray[np.int64]  # (groups + 1,) into ``plates``
    plates: NDArray[np.int64]  # elements by the first group that has one of their bodies
    first_pressure: NDArray[np.int64]  # (groups + 1,) into ``pressures``
    pressures: NDArray[np.int64]  # surfaces under pressure, likewise
    first_cut: NDArray[np.int64]  # (groups + 1,) into ``cuts``
    cuts: NDArray[np.int64]  # cut joints, likewise
    first_force: NDArray[np.int64]  # (groups + 1,) into ``forces``
    forces: NDArray[np.int64]  # forces on bodies, likewise


def lay_out(arrays: Any, found: Groups) -> tuple[Layout, list[NDArray[np.int64]], list[int]]:
    """Return where everything goes, and for every group the rows that stay unknown after folding, and its size."""
    nb, groups, inward = len(arrays.bodies), found.of, found.inward
    role, slot, lock = (np.zeros(nb, np.int64) for _ in range(3))
    members: list[list[int]] = [[] for _ in inward]
    for i in range(1, nb):
        body = arrays.bodies[i]
        parent = int(body["parent"])
        free = body["vf"] >= 0 and body["nv"] > 0
        if role[parent] == FIXED:
            role[i] = INNER if free else FIXED
        else:
            role[i] = INNER if groups[parent] == groups[i] else OUTER
            if not neighbours(groups[[parent, i]], inward):
                raise ValueError(f"body {i} and its parent {parent} are in groups {groups[i]} and {groups[parent]}")
        if role[i] != FIXED:
            members[groups[i]].append(i)
    kept, sizes = [], []
    for own in members:
        rows: list[int] = []
        for k, i in enumerate(own):
            slot[i] = 6 * k
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
    ties, acting = (np.column_stack((table["a"], table["b"])) for table in (arrays.cuts, arrays.forces))
    acting[arrays.forces["v"] >= 0] = 0  # on joints, not on bodies
    plates, pressures, cuts, forces = (
        by_group(nodes, role, groups, inward)
        for nodes in (arrays.plates["node"], arrays.pressures["node"], ties, acting)
    )
    layout = Layout(
        role, groups, inward, slot, lock, offsets(members), flat,
        offsets(plates), flat_list(plates), offsets(pressures), flat_list(pressures), offsets(cuts), flat_list(cuts),
        offsets(forces), flat_list(forces),
    )  # fmt: skip
    return layout, kept, sizes


def neighbours(groups: Any, inward: Any) -> bool:
    """Whether some groups are one, or one and its neighbour inward."""
    first, *others = sorted({int(group) for group in groups})
    return not others or (len(others) == 1 and inward[first] == others[0])


def by_group(elements: Any, role: Any, groups: Any, inward: Any) -> list[list[int]]:
    """Return the elements, each a row of bodies, by the first group that has one of their moving bodies."""
    found: list[list[int]] = [[] for _ in inward]
    for e, nodes in enumerate(elements):
        own = [int(groups[i]) for i in nodes if role[i] != FIXED]
        if own:
            if not neighbours(own, inward):
                raise ValueError(f"element {e} spans groups {sorted(set(own))}")
            found[min(own)].append(e)
    return found


def offsets(lists: list[list[int]]) -> NDArray[np.int64]:
    """Return where each list starts in :func:`flat_list`, and the end."""
    return np.concatenate(([0], np.cumsum([len(own) for own in lists]))).astype(np.int64)


def flat_list(lists: list[list[int]]) -> NDArray[np.int64]:
    """Return all lists as one array."""
    return np.array([i for own in lists for i in own], np.int64)

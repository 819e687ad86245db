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


class GroupRows(NamedTuple):
    """Rows of the bodies of every group, as in :class:`Layout`, and what stays unknown of them."""

    slot: NDArray[np.int64]  # (nb,)
    place: NDArray[np.int64]  # (nb,) first of a body's rows among those of its group that stay after condensation
    lock: NDArray[np.int64]  # (nb,)
    kept: list[NDArray[np.int64]]  # for every group, the rows that stay
    sizes: list[int]  # of every group, with multipliers


def lay_out(
    arrays: Arrays, found: Groups, acting: Sequence[Acting]
) -> tuple[Layout, list[NDArray[np.int64]], list[int]]:
    """Return where everything goes, and for every group the rows that stay unknown after condensation, and its size."""
    role, members = roles_of(arrays, found)
    rows = rows_of(arrays, role, members)
    on = [[] if a.load.on_joint else [body.index for body in a.bodies] for a in acting]
    tangents = [kernel_of(a.load, "tangent") for a in acting]
    has_tangent = [tangent not in (None, zero_tangent) for tangent in tangents]
    tied = [own[: len(own) - a.load.n_untied_bodies] for a, own in zip(acting, on, strict=True)]
    loads = by_group([own if has else [] for has, own in zip(has_tangent, tied, strict=True)], role, found)
    home = np.full(len(acting), -1)
    for g, at_home in enumerate(loads):
        home[at_home] = g
    loose = [own[len(ties) :] if has else [] for has, own, ties in zip(has_tangent, on, tied, strict=True)]
    column, columns = place_away_from_home(arrays, role, found, home, loose, loads)
    steps = by_group([own if tangent is None else [] for tangent, own in zip(tangents, on, strict=True)], role, found)
    ties = [[int(cut["a"]), int(cut["b"])] for cut in arrays.cuts]
    cuts = by_group(ties, role, found)
    pairs = [[i for end in "ab" for i in coupled_bodies(arrays, coupling, end)] for coupling in arrays.couplings]
    couplings = by_group(pairs, role, found)
    layout = Layout(
        role=role,
        group=found.of,
        inward=found.inward,
        slot=rows.slot,
        condensed=np.array([any(role[i] == INNER for i in own) for own in members], np.int64),
        kept=rows.place,
        lock=rows.lock,
        first=offsets(members),
        members=flat_list(members),
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
        along=np.array(loads_along_coordinates(acting), np.int64).reshape(-1, 4),
        column=column,
        columns=columns,
    )
    return layout, rows.kept, rows.sizes


def roles_of(arrays: Arrays, found: Groups) -> tuple[NDArray[np.int64], list[list[int]]]:
    """Return the role (nb,) of every body, and the moving bodies of every group, parents first."""
    role = np.zeros(len(arrays.bodies), np.int64)
    members: list[list[int]] = [[] for _ in found.inward]
    for i, body in enumerate(arrays.bodies[1:], 1):
        parent, free = int(body["parent"]), count_free(body)
        if role[parent] == FIXED:
            role[i] = INNER if free else FIXED
        else:
            role[i] = INNER if free < 6 and found.of[parent] == found.of[i] else OUTER
            if not neighbors(found.of[[parent, i]], found.inward):
                raise ValueError(f"body {i} and its parent {parent} are in groups {found.of[i]} and {found.of[parent]}")
        if role[i] != FIXED:
            members[found.of[i]].append(i)
    return role, members


def count_free(body: Any) -> int:
    """Return the number of coordinates of a body's joint that are not driven."""
    return int(body["nv"]) if body["vf"] >= 0 else 0


def rows_of(arrays: Arrays, role: NDArray[np.int64], members: Sequence[Sequence[int]]) -> GroupRows:
    """Return the rows of the bodies: six each, then the multipliers of the joints of outer bodies."""
    slot, place, lock = (np.zeros(len(arrays.bodies), np.int64) for _ in range(3))
    kept, sizes = [], []
    for own in members:
        rows: list[int] = []
        for k, i in enumerate(own):
            slot[i], place[i] = 6 * k, len(rows)
            rows += range(6 * k, 6 * k + (6 if role[i] == OUTER else count_free(arrays.bodies[i])))
        size = 6 * len(own)
        for i in own:
            if role[i] == OUTER:
                lock[i] = size
                rows += range(size, size + 6 - count_free(arrays.bodies[i]))
                size += 6 - count_free(arrays.bodies[i])
        kept.append(np.array(rows, np.int64))
        sizes.append(size)
    return GroupRows(slot, place, lock, kept, sizes)


def place_away_from_home(
    arrays: Arrays,
    role: NDArray[np.int64],
    found: Groups,
    home: NDArray[np.int64],
    loose: Sequence[Sequence[int]],
    loads: list[list[int]],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Add every load to the groups of its *loose* bodies, those that it does not tie, if these are neither at home nor
    next to it inward. Return the columns (nb,) of such bodies in the border, and their number (nb,).
    """
    column, columns = np.full(len(arrays.bodies), -1), np.zeros(len(arrays.bodies), np.int64)
    for e, own in enumerate(loose):
        at_home = {home[e], found.inward[home[e]]} if home[e] >= 0 else set()
        away = [i for i in own if role[i] != FIXED and found.of[i] not in at_home]
        for g in {int(found.of[i]) for i in away}:
            loads[g].append(e)
        for i in away if home[e] >= 0 else ():
            if column[i] < 0:
                column[i] = columns.sum()
                alone = arrays.bodies[i]["nv"] == 1 and role[arrays.bodies[i]["parent"]] == FIXED
                columns[i] = 1 if alone else 6
    return column, columns


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

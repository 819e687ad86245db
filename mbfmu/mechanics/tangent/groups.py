"""Groups of bodies for the structured elimination, found from what ties bodies to each other: see the package.

Bodies are put in layers by their distance from a root, a joint or an element being a step. Those of one layer that hang
together by way of layers further out are one group, and every group has one neighbor inward: the groups form a tree
(a layering tree: Chepoi and Dragan 2000), a chain's a path, a star's a star. Then neighbors are merged into blocks:
the elimination costs some calls a group, and condensation within a group costs little.

The columns of a mesh's grid are groups as they are.
"""

from __future__ import annotations

from collections.abc import Set
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from mbfmu.mechanics.builder.bodies import Body
    from mbfmu.mechanics.builder.mechanism import Mechanism

MAX_BLOCK_BODIES = 12  # bodies up to which neighboring groups are merged


class Groups(NamedTuple):
    """Which group every body is in, and where each leads."""

    of: NDArray[np.int64]  # (nb,), outer groups first; of a body that does not move any
    inward: NDArray[np.int64]  # (groups,) the neighbor inward, a larger number; -1: there is none


def find_groups(mechanism: Mechanism, locked: Set[int] = frozenset()) -> Groups:
    """Return groups such that every joint and element lies within one or between one and its neighbor inward.

    ``locked`` are the numbers of bodies whose joints are locked.
    """
    moving = moving_bodies(mechanism, locked)
    cells, columns = cell_of(mechanism, moving)
    near = neighbors(mechanism, moving, cells)
    roots = [own[-1] for own in columns if own] + sorted(near)
    layer = layers(near, roots)
    group, inward = layering_tree(near, layer)
    whole = {group[cell] for own in columns for cell in own}
    merged = blocks(group, inward, whole)
    depth = {group[cell]: layer[cell] for cell in near}
    kept = sorted((g for g in inward if merged[g] == g), key=lambda g: (-depth[g], g))
    number = {g: k for k, g in enumerate(kept)}
    of = [number[merged[group[cells[i]]]] if moves else 0 for i, moves in enumerate(moving)]
    further = [number[merged[inward[g]]] if inward[g] >= 0 else -1 for g in kept]
    return Groups(np.array(of, np.int64), np.array(further, np.int64))


def moving_bodies(mechanism: Mechanism, locked: Set[int]) -> list[bool]:
    """Return which bodies move by coordinates that are free; not by those of joints that are ``locked``."""
    moving = [False]
    for body in mechanism.bodies[1:]:
        free = body.joint.drive is None and body.joint.nv > 0 and body.index not in locked
        moving.append(moving[body.parent] or free)
    return moving


def cell_of(mechanism: Mechanism, moving: list[bool]) -> tuple[dict[int, int], list[list[int]]]:
    """Return a number for every moving body, one for those that are to stay together, and the numbers of every mesh.

    Together stay the columns of a mesh, each with what is welded to it, and a body without mass and one it carries. A
    number is that of one of the bodies.
    """
    cells = {i: i for i, moves in enumerate(moving) if moves}
    columns: list[list[int]] = []
    for mesh in mechanism.meshes:
        nodes = mesh.nodes if mesh.along == 0 else tuple(zip(*mesh.nodes, strict=True))
        own = [[body.index for body in column if moving[body.index]] for column in nodes]
        columns.append([column[0] for column in own if column])
        cells |= {i: column[0] for column in own for i in column}
    in_meshes = {body.index for mesh in mechanism.meshes for row in mesh.nodes for body in row}
    for body in mechanism.bodies[1:]:
        pair = (body.index, body.parent)
        if body.joint.nv == 0 and all(moving[i] for i in pair) and len(in_meshes.intersection(pair)) == 1:
            holder, node = pair if pair[1] in in_meshes else pair[::-1]
            if cells[holder] == holder:
                cells[holder] = cells[node]
    for body in reversed(mechanism.bodies[1:]):  # a chain of those without mass ends in the cell of what it carries
        holder = body.parent
        if moving[holder] and cells[holder] == holder and is_massless(mechanism.bodies[holder]):
            cells[holder] = cells[body.index]
    return cells, columns


def is_massless(body: Body) -> bool:
    """Whether a body has no inertia: a block of such bodies is singular, the mass is in that of its child."""
    return body.mass == 0.0 and not body.inertia.any()


def neighbors(mechanism: Mechanism, moving: list[bool], cells: dict[int, int]) -> dict[int, set[int]]:
    """Return the cells that joints, cut joints, couplings and loads tie every cell to."""
    ties: list[list[int]] = [[body.index, body.parent] for body in mechanism.bodies[1:]]
    ties += [[cut.a.index, cut.b.index] for cut in mechanism.cuts]
    for coupling in mechanism.couplings:
        free = [end for end in (coupling.a, coupling.b) if end.joint.drive is None]
        ties.append([i for end in free for i in (end.index, end.parent)])
    ties += [[body.index for body in acting.tied] for acting in mechanism.loads() if not acting.load.on_joint]
    near: dict[int, set[int]] = {cell: set() for cell in cells.values()}
    for tie in ties:
        tied = {cells[i] for i in tie if moving[i]}
        for cell in tied:
            near[cell] |= tied - {cell}
    return near


def layers(near: dict[int, set[int]], roots: list[int]) -> dict[int, int]:
    """Return the distance of every cell from the first of the ``roots`` in its connected component."""
    layer: dict[int, int] = {}
    for root in roots:
        if root in layer:
            continue
        layer[root], front = 0, [root]
        while front:
            reached = []
            for cell in front:
                for other in sorted(near[cell]):
                    if other not in layer:
                        layer[other] = layer[cell] + 1
                        reached.append(other)
            front = reached
    return layer


def layering_tree(near: dict[int, set[int]], layer: dict[int, int]) -> tuple[dict[int, int], dict[int, int]]:
    """Return the group of every cell, named by one of its cells, and the neighbor inward of every group; -1: none."""
    joined = {cell: cell for cell in near}  # towards the representative of the connected component

    def name(cell: int) -> int:
        while joined[cell] != cell:
            joined[cell] = joined[joined[cell]]
            cell = joined[cell]
        return cell

    by_layer: list[list[int]] = [[] for _ in range(1 + max(layer.values(), default=-1))]
    for cell in near:
        by_layer[layer[cell]].append(cell)
    group: dict[int, int] = {}
    inward: dict[int, int] = {}
    outer: list[int] = []  # groups of the layer before
    for cells in reversed(by_layer):
        for cell in cells:
            for other in near[cell]:
                if layer[other] >= layer[cell]:
                    joined[name(other)] = name(cell)
        first: dict[int, int] = {}
        for cell in cells:
            group[cell] = first.setdefault(name(cell), cell)
        for g in outer:
            inward[g] = first[name(g)]
        outer = list(first.values())
    inward |= dict.fromkeys(outer, -1)
    return group, inward


def blocks(group: dict[int, int], inward: dict[int, int], whole: set[int]) -> dict[int, int]:
    """Return the block of every group, named by its innermost; those in ``whole`` are blocks already."""
    size = dict.fromkeys(inward, 0)
    for g in group.values():
        size[g] += 1
    block = {g: g for g in inward}
    for g, inner in inward.items():  # outer ones come first
        if inner >= 0 and not {g, inner} & whole and size[g] + size[inner] <= MAX_BLOCK_BODIES:
            block[g] = inner
            size[inner] += size[g]
    for g in reversed(list(inward)):
        block[g] = block[block[g]]
    return block

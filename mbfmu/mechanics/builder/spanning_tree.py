"""Choice of the spanning tree of a mechanism that is declared as a graph.

Short loops are fast: the constraint equations of a cut joint depend on the coordinates of its loop only. To find the
spanning tree with the least total length of its loops is NP-hard [DPK]. Here a tree of shortest paths from the ground
is improved by exchanges of one joint of the tree and one that closes a loop [ALM].
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

MAX_COMPARISONS = 2_000_000  # of two loops, in the search for better trees: about 1 s


class Rank(IntEnum):
    """Order in which joints enter the tree."""

    BODY = 0  # joint with which a body is declared: always in the tree
    COORDINATE = 1  # its coordinates are used, or there is no such cut joint
    START = 2  # it has start values
    FREE = 3  # either
    UNCONSTRAINED = 4  # it has no constraint equations, so that it closes no loop


class Edge(NamedTuple):
    """A joint between two bodies, by their numbers."""

    a: int
    b: int
    rank: Rank
    rows: int  # constraint equations of its cut joint


class Tree(NamedTuple):
    """Numbers of the edges of a spanning tree, and of those that close loops; both in the order of the edges."""

    inside: list[int]
    closing: list[int]


class Components:
    """Sets of connected bodies (union-find)."""

    def __init__(self, count: int) -> None:
        self._root = list(range(count))

    def find(self, i: int) -> int:
        """Return the representative of the set of body i."""
        while self._root[i] != i:
            self._root[i] = self._root[self._root[i]]
            i = self._root[i]
        return i

    def join(self, i: int, j: int) -> bool:
        """Unite the sets of two bodies; return whether they were different."""
        i, j = self.find(i), self.find(j)
        self._root[max(i, j)] = min(i, j)
        return i != j


def choose_tree(count: int, edges: Sequence[Edge]) -> Tree:
    """Return the spanning tree of ``count`` bodies, the ground first; see the module.

    Edges of a lower rank enter first, those of equal rank by their distance from the ground, then in their order. The
    edges of rank FREE are then exchanged while the total length of the loops decreases, or, with the same total length,
    the number of constraint equations. If not all bodies are connected, the tree is that of every part.
    """
    distance = distances(count, edges)

    def order(e: int) -> tuple[int, int, int, int]:
        near, far = sorted((distance[edges[e].a], distance[edges[e].b]))
        return edges[e].rank, far, near, e

    parts = Components(count)
    inside = {e for e in sorted(range(len(edges)), key=order) if parts.join(edges[e].a, edges[e].b)}
    _shorten_loops(count, edges, inside)
    return Tree(sorted(inside), [e for e in range(len(edges)) if e not in inside])


def distances(count: int, edges: Sequence[Edge]) -> list[int]:
    """Return the number of joints between the ground and every body; ``count`` where there is no connection."""
    near: list[list[int]] = [[] for _ in range(count)]
    for edge in edges:
        near[edge.a].append(edge.b)
        near[edge.b].append(edge.a)
    found, waiting = [count] * count, deque([0])
    found[0] = 0
    while waiting:
        i = waiting.popleft()
        for j in near[i]:
            if found[j] == count:
                found[j] = found[i] + 1
                waiting.append(j)
    return found


def orient(count: int, edges: Sequence[Edge], inside: Sequence[int]) -> list[int]:
    """Return the number of the edge towards the ground of every body; -1: the ground, or it is not connected to it."""
    near: list[list[tuple[int, int]]] = [[] for _ in range(count)]
    for e in inside:
        near[edges[e].a].append((edges[e].b, e))
        near[edges[e].b].append((edges[e].a, e))
    found, waiting = [-1] * count, deque([0])
    while waiting:
        i = waiting.popleft()
        for j, e in near[i]:
            if j != 0 and found[j] < 0:
                found[j] = e
                waiting.append(j)
    return found


def _shorten_loops(count: int, edges: Sequence[Edge], inside: set[int]) -> None:
    """Exchange edges of the tree ``inside``; a loop is a set of edges, kept as the bits of a whole number."""
    closing = [e for e in range(len(edges)) if e not in inside and Rank.COORDINATE < edges[e].rank <= Rank.FREE]
    loops = _loops(count, edges, inside, closing)
    through: dict[int, set[int]] = {}  # closing edges whose loops contain an edge
    for e, loop in loops.items():
        for k in _bits(loop):
            through.setdefault(k, set()).add(e)
    free = sum(1 << e for e, edge in enumerate(edges) if edge.rank == Rank.FREE)
    left, improved = MAX_COMPARISONS, True
    while improved and left > 0:
        improved = False
        for c in closing:
            if c in inside:
                continue
            own, best = loops[c], (0, 0, -1)
            for t in _bits(own & free & ~(1 << c)):
                others = through[t] - {c}
                left -= len(others) + 1
                length = sum((loops[e] ^ own).bit_count() - loops[e].bit_count() for e in others)
                best = min(best, (length, edges[t].rows - edges[c].rows, t))
            if best < (0, 0, -1):
                _exchange(c, best[2], loops, through)
                inside.remove(best[2])
                inside.add(c)
                improved = True
        closing = sorted(loops)


def _exchange(c: int, t: int, loops: dict[int, int], through: dict[int, set[int]]) -> None:
    """Let edge t of the tree close a loop in place of edge c."""
    own = loops.pop(c)
    for e in through[t] - {c}:
        _replace(e, loops[e], loops[e] ^ own, through)
        loops[e] ^= own
    loops[t] = own
    for k in _bits(own):
        through[k].discard(c)
        through[k].add(t)


def _replace(e: int, old: int, new: int, through: dict[int, set[int]]) -> None:
    """Note that the loop that edge e closes has changed."""
    for k in _bits(old & ~new):
        through[k].discard(e)
    for k in _bits(new & ~old):
        through.setdefault(k, set()).add(e)


def _loops(count: int, edges: Sequence[Edge], inside: set[int], closing: Sequence[int]) -> dict[int, int]:
    """Return the loop of every closing edge: the edges on the paths of its bodies to the ground that are not common."""
    if not closing:
        return {}
    towards = orient(count, edges, sorted(inside))
    paths: dict[int, int] = {}

    def path(i: int) -> int:
        way = []
        while i not in paths and towards[i] >= 0:
            way.append(i)
            i = sum(edges[towards[i]][:2]) - i
        total = paths.setdefault(i, 0)
        for j in reversed(way):
            total |= 1 << towards[j]
            paths[j] = total
        return total

    return {e: (path(edges[e].a) ^ path(edges[e].b)) | 1 << e for e in closing}


def _bits(number: int) -> list[int]:
    """Return the numbers of the bits that are set, in ascending order."""
    found = []
    while number:
        low = number & -number
        found.append(low.bit_length() - 1)
        number ^= low
    return found

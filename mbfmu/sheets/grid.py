"""Trees over the grid of a sheet: lists of nodes with their parents, parents first."""

from __future__ import annotations

from itertools import pairwise

Node = tuple[int, int]  # i, k
Link = tuple[Node, Node | None]  # a node and its parent in the tree; None: the support's body


def on_edge(shape: tuple[int, int], edge: str, n: int) -> Node:
    """Node number n of an edge."""
    along = 0 if edge[0] == "x" else 1
    end = 0 if edge[1] == "0" else shape[along] - 1
    return (end, n) if along == 0 else (n, end)


def around(shape: tuple[int, int]) -> list[Link]:
    """Tree from the middle node: a spine along x, ribs along z."""
    nx, nz = shape
    links: list[Link] = [((nx // 2, nz // 2), None)]
    for i, parent in [(nx // 2, None), *_outward(nx, nx // 2, nx // 2)]:
        if parent is not None:
            links.append(((i, nz // 2), (parent, nz // 2)))
        links += [((i, n), (i, m)) for n, m in _outward(nz, nz // 2, nz // 2)]
    return links


def from_edge(shape: tuple[int, int], edge: str, held: list[int], spine: bool) -> list[Link]:
    """Tree from the held nodes of an edge, line by line across the sheet."""
    along = 0 if edge[0] == "x" else 1
    lines = range(shape[along]) if edge[1] == "0" else range(shape[along] - 1, -1, -1)

    def node(line: int, n: int) -> Node:
        return (line, n) if along == 0 else (n, line)

    count, middle = shape[1 - along], held[len(held) // 2]
    links: list[Link] = [(node(lines[0], n), None) for n in held]
    links += [(node(lines[0], n), node(lines[0], m)) for n, m in _outward(count, held[0], held[-1])]
    for before, line in pairwise(lines):
        if spine:
            links.append((node(line, middle), node(before, middle)))
            links += [(node(line, n), node(line, m)) for n, m in _outward(count, middle, middle)]
        else:
            links += [(node(line, n), node(before, n)) for n in range(count)]
    return links


def _outward(count: int, low: int, high: int) -> list[tuple[int, int]]:
    """Pairs (number, neighbor nearer to low ... high) outside that range, outward."""
    return [(n, n + 1) for n in range(low - 1, -1, -1)] + [(n, n - 1) for n in range(high + 1, count)]

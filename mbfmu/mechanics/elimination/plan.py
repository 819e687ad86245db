"""The order in which the bodies of a mechanism with loops are eliminated, and what each front has: made once.

Variables are the motions of bodies (six components each), the coordinates that couplings relate, and the amplitudes of
flexible bodies, which the sections of one body share. A *front* belongs to one body; it eliminates the motion of that
body and the coordinates of its joint: those of a section are the amplitudes, which its parent eliminates, the first
section. Its *interface* are the variables
that remain: the motion of the parent, and what constraint equations connect that is not eliminated yet. What remains of
a front, its *message*, goes to the front that eliminates a variable of the interface first (multifrontal elimination,
Duff and Reid 1983). Bodies follow those they carry. Among the possible ones the body with the narrowest interface is
next, so that loops are closed one after the other.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

BODY_WIDTH = 6  # components of the motion of a body
GROUND = 0  # its motion is known, so that it is no variable

Variable = tuple[int, int]  # (body, -1): its motion; (body, k): coordinate k of its joint


def motion(body: int) -> Variable:
    """Return the variable of the motion of a body."""
    return body, -1


def width(variable: Variable) -> int:
    """Return the number of components of a variable."""
    return BODY_WIDTH if variable[1] < 0 else 1


@dataclass
class Front:
    """What is eliminated with one body.

    Attributes
    ----------
    body
        Its number.
    equations
        Numbers of the constraint equations that are complete here.
    messages
        Fronts whose messages arrive here, by position in the order.
    interface
        Variables that remain, in the order of their components.
    target
        Front that gets the message, by position in the order; -1: nothing remains.
    """

    body: int
    equations: list[int] = field(default_factory=list)
    messages: list[int] = field(default_factory=list)
    interface: list[Variable] = field(default_factory=list)
    target: int = -1

    @property
    def interface_width(self) -> int:
        """Number of components of the interface."""
        return sum(map(width, self.interface))


class Elimination:
    """Symbolic elimination of a graph of variables: which fronts there are, in their order.

    Parameters
    ----------
    parents
        Parent of every body (nb,), ground first.
    equations
        Variables of every constraint equation, none of the ground.
    amplitudes
        Number of coordinates of the parent that move a body, of sections of flexible bodies.
    """

    def __init__(
        self,
        parents: Sequence[int],
        equations: Sequence[Iterable[Variable]],
        amplitudes: Mapping[int, int] = MappingProxyType({}),
    ) -> None:
        self._parents, self._children = parents, np.bincount(np.asarray(parents[1:], int), minlength=len(parents))
        self._cliques: list[frozenset[Variable]] = []
        self._of: list[set[int]] = [set() for _ in parents]  # cliques with a variable of each body
        for i in range(1, len(parents)):
            shared = {(parents[i], k) for k in range(amplitudes.get(i, 0))}
            self._add({motion(i)} | ({motion(parents[i])} if parents[i] != GROUND else set()) | shared)
        self._first_equation = len(self._cliques)
        for variables in equations:
            self._add(set(variables))
        self._first_message = len(self._cliques)

    def _add(self, variables: set[Variable]) -> None:
        for body, _ in variables:
            self._of[body].add(len(self._cliques))
        self._cliques.append(frozenset(variables))

    def _remaining(self, body: int) -> set[Variable]:
        """Return the interface of a body if it is eliminated now."""
        found: set[Variable] = set()
        return {v for v in found.union(*(self._cliques[c] for c in self._of[body])) if v[0] != body}

    def _priority(self, body: int) -> tuple[int, int]:
        return sum(map(width, self._remaining(body))), -body

    def order(self) -> list[Front]:
        """Return the fronts in the order of elimination."""
        fronts: list[Front] = []
        senders: list[int] = []  # position of the front of each message
        ready = [(*self._priority(i), i) for i in range(1, len(self._parents)) if self._children[i] == 0]
        heapq.heapify(ready)
        done = [False] * len(self._parents)
        while ready:
            *priority, body = heapq.heappop(ready)
            if done[body] or tuple(priority) != self._priority(body):
                continue  # its interface has changed since
            done[body] = True
            front = Front(body, interface=sorted(self._remaining(body)))
            for clique in sorted(self._of[body]):
                if clique >= self._first_message:
                    front.messages.append(senders[clique - self._first_message])
                elif clique >= self._first_equation:
                    front.equations.append(clique - self._first_equation)
                for other, _ in self._cliques[clique]:
                    if other != body:
                        self._of[other].discard(clique)
            if front.interface:
                senders.append(len(fronts))
                self._add(set(front.interface))
            fronts.append(front)
            parent = self._parents[body]
            self._children[parent] -= 1
            for other in {v[0] for v in front.interface} | {parent}:
                if other != GROUND and self._children[other] == 0:
                    heapq.heappush(ready, (*self._priority(other), other))
        for k, front in enumerate(fronts):
            for sender in front.messages:
                fronts[sender].target = k
        return fronts


@dataclass
class Capacity:
    """How much memory each front may need: coordinates to eliminate, rows that arrive, directions that are delayed."""

    coordinates: NDArray[np.int64]
    rows: NDArray[np.int64]
    delayed: NDArray[np.int64]


def find_capacity(fronts: Sequence[Front], joint_coordinates: Sequence[int]) -> Capacity:
    """Return the memory that fronts need at most; ``joint_coordinates`` (nb,) are those of each body's joint that are
    free.

    No more rows and no more delayed directions remain than the interface has components, see :mod:`.front`.
    """
    count = len(fronts)
    found = Capacity(*(np.zeros(count, np.int64) for _ in range(3)))
    left = np.zeros(count, np.int64)
    for k, front in enumerate(fronts):
        found.coordinates[k] = joint_coordinates[front.body] + sum(int(found.delayed[i]) for i in front.messages)
        found.rows[k] = len(front.equations) + sum(int(left[i]) for i in front.messages)
        left[k] = min(front.interface_width, found.rows[k])
        found.delayed[k] = min(left[k], found.coordinates[k])
    return found

"""Groups of bodies for the structured elimination: see the package.

A sheet numbers the columns of its grid; every other body joins the group of the nearest body that has one.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.mechanism import Mechanism


def number_groups(mechanism: Mechanism) -> NDArray[np.int64]:
    """Return the group of every body (nb,), from zero and without gaps; joints and elements span neighbours at most.

    Where the given numbers do not allow that, groups are merged until they do.
    """
    bodies = mechanism.bodies
    fixed = [True]
    for body in bodies[1:]:
        fixed.append(fixed[body.parent] and (body.joint.drive is not None or body.joint.nv == 0))
    ties = [(b.index, b.parent) for b in bodies[1:] if not fixed[b.parent]]
    ties += [(c.a.index, c.b.index) for c in mechanism.cuts if not fixed[c.a.index] and not fixed[c.b.index]]
    ties += [
        (a.index, b.index)
        for _, force, a, b in mechanism.forces
        if not (force.on_joint or fixed[a.index] or fixed[b.index])
    ]
    spans = [*ties, *([body.index for body in nodes] for _, nodes in mechanism.plates)]
    spans += [[body.index for body in corners] for _, _, faces in mechanism.pressures for corners in faces]
    neighbours: list[list[int]] = [[] for _ in bodies]
    for a, b in ties:
        neighbours[a].append(b)
        neighbours[b].append(a)
    groups = [-1 if body.group is None else body.group for body in bodies]
    queue = deque(i for i, group in enumerate(groups) if group >= 0)
    while queue:
        i = queue.popleft()
        for j in neighbours[i]:
            if groups[j] < 0:
                groups[j] = groups[i]
                queue.append(j)
    own = np.array([max(group, 0) for group in groups])
    own[0] = own[1:].min(initial=0)
    numbers = np.unique(own, return_inverse=True)[1]
    merged = np.zeros(int(numbers.max(initial=0)) + 1, bool)  # group k with its predecessor
    for span in spans:
        low, high = min(numbers[list(span)]), max(numbers[list(span)])
        merged[low + 2 : high + 1] = True
    return (numbers - np.cumsum(merged)[numbers]).astype(np.int64)

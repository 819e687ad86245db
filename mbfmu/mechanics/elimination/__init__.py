"""Closed loops in relative coordinates in O(n): constraints eliminated along the tree, front by front.

The articulated-body recursion passes the inertia and the bias of a subtree to its parent. Here it also passes on the
constraint equations that the coordinates of the subtree cannot satisfy, and the few directions of coordinates that no
equation determines well enough yet::

    min 1/2 Y'^T M Y' + h^T v'    subject to    J v' = gamma                     accelerations
    min sum (dq / size)^2         subject to    J dq = -Phi,  or  nu - J v       corrections

over the coordinates of one body after the other. Each of these *fronts* is a small dense problem (:mod:`.front`). The
second line is the least-norm solution, that is the pseudo-inverse of J in units of the coordinates.

* :mod:`.plan` -- the order of the bodies, what remains of each front, and where it goes.
* :mod:`.records` -- fronts and memory as kernels take them.
* :mod:`.assembly` -- what a front is made of: inertia, equations, and the motion of its body in terms of the parent's.
* :mod:`.front` -- the elimination of its coordinates.
* :mod:`.message` -- what remains of it, restricted to where its equations hold.
* :mod:`.recursion` -- the two passes over all fronts, and the multipliers.
* :mod:`.eliminated` -- the callbacks of a solver.
* :mod:`.loops` -- closed positions, consistent velocities and redundant equations.
* :mod:`.right_sides` -- the same equations with other right-hand sides, for derivatives.

The work is proportional to the number of bodies if the interfaces are narrow: they are as wide as the number of bodies
whose motions are open at the same time. Equations may depend on each other, and bodies may have no mass, where a
combination of motions that constraints allow has.
"""

from __future__ import annotations

from .eliminated import eliminate_constraints, empty_elimination
from .loops import MAX_DENSE_LOOP_COORDINATES, EliminatedLoops, closes_by_elimination

__all__ = [
    "MAX_DENSE_LOOP_COORDINATES",
    "EliminatedLoops",
    "closes_by_elimination",
    "eliminate_constraints",
    "empty_elimination",
]

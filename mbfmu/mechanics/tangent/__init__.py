"""The linearized equations of motion of a large tree, assembled and solved in O(n): no matrix over all bodies.

For changes of the joint positions dq, of the velocities c1 dq and of the accelerations c2 dq, the change of the inverse
dynamics is d tau = T dq. T is dense in joint coordinates, because a joint moves everything beyond it. In the motions
y_i = (dr_i, dphi_i) of the bodies it is sparse: an element ties those at its corners, a joint two. With B y-columns of
the tree (y_i = X y_j + S dq, the same shift as in the recursions),

    T = B^T (c2 M + c1 D + K) B + G,

K the tangents of elements, forces and pressures, D of their damping, M the bodies' inertia at their origins, and G what
comes from turning the joints while they transmit the wrench W (S and X change with the position) and from forces along
their coordinates. Velocity products and drag are left out: exact at rest, and as a preconditioner at moderate
speeds. Steady states and modes while drives move need the rest too: :mod:`solvers.projection.saddle`
adds it by products of the whole residual by complex step.

A cut joint adds what its reactions gain as its bodies move, lambda dG, so that T is the derivative of h + J^T lambda.
On request it adds springs that hold it: T + J^T alpha J, with which a saddle-point system is solved if T is
singular (:mod:`solvers.projection.saddle`).

**Groups.** Every body belongs to a group; the groups form a tree such that joints and elements lie within a group or
between neighbors (:mod:`.groups`): the columns of a mesh's grid are a path. Unknowns of a group: dq
of joints whose parent is in the same group or fixed (inner), and of every other body (outer) its motion y and the
multipliers of the directions N its joint locks, N^T (y_i - X y_j) = 0. Inner bodies are condensed onto their parents by
the recursion itself, rows and columns alike, as in the composite-body algorithm. A joint of six coordinates locks
nothing, so behind it y is no more unknowns than dq, and needs no condensation: such bodies are outer wherever their
parent moves. What is left has a block for every group and for every two neighbors (:mod:`solvers.linalg.blocks`).

First-order states that depend on one joint coordinate, such as the bristle of a joint with friction, are condensed onto
this coordinate (:mod:`.states`). Other states are a Schur complement (:mod:`.coupled_states`).

A body that a load ties to many groups, such as a free roller that rubs on a mesh, is in a separate group, and its
coupling to the others is a border (:mod:`.border`).

T is symmetric at rest without follower loads; in motion the change of the inertia forces with the positions, small
compared with c2 M, is not. If its error is corrected iteratively it may be used as symmetric: one triangle, half the
memory.
"""

from __future__ import annotations

from .coupled_states import StateUse, coupled_states
from .factored import Tangent
from .groups import Groups, find_groups
from .missing import MissingTangent

__all__ = ["Groups", "MissingTangent", "StateUse", "Tangent", "coupled_states", "find_groups"]

"""Jumps of the velocities by impulses in large mechanisms with loops, in O(n).

With impulses p on the coordinates and Lambda of the constraints::

    M dv + J^T Lambda = p,    J dv = 0

are the equations of motion with p in place of the forces and without velocity-dependent terms. The elimination of
:mod:`mbfmu.mechanics.elimination` solves them with the inertia and the equations of one state. Only the part of p that
some allowed motion follows counts: p is projected onto these motions first, in units of the coordinates, which also
avoids the cancellation of p and J^T Lambda.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbfmu.mechanics.elimination.right_sides import solve_motion
from solvers.compiled.kernel import kernel
from solvers.positions import count_velocities
from solvers.projection.eliminated import (
    REDUNDANT_LENGTH,
    find_accelerations,
    find_velocity_correction,
    shortest_of,
)
from solvers.system import DROPPED_LENGTH

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.projection.eliminated import EliminationScratch
    from solvers.system import EliminationEquations

DEPENDENT_ROW_RATIO = 1e-10  # part of an impulse, relative to all of it, that moves nothing
UNDETERMINED_RATIO = 1e-9  # rate of a coordinate of a loop, relative to the largest of a jump, that is none
DETERMINED, IMMOBILE, UNRESOLVED = range(3)  # a jump; a motion has no mass; it depends on a singular configuration


@kernel
def project_impulse(
    eqs: EliminationEquations, t: float, q: Reals, v: Reals, p: Reals, drop: float, work: EliminationScratch
) -> bool:
    """work.tau (n,) <- -p without its part that no allowed motion follows; False: nothing is left of p (n,).

    The projection is the difference of the corrections of v and of velocities that differ from v by the impulses, in
    units of the coordinates: v may be inconsistent, as where the rate of a drive has just jumped.
    """
    size, moving, largest, speed, left = work.size, count_velocities(work.positions, p.shape[0]), 0.0, 0.0, 0.0
    for i in range(moving):
        largest, speed = max(largest, abs(size[i] * p[i])), max(speed, abs(v[i]) / size[i])
    if largest == 0.0:
        return False
    speed = speed if speed > 0.0 else 1.0
    find_velocity_correction(eqs, t, q, v, drop, work)
    for i in range(p.shape[0]):
        work.a_near[i] = work.change[i]
    for i in range(p.shape[0]):
        part = size[i] * p[i] / largest if i < moving else 0.0
        work.v_near[i] = v[i] + speed * size[i] * part
    find_velocity_correction(eqs, t, q, work.v_near, drop, work)
    for i in range(p.shape[0]):
        normal = (work.a_near[i] - work.change[i]) / (speed * size[i])
        part = size[i] * p[i] / largest - normal if i < moving else 0.0
        left = max(left, abs(part))
        work.tau[i] = -part * largest / size[i]
    return left > DEPENDENT_ROW_RATIO


@kernel
def find_jump(
    eqs: EliminationEquations, t: float, q: Reals, v: Reals, p: Reals, resolution: float, work: EliminationScratch,
    dv: Reals,
) -> int:  # fmt: skip
    """dv (n,) <- the jump by impulses p (n,) at a closed state (q, v); return whether it is determined.

    In a singular configuration, where an equation is no longer than ``resolution``, this equation is left out. The jump
    is determined there if it moves no coordinate of a loop: such equations do not restrict it. ``work`` has the rank of
    the motion.
    """
    report, size, rank = work.report, work.size, work.near[0].rank
    for i in range(dv.shape[0]):
        dv[i] = 0.0
    if not find_accelerations(eqs, t, q, v, False, work, work.qdot_near, work.a_near, work.lam_near):
        return IMMOBILE
    is_singular = rank > 0 and shortest_of(report, rank) <= resolution
    drop = max(report[DROPPED_LENGTH], resolution if is_singular else REDUNDANT_LENGTH)
    if not project_impulse(eqs, t, q, v, p, drop, work):
        return DETERMINED
    if not solve_motion(eqs.elimination, work.tau, work.zero_lam, drop, dv, work.lam_near, report):
        return IMMOBILE
    largest, in_loops = 0.0, 0.0
    for i in range(count_velocities(work.positions, dv.shape[0])):
        largest = max(largest, abs(dv[i]) / size[i])
        in_loops = max(in_loops, eqs.in_loops[i] * abs(dv[i]) / size[i])
    return UNRESOLVED if is_singular and in_loops > UNDETERMINED_RATIO * largest else DETERMINED

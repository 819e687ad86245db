"""Constraints of a wheel that rolls: a circle of body b, or a torus, on a surface of body a with the normal n.

The wheel has the center Q and the axle e. With s = |e x n|, the directions::

    t = e x n / s   longitudinal: where the wheel heads       l = n x t   lateral       u = e x t   from Q downwards

and the crown radius c the lowest point of the wheel is C = Q + (R - c) u - c n, whether it touches the surface or not.
S is a point of the surface, n its normal there, and n.(C - S) the distance of the wheel to the surface. With the
velocity V at C of the wheel relative to the surface, both taken as rigid::

    Phi = n.(Q - S) - (R - c) s - c,    Phi' = n.V        distance to the surface: a holonomic constraint
    t.V = 0,    l.V = 0                                   no slip: nonholonomic constraints, which have no Phi

C is a point of neither body. For each direction d = n, t, l, with the rates n' and e' = w_b x e::

    (d.V)' = d.(v'_b + w'_b x (C - O_b) - v'_a - w'_a x (C - O_a)) + d.(w_b x (C' - v_b) - w_a x (C' - v_a)) + d'.V

[P] section 2.4 for disks, [BCPR] for toroidal wheels.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.spatial import arm
from mbfmu.mechanics.wheels import add3, cross3, dot3, heading
from solvers.compiled.kernel import kernel
from solvers.compiled.record import f8, i8

from .base import CutJointRecord

if TYPE_CHECKING:
    from mbfmu.mechanics.records import MotionRecord, RowRecord, State


class RollingWheelRecord(CutJointRecord):
    """Parameters of :class:`.RollingWheel`; the normal of a plane is the last axis of Ra, the axle that of Rb."""

    radius: f8  # of the circle in the middle of the torus, m
    crown: f8  # m
    longitudinal: i8  # 1: no slip in this direction
    lateral: i8
    longitudinal_friction: f8  # coefficient of friction in this direction; 0: it is not compared
    lateral_friction: f8


@kernel
def roll(
    cut: RollingWheelRecord, A: MotionRecord, B: MotionRecord, n: Any, dn: Any, above: Any, row: int, state: State
) -> None:
    """Rows of a wheel on a surface with the normal n, its rate n' and the vector Q - S, called ``above``."""
    radius, crown = cut.radius, cut.crown
    va, wa = (A.Y[0], A.Y[1], A.Y[2]), (A.Y[3], A.Y[4], A.Y[5])
    vb, wb = (B.Y[0], B.Y[1], B.Y[2]), (B.Y[3], B.Y[4], B.Y[5])
    e, center = arm(B, cut.Rb[:, 2]), arm(B, cut.Pb)
    s, t, u, dt, du = heading_rates(e, n, cross3(wb, e), dn)
    at_b = add3(add3(center, radius, u), -crown, n)  # C - O_b
    apart = B.r[0] - A.r[0], B.r[1] - A.r[1], B.r[2] - A.r[2]
    at_a = add3(at_b, 1.0, apart)
    moving = add3(add3(cross3(wb, center), radius, du), -crown, dn)  # C' - v_b
    onward = add3(add3(moving, 1.0, vb), -1.0, va)
    V = add3(add3(add3(cross3(wb, at_b), -1.0, cross3(wa, at_a)), 1.0, vb), -1.0, va)
    turning = add3(cross3(wb, moving), -1.0, cross3(wa, onward))
    fill_row(state.rows[row], n, at_a, at_b, dot3(n, above) - radius * s - crown, dot3(n, turning) + dot3(dn, V))
    own = row + 1
    if cut.longitudinal == 1:
        fill_row(state.rows[own], t, at_a, at_b, 0.0 * s, dot3(t, turning) + dot3(dt, V))
        own += 1
    if cut.lateral == 1:
        side, d_side = cross3(n, t), add3(cross3(dn, t), 1.0, cross3(n, dt))
        fill_row(state.rows[own], side, at_a, at_b, 0.0 * s, dot3(side, turning) + dot3(d_side, V))


@kernel
def heading_rates(e: Any, n: Any, de: Any, dn: Any) -> Any:
    """s, t and u of an axle e and a normal n, and the rates of t and u."""
    s, t, u = heading(e, n)
    d_across = add3(cross3(de, n), 1.0, cross3(e, dn))
    ds = dot3(t, d_across)
    dt = (d_across[0] - ds * t[0]) / s, (d_across[1] - ds * t[1]) / s, (d_across[2] - ds * t[2]) / s
    return s, t, u, dt, add3(cross3(de, t), 1.0, cross3(e, dt))


@kernel
def fill_row(row: RowRecord, d: Any, at_a: Any, at_b: Any, Phi: Any, bias: Any) -> None:
    """One row along d at the point that is ``at_a`` and ``at_b`` from the origins of the bodies."""
    ma, mb = cross3(at_a, d), cross3(at_b, d)
    row.Phi, row.bias = Phi, bias
    for k in range(3):
        row.Ga[k], row.Gb[k] = -d[k], d[k]
        row.Ga[3 + k], row.Gb[3 + k] = -ma[k], mb[k]

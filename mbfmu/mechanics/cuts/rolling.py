"""Rolling wheel: a circle of body b, or a torus, touches a plane of body a and does not slip on it.

The wheel has the center Q and the axle e, the plane the point P and the normal n. With s = |e x n|, the directions::

    t = e x n / s   longitudinal: where the wheel heads       l = n x t   lateral       u = e x t   from Q downwards

and the crown radius c the lowest point of the wheel is C = Q + (R - c) u - c n, whether it touches the plane or not.
With the velocity V at C of the wheel relative to the plane, both taken as rigid::

    Phi = n.(Q - P) - (R - c) s - c,    Phi' = n.V        distance to the plane: a holonomic constraint
    t.V = 0,    l.V = 0                                   no slip: nonholonomic constraints, which have no Phi

C is a point of neither body. For each direction d = n, t, l, with n' = w_a x n and e' = w_b x e::

    (d.V)' = d.(v'_b + w'_b x (C - O_b) - v'_a - w'_a x (C - O_a)) + d.(w_b x (C' - v_b) - w_a x (C' - v_a)) + d'.V

[P] section 2.4 for disks, [BCPR] for toroidal wheels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.axes import unit_axis
from mbfmu.mechanics.checks import Matrix, one_of
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import MAX_LENGTH, MIN_LENGTH, is_finite
from mbfmu.mechanics.spatial import arm
from mbfmu.mechanics.wheels import add3, cross3, dot3, heading
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel
from solvers.compiled.record import f8, i8

from .base import CutJoint, CutJointRecord, with_axis_last

if TYPE_CHECKING:
    from mbfmu.mechanics.records import MotionRecord, RowRecord, State

GRIPS = {"both": ("longitudinal", "lateral"), "longitudinal": ("longitudinal",), "lateral": ("lateral",)}


class RollingWheelRecord(CutJointRecord):
    """Parameters of :class:`RollingWheel`; the normal is the last axis of Ra, the axle that of Rb."""

    radius: f8  # of the circle in the middle of the torus, m
    crown: f8  # m
    longitudinal: i8  # 1: no slip in this direction
    lateral: i8
    longitudinal_friction: f8  # coefficient of friction in this direction; 0: it is not compared
    lateral_friction: f8


@kernel
def evaluate(cut: RollingWheelRecord, A: MotionRecord, B: MotionRecord, row: int, state: State) -> None:
    """See :mod:`.base`."""
    radius, crown = cut.radius, cut.crown
    va, wa = (A.Y[0], A.Y[1], A.Y[2]), (A.Y[3], A.Y[4], A.Y[5])
    vb, wb = (B.Y[0], B.Y[1], B.Y[2]), (B.Y[3], B.Y[4], B.Y[5])
    n, e, center = arm(A, cut.Ra[:, 2]), arm(B, cut.Rb[:, 2]), arm(B, cut.Pb)
    dn, de = cross3(wa, n), cross3(wb, e)
    d_across = add3(cross3(de, n), 1.0, cross3(e, dn))
    s, t, u = heading(e, n)
    ds = dot3(t, d_across)
    dt = (d_across[0] - ds * t[0]) / s, (d_across[1] - ds * t[1]) / s, (d_across[2] - ds * t[2]) / s
    du = add3(cross3(de, t), 1.0, cross3(e, dt))
    at_b = add3(add3(center, radius, u), -crown, n)  # C - O_b
    apart = B.r[0] - A.r[0], B.r[1] - A.r[1], B.r[2] - A.r[2]
    at_a = add3(at_b, 1.0, apart)
    moving = add3(add3(cross3(wb, center), radius, du), -crown, dn)  # C' - v_b
    onward = add3(add3(moving, 1.0, vb), -1.0, va)
    V = add3(add3(add3(cross3(wb, at_b), -1.0, cross3(wa, at_a)), 1.0, vb), -1.0, va)
    turning = add3(cross3(wb, moving), -1.0, cross3(wa, onward))
    height = add3(add3(center, 1.0, apart), -1.0, arm(A, cut.Pa))
    fill_row(state.rows[row], n, at_a, at_b, dot3(n, height) - radius * s - crown, dot3(n, turning) + dot3(dn, V))
    own = row + 1
    if cut.longitudinal == 1:
        fill_row(state.rows[own], t, at_a, at_b, 0.0 * s, dot3(t, turning) + dot3(dt, V))
        own += 1
    if cut.lateral == 1:
        side, d_side = cross3(n, t), add3(cross3(dn, t), 1.0, cross3(n, dt))
        fill_row(state.rows[own], side, at_a, at_b, 0.0 * s, dot3(side, turning) + dot3(d_side, V))


@kernel
def fill_row(row: RowRecord, d: Any, at_a: Any, at_b: Any, Phi: Any, bias: Any) -> None:
    """One row along d at the point that is ``at_a`` and ``at_b`` from the origins of the bodies."""
    ma, mb = cross3(at_a, d), cross3(at_b, d)
    row.Phi, row.bias = Phi, bias
    for k in range(3):
        row.Ga[k], row.Gb[k] = -d[k], d[k]
        row.Ga[3 + k], row.Gb[3 + k] = -ma[k], mb[k]


@dataclass(frozen=True, kw_only=True)
class RollingWheel(CutJoint):
    """Wheel of body b that rolls without slip on a plane of body a.

    The constraint is bilateral: the wheel cannot lift, and a run warns if its plane would have to pull it. The axle
    must not become normal to the plane.

    Parameters
    ----------
    radius
        Outer radius of the wheel, m.
    crown_radius
        Radius of the cross-section of its tire, m; 0: the wheel is a thin disk.
    normal
        Normal of the plane, on the side of the wheel: ``"x"``, ``"y"``, ``"z"`` or three numbers in the cut frame of
        body a; ``at_a`` is a point of the plane.
    axis
        Axle: the same in the cut frame of body b; ``at_b`` is the center of the wheel. With the normal up and the axle
        to the left the wheel heads forward.
    friction
        Coefficient of friction, or two: longitudinal and lateral. The motion does not depend on it, but a run warns if
        the wheel would slip: if (F_longitudinal / mu_longitudinal)^2 + (F_lateral / mu_lateral)^2 > N^2 with the normal
        force N. None: the forces are not compared.
    grip
        Directions without slip: ``"both"``, ``"longitudinal"`` (a wheel with rollers at its rim) or ``"lateral"`` (a
        skate).
    """

    record = RollingWheelRecord
    drawn = "wheel"
    evaluate = evaluate

    radius: float
    crown_radius: float = 0.0
    normal: Any = "z"
    axis: Any = "y"
    grip: str = "both"
    friction: float | tuple[float, float] | None = None

    @property
    def rows(self) -> tuple[str, ...]:  # type: ignore[override]
        """Suffix of each row's name."""
        return ("normal", *self.nonholonomic)

    @property
    def units(self) -> tuple[str, ...]:  # type: ignore[override]
        """Unit of each row's multiplier."""
        return ("N",) * len(self.rows)

    @property
    def nonholonomic(self) -> tuple[str, ...]:  # type: ignore[override]
        """Rows that restrict velocities only."""
        return GRIPS[self.grip]

    def check(self, what: str) -> None:
        """Refuse what is no wheel and no direction."""
        if not (is_finite(self.radius) and np.ndim(self.radius) == 0 and MIN_LENGTH <= self.radius <= MAX_LENGTH):
            raise UserError(f"radius of {what} is {self.radius!r} m; allowed: {MIN_LENGTH:g} to {MAX_LENGTH:g}")
        crown = self.crown_radius
        if not (is_finite(crown) and np.ndim(crown) == 0 and 0.0 <= crown <= self.radius):
            raise UserError(f"crown_radius of {what} is {crown!r} m; allowed: 0 to the radius, {self.radius:g}")
        unit_axis(self.normal, f"normal of {what}")
        unit_axis(self.axis, f"axis of {what}")
        one_of(f"grip of {what}", self.grip, tuple(GRIPS))
        if self.friction is None:
            return
        if not (
            is_finite(self.friction)
            and np.shape(self.friction) in ((), (2,))
            and np.all(np.greater(self.friction, 0.0))
        ):
            raise UserError(
                f"friction of {what} is {self.friction!r}; allowed: a positive number, or two (longitudinal, lateral)"
            )

    def frames(self, what: str = "a rolling wheel") -> tuple[Matrix, Matrix]:
        """Return the cut frames as columns in bodies a and b; the last axes are the normal and the axle."""
        Ra, Rb = super().frames(what)
        return with_axis_last(Ra, self.normal, what), with_axis_last(Rb, self.axis, what)

    def fill(self, record: Any, site: Attachment) -> None:
        """Write points, axes, radii and rows."""
        super().fill(record, site)
        record["radius"], record["crown"] = self.radius - self.crown_radius, self.crown_radius
        for direction in GRIPS["both"]:
            record[direction] = direction in self.nonholonomic
        if self.friction is not None:
            record["longitudinal_friction"], record["lateral_friction"] = np.broadcast_to(self.friction, 2)

    def extent(self) -> float:
        """Return the radius."""
        return self.radius

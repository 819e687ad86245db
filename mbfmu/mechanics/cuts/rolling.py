"""Rolling wheel: a circle of body b, or a torus, touches a surface of body a and does not slip on it.

The surface is a plane through the point P, or a profile. Equations: :mod:`.rolling_rows`, :mod:`.rolling_profile`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics import law
from mbfmu.mechanics.axes import unit_axis
from mbfmu.mechanics.checks import Matrix, one_of
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import MAX_LENGTH, MIN_LENGTH, is_finite
from mbfmu.mechanics.spatial import arm
from mbfmu.mechanics.wheels import add3, cross3
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel

from .base import CutJoint, with_axis_last
from .profile import Profile
from .rolling_profile import RollingProfileRecord, evaluate_on_table, kernels_of_function, monitor_on_table
from .rolling_rows import RollingWheelRecord, roll

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State

GRIPS = {"both": ("longitudinal", "lateral"), "longitudinal": ("longitudinal",), "lateral": ("lateral",)}
MAX_PROFILE_AXIS_COSINE = 1e-6  # of the angle between profile_axis and normal


@kernel
def evaluate(cut: RollingWheelRecord, A: MotionRecord, B: MotionRecord, row: int, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`. On a plane S is the point P, and n' = w_a x n."""
    n = arm(A, cut.Ra[:, 2])
    apart = B.r[0] - A.r[0], B.r[1] - A.r[1], B.r[2] - A.r[2]
    above = add3(add3(arm(B, cut.Pb), 1.0, apart), -1.0, arm(A, cut.Pa))
    roll(cut, A, B, n, cross3((A.Y[3], A.Y[4], A.Y[5]), n), above, row, state)


class RollingOnTable(CutJoint):
    """Record and kernel of a wheel on a profile through points."""

    record = RollingProfileRecord
    evaluate = evaluate_on_table
    monitor = monitor_on_table


@dataclass(frozen=True, kw_only=True)
class RollingWheel(CutJoint):
    """Wheel of body b that rolls without slip on a plane of body a, or on a cylindrical surface with a profile.

    The constraint is bilateral: the wheel cannot lift, and a run warns if the surface would have to pull it. The axle
    must not become normal to the surface. A wheel on a profile touches it at one place only: its radius is below the
    radius of curvature of all troughs.

    Parameters
    ----------
    radius
        Outer radius of the wheel, m.
    crown_radius
        Radius of the cross-section of its tire, m; 0: the wheel is a thin disk.
    normal
        Normal of the plane, on the side of the wheel: ``"x"``, ``"y"``, ``"z"`` or three numbers in the cut frame of
        body a; ``at_a`` is a point of the plane. For a profile the direction of its height.
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
    profile
        Height of the surface over the plane as a function of the distance x along ``profile_axis`` from ``at_a``, m; it
        is constant along the third direction. ``Table`` of points, which must be smooth; a function ``lambda x: ...``
        or an expression ``"0.1 * cos(3 * x)"``, differentiated by differences. None: a plane.
    profile_axis
        Direction of x: as ``normal``, to which it is perpendicular.
    profile_interval
        Least and greatest x where the wheel may touch the profile, m; required for a function. The profile continues
        straight beyond, and a run warns of a wheel that gets there. None: a table's ``beyond`` is its continuation, and
        a run warns if this is ``"linear"``.
    profile_width
        For a function: distance over which it changes noticeably, m; None: the radius of the wheel.
    """

    record = RollingWheelRecord
    variants = (RollingOnTable,)
    planes = "a"
    drawn = "wheel"
    evaluate = evaluate

    radius: float
    crown_radius: float = 0.0
    normal: Any = "z"
    axis: Any = "y"
    grip: str = "both"
    friction: float | tuple[float, float] | None = None
    profile: Any = None
    profile_axis: Any = "x"
    profile_interval: Any = None
    profile_width: float | None = None

    def __post_init__(self) -> None:
        """Take the kernel of a profile."""
        if self.profile is not None:
            self.become(RollingOnTable)
            if isinstance(self.profile, str) or (callable(self.profile) and not isinstance(self.profile, type)):
                kernels = kernels_of_function(law.law_of("profile of a wheel", self.profile, ("x",)))
                object.__setattr__(self, "evaluate", kernels.evaluate)
                object.__setattr__(self, "monitor", kernels.monitor)

    @cached_property
    def surface(self) -> Profile | None:
        """Profile with its interval; None: a plane."""
        if self.profile is None:
            return None
        width = self.radius if self.profile_width is None else self.profile_width
        return Profile(self.profile, self.profile_interval, width)

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
        for own in ("profile_interval", "profile_width"):
            if self.profile is None and getattr(self, own) is not None:
                raise UserError(f"{own} of {what} is given without a profile; give a profile, or leave it out")
        if self.surface is not None:
            self._axis_across(what)
            self.surface.check(what, self.radius)
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
        if self.surface is None:
            return with_axis_last(Ra, self.normal, what), with_axis_last(Rb, self.axis, what)
        across = self._axis_across(what)
        normal = unit_axis(self.normal, f"normal of {what}")
        return Ra @ np.column_stack((np.cross(across, normal), across, normal)), with_axis_last(Rb, self.axis, what)

    def _axis_across(self, what: str) -> Any:
        """Return the unit vector of the generators of a profile: normal x profile_axis."""
        normal, own = (
            unit_axis(self.normal, f"normal of {what}"),
            unit_axis(self.profile_axis, f"profile_axis of {what}"),
        )
        if abs(own @ normal) > MAX_PROFILE_AXIS_COSINE:
            raise UserError(
                f"profile_axis of {what} is {self.profile_axis!r}; allowed: a direction perpendicular to its normal, "
                f"{self.normal!r}"
            )
        across = np.cross(normal, own)
        return across / np.linalg.norm(across)

    def fill(self, record: Any, site: Attachment) -> None:
        """Write points, axes, radii and rows."""
        super().fill(record, site)
        record["radius"], record["crown"] = self.radius - self.crown_radius, self.crown_radius
        for direction in GRIPS["both"]:
            record[direction] = direction in self.nonholonomic
        if self.friction is not None:
            record["longitudinal_friction"], record["lateral_friction"] = np.broadcast_to(self.friction, 2)
        if self.surface is not None:
            record["Pa"] = self.at_a  # from where x is measured
            self.surface.fill(record, site)

    def extent(self) -> float:
        """Return the radius."""
        return self.radius

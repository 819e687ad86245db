"""Bearings of a joint, whose normal forces follow the force and the moment that the joint transmits.

With the force F and the moment M that the joint transmits, about the center of the bearings on the axis a, indices a
and r for the parts along and across the axis, and the distance l of two bearings, the loads of these are

    F_1 = F_r / 2 + M x a / l,      F_2 = F_r / 2 - M x a / l,

and the normal forces N, which ``coulomb`` multiplies (N; for angles times a radius, N m):

    guide of a displacement  |F_1| + |F_2| + 2 |M_a| / w + P                   width w
    journal of an angle      r (|F_1| + |F_2| + P) + r_t |F_a|                 radius r, thrust radius r_t
    thread of a screw        r (|F_a + Q cos(g) sin(g) / r| / cos(g)^2 + P)    radius r, tan(g) = h / r
    ball                     r (|F| + P)                                       radius r
    sleeve                   |F_1| + |F_2| + P
    plane                    |F_a| + P                                         a: its normal

P is the preload. Q is the friction torque of the thread, g its lead angle, h the rise per radian: the flank transmits
the normal force N cos(g) / r, whose axial part is F_a less the axial part of the friction along the thread. The two
angles of a universal joint are journals of its cross, which has no mass: both transmit F and M.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from mbfmu.mechanics.checks import one_of
from mbfmu.mechanics.joints import Cylindrical, Revolute, Screw, Translational, Universal
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import not_negative, positive
from mbfmu.util.errors import UserError

# types of bearings: of a displacement, an angle, a screw joint, a ball joint; of a shaft that turns and slides, a plane
GUIDE, JOURNAL, THREAD, BALL, SLEEVE, PLANE = range(6)


class Bearings(NamedTuple):
    """Bearings of one coordinate of a joint, or of those that slide together: their type, and their parameters."""

    type: int
    required: tuple[str, ...] = ()
    others: tuple[str, ...] = ()


JOURNAL_BEARINGS = Bearings(JOURNAL, ("radius",), ("thrust_radius", "length"))
BEARINGS = {  # of the coordinates of joints
    Translational: (Bearings(GUIDE, (), ("length", "width")),),
    Revolute: (JOURNAL_BEARINGS,),
    Universal: (JOURNAL_BEARINGS, JOURNAL_BEARINGS),
    Cylindrical: (Bearings(JOURNAL, ("radius",), ("length",)), Bearings(GUIDE, (), ("length",))),
    Screw: (Bearings(THREAD, ("radius",)),),
}


def bearings_of(joint: Any) -> tuple[Bearings, ...]:
    """Return the bearings of the coordinates of a joint; none: it has no friction that follows reactions."""
    return BEARINGS.get(type(joint), ())


@dataclass(frozen=True, kw_only=True)
class Reaction:
    """Normal force of a friction that follows the force and the moment which the joint transmits.

    ``coulomb`` of the friction then is the coefficient of friction, for displacements and for angles. The joint is a
    joint of the tree, for :class:`.JointFriction` a translational, revolute, cylindrical, screw or universal one.

    Parameters
    ----------
    radius
        Radius of the journal of an angle or of the ball of a spherical joint, or mean radius of the thread of a screw
        joint, m. Required for these.
    thrust_radius
        Mean radius of the surface on which the axial force of a revolute joint, or of a pin of a universal joint, acts,
        m; 0: it causes no friction.
    length
        Distance of the two bearings along the axis, m, or of the ends of a guide; they carry the moment across the
        axis. None: the moment causes no friction.
    width
        Distance of the two rails of a translational joint, m, which carry the moment about its axis. None: this moment
        causes no friction.
    preload
        Normal force without a load, N, which is added.
    on
        Body in which the bearings are fixed: ``"b"``, the body that the joint moves, as a carriage on a rail, or
        ``"a"``, its parent, as the bushing of a rod. The forces of the bearings are about the origin of the joint frame
        in this body.

    Notes
    -----
    The normal force on a plane is that of the whole body; how moments distribute it has no effect on the friction.
    Bearings and friction are on the axis: the moment of the friction of a guide about its axis, by its thickness, is
    neglected. The radial force of a screw joint and moments across its axis cause no friction.
    """

    radius: float | None = None
    thrust_radius: float = 0.0
    length: float | None = None
    width: float | None = None
    preload: float = 0.0
    on: str = "b"

    sizes: ClassVar = ("radius", "length", "width")

    def check(self, what: str, bearings: Bearings) -> None:
        """Raise UserError for values that are no such bearings.

        Parameters
        ----------
        what
            Name of the force in messages, such as ``"force 'x'"``.
        bearings
            Bearings that the joint has.
        """
        for name in self.sizes:
            value = getattr(self, name)
            if value is not None:
                positive(f"{name} of the Reaction of {what}", value)
            elif name in bearings.required:
                raise UserError(f"{name} of the Reaction of {what} is not given; give it, m: the joint has an angle")
        not_negative(f"thrust_radius of the Reaction of {what}", self.thrust_radius)
        not_negative(f"preload of the Reaction of {what}", self.preload)
        one_of(f"on of the Reaction of {what}", self.on, ("a", "b"))
        allowed = (*bearings.required, *bearings.others)
        for name in (*self.sizes, "thrust_radius"):
            if getattr(self, name) and name not in allowed:
                names = ", ".join((*allowed, "preload", "on"))
                raise UserError(f"the Reaction of {what} has a {name}; allowed for this joint: {names}. Leave it out")

    def fill(self, record: Any, site: Attachment, bearings: Bearings) -> None:
        """Write the bearings and the place of what the recursions determine.

        Parameters
        ----------
        record
            Record of the force.
        site
            Where the force is in the mechanism.
        bearings
            Bearings that the joint has.
        """
        record["bearing"] = min([site.bearing() for _ in range(record["count"])])
        record["body"], record["bearing_type"] = site.bodies[0], bearings.type
        record["is_on_b"] = self.on == "b"
        record["radius"], record["thrust_radius"] = self.radius or 0.0, self.thrust_radius
        record["inverse_length"] = 1.0 / self.length if self.length else 0.0
        record["inverse_width"] = 1.0 / self.width if self.width else 0.0
        record["preload"] = self.preload

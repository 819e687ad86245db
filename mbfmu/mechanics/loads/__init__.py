"""Loads: forces and what acts on surfaces, one file a kind."""

from __future__ import annotations

from .base import Force, Load
from .beam import BeamElement
from .bushing import Bushing
from .combined_friction import CylindricalFriction, PlanarFriction, SphericalFriction
from .damper import Damper, JointDamper
from .distance_stop import DistanceStop
from .drag import Drag
from .joint_force import JointForce
from .joint_friction import JointFriction
from .joint_spring import JointSpring
from .joint_stop import JointStop
from .line_force import LineForce
from .line_friction import LineFriction
from .point_force import PointForce
from .pressure import Pressure
from .reaction import Reaction
from .rope import Rope
from .slipping_wheel import SlippingWheel
from .spring import Spring
from .torque import Torque
from .torsion_spring import TorsionSpring

__all__ = [
    "BeamElement",
    "Bushing",
    "CylindricalFriction",
    "Damper",
    "DistanceStop",
    "Drag",
    "Force",
    "JointDamper",
    "JointForce",
    "JointFriction",
    "JointSpring",
    "JointStop",
    "LineForce",
    "LineFriction",
    "Load",
    "PlanarFriction",
    "PointForce",
    "Pressure",
    "Reaction",
    "Rope",
    "SlippingWheel",
    "SphericalFriction",
    "Spring",
    "Torque",
    "TorsionSpring",
]

"""Sensors, what can be read off a mechanism: one file a family."""

from __future__ import annotations

from .attitudes import AngularVelocity, DirectionCosine, Quaternion
from .base import Follows, Sensor, axis_index
from .blocks import BlockOutput
from .coordinates import Acceleration, Coordinate, Effort, Rate, Turn
from .energies import Energy, JacobiIntegral, KineticEnergy, PotentialEnergy, Residual, largest_residual
from .expression import Expression, with_arguments
from .forces import CouplingEffort, CutForce, DeclaredJointForce, JointForce, RequiredFriction, RowForce
from .loads import LoadEffort, LoadWrench
from .pairs import AngleBetween, Distance, DistanceRate, RelativePosition, RelativeVelocity
from .points import PointAcceleration, PointPosition, PointVelocity
from .ropes import RopeLength, RopeLengthRate, RopeTension
from .sections import BendingMoment, Deflection
from .states import StateRate, StateValue
from .stresses import NodeStress, VonMisesStress

__all__ = [
    "Acceleration",
    "AngleBetween",
    "AngularVelocity",
    "BendingMoment",
    "BlockOutput",
    "Coordinate",
    "CouplingEffort",
    "CutForce",
    "DeclaredJointForce",
    "Deflection",
    "DirectionCosine",
    "Distance",
    "DistanceRate",
    "Effort",
    "Energy",
    "Expression",
    "Follows",
    "JacobiIntegral",
    "JointForce",
    "KineticEnergy",
    "LoadEffort",
    "LoadWrench",
    "NodeStress",
    "PointAcceleration",
    "PointPosition",
    "PointVelocity",
    "PotentialEnergy",
    "Quaternion",
    "Rate",
    "RelativePosition",
    "RelativeVelocity",
    "RequiredFriction",
    "Residual",
    "RopeLength",
    "RopeLengthRate",
    "RopeTension",
    "RowForce",
    "Sensor",
    "StateRate",
    "StateValue",
    "Turn",
    "VonMisesStress",
    "axis_index",
    "largest_residual",
    "with_arguments",
]

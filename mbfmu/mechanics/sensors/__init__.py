"""Sensors, what can be read off a mechanism: one file a family."""

from __future__ import annotations

from .base import Follows, Sensor, axis_index
from .coordinates import Acceleration, Coordinate, Effort, Rate, Turn
from .energies import Energy, JacobiIntegral, KineticEnergy, PotentialEnergy, Residual, largest_residual
from .forces import CutForce, JointForce, RowForce
from .points import PointAcceleration, PointPosition, PointVelocity
from .sections import BendingMoment, Deflection

__all__ = [
    "Acceleration",
    "BendingMoment",
    "Coordinate",
    "CutForce",
    "Deflection",
    "Effort",
    "Energy",
    "Follows",
    "JacobiIntegral",
    "JointForce",
    "KineticEnergy",
    "PointAcceleration",
    "PointPosition",
    "PointVelocity",
    "PotentialEnergy",
    "Rate",
    "Residual",
    "RowForce",
    "Sensor",
    "Turn",
    "axis_index",
    "largest_residual",
]

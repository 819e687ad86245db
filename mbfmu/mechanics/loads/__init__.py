"""Loads: forces and what acts on surfaces, one file a kind."""

from __future__ import annotations

from .base import Force, Load
from .drag import Drag
from .joint_force import JointForce
from .joint_spring import JointSpring
from .point_force import PointForce
from .pressure import Pressure
from .spring import Spring
from .torque import Torque

__all__ = ["Drag", "Force", "JointForce", "JointSpring", "Load", "PointForce", "Pressure", "Spring", "Torque"]

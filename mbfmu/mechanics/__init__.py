"""What a mechanism is and how it moves; knows neither solvers' methods nor FMI."""

from mbfmu.errors import AssemblyError, UserError

from .compile import Variable
from .cuts import DistanceCut, PlanarCut, PlaneCut, RevoluteCut, SphericalCut, WeldCut
from .elastic import Plate
from .forces import JointForce, JointSpring, PointForce, Spring, Torque
from .joints import Floating, OutOfPlane, Revolute, Spherical, Translational, Weld
from .mechanism import Body, Mechanism, rod
from .plant import Plant
from .sensors import Sensor
from .signals import Harmonic, Input, Polynomial, SpeedInput

__all__ = [
    "AssemblyError",
    "Body",
    "DistanceCut",
    "Floating",
    "Harmonic",
    "Input",
    "JointForce",
    "JointSpring",
    "Mechanism",
    "OutOfPlane",
    "PlanarCut",
    "PlaneCut",
    "Plant",
    "Plate",
    "PointForce",
    "Polynomial",
    "Revolute",
    "RevoluteCut",
    "Sensor",
    "SpeedInput",
    "Spherical",
    "SphericalCut",
    "Spring",
    "Torque",
    "Translational",
    "UserError",
    "Variable",
    "Weld",
    "WeldCut",
    "rod",
]

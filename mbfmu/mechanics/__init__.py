"""What a mechanism is and how it moves; knows neither solvers' methods nor FMI."""

from mbfmu.errors import AssemblyError, UserError

from .bodies import Body, CutHandle, Elastic
from .chain import add_chain
from .compile import Variable
from .cuts import DistanceCut, PlanarCut, PlaneCut, RevoluteCut, SphericalCut, WeldCut
from .elastic import MODES, Beam, Plate
from .forces import BeamElement, JointForce, JointSpring, PointForce, Spring, Torque
from .joints import Floating, Geodesic, OutOfPlane, Revolute, Spherical, Translational, Weld
from .mechanism import Mechanism, rod
from .plant import Plant
from .sensors import Sensor
from .shapes import Box, Cylinder, Sphere
from .sheet import Sheet, add_sheet
from .signals import Harmonic, Input, Polynomial, RunUp, SpeedInput
from .supports import Support

__all__ = [
    "MODES",
    "AssemblyError",
    "Beam",
    "BeamElement",
    "Body",
    "Box",
    "CutHandle",
    "Cylinder",
    "DistanceCut",
    "Elastic",
    "Floating",
    "Geodesic",
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
    "RunUp",
    "Sensor",
    "Sheet",
    "SpeedInput",
    "Sphere",
    "Spherical",
    "SphericalCut",
    "Spring",
    "Support",
    "Torque",
    "Translational",
    "UserError",
    "Variable",
    "Weld",
    "WeldCut",
    "add_chain",
    "add_sheet",
    "rod",
]

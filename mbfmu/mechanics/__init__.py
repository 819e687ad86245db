"""What a mechanism is and how it moves; knows neither solvers' methods nor FMI."""

from mbfmu.errors import AssemblyError, UserError

from .arrays.compile import Variable
from .arrays.plant import Plant
from .assemblies.chain import add_chain
from .assemblies.sheet import Sheet, add_sheet
from .assemblies.supports import Support
from .builder.bodies import Body, CutHandle, Elastic
from .builder.mechanism import Mechanism, rod
from .cuts import (
    CylindricalCut,
    DistanceCut,
    PlanarCut,
    PlaneCut,
    RevoluteCut,
    SphericalCut,
    TranslationalCut,
    WeldCut,
)
from .elements import BeamElement, Plate
from .flexible import MODES, Beam
from .joints import (
    Cylindrical,
    Floating,
    Geodesic,
    OutOfPlane,
    Planar,
    Revolute,
    Screw,
    Spherical,
    Translational,
    Universal,
    Weld,
)
from .loads import JointForce, JointSpring, PointForce, Spring, Torque
from .sensors import Sensor
from .shapes import Box, Cylinder, Sphere
from .signals import Harmonic, Input, Polynomial, RunUp, SpeedInput

__all__ = [
    "MODES",
    "AssemblyError",
    "Beam",
    "BeamElement",
    "Body",
    "Box",
    "CutHandle",
    "Cylinder",
    "Cylindrical",
    "CylindricalCut",
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
    "Planar",
    "PlanarCut",
    "PlaneCut",
    "Plant",
    "Plate",
    "PointForce",
    "Polynomial",
    "Revolute",
    "RevoluteCut",
    "RunUp",
    "Screw",
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
    "TranslationalCut",
    "Universal",
    "UserError",
    "Variable",
    "Weld",
    "WeldCut",
    "add_chain",
    "add_sheet",
    "rod",
]

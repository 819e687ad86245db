"""What a mechanism is and how it moves; knows neither solvers' methods nor FMI."""

from mbfmu.errors import AssemblyError, UserError

from .arrays.compile import Variable
from .arrays.plant import Plant
from .assemblies.chain import add_chain
from .assemblies.sheet import Sheet, add_sheet
from .assemblies.supports import Support
from .builder.bodies import Body, CutHandle, Elastic, ForceHandle
from .builder.inertia import box, cylinder, rod, sphere, tube
from .builder.mechanism import Mechanism
from .cuts import DistanceCut, PlanarCut, PlaneCut, RevoluteCut, SphericalCut, WeldCut
from .elements import BeamElement, Plate
from .flexible import MODES, Beam
from .joints import Floating, Geodesic, OutOfPlane, Revolute, Spherical, Translational, Weld
from .loads import Bushing, DistanceStop, JointForce, JointSpring, JointStop, PointForce, Spring, Torque, TorsionSpring
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
    "Bushing",
    "CutHandle",
    "Cylinder",
    "DistanceCut",
    "DistanceStop",
    "Elastic",
    "Floating",
    "ForceHandle",
    "Geodesic",
    "Harmonic",
    "Input",
    "JointForce",
    "JointSpring",
    "JointStop",
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
    "TorsionSpring",
    "Translational",
    "UserError",
    "Variable",
    "Weld",
    "WeldCut",
    "add_chain",
    "add_sheet",
    "box",
    "cylinder",
    "rod",
    "sphere",
    "tube",
]

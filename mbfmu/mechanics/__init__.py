"""Mechanisms and their motion; independent of the methods of solvers and of FMI."""

from mbfmu.util.errors import AssemblyError, UserError, missing_attribute
from solvers.compiled.kernel import kernel

from .arrays.compile import Variable
from .arrays.plant import Plant
from .builder.bodies import Body, FlexibleBody
from .builder.chain import add_chain
from .builder.handles import CouplingHandle, CutHandle, ForceHandle
from .builder.inertia import box, cylinder, rod, sphere, tube
from .builder.mechanism import Mechanism
from .contact.surfaces import Drum, Guide, Surface, Trough, Wall
from .couplings import Cam, Coupling, Gear
from .cuts import (
    Cut,
    CylindricalCut,
    DistanceCut,
    PlanarCut,
    PlaneCut,
    RevoluteCut,
    SphericalCut,
    TranslationalCut,
    WeldCut,
)
from .dispatch import signal_value
from .elements import BeamElement, Plate, Shell
from .flexible import MODES, Beam
from .joints import (
    Cylindrical,
    Floating,
    Geodesic,
    Joint,
    OutOfPlane,
    Planar,
    Revolute,
    Screw,
    Spherical,
    Stretching,
    Translational,
    Universal,
    Weld,
)
from .loads import (
    Bushing,
    DistanceStop,
    Force,
    JointForce,
    JointSpring,
    JointStop,
    LineForce,
    Load,
    PointForce,
    Spring,
    Torque,
    TorsionSpring,
)
from .sensors import Sensor
from .shapes import Box, Cylinder, Panel, Sphere
from .signals import Function, Harmonic, Input, Polynomial, Product, Ramp, RunUp, Signal, SpeedInput, Step, Sum, Table

__all__ = [
    "MODES",
    "AssemblyError",
    "Beam",
    "BeamElement",
    "Body",
    "Box",
    "Bushing",
    "Cam",
    "Coupling",
    "CouplingHandle",
    "Cut",
    "CutHandle",
    "Cylinder",
    "Cylindrical",
    "CylindricalCut",
    "DistanceCut",
    "DistanceStop",
    "Drum",
    "FlexibleBody",
    "Floating",
    "Force",
    "ForceHandle",
    "Function",
    "Gear",
    "Geodesic",
    "Guide",
    "Harmonic",
    "Input",
    "Joint",
    "JointForce",
    "JointSpring",
    "JointStop",
    "LineForce",
    "Load",
    "Mechanism",
    "OutOfPlane",
    "Panel",
    "Planar",
    "PlanarCut",
    "PlaneCut",
    "Plant",
    "Plate",
    "PointForce",
    "Polynomial",
    "Product",
    "Ramp",
    "Revolute",
    "RevoluteCut",
    "RunUp",
    "Screw",
    "Sensor",
    "Shell",
    "Signal",
    "SpeedInput",
    "Sphere",
    "Spherical",
    "SphericalCut",
    "Spring",
    "Step",
    "Stretching",
    "Sum",
    "Surface",
    "Table",
    "Torque",
    "TorsionSpring",
    "Translational",
    "TranslationalCut",
    "Trough",
    "Universal",
    "UserError",
    "Variable",
    "Wall",
    "Weld",
    "WeldCut",
    "add_chain",
    "box",
    "cylinder",
    "kernel",
    "rod",
    "signal_value",
    "sphere",
    "tube",
]


def __getattr__(name: str) -> object:
    raise missing_attribute("mbfmu.mechanics", name)

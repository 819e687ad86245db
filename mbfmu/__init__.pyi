# What a first session needs; `mbfmu/__init__.py` loads each name when it is first used.

from .errors import AssemblyError, EquilibriumError, UserError
from .fmi import export
from .mechanics import (
    Beam,
    BeamElement,
    Box,
    Bushing,
    Cylinder,
    DistanceCut,
    DistanceStop,
    Floating,
    Geodesic,
    Harmonic,
    Input,
    JointForce,
    JointSpring,
    JointStop,
    Mechanism,
    OutOfPlane,
    PlanarCut,
    PlaneCut,
    Plate,
    PointForce,
    Polynomial,
    Revolute,
    RevoluteCut,
    RunUp,
    SpeedInput,
    Sphere,
    Spherical,
    SphericalCut,
    Spring,
    Support,
    Torque,
    TorsionSpring,
    Translational,
    Weld,
    WeldCut,
    add_chain,
    add_sheet,
    box,
    cylinder,
    rod,
    sphere,
    tube,
)
from .model import Model, find, models, parameter
from .native import simulate
from .result import Result
from .settings import Settings
from .simulation import Simulation
from .steady.linear import StateSpace
from .steady.problem import equilibrium, linearize, modes
from .steady.state import Equilibrium
from .studies.compare import compare
from .viewer.show import view

__all__ = [
    "AssemblyError", "Beam", "BeamElement", "Box", "Bushing", "Cylinder", "DistanceCut", "DistanceStop", "Equilibrium",
    "EquilibriumError", "Floating", "Geodesic", "Harmonic", "Input", "JointForce", "JointSpring", "JointStop",
    "Mechanism", "Model", "OutOfPlane", "PlanarCut", "PlaneCut", "Plate", "PointForce", "Polynomial", "Result",
    "Revolute", "RevoluteCut", "RunUp", "Settings", "Simulation", "SpeedInput", "Sphere", "Spherical", "SphericalCut",
    "Spring", "StateSpace", "Support", "Torque", "TorsionSpring", "Translational", "UserError", "Weld", "WeldCut",
    "add_chain", "add_sheet", "box", "compare", "cylinder", "equilibrium", "export", "find", "linearize", "models",
    "modes", "parameter", "rod", "simulate", "sphere", "tube", "view",
]  # fmt: skip

__version__: str

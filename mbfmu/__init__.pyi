# What a first session needs; `mbfmu/__init__.py` loads each name when it is first used.

from .direct import simulate
from .ensemble.study import Study, load_study, study
from .errors import AssemblyError, EquilibriumError, UserError
from .fmi import export
from .mechanics import (
    Beam,
    BeamElement,
    Box,
    Bushing,
    Cam,
    Crease,
    Cylinder,
    Cylindrical,
    CylindricalCut,
    DistanceCut,
    DistanceStop,
    Drum,
    Floating,
    Function,
    Gear,
    Geodesic,
    Guide,
    Harmonic,
    Input,
    JointForce,
    JointSpring,
    JointStop,
    LineForce,
    Mechanism,
    OutOfPlane,
    Panel,
    Planar,
    PlanarCut,
    PlaneCut,
    Plate,
    PointForce,
    Polynomial,
    Product,
    Ramp,
    Revolute,
    RevoluteCut,
    RunUp,
    Screw,
    Shell,
    SpeedInput,
    Sphere,
    Spherical,
    SphericalCut,
    Spring,
    Step,
    Stretching,
    Sum,
    Support,
    Table,
    Torque,
    TorsionSpring,
    Translational,
    TranslationalCut,
    Trough,
    Universal,
    Wall,
    Weld,
    WeldCut,
    add_chain,
    add_contact,
    add_nip,
    add_sheet,
    box,
    cylinder,
    rod,
    sphere,
    tube,
)
from .model import Model, find, models, parameter
from .result import Result
from .settings import Settings
from .simulation import Simulation
from .steady.equilibrium import equilibrium, linearize, modes
from .steady.linear import StateSpace
from .steady.path import EquilibriumPath, equilibrium_path
from .steady.state import Equilibrium
from .studies.check import Findings, check
from .studies.compare import Comparison, compare
from .studies.recommendation import Recommendation, recommend_solver
from .viewer.show import view

__all__ = [
    "AssemblyError", "Beam", "BeamElement", "Box", "Bushing", "Cam", "Comparison", "Crease", "Cylinder",
    "Cylindrical", "CylindricalCut", "DistanceCut", "DistanceStop", "Drum", "Equilibrium", "EquilibriumError",
    "EquilibriumPath", "Findings", "Floating", "Function", "Gear", "Geodesic", "Guide", "Harmonic", "Input",
    "JointForce", "JointSpring", "JointStop", "LineForce", "Mechanism", "Model", "OutOfPlane", "Panel", "Planar",
    "PlanarCut", "PlaneCut", "Plate", "PointForce", "Polynomial", "Product", "Ramp", "Recommendation", "Result",
    "Revolute", "RevoluteCut", "RunUp", "Screw", "Settings", "Shell", "Simulation", "SpeedInput", "Sphere",
    "Spherical", "SphericalCut", "Spring", "StateSpace", "Step", "Stretching", "Study", "Sum", "Support", "Table",
    "Torque", "TorsionSpring", "Translational", "TranslationalCut", "Trough", "Universal", "UserError", "Wall",
    "Weld", "WeldCut", "add_chain", "add_contact", "add_nip", "add_sheet", "box", "check", "compare", "cylinder",
    "equilibrium", "equilibrium_path", "export", "find", "linearize", "load_study", "models", "modes", "parameter",
    "recommend_solver", "rod", "simulate", "sphere", "study", "tube", "view",
]  # fmt: skip

__version__: str

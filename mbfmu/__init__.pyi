# What a first session needs; `mbfmu/__init__.py` loads each name when it is first used.

from .ensemble.study import Study, load_study, study
from .fmi import Batch, export, simulate_many, write_ssp
from .formats import load, write_mjcf, write_urdf
from .mechanics import (
    Beam,
    BeamElement,
    Bounce,
    Box,
    Bushing,
    Cam,
    Capsule,
    Cylinder,
    Cylindrical,
    CylindricalCutJoint,
    CylindricalFriction,
    Damper,
    DistanceCutJoint,
    DistanceStop,
    Ellipsoid,
    EndRun,
    FlexibleBody,
    Floating,
    Function,
    Gear,
    Harmonic,
    Impulse,
    Input,
    Interface,
    JointDamper,
    JointForce,
    JointFriction,
    JointSpring,
    JointStop,
    LineForce,
    LineFriction,
    Lock,
    Mechanism,
    MeshFile,
    Noise,
    Panel,
    Planar,
    PlanarCutJoint,
    PlanarFriction,
    PlaneCutJoint,
    PointForce,
    Polynomial,
    Product,
    Ramp,
    Reaction,
    Release,
    Restart,
    Revolute,
    RevoluteCutJoint,
    RollingWheel,
    RunUp,
    Screw,
    SetInput,
    SetParameter,
    SlippingWheel,
    SpeedInput,
    Sphere,
    Spherical,
    SphericalCutJoint,
    SphericalFriction,
    Spring,
    Step,
    Sum,
    Table,
    Torque,
    TorsionSpring,
    Translational,
    TranslationalCutJoint,
    Universal,
    UniversalCutJoint,
    Weld,
    WeldCutJoint,
    add_chain,
    box,
    cylinder,
    pade_delay,
    rod,
    solid_mesh,
    sphere,
    tube,
)
from .modeling import Model, find, models, parameter
from .modeling.settings import Settings
from .modeling.table_files import read_table
from .session.event_record import EventRecord
from .session.result import Result
from .session.run import simulate
from .session.simulation import Simulation
from .sheets import (
    Crease,
    Drum,
    Geodesic,
    Guide,
    OutOfPlane,
    Plate,
    Shell,
    Stretching,
    Support,
    Trough,
    Wall,
    add_contact,
    add_nip,
    add_sheet,
)
from .steady.equilibrium import equilibrium, linearize, modes
from .steady.linear import StateSpace
from .steady.path import EquilibriumPath, equilibrium_path
from .steady.state import Equilibrium
from .studies.check import Findings, check
from .studies.compare import Comparison, compare
from .studies.recommendation import Recommendation, recommend_solver
from .util.diagnostics import Diagnostic
from .util.errors import AssemblyError, EquilibriumError, UserError
from .viewer.show import view

__all__ = [
    "AssemblyError", "Batch", "Beam", "BeamElement", "Bounce", "Box", "Bushing", "Cam", "Capsule", "Comparison",
    "Crease", "Cylinder", "Cylindrical", "CylindricalCutJoint", "CylindricalFriction", "Damper", "Diagnostic",
    "DistanceCutJoint", "DistanceStop", "Drum", "Ellipsoid", "EndRun", "Equilibrium", "EquilibriumError",
    "EquilibriumPath", "EventRecord", "Findings", "FlexibleBody", "Floating", "Function", "Gear", "Geodesic", "Guide",
    "Harmonic", "Impulse", "Input", "Interface", "JointDamper", "JointForce", "JointFriction", "JointSpring",
    "JointStop", "LineForce", "LineFriction", "Lock", "Mechanism", "MeshFile", "Model", "Noise", "OutOfPlane",
    "Panel", "Planar",
    "PlanarCutJoint", "PlanarFriction", "PlaneCutJoint", "Plate", "PointForce", "Polynomial", "Product", "Ramp",
    "Reaction", "Recommendation", "Release", "Restart", "Result", "Revolute", "RevoluteCutJoint", "RollingWheel",
    "RunUp", "Screw", "SetInput", "SetParameter", "Settings", "Shell", "Simulation", "SlippingWheel", "SpeedInput",
    "Sphere", "Spherical", "SphericalCutJoint", "SphericalFriction", "Spring", "StateSpace", "Step", "Stretching",
    "Study", "Sum", "Support", "Table", "Torque", "TorsionSpring", "Translational", "TranslationalCutJoint", "Trough",
    "Universal", "UniversalCutJoint", "UserError", "Wall", "Weld", "WeldCutJoint", "add_chain", "add_contact",
    "add_nip", "add_sheet", "box", "check", "compare", "cylinder", "equilibrium", "equilibrium_path", "export", "find",
    "linearize", "load", "load_study", "models", "modes", "pade_delay", "parameter", "read_table", "recommend_solver",
    "rod", "simulate", "simulate_many", "solid_mesh", "sphere", "study", "tube", "view", "write_mjcf", "write_ssp",
    "write_urdf",
]  # fmt: skip

__version__: str

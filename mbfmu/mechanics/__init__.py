"""Mechanisms and their motion; independent of the methods of solvers and of FMI."""

from mbfmu.util.errors import AssemblyError, UserError, missing_attribute
from solvers.compiled.kernel import kernel

from .arrays.compiled_mechanism import CompiledMechanism
from .arrays.load_groups import LoadGroup
from .arrays.numbering import Variable
from .builder.blocks import BlockHandle
from .builder.bodies import Body
from .builder.chain import add_chain
from .builder.controllers import MotorHandle
from .builder.flexible_handle import FlexibleHandle
from .builder.handles import CouplingHandle, CutHandle, ForceHandle, RopeHandle
from .builder.inertia import box, cylinder, rod, sphere, tube
from .builder.joint_handle import JointHandle
from .builder.mechanism import Mechanism
from .builder.mesh_inertia import solid_mesh
from .builder.sampled import SampledHandle
from .builder.states import StateHandle
from .couplings import Cam, Coupling, Gear
from .cuts import (
    CutJoint,
    CylindricalCutJoint,
    DistanceCutJoint,
    PlanarCutJoint,
    PlaneCutJoint,
    RevoluteCutJoint,
    RollingWheel,
    SphericalCutJoint,
    TranslationalCutJoint,
    UniversalCutJoint,
    WeldCutJoint,
)
from .dispatch import part_value, scratch_record, signal_value
from .events import Bounce, EndRun, Impulse, Lock, Release, Restart, SetInput, SetParameter
from .flexible import MODES, Beam, FlexibleBody, Interface
from .joints import (
    Cylindrical,
    Floating,
    Joint,
    Planar,
    Revolute,
    Screw,
    Spherical,
    Translational,
    Universal,
    Weld,
)
from .loads import (
    BeamElement,
    Bushing,
    CylindricalFriction,
    Damper,
    DistanceStop,
    Force,
    JointDamper,
    JointForce,
    JointFriction,
    JointSpring,
    JointStop,
    LineForce,
    LineFriction,
    Load,
    PlanarFriction,
    PointForce,
    Reaction,
    SlippingWheel,
    SphericalFriction,
    Spring,
    Torque,
    TorsionSpring,
)
from .loads.base import MAX_ACCURATE_RATIO, MAX_VALID_RATIO, FirstOrderState, limit_ratio
from .sensors import Sensor
from .shapes import Box, Capsule, Cylinder, Ellipsoid, MeshFile, Panel, Sphere
from .signals import (
    Function,
    Harmonic,
    Input,
    Noise,
    Polynomial,
    Product,
    Ramp,
    RunUp,
    Signal,
    SpeedInput,
    Step,
    Sum,
    Table,
)
from .transfer import pade_delay

__all__ = [
    "MAX_ACCURATE_RATIO",
    "MAX_VALID_RATIO",
    "MODES",
    "AssemblyError",
    "Beam",
    "BeamElement",
    "BlockHandle",
    "Body",
    "Bounce",
    "Box",
    "Bushing",
    "Cam",
    "Capsule",
    "CompiledMechanism",
    "Coupling",
    "CouplingHandle",
    "CutHandle",
    "CutJoint",
    "Cylinder",
    "Cylindrical",
    "CylindricalCutJoint",
    "CylindricalFriction",
    "Damper",
    "DistanceCutJoint",
    "DistanceStop",
    "Ellipsoid",
    "EndRun",
    "FirstOrderState",
    "FlexibleBody",
    "FlexibleHandle",
    "Floating",
    "Force",
    "ForceHandle",
    "Function",
    "Gear",
    "Harmonic",
    "Impulse",
    "Input",
    "Interface",
    "Joint",
    "JointDamper",
    "JointForce",
    "JointFriction",
    "JointHandle",
    "JointSpring",
    "JointStop",
    "LineForce",
    "LineFriction",
    "Load",
    "LoadGroup",
    "Lock",
    "Mechanism",
    "MeshFile",
    "MotorHandle",
    "Noise",
    "Panel",
    "Planar",
    "PlanarCutJoint",
    "PlanarFriction",
    "PlaneCutJoint",
    "PointForce",
    "Polynomial",
    "Product",
    "Ramp",
    "Reaction",
    "Release",
    "Restart",
    "Revolute",
    "RevoluteCutJoint",
    "RollingWheel",
    "RopeHandle",
    "RunUp",
    "SampledHandle",
    "Screw",
    "Sensor",
    "SetInput",
    "SetParameter",
    "Signal",
    "SlippingWheel",
    "SpeedInput",
    "Sphere",
    "Spherical",
    "SphericalCutJoint",
    "SphericalFriction",
    "Spring",
    "StateHandle",
    "Step",
    "Sum",
    "Table",
    "Torque",
    "TorsionSpring",
    "Translational",
    "TranslationalCutJoint",
    "Universal",
    "UniversalCutJoint",
    "UserError",
    "Variable",
    "Weld",
    "WeldCutJoint",
    "add_chain",
    "box",
    "cylinder",
    "kernel",
    "limit_ratio",
    "pade_delay",
    "part_value",
    "rod",
    "scratch_record",
    "signal_value",
    "solid_mesh",
    "sphere",
    "tube",
]


def __getattr__(name: str) -> object:
    raise missing_attribute("mbfmu.mechanics", name)

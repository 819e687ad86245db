"""A rigid mechanism as imported files describe it: between the reader of a format and the writer of Python code.

Frames, axes and coordinates are those of :mod:`mbfmu.mechanics`; units are SI and rad. Names are Python identifiers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mbfmu.util.diagnostics import Diagnostic

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
GROUND_NAME = "m.ground"  # as a body in the code


@dataclass(kw_only=True)
class ImportedJoint:
    """Joint of a body to its parent.

    Attributes
    ----------
    kind
        Name of the class in :mod:`mbfmu`.
    name
        Name of its parameters and outputs; empty for welded bodies.
    at, rotation
        Joint frame in the parent: origin (3,), m, and axes as columns (3, 3).
    axis
        Axis in the joint frame (3,); None: the joint has none.
    start
        Positions at the start; None: those of the frame.
    armature, stiffness, unloaded, damping, friction
        Properties of a joint of one coordinate: reflected inertia, spring with its unloaded coordinate, damper, Coulomb
        friction.
    lower, upper, stop_stiffness
        Range of the coordinate and the stiffness of its stops; None: no range.
    is_locked
        The coordinate stays at ``start``.
    stop_time
        Time constant of the stops in the start position, s, at critical damping; only of exported mechanisms.
    """

    kind: Literal["Weld", "Revolute", "Translational", "Spherical", "Floating"]
    name: str = ""
    at: Vector
    rotation: Matrix
    axis: Vector | None = None
    start: Vector | None = None
    armature: float = 0.0
    stiffness: float = 0.0
    unloaded: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    lower: float | None = None
    upper: float | None = None
    stop_stiffness: float = 0.0
    is_locked: bool = False
    stop_time: float = 0.0

    @property
    def has_one_coordinate(self) -> bool:
        """Whether it is a hinge or a slide."""
        return self.kind in ("Revolute", "Translational")


@dataclass(kw_only=True)
class ImportedBody:
    """Body.

    Attributes
    ----------
    name, parent
        Names of the body and of its parent, or GROUND_NAME.
    joint
        Joint to the parent; the frame of the body is that of the joint.
    mass, com, inertia
        Mass, kg, center of mass (3,), m, and inertia about it (3, 3), kg m^2.
    origin
        Origin (3,), m, of the frame that the file gives the body.
    """

    name: str
    parent: str
    joint: ImportedJoint
    mass: float
    com: Vector
    inertia: Matrix
    origin: Vector = field(default_factory=lambda: np.zeros(3))


@dataclass(kw_only=True)
class ImportedCut:
    """Loop-closing joint: points (3,) of bodies a and b, and the axes of the frame in body a (3, 3)."""

    name: str
    kind: Literal["SphericalCutJoint", "RevoluteCutJoint", "WeldCutJoint"]
    a: str
    b: str
    at_a: Vector
    at_b: Vector
    rotation_a: Matrix = field(default_factory=lambda: np.eye(3))
    rotation_b: Matrix = field(default_factory=lambda: np.eye(3))


@dataclass(kw_only=True)
class ImportedCoupling:
    """Coupling: coordinate of body a = polynomial of (coordinate of body b - origin), coefficients in rising order."""

    name: str
    a: str
    b: str
    coefficients: Vector
    origin: float


@dataclass(kw_only=True)
class ImportedDrive:
    """Force on the joint of a body: gain * input + bias, and the spring and damper of a servo.

    ``unit`` is that of the input, ``joint`` the name of the joint. ``limits`` are the least and the largest value of
    gain * input.
    """

    name: str
    body: str
    joint: str
    input: str
    unit: str
    description: str
    gain: float = 1.0
    bias: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0
    limits: tuple[float, float] | None = None


@dataclass(kw_only=True)
class ImportedTransmission:
    """Force along a linear combination L = sum of c_k q_k of joint coordinates, such as a tendon or a limited servo.

    The force F = gain * input + bias - stiffness L - damping L', within its limits, acts with c_k F on coordinate k.

    Attributes
    ----------
    name, description
        Name of the force, and description of its input.
    bodies, factors
        Bodies whose joints have the coordinates q_k, and the factors c_k.
    input, unit
        Name and unit of the input; empty: it has none.
    gain, bias, stiffness, damping
        Coefficients of the force.
    control_limits, limits
        Least and largest value of the input and of F; None: no limits.
    """

    name: str
    description: str
    bodies: list[str]
    factors: tuple[float, ...]
    input: str = ""
    unit: str = "1"
    gain: float = 0.0
    bias: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0
    control_limits: tuple[float, float] | None = None
    limits: tuple[float, float] | None = None


@dataclass(kw_only=True)
class ImportedDistanceRange:
    """Range of the distance between points of two bodies, m, such as a rope; None: no limit on that side."""

    name: str
    a: str
    b: str
    at_a: Vector
    at_b: Vector
    lower: float | None
    upper: float | None
    stiffness: float


@dataclass(kw_only=True)
class ImportedSpring:
    """Spring between points of two bodies: stiffness, damping, unloaded length."""

    name: str
    a: str
    b: str
    at_a: Vector
    at_b: Vector
    stiffness: float
    damping: float
    unloaded: float


@dataclass(kw_only=True)
class ImportedLift:
    """Constant force (3,) in global axes at a point of a body, such as gravity compensation."""

    name: str
    body: str
    at: Vector
    force: Vector


@dataclass(kw_only=True)
class ImportedPoint:
    """Point of a body whose position is an output."""

    name: str
    body: str
    at: Vector


@dataclass(kw_only=True)
class ImportedShape:
    """Shape of a body in pictures.

    Attributes
    ----------
    name, body
        Name for messages, and the body; or GROUND_NAME.
    kind
        Class in :mod:`mbfmu`.
    at, rotation
        Center (3,), m, and axes as columns (3, 3) in the body; of meshes those of the coordinates in the file.
    size
        Sizes that the class requires, by the names of its arguments, m; of meshes the scale.
    file
        File of a mesh.
    color, opacity
        Color ``#rrggbb``, or empty, and opacity.
    """

    name: str = ""
    body: str
    kind: Literal["Box", "Sphere", "Ellipsoid", "Cylinder", "Capsule", "MeshFile"]
    at: Vector
    rotation: Matrix
    size: dict[str, float | Vector]
    file: Path | None = None
    color: str = ""
    opacity: float = 1.0


@dataclass(kw_only=True)
class Description:
    """A rigid mechanism.

    Attributes
    ----------
    name
        Identifier of the model.
    source
        Name of the imported file.
    folder
        Folder of the imported file.
    origin
        Text: of which file the mechanism was read and by which program.
    gravity
        Acceleration of gravity (3,), m/s^2.
    diagnostics
        What has no counterpart or was changed.
    renamed
        Names of the file that are no identifiers, with the names in the model.
    """

    name: str
    source: str
    origin: str
    gravity: Vector
    bodies: list[ImportedBody] = field(default_factory=list)
    cuts: list[ImportedCut] = field(default_factory=list)
    couplings: list[ImportedCoupling] = field(default_factory=list)
    drives: list[ImportedDrive] = field(default_factory=list)
    transmissions: list[ImportedTransmission] = field(default_factory=list)
    springs: list[ImportedSpring] = field(default_factory=list)
    distance_ranges: list[ImportedDistanceRange] = field(default_factory=list)
    lifts: list[ImportedLift] = field(default_factory=list)
    points: list[ImportedPoint] = field(default_factory=list)
    shapes: list[ImportedShape] = field(default_factory=list)
    folder: Path = Path()
    diagnostics: list[Diagnostic] = field(default_factory=list)
    renamed: dict[str, str] = field(default_factory=dict)

    @property
    def ends(self) -> list[str]:
        """Bodies whose positions are outputs: the last ones of chains, and those that move freely."""
        parents = {body.parent for body in self.bodies}
        return [body.name for body in self.bodies if body.name not in parents or body.joint.kind == "Floating"]

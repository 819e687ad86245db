"""The builder: a mechanism in a dozen lines, and every check of what a user writes.

>>> from mbfmu.mechanics import Mechanism, Revolute, rod
>>> m = Mechanism(gravity=(0, -9.81, 0))
>>> bob = m.body("bob", m.ground, Revolute(axis="z"), **rod(mass=1.0, length=1.0))
>>> m.output("bob.angle", bob.angle(), "angle from the horizontal")
>>> plant = m.compile()

A body's frame is where its tree joint puts it: at rest it lies on the joint frame in the parent.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.errors import UserError

from .cuts import REGISTRY as CUTS
from .cuts import Cut, DistanceCut
from .elastic import Beam, Plate
from .forces import REGISTRY as FORCES
from .forces import Force, JointForce, JointSpring
from .joints import REGISTRY as JOINTS
from .joints import Joint, Revolute, Section, Weld
from .sensors import Kind, Sensor, axis_index
from .shapes import Shape, check_colour, lengths
from .signals import Input, Signal, as_signal

if TYPE_CHECKING:
    from .plant import Plant

Matrix = NDArray[np.float64]
Vector = Sequence[float] | Matrix


@dataclass(frozen=True, eq=False)
class Body:
    """A body of a mechanism, as :meth:`Mechanism.body` returns it."""

    name: str
    index: int
    parent: int
    joint: Joint
    mass: float = 0.0
    com: Matrix = field(default_factory=lambda: np.zeros(3))
    inertia: Matrix = field(default_factory=lambda: np.zeros((3, 3)))
    group: int | None = None

    def coordinate(self, k: int = 0) -> Sensor:
        """Joint position k, rad or m."""
        return Sensor(kind=Kind.COORDINATE, unit=self._unit(k), item=self, component=k)

    def rate(self, k: int = 0) -> Sensor:
        """Joint velocity k, rad/s or m/s."""
        return Sensor(kind=Kind.RATE, unit=self._unit(k) + "/s", item=self, component=k)

    def acceleration(self, k: int = 0) -> Sensor:
        """Joint acceleration k, rad/s2 or m/s2."""
        return Sensor(kind=Kind.ACCELERATION, unit=self._unit(k) + "/s2", item=self, component=k)

    def effort(self, k: int = 0) -> Sensor:
        """Force or torque that drives a driven joint."""
        return Sensor(kind=Kind.EFFORT, unit="N.m" if self._unit(k) == "rad" else "N", item=self, component=k)

    angle = coordinate

    def position(self, axis: str, point: Vector = (0.0, 0.0, 0.0)) -> Sensor:
        """Global component of the position of a body-fixed point, m."""
        return Sensor(
            kind=Kind.POINT_POSITION, unit="m", item=self, component=axis_index(axis), point=vector("point", point)
        )

    def velocity(self, axis: str, point: Vector = (0.0, 0.0, 0.0)) -> Sensor:
        """... of its velocity, m/s."""
        return Sensor(
            kind=Kind.POINT_VELOCITY, unit="m/s", item=self, component=axis_index(axis), point=vector("point", point)
        )

    def point_acceleration(self, axis: str, point: Vector = (0.0, 0.0, 0.0)) -> Sensor:
        """... of its acceleration, m/s2."""
        return Sensor(
            kind=Kind.POINT_ACCELERATION,
            unit="m/s2",
            item=self,
            component=axis_index(axis),
            point=vector("point", point),
        )

    def joint_force(self, axis: str) -> Sensor:
        """Global component of the force the tree joint exerts on this body, N."""
        return Sensor(kind=Kind.JOINT_FORCE, unit="N", item=self, component=axis_index(axis))

    def joint_moment(self, axis: str) -> Sensor:
        """Global component of the moment it exerts about the body's origin, N m."""
        return Sensor(kind=Kind.JOINT_FORCE, unit="N.m", item=self, component=3 + axis_index(axis))

    def _unit(self, k: int) -> str:
        if not 0 <= k < self.joint.nv:
            raise UserError(f"body {self.name!r} has no joint coordinate {k}; it has {self.joint.nv}")
        return self.joint.units[k]


@dataclass(frozen=True, eq=False)
class CutHandle:
    """A cut joint of a mechanism, as :meth:`Mechanism.cut` returns it."""

    name: str
    index: int
    cut: Cut
    a: Body
    b: Body

    def force(self, row: str = "") -> Sensor:
        """Force (N) or moment (N m) of one row on body b, along the row's direction from a to b."""
        if row not in self.cut.rows:
            raise UserError(f"cut {self.name!r} has no row {row!r}; allowed: {', '.join(map(repr, self.cut.rows))}")
        k = self.cut.rows.index(row)
        return Sensor(kind=Kind.CUT_FORCE, unit=self.cut.units[k], item=self, component=k)


@dataclass(frozen=True, eq=False)
class Elastic:
    """An elastic body, as :meth:`Mechanism.elastic` returns it.

    Attributes
    ----------
    body
        Its frame as a body of the tree, without mass: what the joint to the parent moves.
    modes
        Its first section: coordinate k is the amplitude of mode k + 1, m.
    """

    name: str
    index: int
    beam: Beam
    body: Body
    modes: Body
    _mechanism: Mechanism
    _sections: dict[float, Body] = field(default_factory=dict)

    def section(self, x: float) -> Body:
        """Return the cross-section at x (m) as a body, to hang others on, to cut, to load, to observe."""
        if x not in self._sections:
            self.beam.shape(x)
            joint = Section(beam=self.beam, x=float(x), frame=self.modes)
            self._sections[x] = self._mechanism.add_section(f"{self.name}[{x:g}]", self.modes, joint)
        return self._sections[x]

    def deflection(self, x: float) -> Sensor:
        """Deflection along y at x, m."""
        return Sensor(kind=Kind.DEFLECTION, unit="m", item=self.section(x))

    def moment(self, x: float) -> Sensor:
        """Bending moment E I w'' about z at x, N m; without the damping of the material."""
        return Sensor(kind=Kind.BENDING_MOMENT, unit="N.m", item=self.section(x))


@dataclass(frozen=True, eq=False)
class Surface:
    """A grid of bodies drawn as one skin, see :meth:`Mechanism.surface`."""

    name: str
    bodies: NDArray[np.int64]  # (rows, columns) indices
    at: Matrix  # the point of every body it passes through, body axes, m
    colour: str


@dataclass(frozen=True, kw_only=True)
class Profile:
    """The rectangular cross-section an elastic body is drawn with, see :meth:`Mechanism.profile`."""

    height: float  # along y, in which it bends, m
    width: float  # along z, m
    colour: str


class Mechanism:
    """Bodies on tree joints from the ground, closed by cut joints, moved by forces and drives.

    Parameters
    ----------
    gravity
        Acceleration of gravity, global axes, m/s^2; zero: none. A component may be an input without rate: it holds
        between steps.

    Attributes
    ----------
    gravity
        (3,), m/s^2; of inputs the start.
    gravity_inputs
        By component.
    """

    def __init__(self, *, gravity: Vector | Sequence[float | Input] = (0.0, 0.0, 0.0)) -> None:
        components = np.atleast_1d(np.asarray(gravity, object))
        for given in components:
            if isinstance(given, Signal) and (not isinstance(given, Input) or given.rate_name):
                raise UserError(f"gravity is {given!r}; allowed: a number, or an input without rate_name")
        self.gravity_inputs = {k: g for k, g in enumerate(components) if isinstance(g, Input)}
        self.gravity = vector("gravity", [g.start if isinstance(g, Input) else g for g in components])
        self.ground = Body("ground", 0, 0, Weld())
        self.bodies: list[Body] = [self.ground]
        self._bodies_named = {"ground": self.ground}
        self.cuts: list[CutHandle] = []
        self.forces: list[tuple[str, Force, Body, Body]] = []
        self.plates: list[tuple[Plate, tuple[Body, Body, Body, Body]]] = []
        self.elastics: list[Elastic] = []
        self.pressures: list[tuple[str, Any, list[tuple[Body, ...]]]] = []
        self.profiles: dict[int, Profile] = {}  # by elastic body
        self.outputs: list[tuple[str, Sensor, str, float | None]] = []
        self.shapes: list[tuple[Body, Shape]] = []
        self.surfaces: list[Surface] = []
        self.energy = Sensor(kind=Kind.ENERGY, unit="J")
        self.kinetic_energy = Sensor(kind=Kind.KINETIC, unit="J")
        self.potential_energy = Sensor(kind=Kind.POTENTIAL, unit="J")
        self.jacobi_integral = Sensor(kind=Kind.JACOBI, unit="J")
        self.position_residual = Sensor(kind=Kind.POSITION_RESIDUAL, unit="m")
        self.velocity_residual = Sensor(kind=Kind.VELOCITY_RESIDUAL, unit="m/s")

    def body(
        self,
        name: str,
        parent: Body,
        joint: Joint,
        *,
        mass: float = 0.0,
        com: Vector = (0.0, 0.0, 0.0),
        inertia: Any = (0.0, 0.0, 0.0),
        group: int | None = None,
    ) -> Body:
        """Hang a body on its parent.

        Parameters
        ----------
        name
            New among the bodies.
        parent
            A body of this mechanism or its ground.
        joint
            Tree joint; places the body's frame in the parent's.
        mass
            kg; zero is allowed where the motion has inertia from other bodies.
        com
            Centre of mass in the body's frame, m.
        inertia
            About the centre of mass, body axes, kg m^2: three principal values or a 3x3 matrix.
        group
            Of a large tree: bodies are solved group by group, and joints and elements should span neighbouring groups
            at most, as the columns of a grid do; None: that of the nearest body which has one.
        """
        self._new_name("body", name, self._bodies_named)
        self._member(parent, f"parent of body {name!r}")
        if type(joint) not in JOINTS:
            raise UserError(f"joint of body {name!r} is {joint!r}; allowed: {names_of(JOINTS)}")
        if joint.drive is not None and joint.nv != 1:
            raise UserError(
                f"joint of body {name!r} cannot be driven: only joints of one coordinate can; "
                "chain revolute and translational joints through bodies without mass"
            )
        new = Body(
            name,
            len(self.bodies),
            parent.index,
            joint,
            not_negative(f"mass of body {name!r}", mass),
            vector(f"com of body {name!r}", com),
            inertia_matrix(name, inertia),
            group,
        )
        self.bodies.append(new)
        self._bodies_named[name] = new
        return new

    def elastic(self, name: str, parent: Body, joint: Joint, beam: Beam) -> Elastic:
        """Hang a beam on its parent: a body that bends.

        Parameters
        ----------
        name
            New among the bodies; its frame is a body of this name.
        parent, joint
            As those of :meth:`body`; the joint places the frame the beam bends in, which x runs along.
        beam
            The beam and its modes.
        """
        if not isinstance(beam, Beam):
            raise UserError(f"beam of elastic body {name!r} is {beam!r}; it must be a Beam")
        body = self.body(name, parent, joint)
        modes = self.add_section(f"{name}.mode", body, Section(beam=beam))
        self.elastics.append(Elastic(name, len(self.elastics), beam, body, modes, self))
        return self.elastics[-1]

    def add_section(self, name: str, parent: Body, joint: Section) -> Body:
        """Append a cross-section of an elastic body; :meth:`Elastic.section` is the way to one."""
        self._new_name("body", name, self._bodies_named)
        new = Body(name, len(self.bodies), parent.index, joint)
        self.bodies.append(new)
        self._bodies_named[name] = new
        return new

    def cut(self, name: str, cut: Cut, a: Body, b: Body) -> CutHandle:
        """Close a loop with a cut joint between bodies a and b."""
        self._new_name("cut", name, [c.name for c in self.cuts])
        if type(cut) not in CUTS:
            raise UserError(f"cut {name!r} is {cut!r}; allowed: {names_of(CUTS)}")
        self._member(a, f"body a of cut {name!r}")
        self._member(b, f"body b of cut {name!r}")
        if a is b:
            raise UserError(f"cut {name!r} ties body {a.name!r} to itself; it needs two bodies")
        if isinstance(cut, DistanceCut) and not (np.isfinite(cut.length) and cut.length > 0.0):
            raise UserError(f"length of cut {name!r} is {cut.length!r} m; allowed: greater than zero")
        self.cuts.append(CutHandle(name, len(self.cuts), cut, a, b))
        return self.cuts[-1]

    def force(self, name: str, force: Force, a: Body, b: Body | None = None) -> None:
        """Let a force act on body a (and b); joint forces act on a's tree joint."""
        self._new_name("force", name, [f[0] for f in self.forces])
        if type(force) not in FORCES:
            raise UserError(f"force {name!r} is {force!r}; allowed: {names_of(FORCES)}")
        self._member(a, f"body a of force {name!r}")
        other = self.ground if b is None else b
        self._member(other, f"body b of force {name!r}")
        if isinstance(force, JointForce | JointSpring) and a.joint.nv != 1:
            raise UserError(f"force {name!r} needs a joint of one coordinate; that of {a.name!r} has {a.joint.nv}")
        for key in ("stiffness", "damping", "free"):
            if not np.isfinite(getattr(force, key, 0.0)):
                raise UserError(f"{key} of force {name!r} is {getattr(force, key)!r}; it must be finite")
        self.forces.append((name, force, a, other))

    def shape(self, body: Body, *shapes: Shape) -> None:
        """Draw a body with these shapes instead of the picture it gets by default."""
        self._member(body, "body of a shape")
        for shape in shapes:
            if not isinstance(shape, Shape):
                raise UserError(f"shape of body {body.name!r} is {shape!r}; allowed: Box, Cylinder, Sphere")
            vector(f"at of a shape of body {body.name!r}", shape.at)
            shape.axes()
            self.shapes.append((body, shape))

    def profile(self, elastic: Elastic, *, height: float, width: float, colour: str = "") -> None:
        """Draw an elastic body with this rectangular cross-section instead of a slender one.

        Parameters
        ----------
        elastic
            Of this mechanism.
        height, width
            Along y, in which it bends, and along z, m.
        colour
            ``"#rrggbb"``; empty: the one the body is given.
        """
        if not any(elastic is own for own in self.elastics):
            named = getattr(elastic, "name", elastic)
            raise UserError(f"elastic body of a profile is {named!r}; it must be one of this mechanism")
        lengths(f"height and width of the profile of {elastic.name!r}", (height, width), 2)
        self.profiles[elastic.index] = Profile(height=height, width=width, colour=check_colour(colour))

    def surface(
        self, name: str, bodies: Sequence[Sequence[Body]], *, at: Vector = (0.0, 0.0, 0.0), colour: str = ""
    ) -> None:
        """Draw a grid of bodies as one skin, and not one by one.

        Parameters
        ----------
        name
            New among the surfaces.
        bodies
            Rows of bodies, all of one length, at least 2 by 2.
        at
            The point of every body the skin passes through, in the body's frame, m.
        colour
            ``"#rrggbb"``; empty: one is chosen.
        """
        self._new_name("surface", name, [s.name for s in self.surfaces])
        for body in (body for row in bodies for body in row):
            self._member(body, f"a body of surface {name!r}")
        columns = {len(row) for row in bodies}
        if len(bodies) < 2 or len(columns) != 1 or min(columns) < 2:
            raise UserError(f"surface {name!r} needs at least 2 rows of at least 2 bodies, all of one length")
        grid = np.array([[body.index for body in row] for row in bodies], np.int64)
        self.surfaces.append(Surface(name, grid, vector(f"at of surface {name!r}", at), check_colour(colour)))

    def plate(self, plate: Plate, a: Body, b: Body, c: Body, d: Body) -> None:
        """Span a plate element between bodies at its corners (0, 0), (a, 0), (a, b), (0, b) of their x-z plane."""
        if not isinstance(plate, Plate):
            raise UserError(f"plate is {plate!r}; it must be a Plate")
        plate.check()
        nodes = (a, b, c, d)
        self._corners("a plate", nodes)
        self.plates.append((plate, nodes))

    def pressure(self, name: str, magnitude: Any, faces: Iterable[Sequence[Body]]) -> None:
        """Let a pressure act on surfaces, along their normals as they turn.

        Parameters
        ----------
        name
            New among the pressures.
        magnitude
            Pa, a number, a signal or an input; positive along y of a flat face.
        faces
            Four bodies each, in the order of a plate's corners.
        """
        self._new_name("pressure", name, [p[0] for p in self.pressures])
        quads = [tuple(face) for face in faces]
        for corners in quads:
            self._corners(f"a face of pressure {name!r}", corners)
        self.pressures.append((name, magnitude, quads))

    def _corners(self, what: str, nodes: tuple[Body, ...]) -> None:
        """Refuse what does not span a surface."""
        for body in nodes:
            self._member(body, f"corner of {what}")
        if len({body.index for body in nodes}) < 4 or len(nodes) > 4:
            raise UserError(f"corners of {what} are {[body.name for body in nodes]}; it needs four bodies")

    def turn(self, body: Body) -> Sensor:
        """Absolute angle (rad) of a body that hangs on the ground by parallel revolutes; it counts whole turns."""
        return Sensor(kind=Kind.TURN, unit="rad", item=self._planar(body))

    def turn_rate(self, body: Body) -> Sensor:
        """Rate of :meth:`turn`, rad/s."""
        return Sensor(kind=Kind.TURN_RATE, unit="rad/s", item=self._planar(body))

    def _planar(self, body: Body) -> Body:
        here, axis = body, body.joint.direction
        while here.index > 0:
            joint = here.joint
            turned = rotation("rotation", joint.rotation) @ joint.direction
            if not isinstance(joint, Revolute | Section) or abs(abs(turned @ axis) - 1.0) > 1e-12:
                raise UserError(
                    f"turn of body {body.name!r} needs parallel revolutes down to the ground, or beams between"
                )
            here = self.bodies[here.parent]
        return body

    def output(self, name: str, sensor: Sensor, description: str = "", nominal: float | None = None) -> None:
        """Publish a quantity under a structured name such as ``crank.angle``."""
        self._new_name("output", name, [o[0] for o in self.outputs])
        self.outputs.append((name, sensor, description, nominal))

    def compile(self) -> Plant:
        """Turn the mechanism into flat arrays and callbacks."""
        from .plant import Plant

        if len(self.bodies) == 1:
            raise UserError("the mechanism has no bodies; add at least one with Mechanism.body")
        return Plant(self)

    def _member(self, body: Body, role: str) -> None:
        if not isinstance(body, Body) or body.index >= len(self.bodies) or self.bodies[body.index] is not body:
            raise UserError(f"{role} is {body!r}, which is not a body of this mechanism")

    @staticmethod
    def _new_name(what: str, name: str, taken: Collection[str]) -> None:
        if not name or name in taken:
            raise UserError(f"{what} is named {name!r}; a name must not be empty and must be new among {list(taken)}")


def rod(*, mass: float, length: float) -> dict[str, Any]:
    """Mass properties of a uniform slender rod along x from the body's origin (along -x for a negative length)."""
    transverse = mass * length**2 / 12.0
    return {"mass": mass, "com": (0.5 * length, 0.0, 0.0), "inertia": (0.0, transverse, transverse)}


def signal_of(value: Any, what: str) -> Signal:
    """Return a signal from a number, a signal or an input."""
    if isinstance(value, int | float) and not np.isfinite(value):
        raise UserError(f"{what} is {value!r}; it must be finite")
    return as_signal(value)


def vector(what: str, value: Vector) -> Matrix:
    """Check three finite numbers."""
    array = np.asarray(value, float)
    if array.shape != (3,) or not np.all(np.isfinite(array)):
        raise UserError(f"{what} is {value!r}; it needs three finite numbers")
    return array


def rotation(what: str, value: Any) -> Matrix:
    """Check a rotation matrix; None is the identity."""
    if value is None:
        return np.eye(3)
    R = np.asarray(value, float)
    if R.shape != (3, 3) or not np.allclose(R @ R.T, np.eye(3), atol=1e-9) or np.linalg.det(R) < 0.0:
        raise UserError(f"{what} is {value!r}; it must be a 3x3 rotation matrix")
    return R


def not_negative(what: str, value: float) -> float:
    """Check a finite number that is not negative."""
    if not np.isfinite(value) or value < 0.0:
        raise UserError(f"{what} is {value!r}; allowed: finite and not negative")
    return float(value)


def inertia_matrix(body: str, value: Any) -> Matrix:
    """Check an inertia: symmetric, no negative principal value, triangle inequality."""
    array = np.asarray(value, float)
    J = np.diag(array) if array.shape == (3,) else array
    what = f"inertia of body {body!r} is {value!r}"
    if J.shape != (3, 3) or not np.all(np.isfinite(J)) or not np.allclose(J, J.T):
        raise UserError(f"{what}; it needs three principal values or a symmetric 3x3 matrix, kg m^2")
    p = np.linalg.eigvalsh(J)
    slack = 1e-9 * max(1.0, p[2])
    if p[0] < -slack or p[2] > p[0] + p[1] + slack:
        raise UserError(f"{what}; principal values must not be negative, nor one exceed the sum of the others")
    return J


def names_of(registry: tuple[type, ...]) -> str:
    """Class names, for messages."""
    return ", ".join(kind.__name__ for kind in registry)

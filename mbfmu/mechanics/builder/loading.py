"""Forces and other loads on the bodies of a mechanism."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from mbfmu.mechanics.checks import Vector, vector
from mbfmu.mechanics.kind import check_element_type
from mbfmu.mechanics.loads import Force, Load, PointForce, Pressure, Rope
from mbfmu.mechanics.sensors import Expression, Sensor
from mbfmu.mechanics.signals import Product, Signal
from mbfmu.util.errors import UserError, short
from mbfmu.util.text_table import format_count

from .bodies import UNPLACED, Body
from .graph import Graph
from .handles import CouplingHandle, CutHandle, ForceHandle, RopeHandle
from .joint_handle import JointHandle

MAX_COMPANION_LEVELS = 10  # of loads that come with loads


class Acting(NamedTuple):
    """A load, what messages call it, the bodies it acts on, and the name that it was given."""

    what: str
    load: Load
    bodies: tuple[Body, ...]
    name: str = ""

    @property
    def place(self) -> str:
        """What messages call it, and its first body: elements of a mesh have no names."""
        return f"{self.what} at {self.bodies[0].name}" if self.bodies else self.what

    @property
    def tied(self) -> tuple[Body, ...]:
        """Those that the structured tangent ties to each other."""
        return self.bodies[: len(self.bodies) - self.load.n_untied_bodies]


class Loading(Graph):
    """Base of :class:`.Mechanism`: forces, elements of meshes, pressures and other loads."""

    def __init__(self) -> None:
        super().__init__()
        self.forces: list[tuple[str, Load, Body, Body]] = []
        self.elements: list[Acting] = []  # loads without a name
        self._element_companions: list[Acting] = []
        self._other_companions: list[Acting] = []
        self.pressures: list[tuple[str, Pressure, list[tuple[Body, ...]]]] = []
        self.others: list[Acting] = []  # loads, by their name
        self.state_equations: list[Acting] = []  # of states that users define
        self.blocks: list[Acting] = []
        self.gravity_signals: dict[int, Signal] = {}

    def force(self, name: str, force: Force, a: Body | JointHandle, b: Body | None = None) -> ForceHandle:
        """Add a force on body a (and b); joint forces act on the tree joint of a, or on joint a.

        Parameters
        ----------
        name
            Unique name among the forces and loads.
        force
            Force element, such as :class:`.Spring` or :class:`.JointForce`.
        a, b
            Bodies of this mechanism; b is the ground by default. Elements of a joint coordinate, such as
            :class:`.JointForce`, act on the tree joint of a, or on a joint a that :meth:`joint` has returned. Most of
            them need a joint of one coordinate.

        Returns
        -------
        ForceHandle
            Handle whose sensors give the force.

        Raises
        ------
        UserError
            The name is used already, a body is not one of this mechanism, or the element is invalid.
        """
        self._new_name("force", name, self._loads_named())
        check_element_type(f"force {name!r}", force, Force)
        if isinstance(a, JointHandle) and not force.on_joint:
            raise UserError(f"force {name!r} acts on bodies, and is given joint {a.name!r}; give it one or two bodies")
        a = self._coordinate_owner(a, f"body a of force {name!r}")
        other = self.ground if b is None else b
        self._member(other, f"body b of force {name!r}")
        if force.on_joint and (needed := force.describe_joint_refusal(a.joint)):
            raise UserError(
                f"force {name!r} needs {needed}; the joint of {a.name!r} is a {type(a.joint).__name__} with "
                f"{format_count(a.joint.nv, 'coordinate')}"
                + "; give the force a joint that Mechanism.joint has returned"
                * (getattr(a, "parent", 0) == UNPLACED)
            )
        if not force.on_joint and a is other:
            raise UserError(f"force {name!r} acts between body {a.name!r} and itself; it needs two bodies")
        force.check(f"force {name!r}")
        if force.on_joint:
            force.check_joint(f"force {name!r}", a.joint)
        self._check_quantities(f"force {name!r}", getattr(force, "quantities", getattr(force, "uses", {})))
        self.forces.append((name, force, a, other))
        return ForceHandle(name, len(self.forces) - 1, force, a, other)

    def element(self, element: Load, *bodies: Body) -> None:
        """Add an element of a mesh between its bodies; unlike a :meth:`load` it has no name.

        Parameters
        ----------
        element
            Element.
        bodies
            Different bodies of this mechanism, in the order that the element requires.
        """
        what = element.title if isinstance(element, Load) else "an element"
        check_element_type(what, element, Load)
        element.check(what)
        self._check_nodes(what, bodies, element.n_bodies)
        self.elements.append(Acting(what, element, bodies))
        self._element_companions += self._companions(self.elements[-1])

    def pressure(self, name: str, magnitude: Any, faces: Iterable[Sequence[Body]]) -> None:
        """Add a pressure on surfaces, along their normals in the deformed position.

        Parameters
        ----------
        name
            Unique name among the pressures.
        magnitude
            Pressure, Pa: number, signal or input; positive along y of a flat face.
        faces
            Four bodies per face, at the corners (0, 0), (a, 0), (a, b), (0, b) of its x-z plane.
        """
        self._new_name("pressure", name, [p[0] for p in self.pressures])
        quads = [tuple(face) for face in faces]
        for corners in quads:
            self._check_nodes(f"a face of pressure {name!r}", corners, 4)
        self.pressures.append((name, Pressure(magnitude=magnitude), quads))

    def rope(
        self,
        name: str,
        path: Sequence[tuple[Body, Vector]],
        *,
        length: float,
        stiffness: float,
        damping: float = 0.0,
    ) -> RopeHandle:
        """Add an elastic rope that slides without friction over points of bodies, such as pulleys.

        The rope pulls if its path is longer than its unloaded length, and is slack otherwise. All segments have one
        tension.

        Parameters
        ----------
        name
            Unique name among the forces and loads.
        path
            Points in their order along the rope, two or more: pairs of a body of this mechanism or its ground and a
            point in the frame of this body (3,), m. A body may occur several times.
        length
            Unloaded length, m.
        stiffness
            Stiffness of the whole rope, N/m: axial stiffness E A divided by the unloaded length.
        damping
            Damping c, s/m: the tension is k x (1 + c x') at the elongation x, with the stiffness k, and not negative.

        Returns
        -------
        RopeHandle
            Handle whose sensors give tension and length.

        Raises
        ------
        UserError
            The name is used already, the path is none of two or more bodies, or a value is invalid.
        """
        what = f"rope {name!r}"
        if not isinstance(path, Sequence):
            raise UserError(f"path of {what} is {short(path)}; allowed: a list of pairs of a body and a point")
        pairs = [own for own in path if isinstance(own, Sequence) and len(own) == 2]
        if len(pairs) < max(2, len(path)):
            raise UserError(
                f"path of {what} has {len(path)} points, {len(pairs)} of them pairs; allowed: two or more pairs of a "
                "body and a point in its frame"
            )
        for body, _ in path:
            self._member(body, f"a body of {what}")
        bodies = tuple(dict.fromkeys(body for body, _ in path))
        if len(bodies) < 2:
            raise UserError(f"path of {what} has points of body {bodies[0].name!r} alone; allowed: two or more bodies")
        points = tuple((bodies.index(body), vector(f"a point of {what}", point)) for body, point in path)
        rope = Rope(path=points, length=length, stiffness=stiffness, damping=damping)
        self.load(name, rope, *bodies)
        return RopeHandle(name, rope, bodies)

    def load(self, name: str, load: Load, *bodies: Body) -> None:
        """Add a load of any type on the required number of bodies; :meth:`force` and :meth:`element` are shorter.

        Parameters
        ----------
        name
            Unique name among the forces and loads.
        load
            Load, for instance a user-defined element.
        bodies
            Bodies of this mechanism, in the order that the load requires.
        """
        self._new_name("load", name, self._loads_named())
        check_element_type(f"load {name!r}", load, Load)
        for body in bodies:
            self._member(body, f"a body of load {name!r}")
        if not bodies:
            raise UserError(f"load {name!r} acts on no body; give it the bodies it acts on")
        load.check(f"load {name!r}")
        if load.n_bodies is not None:
            self._check_nodes(f"load {name!r}", bodies, load.n_bodies)
        self.others.append(Acting(f"load {name!r}", load, bodies, name))
        self._other_companions += self._companions(self.others[-1])

    def load_all(self, name: str, loads: Sequence[tuple[Load, tuple[Body, ...]]]) -> int:
        """Add loads of one name, each on its bodies, such as those of the cells of a mesh.

        Parameters
        ----------
        name
            Unique name among the forces and loads.
        loads
            Pairs of a load and the bodies on which it acts.

        Returns
        -------
        int
            Number of the first of these loads among ``others``.
        """
        self._new_name("load", name, self._loads_named())
        for load, bodies in loads:
            check_element_type(f"load {name!r}", load, Load)
            for body in bodies:
                self._member(body, f"a body of load {name!r}")
        added = [Acting(f"load {name!r}", load, bodies, name) for load, bodies in loads]
        self.others += added
        for acting in added:
            self._other_companions += self._companions(acting)
        return len(self.others) - len(loads)

    def _check_quantities(self, what: str, uses: Mapping[str, Any]) -> None:
        """Raise UserError for sensors and states in a law that are not of this mechanism."""
        for name, source in uses.items():
            if isinstance(source, Sensor):
                self._check_sensor(f"{name!r} in the law of {what}", source)
            elif getattr(source, "mechanism", self) is not self:
                raise UserError(
                    f"{name!r} in the law of {what} is {source.name!r} of another mechanism; use one of this mechanism"
                )

    def _check_sensor(self, what: str, sensor: Sensor) -> None:
        """Raise UserError for a sensor that is not one of this mechanism; ``what`` is text such as "output 'x'"."""
        if isinstance(sensor, Expression):
            self._check_quantities(what, sensor.uses)
        for body in sensor.bodies or ((sensor.item,) if isinstance(sensor.item, Body) else ()):
            self._coordinate_owner(body, f"body of {what}")
        if isinstance(sensor.item, JointHandle) and not any(sensor.item is joint for joint in self.joints):
            raise UserError(f"{what} is of joint {sensor.item.name!r}, which is not one of this mechanism; use its own")
        if isinstance(sensor.item, CutHandle | CouplingHandle) and not any(
            sensor.item is c for c in (*self.cuts, *self.couplings)
        ):
            raise UserError(
                f"{what} is of {sensor.item.name!r}, which is not a constraint of this mechanism; use its own"
            )
        if isinstance(sensor.item, ForceHandle) and not self._has(sensor.item):
            raise UserError(f"{what} is of force {sensor.item.name!r}, which is not one of this mechanism; use its own")
        if getattr(sensor.item, "mechanism", self) is not self:
            raise UserError(
                f"{what} is of {sensor.item.name!r}, which is of another mechanism; use one of this mechanism"
            )

    def _has(self, handle: ForceHandle) -> bool:
        """Whether a force is one of this mechanism."""
        return handle.index < len(self.forces) and self.forces[handle.index][1] is handle.load

    def _loads_named(self) -> list[str]:
        return [*(f[0] for f in self.forces), *(a.name for a in self.others)]

    def loads(self) -> Iterator[Acting]:
        """Yield the loads: forces, elements and what comes with them, pressures, what comes with other loads, other
        loads, gravity that is a signal, equations of states, blocks.
        """
        for name, force, a, b in self.forces:
            yield Acting(f"force {name!r}", force, (a, b), name)
        yield from self.elements
        yield from self._element_companions
        for name, pressure, faces in self.pressures:
            for face in faces:
                yield Acting(f"pressure {name!r}", pressure, face)
        yield from self._other_companions
        yield from self.others
        yield from self._weights()
        yield from self.state_equations
        yield from self.blocks

    def _weights(self) -> Iterator[Acting]:
        """Yield the forces m g(t) at the centers of mass for the components of gravity that are signals."""
        for k, signal in self.gravity_signals.items():
            for body in self.bodies:
                if body.mass > 0.0:
                    weight = PointForce(magnitude=Product(body.mass, signal), axis="xyz"[k], at_a=body.com)
                    yield Acting(f"gravity along {'xyz'[k]} on body {body.name!r}", weight, (body,))

    @property
    def first_other(self) -> int:
        """Number of the first of ``others`` among :meth:`loads` of a mechanism that is complete."""
        of_elements = len(self.elements) + len(self._element_companions)
        of_faces = sum(len(faces) for _, _, faces in self.pressures)
        return len(self.forces) + of_elements + of_faces + len(self._other_companions)

    def _companions(self, acting: Acting) -> list[Acting]:
        """Return the loads that come with a load, and those that come with these; UserError for what is none."""
        what = f"companion of {acting.what}"
        try:
            own = tuple(acting.load.companions())
        except Exception as error:
            raise UserError(
                f"{what}: {type(error).__name__}: {error}; companions() returns a tuple of loads"
            ) from error
        found = []
        for companion in own:
            check_element_type(what, companion, Load)
            companion.check(what)
            if companion.n_bodies is not None:
                self._check_nodes(what, acting.bodies, companion.n_bodies)
            added = Acting(f"{type(companion).__name__.lower()} on {acting.what}", companion, acting.bodies)
            if acting.what.count(" on ") > MAX_COMPANION_LEVELS:
                raise UserError(f"{what} has companions again and again; a load cannot be a companion of itself")
            found += [added, *self._companions(added)]
        return found

    def _check_nodes(self, what: str, nodes: tuple[Body, ...], count: int | None) -> None:
        """Refuse bodies that are not of this mechanism, not all different, or not as many as an element has."""
        for body in nodes:
            self._member(body, f"corner of {what}")
        wanted = len(nodes) if count is None else count
        if len({body.index for body in nodes}) != wanted or len(nodes) != wanted or not nodes:
            names, needed = [body.name for body in nodes], "one or more" if count is None else count
            raise UserError(f"corners of {what} are {names}; it needs {needed} different bodies")

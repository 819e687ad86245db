"""How a mechanism is drawn: its picture, derived from its definition.

A body the model gives no shapes gets bars from its joint to the points of other connections, and a ball at its center
of mass with a volume proportional to the mass.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from mbfmu.mechanics import Mechanism
from mbfmu.mechanics.axes import along
from mbfmu.mechanics.builder.appearance import Surface
from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.builder.flexible_handle import FlexibleHandle
from mbfmu.mechanics.builder.handles import CutHandle
from mbfmu.mechanics.cuts import CutJoint
from mbfmu.mechanics.flexible import Beam, FlexibleBody
from mbfmu.mechanics.joints.section import Section
from mbfmu.mechanics.loads import Rope
from mbfmu.mechanics.shapes import Shape
from mbfmu.util.errors import UserError

from .hulls import Hull, hull_of
from .mesh_solids import MeshSolids, readable_shapes
from .picture import Bar, Link, Matrix, Numbers, Part, Picture, Poses, Skin, cells, numbers
from .profiles import profile_shapes

PALETTE = (
    "#4269d0", "#efb118", "#ff725c", "#3ca951", "#a463f2", "#38b2c4", "#ff8ab7", "#9c6b4e", "#97bbf5", "#8fbf3f",
)  # fmt: skip
GROUND_COLOR, STEEL_COLOR, PIN_COLOR = "#6b7280", "#a3abb8", "#3f4654"
AXIS_COLORS = ("#d9483b", "#3f9b4b", "#3b6fd9")
WHEEL_WIDTH_RATIO = 0.12  # width of a rolling wheel relative to its radius
BENT_AXIS_PIECES = 64  # a flexible body is drawn with: five and more for every bulge of the highest mode


def up_of(mechanism: Mechanism) -> Numbers:
    """Return the direction against gravity; the axis of its first signal, or y, if all components are zero."""
    gravity = mechanism.gravity
    norm = float(np.linalg.norm(gravity))
    return numbers(-gravity / norm) if norm > 0.0 else numbers(np.eye(3)[next(iter(mechanism.gravity_signals), 1)])


def draw(mechanism: Mechanism, span: float, poses: Poses | None = None) -> Picture:
    """Return the picture of a mechanism that moves about in a space ``span`` (m) across.

    ``poses`` has all places that its bodies take; planes without an end are drawn where sheets come.

    Raises
    ------
    UserError
        As :func:`check_fields`.
    """
    check_fields(mechanism)
    return _Artist(mechanism, span, poses).picture()


class _Artist:
    """Draws one mechanism; every part is sized after one bar radius."""

    def __init__(self, mechanism: Mechanism, span: float, poses: Poses | None) -> None:
        self.mechanism = mechanism
        self.coils = list(self._coils())
        self.held = self._held_points()
        self.contact_shapes = _contact_shapes(mechanism, poses)
        self.rolled = {body.index for body, shape in self.contact_shapes if body.index and shape.opacity == 1.0}
        self.profiles = list(profile_shapes(mechanism, poses))
        self.shapes, self.meshes = readable_shapes(mechanism.shapes), MeshSolids()
        self.shaped = {body.index for body, _ in self.shapes} | self.rolled
        for handle, _ in bodies_with_hulls(mechanism):
            self.shaped |= {body.index for body in (handle.body, handle.modes, *handle.sections())}
        self.surfaces = surfaces_of(mechanism)
        self.skinned = {int(i) for surface in self.surfaces for i in surface.bodies.flat}
        bars = [float(np.linalg.norm(p)) for body in mechanism.bodies[1:] for p in self._ends(body)]
        bars += [handle.cut.extent() for handle in mechanism.cuts if handle.cut.drawn == "rod"]
        bars += [beam.length for _, beam in mechanism.beams()]
        self.radius = bar_radius(bars, max([span, *bars]) or 1.0)
        masses = [body.mass for body in mechanism.bodies] + [
            handle.elastic.mass for handle in mechanism.flexible_bodies
        ]
        self.heaviest = max(masses, default=0.0)
        self.parts: list[Part] = []
        self.links: list[Link] = []

    def picture(self) -> Picture:
        """Draw everything."""
        for body in self.mechanism.bodies[1:]:
            if body.index not in self.shaped | self.skinned:
                self._bars_and_ball(body)
            if body.index not in self.skinned | self.rolled:
                self._joint(body)
        for body, shape in (*self.shapes, *self.contact_shapes, *self.profiles):
            for solid, at, axes, mesh in shape.pieces():
                name = solid if mesh is None else self.meshes.name_of(solid, mesh)
                self._part(name, body, at, axes, shape.color or color_of(body), shape.opacity)
        for handle in self.mechanism.cuts:
            self._cut(handle)
        self._stars()
        for acting in self.mechanism.loads():
            if isinstance(acting.load, Rope):
                points = [(acting.bodies[k], point) for k, point in acting.load.path]
                for (a, at_a), (b, at_b) in pairwise(points):
                    self._link("cylinder", a, at_a, b, at_b, 0.3 * self.radius, STEEL_COLOR)
        for a, at_a, b, at_b in self.coils:
            if not {a.index, b.index} <= self.skinned:
                self._link("coil", a, at_a, b, at_b, 2.5 * self.radius, STEEL_COLOR)
                self._feet((a, at_a), (b, at_b))
        skins = tuple(
            Skin(
                name=surface.name,
                bodies=tuple(tuple(int(i) for i in row) for row in surface.bodies),
                at=numbers(surface.at),
                color=surface.color or PALETTE[(k + 5) % len(PALETTE)],
                field=surface.field,
            )
            for k, surface in enumerate(self.surfaces)
        )
        return Picture(
            up=up_of(self.mechanism),
            middles=self._middles(),
            parts=tuple(self.parts),
            links=tuple(self.links),
            skins=skins,
            bars=self._bars(),
            hulls=self._hulls(),
            unnamed=tuple(body.index for body in self.mechanism.bodies if isinstance(body.joint, Section)),
            shown_outputs=tuple(self.mechanism.shown_outputs),
            meshes=tuple(self.meshes.solids),
        )

    def _bars(self) -> tuple[Bar, ...]:
        bars: list[Bar] = []
        first = 0
        for handle, beam in self.mechanism.beams():
            bars.append(self._bar(handle, beam, first))
            first += beam.modes
        return tuple(bars)

    def _hulls(self) -> tuple[Hull, ...]:
        hulls: list[Hull] = []
        first = sum(beam.modes for _, beam in self.mechanism.beams())
        for handle, elastic in bodies_with_hulls(self.mechanism):
            hulls.append(hull_of(handle, elastic, first, color_of(handle.body)))
            first += elastic.modes
        return tuple(hulls)

    def _bar(self, elastic: FlexibleHandle, beam: Beam, first: int) -> Bar:
        profile = self.mechanism.profiles.get(elastic.index)
        x = np.linspace(0.0, beam.length, BENT_AXIS_PIECES + 1)
        return Bar(
            name=elastic.name,
            body=elastic.body.index,
            first=first,
            x=numbers(x),
            shapes=tuple(numbers(beam.shape(float(place))[0]) for place in x),
            shortenings=tuple(tuple(map(numbers, beam.shortening(float(place)))) for place in x if beam.stiffening),
            height=profile.height if profile else 1.2 * self.radius,
            width=profile.width if profile else 1.2 * self.radius,
            color=profile.color if profile and profile.color else color_of(elastic.body),
        )

    def _stars(self) -> None:
        """Draw a body of finite elements without a mesh as bars from its center of mass to its interfaces."""
        for handle in self.mechanism.flexible_bodies:
            if isinstance(handle.elastic, FlexibleBody) and handle.elastic.triangles is None:
                center = handle.elastic.com
                self._part("sphere", handle.body, center, np.eye(3) * 2.0 * self.radius, color_of(handle.body))
                for body in (handle.body, *handle.sections()):
                    ends = (handle.body, center, body, np.zeros(3))
                    self._link("cylinder", *ends, self.radius, color_of(handle.body))

    def _middles(self) -> tuple[Numbers, ...]:
        middles = [numbers(body.com) for body in self.mechanism.bodies]
        for handle, beam in self.mechanism.beams():
            middles[handle.body.index] = (0.5 * beam.length, 0.0, 0.0)
        for surface in self.surfaces:
            for i in surface.bodies.flat:
                middles[i] = numbers(surface.at)
        return tuple(middles)

    def _coils(self) -> Iterator[tuple[Body, Any, Body, Any]]:
        """Yield the two bodies that every coil is between, with the points on them, body axes."""
        for acting in self.mechanism.loads():
            load, bodies = acting.load, acting.bodies
            if load.drawn != "coil":
                continue
            body, joint = bodies[0], bodies[0].joint
            if len(load.points()) == len(bodies) == 2:
                yield bodies[0], load.points()[0], bodies[1], load.points()[1]
            elif getattr(load, "stiffness", None) == 0.0:  # a damper in a joint
                continue
            elif load.on_joint and joint.drawn == "slide" and joint.units == ("m",):
                yield self.mechanism.bodies[body.parent], joint.at, body, body.joint_at

    def _held_points(self) -> list[list[Matrix]]:
        """Return, for every body, the connection points of other bodies, cuts and springs, body axes."""
        held: list[list[Matrix]] = [[] for _ in self.mechanism.bodies]
        for body in self.mechanism.bodies[1:]:
            if body.joint.drawn != "free":
                held[body.parent].append(np.asarray(body.joint.at, float))
                held[body.index].append(body.joint_at)
        cuts = ((handle.a, handle.cut.at_a, handle.b, handle.cut.at_b) for handle in self.mechanism.cuts)
        for a, at_a, b, at_b in (*cuts, *self.coils):
            held[a.index].append(np.asarray(at_a, float))
            held[b.index].append(np.asarray(at_b, float))
        return held

    def _ends(self, body: Body) -> list[Matrix]:
        """Return where the bars from a body's origin lead; of several in one direction the farthest."""
        ends: list[Matrix] = []
        for point in sorted([*self.held[body.index], body.com], key=lambda p: -float(p @ p)):
            size = float(np.linalg.norm(point))
            if size > 0.0 and all(point @ end < (1.0 - 1e-9) * size * np.linalg.norm(end) for end in ends):
                ends.append(point)
        return ends

    def _bars_and_ball(self, body: Body) -> None:
        color, ends = color_of(body), self._ends(body)
        thick = self.radius * (1.0 + 0.08 * (body.index % 3))  # bars that lie in one line do not flicker
        for end in ends:
            size = float(np.linalg.norm(end))
            self._part("cylinder", body, 0.5 * end, along(end / size) * [thick, thick, size], color)
            self._part("sphere", body, end, np.eye(3) * thick, color)
        if ends:
            self._part("sphere", body, np.zeros(3), np.eye(3) * thick, color)
        if body.mass > 0.0:
            ball = self.radius * max(1.4, 3.2 * (body.mass / self.heaviest) ** (1.0 / 3.0))
            self._part("sphere", body, body.com, np.eye(3) * ball, color)
            if not ends and body.joint.quaternion:  # show how it turns
                for axis, of_axis in zip(np.eye(3), AXIS_COLORS, strict=True):
                    bar = along(axis) * [0.5 * thick, 0.5 * thick, 1.5 * ball]
                    self._part("cylinder", body, body.com + 1.25 * ball * axis, bar, of_axis)

    def _joint(self, body: Body) -> None:
        joint, r = body.joint, self.radius
        parent = self.mechanism.bodies[body.parent]
        if joint.drawn == "free":
            return
        if joint.drawn == "pin":
            self._pin(body, body.joint_at, body.joint_rotation @ joint.direction)
        elif joint.drawn == "ball":
            self._part("sphere", body, body.joint_at, np.eye(3) * 1.7 * r, PIN_COLOR)
        elif joint.drawn == "slide":
            self._link("cylinder", parent, joint.at, body, body.joint_at, 0.7 * r, color_of(parent))
        self._feet((parent, joint.at))

    def _cut(self, handle: CutHandle) -> None:
        cut: CutJoint = handle.cut
        a, b, r = handle.a, handle.b, self.radius
        if {a.index, b.index} <= self.skinned:
            return
        if cut.drawn == "rod":
            self._link("cylinder", a, cut.at_a, b, cut.at_b, 0.6 * r, STEEL_COLOR)
            for body, at in ((a, cut.at_a), (b, cut.at_b)):
                self._part("sphere", body, at, np.eye(3) * 1.3 * r, PIN_COLOR)
        elif cut.drawn == "wheel":
            if b.index not in self.shaped:
                R = cut.extent()
                axes = along(cut.frames()[1][:, 2]) * [R, R, WHEEL_WIDTH_RATIO * R]
                self._part("cylinder", b, cut.at_b, axes, color_of(b))
            return
        elif cut.drawn == "ball":
            self._part("sphere", a, cut.at_a, np.eye(3) * 1.7 * r, PIN_COLOR)
        else:
            self._pin(a, cut.at_a, cut.frames()[0][:, 2])
        self._feet((a, cut.at_a), (b, cut.at_b))

    def _pin(self, body: Body, at: Sequence[float] | Matrix, axis: Matrix) -> None:
        r = self.radius
        self._part("cylinder", body, at, along(axis) * [1.5 * r, 1.5 * r, 4.0 * r], PIN_COLOR)

    def _feet(self, *points: tuple[Body, Any]) -> None:
        """Mark those of the points that are on the ground: it carries something there."""
        for body, at in points:
            if body.index == 0:
                self._part("box", body, at, np.eye(3) * 3.6 * self.radius, GROUND_COLOR)

    def _part(
        self, solid: str, body: Body, at: Sequence[float] | Matrix, axes: Matrix, color: str, opacity: float = 1.0
    ) -> None:
        flat = numbers(np.asarray(axes).T.ravel())
        own = Part(solid=solid, body=body.index, at=numbers(at), axes=flat, color=color, opacity=float(opacity))
        self.parts.append(own)

    def _link(self, solid: str, a: Body, at_a: Any, b: Body, at_b: Any, radius: float, color: str) -> None:
        ends: dict[str, Any] = {"a": a.index, "b": b.index, "at_a": numbers(at_a), "at_b": numbers(at_b)}
        self.links.append(Link(solid=solid, radius=radius, color=color, **ends))


def bodies_with_hulls(mechanism: Mechanism) -> list[tuple[FlexibleHandle, FlexibleBody]]:
    """Return the bodies of finite elements whose surface is known."""
    return [
        (handle, handle.elastic)
        for handle in mechanism.flexible_bodies
        if isinstance(handle.elastic, FlexibleBody) and handle.elastic.triangles is not None
    ]


def surfaces_of(mechanism: Mechanism) -> list[Surface]:
    """Return the surfaces of a mechanism, and those of its meshes that it gives none."""
    found = list(mechanism.surfaces)
    drawn = {int(i) for surface in found for i in surface.bodies.flat}
    for mesh in mechanism.meshes:
        nodes = np.array([[node.index for node in row] for row in mesh.nodes], np.int64)
        if not drawn.intersection(map(int, nodes.flat)):
            found.append(Surface(mesh.name, nodes, np.zeros(3), ""))
    return found


def check_fields(mechanism: Mechanism) -> None:
    """Raise UserError where a surface has a field whose outputs are not all there, or not in one unit."""
    units = {name: sensor.unit for name, sensor, *_ in mechanism.outputs}
    for surface in mechanism.surfaces:
        names = cells(surface.field, *surface.bodies.shape)
        for name in names:
            if name not in units:
                raise UserError(
                    f"field of surface {surface.name!r} is {surface.field!r}, but there is no output {name!r}; it "
                    f"needs one for each of the surface's cells, {names[0]!r} to {names[-1]!r}"
                )
            if units[name] != units[names[0]]:
                raise UserError(
                    f"field of surface {surface.name!r} has {names[0]!r} in {units[names[0]]} and {name!r} in "
                    f"{units[name]}; allowed: one unit"
                )


def _contact_shapes(mechanism: Mechanism, poses: Poses | None) -> list[tuple[Body, Shape]]:
    """Return what sheets are in contact with; without loads on several bodies, the code of sheets is not imported."""
    if not mechanism.others:
        return []
    from .contacts import contact_shapes

    return list(contact_shapes(mechanism, poses))


def bar_radius(bars: list[float], across: float) -> float:
    """Return how thick bars of these lengths (m) look well in a picture of something ``across`` (m) wide."""
    if not bars:
        return 0.015 * across
    usual = float(np.median(bars))
    return min(max(0.03 * usual, 0.004 * across), 0.12 * usual, 0.015 * across)


def color_of(body: Body) -> str:
    """Return the color a body is given."""
    return PALETTE[(body.index - 1) % len(PALETTE)] if body.index else GROUND_COLOR

"""Sketches of elements for the reference: bodies drawn by the viewer in one pose, with arrows and lines over them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import BytesIO
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
from matplotlib.patches import Polygon
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from mbfmu.mechanics import Body, Floating, Joint, Mechanism
from mbfmu.mechanics.axes import along
from mbfmu.mechanics.kind import kernel_of, record_of
from mbfmu.mechanics.records import RelativeMotionRecord
from mbfmu.viewer.drawing import draw
from mbfmu.viewer.images import DPI, Artist, Shot
from mbfmu.viewer.motion import Motion

Array = NDArray[np.float64]
Vector = Sequence[float]

GRAY, BLUE, DARK = "#a9b2c0", "#4c7be0", "#4a5263"  # body a, body b, pins
MOTION, FORCE, LINE = "#2f9e44", "#e03131", "#868e96"  # arrows of free directions, of forces; axes and dashed lines
SIZE = (288, 216)  # pixels: twice the size shown, for screens of high resolution
COLORS = 64  # of a file
WIDTH = 2.6  # of lines, points
HEAD = 0.085  # length of an arrow's head, in picture heights
BEHIND, BEFORE = 1.5, 3.0  # drawing order of lines; that of solids is 2


def pose(joint: Joint) -> tuple[Array, Array]:
    """Return origin and axes of a child in its parent, at the joint's start position."""
    start = joint.rest() if joint.start is None else np.atleast_1d(np.asarray(joint.start, float))
    record = np.zeros(1, record_of(joint)).view(np.recarray)[0] if record_of(joint).names else None
    joint.fill(record, SimpleNamespace(name="b"))  # type: ignore[arg-type]
    state = SimpleNamespace(q=start, rel=np.zeros(1, RelativeMotionRecord.dtype).view(np.recarray))
    place = kernel_of(joint, "place")
    getattr(place, "py_func", place)(record, 0, state)
    axes = np.eye(3) if joint.rotation is None else np.asarray(joint.rotation, float)
    return np.asarray(joint.at) + axes @ state.rel.p[0], axes @ state.rel.R[0]


@dataclass(frozen=True, kw_only=True)
class Line:
    """A line over a picture."""

    points: Array  # (k, 3), m
    color: str
    style: Any = "-"  # as matplotlib has it
    heads: str = ""  # of arrows: at start, end, both, or none
    width: float = WIDTH
    order: float = BEFORE
    split: Any = None  # a point: what is farther away is drawn behind the solids

    def draw(self, ax: Any, camera: Any, height: float) -> None:
        """Draw it into a picture of this height, in the units of the camera."""
        flat, depth = camera.project(self.points)
        behind = np.full(len(flat), self.order == BEHIND)
        if self.split is not None:
            behind = depth > camera.project(np.asarray(self.split, float))[1]
        head = HEAD * height * self.width / WIDTH
        length = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(flat, axis=0), axis=1))))
        first, last = (0.7 * head * (self.heads in (end, "both")) for end in ("start", "end"))
        fine = np.linspace(first, length[-1] - last, 80)
        path = np.column_stack([np.interp(fine, length, flat[:, k]) for k in range(2)])
        hidden = np.interp(fine, length, behind.astype(float)) > 0.5
        changes = [0, *(np.flatnonzero(np.diff(hidden.astype(int))) + 1), len(fine)]
        for i, k in pairwise(changes):
            order = BEHIND if hidden[i] else self.order
            look = {"color": self.color, "lw": self.width, "ls": self.style, "solid_capstyle": "butt"}
            ax.plot(*path[i : k + 1].T, zorder=order, **look)
        for end, k in (("start", 0), ("end", -1)):
            if self.heads in (end, "both"):
                way = flat[k] - path[k]
                way /= max(float(np.linalg.norm(way)), 1e-12)
                base, side = flat[k] - head * way, 0.42 * head * np.array((-way[1], way[0]))
                order = BEHIND if behind[k] else self.order
                ax.add_patch(Polygon([flat[k], base + side, base - side], color=self.color, lw=0, zorder=order))


class Sketch:
    """One element between a gray body and a blue one, and the marks drawn over them."""

    def __init__(self, azimuth: float = 28.0, elevation: float = 24.0, bar: float = 0.001) -> None:
        self.mechanism = Mechanism(gravity=(0.0, 0.0, -9.81))
        self.azimuth, self.elevation, self.bar = azimuth, elevation, bar
        self.poses = [(np.zeros(3), np.eye(3))]
        self.lines: list[Line] = []
        self.a = self.body("a", self.mechanism.ground, Floating())

    def body(self, name: str, parent: Body, joint: Joint, moved: Vector = (0.0, 0.0, 0.0)) -> Body:
        """Add a body; ``moved`` is a displacement in the parent, in addition to that of the joint."""
        r, A = pose(joint)
        origin, axes = self.poses[parent.index]
        self.poses.append((origin + axes @ (r + moved), axes @ A))
        return self.mechanism.body(name, parent, joint, mass=0.0)

    def other(self, at: Vector = (0.0, 0.0, 0.0), turned: Vector = (0.0, 0.0, 0.0), name: str = "b") -> Body:
        """Add a body without a joint; ``turned`` is its rotation vector."""
        x, y, z, w = Rotation.from_rotvec(turned).as_quat()
        return self.body(name, self.mechanism.ground, Floating(start=(*at, w, x, y, z)))

    def show(self, body: Body, color: str, *shapes: Any) -> None:
        """Give a body shapes, of this color unless they have their own."""
        for shape in shapes:
            object.__setattr__(shape, "color", shape.color or color)
        self.mechanism.shape(body, *shapes)

    def line(self, points: Any, color: str = LINE, **how: Any) -> None:
        """Draw a line through points, with the attributes of a :class:`Line`."""
        self.lines.append(Line(points=np.asarray(points, float), color=color, **how))

    def axis(self, way: Any, at: Vector = (0.0, 0.0, 0.0), length: float = 3.0) -> None:
        """Draw the axis of a joint, hidden by the bodies."""
        half = 0.5 * length * unit(way)
        self.line((np.asarray(at) - half, np.asarray(at) + half), style=(0, (6, 2, 1.2, 2)), width=1.6, order=BEHIND)

    def slide(self, way: Any, at: Vector, length: float = 1.2, color: str = MOTION, heads: str = "both") -> None:
        """Draw a straight arrow about a point."""
        half = 0.5 * length * unit(way)
        self.line((np.asarray(at) - half, np.asarray(at) + half), color, heads=heads)

    def push(self, start: Vector, end: Vector, color: str = FORCE, order: float = BEFORE) -> None:
        """Draw the arrow of a force."""
        self.line((start, end), color, heads="end", width=3.6, order=order)

    def turn(
        self,
        way: Any,
        at: Vector,
        radius: float,
        angles: tuple[float, float] = (-150.0, 110.0),
        rise: float = 0.0,
        color: str = MOTION,
        **how: Any,
    ) -> None:
        """Draw an arc about an axis, from and to angles in degrees; ``rise`` along the axis makes it a helix."""
        frame = along(unit(way))
        phi = np.radians(np.linspace(*angles, 60))
        circle = np.outer(np.cos(phi), frame[:, 0]) + np.outer(np.sin(phi), frame[:, 1])
        points = np.asarray(at) + radius * circle + np.outer(np.linspace(-0.5, 0.5, 60) * rise, frame[:, 2])
        self.line(points, color, **{"heads": "both", "split": at, **how})

    def loop(self, start: Vector, end: Vector, bulge: Vector = (0.0, 0.0, -1.3)) -> None:
        """Draw the rest of a loop, dashed, from the gray body round to the blue one."""
        s = np.linspace(0.0, np.pi, 60)[:, None]
        middle, half = 0.5 * np.add(start, end), 0.5 * np.subtract(start, end)
        points = middle + half * np.sign(np.cos(s)) * np.abs(np.cos(s)) ** 0.6
        points = points + np.asarray(bulge) * np.abs(np.sin(s)) ** 0.6
        self.line(points, style=(0, (2.2, 1.4)), width=2.2, order=BEHIND)

    def png(self) -> bytes:
        """Draw everything."""
        r = np.array([[origin for origin, _ in self.poses]], np.float32)
        A = np.array([[axes for _, axes in self.poses]], np.float32)
        e = np.roll(Rotation.from_matrix(A[0]).as_quat(), 1, axis=-1)[None].astype(np.float32)
        bodies, none = self.mechanism.bodies, np.zeros((1, 0))
        motion = Motion(
            title="", times=np.zeros(1), names=tuple(body.name for body in bodies),
            parents=tuple(body.parent for body in bodies), joints=("",) * len(bodies),
            r=r, e=e, p=none.astype(np.float32), outputs=(), values=none, arrows=(),
            forces=np.zeros((1, 0, 3), np.float32), picture=draw(self.mechanism, 67.0 * self.bar, (r, A)),
        )  # fmt: skip
        artist = Artist(motion, Shot(*SIZE, self.azimuth, self.elevation, solids_only=True))
        artist.draw(0)
        ax = artist.figure.axes[0]
        corners = [np.concatenate([path.vertices for path in own.get_paths()]) for own in ax.collections]
        corners += [artist.camera.project(line.points)[0] for line in self.lines]
        low, high = np.min([c.min(axis=0) for c in corners], axis=0), np.max([c.max(axis=0) for c in corners], axis=0)
        height = 1.1 * max(high[1] - low[1], (high[0] - low[0]) * SIZE[1] / SIZE[0])
        half = 0.5 * height * np.array((SIZE[0] / SIZE[1], 1.0))
        middle = 0.5 * (low + high)
        ax.set_xlim(middle[0] - half[0], middle[0] + half[0])
        ax.set_ylim(middle[1] - half[1], middle[1] + half[1])
        for line in self.lines:
            line.draw(ax, artist.camera, height)
        buffer = BytesIO()
        artist.figure.savefig(buffer, dpi=DPI, format="png", transparent=True)
        return compressed(buffer)


def unit(way: Any) -> Array:
    """Return a unit vector along a direction or a named axis."""
    vector = np.eye(3)["xyz".index(way)] if isinstance(way, str) else np.asarray(way, float)
    return vector / np.linalg.norm(vector)


def compressed(png: BytesIO) -> bytes:
    """Return a picture with few colors, some of them translucent."""
    out = BytesIO()
    Image.open(png).quantize(COLORS, Image.Quantize.FASTOCTREE).save(out, "png", optimize=True)
    return out.getvalue()


PICTURES: dict[str, Callable[[], Sketch]] = {}


def element(name: str) -> Callable[[Any], Any]:
    """Register the picture of an element of this name."""

    def register(function: Any) -> Any:
        PICTURES[name] = function
        return function

    return register

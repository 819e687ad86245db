"""Still pictures and films of a motion, drawn with matplotlib: solids as faces, those farthest away first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from subprocess import CalledProcessError
from typing import Any

import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mbfmu.mechanics.axes import along
from mbfmu.util.errors import UserError
from mbfmu.util.files import replacing

from .camera import Camera, Stage
from .fields import Field, colored, fields, hull_fields
from .motion import Motion, matrices

Array = NDArray[np.float64]

DPI = 100
BACKGROUND, INK, GRID_COLOR, SHADOW = "#eef1f5", "#1d2430", "#c3cad4", "#d3d8e0"
PANEL_FACES = np.array([[(-0.5, -0.5, 0.0), (0.5, -0.5, 0.0), (0.5, 0.5, 0.0), (-0.5, 0.5, 0.0)]])
ONE_SIDE, BOTH_SIDES, SKIN_SIDES = range(
    3
)  # solids, of which one side is seen; meshes, which may be open; skins and panels
SHOWN_SIDES = {"panel": SKIN_SIDES, "mesh": BOTH_SIDES}
MAX_FINE_PARTS = 300  # parts; more are drawn with fewer faces


@dataclass(frozen=True)
class Shot:
    """How pictures are taken: size in pixels, angles of the camera in degrees (None: those that suit the motion).

    A picture with ``solids_only`` has no floor, shadow, title or time, and its background is transparent.
    """

    width: int = 960
    height: int = 720
    azimuth: float | None = None
    elevation: float | None = None
    solids_only: bool = False


def write_png(motion: Motion, path: Path, time: float, shot: Shot) -> None:
    """Draw the recorded frame next to a time (s)."""
    artist = Artist(motion, shot)
    artist.draw(motion.frame(time))
    with replacing(path) as unfinished:
        artist.figure.savefig(unfinished, dpi=DPI, format="png")


def write_film(
    motion: Motion,
    path: Path,
    shot: Shot,
    fps: int = 25,
    speed: float = 1.0,
    progress: Callable[[], None] | None = None,
) -> None:
    """Draw a GIF or an MP4, after the file's name, of ``fps`` pictures a second at ``speed`` times real time."""
    if path.suffix == ".mp4":
        if not FFMpegWriter.isAvailable():
            raise UserError(f"{str(path)!r} needs the program ffmpeg, which is not installed; a GIF needs nothing more")
        writer: Any = FFMpegWriter(fps=fps, extra_args=["-pix_fmt", "yuv420p"])
    else:
        writer = PillowWriter(fps=fps)
    artist = Artist(motion, shot)
    with replacing(path) as unfinished:
        try:
            with writer.saving(artist.figure, str(unfinished), DPI):
                for time in film_times(motion, fps, speed):
                    artist.draw(motion.frame(float(time)))
                    writer.grab_frame()
                    if progress is not None:
                        progress()
        except (CalledProcessError, BrokenPipeError) as error:
            raise UserError(
                f"{str(path)!r} cannot be written: the program ffmpeg fails; check its installation, or write a .gif"
            ) from error


def film_times(motion: Motion, fps: int, speed: float) -> Array:
    """Return the times (s) a film shows."""
    span = float(motion.times[-1] - motion.times[0])
    count = int(span / speed * fps + 1e-9) + 1
    times: Array = np.minimum(motion.times[0] + np.arange(count) * (speed / fps), motion.times[-1])
    return times


class Artist:
    """Draws frames of a motion into one figure."""

    def __init__(self, motion: Motion, shot: Shot) -> None:
        self.motion = motion
        self.shot = shot
        self.stage = stage = Stage.of(motion)
        azimuth = stage.azimuth if shot.azimuth is None else shot.azimuth
        elevation = stage.elevation if shot.elevation is None else shot.elevation
        self.camera = Camera.looking_at(stage, shot.width / shot.height, azimuth, elevation)
        self.axes = np.array(stage.axes)
        self.light = np.array([0.35, 1.0, 0.55]) @ self.axes
        self.light /= np.linalg.norm(self.light)
        self.floor = stage.center[1] - stage.half[1] - 0.01 * float(np.linalg.norm(stage.half))
        picture = motion.picture
        fine = len(picture.parts) + len(picture.links) < MAX_FINE_PARTS
        self.solids = {"sphere": sphere(fine), "cylinder": cylinder(fine), "box": box(fine), "panel": PANEL_FACES}
        self.solids["coil"], self.wire = coil()
        for k, mesh in enumerate(picture.meshes):
            self.solids[f"mesh{k}"] = mesh.corners()[:, [0, 1, 2, 2]]
        self.colors = {c: np.array(to_rgb(c)) for c in self._colors()}
        ground = "none" if shot.solids_only else BACKGROUND
        self.figure = Figure(figsize=(shot.width / DPI, shot.height / DPI), facecolor=ground)
        self.grid = self._grid()
        self.fields, self.hull_fields = fields(motion), hull_fields(motion)

    def _colors(self) -> set[str]:
        picture = self.motion.picture
        return {
            thing.color for things in (picture.parts, picture.links, picture.bars, picture.skins) for thing in things
        }

    def draw(self, frame: int) -> None:
        """Draw one frame, in place of what was drawn before."""
        self.figure.clear()
        ax = self.figure.add_axes((0.0, 0.0, 1.0, 1.0))
        ax.set_axis_off()
        aspect = self.shot.width / self.shot.height
        ax.set_xlim(-0.5 * aspect, 0.5 * aspect)
        ax.set_ylim(-0.5, 0.5)
        if not self.shot.solids_only:
            ax.add_collection(LineCollection(self.grid, colors=GRID_COLOR, linewidths=0.7, zorder=0))
        faces, colors, sides, opacity = self._faces(frame)
        clear = opacity < 1.0
        if not clear.all() and not self.shot.solids_only:
            self._cast(ax, faces[~clear])
        for own in filter(np.any, (clear, ~clear)):  # what is led along glass stands before it, as it is seen through
            self._paint(ax, faces[own], colors[own], sides[own], opacity[own])
        if not self.shot.solids_only:
            self._caption(frame)

    def _caption(self, frame: int) -> None:
        """Draw title, outputs, time and what the colors mean."""
        clock = "   ".join(filter(None, (f"{self.motion.times[frame]:.3f} s", self.motion.caption)))
        self.figure.text(0.02, 0.965, self.motion.title, color=INK, fontsize=12, va="center", weight="bold")
        below = 1.0 - 44.0 / self.shot.height
        self.figure.text(0.02, below, self.motion.reading(frame), color=INK, fontsize=12, va="top", family="monospace")
        self.figure.text(0.02, 0.03, clock, color=INK, fontsize=10, va="center", family="monospace")
        shown = [field for field in (*self.fields, *self.hull_fields) if field]
        for k, field in enumerate({field.title: field for field in shown}.values()):
            self._legend(field, 68.0 * k)

    def _legend(self, field: Field, above: float) -> None:
        """Draw the color bar of a field into the lower right corner, ``above`` pixels above the others."""
        wide, high = self.shot.width, self.shot.height
        left, right, low = 1.0 - min(246.0 / wide, 0.6), 1.0 - 46.0 / wide, (36.0 + above) / high
        bar = self.figure.add_axes((left, low, right - left, 12.0 / high))
        bar.set_axis_off()
        limit = field.limit or 1.0
        bar.imshow(colored(np.linspace(field.low, limit, 256), limit)[None], aspect="auto")
        middle = 0.5 * (left + right)
        self.figure.text(middle, low + 26.0 / high, field.title, color=INK, fontsize=9, ha="center", va="center")
        zero = middle if field.low < 0.0 or not field.limit else left
        ticks = {left: field.low, zero: 0.0, right: field.limit} if field.limit else {zero: 0.0}
        for x, value in ticks.items():
            self.figure.text(x, low - 12.0 / high, f"{value:.3g}", color=INK, fontsize=9, ha="center", va="center")

    def _faces(self, frame: int) -> tuple[Array, Array, NDArray[np.int64], Array]:
        """Return faces (n, 4, 3) in global axes, their colors (n, 3), which sides are shown, and opacities (n,)."""
        motion, picture = self.motion, self.motion.picture
        r, A = motion.r[frame].astype(float), matrices(motion.e[frame].astype(float))
        faces: list[Array] = []
        colors: list[Array] = []  # one for all faces of a thing, or (n, 3)
        for part in picture.parts:
            local = self.solids[part.solid] @ np.reshape(part.axes, (3, 3)) + part.at
            faces.append(local @ A[part.body].T + r[part.body])
            colors.append(self.colors[part.color])
        for link in picture.links:
            a, b = (A[body] @ at + r[body] for body, at in ((link.a, link.at_a), (link.b, link.at_b)))
            size = float(np.linalg.norm(b - a))
            if size > 0.0:
                turned = along((b - a) / size)
                solid = self.solids[link.solid] * [link.radius, link.radius, size]
                solid = solid + link.radius * self.wire if link.solid == "coil" else solid
                faces.append(solid @ turned.T + 0.5 * (a + b))
                colors.append(self.colors[link.color])
        for bar in picture.bars:
            faces.append(bent(motion.axis(bar, frame), A[bar.body][:, 2], bar.height, bar.width))
            colors.append(self.colors[bar.color])
        for hull, own in zip(picture.hulls, self.hull_fields, strict=True):
            faces.append(motion.hull_points(hull, frame)[hull.corners][:, [0, 1, 2, 2]])
            values = hull.values(motion.p[frame, hull.modes].astype(float))[hull.corners].mean(axis=1)
            colors.append(colored(values, own.limit))
        sides = [SHOWN_SIDES.get(part.solid.rstrip("0123456789"), ONE_SIDE) for part in picture.parts]
        sides += [ONE_SIDE] * (len(faces) - len(sides)) + [SKIN_SIDES] * len(picture.skins)
        opacity = [part.opacity for part in picture.parts]
        for skin, field in zip(picture.skins, self.fields, strict=True):
            grid = np.array(skin.bodies)
            p = r[grid] + A[grid] @ np.array(skin.at)
            quads = np.stack((p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]), axis=2)
            faces.append(quads.reshape(-1, 4, 3))
            colors.append(self._cells(field, self.colors[skin.color], frame) if field else self.colors[skin.color])
        if not faces:
            return np.zeros((0, 4, 3)), np.zeros((0, 3)), np.zeros(0, int), np.zeros(0)
        total = np.concatenate(faces)
        tints = np.concatenate([np.broadcast_to(c, (len(f), 3)) for f, c in zip(faces, colors, strict=True)])
        counts = [len(f) for f in faces]
        opacity += [1.0] * (len(faces) - len(opacity))
        return total, tints, np.repeat(sides, counts), np.repeat(opacity, counts)

    def _cells(self, field: Field, otherwise: Array, frame: int) -> Array:
        """Return the colors (cells, 3) of a field; ``otherwise`` where its values are not finite."""
        colors = colored(self.motion.values[frame, field.columns], field.limit)
        return np.where(np.isnan(colors), otherwise, colors)

    def _cast(self, ax: Any, faces: Array) -> None:
        """Draw the shadows on the floor, where the camera is above it."""
        up = self.axes[1]
        if self.camera.eye @ up <= self.floor:
            return
        drop = (faces @ up - self.floor) / (self.light @ up)
        fallen: Any = self.camera.project(faces - drop[..., None] * self.light)[0]
        ax.add_collection(PolyCollection(fallen, facecolors=SHADOW, edgecolors=SHADOW, linewidths=0.3, zorder=1))

    def _paint(self, ax: Any, faces: Array, colors: Array, sides: NDArray[np.int64], opacity: Array) -> None:
        """Draw faces, all of them opaque or all translucent, over what is there."""
        both, thin = sides != ONE_SIDE, sides == SKIN_SIDES
        normals = np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1])
        normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-30)[:, None]
        middle = faces.mean(axis=1)
        sight = self.camera.eye - middle
        front = np.einsum("ij,ij->i", normals, sight) / np.linalg.norm(sight, axis=1)
        normals[both & (front < 0.0)] *= -1.0
        shown = both | (front >= 0.0)
        n = normals[shown]
        through = np.where(thin[shown], 0.25, 0.0)  # skins let light shine through
        sky, key = n @ self.axes[1], n @ self.light
        bright = 0.45 + 0.11 * (1.0 - 2.0 * through) * sky + 0.14 * np.abs(front[shown])
        bright += 0.42 * np.where(key > 0.0, 1.0 - through, through) * np.abs(key)
        color = np.minimum(colors[shown] * bright[:, None], 1.0)
        points, depth = self.camera.project(faces[shown])
        order = np.argsort(-depth.mean(axis=1))
        outlines: Any = points[order]
        if opacity[0] < 1.0:  # outlines would be seen twice where one face meets the next
            look: Any = {"edgecolors": "none", "alpha": opacity[shown][order]}
        else:
            look = {"edgecolors": np.where(thin[shown][:, None], 0.8 * color, color)[order], "linewidths": 0.35}
        ax.add_collection(PolyCollection(outlines, facecolors=color[order], zorder=2, **look))

    def _grid(self) -> Any:
        """Return the lines (n, 2, 2) of the floor's grid in picture coordinates."""
        center, half = self.stage.center, self.stage.half
        reach = 1.8 * max(half[0], half[2], 0.5 * half[1])
        spacing = rounded(reach / 4.0)
        count = int(np.ceil(reach / spacing))
        middle = spacing * np.round(np.array(center) / spacing)
        ticks = spacing * np.arange(-count, count + 1)
        edge = ticks[-1]
        ends = [((x, -edge), (x, edge)) for x in ticks] + [((-edge, x), (edge, x)) for x in ticks]
        flat = np.array(ends)
        local = np.stack(
            (middle[0] + flat[..., 0], np.full(flat.shape[:2], self.floor), middle[2] + flat[..., 1]), axis=-1
        )
        lines, _ = self.camera.project(local @ self.axes)
        return lines


def rounded(size: float) -> float:
    """Return a round number (1, 2 or 5 times a power of ten) not above a size."""
    power = 10.0 ** np.floor(np.log10(size))
    return float(power * max(digit for digit in (1.0, 2.0, 5.0) if digit * power <= size * (1.0 + 1e-12)))


def patch(rows: int, columns: int, point: Callable[[Array, Array], Array]) -> Array:
    """Return the faces (n, 4, 3) of a grid over (u, v) in [0, 1] x [0, 1]."""
    u, v = np.meshgrid(np.linspace(0.0, 1.0, rows + 1), np.linspace(0.0, 1.0, columns + 1), indexing="ij")
    p = point(u, v)
    return np.stack((p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]), axis=2).reshape(-1, 4, 3)


def bent(axis: Array, z: Array, height: float, width: float) -> Array:
    """Return the faces (n, 4, 3) of a bar along an axis (k, 3) that bends across the unit vector z."""
    tangents = np.gradient(axis, axis=0)
    up = np.cross(z, tangents)
    up *= 0.5 * height / np.linalg.norm(up, axis=1)[:, None]
    side = 0.5 * width * z
    ring = np.stack((axis + up + side, axis + up - side, axis - up - side, axis - up + side), axis=1)
    following = np.roll(ring, -1, axis=1)
    sides = np.stack((ring[:-1], ring[1:], following[1:], following[:-1]), axis=2).reshape(-1, 4, 3)
    return np.concatenate((sides, ring[:1], ring[-1:, ::-1]))


def sphere(fine: bool) -> Array:
    """Return the unit solid's faces; see :mod:`mbfmu.mechanics.shapes`."""

    def point(u: Array, v: Array) -> Array:
        a, b = np.pi * u, 2.0 * np.pi * v
        return np.stack((np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)), axis=-1)

    return patch(*((18, 30) if fine else (6, 10)), point)


def cylinder(fine: bool) -> Array:
    """Return the unit solid's faces: the side in pieces, for the order in depth, and two caps."""
    sides, pieces = (20, 8) if fine else (8, 2)

    def side(u: Array, v: Array) -> Array:
        return np.stack((np.cos(2.0 * np.pi * v), np.sin(2.0 * np.pi * v), 0.5 - u), axis=-1)

    def cap(sign: float) -> Array:
        def point(u: Array, v: Array) -> Array:
            a = sign * 2.0 * np.pi * v
            return np.stack((u * np.cos(a), u * np.sin(a), np.full_like(u, 0.5 * sign)), axis=-1)

        return patch(1, sides, point)

    return np.concatenate((patch(pieces, sides, side), cap(1.0), cap(-1.0)))


def box(fine: bool) -> Array:
    """Return the unit solid's faces, in pieces for the order in depth."""
    pieces = 6 if fine else 1
    faces = []
    for axis in range(3):
        for side in (-0.5, 0.5):

            def face(u: Array, v: Array, side: float = side) -> Array:
                return np.stack((np.full_like(u, side), u - 0.5, 2.0 * side * (v - 0.5)), axis=-1)

            faces.append(np.roll(patch(pieces, pieces, face), axis, axis=2))
    return np.concatenate(faces)


def coil() -> tuple[Array, Array]:
    """Return faces in the middle of the wire of a coil of radius 1 along z, length 1, and what makes the wire thick."""
    turns, wire, lead = 8, 0.16, 0.08

    def turn(u: Array) -> Array:
        return 2.0 * np.pi * turns * np.clip((u - lead) / (1.0 - 2.0 * lead), 0.0, 1.0)

    def middle(u: Array, _: Array) -> Array:
        reach = np.minimum(1.0, np.minimum(u, 1.0 - u) / lead)
        return np.stack((reach * np.cos(turn(u)), reach * np.sin(turn(u)), u - 0.5), axis=-1)

    def thick(u: Array, v: Array) -> Array:
        b = 2.0 * np.pi * v
        return wire * np.stack((np.cos(b) * np.cos(turn(u)), np.cos(b) * np.sin(turn(u)), np.sin(b)), axis=-1)

    return patch(16 * turns, 5, middle), patch(16 * turns, 5, thick)

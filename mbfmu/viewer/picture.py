"""Picture of a mechanism: what is drawn of it, as data that can be saved.

Everything drawn is one of five: a part, a solid fixed to a body; a link, a solid stretched between points of two
bodies; a skin through a grid of bodies; a bar, a beam as it bends; a hull, the surface of a body of finite elements as
it deforms.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .hulls import Hull

Matrix = NDArray[np.float64]
Numbers = tuple[float, ...]
Poses = tuple[NDArray[np.float32], NDArray[np.float32]]  # origins (T, nb, 3), m, and axes (T, nb, 3, 3) of all bodies


@dataclass(frozen=True, kw_only=True)
class Part:
    """A unit solid (see :mod:`mbfmu.mechanics.shapes`) fixed to a body."""

    solid: str  # sphere, cylinder, box, panel, or mesh and a number
    body: int
    at: Numbers  # center, body axes, m
    axes: Numbers  # columns of the matrix from the unit solid to the body's axes, one after the other
    color: str
    opacity: float = 1.0


@dataclass(frozen=True, kw_only=True)
class MeshSolid:
    """A solid of triangles in a cube of side 1 at the origin; parts name it ``mesh0``, ``mesh1``, ... by its number."""

    points: Numbers  # coordinates of the points, one point after the other
    triangles: tuple[int, ...]  # numbers of their points, one triangle after the other

    def corners(self) -> Matrix:
        """Return the corners (k, 3, 3) of the triangles."""
        found: Matrix = np.reshape(self.points, (-1, 3))[np.reshape(self.triangles, (-1, 3))]
        return found


@dataclass(frozen=True, kw_only=True)
class Link:
    """A rod or a coil between points of two bodies."""

    solid: str  # cylinder or coil
    a: int
    b: int
    at_a: Numbers  # body axes, m
    at_b: Numbers
    radius: float  # m
    color: str


@dataclass(frozen=True, kw_only=True)
class Skin:
    """A surface through a grid of bodies."""

    name: str
    bodies: tuple[tuple[int, ...], ...]
    at: Numbers  # point of every body, body axes, m
    color: str
    field: str = ""  # whose outputs color its cells; empty: none

    @property
    def outputs(self) -> list[str]:
        """Names of the outputs that color its cells, row after row."""
        return cells(self.field, len(self.bodies), len(self.bodies[0]))


@dataclass(frozen=True, kw_only=True)
class Bar:
    """A flexible body: a rectangular bar along its bent axis.

    Attributes
    ----------
    body
        Its frame, in whose x-y plane it bends.
    first
        Of its amplitudes among those of all bars.
    x
        Places (k,) on the axis, m.
    shapes
        Deflection (k, modes) of every mode there.
    shortenings
        G(x) (k, modes, modes) of :meth:`mbfmu.mechanics.Beam.shortening`, 1/m; empty where bending does not shorten.
    height, width
        Along y and z, m.
    """

    name: str
    body: int
    first: int
    x: Numbers
    shapes: tuple[Numbers, ...]
    shortenings: tuple[tuple[Numbers, ...], ...]
    height: float
    width: float
    color: str

    @property
    def modes(self) -> slice:
        """Its amplitudes among those of all bars."""
        return slice(self.first, self.first + len(self.shapes[0]))

    def axis(self, amplitudes: Matrix, scale: float) -> Matrix:
        """Return the axis (..., k, 3), frame's axes, m, by amplitudes (..., modes); deflection times ``scale``."""
        w = scale * amplitudes @ np.transpose(self.shapes)
        x = np.broadcast_to(self.x, w.shape)
        if self.shortenings:
            x = x - 0.5 * np.einsum("...i,kij,...j->...k", amplitudes, np.array(self.shortenings), amplitudes)
        return np.stack((x, w, np.zeros_like(w)), axis=-1)


@dataclass(frozen=True, kw_only=True)
class Picture:
    """All that is drawn of a mechanism, and which way is up."""

    up: Numbers
    middles: tuple[Numbers, ...]  # of every body, body axes: where its name stands and whose path is shown, m
    parts: tuple[Part, ...]
    links: tuple[Link, ...]
    skins: tuple[Skin, ...]
    bars: tuple[Bar, ...]
    unnamed: tuple[int, ...]  # cross-sections of flexible bodies, whose names would be in the way
    shown_outputs: tuple[str, ...] = ()  # outputs, by name
    meshes: tuple[MeshSolid, ...] = ()
    hulls: tuple[Hull, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return plain lists and numbers, for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> Picture:
        """Return the picture :meth:`as_dict` wrote."""
        frozen = as_tuples(content)
        return cls(
            up=frozen["up"],
            middles=frozen["middles"],
            parts=tuple(Part(**part) for part in frozen["parts"]),
            links=tuple(Link(**link) for link in frozen["links"]),
            skins=tuple(Skin(**skin) for skin in frozen["skins"]),
            bars=tuple(Bar(**bar) for bar in frozen["bars"]),
            unnamed=frozen["unnamed"],
            shown_outputs=frozen.get("shown_outputs", ()),  # pose files from before there were any
            meshes=tuple(MeshSolid(**mesh) for mesh in frozen.get("meshes", ())),
            hulls=tuple(Hull(**hull) for hull in frozen.get("hulls", ())),
        )

    def points(self) -> dict[int, Matrix]:
        """Return, by body, points (k, 3) in body axes that enclose what is drawn of it, bars apart."""
        found: dict[int, list[Matrix]] = {}
        for part in self.parts:
            half = 0.5 if part.solid in ("box", "panel") else 1.0
            at, axes = np.array(part.at), half * np.reshape(part.axes, (3, 3))
            number = part.solid.removeprefix("mesh")
            if number != part.solid:
                corners = self.meshes[int(number)].corners().reshape(-1, 3) @ np.reshape(part.axes, (3, 3))
                found.setdefault(part.body, []).append(at + corners)
                continue
            if part.solid == "cylinder":
                axes[2] *= 0.5
            found.setdefault(part.body, []).extend((at + axes, at - axes))
        for link in self.links:
            found.setdefault(link.a, []).append(np.array([link.at_a]))
            found.setdefault(link.b, []).append(np.array([link.at_b]))
        for skin in self.skins:
            for body in {body for row in skin.bodies for body in row}:
                found.setdefault(body, []).append(np.array([skin.at]))
        return {body: np.concatenate(points) for body, points in found.items()}


def as_tuples(content: Any) -> Any:
    """Return what JSON holds with tuples for its lists."""
    if isinstance(content, dict):
        return {key: as_tuples(value) for key, value in content.items()}
    return tuple(map(as_tuples, content)) if isinstance(content, list) else content


def cells(field: str, rows: int, columns: int) -> list[str]:
    """Return the names of a field's outputs over a grid of rows and columns of bodies; none where there is no field."""
    return [f"{field}[{i},{k}]" for i in range(rows - 1) for k in range(columns - 1) if field]


def numbers(vector: Any) -> Numbers:
    """Return plain floats."""
    return tuple(float(x) for x in np.asarray(vector, float))

"""Appearance of a mechanism in pictures, in place of the default pictures of its bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.checks import Matrix, Vector, vector
from mbfmu.mechanics.flexible import Beam
from mbfmu.mechanics.numbers import positive
from mbfmu.mechanics.shapes import SHAPES, Shape, check_color
from mbfmu.util.errors import UserError

from .bodies import Body
from .flexible_handle import FlexibleHandle
from .members import Members


@dataclass(frozen=True, eq=False)
class Surface:
    """Grid of bodies that is drawn as one surface, see :meth:`Mechanism.surface`."""

    name: str
    bodies: NDArray[np.int64]  # (rows, columns) indices
    at: Matrix  # the point of every body it passes through, body axes, m
    color: str
    field: str = ""  # cell (i, k) is colored by the output field[i,k]; empty: by none


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Rectangular cross-section of a flexible body in pictures, see :meth:`Mechanism.profile`."""

    height: float  # along y, in which it bends, m
    width: float  # along z, m
    color: str


class Appearance(Members):
    """Base of :class:`.Mechanism`: shapes, cross-sections of flexible bodies, grids of bodies drawn as surfaces."""

    def __init__(self) -> None:
        super().__init__()
        self.flexible_bodies: list[FlexibleHandle] = []
        self.shapes: list[tuple[Body, Shape]] = []
        self.profiles: dict[int, Profile] = {}  # by flexible body
        self.surfaces: list[Surface] = []

    def beams(self) -> list[tuple[FlexibleHandle, Beam]]:
        """Return the flexible bodies that are beams, with their beams."""
        return [(own, own.elastic) for own in self.flexible_bodies if isinstance(own.elastic, Beam)]

    def shape(self, body: Body, *shapes: Shape) -> None:
        """Draw a body with these shapes instead of its default picture.

        Parameters
        ----------
        body
            Body of this mechanism.
        *shapes
            Shapes in the frame of the body, such as :class:`.Box` or :class:`.MeshFile`.
        """
        self._member(body, "body of a shape")
        for shape in shapes:
            if not isinstance(shape, Shape):
                raise UserError(f"shape of body {body.name!r} is {shape!r}; allowed: {', '.join(SHAPES)}")
            vector(f"at of a shape of body {body.name!r}", shape.at)
            shape.axes()
            self.shapes.append((body, shape))

    def profile(self, flexible_body: FlexibleHandle, *, height: float, width: float, color: str = "") -> None:
        """Draw a flexible body with this rectangular cross-section instead of a slender one.

        Parameters
        ----------
        flexible_body
            Flexible body of this mechanism.
        height, width
            Size along y, the direction of bending, and along z, m.
        color
            Color ``"#rrggbb"``; empty: the color of the body.
        """
        if not any(flexible_body is own for own in self.flexible_bodies):
            named = getattr(flexible_body, "name", flexible_body)
            raise UserError(f"flexible body of a profile is {named!r}; it must be one of this mechanism")
        if not isinstance(flexible_body.elastic, Beam):
            raise UserError(
                f"flexible body of a profile is {flexible_body.name!r}, of finite elements; it must be a beam"
            )
        self.profiles[flexible_body.index] = Profile(
            height=positive(f"height of the profile of {flexible_body.name!r}", height),
            width=positive(f"width of the profile of {flexible_body.name!r}", width),
            color=check_color(color),
        )

    def surface(
        self,
        name: str,
        bodies: Sequence[Sequence[Body]],
        *,
        at: Vector = (0.0, 0.0, 0.0),
        color: str = "",
        field: str = "",
    ) -> None:
        """Draw a grid of bodies as one surface instead of separate bodies.

        Parameters
        ----------
        name
            Unique name among the surfaces.
        bodies
            Rows of bodies of equal length, at least 2 by 2.
        at
            Point of each body that is on the surface, in the frame of the body, m.
        color
            Color ``"#rrggbb"``; empty: a color is chosen.
        field
            Name of a field: the cell between rows i and i + 1 and columns k and k + 1 is colored by the output
            ``field[i,k]``. When the mechanism is drawn, all of these outputs must exist and have one unit. Empty: no
            field.
        """
        self._new_name("surface", name, [s.name for s in self.surfaces])
        for body in (body for row in bodies for body in row):
            self._member(body, f"a body of surface {name!r}")
        columns = {len(row) for row in bodies}
        if len(bodies) < 2 or len(columns) != 1 or min(columns) < 2:
            raise UserError(
                f"surface {name!r} has rows of {sorted(columns)} bodies; allowed: 2 rows or more of equal "
                "length, 2 or more"
            )
        if not isinstance(field, str):
            raise UserError(f"field of surface {name!r} is {field!r}; allowed: text, as its outputs begin")
        grid = np.array([[body.index for body in row] for row in bodies], np.int64)
        self.surfaces.append(Surface(name, grid, vector(f"at of surface {name!r}", at), check_color(color), field))

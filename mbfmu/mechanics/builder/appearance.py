"""How a mechanism is drawn where its bodies' default pictures are not wanted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbfmu.errors import UserError
from mbfmu.mechanics.checks import Vector, vector
from mbfmu.mechanics.numbers import positive
from mbfmu.mechanics.shapes import Shape, check_color

from .bodies import Body, FlexibleBody, Profile, Surface
from .members import Members


class Appearance(Members):
    """Base of :class:`.Mechanism`: shapes of bodies, cross-sections of elastic ones, skins over grids of them."""

    def __init__(self) -> None:
        super().__init__()
        self.flexible_bodies: list[FlexibleBody] = []
        self.shapes: list[tuple[Body, Shape]] = []
        self.profiles: dict[int, Profile] = {}  # by flexible body
        self.surfaces: list[Surface] = []

    def shape(self, body: Body, *shapes: Shape) -> None:
        """Draw a body with these shapes instead of the picture it gets by default."""
        self._member(body, "body of a shape")
        for shape in shapes:
            if not isinstance(shape, Shape):
                raise UserError(f"shape of body {body.name!r} is {shape!r}; allowed: Box, Cylinder, Panel, Sphere")
            vector(f"at of a shape of body {body.name!r}", shape.at)
            shape.axes()
            self.shapes.append((body, shape))

    def profile(self, flexible_body: FlexibleBody, *, height: float, width: float, color: str = "") -> None:
        """Draw an elastic body with this rectangular cross-section instead of a slender one.

        Parameters
        ----------
        flexible_body
            Of this mechanism.
        height, width
            Along y, in which it bends, and along z, m.
        color
            ``"#rrggbb"``; empty: the one the body is given.
        """
        if not any(flexible_body is own for own in self.flexible_bodies):
            named = getattr(flexible_body, "name", flexible_body)
            raise UserError(f"elastic body of a profile is {named!r}; it must be one of this mechanism")
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
        """Draw a grid of bodies as one skin, and not one by one.

        Parameters
        ----------
        name
            New among the surfaces.
        bodies
            Rows of bodies, all of one length, at least 2 by 2.
        at
            The point of every body the skin passes through, in the body's frame, m.
        color
            ``"#rrggbb"``; empty: one is chosen.
        field
            Name of a field: the cell between rows i and i + 1, columns k and k + 1 gets the color that goes with the
            output ``field[i,k]``. All of these must be there when the mechanism is drawn, in one unit; empty: no field.
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

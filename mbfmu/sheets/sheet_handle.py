"""A sheet of a mechanism: its nodes, and sensors of its points, edges and cells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mbfmu.mechanics.axes import unit_axis
from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.builder.handles import CutHandle
from mbfmu.mechanics.checks import Vector, one_of, vector
from mbfmu.mechanics.numbers import is_finite, is_whole
from mbfmu.mechanics.sensors import Sensor, axis_index
from mbfmu.sheets.elements import Plate
from mbfmu.sheets.sensors import Covered, InPlate, InShell, SheetPosition, Skew
from mbfmu.util.errors import UserError

from .grid import Node
from .mesh_builder import Cell
from .section_properties import SheetProperties
from .supports import SHEET_EDGES

COMPONENTS = {"xx": 0, "zz": 1, "xz": 2}
FACES = {"top": 1.0, "middle": 0.0, "bottom": -1.0}


@dataclass(frozen=True, eq=False)
class SheetPoint:
    """A point of a sheet, as :meth:`Sheet.point` and :meth:`Sheet.edge` return it."""

    corners: tuple[Body, ...]
    sides: tuple[float, float]
    at: tuple[float, float]

    def position(self, axis: str) -> Sensor:
        """Global component of the position of the point, m.

        Parameters
        ----------
        axis
            Global axis: ``"x"``, ``"y"`` or ``"z"``.
        """
        component = axis_index(axis, "of the position of a point of a sheet")
        return SheetPosition(unit="m", component=component, bodies=self.corners, sides=self.sides, at=self.at)


@dataclass(frozen=True, eq=False)
class Sheet:
    """Sheet of a mechanism, as returned by :func:`add_sheet`.

    Attributes
    ----------
    name
        Name of the sheet.
    nodes
        Bodies by grid index, ``nodes[i][k]`` at x = i a, z = k b; the x-z plane of each frame is that of the sheet.
    a, b
        Sides of a cell, m.
    plate
        Plate of every cell, or of the middle one if they differ; with stretch the elements are shells of it.
    fabric
        Plate properties of each cell.
    cells
        Elements and the four bodies at their corners, by grid index of the first.
    cuts
        Cut joints of the supports other than the root of the tree.
    along
        Direction of the tree: its columns are across x (0) or z (1).
    """

    name: str
    nodes: tuple[tuple[Body, ...], ...]
    a: float
    b: float
    plate: Plate
    fabric: SheetProperties
    cells: Mapping[Node, Cell]
    cuts: tuple[CutHandle, ...]
    along: int

    def node(self, i: int, k: int) -> Body:
        """Return a node.

        Parameters
        ----------
        i, k
            Numbers of the node along x and z: it is at x = i a, z = k b; negative numbers count from the far edge.

        Returns
        -------
        Body
            Body of the node, for joints, loads and sensors.

        Raises
        ------
        UserError
            The grid has no such node.
        """
        shape = len(self.nodes), len(self.nodes[0])
        if not (is_whole(i) and is_whole(k) and -shape[0] <= i < shape[0] and -shape[1] <= k < shape[1]):
            raise UserError(f"sheet {self.name!r} has no node {(i, k)}; its grid is {shape}")
        return self.nodes[i][k]

    def nearest(self, x: float, z: float) -> Body:
        """Return the node nearest to a point of the flat sheet.

        Parameters
        ----------
        x, z
            Position in the flat sheet, m.

        Returns
        -------
        Body
            Body of the node.
        """
        return self.node(
            min(range(len(self.nodes)), key=lambda i: abs(i * self.a - x)),
            min(range(len(self.nodes[0])), key=lambda k: abs(k * self.b - z)),
        )

    def point(self, x: float, z: float) -> SheetPoint:
        """Return a point of the sheet on the smooth surface that is used for contact.

        Parameters
        ----------
        x, z
            Position in the flat sheet, m.

        Returns
        -------
        SheetPoint
            Point whose sensors give its position.

        Raises
        ------
        UserError
            The position is not on the sheet.
        """
        (i, xi), (k, zeta) = self._cell("x", x), self._cell("z", z)
        return SheetPoint(self.cells[i, k][1], (self.a, self.b), (xi, zeta))

    def edge(self, name: str) -> SheetPoint:
        """Return the middle of an edge.

        Parameters
        ----------
        name
            Edge: ``"x0"``, ``"x1"``, ``"z0"`` or ``"z1"``.

        Returns
        -------
        SheetPoint
            Point whose sensors give its position.
        """
        one_of(f"edge of sheet {self.name!r}", name, SHEET_EDGES)
        ends = {"x": self.a * (len(self.nodes) - 1), "z": self.b * (len(self.nodes[0]) - 1)}
        place = {axis: 0.5 * end for axis, end in ends.items()} | {name[0]: ends[name[0]] * int(name[1])}
        return self.point(place["x"], place["z"])

    def skew(self, edge: str = "x1", across: str | Sequence[float] = "z") -> Sensor:
        """Skew angle: angle between the line through the corners of an edge and a direction, about the normal, rad.

        The skew of a flat sheet in the plane x-z that is rotated about y is the angle of rotation.

        Parameters
        ----------
        edge
            Edge, ``"x0"`` or ``"x1"``.
        across
            Direction of the edge at zero skew, global axes: ``"x"``, ``"y"``, ``"z"``, or a vector (3,).
        """
        one_of(f"edge of the skew of sheet {self.name!r}", edge, ("x0", "x1"))
        row = 0 if edge == "x0" else -1
        direction = unit_axis(across, f"across of the skew of sheet {self.name!r}")
        return Skew(unit="rad", bodies=(self.node(row, 0), self.node(row, -1)), across=direction)

    def covers(self, point: Vector, direction: str | Sequence[float] = "y") -> Sensor:
        """Fraction of a light beam that the sheet covers, 0 to 1, smoothed over 1 mm at the edges.

        Parameters
        ----------
        point
            Point of the beam (3,), global axes, m.
        direction
            Direction of the beam, global axes: ``"x"``, ``"y"``, ``"z"``, or a vector (3,).
        """
        what = f"of the beam that sheet {self.name!r} covers"
        cells = sorted(self.cells)
        last = len(self.nodes) - 2, len(self.nodes[0]) - 2
        return Covered(
            unit="1",
            bodies=tuple(body for cell in cells for body in self.cells[cell][1]),
            place=vector(f"point {what}", point),
            direction=unit_axis(direction, f"direction {what}"),
            sides=(self.a, self.b),
            ends=[[(number == 0, number == end) for number, end in zip(cell, last, strict=True)] for cell in cells],
        )

    def curvature(self, component: str, x: float, z: float) -> Sensor:
        """Curvature or twist of the sheet, 1/m: the second derivative of the deflection along y of the flat sheet.

        Curvature, moment, strain, force per length and stress are values of the element at the point. Their mean over
        the element is exact and they are most accurate at its center: with two cells across the width, the force in a
        hanging strip has an error of 50 % at the edge. On a line between two elements, the value is that of the second
        one.

        Parameters
        ----------
        component
            ``"xx"``, ``"zz"`` (curvatures) or ``"xz"`` (twist), in the axes of the flat sheet.
        x, z
            Position in the flat sheet, m.
        """
        return self._recovered("1/m", component, x, z, curvature=1.0)

    def moment(self, component: str, x: float, z: float) -> Sensor:
        """Bending or twisting moment per length, N m/m; elastic part, without material damping.

        Parameters
        ----------
        component, x, z
            As for :meth:`curvature`.
        """
        return self._recovered("N.m/m", component, x, z, moment=1.0)

    def strain(self, component: str, x: float, z: float) -> Sensor:
        """Strain of the mid-plane; ``"xz"`` is half the shear angle.

        Parameters
        ----------
        component, x, z
            As for :meth:`curvature`.

        Raises
        ------
        UserError
            The sheet has no in-plane strains; use ``stretch=True``.
        """
        return self._recovered("1", component, x, z, strain=1.0)

    def force_per_length(self, component: str, x: float, z: float) -> Sensor:
        """In-plane force per length, N/m, positive in tension; elastic part, without material damping.

        Parameters
        ----------
        component, x, z
            As for :meth:`curvature`.

        Raises
        ------
        UserError
            The sheet has no in-plane strains; use ``stretch=True``.
        """
        return self._recovered("N/m", component, x, z, force=1.0)

    def stress(self, component: str, x: float, z: float, face: str = "top") -> Sensor:
        """Stress, Pa, positive in tension; elastic part, without material damping.

        Parameters
        ----------
        component, x, z
            As for :meth:`curvature`.
        face
            ``"top"`` (on the side of y), ``"middle"`` or ``"bottom"``.

        Raises
        ------
        UserError
            The sheet has no in-plane strains; use ``stretch=True``.
        """
        one_of(f"face of sheet {self.name!r}", face, FACES)
        t = self.fabric.at((self._cell("x", x)[0], self._cell("z", z)[0])).thickness
        return self._recovered("Pa", component, x, z, force=1.0 / t, moment=-6.0 * FACES[face] / t**2)

    def _recovered(self, unit: str, component: str, x: float, z: float, **parts: float) -> Sensor:
        """Return a sensor of a weighted sum of strains and stress resultants of the element at (x, z)."""
        one_of(f"component of the loads in sheet {self.name!r}", component, COMPONENTS)
        (i, x), (k, z) = self._cell("x", x), self._cell("z", z)
        element, corners = self.cells[i, k]
        recovered, row = element.recover(x, z), COMPONENTS[component]
        if not parts.keys() <= recovered.keys():
            raise UserError(f"sheet {self.name!r} has no output of in-plane strains; use stretch=True")
        start = sum(part * recovered[key].start[row] for key, part in parts.items())
        weights = sum(part * recovered[key].weights[row] for key, part in parts.items())
        kind = InPlate if isinstance(element, Plate) else InShell
        stiff = bool(parts.keys() & {"strain", "force"})
        return kind(unit=unit, bodies=corners, element=element, start=start, weights=weights, stiff=stiff)

    def _cell(self, axis: str, value: float) -> tuple[int, float]:
        """Return the number of the cell at a place along x or z, and how far in it that is, from 0 to 1."""
        step, last = (self.a, len(self.nodes) - 1) if axis == "x" else (self.b, len(self.nodes[0]) - 1)
        place = value / step if is_finite(value) else -1.0
        if not -1e-9 * last <= place <= (1.0 + 1e-9) * last:
            raise UserError(f"{axis} on sheet {self.name!r} is {value!r} m; allowed: 0 to {last * step:g}")
        cell = min(max(int(place), 0), last - 1)
        return cell, min(max(place - cell, 0.0), 1.0)

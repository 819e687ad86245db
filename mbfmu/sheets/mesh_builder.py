"""Builder of the mesh of a sheet: bodies along a tree, an element in every cell, cut joints at the supports."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np

from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.builder.handles import CutHandle
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.checks import Matrix, Vector, rotation, vector
from mbfmu.mechanics.cuts import CutJoint, PlaneCutJoint
from mbfmu.mechanics.joints import Floating, Joint, Planar, Revolute, Weld
from mbfmu.mechanics.numbers import is_finite
from mbfmu.sheets.elements import Plate, Shell
from mbfmu.util.errors import UserError

from .grid import Link, Node, around, from_edge, on_edge
from .section_properties import SheetProperties, shell_of
from .supports import Support, cut_of

# Size of a joint's angles times the square of the cells in its chain: curvature times cell, and the errors of a chain
# add up; measured on releases of a sheet with 14 to 50 cells. Less if a sheet bends less: _bending_compliance
JOINT_ANGLE_SCALE = 25.0
LIMP_SLENDERNESS = 800.0  # length to thickness, from which on a sheet bends as far as any other
Cell = tuple[Plate | Shell, tuple[Body, Body, Body, Body]]


class SheetMeshBuilder:
    """Builder of one sheet in a mechanism.

    Parameters
    ----------
    mechanism, name, properties, density
        Mechanism, name and properties of the sheet, and its density, kg/m^3.
    placement
        Frame of the flat sheet in that of what holds it: position, m, and axes.
    joint
        Between neighbors of the tree.

    Attributes
    ----------
    bodies, cells
        The nodes so far, and the elements with the bodies at their corners.
    cuts
        Cut joints of supports so far.
    along
        Which way the tree grows: its columns lie across x (0) or z (1).
    """

    def __init__(
        self,
        mechanism: Mechanism,
        name: str,
        properties: SheetProperties,
        density: float,
        placement: tuple[Vector, Any],
        joint: type[Joint],
    ) -> None:
        self.mechanism, self.name, self.properties, self.shape, self.joint = (
            mechanism,
            name,
            properties,
            properties.shape,
            joint,
        )
        self.plate = plate = properties.middle
        self.what = f"sheet {name!r}"
        self.at = vector(f"placement of {self.what}", placement[0])
        self.rotation = rotation(f"rotation of {self.what}", placement[1])
        self.density = density
        self.side = max((self.shape[0] - 1) * plate.a, (self.shape[1] - 1) * plate.b)
        self.angle_scale = JOINT_ANGLE_SCALE * _bending_compliance(self.side, plate.thickness)
        self.bodies: dict[Node, Body] = {}
        self.held_nodes: set[Node] = set()  # held by a support
        self.cells: dict[Node, Cell] = {}
        self.cuts: list[CutHandle] = []
        self.along = 0

    def build(
        self, tree: str, supports: list[Support], master: Body | None, rate: Vector | None, pressure: Any
    ) -> None:
        """Add the nodes, the elements and the supports."""
        if rate is not None and (tree != "master" or master is not None):
            raise UserError(
                f"rate of {self.what} is {rate!r}, but it has no floating master node; leave it out, or use "
                "tree='master' without master"
            )
        if tree == "master":
            self._refuse_double_support(supports, master)
            kind, options = (Floating, {"rate": rate}) if master is None else (Weld, {})
            self._add_bodies(around(self.shape), kind, master, self.at, self.rotation, **options)
        else:
            if master is not None:
                raise UserError(
                    f"master of {self.what} is {master.name!r}, but its tree {tree!r} has no master node; use "
                    "tree='master', or leave master out"
                )
            if not supports or supports[0].kind not in ("clamped", "pinned"):
                given = supports[0].kind if supports else "missing"
                raise UserError(
                    f"first support of {self.what} is {given}; tree {tree!r} grows from one that is clamped or pinned: "
                    "list it first, or use tree 'master'"
                )
            self._refuse_double_support(supports, None)
            root = supports.pop(0)
            self.along = 0 if root.edge[0] == "x" else 1
            at, axes = self._frame(root)
            self.held_nodes |= {on_edge(self.shape, root.edge, n) for n in self._held(root)}
            self._add_bodies(
                from_edge(self.shape, root.edge, self._held(root), tree == "spine"),
                Weld if root.kind == "clamped" else Revolute,
                root.body,
                at,
                axes,
                **({"axis": "z" if root.edge[0] == "x" else "x"} if root.kind == "pinned" else {}),
            )
        self._add_elements(self.properties.at, supports, pressure)

    def build_stretchable(
        self, supports: list[Support], master: Body | None, rate: Vector | None, pressure: Any
    ) -> None:
        """Give every node all six motions against its neighbor, or those its support leaves; span shells."""
        if rate is not None and (supports or master is not None):
            raise UserError(
                f"rate of {self.what} is {rate!r}, but it has supports or a master and does not float; leave rate out"
            )
        joints: dict[str, tuple[type[Joint], dict[str, Any]]] = {
            "clamped": (Weld, {}),
            "pinned": (Revolute, {}),
            "guided": (Planar, {"axis": "y"}),
        }
        for support in supports:
            if support.kind not in joints:
                continue
            kind, options = joints[support.kind]
            if kind is Revolute:
                options = {"axis": "z" if support.edge[0] == "x" else "x"}
            held = [on_edge(self.shape, support.edge, n) for n in self._held(support)]
            own: list[Link] = [(node, None) for node in held if node not in self.held_nodes]
            self.held_nodes |= {node for node, _ in own}
            self._add_bodies(own, kind, support.body, *self._frame(support), **options)
        if supports and master is None:
            root = supports[0]
            links = from_edge(self.shape, root.edge, self._held(root), spine=True)
            root_body, (at, axes) = root.body, self._frame(root)
            self.along = 0 if root.edge[0] == "x" else 1
        else:
            links, root_body, at, axes = around(self.shape), master, self.at, self.rotation
        remaining = [link for link in links if link[0] not in self.bodies]
        first = Floating if master is None else Weld
        self._add_bodies(remaining, first, root_body, at, axes, **({} if rate is None else {"rate": rate}))
        shell = cache(shell_of)
        left = [support for support in supports if support.kind not in joints]
        self._add_elements(lambda cell: shell(self.properties.at(cell)), left, pressure)

    def _add_elements(self, element: Callable[[Node], Plate | Shell], supports: list[Support], pressure: Any) -> None:
        """Span an element in every cell, load it, and close these supports by cut joints."""
        node = self.bodies
        for i in range(self.shape[0] - 1):
            for k in range(self.shape[1] - 1):
                corners = node[i, k], node[i + 1, k], node[i + 1, k + 1], node[i, k + 1]
                self.cells[i, k] = element((i, k)), corners
                self.mechanism.element(self.cells[i, k][0], *corners)
        if pressure != 0.0:
            self.mechanism.pressure(self.name, pressure, [corners for _, corners in self.cells.values()])
        self.cuts += [cut for support in supports for cut in self._close(support)]

    def _refuse_double_support(self, supports: list[Support], master: Body | None) -> None:
        """Refuse supports that hold the sheet in its plane twice: it cannot stretch, so it could not bend."""
        holders = [] if master is None else [(master, f"master on {master.name!r}")]
        for support in supports:
            if support.kind in ("clamped", "pinned"):
                body = self.mechanism.ground if support.body is None else support.body
                holders.append((body, f"{support.kind} {support.edge!r}"))
        first: dict[int, str] = {}
        for body, name in holders:
            self.mechanism._member(body, f"body that holds {self.what}")
            i = body.index
            while i > 0 and self.mechanism.bodies[i].joint.nv == 0:
                i = self.mechanism.bodies[i].parent
            if i in first:
                raise UserError(
                    f"supports of {self.what} constrain its in-plane motion twice: {first[i]} and {name}; it "
                    "cannot stretch and could not bend between them; change one to 'guided' or 'supported'"
                )
            first[i] = name

    def _flat_position(self, node: Node) -> Matrix:
        """Position of a node in the sheet's frame."""
        return np.array([node[0] * self.plate.a, 0.0, node[1] * self.plate.b])

    def _add_bodies(
        self,
        links: list[Link],
        kind: type[Joint],
        root_body: Body | None,
        at: Matrix,
        axes: Matrix,
        **options: Any,
    ) -> None:
        """Add the bodies in the order of ``links``; those without a parent are connected to ``root_body``."""
        for node, parent in links:
            if parent is None:
                body = self.mechanism.ground if root_body is None else root_body
                joint = kind(at=tuple(at + axes @ self._flat_position(node)), rotation=axes, **options)
            else:
                body = self.bodies[parent]
                cells = self.shape[0 if node[1] == parent[1] else 1] - 1
                angle = self.angle_scale / cells**2
                way = angle * self.side  # a node that is off takes along as many as one that is turned
                size = (way, angle, angle, way, way, angle)[: self.joint.nv]
                joint = self.joint(at=tuple(self._flat_position(node) - self._flat_position(parent)), nominal=size)
            self.bodies[node] = self.mechanism.body(f"{self.name}.{node[0]}.{node[1]}", body, joint, **self._cell(node))

    def _cell(self, node: Node) -> dict[str, Any]:
        """Mass properties of a node's cell, which is half as long at a border."""
        i, k = node
        a, x = _lumped_length(i, self.shape[0], self.plate.a)
        b, z = _lumped_length(k, self.shape[1], self.plate.b)
        t = self.properties.thickness_at(i * self.plate.a + x, k * self.plate.b + z)
        m = self.density * t * a * b
        return {
            "mass": m,
            "com": (x, 0.0, z),
            "inertia": (m * (b * b + t * t) / 12.0, m * (a * a + b * b) / 12.0, m * (a * a + t * t) / 12.0),
        }

    def _frame(self, support: Support) -> tuple[Matrix, Matrix]:
        """Origin and axes of the sheet in the frame of the support's body."""
        role = f"of the support at {support.edge!r} of {self.what}"
        at = self.at if support.at is None else vector(f"placement {role}", support.at)
        return at, self.rotation if support.rotation is None else rotation(f"rotation {role}", support.rotation)

    def _held(self, support: Support) -> list[int]:
        """Numbers along the edge of the nodes that a support holds."""
        across = 1 if support.edge[0] == "x" else 0
        step = (self.plate.a, self.plate.b)[across]
        if support.span is None:
            return list(range(self.shape[across]))
        role = f"span of the support at {support.edge!r} of {self.what} is {support.span!r} m"
        if np.shape(support.span) != (2,) or not is_finite(support.span):
            raise UserError(f"{role}; it needs two finite numbers")
        low, high = support.span
        held = [n for n in range(self.shape[across]) if low - 1e-9 * step <= n * step <= high + 1e-9 * step]
        if not held:
            raise UserError(f"{role}; no node lies within: they are {step:g} m apart")
        return held

    def _close(self, support: Support) -> Iterator[CutHandle]:
        """Hold a support's nodes by cut joints, all six motions of one node at most.

        What the nodes of an edge cannot do against each other in the plane must not be forbidden twice: those
        constraints would be redundant, and change their rank as the sheet bends.
        """
        at, axes = self._frame(support)
        body = self.mechanism.ground if support.body is None else support.body
        held = [n for n in self._held(support) if on_edge(self.shape, support.edge, n) not in self.held_nodes]
        for n in held:
            node = on_edge(self.shape, support.edge, n)
            self.held_nodes.add(node)
            kind, local = cut_of(support, n == held[len(held) // 2])
            name, place = f"{self.name}.{support.edge}.{n}", tuple(at + axes @ self._flat_position(node))
            if (
                support.kind == "pinned" and kind is PlaneCutJoint
            ):  # the pin stays in the plane of the node as that turns
                cut: CutJoint = kind(at_b=place, rotation_a=local, rotation_b=axes @ local)
                yield self.mechanism.cut(name, cut, self.bodies[node], body)
            else:
                cut = kind(at_a=place, rotation_a=axes @ local, rotation_b=local)
                yield self.mechanism.cut(name, cut, body, self.bodies[node])


def _bending_compliance(length: float, thickness: float) -> float:
    """How far a sheet bends, in units of a limp one, at most 1.

    At the same strain of its faces its curvature times its length is in proportion to length / thickness, which has no
    unit; loads are unknown here. The power is that at which ida keeps the energy of a release to 1e-3 at rtol 1e-5,
    measured on a sheet of 0.3 m from 0.3 to 3 mm.
    """
    return min(1.0, length / (LIMP_SLENDERNESS * thickness)) ** 1.5


def _lumped_length(n: int, count: int, step: float) -> tuple[float, float]:
    """Length of a node's cell and where its middle is from the node, along one side of the grid."""
    if 0 < n < count - 1:
        return step, 0.0
    return 0.5 * step, 0.25 * step if n == 0 else -0.25 * step

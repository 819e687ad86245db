"""The builder of flexible sheets: a grid of nodal bodies on geodesic joints, with plate elements between them.

>>> m = Mechanism(gravity=(0, -9.81, 0))
>>> sheet = add_sheet(
...     m, "sheet", length=0.3, width=0.21, thickness=0.3e-3, youngs_modulus=1e10, poisson=0.3, density=1000.0,
...     grid=(7, 5), supports=[Support("x1", "clamped")],
... )
>>> m.output("tip", sheet.node(0, 2).position("y"), "height of the free edge")

In its own frame the flat sheet fills 0 <= x <= length, 0 <= z <= width; its normal is y. Node (i, k) of the grid lies
at x = i a, z = k b. A node has the mass of its cell, half a cell at a border and a quarter at a corner, the center of
mass in the middle of the cell (so off the node at a border) and the rotary inertia m (c^2 + t^2) / 12 of a rigid one,
which leaves explicit steps 12 to 95 times as long as the plate's own m t^2 / 12.

**Trees.** ``spine`` and ``rows`` grow from the first support, whose nodes hang on its body: ``rows`` as chains across
the sheet; ``spine`` as one chain from the middle of the support, with ribs to both sides. ``master`` is the paper's: a
node in the middle floats, or hangs on a body of yours, with spine and ribs around it, and every support is made of cut
joints. A chain cannot stretch, so what resists stretching (membrane) matters across chains only. ``rows`` is the tree
for load in the plane, which every row carries; of ``spine`` the spine carries it alone.

**Effects.** Bending is always there; membrane, damping, drag and pressure where they are asked for. Bending alone
converges to a sheet that resists no Gaussian curvature, because nothing resists shear in its plane nor stretching
across the chains; membrane does, and leaves out the strain along rows or ribs, of which there is none. It may see the
strain along a chain only with joints that keep the length of the sheet (:mod:`.joints.geodesic`): those of projected
length would lock.

**Stretch.** Along its chains the sheet cannot stretch, which is right where it bends one way, and wrong where it is
held twice or curved both ways. With ``stretch`` a node has all six motions against its neighbor in the tree, of which
bending moves three and hardly the others, and elements are shells (:class:`.Shell`). Supports hold their nodes by
joints of their own, and edges may be held against each other. Waves in the plane are hundreds of times faster than
bending, so it takes an implicit solver. (Nodes on the ground, each by itself, would be as many unknowns; but a sheet
that hardly stretches moves along curves in those, and Newton takes five times as many steps to its rest.)

**Rows of cells.** An element measures stretching by means over its edges. One row of cells across the chains has one
mean for the whole width: the sheet folds along its chain, is then stiff as an angle bar, and stays so though it would
hang lower and with less energy unfolded. With membrane two rows of cells are the least.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbfmu.errors import UserError
from mbfmu.mechanics.builder.bodies import Body, CutHandle
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.checks import Matrix, Vector, one_of, rotation, vector
from mbfmu.mechanics.cuts import Cut, PlaneCut
from mbfmu.mechanics.elements import Plate, Shell
from mbfmu.mechanics.elements.shell_stiffness import plane_stress
from mbfmu.mechanics.joints import Floating, Geodesic, Joint, OutOfPlane, Planar, Revolute, Weld
from mbfmu.mechanics.numbers import is_finite, positive

from .grid import Link, Node, around, from_edge, on_edge
from .supports import Support, check_support, cut_of

GRAVITY = 9.81  # m/s^2: what bends a sheet is of the order of its weight
# Size of a joint's angles times the square of the cells in its chain: curvature times cell, and the errors of a chain
# add up; measured on releases of a sheet with 14 to 50 cells. Less where a sheet bends less: _pliancy
SHARE = 25.0
TREES = ("spine", "rows", "master")
JOINTS: dict[str, type[Joint]] = {"geodesic": Geodesic, "paper": OutOfPlane}


@dataclass(frozen=True, eq=False)
class Sheet:
    """A sheet of a mechanism, as :func:`add_sheet` returns it.

    Attributes
    ----------
    nodes
        Bodies by grid index, ``nodes[i][k]`` at x = i a, z = k b; each frame's x-z plane is the sheet's.
    a, b
        Sides of a cell, m.
    plate
        What every cell is of; with stretch its element is a shell of that.
    cuts
        Cut joints of supports that the tree does not grow from.
    along
        Which way the tree grows: its columns lie across x (0) or z (1).
    """

    name: str
    nodes: tuple[tuple[Body, ...], ...]
    a: float
    b: float
    plate: Plate
    cuts: tuple[CutHandle, ...]
    along: int

    def node(self, i: int, k: int) -> Body:
        """Return the node at x = i a, z = k b; negative numbers count from the far edge."""
        shape = len(self.nodes), len(self.nodes[0])
        if not (-shape[0] <= i < shape[0] and -shape[1] <= k < shape[1]):
            raise UserError(f"sheet {self.name!r} has no node {(i, k)}; its grid is {shape}")
        return self.nodes[i][k]

    def nearest(self, x: float, z: float) -> Body:
        """Return the node nearest to (x, z) of the flat sheet, m."""
        return self.node(
            min(range(len(self.nodes)), key=lambda i: abs(i * self.a - x)),
            min(range(len(self.nodes[0])), key=lambda k: abs(k * self.b - z)),
        )


def add_sheet(
    mechanism: Mechanism,
    name: str,
    *,
    length: float,
    width: float,
    thickness: float,
    youngs_modulus: float,
    density: float,
    poisson: float = 0.3,
    grid: tuple[int, int],
    tree: str = "spine",
    supports: Sequence[Support] = (),
    at: Vector = (0.0, 0.0, 0.0),
    rotation: Any = None,
    master: Body | None = None,
    rate: Vector | None = None,
    joint: str = "geodesic",
    membrane: bool | str = False,
    stretch: bool = False,
    damping: float = 0.0,
    drag: float = 0.0,
    pressure: Any = 0.0,
) -> Sheet:
    """Add a flexible sheet to a mechanism.

    Parameters
    ----------
    mechanism
        What the sheet is added to.
    name
        Nodes are the bodies ``name.i.k``.
    length, width, thickness
        Along x, z and y, m.
    youngs_modulus, poisson, density
        Pa, 1, kg/m^3.
    grid
        Nodes along x and z, at least 2 each; with membrane at least 3 across the chains (in both directions where the
        tree is ``master``).
    tree
        ``spine``, ``rows`` or ``master``; see the module.
    supports
        What holds the edges; the trees ``spine`` and ``rows`` grow from the first, which must not slide.
    at, rotation
        Frame of the flat sheet in that of a support's body, of ``master``, or in the ground: m and 3x3 axes.
    master
        Body the master node is fixed to; None: it floats. Of the tree ``master`` only.
    rate
        Velocity of a floating master node at the start, m/s in the ground's axes and rad/s in its own: the flat sheet
        moves like a rigid body.
    joint
        ``geodesic`` keeps the lengths and angles of the sheet; ``paper`` the projected length of its chains.
    membrane
        Resist shear and stretching across rows or ribs; or the strains you name, out of ``x``, ``z``, ``s`` (shear), as
        in :class:`.Plate`.
    stretch
        Give way in the plane too: nodes of six motions and elements of a shell. The tree is then ``spine``, or
        ``master`` where there is a ``master`` or no support; ``membrane`` and ``joint`` mean nothing.
    damping, drag
        Material damping time, s, and density times drag coefficient of the air, kg/m^3.
    pressure
        On the sheet, along its normal as that turns, Pa: a number (zero: none), a signal or an input.
    """
    what = f"sheet {name!r}"
    shape = _grid(what, grid)
    for key, value in (("length", length), ("width", width), ("density", density)):
        positive(f"{key} of {what}", value)
    one_of(f"tree of {what}", tree, TREES)
    one_of(f"joint of {what}", joint, JOINTS)
    if isinstance(supports, Support):
        raise UserError(f"supports of {what} are {supports!r}; allowed: a list of them")
    for support in supports:
        check_support(what, support)
    plate = Plate(
        a=length / (shape[0] - 1),
        b=width / (shape[1] - 1),
        thickness=thickness,
        youngs_modulus=youngs_modulus,
        poisson=poisson,
        membrane=_resisted(what, membrane, tree, joint, supports),
        damping=damping,
        drag=drag,
    )
    plate.check(what)
    builder = _Builder(mechanism, name, plate, density, shape, (at, rotation), Floating if stretch else JOINTS[joint])
    if stretch:
        return builder.build_free(list(supports), master, rate, pressure)
    _refuse_one_row(what, shape, plate, tree, supports)
    return builder.build(tree, list(supports), master, rate, pressure)


class _Builder:
    """One sheet on its way into a mechanism."""

    def __init__(
        self,
        mechanism: Mechanism,
        name: str,
        plate: Plate,
        density: float,
        shape: tuple[int, int],
        placement: tuple[Vector, Any],
        joint: type[Joint],
    ) -> None:
        self.mechanism, self.name, self.plate, self.shape, self.joint = mechanism, name, plate, shape, joint
        self.what = f"sheet {name!r}"
        self.at = vector(f"placement of {self.what}", placement[0])
        self.rotation = rotation(f"rotation of {self.what}", placement[1])
        self.density = density
        self.side = max((shape[0] - 1) * plate.a, (shape[1] - 1) * plate.b)
        self.share = SHARE * _pliancy(plate, density, self.side)
        self.bodies: dict[Node, Body] = {}
        self.taken: set[Node] = set()  # held by a support

    def build(
        self, tree: str, supports: list[Support], master: Body | None, rate: Vector | None, pressure: Any
    ) -> Sheet:
        """Hang the nodes, span the elements, close the supports."""
        if rate is not None and (tree != "master" or master is not None):
            raise UserError(f"rate of {self.what} is {rate!r}, but it has no floating master node to move")
        along = 0
        if tree == "master":
            self._refuse_taut(supports, master)
            kind, options = (Floating, {"rate": rate}) if master is None else (Weld, {})
            self._hang(around(self.shape), kind, master, self.at, self.rotation, **options)
        else:
            if master is not None:
                raise UserError(f"master of {self.what} is {master.name!r}, but its tree {tree!r} has no master node")
            if not supports or supports[0].kind not in ("clamped", "pinned"):
                given = supports[0].kind if supports else "missing"
                raise UserError(
                    f"first support of {self.what} is {given}; tree {tree!r} grows from one that is clamped or pinned: "
                    "put it first, or take tree 'master'"
                )
            self._refuse_taut(supports, None)
            root = supports.pop(0)
            along = 0 if root.edge[0] == "x" else 1
            at, axes = self._frame(root)
            self.taken |= {on_edge(self.shape, root.edge, n) for n in self._held(root)}
            self._hang(
                from_edge(self.shape, root.edge, self._held(root), tree == "spine"),
                Weld if root.kind == "clamped" else Revolute,
                root.body,
                at,
                axes,
                **({"axis": "z" if root.edge[0] == "x" else "x"} if root.kind == "pinned" else {}),
            )
        return self._span(self.plate, supports, pressure, along)

    def build_free(self, supports: list[Support], master: Body | None, rate: Vector | None, pressure: Any) -> Sheet:
        """Give every node all six motions against its neighbor, or those its support leaves; span shells."""
        if rate is not None and (supports or master is not None):
            raise UserError(f"rate of {self.what} is {rate!r}, but it is held and does not float")
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
            own: list[Link] = [(node, None) for node in held if node not in self.taken]
            self.taken |= {node for node, _ in own}
            self._hang(own, kind, support.body, *self._frame(support), **options)
        if supports and master is None:
            root = supports[0]
            links = from_edge(self.shape, root.edge, self._held(root), spine=True)
            carrier, (at, axes), along = root.body, self._frame(root), 0 if root.edge[0] == "x" else 1
        else:
            links, carrier, at, axes, along = around(self.shape), master, self.at, self.rotation, 0
        loose = [link for link in links if link[0] not in self.bodies]
        first = Floating if master is None else Weld
        self._hang(loose, first, carrier, at, axes, **({} if rate is None else {"rate": rate}))
        p = self.plate
        stretching = plane_stress(p.youngs_modulus, p.poisson) * p.thickness
        cell = [self._flat(node) for node in ((0, 0), (1, 0), (1, 1), (0, 1))]
        shell = Shell(
            corners=cell,
            stretching=stretching,
            bending=stretching * p.thickness**2 / 12.0,
            damping=p.damping,
            drag=p.drag,
        )
        return self._span(shell, [support for support in supports if support.kind not in joints], pressure, along)

    def _span(self, plate: Plate | Shell, supports: list[Support], pressure: Any, along: int) -> Sheet:
        """Span an element in every cell, load it, and close these supports by cut joints."""
        nx, nz = self.shape
        node = self.bodies
        cells = [
            (node[i, k], node[i + 1, k], node[i + 1, k + 1], node[i, k + 1])
            for i in range(nx - 1)
            for k in range(nz - 1)
        ]
        for corners in cells:
            self.mechanism.plate(plate, *corners)
        if pressure != 0.0:
            self.mechanism.pressure(self.name, pressure, cells)
        cuts = [cut for support in supports for cut in self._close(support)]
        nodes = tuple(tuple(node[i, k] for k in range(nz)) for i in range(nx))
        sheet = Sheet(self.name, nodes, self.plate.a, self.plate.b, self.plate, tuple(cuts), along)
        self.mechanism.sheets.append(sheet)
        return sheet

    def _refuse_taut(self, supports: list[Support], master: Body | None) -> None:
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
                    f"supports of {self.what} hold it in its plane twice: {first[i]} and {name}; it cannot stretch, so "
                    "it could not bend between them; make one 'guided' or 'supported'"
                )
            first[i] = name

    def _flat(self, node: Node) -> Matrix:
        """Position of a node in the sheet's frame."""
        return np.array([node[0] * self.plate.a, 0.0, node[1] * self.plate.b])

    def _hang(
        self,
        links: list[Link],
        kind: type[Joint],
        carrier: Body | None,
        at: Matrix,
        axes: Matrix,
        **options: Any,
    ) -> None:
        """Add the bodies in the order of ``links``; those without a parent hang on the carrier."""
        for node, parent in links:
            if parent is None:
                body = self.mechanism.ground if carrier is None else carrier
                joint = kind(at=tuple(at + axes @ self._flat(node)), rotation=axes, **options)
            else:
                body = self.bodies[parent]
                cells = self.shape[0 if node[1] == parent[1] else 1] - 1
                angle = self.share / cells**2
                way = angle * self.side  # a node that is off takes along as many as one that is turned
                size = (way, angle, angle) if self.joint.nv == 3 else (way, way, way, angle, angle, angle)
                joint = self.joint(at=tuple(self._flat(node) - self._flat(parent)), nominal=size)
            self.bodies[node] = self.mechanism.body(f"{self.name}.{node[0]}.{node[1]}", body, joint, **self._cell(node))

    def _cell(self, node: Node) -> dict[str, Any]:
        """Mass properties of a node's cell, which is half as long at a border."""
        (i, k), t = node, self.plate.thickness
        a, x = _lump(i, self.shape[0], self.plate.a)
        b, z = _lump(k, self.shape[1], self.plate.b)
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
        held = [n for n in self._held(support) if on_edge(self.shape, support.edge, n) not in self.taken]
        for n in held:
            node = on_edge(self.shape, support.edge, n)
            self.taken.add(node)
            kind, local = cut_of(support, n == held[len(held) // 2])
            name, place = f"{self.name}.{support.edge}.{n}", tuple(at + axes @ self._flat(node))
            if support.kind == "pinned" and kind is PlaneCut:  # the pin stays in the plane of the node as that turns
                cut: Cut = kind(at_b=place, rotation_a=local, rotation_b=axes @ local)
                yield self.mechanism.cut(name, cut, self.bodies[node], body)
            else:
                cut = kind(at_a=place, rotation_a=axes @ local, rotation_b=local)
                yield self.mechanism.cut(name, cut, body, self.bodies[node])


def _pliancy(plate: Plate, density: float, length: float) -> float:
    """How far a sheet bends: the root curvature of a cantilever under its weight times its length, at most 1.

    rho g t L^3 / (2 D), to the power at which ida keeps the energy of a release to 1e-3 at rtol 1e-5 from 0.3 to 3 mm.
    """
    D = plate.youngs_modulus * plate.thickness**3 / (12.0 * (1.0 - plate.poisson**2))
    return float(min(1.0, density * GRAVITY * plate.thickness * length**3 / (2.0 * D)) ** 0.75)


def _lump(n: int, count: int, step: float) -> tuple[float, float]:
    """Length of a node's cell and where its middle is from the node, along one side of the grid."""
    if 0 < n < count - 1:
        return step, 0.0
    return 0.5 * step, 0.25 * step if n == 0 else -0.25 * step


def _resisted(what: str, membrane: bool | str, tree: str, joint: str, supports: Sequence[Support]) -> str:
    """Membrane strains that the elements resist, refused where they lock."""
    spine = supports[0].edge[0] if tree != "master" and supports else "x"
    across = "z" if spine == "x" else "x"
    chain = spine if tree == "rows" else across  # along rows or ribs nothing stretches
    strains = membrane if isinstance(membrane, str) else "xzs".replace(chain, "") * membrane
    locked = set(strains) & ({spine} if tree == "rows" else {"x", "z"})
    if joint == "paper" and locked:
        raise UserError(
            f"{what} has membrane {membrane!r} on chains of projected length, which locks: it would be several times "
            "too stiff; take joint 'geodesic' or no membrane"
        )
    return strains


def _refuse_one_row(what: str, shape: tuple[int, int], plate: Plate, tree: str, supports: Sequence[Support]) -> None:
    """Refuse a membrane on one row of cells; see the module."""
    along = supports[0].edge[0] if tree != "master" and supports else ""
    for axis, count in zip("xz", shape, strict=True):
        if plate.strains and axis != along and count < 3:
            raise UserError(
                f"grid of {what} is {shape}: one row of cells across its chains, along {axis}; with membrane it folds "
                f"there instead of bending; allowed: at least 3 nodes along {axis}, or no membrane"
            )


def _grid(what: str, grid: Any) -> tuple[int, int]:
    """Check two numbers of nodes."""
    counts = tuple(grid) if isinstance(grid, Sequence) else (grid,)
    if len(counts) != 2 or not all(isinstance(n, int | np.integer) and n >= 2 for n in counts):
        raise UserError(f"grid of {what} is {grid!r}; allowed: two whole numbers of nodes, at least 2 each")
    return int(counts[0]), int(counts[1])

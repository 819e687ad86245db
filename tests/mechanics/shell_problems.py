"""Standard problems of shells as mechanisms: what is built, and what others found.

Every problem gives ``Problem``: a mechanism, and its outputs with the published values. Nodes have all six motions;
those in a plane of symmetry slide in it.

Sources: Cook, Malkus and Plesha (1989), *Concepts and Applications of Finite Element Analysis*; MacNeal and Harder
(1985), *A proposed standard set of problems to test finite element accuracy*, Finite Elem. Anal. Des. 1, 3-20; Sze,
Liu and Lo (2004), *Popular benchmark problems for geometric nonlinear analysis of shells*, Finite Elem. Anal. Des. 40,
1551-1569, whose tables are by S4R elements of Abaqus; Simo, Fox and Rifai (1989), *On a stress resultant geometrically
exact shell model II*, Comput. Methods Appl. Mech. Eng. 73, 53-92.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.polynomial import Legendre, Polynomial
from numpy.typing import NDArray
from scipy.linalg import eigh

from mbfmu.mechanics import (
    Body,
    Floating,
    Input,
    Mechanism,
    Planar,
    PointForce,
    Product,
    Revolute,
    Torque,
    Translational,
    Weld,
)
from mbfmu.sheets import Shell, Support, add_sheet
from mbfmu.sheets.elements.material import PlaneStress
from mbfmu.steady.equilibrium import equilibrium

Node = tuple[int, int]


@dataclass(frozen=True)
class Problem:
    """A mechanism some of whose displacements others have found too.

    Attributes
    ----------
    published
        Displacements by the names of outputs, which are positions, in the unit of the source.
    start
        The outputs where nothing is loaded.
    part
        Of the published load; a small one where the source is linear.
    """

    mechanism: Mechanism
    published: Mapping[str, float]
    start: Mapping[str, float]
    part: float = 1.0

    def displacements(self, outputs: Mapping[str, float]) -> dict[str, float]:
        """Return what is compared with ``published``."""
        return {name: (outputs[name] - self.start[name]) / self.part for name in self.published}


@dataclass
class Surface:
    """A net of nodes with a shell element in every cell.

    Parameters
    ----------
    P
        (nu, nv, 3), the nodes, m.
    normals
        (nu, nv, 3), of the surface: those of d/dv x d/du.
    thickness, youngs_modulus, poisson
        m, Pa, 1.
    root
        The node that the tree grows from, first along u, then along v.
    hung
        Whether the joints of nodes connect them to their neighbors. For a sheet that is held at one end this needs a
        tenth of the steps. Otherwise they connect nodes to the ground, which needs a third of the steps for a
        sheet that is held at all edges.

    Attributes
    ----------
    mechanism
        What it is in.
    axes
        (nu, nv, 3, 3), of the nodes in columns: along u, normal, and across both.
    bodies
        The nodes.
    start
        Where outputs start, m.
    """

    P: NDArray[np.float64]
    normals: NDArray[np.float64]
    thickness: float
    youngs_modulus: float
    poisson: float
    root: Node = (0, 0)
    hung: bool = True
    mechanism: Mechanism = field(default_factory=Mechanism)
    bodies: dict[Node, Body] = field(default_factory=dict)
    start: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Lay the axes of the nodes."""
        n = self.normals / np.linalg.norm(self.normals, axis=-1, keepdims=True)
        x = np.gradient(self.P, axis=0)
        x -= np.sum(x * n, -1, keepdims=True) * n
        x /= np.linalg.norm(x, axis=-1, keepdims=True)
        self.axes = np.stack((x, n, np.cross(x, n)), -1)

    def weave(self, held: Callable[[int, int], Any] = lambda i, k: None) -> None:
        """Add all bodies and elements.

        ``held(i, k)`` gives the joints that node holds the ground by, one after the other, as pairs of a kind and the
        axis it has in the ground; None: the node is connected to a neighbor.
        """
        nu, nv = self.P.shape[:2]
        rows, columns = (
            sorted(range(n), key=lambda j, c=c: abs(j - c)) for n, c in zip((nu, nv), self.root, strict=True)
        )
        for i in rows:
            for k in columns:
                self._hang((i, k), held(i, k))
        material = PlaneStress(self.youngs_modulus, self.poisson).Q * self.thickness
        for i in range(nu - 1):
            for k in range(nv - 1):
                cell = [(i, k), (i + 1, k), (i + 1, k + 1), (i, k + 1)]
                shell = Shell(
                    corners=[self.P[c] for c in cell],
                    attitudes=[self.axes[c] for c in cell],
                    stretching=material,
                    bending=material * self.thickness**2 / 12.0,
                )
                self.mechanism.element(shell, *(self.bodies[c] for c in cell))

    def _hang(self, node: Node, held: Any) -> None:
        """Add the body of a node, of a density of 1 kg/m^3; statics only see that it is there."""
        (i, k), (ci, ck) = node, self.root
        ahead = np.linalg.norm(np.gradient(self.P, axis=0)[node])
        across = np.linalg.norm(np.gradient(self.P, axis=1)[node])
        mass = float(ahead * across) * self.thickness
        own = {"mass": mass, "inertia": [mass * float(ahead * across) / 12.0] * 3}
        name, A, r = f"{i}.{k}", self.axes[node], self.P[node]
        if held is None:
            parent = (i, k - int(np.sign(k - ck))) if k != ck else (i - int(np.sign(i - ci)), k)
            if parent == node or not self.hung:
                body, at, rotation = self.mechanism.ground, r, A
            else:
                B = self.axes[parent]
                body, at, rotation = self.bodies[parent], B.T @ (r - self.P[parent]), B.T @ A
            self.bodies[node] = self.mechanism.body(name, body, Floating(at=at, rotation=rotation), **own)
            return
        body = self.mechanism.ground
        for j, (kind, axis) in enumerate(held):
            last = j == len(held) - 1
            options: dict[str, Any] = {"at": r, "rotation": A} if j == 0 else {}
            if axis is not None:
                options["axis"] = tuple(A.T @ np.asarray(axis, float))
            body = self.mechanism.body(name if last else f"{name}:{j}", body, kind(**options), **(own if last else {}))
        self.bodies[node] = body

    def force(self, node: Node, magnitude: float, axis: str) -> None:
        """Load a node along an axis of the ground, N."""
        number = len(self.mechanism.forces)
        self.mechanism.force(f"force{number}", PointForce(magnitude=magnitude, axis=axis), self.bodies[node])

    def output(self, name: str, node: Node, axis: str) -> None:
        """Return where a node is, along an axis of the ground."""
        self.mechanism.output(name, self.bodies[node].position(axis))
        self.start[name] = float(self.P[node]["xyz".index(axis)])

    def problem(self, part: float = 1.0, **published: float) -> Problem:
        """Return what is to be solved, and what its outputs are to be moved by."""
        return Problem(self.mechanism, published, self.start, part)


CLAMPED = ((Weld, None),)
X, Y, Z = np.eye(3)


def flat(P: Any) -> NDArray[np.float64]:
    """Return normals along y for a net P (nu, nv, 3) in the x-z plane."""
    return np.broadcast_to(Y, P.shape)


def shares(n: int) -> NDArray[np.float64]:
    """Return the parts (n + 1,) of a load on an edge of n cells that go to its nodes."""
    parts = np.full(n + 1, 1.0 / n)
    parts[[0, -1]] *= 0.5
    return parts


def clamped_edge(i: int, k: int) -> Any:
    """Clamp the first line of nodes."""
    return CLAMPED if i == 0 else None


def cook(n: int) -> Problem:
    """Cook's membrane on n x n cells, n even: a tapered panel, clamped at one side and sheared at the other; linear."""
    s, part = np.linspace(0.0, 1.0, n + 1), 1e-4
    P = np.zeros((n + 1, n + 1, 3))
    P[..., 0], P[..., 2] = 48.0 * s[:, None], 44.0 * s[:, None] + np.outer(44.0 - 28.0 * s, s)
    panel = Surface(P, flat(P), 1.0, 1.0, 1.0 / 3.0, root=(0, n // 2))
    panel.weave(clamped_edge)
    for k, share in enumerate(shares(n)):
        panel.force((n, k), part * share, "z")
    panel.output("v", (n, n // 2), "z")
    return panel.problem(part, v=23.96)


def strip(cells: tuple[int, int], length: float) -> Surface:
    """Clamped strip of Sze, Liu and Lo, 3.1 and 3.2: 1 wide, 0.1 thick, E 1.2e6, nu 0."""
    P = np.zeros((cells[0] + 1, cells[1] + 1, 3))
    P[..., 0] = np.linspace(0.0, length, cells[0] + 1)[:, None]
    P[..., 2] = np.linspace(0.0, 1.0, cells[1] + 1)
    surface = Surface(P, flat(P), 0.1, 1.2e6, 0.0, root=(0, cells[1] // 2))
    surface.weave(clamped_edge)
    surface.output("u", (cells[0], 0), "x")
    surface.output("w", (cells[0], 0), "y")
    return surface


def sheared_strip(cells: tuple[int, int]) -> Problem:
    """Strip with a force of 4 across its end: Sze, Liu and Lo, table 1."""
    surface = strip(cells, 10.0)
    for k, share in enumerate(shares(cells[1])):
        surface.force((cells[0], k), 4.0 * share, "y")
    return surface.problem(u=-3.286, w=6.698)


def rolled_strip(cells: tuple[int, int], turn: float) -> Problem:
    """Strip rolled up by a moment at its end to an arc of ``turn`` rad: the elastica, whose curvature is M / E I."""
    surface = strip(cells, 12.0)
    EI = 1.2e6 * 0.1**3 / 12.0
    for k, share in enumerate(shares(cells[1])):
        torque = Torque(magnitude=share * EI * turn / 12.0, axis="z")
        surface.mechanism.force(f"moment{k}", torque, surface.bodies[cells[0], k])
    return surface.problem(u=12.0 * (np.sin(turn) / turn - 1.0), w=12.0 * (1.0 - np.cos(turn)) / turn)


def slit_annulus(cells: tuple[int, int]) -> Problem:
    """Ring from radius 6 to 10, slit: one lip clamped, the other lifted by 0.8 per length; cells around and across.

    Sze, Liu and Lo, 3.3 and table 4; 0.03 thick, E 21e6, nu 0.
    """
    angle, r = np.linspace(0.0, 2.0 * np.pi, cells[0] + 1), np.linspace(6.0, 10.0, cells[1] + 1)
    P = np.stack((np.outer(np.cos(angle), r), np.zeros((len(angle), len(r))), -np.outer(np.sin(angle), r)), -1)
    ring = Surface(P, flat(P), 0.03, 21e6, 0.0, root=(0, cells[1] // 2))
    ring.weave(clamped_edge)
    for k, share in enumerate(shares(cells[1])):
        ring.force((cells[0], k), 0.8 * 4.0 * share, "y")
    ring.output("wA", (cells[0], 0), "y")
    ring.output("wB", (cells[0], cells[1]), "y")
    return ring.problem(wA=13.891, wB=17.528)


def twisted_strip(cells: tuple[int, int], axis: str, thickness: float = 0.32) -> Problem:
    """Clamped strip twisted by a right angle, 12 long, 1.1 wide, with a force at its end; linear.

    MacNeal and Harder for 0.32 thick and a force of 1; Simo, Fox and Rifai for 0.0032 and 1e-6. Along z it acts in the
    plane of the end, along y across it.
    """
    published = {("z", 0.32): 5.424e-3, ("y", 0.32): 1.754e-3, ("z", 0.0032): 5.256e-3, ("y", 0.0032): 1.294e-3}
    x, s = np.linspace(0.0, 12.0, cells[0] + 1), np.linspace(-0.55, 0.55, cells[1] + 1)
    rate = 0.5 * np.pi / 12.0
    c, d = np.cos(rate * x)[:, None], np.sin(rate * x)[:, None]
    P = np.stack((np.broadcast_to(x[:, None], (len(x), len(s))), c * s, d * s), -1)
    along = np.stack((np.ones_like(P[..., 0]), -rate * d * s, rate * c * s), -1)
    across = np.stack((np.zeros_like(P[..., 0]), c + 0.0 * s, d + 0.0 * s), -1)
    surface = Surface(P, np.cross(across, along), thickness, 29e6, 0.22, root=(0, cells[1] // 2))
    surface.weave(clamped_edge)
    for k, share in enumerate(shares(cells[1])):
        surface.force((cells[0], k), (1.0 if thickness == 0.32 else 1e-6) * share, axis)
    surface.output(axis, (cells[0], cells[1] // 2), axis)
    return surface.problem(**{axis: published[axis, thickness]})


def pinched_hemisphere(n: int, load: float) -> Problem:
    """Hemisphere with a hole of 18 degrees, pulled and pushed at its rim; a quarter of it on n x n cells.

    Radius 10, 0.04 thick, E 6.825e7, nu 0.3. A load of 2 or less is the linear problem of MacNeal and Harder, with
    0.094; 400 is that of Sze, Liu and Lo, 3.4.
    """
    around, down = np.linspace(0.0, 0.5 * np.pi, n + 1), np.linspace(0.1 * np.pi, 0.5 * np.pi, n + 1)
    P = np.stack(
        (
            np.outer(np.cos(around), np.sin(down)),
            np.outer(np.sin(around), np.sin(down)),
            np.broadcast_to(np.cos(down), (n + 1, n + 1)),
        ),
        -1,
    )
    dome = Surface(10.0 * P, P, 0.04, 6.825e7, 0.3, root=(0, n // 2), hung=False)

    def held(i: int, k: int) -> Any:
        if (i, k) == (0, 0):  # held along z too, on which nothing acts
            return ((Translational, X), (Revolute, Y))
        return {0: ((Planar, Y),), n: ((Planar, X),)}.get(i)

    dome.weave(held)
    dome.force((0, n), 0.5 * load, "x")
    dome.force((n, n), -0.5 * load, "y")
    dome.output("u", (0, n), "x")
    dome.output("v", (n, n), "y")
    if load <= 2.0:
        return dome.problem(0.5 * load, u=0.094, v=-0.094)
    return dome.problem(u=4.067, v=-8.178)


def pulled_cylinder(cells: tuple[int, int]) -> Problem:
    """Cylinder with free ends, pulled apart at two points by 40000; an eighth of it, cells along and around.

    Sze, Liu and Lo, 3.5: radius 4.953, length 10.35, 0.094 thick, E 10.5e6, nu 0.3125.
    """
    z, angle = np.linspace(0.0, 5.175, cells[0] + 1), np.linspace(0.0, 0.5 * np.pi, cells[1] + 1)
    normals = np.broadcast_to(
        np.stack((np.cos(angle), np.sin(angle), 0.0 * angle), -1), (cells[0] + 1, cells[1] + 1, 3)
    )
    P = 4.953 * normals
    P[..., 2] = z[:, None]
    tube = Surface(P, normals, 0.094, 10.5e6, 0.3125, root=(0, cells[1] // 2), hung=False)

    def held(i: int, k: int) -> Any:
        side = {0: Y, cells[1]: X}.get(k)
        if i == 0:
            return ((Planar, Z),) if side is None else ((Translational, X + Y - side),)
        return None if side is None else ((Planar, side),)

    tube.weave(held)
    tube.force((0, cells[1]), 10000.0, "y")
    tube.output("wA", (0, cells[1]), "y")
    return tube.problem(wA=2.768)


def hinged_roof(cells: tuple[int, int], thickness: float) -> Mechanism:
    """Shallow cylindrical roof, hinged along its straight edges, with a force at its middle; a quarter, from there.

    Sze, Liu and Lo: radius 2.54 m, 0.2 rad, 0.508 m long, E 3102.75 N/mm^2, nu 0.3; cells around and along. The
    input ``force`` is that on all of it, downwards; the output ``y`` is the height of its middle.
    """
    angle, z = np.linspace(0.0, 0.1, cells[0] + 1), np.linspace(0.0, 0.254, cells[1] + 1)
    normals = np.broadcast_to(
        np.stack((np.sin(angle), np.cos(angle), 0.0 * angle), -1)[:, None], (cells[0] + 1, cells[1] + 1, 3)
    )
    P = 2.54 * normals
    P[..., 2] = z
    roof = Surface(P, normals, thickness, 3102.75e6, 0.3, root=(cells[0], 0), hung=False)

    def held(i: int, k: int) -> Any:
        if i == cells[0]:
            return ((Revolute, Z),)
        if i == 0:
            return ((Planar, X),) if k else ((Translational, Y),)
        return None if k else ((Planar, Z),)

    roof.weave(held)
    force = Input(name="force", unit="N")
    roof.mechanism.force("force", PointForce(magnitude=Product(force, -0.25), axis="y"), roof.bodies[0, 0])
    roof.mechanism.output("y", roof.bodies[0, 0].position("y"))
    return roof.mechanism


WAYS = ("from the support", "from the load", "from the middle")  # a sheet's tree may grow
PLATES = {"hinged": (0.3, 0.3), "clamped": (0.3, 0.21)}  # m, compressed along the first
MATERIAL = {"thickness": 1e-3, "youngs_modulus": 1e10, "poisson": 0.3}


def compressed_plate(edges: str, cells: int, load: float | Input, way: str) -> Mechanism:
    """Plate under ``load`` times Euler's load of a strip of it, between two edges that are hinged or clamped.

    ``load`` is a number or an input. The edge x = 0, which is pushed, slides in the plane. The middle floats where the
    sheet grows from there.
    """
    (length, width), t = PLATES[edges], MATERIAL["thickness"]
    grid = cells + 1, round(cells * width / length) + 1
    strip = {"hinged": 1.0, "clamped": 4.0}[edges] * np.pi**2 * MATERIAL["youngs_modulus"] * t**3 / (12.0 * length**2)
    m, master, at = Mechanism(), None, (0.0, 0.0, 0.0)
    if way == "from the middle":
        at = (-(cells // 2) * length / cells, 0.0, -(grid[1] // 2) * width / (grid[1] - 1))
        master = m.body("middle", m.ground, Floating())
    held, sliding = {"hinged": ("pinned", "supported"), "clamped": ("clamped", "guided")}[edges]
    supports = [Support("x1", held, at=at), Support("x0", sliding, at=at)]
    sheet = add_sheet(
        m, "plate", length=length, width=width, density=1000.0, grid=grid, master=master, at=at, stretch=True,
        supports=supports[::-1] if way == "from the load" else supports, **MATERIAL,
    )  # fmt: skip
    for k, share in enumerate(shares(grid[1] - 1)):
        part = share * strip * width
        push = PointForce(magnitude=Product(load, part) if isinstance(load, Input) else load * part, axis="x")
        m.force(f"push{k}", push, sheet.node(0, k))
    return m


def buckling_load(edges: str, cells: int, way: str) -> float:
    """Return the load of :func:`compressed_plate` at which its lowest frequency comes to zero.

    The square of the frequency falls with the load along a straight line but for the change of the mode.
    """
    loads, squares = (0.8, 1.0), []
    for load in loads:
        found = equilibrium(compressed_plate(edges, cells, load, way))
        squares.append(found.shapes(1)[0].mode.eigenvalue.imag ** 2)
    return loads[1] + squares[1] * (loads[1] - loads[0]) / (squares[0] - squares[1])


def ritz_buckling_load(edges: str, terms: int = 12) -> float:
    """Return the same by Ritz: w = sum of f(x) g(z), f polynomials that keep the edges, g even ones.

    Kirchhoff's energy over D: (w,xx + w,zz)^2 - 2 (1 - nu) (w,xx w,zz - w,xz^2), against w,x^2 of the force; length 1.
    """
    nu, b = MATERIAL["poisson"], PLATES[edges][1] / PLATES[edges][0]
    s, weight = np.polynomial.legendre.leggauss(40)
    kept = Polynomial([0.0, 1.0, -1.0]) ** {"hinged": 1, "clamped": 2}[edges]
    along = [kept * Legendre.basis(k)(Polynomial([-1.0, 2.0])) for k in range(terms)]
    across = [Legendre.basis(2 * k)(Polynomial([0.0, 2.0 / b])) for k in range(terms)]

    def products(own: Any, at: Any, by: Any, c: int, d: int) -> Any:
        """Integrals of the derivatives of orders c and d of all pairs."""
        left, right = (np.array([p.deriv(n)(at) for p in own]) for n in (c, d))
        return (left * by) @ right.T

    X = {(c, d): products(along, 0.5 * (s + 1.0), 0.5 * weight, c, d) for c in range(3) for d in range(3)}
    Z = {(c, d): products(across, 0.5 * b * s, 0.5 * b * weight, c, d) for c in range(3) for d in range(3)}
    bent = np.kron(X[2, 2], Z[0, 0]) + np.kron(X[0, 0], Z[2, 2]) + 2.0 * (1.0 - nu) * np.kron(X[1, 1], Z[1, 1])
    bent += nu * (np.kron(X[2, 0], Z[0, 2]) + np.kron(X[0, 2], Z[2, 0]))
    strip = {"hinged": 1.0, "clamped": 4.0}[edges] * np.pi**2 * (1.0 - nu**2)
    return float(eigh(bent, np.kron(X[1, 1], Z[0, 0]), eigvals_only=True)[0] / strip)


def held_sheet(cells: tuple[int, int]) -> Mechanism:
    """The sheet of Bae and Cho under its weight, held by the middle third of an edge; whose ends are nodes."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    sheet = add_sheet(
        m, "sheet", length=0.3, width=0.21, thickness=0.3e-3, youngs_modulus=1e10, density=1000.0,
        grid=(cells[0] + 1, cells[1] + 1), supports=[Support("x1", span=(0.07, 0.14))], stretch=True,
    )  # fmt: skip
    for name, k in {"corner": 0, "middle": cells[1] // 2, "other": cells[1]}.items():
        m.output(name, sheet.node(0, k).position("y"))
    return m

"""Problems of the literature for thin shells: nets of nodes with six coordinates each and shell elements.

Nodes in a plane of symmetry slide in it. Lengths and forces are in the units of the sources, which is without effect:
R. D. Cook, D. S. Malkus, M. E. Plesha (1989): Concepts and applications of finite element analysis, 3rd edition, Wiley.
R. H. MacNeal, R. L. Harder (1985): A proposed standard set of problems to test finite element accuracy. Finite Elements
in Analysis and Design 1, 3-20.
K. Y. Sze, X. H. Liu, S. H. Lo (2004): Popular benchmark problems for geometric nonlinear analysis of shells. Finite
Elements in Analysis and Design 40, 1551-1569; their tables are computed with elements S4R of Abaqus.
J. C. Simo, D. D. Fox, M. S. Rifai (1989): On a stress resultant geometrically exact shell model, part II. Computer
Methods in Applied Mechanics and Engineering 73, 53-92.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
from mbfmu.sheets import Shell
from mbfmu.sheets.elements.material import PlaneStress

Array = NDArray[np.float64]
Node = tuple[int, int]


@dataclass(frozen=True)
class LoadedShell:
    """Mechanism with published displacements.

    Attributes
    ----------
    mechanism
        Shell with its loads; its outputs are coordinates of nodes.
    published
        Displacements by names of outputs, in the unit of the source.
    start
        Values of the outputs without load.
    load_factor
        Part of the published load that acts; a small one if the source is linear.
    """

    mechanism: Mechanism
    published: Mapping[str, float]
    start: Mapping[str, float]
    load_factor: float = 1.0

    def displacements(self, outputs: Mapping[str, float]) -> dict[str, float]:
        """Return the displacements that are compared with ``published``."""
        return {name: (outputs[name] - self.start[name]) / self.load_factor for name in self.published}


@dataclass
class ShellNet:
    """Net of nodes with a shell element in every cell.

    Parameters
    ----------
    P
        Positions of the nodes (nu, nv, 3).
    normals
        Normals of the surface (nu, nv, 3), in the direction of d/dv x d/du.
    thickness, youngs_modulus, poisson
        Thickness, Young's modulus and Poisson's ratio.
    root
        Root of the tree of joints, which connects nodes along v, and these lines along u.
    connect_neighbors
        Whether joints connect nodes to their neighbors. For a sheet that is held at one end this needs a tenth of the
        steps. Otherwise they connect nodes to the ground, which needs a third of the steps for a sheet that is held
        at all edges.

    Attributes
    ----------
    mechanism
        Mechanism of the shell.
    axes
        Axes of the nodes (nu, nv, 3, 3) in columns: along u, normal, perpendicular to both.
    bodies
        Bodies of the nodes.
    start
        Outputs without load.
    """

    P: Array
    normals: Array
    thickness: float
    youngs_modulus: float
    poisson: float
    root: Node = (0, 0)
    connect_neighbors: bool = True
    mechanism: Mechanism = field(default_factory=Mechanism)
    bodies: dict[Node, Body] = field(default_factory=dict)
    start: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Compute the axes of the nodes."""
        n = self.normals / np.linalg.norm(self.normals, axis=-1, keepdims=True)
        x = np.gradient(self.P, axis=0)
        x -= np.sum(x * n, -1, keepdims=True) * n
        x /= np.linalg.norm(x, axis=-1, keepdims=True)
        self.axes = np.stack((x, n, np.cross(x, n)), -1)

    def build(self, supports: Callable[[int, int], Any] = lambda i, k: None) -> None:
        """Add all bodies and elements.

        ``supports(i, k)`` returns the joints between the ground and a node, one after the other, as pairs of a type and
        its axis in the ground; None: the node has six coordinates.
        """
        nu, nv = self.P.shape[:2]
        for i in outward(nu, self.root[0]):
            for k in outward(nv, self.root[1]):
                joints = supports(i, k)
                self.bodies[i, k] = self._free_node((i, k)) if joints is None else self._supported_node((i, k), joints)
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

    def _mass_properties(self, node: Node) -> dict[str, Any]:
        """Return mass and inertia of a node for a density of 1; steady states do not depend on them."""
        area = float(np.prod([np.linalg.norm(np.gradient(self.P, axis=axis)[node]) for axis in (0, 1)]))
        mass = area * self.thickness
        return {"mass": mass, "inertia": [mass * area / 12.0] * 3}

    def _free_node(self, node: Node) -> Body:
        """Add a node with six coordinates."""
        (i, k), (ci, ck), A, r = node, self.root, self.axes[node], self.P[node]
        neighbor = (i, k - int(np.sign(k - ck))) if k != ck else (i - int(np.sign(i - ci)), k)
        parent, at, rotation = self.mechanism.ground, r, A
        if neighbor != node and self.connect_neighbors:
            B = self.axes[neighbor]
            parent, at, rotation = self.bodies[neighbor], B.T @ (r - self.P[neighbor]), B.T @ A
        joint = Floating(at=at, rotation=rotation)
        return self.mechanism.body(f"{i}.{k}", parent, joint, **self._mass_properties(node))

    def _supported_node(self, node: Node, joints: Any) -> Body:
        """Add a node that joints connect to the ground."""
        name, A, body = f"{node[0]}.{node[1]}", self.axes[node], self.mechanism.ground
        for j, (kind, axis) in enumerate(joints):
            options: dict[str, Any] = {"at": self.P[node], "rotation": A} if j == 0 else {}
            if axis is not None:
                options["axis"] = tuple(A.T @ np.asarray(axis, float))
            is_last = j == len(joints) - 1
            mass = self._mass_properties(node) if is_last else {}
            body = self.mechanism.body(name if is_last else f"{name}:{j}", body, kind(**options), **mass)
        return body

    def add_force(self, node: Node, magnitude: float, axis: str) -> None:
        """Add a force on a node along an axis of the ground."""
        number = len(self.mechanism.forces)
        self.mechanism.force(f"force{number}", PointForce(magnitude=magnitude, axis=axis), self.bodies[node])

    def add_output(self, name: str, node: Node, axis: str) -> None:
        """Add the coordinate of a node along an axis of the ground as an output."""
        self.mechanism.output(name, self.bodies[node].position(axis))
        self.start[name] = float(self.P[node]["xyz".index(axis)])

    def loaded(self, load_factor: float = 1.0, **published: float) -> LoadedShell:
        """Return the shell with its published displacements."""
        return LoadedShell(self.mechanism, published, self.start, load_factor)


def outward(count: int, root: int) -> list[int]:
    """Return 0 to count - 1 in the order of their distance from the root."""
    return sorted(range(count), key=lambda j: abs(j - root))


CLAMPED = ((Weld, None),)
X, Y, Z = np.eye(3)


def flat(P: Any) -> Array:
    """Return normals (nu, nv, 3) along y of a net P (nu, nv, 3) in the x-z plane."""
    return np.broadcast_to(Y, P.shape)


def shares(n: int) -> Array:
    """Return the parts (n + 1,) of a load on an edge of n cells that go to its nodes."""
    parts = np.full(n + 1, 1.0 / n)
    parts[[0, -1]] *= 0.5
    return parts


def clamped_edge(i: int, k: int) -> Any:
    """Return the supports of a net whose first line of nodes is clamped."""
    return CLAMPED if i == 0 else None


def cook(n: int) -> LoadedShell:
    """Cook's membrane on n x n cells, n even: a tapered panel, clamped at one side and sheared at the other; linear."""
    s, factor = np.linspace(0.0, 1.0, n + 1), 1e-4
    P = np.zeros((n + 1, n + 1, 3))
    P[..., 0], P[..., 2] = 48.0 * s[:, None], 44.0 * s[:, None] + np.outer(44.0 - 28.0 * s, s)
    panel = ShellNet(P, flat(P), 1.0, 1.0, 1.0 / 3.0, root=(0, n // 2))
    panel.build(clamped_edge)
    for k, share in enumerate(shares(n)):
        panel.add_force((n, k), factor * share, "z")
    panel.add_output("v", (n, n // 2), "z")
    return panel.loaded(factor, v=23.96)


def strip(cells: tuple[int, int], length: float) -> ShellNet:
    """Clamped strip of Sze, Liu and Lo, 3.1 and 3.2: 1 wide, 0.1 thick, E 1.2e6, nu 0."""
    P = np.zeros((cells[0] + 1, cells[1] + 1, 3))
    P[..., 0] = np.linspace(0.0, length, cells[0] + 1)[:, None]
    P[..., 2] = np.linspace(0.0, 1.0, cells[1] + 1)
    surface = ShellNet(P, flat(P), 0.1, 1.2e6, 0.0, root=(0, cells[1] // 2))
    surface.build(clamped_edge)
    surface.add_output("u", (cells[0], 0), "x")
    surface.add_output("w", (cells[0], 0), "y")
    return surface


def sheared_strip(cells: tuple[int, int]) -> LoadedShell:
    """Strip with a force of 4 across its end: Sze, Liu and Lo, table 1."""
    surface = strip(cells, 10.0)
    for k, share in enumerate(shares(cells[1])):
        surface.add_force((cells[0], k), 4.0 * share, "y")
    return surface.loaded(u=-3.286, w=6.698)


def rolled_strip(cells: tuple[int, int], turn: float) -> LoadedShell:
    """Strip that a moment at its end bends to an arc of ``turn`` rad; the curvature of the elastica is M / E I."""
    surface = strip(cells, 12.0)
    EI = 1.2e6 * 0.1**3 / 12.0
    for k, share in enumerate(shares(cells[1])):
        torque = Torque(magnitude=share * EI * turn / 12.0, axis="z")
        surface.mechanism.force(f"moment{k}", torque, surface.bodies[cells[0], k])
    return surface.loaded(u=12.0 * (np.sin(turn) / turn - 1.0), w=12.0 * (1.0 - np.cos(turn)) / turn)


def slit_annulus(cells: tuple[int, int]) -> LoadedShell:
    """Slit ring of radii 6 and 10: one lip is clamped, the other has a load of 0.8 per length; cells around and across.

    Sze, Liu and Lo, 3.3 and table 4; 0.03 thick, E 21e6, nu 0.
    """
    angle, r = np.linspace(0.0, 2.0 * np.pi, cells[0] + 1), np.linspace(6.0, 10.0, cells[1] + 1)
    P = np.stack((np.outer(np.cos(angle), r), np.zeros((len(angle), len(r))), -np.outer(np.sin(angle), r)), -1)
    ring = ShellNet(P, flat(P), 0.03, 21e6, 0.0, root=(0, cells[1] // 2))
    ring.build(clamped_edge)
    for k, share in enumerate(shares(cells[1])):
        ring.add_force((cells[0], k), 0.8 * 4.0 * share, "y")
    ring.add_output("wA", (cells[0], 0), "y")
    ring.add_output("wB", (cells[0], cells[1]), "y")
    return ring.loaded(wA=13.891, wB=17.528)


def twisted_strip(cells: tuple[int, int], axis: str, thickness: float = 0.32) -> LoadedShell:
    """Clamped strip twisted by a right angle, 12 long, 1.1 wide, with a force at its end; linear.

    MacNeal and Harder: thickness 0.32, force 1; Simo, Fox and Rifai: 0.0032 and 1e-6. A force along z is in the plane
    of the end, a force along y perpendicular to it.
    """
    published = {("z", 0.32): 5.424e-3, ("y", 0.32): 1.754e-3, ("z", 0.0032): 5.256e-3, ("y", 0.0032): 1.294e-3}
    x, s = np.linspace(0.0, 12.0, cells[0] + 1), np.linspace(-0.55, 0.55, cells[1] + 1)
    rate = 0.5 * np.pi / 12.0
    c, d = np.cos(rate * x)[:, None], np.sin(rate * x)[:, None]
    P = np.stack((np.broadcast_to(x[:, None], (len(x), len(s))), c * s, d * s), -1)
    along = np.stack((np.ones_like(P[..., 0]), -rate * d * s, rate * c * s), -1)
    across = np.stack((np.zeros_like(P[..., 0]), c + 0.0 * s, d + 0.0 * s), -1)
    surface = ShellNet(P, np.cross(across, along), thickness, 29e6, 0.22, root=(0, cells[1] // 2))
    surface.build(clamped_edge)
    for k, share in enumerate(shares(cells[1])):
        surface.add_force((cells[0], k), (1.0 if thickness == 0.32 else 1e-6) * share, axis)
    surface.add_output(axis, (cells[0], cells[1] // 2), axis)
    return surface.loaded(**{axis: published[axis, thickness]})


def pinched_hemisphere(n: int, load: float) -> LoadedShell:
    """Quarter of a hemisphere with a hole of 18 degrees, n x n cells; forces at its rim pull and push it.

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
    dome = ShellNet(10.0 * P, P, 0.04, 6.825e7, 0.3, root=(0, n // 2), connect_neighbors=False)

    def supports(i: int, k: int) -> Any:
        if (i, k) == (0, 0):  # also held along z, in which direction there is no load
            return ((Translational, X), (Revolute, Y))
        return {0: ((Planar, Y),), n: ((Planar, X),)}.get(i)

    dome.build(supports)
    dome.add_force((0, n), 0.5 * load, "x")
    dome.add_force((n, n), -0.5 * load, "y")
    dome.add_output("u", (0, n), "x")
    dome.add_output("v", (n, n), "y")
    if load <= 2.0:
        return dome.loaded(0.5 * load, u=0.094, v=-0.094)
    return dome.loaded(u=4.067, v=-8.178)


def pulled_cylinder(cells: tuple[int, int]) -> LoadedShell:
    """Eighth of a cylinder with free ends that two forces of 40000 pull apart; cells along and around.

    Sze, Liu and Lo, 3.5: radius 4.953, length 10.35, 0.094 thick, E 10.5e6, nu 0.3125.
    """
    z, angle = np.linspace(0.0, 5.175, cells[0] + 1), np.linspace(0.0, 0.5 * np.pi, cells[1] + 1)
    normals = np.broadcast_to(
        np.stack((np.cos(angle), np.sin(angle), 0.0 * angle), -1), (cells[0] + 1, cells[1] + 1, 3)
    )
    P = 4.953 * normals
    P[..., 2] = z[:, None]
    tube = ShellNet(P, normals, 0.094, 10.5e6, 0.3125, root=(0, cells[1] // 2), connect_neighbors=False)

    def supports(i: int, k: int) -> Any:
        side = {0: Y, cells[1]: X}.get(k)
        if i == 0:
            return ((Planar, Z),) if side is None else ((Translational, X + Y - side),)
        return None if side is None else ((Planar, side),)

    tube.build(supports)
    tube.add_force((0, cells[1]), 10000.0, "y")
    tube.add_output("wA", (0, cells[1]), "y")
    return tube.loaded(wA=2.768)


def hinged_roof(cells: tuple[int, int], thickness: float) -> Mechanism:
    """Quarter of a shallow cylindrical roof, hinged along its straight edges, with a force at its middle.

    Sze, Liu and Lo: radius 2.54 m, 0.2 rad, 0.508 m long, E 3102.75 N/mm^2, nu 0.3; cells around and along. The
    input ``force`` is the force on the whole roof, downwards; the output ``y`` is the height of its middle.
    """
    angle, z = np.linspace(0.0, 0.1, cells[0] + 1), np.linspace(0.0, 0.254, cells[1] + 1)
    normals = np.broadcast_to(
        np.stack((np.sin(angle), np.cos(angle), 0.0 * angle), -1)[:, None], (cells[0] + 1, cells[1] + 1, 3)
    )
    P = 2.54 * normals
    P[..., 2] = z
    roof = ShellNet(P, normals, thickness, 3102.75e6, 0.3, root=(cells[0], 0), connect_neighbors=False)

    def supports(i: int, k: int) -> Any:
        if i == cells[0]:
            return ((Revolute, Z),)
        if i == 0:
            return ((Planar, X),) if k else ((Translational, Y),)
        return None if k else ((Planar, Z),)

    roof.build(supports)
    force = Input(name="force", unit="N")
    roof.mechanism.force("force", PointForce(magnitude=Product(force, -0.25), axis="y"), roof.bodies[0, 0])
    roof.mechanism.output("y", roof.bodies[0, 0].position("y"))
    return roof.mechanism

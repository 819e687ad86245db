"""Flexible sheet (Bae and Cho): nodal bodies on geodesic joints under plate elements, held by one edge.

The default is the paper's example: 300 x 210 x 0.3 mm, one 210 mm edge clamped, released flat under its weight. The
sheet lies in the x-z plane, its normal along y; the held edge is x = ``length``, the free edge opposite passes through
x = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import (
    Body,
    Box,
    Input,
    Mechanism,
    PointForce,
    Product,
    Revolute,
    Sensor,
    Step,
    Translational,
    Weld,
)
from mbfmu.modeling import Model, parameter
from mbfmu.sheets import Support, add_sheet
from mbfmu.sheets.sheet_handle import Sheet as SheetHandle
from mbfmu.util.errors import UserError

RELEASE_DATA = Path(__file__).with_name("release.csv")  # the default, by a shell code
RELEASE_DOUBT = 0.05e-3  # m; by how much two shell codes differ at rest
FIELDS = tuple(
    f"{kind}.{component}"
    for kind in ("curvature", "moment", "strain", "force", "stress_top", "stress_bottom")
    for component in ("xx", "zz", "xz")
)
SUPPORT_BY_CHOICE = {
    "clamped": "clamped",
    "moved": "clamped",
    "turned": "clamped",
    "pinned": "pinned",
    "two_edges": "pinned",
}


@dataclass(frozen=True, kw_only=True)
class Sheet(Model):
    """Flexible sheet held by an edge, or free."""

    name = "sheet"
    stop_time = 0.5
    output_interval = 0.005
    tolerance = 1e-5
    settling = MappingProxyType({"damping": 0.02})
    effects = MappingProxyType(
        {
            "gravity": {"gravity_y": -9.81},
            "membrane": {"membrane": True},
            "stretch": {"stretch": True},
            "damping": {"damping": 0.002},
            "drag": {"drag": 1.4},
            "pressure": {"pressure": 0.5},
        }
    )

    length: float = parameter(
        0.3, unit="m", min=1e-4, doc="Length of the sheet along x, from the free edge to the supported edge"
    )
    width: float = parameter(0.21, unit="m", min=1e-4, doc="Width of the sheet along z")
    thickness: float = parameter(0.3e-3, unit="m", min=1e-7, doc="Thickness of the sheet")
    youngs_modulus: float = parameter(
        1e10, unit="Pa", min=1.0, doc="Young's modulus; in grain direction if the material is orthotropic"
    )
    poisson: float = parameter(
        0.3, min=-0.99, max=0.5, doc="Poisson's ratio; contraction across the grain for tension in grain direction"
    )
    youngs_modulus_cross: float = parameter(
        0.0, unit="Pa", min=0.0, doc="Optional effect: Young's modulus across the grain; 0: isotropic"
    )
    shear_modulus: float = parameter(
        0.0, unit="Pa", min=0.0, doc="Optional effect: in-plane shear modulus; 0: computed from the other constants"
    )
    angle: float = parameter(0.0, unit="rad", doc="Angle of the grain from x towards z")
    density: float = parameter(1000.0, unit="kg/m3", min=1e-3, doc="Density of the sheet")
    nx: int = parameter(15, min=2, max=400, structural=True, resolution=(7, 10, 15), doc="Number of nodes along x")
    nz: int = parameter(11, min=2, max=400, structural=True, resolution=(5, 7, 11), doc="Number of nodes along z")
    tree: str = parameter(
        "spine",
        choices=("spine", "rows", "master"),
        doc="Topology of the joints between nodes; not used with stretch",
    )
    support: str = parameter(
        "clamped",
        choices=("clamped", "pinned", "moved", "turned", "two_edges", "all_edges", "free", "rails"),
        doc="Support of the edge x = length; moved: clamped, moved by inputs; turned: moved and rotated by inputs; "
        "two_edges: it and "
        "x = 0 are hinged; all_edges: all four are hinged; rails: z = 0 and z = width are clamped, requires stretch",
    )
    shear: float = parameter(0.0, unit="m", doc="Displacement of the rail at z = width along x, from the start on")
    shear_time: float = parameter(0.15, unit="s", min=1e-6, doc="Duration of the displacement of the rail")
    slide: bool = parameter(True, structural=True, doc="Hinged edges may slide in the plane; false requires stretch")
    held_part: float = parameter(1.0, min=0.0, max=1.0, doc="Supported part of the edge, about its middle")
    start_velocity: float = parameter(0.0, unit="m/s", doc="Initial velocity of a free sheet along y")
    start_spin: float = parameter(
        0.0, unit="rad/s", doc="Initial angular velocity of a free sheet about x, and half of it about z"
    )
    gravity_x: float = parameter(
        0.0, unit="m/s2", doc="Acceleration of gravity along x; start value of the input gravity.x"
    )
    gravity_y: float = parameter(
        -9.81, unit="m/s2", doc="Acceleration of gravity along y; start value of the input gravity.y"
    )
    gravity_z: float = parameter(
        0.0, unit="m/s2", doc="Acceleration of gravity along z; start value of the input gravity.z"
    )
    membrane: bool = parameter(True, structural=True, doc="Optional effect: membrane stiffness (stretching and shear)")
    stretch: bool = parameter(
        False,
        structural=True,
        doc="Optional effect: in-plane deformation by shell elements; requires an implicit solver",
    )
    curl_x: float = parameter(0.0, unit="1/m", doc="Optional effect: natural curvature along x, positive in y")
    curl_z: float = parameter(0.0, unit="1/m", doc="Optional effect: natural curvature along z, positive in y")
    damping: float = parameter(
        0.0, unit="s", min=0.0, doc="Optional effect: material damping time, stress = K (e + damping e')"
    )
    drag: float = parameter(0.0, unit="kg/m3", min=0.0, doc="Optional effect: air density times drag coefficient")
    pressure: float = parameter(
        0.0,
        unit="Pa",
        doc="Optional effect: pressure on the sheet along its normal; 0: no pressure",
        tunable=True,
        optional=True,
    )
    load: str = parameter(
        "none",
        choices=("none", "tip", "free_edge", "middle"),
        structural=True,
        doc="Optional effect: point of application of a force set by inputs, in global axes; distributed along an edge",
    )
    grid_outputs: bool = parameter(False, structural=True, doc="Outputs of the positions of all nodes")
    field: str = parameter(
        "none",
        choices=("none", *FIELDS),
        doc="Field with an output for every element, shown as the color of the sheet; strain, force (per "
        "length) and stress require stretch",
    )

    def build(self) -> Mechanism:
        """Return the mechanism: the flat sheet in y = 0, z from 0 to the width."""
        m = Mechanism(gravity=[self._gravity(axis) for axis in "xyz"])
        edge = None if self.support in ("all_edges", "free") else self._edge(m)
        supports, tree, master = [], self.tree, None
        hinged = "supported" if self.slide else "pinned"
        for key, wrong in (("slide", not self.slide), ("support", self.support == "rails")):
            if wrong and not self.stretch:
                given = getattr(self, key)
                raise UserError(
                    f"{key} is {given!r}, which a sheet that cannot stretch does not bear; allowed: with stretch"
                )
        if edge is None:
            tree = tree if self.stretch else "master"
            if self.support == "all_edges":
                supports = [Support(name, hinged) for name in ("x0", "x1", "z0", "z1")]
                if self.slide:
                    master = m.body("lift", m.ground, Translational(axis="y"))  # the middle may not drift in the plane
        elif self.support == "rails":
            supports = self._rails(m, edge)
        else:
            half = 0.5 * self.held_part * self.width
            span = (0.5 * self.width - half, 0.5 * self.width + half)
            at = (-self.length, 0.0, -0.5 * self.width)
            supports = [Support("x1", SUPPORT_BY_CHOICE[self.support], span=span, body=edge, at=at)]
            if self.support == "two_edges":
                supports.append(Support("x0", hinged))
            m.shape(edge, Box(size=(0.02 * self.length, 0.01 * self.length, self.held_part * self.width)))
        sheet = add_sheet(
            m,
            "sheet",
            length=self.length,
            width=self.width,
            thickness=self.thickness,
            youngs_modulus=self._moduli(),
            poisson=self.poisson,
            shear_modulus=self.shear_modulus or None,
            angle=self.angle,
            curl=(self.curl_x, self.curl_z),
            density=self.density,
            grid=(self.nx, self.nz),
            tree=tree,
            supports=supports,
            master=master,
            membrane=self.membrane,
            stretch=self.stretch,
            damping=self.damping,
            drag=self.drag,
            pressure=self.pressure,
            rate=self._rate() if self.support == "free" else None,
        )
        if self.load != "none":
            self._load(m, sheet)
        m.surface("sheet", sheet.nodes, field=self._field)
        self._outputs(m, sheet, edge)
        return m

    def arrays(self) -> dict[str, Sequence[Any]]:
        """Return the heights of the free edge, and positions of all nodes and a field of all cells where there are."""
        rows, columns = range(self.nx), range(self.nz)
        found: dict[str, Sequence[Any]] = {"free_edge.y": [f"free_edge[{k}].y" for k in columns]}
        if self.grid_outputs:
            found["node.position"] = [[[f"node[{i},{k}].{axis}" for axis in "xyz"] for k in columns] for i in rows]
        if self._field:
            found[self.field] = [[f"{self.field}[{i},{k}]" for k in columns[:-1]] for i in rows[:-1]]
        return found

    def independent(self, times: NDArray[np.float64]) -> dict[str, tuple[NDArray[np.float64], float]] | None:
        """Return the tip by a shell code; None except for the default sheet at ``times`` within the data."""
        default = replace(Sheet(), nx=self.nx, nz=self.nz, tree=self.tree)
        if self != replace(default, grid_outputs=self.grid_outputs, field=self.field):
            return None
        table = np.genfromtxt(RELEASE_DATA, delimiter=",", names=True)
        rows = np.searchsorted(table["t_s"], times - 1e-9)
        if rows[-1] == len(table) or np.abs(table["t_s"][rows] - times).max() > 1e-9:
            return None
        return {f"tip.{axis}": (table[f"{axis}_shell_m"][rows], RELEASE_DOUBT) for axis in "xy"}

    @property
    def _field(self) -> str:
        """Name of the field that is output; empty: none."""
        return "" if self.field == "none" else self.field

    def _gravity(self, axis: str) -> Input:
        """Return the input that sets one component of gravity."""
        start = getattr(self, f"gravity_{axis}")
        return Input(
            name=f"gravity.{axis}", unit="m/s2", description=f"Acceleration of gravity along {axis}", start=start
        )

    def _moduli(self) -> float | tuple[float, float]:
        """Return Young's modulus, or those along and across the grain."""
        cross = self.youngs_modulus_cross
        return (self.youngs_modulus, cross) if cross else self.youngs_modulus

    def _rate(self) -> tuple[float, ...]:
        """Return the velocity of the master node of a free sheet."""
        return (0.0, self.start_velocity, 0.0, self.start_spin, 0.0, 0.5 * self.start_spin)

    def _edge(self, m: Mechanism) -> Body:
        """Return the body that holds the edge, in its middle: fixed, or moved by inputs, and turned; or that slides."""
        middle = (self.length, 0.0, 0.5 * self.width)
        if self.support == "rails":
            slides = Step(height=self.shear, duration=self.shear_time)
            middle = (0.5 * self.length, 0.0, self.width)
            return m.body("rail", m.ground, Translational(at=middle, axis="x", drive=slides))
        if self.support not in ("moved", "turned"):
            return m.body("edge", m.ground, Weld(at=middle))
        body = m.body("stand", m.ground, Weld(at=middle))
        for axis in "xyz":
            motion = Input(
                name=f"edge.{axis}",
                unit="m",
                description=f"Displacement of the supported edge along {axis}",
                rate_name=f"edge.v{axis}",
            )
            last = axis == "z" and self.support == "moved"
            body = m.body("edge" if last else f"edge_{axis}", body, Translational(axis=axis, drive=motion))
        if self.support == "turned":
            turn = Input(
                name="edge.angle",
                unit="rad",
                description="Rotation angle of the supported edge about itself",
                rate_name="edge.omega",
            )
            body = m.body("edge", body, Revolute(drive=turn))
        return body

    def _rails(self, m: Mechanism, rail: Body) -> list[Support]:
        """Return what clamps the sheet between a fixed rail and one that slides."""
        stand = m.body("stand", m.ground, Weld(at=(0.5 * self.length, 0.0, 0.0)))
        step = self.length / (self.nx - 1)
        size = (step, 0.02 * self.width, 0.04 * self.width)  # pieces: pictures paint whole things, the far ones first
        for body in (stand, rail):
            m.shape(
                body, *(Box(size=size, at=((k + 0.5) * step - 0.5 * self.length, 0, 0)) for k in range(self.nx - 1))
            )
        at = (-0.5 * self.length, 0.0, 0.0)
        return [Support("z0", body=stand, at=at), Support("z1", body=rail, at=(*at[:2], -self.width))]

    def _load(self, m: Mechanism, sheet: SheetHandle) -> None:
        """Let inputs pull at a node, or along the free edge, each of its nodes by the length that is its own."""
        middle = self.nz // 2
        shares = {sheet.node(self.nx // 2 if self.load == "middle" else 0, middle): 1.0}
        if self.load == "free_edge":
            ends = (0, self.nz - 1)
            shares = {sheet.node(0, k): (0.5 if k in ends else 1.0) / (self.nz - 1) for k in range(self.nz)}
        for axis in "xyz":
            force = Input(name=f"force.{axis}", unit="N", description=f"Force on the sheet along {axis}")
            for node, share in shares.items():
                part = force if share == 1.0 else Product(force, share)
                m.force(f"force.{axis}.{node.name}", PointForce(magnitude=part, axis=axis), node)

    def _outputs(self, m: Mechanism, sheet: SheetHandle, edge: Body | None) -> None:
        """Publish tip, corners, free edge, energies, the support's reaction, and on request every node and a field."""
        points = {"tip": sheet.node(0, self.nz // 2), "corner1": sheet.node(0, 0), "corner2": sheet.node(0, -1)}
        for name, node in points.items():
            for axis in "xyz":
                m.output(f"{name}.{axis}", node.position(axis), f"Position of the {name} of the free edge")
        if self.support in ("two_edges", "all_edges", "rails"):
            middle = sheet.node(self.nx // 2, self.nz // 2)
            for axis in "xyz":
                m.output(f"middle.{axis}", middle.position(axis), "Position of the middle of the sheet")
        m.output("tip.velocity.y", points["tip"].velocity("y"), "Velocity of the tip")
        for k in range(self.nz):
            m.output(f"free_edge[{k}].y", sheet.node(0, k).position("y"), f"Height of node {k} of the free edge")
        if edge is not None:
            for axis in "xyz":
                m.output(f"reaction.{axis}", edge.joint_force(axis), "Force of the support on the sheet")
        m.output("energy", m.energy, "Kinetic and potential energy")
        m.output("kinetic_energy", m.kinetic_energy, "Kinetic energy")
        m.output("potential_energy", m.potential_energy, "Potential energy of weight and deformation")
        if self.grid_outputs:
            for i in range(self.nx):
                for k in range(self.nz):
                    for axis in "xyz":
                        m.output(f"node[{i},{k}].{axis}", sheet.node(i, k).position(axis), f"Position of node {i}, {k}")
        if self._field:
            for i in range(self.nx - 1):
                for k in range(self.nz - 1):
                    felt = self._field_sensor(sheet, (i + 0.5) * sheet.a, (k + 0.5) * sheet.b)
                    m.output(f"{self.field}[{i},{k}]", felt, f"{self.field} in the middle of element {i}, {k}")

    def _field_sensor(self, sheet: SheetHandle, x: float, z: float) -> Sensor:
        """Return the sensor of the field at a place of the flat sheet."""
        kind, component = self.field.split(".")
        if kind.startswith("stress"):
            return sheet.stress(component, x, z, face=kind.removeprefix("stress_"))
        felt = {
            "curvature": sheet.curvature,
            "moment": sheet.moment,
            "strain": sheet.strain,
            "force": sheet.force_per_length,
        }
        return felt[kind](component, x, z)

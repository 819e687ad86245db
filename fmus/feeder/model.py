"""Feeder: a sheet of paper that pairs of rollers drive through guides.

The feed is along x, y is up, and z from -``width`` / 2 on the left to ``width`` / 2 on the right. A line of nips is a
left and a right roller below the sheet, each with an idler above; line 1 is at the origin, and lines follow each other
at ``spacing`` along the path (:mod:`.path`). The sheet starts flat, its leading edge ``lead`` behind line 1, at the
speed of the rollers there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, cos, sin
from types import MappingProxyType
from typing import Any

from mbfmu.mechanics import Body, Input, JointSpring, Mechanism, Product, Revolute, SpeedInput, cylinder
from mbfmu.modeling import Model, parameter
from mbfmu.sheets import (
    NipHandle,
    Surface,
    SurfaceContactHandle,
    Wall,
    add_contact,
    add_nip,
    add_sheet,
    contact_pressure,
    jammed,
)
from mbfmu.sheets import Sheet as SheetHandle
from mbfmu.util.errors import UserError

from .guides import chute, guide_surface
from .path import Path, lay_out

SIDES = ("left", "right")  # at z < 0 and z > 0
BEND_MARGIN = 5e-3  # m, between a line of nips and a bend
MAX_CELL_RADIUS_RATIO = 0.6  # side of a cell in parts of a bend's inner radius
# of the thickness, that a leading edge which bends the sheet to a sixth of its length sinks into a guide
EDGE_PENETRATION_RATIO = 0.25
CONTACT_POINTS = (4, 2)  # of a cell that touch; a sheet in a feeder bends one way, along the first
GUIDE_WIDTH_RATIO = 1.2  # widths of the sheet: width of the guides


@dataclass(frozen=True, kw_only=True)
class Feeder(Model):
    """Sheet of paper through nips and guides."""

    name = "feeder"
    stop_time = 1.0
    output_interval = 0.005
    tolerance = 1e-4
    default_solver = "esdirk"  # ida costs half of it, but four times as much where a host sets speeds at every step
    viewing = MappingProxyType({"field": "pressure"})
    effects = MappingProxyType(
        {
            "gravity": {"gravity_y": -9.81},
            "friction": {"mu_guide": 0.2},
            "drag": {"drag": 1.4},
            "membrane": {"membrane": True},
            "damping": {"damping": 5e-4},
            "guides": {"guides": True},
            "misalignment": {"misalignment": 0.02},
            "idler_inertia": {"idler_mass": 0.02},
            "curl": {"curl": 2.0},
            "stick": {"deflection": 1e-5},
        }
    )

    length: float = parameter(0.297, unit="m", min=1e-3, doc="Length of the sheet in feed direction")
    width: float = parameter(0.21, unit="m", min=1e-3, doc="Width of the sheet")
    thickness: float = parameter(1e-4, unit="m", min=1e-6, doc="Thickness of the sheet")
    youngs_modulus: float = parameter(4e9, unit="Pa", min=1.0, doc="Young's modulus of the sheet")
    poisson: float = parameter(0.3, min=-0.99, max=0.5, doc="Poisson's ratio of the sheet")
    density: float = parameter(800.0, unit="kg/m3", min=1e-3, doc="Density of the sheet")
    nx: int = parameter(
        15, min=3, max=400, structural=True, resolution=(15, 22, 29), doc="Number of nodes in feed direction"
    )
    nz: int = parameter(
        11, min=3, max=400, structural=True, resolution=(11, 16, 21), doc="Number of nodes across the feed direction"
    )
    path: str = parameter(
        "s_bend",
        choices=("straight", "s_bend", "turn", "chute"),
        doc="Path of the sheet; s_bend: two opposite arcs between lines 1 and 2; turn: one arc; "
        "chute: an inclined guide after the last line",
    )
    nips: int = parameter(2, min=1, max=4, structural=True, doc="Number of lines of roller nips")
    spacing: float = parameter(0.12, unit="m", min=1e-3, doc="Distance between lines along the path")
    nip_width: float = parameter(0.02, unit="m", min=1e-4, doc="Width of each nip across the feed direction")
    nip_distance: float = parameter(
        0.1, unit="m", min=1e-3, doc="Distance between the left and the right nip of a line"
    )
    radius: float = parameter(0.01, unit="m", min=1e-4, doc="Radius of the rollers")
    roller_mass: float = parameter(0.05, unit="kg", min=1e-6, doc="Mass of each roller, a solid cylinder")
    speed: float = parameter(
        0.5,
        unit="m/s",
        min=-10.0,
        max=10.0,
        doc="Initial speed of the sheet and of line 1; start value of the roller speeds",
    )
    speed_ratio: float = parameter(
        1.0, min=0.1, max=10.0, doc="Ratio of the speed of each line to that of the previous line"
    )
    speed_difference: float = parameter(
        0.0, min=-1.0, max=1.0, doc="Difference of right and left roller speed, relative to their mean"
    )
    nip_force: float = parameter(
        4.0, unit="N", min=0.0, doc="Normal force of a line, half on each side; start value of the inputs"
    )
    uneven: float = parameter(0.0, min=-1.0, max=1.0, doc="Relative increase of the nip pressure towards its right end")
    misalignment: float = parameter(
        0.0,
        unit="rad",
        min=-0.5,
        max=0.5,
        doc="Optional effect: misalignment angle of the rollers of line 1, positive to the right",
    )
    idler_mass: float = parameter(
        0.0, unit="kg", min=0.0, structural=True,
        doc="Optional effect: mass of each idler, a freely rotating cylinder of the size of its "
        "roller; 0: no inertia",
    )  # fmt: skip
    idler_drag: float = parameter(
        0.0, unit="N.m.s/rad", min=0.0, doc="Coefficient of the bearing friction of an idler with mass"
    )
    mu_idler: float = parameter(
        0.3, min=0.0, max=10.0, doc="Friction coefficient of the idlers; sideways only if they have no mass"
    )
    mu_roller: float = parameter(1.0, min=0.0, max=10.0, doc="Friction coefficient of the rollers")
    creep: float = parameter(
        2e-3, min=0.0, max=1.0, doc="Relative slip at which 70 % of the friction limit is transmitted; 1 mm/s at rest"
    )
    deflection: float = parameter(
        0.0,
        unit="m",
        min=0.0,
        structural=True,
        doc="Optional effect: displacement of the sheet under the friction limit before it slides, on guides and on "
        "rollers at rest; 0: friction is a function of the slip velocity",
    )
    static_ratio: float = parameter(
        1.0, min=1.0, max=10.0, doc="Ratio of static friction to friction of sliding; above 1 it requires a deflection"
    )
    stribeck: float = parameter(
        0.01, unit="m/s", min=1e-9, doc="Slip velocity at which static friction decreases to that of sliding"
    )
    mu_guide: float = parameter(
        0.2, min=0.0, max=10.0, doc="Optional effect: friction coefficient of guides and wall; 0: no friction"
    )
    guides: bool = parameter(True, structural=True, doc="Optional effect: guide plates above and below the sheet")
    guide_damping: float = parameter(
        5.0,
        unit="s/m",
        min=0.0,
        doc="Damping of guides and wall: an impact at v loses the part (4/3) guide_damping v of its energy",
    )
    clearance: float = parameter(5e-4, unit="m", min=1e-6, doc="Clearance between each face of the sheet and its guide")
    bend_radius: float = parameter(0.04, unit="m", min=1e-3, doc="Radius of the path in a bend")
    bend_angle: float = parameter(0.7854, unit="rad", min=0.01, max=3.0, doc="Angle of each arc")
    chute_angle: float = parameter(
        0.5, unit="rad", min=-1.4, max=1.4, doc="Angle of the chute after the last line, positive upward"
    )
    chute_distance: float = parameter(0.02, unit="m", min=1e-3, doc="Distance from the last line to the chute")
    lead: float = parameter(
        0.01, unit="m", min=0.0, doc="Initial distance of the leading edge from line 1, in feed direction"
    )
    stop_at: float = parameter(
        0.0, unit="m", min=0.0, doc="Distance of a wall across the path from line 1; 0: no wall", structural=True
    )
    sensor_distance: float = parameter(0.03, unit="m", min=0.0, doc="Distance from each line to its two sheet sensors")
    sensor_spread: float = parameter(0.1, unit="m", min=1e-3, doc="Distance between the left and the right sensor")
    gravity_y: float = parameter(
        -9.81, unit="m/s2", doc="Acceleration of gravity along y; start value of the input gravity.y"
    )
    membrane: bool = parameter(True, structural=True, doc="Optional effect: membrane stiffness (stretching and shear)")
    damping: float = parameter(5e-4, unit="s", min=0.0, doc="Optional effect: material damping time of the sheet")
    drag: float = parameter(0.0, unit="kg/m3", min=0.0, doc="Optional effect: air density times drag coefficient")
    curl: float = parameter(
        0.0, unit="1/m", doc="Optional effect: natural curvature in feed direction, positive upward"
    )
    field: str = parameter(
        "none",
        choices=("none", "pressure"),
        doc="Field with an output for every element, shown as the color of the sheet; "
        "pressure: contact pressure of guides and wall",
    )

    def build(self) -> Mechanism:
        """Return the mechanism."""
        self._check_options()
        route = self.route()
        weight = Input(
            name="gravity.y", unit="m/s2", description="Acceleration of gravity along y", start=self.gravity_y
        )
        m = Mechanism(gravity=[0.0, weight, 0.0])
        sheet = add_sheet(
            m,
            "sheet",
            length=self.length,
            width=self.width,
            thickness=self.thickness,
            youngs_modulus=self.youngs_modulus,
            poisson=self.poisson,
            density=self.density,
            grid=(self.nx, self.nz),
            tree="master",
            membrane=self.membrane,
            damping=self.damping,
            drag=self.drag,
            curl=(self.curl, 0.0),
            at=(self.lead - self.length, 0.0, -0.5 * self.width),
            rate=(self.speed, 0.0, 0.0, 0.0, 0.0, 0.0),
        )
        m.surface("sheet", sheet.nodes, field=self._field)
        self._outputs(m, sheet)
        nips = [nip for line in range(self.nips) for nip in self._line(m, sheet, route, line)]
        m.output("jam", jammed(nips), "Jam indicator: 1 while a loaded nip slips by more than half its surface speed")
        contacts = self._guide(m, sheet, route) if self.guides else []
        if self.stop_at:
            stop = Wall(**self._across(route, self.stop_at))
            contacts.append(self._contact(m, sheet, "stop", stop, self._hardness(sheet)))
        if self._field:
            for i, k in sheet.cells:
                felt = contact_pressure(contacts, i, k)
                m.output(f"{self._field}[{i},{k}]", felt, f"Contact pressure of guides and wall on element {i}, {k}")
        m.output("energy", m.energy, "Kinetic and potential energy")
        m.output("kinetic_energy", m.kinetic_energy, "Kinetic energy")
        m.output("potential_energy", m.potential_energy, "Potential energy of weight, deformation and contact")
        return m

    def arrays(self) -> dict[str, Sequence[Any]]:
        """Return a field of all cells where there is one."""
        if not self._field:
            return {}
        return {self._field: [[f"{self._field}[{i},{k}]" for k in range(self.nz - 1)] for i in range(self.nx - 1)]}

    def terminals(self) -> dict[str, Sequence[str]]:
        """Return every roller."""
        names = [f"roller[{line + 1}].{side}" for line in range(self.nips) for side in SIDES]
        return {name: (f"{name}.speed", f"{name}.torque") for name in names}

    @property
    def _field(self) -> str:
        """Name of the field that is output; empty: none, or there is no surface."""
        return "" if self.field == "none" or not (self.guides or self.stop_at) else self.field

    def route(self) -> Path:
        """Return the path, long enough for the sheet before line 1 and behind the last line."""
        before, after = self.length, 1.3 * self.length
        rest = (self.nips - 2) * self.spacing + after  # behind line 2
        if self.path == "chute":
            return lay_out(before, [(self.nips - 1) * self.spacing + self.chute_distance])
        if self.path == "straight":
            return lay_out(before, [(self.nips - 1) * self.spacing + after])
        turns = [self.bend_angle, -self.bend_angle] if self.path == "s_bend" else [self.bend_angle]
        gap = 0.5 * (self.spacing - self._bent())
        return lay_out(before, [gap, *((self.bend_radius, turn) for turn in turns), gap + rest])

    def _bent(self) -> float:
        """Return the length of the arcs between lines 1 and 2, m."""
        return {"s_bend": 2.0, "turn": 1.0}.get(self.path, 0.0) * self.bend_radius * self.bend_angle

    def _check_options(self) -> None:
        """Refuse what does not go together, with what would."""
        bends = self.path in ("s_bend", "turn")
        if bends and self.nips < 2:
            raise UserError(f"nips is {self.nips}; allowed with path {self.path!r}: 2 to 4, it bends between two lines")
        if bends and self.spacing < self._bent() + 2.0 * BEND_MARGIN:
            raise UserError(
                f"spacing is {self.spacing:g} m; allowed: at least {self._bent() + 2.0 * BEND_MARGIN:.4g} m, "
                "for the arcs "
                f"between lines 1 and 2"
            )
        inner = self.bend_radius - self.clearance - 0.5 * self.thickness
        side = max(self.length / (self.nx - 1), self.width / (self.nz - 1))
        if bends and side > MAX_CELL_RADIUS_RATIO * inner:
            least = side / MAX_CELL_RADIUS_RATIO + self.clearance + 0.5 * self.thickness
            counts = [
                ceil(size / (MAX_CELL_RADIUS_RATIO * inner)) + 1 if inner > 0.0 else 0
                for size in (self.length, self.width)
            ]
            finer = f", or nx {counts[0]} and nz {counts[1]} at least" if inner > 0.0 else ""
            raise UserError(
                f"bend_radius is {self.bend_radius:g} m; allowed with cells of {side:.3g} m: {least:.3g} m at "
                f"least{finer}"
            )
        if self.idler_drag and not self.idler_mass:
            raise UserError(f"idler_drag is {self.idler_drag:g} N m s/rad; allowed where idler_mass is 0: 0")
        if self.nip_distance < self.nip_width:
            raise UserError(f"nip_distance is {self.nip_distance:g} m; allowed: at least nip_width, {self.nip_width:g}")
        if self.nip_distance - self.nip_width >= self.width:
            raise UserError(
                f"nip_distance is {self.nip_distance:g} m; allowed: below {self.width + self.nip_width:g} m, where "
                "nips meet the sheet"
            )
        if self.nips > 1 and self.spacing < 2.0 * self.radius:
            raise UserError(f"spacing is {self.spacing:g} m; allowed: twice radius at least, {2.0 * self.radius:g} m")
        if self.lead > 0.5 * self.length:
            raise UserError(f"lead is {self.lead:g} m; allowed: at most half the sheet, {0.5 * self.length:g} m")
        if self.guides and bends and self.lead > 0.5 * (self.spacing - self._bent()):
            raise UserError(
                f"lead is {self.lead:g} m; allowed: at most {0.5 * (self.spacing - self._bent()):.3g} m, where the "
                "path bends and a flat sheet would be in the guide"
            )
        if self.stop_at and not self.lead + self.thickness < self.stop_at <= self.route().length:
            raise UserError(
                f"stop_at is {self.stop_at:g} m; allowed: 0 (none), or more than lead, {self.lead:g} m, up to the end "
                f"of the path, {self.route().length:.3g} m"
            )

    def _across(self, route: Path, distance: float) -> dict[str, Any]:
        """Return place and normal of what stands across the path."""
        (x, y), angle = route.at(distance)
        return {"at": (x, y, 0.0), "normal": (-cos(angle), -sin(angle), 0.0)}

    def _line(self, m: Mechanism, sheet: SheetHandle, route: Path, line: int) -> list[NipHandle]:
        """Add a line of nips, its outputs and its sensors."""
        (x, y), angle = route.at(line * self.spacing)
        askew = self.misalignment if line == 0 else 0.0
        normal = (-sin(angle), cos(angle), 0.0)
        feed = (cos(askew) * cos(angle), cos(askew) * sin(angle), sin(askew))
        axis = (sin(askew) * cos(angle), sin(askew) * sin(angle), -cos(askew))  # normal x feed: positive feeds
        label = f"nip[{line + 1}]"
        force = Input(
            name=f"{label}.force",
            unit="N",
            description=f"Normal force of the idlers of line {line + 1}, half each; negative values count as zero",
            start=self.nip_force,
        )
        found = []
        for side, hand in zip(SIDES, (-1.0, 1.0), strict=True):
            z = 0.5 * hand * self.nip_distance
            roller = self._roller(m, f"roller[{line + 1}].{side}", (x, y, z), normal, axis, line, hand)
            idler = self._idler(m, f"idler[{line + 1}].{side}", (x, y, z), normal, axis, line)
            nip = add_nip(
                m,
                f"{label}.{side}",
                sheet,
                roller,
                radius=self.radius,
                at=(x, y, z),
                width=self.nip_width,
                force=Product(force, 0.5),
                feed=feed,
                normal=normal,
                uneven=self.uneven,
                friction=self.mu_roller,
                idler_friction=self.mu_idler,
                creep=self.creep,
                deflection=self.deflection or None,
                static=self._static(self.mu_roller),
                idler_static=self._static(self.mu_idler),
                stribeck=self.stribeck,
                idler=idler,
            )
            found.append(nip)
            for told, sensor, meaning in (
                ("slip", nip.slip(), "speed of the sheet less that of the roller"),
                ("traction", nip.traction(), "with which the sheet pulls at the roller"),
                ("lateral", nip.lateral(), "force on the sheet across the feed"),
                ("normal", nip.normal(), "force that holds the sheet in the plane of the nip"),
                ("heat", nip.heat(), "power of friction and damping in the nip, lost"),
                ("loaded", nip.loaded(), "part of the nip in which the sheet is"),
            ):
                m.output(f"{label}.{side}.{told}", sensor, meaning)
            (p, q), lean = route.at(line * self.spacing + self.sensor_distance)
            beam = sheet.covers((p, q, 0.5 * hand * self.sensor_spread), (-sin(lean), cos(lean), 0.0))
            m.output(
                f"sensor[{line + 1}].{side}.covered", beam, "Sheet sensor: 1 if the sheet covers its beam, otherwise 0"
            )
        return found

    def _roller(
        self, m: Mechanism, name: str, at: tuple[float, ...], normal: Any, axis: Any, line: int, hand: float
    ) -> Body:
        """Add a driven roller below the path, and its torque."""
        speed = SpeedInput(
            name=f"{name}.speed",
            unit="rad/s",
            description="Speed of the roller, positive in feed direction",
            start=self.speed * self.speed_ratio**line * (1.0 + 0.5 * hand * self.speed_difference) / self.radius,
        )
        middle = tuple(p - self.radius * n for p, n in zip(at, normal, strict=True))
        mass = cylinder(mass=self.roller_mass, radius=self.radius, length=self.nip_width, axis=axis)
        roller = m.body(name, m.ground, Revolute(at=middle, axis=axis, drive=speed), **mass)
        m.output(f"{name}.torque", roller.effort(), "Torque of the drive")
        return roller

    def _idler(self, m: Mechanism, name: str, at: tuple[float, ...], normal: Any, axis: Any, line: int) -> Body | None:
        """Add an idler above the path, which turns as the sheet there should, and its speed; None: it has no mass."""
        if not self.idler_mass:
            return None
        middle = tuple(p + self.radius * n for p, n in zip(at, normal, strict=True))
        mass = cylinder(mass=self.idler_mass, radius=self.radius, length=self.nip_width, axis=axis)
        axle = Revolute(at=middle, axis=[-x for x in axis], rate=self.speed * self.speed_ratio**line / self.radius)
        idler = m.body(name, m.ground, axle, **mass)
        if self.idler_drag:
            m.force(f"{name}.drag", JointSpring(stiffness=0.0, damping=self.idler_drag), idler)
        m.output(f"{name}.speed", idler.rate(), "Speed of the idler, positive in feed direction")
        return idler

    def _guide(self, m: Mechanism, sheet: SheetHandle, route: Path) -> list[SurfaceContactHandle]:
        """Add what is above and below each part of the path."""
        off, wide = self.clearance + 0.5 * self.thickness, GUIDE_WIDTH_RATIO * self.width
        surfaces: dict[str, Surface] = {
            f"{name}[{number}]": guide_surface(part, hand, off, wide)
            for number, part in enumerate(route.parts, 1)
            for name, hand in (("lower", -1.0), ("upper", 1.0))
        }
        if self.path == "chute":
            surfaces["chute"] = chute(route, self.chute_angle, self.length, off, wide)
        return [self._contact(m, sheet, name, surface) for name, surface in surfaces.items()]

    def _static(self, friction: float) -> float:
        """Return the coefficient of static friction where this is that of sliding."""
        return self.static_ratio * friction

    def _contact(
        self, m: Mechanism, sheet: SheetHandle, name: str, surface: Surface, stiffness: float | None = None
    ) -> SurfaceContactHandle:
        """Add contact of the sheet with a surface, and the outputs of its force."""
        if stiffness is None:  # that of a contact by itself goes with the longer of the two spacings
            bent = float(sheet.plate.bending[0, 0]) * (6.0 / self.length) ** 2
            stiffness = bent / (sheet.a / CONTACT_POINTS[0] * EDGE_PENETRATION_RATIO * self.thickness)
        contact = add_contact(
            m,
            name,
            sheet,
            surface,
            friction=self.mu_guide,
            deflection=self.deflection or None,
            static=self._static(self.mu_guide),
            stribeck=self.stribeck,
            stiffness=stiffness,
            damping=self.guide_damping,
            points=CONTACT_POINTS,
        )
        for axis in "xyz":
            m.output(f"{name}.force.{axis}", contact.force(axis), "Force of this surface on the sheet")
        m.output(f"{name}.heat", contact.heat(), "Power loss by friction and impacts")
        return contact

    def _hardness(self, sheet: SheetHandle) -> float | None:
        """Return the pressure for the depth of the stop, N/m^3: a line of nips pushes an edge in by its thickness.

        An edge has half a row of points, which are a quarter of a cell apart. What a contact takes by itself is for a
        sheet that is pressed on as it bends, and a hundredth of that.
        """
        push = self.mu_roller * self.nip_force
        return push / (self.width * 0.125 * sheet.a * self.thickness) if push > 0.0 else None

    def _outputs(self, m: Mechanism, sheet: SheetHandle) -> None:
        """Publish where the edges are."""
        for name, edge, row in (("lead", "x1", -1), ("trail", "x0", 0)):
            for axis in "xyz":
                m.output(
                    f"{name}.{axis}", sheet.edge(edge).position(axis), f"Position of the middle of the {name}ing edge"
                )
                for side, k in zip(SIDES, (0, -1), strict=True):
                    corner = sheet.node(row, k).position(axis)
                    m.output(f"{name}.{side}.{axis}", corner, f"Position of the {side} corner of the {name}ing edge")
        m.output("sheet.skew", sheet.skew(), "Skew angle of the leading edge about the normal of the sheet")
        m.show_outputs("sheet.skew")
        m.output(
            "sheet.lateral",
            sheet.point(0.5 * self.length, 0.5 * self.width).position("z"),
            "Lateral position of the middle of the sheet",
        )

"""Contact of a sheet with surfaces and nips that drive it: one load for every cell, all of one name.

Defaults go with the sheet: lengths with a sixth of its longer side, 50 mm of A4, below which paper is not bent, and
forces with what bends it so far.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import ceil
from typing import Any

import numpy as np

from mbfmu.mechanics.axes import unit_axis
from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.checks import Vector, one_of, rotation, vector
from mbfmu.mechanics.joints import Revolute
from mbfmu.mechanics.kind import check_element_type
from mbfmu.mechanics.loads.base import Load
from mbfmu.mechanics.numbers import finite, not_negative, positive
from mbfmu.util.errors import UserError, short

from .contact.nip import RollerNip
from .contact.static_friction import check_static
from .contact.surface_contact import SurfaceContact
from .contact.surfaces import Surface
from .contact_handles import NipHandle, SurfaceContactHandle
from .sheet_handle import Sheet

MAX_CELL_CURVATURE = 0.6  # side of a cell times the curvature of a surface, above which the sheet does not follow it
# Part of its thickness that a leading edge sinks into a surface if it is pressed on as the sheet bends
EDGE_PENETRATION_RATIO = 0.25
DEFAULT_DEPTH_RATIO = 0.2  # of its thickness: depth below which the pressure goes with its square
NIP_ROTATION = 1e-3  # rad, rotation of a nip under the moment that bends the sheet by this angle
MAX_STIFFNESS_RATIO = 1e9  # of the usual stiffness
MAX_POINTS = 1000  # points or stations one way
MIN_LENGTH_RATIO = 1e-6  # of the sheet's scale, of a length in the nip
MIN_ROLLER_DISTANCE_RATIO = 0.5  # of what keeps two rollers apart
AXIS_COSINE_TOLERANCE, AXIS_OFFSET_RATIO = 1e-6, 0.02  # of a roller's axis: one less a cosine; parts of its radius
ENTRY_LENGTH_RATIO = 0.4  # of the roller's radius: way over which an edge comes in
DEFAULT_DAMPING_RATIO = 0.03  # damping of a nip's rubber, to sqrt(stiffness times the sheet's mass)


def add_contact(
    mechanism: Mechanism,
    name: str,
    sheet: Sheet,
    surface: Surface,
    *,
    body: Body | None = None,
    friction: float = 0.0,
    stiffness: float | None = None,
    depth: float | None = None,
    damping: float = 1.0,
    creep: float = 1e-3,
    deflection: float | None = None,
    static: float | None = None,
    stribeck: float | None = None,
    points: tuple[int, int] = (4, 4),
) -> SurfaceContactHandle:
    """Add contact between a sheet, on both faces, and a rigid surface.

    Parameters
    ----------
    mechanism, name
        Mechanism to which the contact is added, and name of its loads.
    sheet
        Sheet of that mechanism.
    surface
        Surface, such as ``Wall(normal="y")``, in the axes of ``body``.
    body
        Body to which the surface is fixed; None: the ground.
    friction
        Coefficient of Coulomb friction; zero: none.
    stiffness, depth
        Pressure per depth, N/m^3, and the depth (m) below which the pressure is quadratic; None: defaults for the
        sheet, whose leading edge sinks in by a quarter of its thickness.
    damping
        Damping of Hunt and Crossley, s/m: an impact at velocity v loses about the fraction (4/3) damping v of its
        energy.
    creep
        Slip velocity v_r, m/s, at which friction has 70 % of its largest force mu N. A sheet that rests under a load
        F < mu N creeps at v_r F / sqrt(mu^2 N^2 - F^2): choose v_r such that this is allowed, and use ``esdirk``.
    deflection
        Displacement of a contact point under the load mu N before it slides, m: friction that sticks. A sheet at rest
        does not creep, and ``creep`` is the slip velocity at which the damping of this elasticity has the force mu N.
        None: friction is a function of the slip velocity.
    static
        Coefficient of static friction, at least ``friction``: a contact point breaks away under ``static`` times its
        normal force. It requires a ``deflection``. None: the same as ``friction``.
    stribeck
        Slip velocity vs, m/s, of the decrease from ``static`` to ``friction`` as exp(-(v / vs)^2). Required if
        ``static`` is larger than ``friction``. It should be several times ``creep``.
    points
        Numbers of contact points of every cell along x and z, without those on its last edge.

    Returns
    -------
    SurfaceContactHandle
        Handle whose sensors give force, depth, pressure and frictional heat.

    Raises
    ------
    UserError
        A value is invalid, or the cells of the sheet are too large for the curvature of the surface.
    """
    what = f"contact {name!r}"
    check_element_type(f"surface of {what}", surface, Surface)
    surface.check(f"the surface of {what}")
    _check_sheet(mechanism, sheet, what)
    plate, length = sheet.plate, _scale(sheet)
    for key, value in (("friction", friction), ("damping", damping)):
        not_negative(f"{key} of {what}", value)
    positive(f"creep of {what}", creep)
    if deflection is not None:
        positive(f"deflection of {what}", deflection)
    if not isinstance(points, Sequence) or len(points) != 2 or not all(map(_is_count, points)):
        raise UserError(f"points of {what} are {points!r}; allowed: two whole numbers from 1 on")
    side = max(sheet.a, sheet.b)
    if surface.curvature() * side > MAX_CELL_CURVATURE:
        longest, (nx, nz) = MAX_CELL_CURVATURE / surface.curvature(), (len(sheet.nodes), len(sheet.nodes[0]))
        finer = [max(n, ceil(h * (n - 1) / longest) + 1) for n, h in ((nx, sheet.a), (nz, sheet.b))]
        raise UserError(
            f"grid ({nx}, {nz}) of sheet {sheet.name!r} has cells of {side:.3g} m, too coarse for a surface of "
            f"{what} with a curvature of {surface.curvature():g} 1/m; allowed: {longest:.3g} m at most, as of "
            f"{finer[0]} x "
            f"{finer[1]} nodes"
        )
    spacing = max(sheet.a / points[0], sheet.b / points[1])
    usual = float(np.max(plate.bending)) / (length**2 * spacing * EDGE_PENETRATION_RATIO * plate.thickness)
    law = {
        "stiffness": _stiffness(what, stiffness, usual, "N/m^3"),
        "depth": positive(f"depth of {what}", DEFAULT_DEPTH_RATIO * plate.thickness if depth is None else depth),
        "damping": damping,
        "friction": friction,
        "friction_velocity": creep,
        "deflection": deflection if deflection is not None and friction > 0.0 else 0.0,
        "static": check_static("static", what, static, friction, stribeck, deflection),
        "stribeck": np.inf if stribeck is None else stribeck,
    }
    holder = mechanism.ground if body is None else body
    loads = [
        (
            SurfaceContact(
                surface=surface, sides=(sheet.a, sheet.b), ends=ends, thickness=element.thickness, samples=points, **law
            ),
            (*corners, holder),
        )
        for element, corners, ends in _cells(sheet)
    ]
    return SurfaceContactHandle(name, mechanism, *_add_loads(mechanism, name, loads, (holder,), sheet), sheet)


def add_nip(
    mechanism: Mechanism,
    name: str,
    sheet: Sheet,
    roller: Body,
    *,
    radius: float,
    at: Vector,
    width: float,
    force: Any,
    feed: str | Sequence[float] = "x",
    normal: str | Sequence[float] = "y",
    along: str = "x",
    uneven: float = 0.0,
    friction: float = 1.0,
    idler_friction: float = 0.3,
    creep: float = 2e-3,
    least: float = 1e-3,
    deflection: float | None = None,
    static: float | None = None,
    idler_static: float | None = None,
    stribeck: float | None = None,
    contact: float | None = None,
    entry: float | None = None,
    stiffness: float | None = None,
    damping: float | None = None,
    pairs: int | None = None,
    idler: Body | None = None,
    idler_radius: float | None = None,
) -> NipHandle:
    """Add a roller nip that drives a sheet by a roller and an idler.

    Parameters
    ----------
    mechanism, name, sheet
        As for :func:`add_contact`.
    roller
        Body of the driving roller, on a ``Revolute`` whose axis is that of the roller.
    radius
        Radius of the roller, m.
    at
        Middle of the nip in global axes, at the contact of sheet and roller, m.
    width
        Width of the contact across the feed, m.
    force
        Normal force of the idler, N: number, signal or input; negative values are zero.
    feed, normal
        Feed direction, and direction from the roller to the idler.
    along
        Axis of the sheet in feed direction, ``x`` or ``z``.
    uneven
        Relative increase of the force per width at the end in direction feed x normal, and decrease at the other.
    friction, idler_friction
        Friction coefficients of the roller and of the idler (sideways only if it has no body).
    creep, least
        Slip at which the roller has 70 % of its largest traction: relative to its speed, and at rest, m/s. The slip
        velocity used is the root of the sum of the squares of both.
    deflection
        Displacement of the sheet on a roller at rest under the load mu N before it slides, m: friction that sticks. A
        sheet in a nip at rest does not creep. ``creep`` and ``least`` then are the slip at which the traction has its
        largest value. None: friction is a function of the slip velocity.
    static, idler_static
        Coefficients of static friction of the roller, and of an idler with a body, at least those of sliding. They
        require a ``deflection``. None: the same as those of sliding.
    stribeck
        Slip velocity vs, m/s, of the decrease from static friction to that of sliding as exp(-(v / vs)^2).
    contact, entry
        Distance of the two contact points along the feed, and length over which an edge enters, m; None: 1/300 of the
        longer side of the sheet, and 0.4 of the radius, where the gap of the rollers is 0.16 of the radius.
    stiffness, damping
        Stiffness, N/m, and damping, N s/m, of the rubber; None: 1 mrad under the largest bending moment of the sheet,
        and small damping.
    pairs
        Number of pairs of contact points across the width; None: two per cell, and at least two, which resist rotation.
    idler
        Body of the idler on the other side of the sheet, on a ``Revolute``; it is driven by the sheet and may slip.
        None: the idler has no inertia and follows the sheet.
    idler_radius
        Radius of the idler, m; None: that of the roller.

    Returns
    -------
    NipHandle
        Handle whose sensors give normal force, traction, slip and frictional heat.

    Raises
    ------
    UserError
        A value is invalid, or a roller is not on a revolute joint about the axis of the nip.
    """
    what = f"nip {name!r}"
    _check_sheet(mechanism, sheet, what)
    for key, value in (("radius", radius), ("width", width), ("least", least)):
        positive(f"{key} of {what}", value)
    for key, value in (("friction", friction), ("idler_friction", idler_friction), ("creep", creep)):
        not_negative(f"{key} of {what}", value)
    if deflection is not None:
        positive(f"deflection of {what}", deflection)
    if isinstance(force, int | float):
        not_negative(f"force of {what}", force)
    if not -1.0 <= finite(f"uneven of {what}", uneven) <= 1.0:
        raise UserError(f"uneven of {what} is {uneven!r}; allowed: -1 to 1")
    one_of(f"along of {what}", along, ("x", "z"))
    d, n = unit_axis(feed, f"feed of {what}"), unit_axis(normal, f"normal of {what}")
    if abs(d @ n) > 1e-9:
        raise UserError(f"feed of {what} is {feed!r}; allowed: a direction normal to its normal {normal!r}")
    place, across = vector(f"at of {what}", at), np.cross(d, n)
    _check_roller(roller, radius, place, n, across, f"roller of {what}")
    if idler is None and idler_radius is not None:
        raise UserError(f"idler_radius of {what} is {idler_radius!r}, but no idler is given; allowed: both or none")
    beyond = 0.0
    if idler is not None:
        beyond = radius if idler_radius is None else positive(f"idler_radius of {what}", idler_radius)
        _check_roller(idler, beyond, place, -n, across, f"idler of {what}")
        if idler is roller:
            raise UserError(f"idler of {what} is {idler.name!r}, its roller; allowed: another body")
    _refuse_overlapping_nips(mechanism, sheet, place, (d, across, n), radius, width, name)
    length, plate, way = _scale(sheet), sheet.plate, "xz".index(along)
    half = 0.5 * _length(f"contact of {what}", length / 50.0 if contact is None else contact, length)
    beside = sheet.b if way == 0 else sheet.a
    if pairs is None:
        pairs = max(2, round(2.0 * width / beside))
    elif not _is_count(pairs):
        raise UserError(f"pairs of {what} is {pairs!r}; allowed: a whole number from 1 to {MAX_POINTS}")
    stiff = float(plate.bending[way, way])
    stiffness = _stiffness(what, stiffness, stiff * width / (length * NIP_ROTATION * half**2), "N/m")
    if damping is None:
        mass = sum(body.mass for row in sheet.nodes for body in row)
        damping = DEFAULT_DAMPING_RATIO * float(np.sqrt(stiffness * mass))
    usual_entry = min(ENTRY_LENGTH_RATIO * radius, length)
    common = {
        "pairs": pairs,
        "way": way,
        "place": place,
        "d": d,
        "n": n,
        "e": across,
        "radius": radius,
        "idler_radius": beyond,
        "half": half,
        "entry": 0.5 * _length(f"entry of {what}", usual_entry if entry is None else entry, length),
        "width": width,
        "uneven": uneven,
        "stiffness": stiffness,
        "damping": not_negative(f"damping of {what}", damping),
        "bending": stiff * max(width, beside) / pairs,
        "friction": friction,
        "idler_friction": idler_friction,
        "creep": creep,
        "friction_velocity": least,
        "deflection": deflection or 0.0,
        "static": check_static("static", what, static, friction, stribeck, deflection),
        "idler_static": check_static("idler_static", what, idler_static, idler_friction, stribeck, deflection),
        "stribeck": np.inf if stribeck is None else stribeck,
    }
    turning = (roller,) if idler is None else (roller, idler)
    loads = [
        (
            RollerNip(name=name, force=force, sides=(sheet.a, sheet.b), cell=cell, ends=ends, common=common),
            (*corners, *turning),
        )
        for cell, (_, corners, ends) in zip(sheet.cells, _cells(sheet), strict=True)
    ]
    first, count = _add_loads(mechanism, name, loads, turning, sheet)
    return NipHandle(name, mechanism, first, count, 2 * pairs, roller, radius)


def _is_count(value: Any) -> bool:
    """Whether a value is a number of points or stations."""
    return isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= MAX_POINTS


def _length(what: str, value: Any, scale: float) -> float:
    """Return a length that is neither nothing nor more than all of a sheet of this scale."""
    if not MIN_LENGTH_RATIO * scale <= positive(what, value) <= 6.0 * scale:
        raise UserError(f"{what} is {value!r} m; allowed: {MIN_LENGTH_RATIO * scale:.3g} to {6.0 * scale:.3g}")
    return float(value)


def _stiffness(what: str, value: Any, usual: float, unit: str) -> float:
    """Return a stiffness, the usual one where none is given, that numbers can bear."""
    if value is None:
        return usual
    if positive(f"stiffness of {what}", value) > MAX_STIFFNESS_RATIO * usual:
        raise UserError(f"stiffness of {what} is {value!r} {unit}; allowed: up to {MAX_STIFFNESS_RATIO * usual:.3g}")
    return float(value)


def _check_roller(roller: Any, radius: float, place: Any, normal: Any, across: Any, what: str) -> None:
    """Refuse a roller that does not turn where its nip is, a radius behind that against ``normal``."""
    if not isinstance(roller, Body) or not isinstance(roller.joint, Revolute):
        raise UserError(f"{what} is {getattr(roller, 'name', roller)!r}; allowed: a body on a Revolute")
    if roller.parent != 0:  # on a moving carrier: its position is not known here
        return
    axle = rotation(f"rotation of {roller.name!r}", roller.joint.rotation) @ roller.joint.direction
    if abs(axle @ across) < 1.0 - AXIS_COSINE_TOLERANCE:
        raise UserError(
            f"axis of {roller.name!r} is {axle.round(6).tolist()}; allowed as {what}: across its feed and its normal, "
            f"{across.round(6).tolist()}"
        )
    off = place - radius * normal - vector(f"at of {roller.name!r}", roller.joint.at)
    beside = float(np.linalg.norm(np.cross(off, axle)))
    if beside > AXIS_OFFSET_RATIO * radius:
        raise UserError(
            f"the axis of {roller.name!r} is {beside:.3g} m away from its place at {what}: {radius:g} m from "
            f"{place.tolist()} along {(0.0 - normal).round(6).tolist()}"
        )


def _refuse_overlapping_nips(
    mechanism: Mechanism, sheet: Sheet, place: Any, axes: Any, radius: float, width: float, name: str
) -> None:
    """Refuse a nip that stands where another of the sheet does, as rollers cannot; ``axes``: feed, across, normal."""
    ours = {id(body) for row in sheet.nodes for body in row}
    others = {
        acting.name: acting.load.common
        for acting in mechanism.others
        if isinstance(acting.load, RollerNip) and id(acting.bodies[0]) in ours
    }
    for other, nip in others.items():
        near = radius + nip["radius"], 0.5 * (width + nip["width"]), radius + nip["radius"]
        off = place - nip["place"]
        if name != other and all(
            abs(off @ axis) < MIN_ROLLER_DISTANCE_RATIO * reach for axis, reach in zip(axes, near, strict=True)
        ):
            raise UserError(
                f"nip {name!r} at {place.tolist()} and nip {other!r} at {nip['place'].tolist()} are in one place; "
                f"allowed: {near[0]:.3g} m apart along the feed, or {near[1]:.3g} m across"
            )


def _scale(sheet: Sheet) -> float:
    """Return a length to which a sheet may be bent, m."""
    return max(sheet.a * (len(sheet.nodes) - 1), sheet.b * (len(sheet.nodes[0]) - 1)) / 6.0


def _cells(sheet: Sheet) -> Iterator[tuple[Any, tuple[Body, ...], Any]]:
    """Yield the elements of a sheet, their corners, and where they end on its edges."""
    nx, nz = len(sheet.nodes) - 1, len(sheet.nodes[0]) - 1
    for (i, k), (_, corners) in sheet.cells.items():
        yield sheet.fabric.at((i, k)), corners, ((i == 0, i == nx - 1), (k == 0, k == nz - 1))


def _check_sheet(mechanism: Mechanism, sheet: Any, what: str) -> None:
    """Refuse what is no sheet of the mechanism."""
    if not isinstance(sheet, Sheet) or not any(sheet is own for own in mechanism.meshes):
        given = repr(sheet.name) if isinstance(sheet, Sheet | Body) else short(sheet)
        raise UserError(f"sheet of {what} is {given}; allowed: a sheet of this mechanism")


def _add_loads(
    mechanism: Mechanism, name: str, loads: Sequence[tuple[Load, tuple[Body, ...]]], bodies: Sequence[Any], sheet: Sheet
) -> tuple[int, int]:
    """Let loads of one name act; return the number of the first, and how many there are."""
    own = {id(node) for row in sheet.nodes for node in row}
    for body in (body for body in bodies if id(body) in own):
        raise UserError(f"body of {name!r} is {body.name!r}, a node of sheet {sheet.name!r} itself; allowed: another")
    return mechanism.load_all(name, loads), len(loads)

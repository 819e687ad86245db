"""What contact refuses, and what it remarks on: one sentence each, with the thing, the value and what is allowed."""

from __future__ import annotations

import re
from math import inf, nan
from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.mechanics import Body, CompiledMechanism, Input, Mechanism, Polynomial, Revolute, SpeedInput, Translational
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.sheets import Drum, Guide, Sheet, Surface, Trough, Wall, add_contact, add_nip, add_sheet
from mbfmu.util.errors import UserError

PAPER: dict[str, Any] = {
    "length": 0.297, "width": 0.21, "thickness": 1e-4, "youngs_modulus": 4e9, "density": 800.0,
    "tree": "master", "membrane": True, "damping": 5e-4,
}  # fmt: skip
ESDIRK = Settings(solver="esdirk", tolerance=1e-4)
ABOVE = 5e-5  # m, half the thickness: where the sheet touches a table at zero


def scene(y: float = ABOVE, grid: tuple[int, int] = (5, 4), weight: float = 9.81, **given: Any) -> tuple[Any, Sheet]:
    """A flat sheet at a height."""
    m = Mechanism(gravity=(0.0, -weight, 0.0))
    return m, add_sheet(m, "s", grid=grid, at=(0.0, y, 0.0), **(PAPER | given))


def starts(surface: Surface, y: float, **given: Any) -> Simulation:
    """A sheet at a height that touches a surface, at its start."""
    m, sheet = scene(y)
    add_contact(m, "table", sheet, surface, **given)
    return Simulation(m, ESDIRK)


def refused(message: str) -> Any:
    """A UserError of one line that begins so."""
    return pytest.raises(UserError, match=rf"^{message}[^\n]*$")


# ---- where a sheet starts --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("deep", [-1e-3, 0.0, 4e-6, 9e-5])
def test_a_sheet_may_start_a_little_in_what_it_touches(deep: float) -> None:
    assert starts(Wall(), ABOVE - deep).t == 0.0


@pytest.mark.parametrize(
    ("surface", "y", "place", "depth"),
    [
        (Wall(), -6e-5, r"\(0, -6e-05, ", "0.00011"),
        (Wall(), -0.2, r"\(0, -0.2, ", "0.2"),  # on the wrong side
        (Drum(radius=0.2, length=0.5, at=(0.1485, -0.19, 0.105)), 0.0, r"\(0.1485, 0, ", "0.01"),
        (
            Trough(radius=0.4, length=0.5, angle=2.0, towards=(0, -1, 0), at=(0.1485, 0.39, 0.1)),
            0.0,
            r"\(0, 0, ",
            "0.0174",
        ),
        # between the contact points, 19 mm apart: one thinner than that would never be felt
        (Guide(start=(0.1, -0.02, 0.1), end=(0.1, 0.02, 0.1), radius=5e-4, width=0.3), 0.0, r"\(0.09987, 0", "0.00041"),
    ],
)
def test_a_sheet_that_starts_through_what_it_touches_is_refused(
    surface: Surface, y: float, place: str, depth: str
) -> None:
    message = rf"sheet 's' penetrates 'table' at the start by {depth}\d* m at {place}.* m; allowed: "
    with refused(message):
        starts(surface, y)


def test_a_sheet_may_rest_on_what_is_soft() -> None:
    """Its weight of 0.785 Pa sinks 0.27 mm in, some times the depth of the law, to where it starts at equilibrium."""
    soft = {"stiffness": 3e3, "depth": 2e-5}
    assert starts(Wall(), ABOVE - 2.7e-4, **soft).t == 0.0
    with refused("sheet 's' penetrates .* allowed: 0.00136 m"):
        starts(Wall(), ABOVE - 2e-3, **soft)


def test_the_start_is_where_inputs_have_put_it() -> None:
    """The input, and not the model, gives the start position of a table on a moved support."""
    m, sheet = scene()
    lift = m.body("lift", m.ground, Translational(axis="y", drive=Input(name="lift", unit="m")), mass=1.0)
    add_contact(m, "table", sheet, Wall(), body=lift)
    Simulation(m, ESDIRK, inputs={"lift": -0.01})
    with refused(r"sheet 's' penetrates 'table' at the start by 0.003 m"):
        Simulation(m, ESDIRK, inputs={"lift": 0.003})


def test_a_start_at_equilibrium_is_where_that_is() -> None:
    """A strip that is clamped at one end, and would be in a guide if it did not hang by 20 mm."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    strip = PAPER | {"tree": "spine", "width": 0.03, "thickness": 1e-3}
    sheet = add_sheet(m, "s", grid=(7, 3), supports=[mb.Support("x0", "clamped")], **strip)
    add_contact(m, "bar", sheet, Guide(start=(0.25, 0.002, 0.0), end=(0.35, 0.002, 0.0), radius=3e-3, width=0.1))
    m.output("tip", sheet.node(-1, 1).position("y"))
    with refused(r"sheet 's' penetrates 'bar' at the start by 0.0015 m .* allowed: 0.001 m"):
        Simulation(m, ESDIRK)
    hanging = Simulation(m, Settings(solver="radau", start_at_equilibrium=True))
    assert hanging.outputs()[0] == pytest.approx(-0.0226, rel=0.05)  # rho g t L^4 / (8 B)


def test_a_restored_state_is_no_start() -> None:
    """It may be deeper than a start, and taken up where the sheet would start through the table."""
    m, sheet = scene(rate=(0.0, -1.0, 0.0, 0.0, 0.0, 0.0))
    lift = Translational(axis="y", drive=Input(name="lift", unit="m", start=0.003))
    contact = add_contact(m, "table", sheet, Wall(), body=m.body("lift", m.ground, lift, mass=1.0))
    m.output("depth", contact.depth())
    run = Simulation(m, ESDIRK, inputs={"lift": 0.0})
    run.advance(5e-4)
    deep = run.outputs()[0]
    assert deep > 1e-4
    state = run.save()
    other = Simulation(m, ESDIRK, begins=False)
    other.restore(state)
    assert other.outputs()[0] == pytest.approx(deep, rel=1e-12)
    with refused("sheet 's' penetrates "):
        Simulation(m, ESDIRK)


# ---- nips next to the sheet -----------------------------------------------------------------------------------------


def roller(m: Mechanism, z: float, drive: Any = None) -> Body:
    """A driven roller below the plane y = 0."""
    axle = Revolute(at=(0.0, -0.01, z), drive=drive or Polynomial((0.0, -10.0)))
    return m.body(f"roller{z}", m.ground, axle, mass=0.1, inertia=(1e-5, 1e-5, 1e-5))


@pytest.mark.parametrize(("z", "off"), [(-0.03, "0.02"), (0.25, "0.03"), (0.0, ""), (0.21, "")])
def test_a_nip_outside_the_sheet_is_reported(z: float, off: str) -> None:
    m, sheet = scene(0.0)
    add_nip(m, "n", sheet, roller(m, z), radius=0.01, at=(0.0, 0.0, z), width=0.02, force=2.0)
    told = [text for text in map(str, Simulation(m, ESDIRK).diagnostics) if "nip" in text]
    wanted = f"nip 'n' is {off} m away from the edge of sheet 's' at the start, across the feed direction"
    assert [text.startswith(wanted) for text in told] == [True] * bool(off)


def test_a_stiffness_that_numbers_cannot_bear_is_refused() -> None:
    m, sheet = scene()
    with refused(r"stiffness of contact 't' is 1e\+30 N/m\^3; allowed: up to [\d.e+]+"):
        add_contact(m, "t", sheet, Wall(), stiffness=1e30)
    with refused(r"stiffness of nip 'n' is 1e\+30 N/m; allowed: up to [\d.e+]+"):
        add_nip(m, "n", sheet, roller(m, 0.1), radius=0.01, at=(0.0, 0.0, 0.1), width=0.02, force=2.0, stiffness=1e30)


# ---- edges between the points of a sheet -----------------------------------------------------------------------------


@pytest.mark.parametrize(("points", "thick"), [((4, 4), True), ((48, 2), False)])
@pytest.mark.parametrize("turn", [False, True])
def test_an_edge_thinner_than_the_points_are_apart_is_reported(
    points: tuple[int, int], thick: bool, turn: bool
) -> None:
    """A plate that stands on edge below the sheet, 2 mm thick, across its length or along it."""
    m, sheet = scene(1e-3 + ABOVE)
    start, end = ((0.1, -0.05, 0.1), (0.1, -1e-3, 0.1))
    knife = Guide(start=start, end=end, radius=1e-3, width=0.4, across="x" if turn else "z")
    add_contact(m, "knife", sheet, knife, points=points[::-1] if turn else points)
    wanted = r"surface of contact 'knife' is 0\.002 m thick, but the contact points of sheet 's' are 0\.01\d* m apart"
    told = [text for text in map(str, Simulation(m, ESDIRK).diagnostics) if "knife" in text]
    assert [re.match(wanted, text) is not None for text in told] == [True] * thick


def test_a_narrow_rail_is_reported() -> None:
    m, sheet = scene(1e-3 + ABOVE)
    rail = Guide(start=(-0.1, -0.02, 0.1), end=(0.4, -0.02, 0.1), radius=0.02, width=5e-3)
    add_contact(m, "rail", sheet, rail)
    told = [text for text in map(str, Simulation(m, ESDIRK).diagnostics) if "rail" in text]
    assert told == [
        "surface of contact 'rail' is 0.005 m wide, but the contact points of sheet 's' are 0.0175 m apart: an edge "
        "between two points causes no contact force. Use more points per cell than (4, 4) [element-at-start]"
    ]


@pytest.mark.parametrize("x", [0.0, 0.014, 0.0186, 0.0232])
def test_an_edge_is_felt_wherever_it_is_among_points_that_are_close(x: float) -> None:
    m, sheet = scene(0.2e-3, grid=(9, 7))
    knife = Guide(start=(0.1485 + x, -0.051, 0.1), end=(0.1485 + x, -0.001, 0.1), radius=1e-3, width=0.4)
    contact = add_contact(m, "knife", sheet, knife, points=(24, 2))
    m.output("force", contact.force("y"))
    m.output("y", sheet.point(0.1485 + x, 0.105).position("y"))
    found = mb.simulate(m, stop_time=0.02, interval=1e-3, solver="esdirk", tolerance=1e-4)
    assert found["force"].max() > 0.01
    assert found["y"].min() > -2e-4  # 1.8 mm of free fall


# ---- bad arguments ---------------------------------------------------------------------------------------------------

GOOD: dict[type[Surface], dict[str, Any]] = {
    Wall: {"at": (0.0, 0.0, 0.0), "normal": "y"},
    Guide: {"start": (0.0, 0.0, 0.0), "end": (0.1, 0.0, 0.0), "radius": 0.01, "width": 0.2, "across": "z"},
    Drum: {"radius": 0.5, "length": 1.0, "at": (0.0, 0.0, 0.0), "axis": "z"},
    Trough: {"radius": 0.5, "length": 1.0, "angle": 1.0, "towards": "x", "at": (0.0, 0.0, 0.0), "axis": "z"},
}
NO_NUMBER = (nan, inf, -1.0, 0.0, True, "1", None, (1, 2), [], 1j)
NO_VECTOR = (nan, 1.0, True, "abc", None, (1, 2), (1.0, nan, 0.0), (True, False, True), np.ones(4), {})
NO_AXIS = (*NO_VECTOR, (0, 0, 0))


@pytest.mark.parametrize("kind", GOOD)
def test_every_argument_of_a_surface_is_checked(kind: type[Surface]) -> None:
    m, sheet = scene()
    for key, good in GOOD[kind].items():
        bad: tuple[Any, ...] = NO_NUMBER if isinstance(good, float) else NO_AXIS if isinstance(good, str) else NO_VECTOR
        for value in bad:
            with refused(rf".*{key} of the surface of contact 't'"):
                add_contact(m, "t", sheet, kind(**(GOOD[kind] | {key: value})))


@pytest.mark.parametrize(
    ("surface", "message"),
    [
        (Guide(**(GOOD[Guide] | {"end": (0, 0, 0)})), r"start and end .* are both \(0.0, 0.0, 0.0\); allowed: two"),
        (Guide(**(GOOD[Guide] | {"across": "x"})), "across .* is 'x'; allowed: a direction normal to the way along it"),
        (Trough(**(GOOD[Trough] | {"angle": 4.0})), "angle .* is 4.0 rad; allowed: pi at most"),
        (Trough(**(GOOD[Trough] | {"towards": "z"})), "towards .* is 'z'; allowed: a direction normal to its axis"),
        (Drum(radius=0.02, length=1.0), r"grid \(5, 4\) of sheet 's' has cells of 0.0742 m, too coarse for a surface "
         "of contact 't' with a curvature of 50 1/m; allowed: 0.012 m at most, as of 26 x 19 nodes"),
        (Wall, "surface of contact 't' is <class .*Wall'>; allowed: a Surface"),
        (None, "surface of contact 't' is None; allowed: a Surface"),
    ],
)  # fmt: skip
def test_surfaces_that_are_none_are_refused(surface: Any, message: str) -> None:
    m, sheet = scene()
    with refused(message):
        add_contact(m, "t", sheet, surface)


def test_the_grid_that_a_drum_takes_is_taken() -> None:
    m, sheet = scene(grid=(26, 19))
    add_contact(m, "t", sheet, Drum(radius=0.02, length=1.0))


@pytest.mark.parametrize("key", ["friction", "stiffness", "depth", "damping", "creep"])
def test_numbers_of_a_contact_are_checked(key: str) -> None:
    m, sheet = scene()
    for value in (nan, inf, -0.1, True, "1", (1, 2)):
        with refused(f"{key} of contact 't' is"):
            add_contact(m, "t", sheet, Wall(), **{key: value})
    for body in (sheet, "roller", Mechanism().ground, 3):
        with refused(".*load 't'"):
            add_contact(m, "t", sheet, Wall(), body=body)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("key", "values"),
    [
        (key, (nan, inf, -0.1, True, "1", (1, 2)))
        for key in ("radius", "width", "friction", "idler_friction", "creep", "least", "contact", "entry", "stiffness",
                    "damping")
    ] + [
        ("radius", (0.0,)), ("width", (0.0,)), ("force", (nan, inf, -0.1, True)), ("uneven", (nan, 1.1, True, "1")),
        ("at", NO_VECTOR), ("feed", NO_AXIS), ("normal", NO_AXIS), ("along", ("y", 0, None, np.ones(3))),
        ("pairs", (0, 1.0, True, 1001, "2")),
    ],
)  # fmt: skip
def test_every_argument_of_a_nip_is_checked(key: str, values: tuple[Any, ...]) -> None:
    m, sheet = scene()
    driving = roller(m, 0.0)
    nip: dict[str, Any] = {"radius": 0.01, "at": (0.0, 0.0, 0.0), "width": 0.02, "force": 2.0}
    for value in values:
        with refused(f"{key} of nip 'n' is"):
            add_nip(m, "n", sheet, driving, **(nip | {key: value}))


def test_an_idler_turns_where_its_nip_is() -> None:
    """On a Revolute beyond the sheet, at its radius, by default the radius of the roller."""
    m, sheet = scene()
    driving = roller(m, 0.0)
    nip: dict[str, Any] = {"radius": 0.01, "at": (0.0, 0.0, 0.0), "width": 0.02, "force": 2.0}
    inertia: dict[str, Any] = {"mass": 0.1, "inertia": (1e-5, 1e-5, 1e-5)}
    bodies = {
        "above": m.body("above", m.ground, Revolute(at=(0.0, 0.01, 0.0)), **inertia),
        "askew": m.body("askew", m.ground, Revolute(axis="x", at=(0.0, 0.01, 0.0)), **inertia),
        "slides": m.body("slides", m.ground, Translational(at=(0.0, 0.01, 0.0)), **inertia),
    }
    node = sheet.nodes[1][1]
    for given, told in (
        (
            {"idler": driving},
            r"the axis of 'roller0.0' is 0.02 m away from its place at idler of nip 'n': 0.01 m from",
        ),
        (
            {"idler": bodies["above"], "idler_radius": 0.02},
            "the axis of 'above' is 0.01 m away from its place at idler of",
        ),
        ({"idler": bodies["askew"]}, "axis of 'askew' is .* allowed as idler of nip 'n': across its feed"),
        ({"idler": bodies["slides"]}, "idler of nip 'n' is 'slides'; allowed: a body on a Revolute"),
        ({"idler": node}, "idler of nip 'n' is '.*'; allowed: a body on a Revolute"),
        ({"idler": "above"}, "idler of nip 'n' is 'above'; allowed: a body on a Revolute"),
        ({"idler_radius": 0.01}, "idler_radius of nip 'n' is 0.01, but no idler is given; allowed: both or none"),
        ({"idler": bodies["above"], "idler_radius": -0.01}, "idler_radius of nip 'n' is -0.01"),
    ):
        with refused(told):
            add_nip(m, "n", sheet, driving, **nip, **given)
    add_nip(m, "n", sheet, driving, **nip, idler=bodies["above"])


@pytest.mark.parametrize("force", [None, (1.0, 2.0), "abc", "nan", 1j])
def test_a_force_that_is_none_is_reported_when_the_mechanism_is_complete(force: Any) -> None:
    m, sheet = scene()
    with refused("force of nip 'n' is"):
        add_nip(m, "n", sheet, roller(m, 0.0), radius=0.01, at=(0.0, 0.0, 0.0), width=0.02, force=force)
        CompiledMechanism(m)


def test_what_is_no_sheet_is_named() -> None:
    m, sheet = scene()
    driving = roller(m, 0.0)
    nip: dict[str, Any] = {"radius": 0.01, "at": (0.0, 0.0, 0.0), "width": 0.02, "force": 2.0}
    for given, told in ((None, "None"), ("s", "'s'"), (driving, "'roller0.0'"), (sheet.nodes, "a tuple"), (m, ".*")):
        with refused(f"sheet of contact 't' is {told}; allowed: a sheet of this mechanism"):
            add_contact(m, "t", given, Wall())  # type: ignore[arg-type]
        with refused(f"sheet of nip 'n' is {told}; allowed: a sheet of this mechanism"):
            add_nip(m, "n", given, driving, **nip)  # type: ignore[arg-type]
    with refused("surface of contact 't' is a Sheet; allowed: a Surface"):
        add_contact(m, "t", sheet, sheet)  # type: ignore[arg-type]


def test_speeds_and_forces_that_are_not_finite_are_refused() -> None:
    """Those of a drive, those that a host gives at the start, and those that it gives later."""
    for value in (nan, inf, -inf, True, "fast", None):
        with refused(".*roller.speed.* is"):
            m, sheet = scene()
            CompiledMechanism(drive(m, sheet, SpeedInput(name="roller.speed", unit="rad/s", start=value)))  # type: ignore[arg-type]
        if value is not True:  # which is a number among numbers
            with refused("polynomial coefficients are"):
                m, sheet = scene()
                CompiledMechanism(drive(m, sheet, Polynomial((0.0, value))))  # type: ignore[arg-type]
    m, sheet = scene(0.0)
    drive(m, sheet, SpeedInput(name="roller.speed", unit="rad/s"), Input(name="force", unit="N", start=2.0))
    for name in ("roller.speed", "force"):
        for value in (nan, inf):
            with refused(f"input '{name}' is {value}"):
                Simulation(m, ESDIRK, inputs={name: value})
    run = Simulation(m, ESDIRK)
    for name in ("roller.speed", "force"):
        with refused(f".*'{name}' is nan"):
            run.set_input(name, nan)
    run.advance(1e-3)
    assert run.t == 1e-3


def drive(m: Mechanism, sheet: Sheet, speed: Any, force: Any = 2.0) -> Mechanism:
    """Drive a sheet by one nip."""
    nip: dict[str, Any] = {"radius": 0.01, "at": (0.1, 0.0, 0.1), "width": 0.02}
    axle = Revolute(at=(0.1, -0.01, 0.1), drive=speed)
    turning = m.body("roller0.0", m.ground, axle, mass=0.1, inertia=(1e-5, 1e-5, 1e-5))
    add_nip(m, "n", sheet, turning, force=force, **nip)
    return m

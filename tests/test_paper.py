"""Sheets of real paper: a grain, curl, uneven thickness and creases, against Ritz, the elastica and closed forms."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from plate_oracles import grain, ritz
from scipy.integrate import quad, solve_bvp
from scipy.special import fresnel

import mbfmu as mb
from fmus.sheet import Sheet
from mbfmu.mechanics import CompiledMechanism, Mechanism
from mbfmu.sheets import Crease, Plate, Support, add_sheet
from mbfmu.steady.equilibrium import equilibrium
from mbfmu.steady.modes import shapes

LENGTH, WIDTH, THICKNESS, DENSITY = 0.3, 0.21, 0.3e-3, 1000.0
PAPER: dict[str, Any] = {"youngs_modulus": (6e9, 2.5e9), "poisson": 0.35}
E, STRIP = 4e9, 0.04  # Pa, m
G = 9.81


def frequencies(grid: tuple[int, int], clamped: bool, count: int, **options: Any) -> Any:
    """Natural frequencies of the flat sheet, Hz, without the rigid motions of a free one."""
    m = Mechanism()
    held: dict[str, Any] = {"supports": [Support("x1")]} if clamped else {"tree": "master"}
    add_sheet(
        m, "sheet", length=LENGTH, width=WIDTH, thickness=THICKNESS, density=DENSITY, grid=grid,
        **PAPER, **held, **options,
    )  # fmt: skip
    compiled, rigid = CompiledMechanism(m), 0 if clamped else 6
    found = shapes(compiled, compiled.assembly.start_positions(), rigid + count, np.zeros(0))
    return np.array([shape.mode.frequency for shape in found])[rigid:] / (2.0 * np.pi)


@pytest.mark.parametrize("stretch", [False, True])
@pytest.mark.parametrize("angle", [0.0, np.pi / 6.0])
@pytest.mark.parametrize("clamped", [True, False])
def test_frequencies_of_a_sheet_with_a_grain(clamped: bool, angle: float, stretch: bool) -> None:
    """Within 0.5 % of Ritz, and of second order."""
    D = grain(**PAPER, angle=angle) * THICKNESS**3 / 12.0
    expected = ritz((LENGTH, WIDTH), D, DENSITY * THICKNESS, clamped=clamped)[0 if clamped else 3 :][:4]
    effects: dict[str, Any] = {"stretch": True} if stretch else {"membrane": True}
    coarse, fine = (
        np.abs(frequencies(grid, clamped, 4, angle=angle, **effects) / expected - 1.0) for grid in ((11, 8), (21, 15))
    )
    assert fine.max() < 5e-3
    assert fine.max() < 0.35 * coarse.max()


def strip(cells: int, *, gravity: float = 0.0, **options: Any) -> Mechanism:
    """A narrow strip clamped at x = 0, which does not contract across."""
    m = Mechanism(gravity=(0.0, -gravity, 0.0))
    given = {"thickness": 0.1e-3, "youngs_modulus": E, "poisson": 0.0, "density": DENSITY, "grid": (cells + 1, 3)}
    given |= {"supports": [Support("x0")], "length": LENGTH, "width": STRIP}
    sheet = add_sheet(m, "strip", **(given | ({} if options.get("stretch") else {"membrane": True}) | options))
    for axis in "xyz":
        m.output(axis, sheet.node(-1, 1).position(axis))
    m.output("energy", m.energy)
    return m


def tip(m: Mechanism) -> Any:
    """x and y of the tip of a strip at rest."""
    found = mb.equilibrium(m).outputs
    return np.array([found["x"], found["y"]])


@pytest.mark.parametrize("stretch", [False, True])
@pytest.mark.parametrize("k", [4.0, -8.0])
def test_a_curled_strip_rests_on_an_arc(k: float, stretch: bool) -> None:
    """Of the radius 1 / k, towards y where k is positive; no energy is left."""
    exact = np.array([np.sin(k * LENGTH), 1.0 - np.cos(k * LENGTH)]) / k
    errors = [np.linalg.norm(tip(strip(cells, curl=(k, 0.0), stretch=stretch)) - exact) / LENGTH for cells in (12, 24)]
    assert errors[1] < 1e-3
    assert errors[1] < 0.3 * errors[0]
    assert mb.equilibrium(strip(24, curl=(k, 0.0), stretch=stretch)).outputs["energy"] < 1e-9


def elastica(k: float, EI: float, weight: float) -> Any:
    """x and y of the tip of an inextensible strip of natural curvature k under its weight per length.

    The moment EI (theta' - k) is that of the weight beyond: EI theta'' = weight (L - s) cos(theta).
    """

    def slope(s: Any, y: Any, part: float) -> Any:
        theta, bend = y[:2]
        return np.array([bend, part * weight / EI * (LENGTH - s) * np.cos(theta), np.cos(theta), np.sin(theta)])

    def ends(a: Any, b: Any) -> Any:
        return np.array([a[0], b[1] - k, a[2], a[3]])

    s = np.linspace(0.0, LENGTH, 101)
    y = np.array([k * s, k + 0.0 * s, s, 0.0 * s])
    for part in np.linspace(0.1, 1.0, 10):
        found = solve_bvp(partial(slope, part=part), ends, s, y, tol=1e-9, max_nodes=20_000)
        assert found.success
        s, y = found.x, found.y
    return found.y[2:, -1]


@pytest.mark.parametrize("stretch", [False, True])
@pytest.mark.parametrize("k", [5.0, -3.0])
def test_a_curled_strip_under_its_weight_follows_the_elastica(k: float, stretch: bool) -> None:
    EI, weight = E * 0.1e-3**3 / 12.0, DENSITY * 0.1e-3 * G
    exact = elastica(k, EI, weight)
    assert np.linalg.norm(exact - elastica(0.0, EI, weight)) > 0.05 * LENGTH
    errors = [
        np.linalg.norm(tip(strip(cells, gravity=G, curl=(k, 0.0), stretch=stretch)) - exact) / LENGTH
        for cells in (15, 30)
    ]
    assert errors[1] < 3e-3
    assert errors[1] < 0.35 * errors[0]


@pytest.mark.parametrize("stretch", [False, True])
def test_curl_may_grow_along_a_strip(stretch: bool) -> None:
    """k = c x: a clothoid, whose tip is given by Fresnel's integrals."""
    c = 20.0
    unit = np.sqrt(np.pi / c)
    y, x = np.array(fresnel(LENGTH / unit)) * unit
    errors = [
        np.linalg.norm(tip(strip(cells, curl=lambda x, z: (c * x, 0.0), stretch=stretch)) - (x, y)) / LENGTH
        for cells in (12, 24)
    ]
    assert errors[1] < 1e-3
    assert errors[1] < 0.3 * errors[0]


@pytest.mark.parametrize("stretch", [False, True])
@pytest.mark.parametrize(("axis", "c"), [("x", 0.1), ("z", 0.1), ("x", 0.1337)])
def test_a_creased_cantilever_hangs_as_one_with_a_hinge_and_a_spring(axis: str, c: float, stretch: bool) -> None:
    """Small deflections: q L^4 / (8 EI) of the strip and (L - c) q (L - c)^2 / (2 k) of the crease at c."""
    k, gravity = 1e-3, 1e-3
    EI, q = E * 0.1e-3**3 / 12.0, DENSITY * 0.1e-3 * gravity
    exact = -q * LENGTH**4 / (8.0 * EI) - 0.5 * q * (LENGTH - c) ** 3 / k
    assert abs(exact) > 1.5 * q * LENGTH**4 / (8.0 * EI)
    turned: dict[str, Any] = {}
    errors = []
    for cells in (12, 24):
        if axis == "z":
            turned = {"length": STRIP, "width": LENGTH, "grid": (3, cells + 1), "supports": [Support("z0")]}
        m = Mechanism(gravity=(0.0, -gravity, 0.0))
        given = {"length": LENGTH, "width": STRIP, "grid": (cells + 1, 3), "supports": [Support("x0")]} | turned
        sheet = add_sheet(
            m, "strip", thickness=0.1e-3, youngs_modulus=E, poisson=0.0, density=DENSITY, membrane=not stretch,
            stretch=stretch, creases=[Crease(axis, c, k)], **given,
        )  # fmt: skip
        m.output("tip", sheet.node(*((-1, 1) if axis == "x" else (1, -1))).position("y"))
        errors.append(abs(mb.equilibrium(m).outputs["tip"] / exact - 1.0))
    assert errors[1] < 5e-3
    assert errors[1] < 0.35 * errors[0]


def test_cells_share_the_angle_of_a_crease_by_where_it_lies() -> None:
    """Sides of cells are 0.1 m: on nodes, 0.03 m off them, in the middle of a cell, near an edge."""
    m = Mechanism()
    creases = [Crease("x", 0.2, 4.0), Crease("x", 0.13, 2.0), Crease("z", 0.15, 5.0), Crease("z", 0.01, 8.0)]
    sheet = add_sheet(
        m, "s", length=0.3, width=0.2, thickness=1e-4, youngs_modulus=E, density=DENSITY, grid=(4, 3),
        supports=[Support("x0")], creases=creases,
    )  # fmt: skip
    softness = np.array([acting.load.creases for acting in m.elements]).reshape(3, 2, 2)  # by cells along x and z
    assert sheet.plate.creases == (0.0, 0.0)
    np.testing.assert_allclose(softness[:, 0, 0], [0.1, 0.4 + 0.125, 0.125])
    np.testing.assert_allclose(softness[0, :, 1], [0.125, 0.2])


@pytest.mark.parametrize("stretch", [False, True])
def test_a_tapered_cantilever_hangs_as_a_beam(stretch: bool) -> None:
    """w'' = M / EI, both by quadrature; its weight follows from its thickness."""
    gravity, t0 = 1e-3, 0.1e-3

    def thickness(x: float, z: float = 0.0) -> float:
        return t0 * (1.5 - x / LENGTH)

    def moment(x: float) -> float:
        return float(quad(lambda u: DENSITY * gravity * thickness(u) * (u - x), x, LENGTH)[0])

    exact = -quad(lambda x: moment(x) * (LENGTH - x) / (E * thickness(x) ** 3 / 12.0), 0.0, LENGTH)[0]
    errors = []
    for cells in (12, 24):
        m = strip(cells, gravity=gravity, thickness=thickness, stretch=stretch)
        mass = sum(body.mass for body in m.bodies[1:])
        assert mass == pytest.approx(DENSITY * t0 * LENGTH * STRIP, rel=1e-12)
        errors.append(abs(tip(m)[1] / exact - 1.0))
    assert errors[1] < 5e-3
    assert errors[1] < 0.35 * errors[0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"youngs_modulus": (1e9, 4e9), "poisson": 0.6}, r"poisson of sheet 's' is 0.6 .* within 0.5"),
        ({"youngs_modulus": (1e9, 0.0)}, "youngs_modulus E2 of sheet 's' is 0"),
        ({"youngs_modulus": "paper"}, "youngs_modulus of sheet 's' is 'paper'"),
        ({"shear_modulus": -1.0}, "shear_modulus of sheet 's' is -1.0"),
        ({"angle": None}, "angle of sheet 's' is None"),
        ({"curl": 3.0}, "curl of sheet 's' is 3.0; allowed: two or three finite curvatures"),
        ({"curl": lambda x, z: (x, np.nan)}, r"curl of sheet 's' at x = .* m, z = .* m is"),
        ({"curl": (30.0, 0.0)}, r"curl of sheet 's' is .* which bends its cells by 3 rad; .* refine the grid"),
        ({"thickness": lambda x, z: x - 0.2}, r"thickness of sheet 's' at x = 0.\d+ m, z = 0.\d+ m is -0.\d+; allowed"),
        (
            {"thickness": lambda x: 1e-4},
            "thickness of sheet 's' at .* TypeError.* given; allowed: a function of x and z",
        ),
        (
            {"thickness": lambda x, z: 1 / 0},
            "thickness of sheet 's' at .* fails with ZeroDivisionError: .* allowed",
        ),
        (
            {"thickness": lambda x, z: "thin"},
            r"thickness of sheet 's' at x = .* is 'thin'; allowed: finite and greater",
        ),
        ({"thickness": lambda x, z: np.nan}, r"thickness of sheet 's' at x = .* is nan; allowed: finite and greater"),
        ({"thickness": lambda x, z: True}, r"thickness of sheet 's' at x = .* is True; allowed"),
        ({"curl": lambda x: (x, 0.0)}, "curl of sheet 's' at .* TypeError.* given; allowed: a function of x and z"),
        ({"curl": lambda x, z: {}["k"]}, "curl of sheet 's' at .* fails with KeyError: 'k'; allowed: a function"),
        ({"curl": lambda x, z: "curly"}, "curl of sheet 's' at .* is 'curly'; it needs numbers"),
        ({"thickness": 0.0}, "thickness of sheet 's' is 0.0"),
        ({"creases": Crease("x", 0.1, 1.0)}, "creases of sheet 's' are .* a list"),
        ({"creases": [0.1]}, "crease of sheet 's' is 0.1; it must be a Crease"),
        ({"creases": [Crease("y", 0.1, 1.0)]}, "axis of a crease of sheet 's' is 'y'"),
        ({"creases": [Crease("z", 0.2, 1.0)]}, "place of the crease across z of sheet 's' is 0.2 m; .* 0 and 0.2 m"),
        ({"creases": [Crease("x", -0.1, 1.0)]}, "place of the crease across x of sheet 's' is -0.1 m"),
        ({"creases": [Crease("x", 0.1, 0.0)]}, "stiffness of the crease across x of sheet 's' is 0.0"),
    ],
)
def test_mistakes_are_named(options: dict[str, Any], message: str) -> None:
    given = {"length": 0.3, "width": 0.2, "thickness": 1e-4, "youngs_modulus": 1e9, "density": 1e3, "grid": (4, 4)}
    with pytest.raises(mb.UserError, match=message):
        add_sheet(Mechanism(), "s", supports=[Support("x0")], **(given | options))


def test_the_model_takes_grain_and_curl_and_leaves_out_what_is_zero() -> None:
    plain = Sheet(nx=7, nz=5)
    record = CompiledMechanism(plain.build()).records(Plate)
    assert not record["grain"].any()
    assert not record["curled"].any()
    grained = plain.with_values({"youngs_modulus_cross": 4e9, "angle": 0.5, "shear_modulus": 3e9})
    plate = grained.build().elements[0].load
    assert (plate.youngs_modulus, plate.shear_modulus, plate.angle) == ((1e10, 4e9), 3e9, 0.5)
    right, left = (equilibrium(grained.with_values({"angle": angle})).outputs for angle in (0.5, -0.5))
    assert right["corner1.y"] == pytest.approx(left["corner2.y"], abs=1e-9)
    assert abs(right["corner1.y"] - right["corner2.y"]) > 2e-3
    curled = equilibrium(plain.with_values({"curl_x": -2.0, "gravity_y": 0.0})).outputs
    assert curled["tip.y"] == pytest.approx(-0.5 * (1.0 - np.cos(2.0 * 0.3)), rel=1e-3)

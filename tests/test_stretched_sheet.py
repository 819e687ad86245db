"""Sheets that are elastic in their plane: at rest, held at all edges, in motion, against independent solutions."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import root

import mbfmu as mb
from fmus.sheet import Sheet
from mbfmu.mechanics import Mechanism, Translational
from mbfmu.modeling.scene import load_scene
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.sheets import Support, add_sheet

PAPER = {"length": 0.3, "width": 0.21, "thickness": 0.3e-3, "youngs_modulus": 1e10, "density": 1000.0}
TIP = -108.22e-3  # m, two shell codes at rest, 51 x 35
SIDE, T, E, NU = 0.3, 1e-3, 1e10, 0.3
EDGES = ("x0", "x1", "z0", "z1")


def hanging(grid: tuple[int, int], **options: Any) -> Mechanism:
    """The sheet of the paper, held by an edge."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    sheet = add_sheet(m, "sheet", grid=grid, supports=[Support("x1")], stretch=True, **(PAPER | options))
    m.output("tip", sheet.node(0, grid[1] // 2).position("y"))
    m.output("energy", m.energy)
    return m


def plate(n: int, load: float, kind: str) -> Mechanism:
    """A square plate under a pressure of load E T^4 / SIDE^4, hinged at all edges, on n x n nodes."""
    m, supports = Mechanism(), [Support(edge, kind) for edge in EDGES]
    lift = None if kind == "pinned" else m.body("lift", m.ground, Translational(axis="y"))
    at = (0.0, 0.0, 0.0) if lift is None else (-0.5 * SIDE, 0.0, -0.5 * SIDE)
    if lift is not None:
        supports = [Support(edge, kind, at=at) for edge in EDGES]
    sheet = add_sheet(
        m, "sheet", length=SIDE, width=SIDE, thickness=T, youngs_modulus=E, poisson=NU, density=1000.0, grid=(n, n),
        supports=supports, master=lift, at=at, stretch=True, pressure=load * E * T**4 / SIDE**4,
    )  # fmt: skip
    m.output("middle", sheet.node(n // 2, n // 2).position("y"))
    return m


def von_karman(load: float, modes: int = 5, points: int = 40) -> float:
    """Deflection over thickness in the middle of the plate with edges that cannot move, by Ritz.

    Foeppl and von Karman's energy with w = sum A sin(m pi x) sin(n pi z), m and n odd, u with m even, v with
    n even; side, thickness and E are one.
    """
    s, weight = np.polynomial.legendre.leggauss(points)
    s, area = 0.5 * (s + 1.0), 0.25 * np.outer(weight, weight)

    def sine(n: int, order: int) -> Any:
        k = n * np.pi
        return (np.sin(k * s), k * np.cos(k * s), -k * k * np.sin(k * s))[order]

    def fields(pairs: Any, orders: Any) -> Any:
        return np.array([[np.outer(sine(m, x), sine(n, z)) for x, z in orders] for m, n in pairs])

    odd, even = 2 * np.arange(modes) + 1, 2 * np.arange(modes) + 2
    across = [(m, n) for m in odd for n in odd]
    W = fields(across, [(1, 0), (0, 1), (2, 0), (0, 2), (1, 1), (0, 0)])
    U = fields([(m, n) for m in even for n in odd], [(1, 0), (0, 1)])
    V = fields([(n, m) for m in even for n in odd], [(1, 0), (0, 1)])
    stiff, bent = 1.0 / (1.0 - NU**2), 1.0 / (12.0 * (1.0 - NU**2))

    def gradient(z: Any) -> Any:
        a, b, c = np.split(z, [len(W), len(W) + len(U)])
        wx, wz, wxx, wzz, wxz, _ = np.tensordot(a, W, 1)
        (ux, uz), (vx, vz) = np.tensordot(b, U, 1), np.tensordot(c, V, 1)
        ex, ez, shear = ux + 0.5 * wx**2, vz + 0.5 * wz**2, uz + vx + wx * wz
        Nx, Nz, N = stiff * (ex + NU * ez), stiff * (ez + NU * ex), 0.5 * stiff * (1.0 - NU) * shear
        Mx, Mz, M = bent * (wxx + NU * wzz), bent * (wzz + NU * wxx), 2.0 * bent * (1.0 - NU) * wxz
        by_w = np.array([Nx * wx + N * wz, Nz * wz + N * wx, Mx, Mz, M, np.full_like(M, -load)])
        parts = (by_w, W), (np.array([Nx, N]), U), (np.array([N, Nz]), V)
        return np.concatenate([np.tensordot(B, area * f, 3) for f, B in parts])

    start = np.zeros(len(W) + len(U) + len(V))
    start[0] = min(0.035 * load, 0.3 * np.cbrt(load))
    found = root(gradient, start, tol=1e-10)
    assert found.success
    return float(np.array([sine_of(m) * sine_of(n) for m, n in across]) @ found.x[: len(W)])


def sine_of(n: int) -> float:
    return float(np.sin(0.5 * n * np.pi))


def test_a_hanging_sheet_is_that_of_shell_codes() -> None:
    tips = [mb.equilibrium(hanging(grid)).outputs["tip"] for grid in ((7, 5), (15, 11))]
    assert tips[1] == pytest.approx(TIP, rel=1e-3)
    assert abs(tips[1] - TIP) < abs(tips[0] - TIP)


@pytest.mark.parametrize("load", [10.0, 100.0, 402.0])
def test_plates_whose_edges_cannot_move(load: float) -> None:
    """Within 1.2 % of von Karman on 17 x 17, and a fourth of that of 9 x 9: of second order."""
    exact = von_karman(load)
    coarse, fine = (mb.equilibrium(plate(n, load, "pinned")).outputs["middle"] / T for n in (9, 17))
    assert fine == pytest.approx(exact, rel=1.2e-2)
    assert abs(fine - exact) < 0.35 * abs(coarse - exact)


def test_a_plate_whose_edges_move_gives_way_further() -> None:
    """A small load: the linear deflection 4.06235e-3 q L^4 / D. A large one: further than where edges cannot move."""
    small = mb.equilibrium(plate(17, 0.1, "supported")).outputs["middle"] / T
    assert small == pytest.approx(4.06235e-3 * 0.1 * 12.0 * (1.0 - NU**2), rel=2e-3)
    assert mb.equilibrium(plate(9, 100.0, "supported")).outputs["middle"] / T > 1.5 * von_karman(100.0)


def test_a_release_is_that_of_shell_codes() -> None:
    """-193.29 mm after 0.25 s on 51 x 35 by a shell code; energy is kept."""
    result = mb.simulate(hanging((15, 11)), 0.25, interval=0.05, solver="esdirk", tolerance=1e-3)
    assert result["tip"][-1] == pytest.approx(-193.29e-3, abs=0.003 * 193.29e-3)
    assert np.ptp(result["energy"]) < 1e-3 * 0.0189 * 9.81 * 0.1  # m g times the fall


def test_a_free_sheet_keeps_its_momenta() -> None:
    """Thrown and spinning, without weight: the middle goes straight, at the speed it was given."""
    m = Mechanism()
    rate = (0.1, 0.2, -0.1, 3.0, 0.0, 1.0)
    sheet = add_sheet(m, "sheet", grid=(5, 5), stretch=True, tree="master", rate=rate, **PAPER)
    for axis in "xyz":
        m.output(axis, sheet.node(2, 2).position(axis))
    m.output("energy", m.energy)
    result = mb.simulate(m, 0.3, interval=0.05, solver="esdirk", tolerance=1e-4)
    start = {axis: result[axis][0] for axis in "xyz"}
    for axis, speed in zip("xyz", rate[:3], strict=True):
        assert result[axis][-1] - start[axis] == pytest.approx(0.3 * speed, abs=2e-4)
    assert np.ptp(result["energy"]) < 1e-3 * result["energy"][0]


def test_explicit_solvers_are_refused() -> None:
    with pytest.raises(mb.UserError, match=r"'adams' is explicit, .* use 'ida' or 'esdirk'"):
        mb.simulate(hanging((7, 5)), 0.01, solver="adams")
    assert mb.simulate(hanging((7, 5)), 0.01, solver="auto")["tip"][-1] < 0.0


def test_the_model_stretches_on_request() -> None:
    model = Sheet(nx=7, nz=5, stretch=True)
    assert mb.equilibrium(model).outputs["tip.y"] == pytest.approx(mb.equilibrium(hanging((7, 5))).outputs["tip"])
    held = replace(model, support="two_edges", gravity_y=0.0, pressure=0.01)
    slides, held_fast = (mb.equilibrium(replace(held, slide=slide)).outputs["middle.y"] for slide in (True, False))
    assert 0.0 < held_fast < slides
    with pytest.raises(mb.UserError, match="slide is False, which a sheet that cannot stretch does not bear"):
        mb.equilibrium(replace(held, slide=False, stretch=False))


def test_forces_in_the_plane_at_a_loose_tolerance_are_reported_once() -> None:
    """Curvatures and moments are not, nor anything at 1e-7."""
    said = r"output 'force.xx\[0,0\]' and 23 more depends .* the tolerance of 1e-05 .* Use a tolerance of 1e-07 or less"
    for field, tolerance, wanted in (
        ("force.xx", 1e-5, 1), ("strain.xz", 1e-6, 1), ("stress_top.zz", 1e-5, 1), ("force.xx", 1e-7, 0),
        ("moment.xx", 1e-5, 0), ("curvature.xz", 1e-5, 0), ("none", 1e-5, 0),
    ):  # fmt: skip
        simulation = Simulation(Sheet(nx=7, nz=5, stretch=True, field=field), Settings(tolerance=tolerance))
        told = [remark for remark in map(str, simulation.diagnostics) if "in-plane strains" in remark]
        assert len(told) == wanted, field
    result = mb.simulate(Sheet(nx=7, nz=5, stretch=True, field="force.xx"), 0.01, solver="esdirk")
    assert [remark for remark in map(str, result.diagnostics) if re.match(said, remark)]


def test_a_film_between_rails_resists_shear() -> None:
    """G t L gamma where it is long, less some of its free ends; the rail is pulled back."""
    film = Sheet(length=2.0, width=0.1, nx=41, nz=5, support="rails", stretch=True, shear=1e-6, gravity_y=0.0)
    G = film.youngs_modulus / (2.0 * (1.0 + film.poisson))
    force = mb.equilibrium(film).outputs["reaction.x"]
    assert abs(force) == pytest.approx(G * film.thickness * film.length * film.shear / film.width, rel=0.03)
    with pytest.raises(mb.UserError, match="support is 'rails', which a sheet that cannot stretch does not bear"):
        replace(film, stretch=False).build()


def test_a_sheared_film_wrinkles() -> None:
    """The scene, half way: waves at 45 degrees, as long as tension field theory has it (benchmarks/wrinkles.py)."""
    scene = load_scene("sheet/wrinkles")
    film = replace(scene.model, grid_outputs=True)
    result = mb.simulate(film, 0.2, interval=0.05, solver=scene.settings.solver, tolerance=scene.settings.tolerance)
    x = np.linspace(0.0, film.length, film.nx)
    y = np.array([result[f"node[{i},{film.nz // 2}].y"][-1] for i in range(film.nx)])
    inner = slice(film.nx // 5, film.nx - film.nx // 5)
    turns = np.flatnonzero(y[inner][:-1] * y[inner][1:] < 0.0) + inner.start
    zeros = x[turns] - y[turns] * (x[turns + 1] - x[turns]) / (y[turns + 1] - y[turns])
    B = film.youngs_modulus * film.thickness**3 / (12.0 * (1.0 - film.poisson**2))
    T = 0.5 * film.youngs_modulus * film.thickness * film.shear / film.width
    wave = 2.0 * np.sqrt(np.pi) * (B / T) ** 0.25 * np.sqrt(film.width * np.sqrt(2.0))
    assert len(zeros) >= 3
    assert 2.0 * np.diff(zeros).mean() / np.sqrt(2.0) == pytest.approx(wave, rel=0.15)
    assert not result.failure
    assert not result.warning


def test_the_model_takes_no_tree_that_stretch_does_not_follow() -> None:
    with pytest.raises(
        mb.UserError, match="tree of sheet 'sheet' is 'rows', but with stretch=True it grows from its first"
    ):
        Sheet(nx=7, nz=5, stretch=True, tree="rows").build()
    with pytest.raises(
        mb.UserError, match="tree of sheet 'sheet' is 'rows', but with stretch=True it grows from its middle"
    ):
        Sheet(nx=7, nz=5, stretch=True, tree="rows", support="free").build()


def test_what_holds_a_sheet_does_not_float() -> None:
    with pytest.raises(mb.UserError, match="and does not float; leave rate out"):
        hanging((5, 5), rate=(0.0, 0.0, 0.0, 1.0, 0.0, 0.0))


@pytest.mark.parametrize("stretch", [False, True])
@pytest.mark.parametrize("where", ["tip", "free_edge"])
def test_forces_that_inputs_set_bend_it_as_a_beam(where: str, stretch: bool) -> None:
    """F L^3 / (3 E I) at rest, a point's by some more; the support bears F."""
    model = Sheet(nx=7, nz=5, load=where, stretch=stretch, gravity_y=0.0, poisson=0.0, damping=0.1)
    F = 1e-3
    result = mb.simulate(model, 3.0, interval=1.0, solver="esdirk", tolerance=1e-4, inputs={"force.y": F})
    beam = F * model.length**3 / (3.0 * model.youngs_modulus * model.width * model.thickness**3 / 12.0)
    assert result["reaction.y"][-1] == pytest.approx(-F, rel=0.02)
    assert result["tip.y"][-1] == pytest.approx(beam, rel=0.03)
    assert np.abs(result["reaction.x"]).max() < F


def test_an_edge_that_inputs_turn_takes_the_sheet_along() -> None:
    model = Sheet(nx=7, nz=5, support="turned", gravity_y=0.0, damping=0.1)
    angle = 0.5
    result = mb.simulate(
        model, 4.0, interval=1.0, solver="esdirk", tolerance=1e-4,
        inputs={"edge.angle": lambda t: angle * (1.0 - np.exp(-4.0 * t * t))},
    )  # fmt: skip
    assert result["tip.y"][-1] == pytest.approx(-model.length * np.sin(angle), rel=0.02)
    assert result["tip.x"][-1] == pytest.approx(model.length * (1.0 - np.cos(angle)), rel=0.05)

"""Flexible sheets: what the builder makes of them, and their statics and frequencies against independent results."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from plate_oracles import (
    CLAMPED,
    FREE,
    TIP,
    bodies_at,
    cantilever,
    cylindrical,
    forces_and_tangent,
    frequencies,
    newton,
)
from random_mechanisms import Case, random_rotation
from test_complex_step import check as check_complex_step
from test_identities import close

from mbfmu.mechanics import CompiledMechanism, Floating, Harmonic, Mechanism, Revolute, Translational, Weld
from mbfmu.mechanics.arrays.rows import dependent_rows
from mbfmu.mechanics.recursions.aba import forward_dynamics
from mbfmu.mechanics.recursions.dynamics import inverse_dynamics_at_solution, update_kinematics
from mbfmu.mechanics.tangent import find_groups
from mbfmu.modeling import Model
from mbfmu.sheets import Plate, Sheet, Support, add_sheet
from mbfmu.sheets.elements.plate_energy import PLATE_SCRATCH, shape, strain
from mbfmu.steady.equilibrium import equilibrium
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import records

TREES = ["spine", "rows", "master"]
EVERYTHING = {"membrane": True, "damping": 1e-3, "drag": 0.6, "pressure": 0.4}
SMALL = {"length": 0.3, "width": 0.2, "thickness": 1e-3, "youngs_modulus": 1e9, "density": 900.0, "grid": (4, 3)}


def supports_of(tree: str) -> list[Support]:
    return [] if tree == "master" else [Support("x1")]


def case(tree: str, **effects: Any) -> Case:
    """A sheet whose numbers are of the order of one, in a random state."""
    soft = {"length": 3.0, "width": 2.0, "thickness": 0.3, "youngs_modulus": 10.0, "density": 1.0}
    m, _ = cantilever((4, 3), tree=tree, supports=supports_of(tree), **soft, **effects)
    m.output("energy", m.energy)
    compiled, rng = CompiledMechanism(m), np.random.default_rng(2)
    q, n = compiled.assembly.start_positions(), compiled.system.n
    compiled.system.apply(q, 0.2 * rng.normal(size=n))
    return Case(compiled, 0.3, q, 0.2 * rng.normal(size=n), rng.normal(size=n))


def test_a_cell_that_bends_and_twists_is_not_strained_to_third_order() -> None:
    """A chain along x with curvature kappa and a smaller twist, and straight ribs: what locked was kappa twist a^2."""

    def shear_and_stretch(size: float) -> Any:
        m, _ = cantilever((3, 3), tree="spine", membrane="xzs")
        compiled = CompiledMechanism(m)
        q = compiled.assembly.start_positions().reshape(-1, 3)
        names = [name.rsplit(".", 1)[0] for name in compiled.system.coordinate_names[::3]]
        for k, name in enumerate(names):
            if name.endswith(".1"):  # the spine runs along k = 1
                q[k] = 0.5 * size * 0.15, -size, size * size
        bodies_at(compiled, q.reshape(-1))
        strains = []
        for plate in compiled.records(Plate):
            here = records(1, PLATE_SCRATCH)
            shape(plate, compiled.data.state.bodies, here[0])
            strain(plate, here[0])
            strains.append(here["strain"][0, 9:12].copy())
        return np.abs(strains).max(axis=0)

    coarse, fine = shear_and_stretch(0.2), shear_and_stretch(0.1)
    assert (coarse < 0.2**4).all()
    assert (coarse / np.maximum(fine, 1e-16) > 14.0).all()


@pytest.mark.parametrize("tree", TREES)
@pytest.mark.parametrize("edge", ["x0", "x1", "z0", "z1"])
def test_flat_sheet_lies_where_it_is_put(tree: str, edge: str) -> None:
    at, R = np.array([0.1, -0.2, 0.3]), random_rotation(np.random.default_rng(0))
    m, sheet = cantilever((6, 5), tree=tree, supports=[Support(edge)], at=at, rotation=R)
    compiled = CompiledMechanism(m)
    bodies = bodies_at(compiled, compiled.assembly.start_positions())
    for i in range(6):
        for k in range(5):
            body = sheet.node(i, k)
            np.testing.assert_allclose(bodies["r"][body.index], at + R @ (0.06 * i, 0.0, 0.0525 * k), atol=1e-15)
            np.testing.assert_allclose(bodies["A"][body.index], R, atol=1e-15)
    held = 0 if tree == "master" else {"x": 5, "z": 6}[edge[0]]
    assert compiled.system.n == 3 * (30 - held) if held else 6 + 3 * 29
    assert len(compiled.records(Plate)) == 20
    assert sheet.nearest(0.13, 0.2) is sheet.node(2, 4)


def test_trees_follow_spine_and_rows() -> None:
    def parent(sheet: Sheet, m: Mechanism, i: int, k: int) -> str:
        return m.bodies[sheet.node(i, k).parent].name

    m, sheet = cantilever((4, 5), tree="spine")
    assert [parent(sheet, m, *n) for n in ((3, 0), (2, 2), (2, 1), (2, 0), (0, 4))] == [
        "ground", "sheet.3.2", "sheet.2.2", "sheet.2.1", "sheet.0.3",
    ]  # fmt: skip
    m, sheet = cantilever((4, 5), tree="rows")
    assert [parent(sheet, m, *n) for n in ((3, 0), (2, 2), (0, 4))] == ["ground", "sheet.3.2", "sheet.1.4"]
    m, sheet = cantilever((5, 5), tree="master", supports=[])
    assert [parent(sheet, m, *n) for n in ((2, 2), (1, 2), (4, 2), (4, 4))] == [
        "ground", "sheet.2.2", "sheet.3.2", "sheet.4.3",
    ]  # fmt: skip
    m, sheet = cantilever((3, 5), tree="rows", supports=[Support("x0", span=(0.05, 0.15))])
    assert [parent(sheet, m, *n) for n in ((0, 1), (0, 0), (0, 4), (1, 4))] == [
        "ground", "sheet.0.1", "sheet.0.3", "sheet.0.4",
    ]  # fmt: skip


def test_cells_add_up_to_the_sheet() -> None:
    """Mass, center of mass and, but for what the cells' own corners round off, inertia."""
    _, sheet = cantilever((6, 5))
    nodes = [
        (b, np.array([0.06 * i, 0.0, 0.0525 * k]) + b.com)
        for i, row in enumerate(sheet.nodes)
        for k, b in enumerate(row)
    ]
    mass = 1000.0 * 0.3e-3 * 0.3 * 0.21
    assert sum(b.mass for b, _ in nodes) == pytest.approx(mass)
    np.testing.assert_allclose(sum(b.mass * x for b, x in nodes) / mass, (0.15, 0.0, 0.105), atol=1e-15)
    about_z = sum(b.inertia[2, 2] + b.mass * (x[0] - 0.15) ** 2 for b, x in nodes)
    assert about_z == pytest.approx(mass * (0.3**2 + 0.3e-3**2) / 12.0, rel=1e-12)


@pytest.mark.parametrize("tree", TREES)
def test_articulated_body_and_complex_step_see_the_elements(tree: str) -> None:
    given = case(tree, **EVERYTHING)
    check_complex_step(given)
    data, terms = given.compiled.data, given.compiled.system.allocate_terms()
    update_kinematics(given.t, given.q, given.v, *given.compiled.kernel_data)
    assert forward_dynamics(*given.compiled.kernel_data) == 0
    a = data.state.a.copy()
    given.compiled.system.fill(given.t, given.q, given.v, terms)
    close(terms.M @ a + terms.h, np.zeros_like(a), float(np.abs(terms.h).max()))


@pytest.mark.parametrize("tree", TREES)
def test_structured_tangent_sees_elements_and_pressure(tree: str) -> None:
    """T = M + K for the exact K of inverse dynamics at rest."""
    given = case(tree, membrane=True, pressure=0.4)
    compiled, n = given.compiled, given.compiled.system.n
    K = forces_and_tangent(compiled, given.q)[1]
    inverse_dynamics_at_solution(0.0, given.q, np.zeros(n), np.zeros(n), np.zeros(0), compiled.kernel_data)
    tangent = compiled.tangent(find_groups(compiled.mechanism))
    assert tangent.factor(0.0, 1.0)
    np.testing.assert_allclose(tangent.solve(K @ given.a + tangent.inertia(given.a)), given.a, atol=1e-11)


def test_pressure_lifts_a_sheet_by_its_area() -> None:
    """On the flat sheet p times the area, on the bent one the vector area of its surface."""
    m, sheet = cantilever((6, 5), tree="master", supports=[], pressure=7.0, gravity=0.0)
    compiled = CompiledMechanism(m)
    update_kinematics(0.0, compiled.assembly.start_positions(), np.zeros(compiled.system.n), *compiled.kernel_data)
    forces = compiled.data.state.bodies["F"][[body.index for row in sheet.nodes for body in row], :3]
    np.testing.assert_allclose(forces.sum(axis=0), (0.0, 7.0 * 0.3 * 0.21, 0.0), atol=1e-15)
    inner = compiled.data.state.bodies["F"][sheet.node(2, 2).index]
    np.testing.assert_allclose(inner, (0.0, 7.0 * 0.06 * 0.0525, 0.0, 0.0, 0.0, 0.0), atol=1e-15)


@pytest.mark.parametrize("stretch", [False, True])
def test_uniform_pressure_bends_a_free_sheet_by_the_square_of_its_cells(stretch: bool) -> None:
    """Pressure acts on the nodes, and the mass of the nodes at a border is a quarter of a cell inside: the edges are
    bent by p a^2 / 8 and p b^2 / 8 per length, which goes to zero with the cells. Weight replaces inertia.
    """
    p, t, E, nu, sides = 0.1, 0.3e-3, 1e10, 0.3, np.array((0.3, 0.21))
    for n in (6, 12):
        m = Mechanism(gravity=(0.0, -p / (1000.0 * t), 0.0))
        fixed = m.body("fixed", m.ground, Weld(at=(0.0, 0.0, 0.0)))
        options: dict[str, Any] = {"stretch": True} if stretch else {"membrane": True, "tree": "master"}
        sheet = add_sheet(
            m, "s", length=sides[0], width=sides[1], thickness=t, youngs_modulus=E, poisson=nu, density=1000.0,
            grid=(n + 1, n + 1), master=fixed, pressure=p, **options,
        )  # fmt: skip
        for key in ("xx", "zz"):
            m.output(key, sheet.curvature(key, *(0.25 * sides)))
        m.output("force", fixed.joint_force("y"))
        found = equilibrium(m).outputs
        edge_x, edge_z = p * (sides / n) ** 2 / 8.0
        rigidity = E * t**3 / 12.0
        expected = np.array((edge_x - nu * edge_z, edge_z - nu * edge_x)) / rigidity
        np.testing.assert_allclose((found["xx"], found["zz"]), expected, rtol=0.01)
        assert abs(found["force"]) < 1e-9


def test_free_sheet_falls_flat() -> None:
    m, sheet = cantilever((5, 3), tree="master", supports=[])
    compiled = CompiledMechanism(m)
    q = compiled.assembly.start_positions()
    update_kinematics(0.0, q, np.zeros(compiled.system.n), *compiled.kernel_data)
    assert forward_dynamics(*compiled.kernel_data) == 0
    for row in sheet.nodes:
        for body in row:
            fall = compiled.data.state.bodies[body.index]["dY"]
            np.testing.assert_allclose(fall[:3] + m.gravity, (0.0, -9.81, 0.0), atol=1e-9)


@dataclass(frozen=True, kw_only=True)
class Cantilever(Model):
    """The reference sheet at 7 x 5."""

    name = "cantilever"
    tree: str = "spine"

    def build(self) -> Mechanism:
        m, sheet = cantilever((7, 5), tree=self.tree, membrane=True)
        m.output("tip", sheet.node(0, 2).position("y"))
        m.output("corner", sheet.node(0, 0).position("y"))
        return m


@pytest.mark.parametrize("tree", ["spine", "master"])
def test_static_tip_at_7_by_5_from_flat(tree: str) -> None:
    found = equilibrium(Cantilever(tree=tree)).outputs
    assert found["tip"] == pytest.approx(TIP, abs=0.3e-3)
    assert found["corner"] == pytest.approx(TIP, abs=0.3e-3)


@pytest.mark.parametrize(("tree", "tip"), [("spine", TIP), ("rows", -107.72e-3)])
def test_static_tip_at_15_by_11(tree: str, tip: float) -> None:
    """Rows cannot stretch one by one, so the free edges do not curl: half a millimeter stiffer."""
    grid = (15, 11)
    m, sheet = cantilever(grid, tree=tree, membrane=True)
    compiled = CompiledMechanism(m)
    q, iterations = newton(compiled, cylindrical(grid, tree == "spine"))
    bodies = bodies_at(compiled, q)
    assert iterations <= 6
    assert bodies["r"][sheet.node(0, 5).index][1] == pytest.approx(tip, abs=0.1e-3)
    assert bodies["r"][sheet.node(0, 0).index][1] == pytest.approx(tip, abs=0.1e-3)


def test_bending_alone_resists_no_gaussian_curvature() -> None:
    """It converges, to a tip 3 mm too low, and needs no help to start from flat."""
    m, sheet = cantilever((15, 11), tree="rows")
    compiled = CompiledMechanism(m)
    q, iterations = newton(compiled, np.zeros(compiled.system.n))
    assert iterations <= 6
    assert bodies_at(compiled, q)["r"][sheet.node(0, 5).index][1] == pytest.approx(-111.1e-3, abs=0.2e-3)


def test_frequencies_converge_with_second_order() -> None:
    """Flat and clamped: all trees and effects have one linear plate."""
    coarse, fine = (
        frequencies(CompiledMechanism(cantilever(g, gravity=0.0, tree="spine")[0]))[:8] / CLAMPED - 1
        for g in ((7, 5), (15, 11))
    )
    assert np.abs(fine).max() < 0.015
    assert abs(fine[0]) < 0.0005
    order = np.log(np.abs(coarse[1:] / fine[1:])) / np.log(14 / 6)
    assert order.min() > 1.9
    rows = (
        frequencies(CompiledMechanism(cantilever((7, 5), gravity=0.0, tree="rows", membrane=True)[0]))[:8] / CLAMPED - 1
    )
    np.testing.assert_allclose(rows, coarse, atol=1e-9)


def test_frequencies_of_a_free_sheet() -> None:
    found = frequencies(CompiledMechanism(cantilever((15, 11), gravity=0.0, tree="master", supports=[])[0]))
    assert np.abs(found[:6]).max() < 1e-3
    np.testing.assert_allclose(found[6:14], FREE, rtol=0.02)


def test_edges_clamped_by_cut_joints_do_as_welded_ones() -> None:
    """Flat frequencies agree; the constraints are independent in a bent position too."""
    welded = frequencies(CompiledMechanism(cantilever((7, 5), gravity=0.0)[0]))
    compiled = CompiledMechanism(cantilever((7, 5), gravity=0.0, tree="master")[0])
    np.testing.assert_allclose(frequencies(compiled)[:8], welded[:8], rtol=1e-9)
    q = compiled.assembly.start_positions()
    assert len(dependent_rows(compiled.system, 0.0, q)) == 0
    for i, name in enumerate(compiled.system.coordinate_names):
        if name.endswith("theta_z"):
            step = np.zeros(compiled.system.n)
            step[i] = 0.1
            compiled.system.apply(q, step)
    assert len(dependent_rows(compiled.system, 0.0, compiled.assembly.close(0.0, q, compiled.assembly.held()))) == 0


@pytest.mark.parametrize("tree", TREES)
def test_plate_supported_on_all_edges(tree: str) -> None:
    """Navier: f = (pi / 2) (1/L^2 + 1/W^2) sqrt(D / (rho t)); what can move in the plane alone has no stiffness."""
    edges = [Support("x0", "pinned"), *(Support(edge, "supported") for edge in ("x1", "z0", "z1"))]
    m, _ = cantilever((13, 9), gravity=0.0, tree=tree, supports=edges)
    D = 1e10 * 0.3e-3**3 / (12 * 0.91)
    exact = 0.5 * np.pi * (1 / 0.3**2 + 1 / 0.21**2) * np.sqrt(D / (1000 * 0.3e-3))
    compiled = CompiledMechanism(m)
    assert frequencies(compiled)[0] == pytest.approx(exact, rel=0.02)
    assert len(dependent_rows(compiled.system, 0.0, compiled.assembly.start_positions())) == 0


def test_pinned_edge_lets_the_sheet_swing_and_guided_edges_let_it_slide() -> None:
    def rigid(**options: Any) -> int:
        return int(np.sum(np.abs(frequencies(CompiledMechanism(cantilever((5, 4), gravity=0.0, **options)[0]))) < 1e-3))

    assert rigid(supports=[Support("z0", "pinned")]) == 1
    assert rigid(supports=[Support("x1")]) == 0
    assert rigid(tree="master", supports=[Support("z1", "pinned")]) == 1
    assert rigid(tree="master", supports=[Support("x0", "guided")]) == 3
    assert rigid(tree="master", supports=[Support("x0", "supported")]) == 4


@pytest.mark.parametrize("tree", TREES)
def test_a_driven_body_carries_an_edge_or_the_master_node(tree: str) -> None:
    m = Mechanism()
    lift = m.body("lift", m.ground, Translational(axis="y", drive=Harmonic(amplitude=0.05, frequency=2.0)))
    sway = m.body("sway", lift, Translational(axis="x", drive=0.02))
    held: dict[str, Any] = {"master": sway} if tree == "master" else {"supports": [Support("x0", body=sway)]}
    sheet = add(m, tree=tree, **held)
    compiled, t = CompiledMechanism(m), 0.07
    bodies = compiled.data.state.bodies
    update_kinematics(t, compiled.assembly.start_positions(), np.zeros(compiled.system.n), *compiled.kernel_data)
    assert compiled.system.m == 0
    expected = (0.02, 0.05 * np.sin(4.0 * np.pi * t), 0.0)
    np.testing.assert_allclose(bodies["r"][sheet.node(0, 0).index], expected, atol=1e-15)


def test_a_sheet_may_hang_between_two_bodies_of_a_mechanism() -> None:
    """A second support has another body and another place; momentum is conserved."""
    m = Mechanism()
    hub = m.body("hub", m.ground, Floating(), mass=1.0, inertia=(1.0, 1.0, 1.0))
    slide = m.body("slide", hub, Translational(axis="x", at=(0.3, 0.0, 0.0)), mass=0.5, inertia=(0.1, 0.1, 0.1))
    sheet = add(m, supports=[Support("x0", body=hub), Support("x1", "guided", body=slide, at=(-0.3, 0.0, 0.0))])
    compiled = CompiledMechanism(m)
    assert [cut.name for cut in sheet.cuts] == ["sheet.x1.0", "sheet.x1.1", "sheet.x1.2"]
    q, v = compiled.assemble()
    assert max(compiled.residuals(0.0, q, v)) < 1e-12
    assert len(dependent_rows(compiled.system, 0.0, q)) == 0


def add(m: Mechanism, **options: Any) -> Sheet:
    """A small sheet, by default clamped at x0."""
    given: dict[str, Any] = SMALL | {"supports": [Support("x0")] if options.get("tree") != "master" else []}
    return add_sheet(m, "sheet", **(given | options))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"thickness": 0.0}, r"thickness of sheet 'sheet' is 0\.0; allowed: finite and greater than zero"),
        ({"width": -0.2}, r"width of sheet 'sheet' is -0\.2"),
        ({"length": float("nan")}, "length of sheet 'sheet' is nan"),
        ({"density": float("inf")}, "density of sheet 'sheet' is inf"),
        ({"youngs_modulus": 0.0}, r"youngs_modulus of sheet 'sheet' is 0\.0"),
        ({"poisson": 1.0}, r"poisson of sheet 'sheet' is 1\.0"),
        ({"grid": (1, 1)}, r"grid of sheet 'sheet' is \(1, 1\); allowed: two whole numbers of nodes, at least 2 each"),
        ({"grid": (4, 2.5)}, r"grid of sheet 'sheet' is \(4, 2\.5\)"),
        ({"grid": 7}, "grid of sheet 'sheet' is 7"),
        (
            {"grid": (4, 2), "membrane": True},
            r"is \(4, 2\): only one row of cells across .* along z, .* at least 3 nodes along z",
        ),
        (
            {"grid": (2, 4), "membrane": True, "supports": [Support("z0")]},
            "only one row of cells across its chains, along x",
        ),
        ({"grid": (2, 4), "membrane": True, "tree": "master"}, "only one row of cells across its chains, along x"),
        ({"length": "long"}, "length of sheet 'sheet' is 'long'"),
        ({"tree": "bush"}, "tree of sheet 'sheet' is 'bush'; allowed: 'spine', 'rows', 'master'"),
        ({"joint": "ball"}, "joint of sheet 'sheet' is 'ball'; allowed: 'geodesic', 'paper'"),
        ({"supports": [Support("y0")]}, "edge of a support of sheet 'sheet' is 'y0'; allowed: 'x0', 'x1', 'z0', 'z1'"),
        ({"supports": [Support("x0", "glued")]}, "kind of the support at 'x0' of sheet 'sheet' is 'glued'; allowed"),
        ({"supports": ["x0"]}, "support of sheet 'sheet' is 'x0'; it must be a Support"),
        ({"supports": []}, "first support of sheet 'sheet' is missing; tree 'spine' grows from one"),
        ({"supports": [Support("x0", "guided")]}, "first support of sheet 'sheet' is guided"),
        ({"supports": [Support("x0", span=(0.03, 0.04))]}, r"span of the support at 'x0' .* no node lies within"),
        ({"supports": [Support("x0", span=(0.0, float("nan")))]}, "span of .* it needs two finite numbers"),
        (
            {"supports": [Support("x0"), Support("x1", "pinned")]},
            "constrain its in-plane motion twice: clamped 'x0' and pinned 'x1'; .* change one to 'guided' or "
            "'supported'",
        ),
        (
            {"supports": [Support("z0"), Support("z1")], "tree": "master"},
            "twice: clamped 'z0' and clamped 'z1'",
        ),
        ({"at": (0.0, 1.0)}, "placement of sheet 'sheet'"),
        ({"rotation": np.ones((3, 3))}, "rotation of sheet 'sheet'"),
        ({"damping": -1.0}, r"damping of sheet 'sheet' is -1\.0"),
        ({"membrane": "w"}, "membrane of sheet 'sheet' is 'w'"),
        ({"membrane": True, "joint": "paper"}, "membrane True on chains of projected length, which causes locking"),
        ({"membrane": "x", "tree": "rows", "joint": "paper"}, "which causes locking"),
        ({"membrane": 1.0}, "membrane of sheet 'sheet' is 1.0; allowed: True, False"),
        ({"stretch": "yes"}, "stretch of sheet 'sheet' is 'yes'; allowed: True, False"),
        ({"stretch": 1.0}, "stretch of sheet 'sheet' is 1.0; allowed: True, False"),
        ({"stretch": None}, "stretch of sheet 'sheet' is None; allowed: True, False"),
        (
            {"stretch": True, "tree": "rows"},
            "tree of sheet 'sheet' is 'rows', but with stretch=True it grows from its first",
        ),
        (
            {"stretch": True, "tree": "master", "supports": [Support("x0")]},
            "tree of sheet 'sheet' is 'master', but with stretch=True it grows from its",
        ),
        ({"stretch": True, "tree": "rows", "supports": []}, "'rows', but with stretch=True it grows from its middle"),
        (
            {"stretch": True, "joint": "paper"},
            "joint of sheet 'sheet' is 'paper', but with stretch=True the joints",
        ),
        (
            {"stretch": True, "membrane": "s"},
            "membrane of sheet 'sheet' is 's', but with stretch=True all in-plane strains",
        ),
        ({"grid": (True, 4)}, r"grid of sheet 'sheet' is \(True, 4\); allowed: two whole numbers"),
    ],
)
def test_mistakes_in_a_sheet_are_reported(options: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        add(Mechanism(), **options)


def test_refuses_a_master_where_there_is_none_and_strange_bodies() -> None:
    m, other = Mechanism(), Mechanism()
    hub = m.body("hub", m.ground, Floating(), mass=1.0, inertia=(1, 1, 1))
    with pytest.raises(UserError, match="its tree 'spine' has no master node"):
        add(m, master=hub)
    with pytest.raises(UserError, match="not a body of this mechanism"):
        add(other, supports=[Support("x0", body=hub)])
    sheet = add(Mechanism())
    with pytest.raises(UserError, match=r"no node \(4, 0\); its grid is \(4, 3\)"):
        sheet.node(4, 0)


def test_bending_alone_needs_no_second_row_of_cells() -> None:
    assert len(add(Mechanism(), grid=(4, 2)).nodes[0]) == 2
    assert len(add(Mechanism(), grid=(2, 3), membrane=True).nodes) == 2  # one cell along the chains is only coarse


def test_sharpest_bend_is_the_angle_of_the_joint() -> None:
    """And the advice spreads it over cells of 15 degrees."""
    m = Mechanism()
    add(m)
    compiled = CompiledMechanism(m)
    q = compiled.assembly.start_positions()
    names = compiled.system.coordinate_names
    q[names.index("sheet.2.1.theta_z")] = 0.6
    q[names.index("sheet.3.2.theta_x")] = -0.4
    accurate, valid = np.radians(15.0), np.radians(60.0)
    assert compiled.limit_ratio(0.0, q) == pytest.approx(1.0 + (0.6 - accurate) / (valid - accurate), abs=1e-12)
    assert re.fullmatch(
        r"the mesh is too coarse: adjacent cells are rotated by up to 34 deg between nodes 'sheet.1.(\d)' and "
        r"'sheet.2.\1'; "
        r"allowed: about 15 deg\. Refine the grid of 'sheet' to 8 x 5 nodes",
        compiled.describe_limit(0.0, q),
    )
    hinge = Mechanism()
    hinge.body("b", hinge.ground, Revolute(), mass=1.0, inertia=(1.0, 1.0, 1.0))
    assert CompiledMechanism(hinge).limit_ratio(0.0, np.zeros(1)) == 0.0


def test_projected_length_and_membrane_may_meet_across_rows() -> None:
    assert add(Mechanism(), tree="rows", joint="paper", membrane=True).plate.strains == "zs"
    assert add(Mechanism(), joint="paper", membrane="s").plate.strains == "s"
    assert add(Mechanism(), membrane=True).plate.strains == "xs"
    assert add(Mechanism(), membrane=True, supports=[Support("z0")]).plate.strains == "zs"

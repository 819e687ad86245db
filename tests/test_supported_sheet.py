"""Sheets held by cut joints: the structured way against the dense one, against trees, against closed forms."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plate_oracles import karman
from scipy.integrate import solve_bvp

import solvers
from fmus.sheet import Sheet
from mbfmu.fmi import Fmu, export
from mbfmu.mechanics import (
    CompiledMechanism,
    JointSpring,
    Mechanism,
    PlaneCutJoint,
    PointForce,
    Revolute,
    Spring,
    Translational,
)
from mbfmu.mechanics.arrays import systems
from mbfmu.modeling import Model, parameter
from mbfmu.session.run import run
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.sheets import Support, add_sheet
from mbfmu.sheets.supports import NORMAL_FRAME
from mbfmu.steady.equilibrium import build_problem
from mbfmu.steady.modes import shapes
from mbfmu.steady.state import Equilibrium
from mbfmu.util.errors import UserError
from solvers.projection.saddle import Accelerations, Saddle
from solvers.system import System, TreeSystem

LENGTH, WIDTH, THICKNESS, E, DENSITY = 0.3, 0.21, 0.3e-3, 1e10, 1000.0
WAYS = {
    "clamped": ("spine", [Support("x1")]),
    "master": ("master", [Support("x1")]),
    "guided": ("spine", [Support("x1"), Support("x0", "guided")]),
    "simple": ("spine", [Support("x1", "pinned"), Support("x0", "supported")]),
}


@dataclass(frozen=True, kw_only=True)
class Held(Model):
    """The paper's sheet, held in one of WAYS."""

    name = "held"
    nx: int = parameter(9, min=2)
    nz: int = parameter(7, min=2)
    way: str = parameter("guided", choices=tuple(WAYS))
    gravity: float = parameter(9.81)
    pressure: float = parameter(0.0)
    poisson: float = parameter(0.3)
    doubled: bool = parameter(False, doc="hold one node of x0 twice")

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -self.gravity, 0.0))
        tree, supports = WAYS[self.way]
        sheet = add_sheet(
            m, "sheet", length=LENGTH, width=WIDTH, thickness=THICKNESS, youngs_modulus=E, poisson=self.poisson,
            density=DENSITY, grid=(self.nx, self.nz), tree=tree, supports=supports, membrane=True,
            pressure=self.pressure,
        )  # fmt: skip
        if self.doubled:
            m.cut("again", PlaneCutJoint(rotation_a=NORMAL_FRAME, rotation_b=NORMAL_FRAME), m.ground, sheet.node(0, 1))
        m.output("middle", sheet.node(self.nx // 2, self.nz // 2).position("y"))
        m.output("corner", sheet.node(0, 0).position("y"))
        m.output("slide", sheet.node(0, self.nz // 2).position("x"))
        m.output("energy", m.energy)
        m.output("kinetic", m.kinetic_energy)
        m.output("gap", m.position_residual)
        m.output("opening", m.velocity_residual)
        return m


class Fixed(Model):
    """A mechanism that is there already."""

    name = "fixed"

    def __init__(self, mechanism: Mechanism) -> None:
        object.__setattr__(self, "mechanism", mechanism)

    def build(self) -> Mechanism:
        found: Mechanism = self.mechanism  # type: ignore[attr-defined]
        return found


def still(model: Model) -> Equilibrium:
    return build_problem(model).solve()


def dense(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every mechanism with cut joints go the dense way."""
    monkeypatch.setattr(systems, "MAX_DENSE_LOOP_COORDINATES", 10_000)


@pytest.mark.parametrize("way", ["master", "guided", "simple"])
def test_statics_are_those_of_the_dense_way(way: str, monkeypatch: pytest.MonkeyPatch) -> None:
    model = Held(way=way, gravity=9.81 if way != "simple" else 2.0)
    found = still(model)
    assert isinstance(found.compiled.system, TreeSystem)
    dense(monkeypatch)
    expected = still(model)
    assert isinstance(expected.compiled.system, System)
    for name in ("middle", "corner", "slide"):
        assert found.outputs[name] == pytest.approx(expected.outputs[name], abs=1e-11)
    np.testing.assert_allclose(found.lam, expected.lam, atol=1e-8 * np.abs(expected.lam).max())


@pytest.mark.parametrize("way", ["master", "guided"])
def test_motion_and_reactions_are_those_of_the_dense_way(way: str, monkeypatch: pytest.MonkeyPatch) -> None:
    model = Held(nx=7, nz=6, way=way)
    times = np.linspace(0.0, 0.05, 6)
    structured = run(model, Settings(tolerance=1e-6), times)
    large = Simulation(model, Settings())
    dense(monkeypatch)
    reference = run(model, Settings(tolerance=1e-7), times)
    assert isinstance(large.compiled.system, TreeSystem)
    assert not structured.failure
    scale = np.ptp(reference["middle"])
    assert np.abs(structured["middle"] - reference["middle"]).max() < 2e-3 * scale
    assert np.abs(structured["corner"] - reference["corner"]).max() < 2e-3 * max(scale, np.ptp(reference["corner"]))
    assert structured["gap"].max() < 1e-10
    assert structured["opening"].max() < 1e-10
    assert np.ptp(structured["energy"]) < 1e-2 * np.ptp(structured["kinetic"])
    small = Simulation(model, Settings())
    for expected, value in zip(small.stepper.accelerations(), large.stepper.accelerations(), strict=True):
        np.testing.assert_allclose(value, expected, atol=1e-7 * np.abs(expected).max())


def test_a_flat_sheet_may_be_clamped_to_a_slider() -> None:
    """Flat, nothing works against what holds it in its plane: rows of J are zero. A beam clamped at both ends, with
    the sides free, hangs through by q L^4 / (384 D), within Poisson's share.
    """
    m = Mechanism(gravity=(0.0, -0.1, 0.0))
    slide = m.body("slide", m.ground, Translational(axis="x", at=(LENGTH, 0.0, 0.0)), mass=0.01)
    supports = [Support("x0"), Support("x1", body=slide, at=(-LENGTH, 0.0, 0.0))]
    sheet = add_sheet(
        m, "sheet", length=LENGTH, width=WIDTH, thickness=THICKNESS, youngs_modulus=E, density=DENSITY, grid=(9, 7),
        supports=supports, membrane=True,
    )  # fmt: skip
    m.output("middle", sheet.node(4, 3).position("y"))
    m.output("energy", m.energy)
    m.output("gap", m.position_residual)
    found = still(Fixed(m))
    D = E * THICKNESS**3 / (12.0 * (1.0 - 0.09))
    load = DENSITY * THICKNESS * 0.1
    assert found.outputs["middle"] == pytest.approx(-load * LENGTH**4 / (384.0 * D), rel=0.05)
    result = run(Fixed(m), Settings(tolerance=1e-6), np.linspace(0.0, 0.02, 5))
    assert not result.failure
    assert result["middle"][-1] < -1e-5
    assert result["gap"].max() < 1e-10
    assert abs(result["energy"][-1]) < 1e-3 * load * LENGTH * WIDTH * abs(result["middle"][-1])


def test_a_regularization_that_would_damp_is_small_on_fine_grids_too() -> None:
    drift = [
        np.ptp(r["energy"]) / np.ptp(r["kinetic"])
        for r in (run(Held(nx=n, nz=5), Settings(tolerance=1e-5), np.linspace(0.0, 0.05, 11)) for n in (9, 25))
    ]
    assert max(drift) < 3e-3


def test_an_edge_clamped_by_cut_joints_is_a_clamped_edge() -> None:
    """The two trees discretize alike but for the side their joints' arcs start from."""
    gaps = []
    for nx, nz in ((9, 7), (17, 13)):
        tree, cuts = (still(Held(nx=nx, nz=nz, way=way)).outputs for way in ("clamped", "master"))
        gaps.append(abs(tree["corner"] - cuts["corner"]))
        flat = [
            [shape.mode.frequency for shape in shapes(p, p.assembly.start_positions(), 6, np.zeros(p.system.m))]
            for p in (
                CompiledMechanism(Held(nx=nx, nz=nz, way=way, gravity=0.0).build()) for way in ("clamped", "master")
            )
        ]
        np.testing.assert_allclose(flat[1], flat[0], rtol=1e-7)
    assert gaps[0] < 3e-4
    assert gaps[1] < 0.25 * gaps[0]


def test_strip_on_two_edges_bends_as_a_beam() -> None:
    """w = 5 q L^4 / (384 D) at small pressure, f = pi / (2 L^2) sqrt(D / (rho t)); nu = 0: a beam of any width."""
    D = E * THICKNESS**3 / 12.0
    errors, pitch = [], []
    for nx, nz in ((13, 5), (25, 9)):
        found = still(Held(nx=nx, nz=nz, way="simple", gravity=0.0, pressure=1e-3, poisson=0.0))
        errors.append(found.outputs["middle"] / (5.0 * 1e-3 * LENGTH**4 / (384.0 * D)) - 1.0)
        pitch.append(found.modes[0].frequency / (np.pi**2 / LENGTH**2 * np.sqrt(D / (DENSITY * THICKNESS))) - 1.0)
    assert abs(errors[1]) < 0.002
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)
    assert abs(pitch[1]) < 0.001
    assert pitch[0] / pitch[1] > 3.8


def test_modes_on_cut_joints_are_the_dense_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    model = Held(way="guided")
    found = still(model)
    frequencies = [shape.mode.frequency for shape in shapes(found.compiled, found.q, 5, found.lam)]
    dense(monkeypatch)
    expected = sorted(mode.frequency for mode in still(model).modes)[:5]
    np.testing.assert_allclose(frequencies, expected, rtol=1e-5)


def test_redundant_cut_joints_are_allowed() -> None:
    """One node held twice: it moves as held once, and the two share its reaction."""
    once, twice = still(Held()), still(Held(doubled=True))
    assert twice.outputs["middle"] == pytest.approx(once.outputs["middle"], abs=1e-11)
    names = twice.compiled.system.constraint_names
    shared = [twice.lam[names.index(name)] for name in ("sheet.x0.1.z", "again.z")]
    assert sum(shared) == pytest.approx(once.lam[once.compiled.system.constraint_names.index("sheet.x0.1.z")], rel=1e-6)
    times = np.linspace(0.0, 0.05, 3)
    settings = Settings(tolerance=1e-6)
    first, second = (run(Held(doubled=doubled), settings, times) for doubled in (False, True))
    assert not second.failure
    np.testing.assert_allclose(second["middle"], first["middle"], atol=1e-5)


def test_a_saved_run_goes_on() -> None:
    first, second = (Simulation(Held(), Settings(tolerance=1e-5)) for _ in range(2))
    first.advance(0.02)
    second.stepper.restore(first.stepper.save())
    first.advance(0.03)
    second.advance(0.03)
    np.testing.assert_allclose(first.outputs(), second.outputs().copy(), atol=1e-4)


def test_radau_reports_what_it_cannot_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solvers.steppers, "MAX_RADAU_COORDINATES", 100)
    with pytest.raises(UserError, match=r"solver 'radau' is given 168 joint coordinates and 21 constraints; .* 'ida'"):
        Simulation(Held(), Settings(solver="radau"))


def elastica(pressure: float, D: float) -> tuple[float, float]:
    """Deflection of the middle and slide of the free end of an inextensible strip on two hinges under normal pressure.

    F' = -p n, M' = F x t over the arc length, n normal to the tangent t; at s = 0 the end slides along x.
    """

    def slope(s: Any, y: Any) -> Any:
        x, _, theta, moment, along, up = y
        c, n = np.cos(theta), np.sin(theta)
        return np.array([c, n, moment / D, along * n - up * c, pressure * n, -pressure * c + 0.0 * x])

    def ends(a: Any, b: Any) -> Any:
        return np.array([a[1], a[3], a[4], b[0] - LENGTH, b[1], b[3]])

    s = np.linspace(0.0, LENGTH, 201)
    y = np.zeros((6, 201))
    y[0] = s
    for part in np.linspace(0.1, 1.0, 10):
        full, pressure = pressure, part * pressure
        found = solve_bvp(slope, ends, s, y, tol=1e-8, max_nodes=20_000)
        pressure = full
        assert found.success
        s, y = found.x, found.y
    return float(found.sol(0.5 * LENGTH)[1]), float(found.sol(0.0)[0])


def test_two_edges_under_a_large_pressure_follow_the_elastica() -> None:
    """A fifth of the span deep; nu = 0, so the strip bends to a cylinder."""
    D = E * THICKNESS**3 / 12.0
    deep, slide = elastica(25.0, D)
    assert abs(deep) > 0.2 * LENGTH
    errors = []
    for nx in (13, 25):
        found = still(Held(nx=nx, nz=5, way="simple", gravity=0.0, pressure=25.0, poisson=0.0)).outputs
        assert found["slide"] == pytest.approx(slide, rel=0.05)
        errors.append(found["middle"] / deep - 1.0)
    assert abs(errors[1]) < 0.003
    assert abs(errors[1]) < 0.4 * abs(errors[0])


@pytest.mark.parametrize(("load", "low", "high"), [(0.1, -0.005, 0.005), (1.0, -0.006, 0.0), (9.16, -0.13, -0.09)])
def test_limit_of_a_sheet_that_cannot_stretch_along_its_tree(load: float, low: float, high: float) -> None:
    """Four hinged edges, free in the plane: right while the deflection is a small part of the thickness, then stiff."""
    model = Sheet(
        nx=17, nz=17, width=LENGTH, support="all_edges", gravity_y=0.0, pressure=load * E * THICKNESS**4 / LENGTH**4
    )
    found = still(model).outputs["middle.y"] / THICKNESS
    assert low < found / karman(load) - 1.0 < high


def test_pressure_may_change_during_a_run_but_not_appear() -> None:
    model = Sheet(nx=7, nz=5, support="two_edges", pressure=0.5)
    simulation = Simulation(model, Settings(tolerance=1e-5))
    simulation.advance(0.002)
    simulation.retune(model.with_values({"pressure": 2.0}))
    assert simulation.compiled.signals(simulation.compiled.data)[0].record["c"][0] == 2.0
    assert simulation.advance(0.004).ok
    none = Simulation(model.with_values({"pressure": 0.0}), Settings())
    with pytest.raises(UserError, match="'pressure' cannot change during a run"):
        none.retune(model)


def test_karman_plate_is_navier_s_at_small_loads() -> None:
    assert karman(1e-3) / 1e-3 == pytest.approx(0.0040624 * 12.0 * (1.0 - 0.09), rel=1e-4)
    assert karman(40.0, count=5) == pytest.approx(karman(40.0, count=7), rel=1e-4)


def test_adams_and_ida_agree_on_a_small_sheet_held_by_cut_joints() -> None:
    model, times = Held(nx=5, nz=5, way="master"), np.linspace(0.0, 0.04, 5)
    explicit, implicit = (run(model, Settings(solver=name, tolerance=1e-6), times) for name in ("adams", "ida"))
    assert not explicit.failure
    assert not implicit.failure
    swing = np.ptp(explicit["corner"])
    assert np.abs(implicit["corner"] - explicit["corner"]).max() < 1e-3 * swing


def shaken(simulation: Simulation, times: Any) -> Any:
    """Corner of a sheet whose edge goes up and down by 5 mm at 8 Hz, held by its rate between the points."""
    names = [v.name for v in simulation.compiled.inputs.variables]
    tip = [v.name for v in simulation.compiled.outputs].index("corner1.y")
    found = []
    for t, after in pairwise(times):
        for name, value in zip(("edge.y", "edge.vy"), shake(t, after), strict=True):
            simulation.set_input(names.index(name), value)
        assert simulation.advance(after).ok
        found.append(float(simulation.outputs()[tip]))
    return np.array(found)


def shake(t: float, after: float) -> tuple[float, float]:
    """Where the edge is at t, m, and how fast it has to go to be right at the next point, m/s."""
    y, then = (0.005 * np.sin(2.0 * np.pi * 8.0 * s) for s in (t, after))
    return float(y), float((then - y) / (after - t))


def test_a_sheet_shaken_at_its_edge(tmp_path: Path) -> None:
    model, times = Sheet(nx=5, nz=4, support="moved"), np.linspace(0.0, 0.06, 31)
    ida, adams = (
        shaken(Simulation(model, Settings(solver=solver, tolerance=1e-6)), times) for solver in ("ida", "adams")
    )
    at_rest = run(model, Settings(tolerance=1e-6), times)["corner1.y"][1:]
    swing = np.ptp(ida - at_rest)
    assert swing > 2e-3
    assert np.abs(ida - adams).max() < 0.01 * swing
    with Fmu(export(model, tmp_path / "sheet.fmu", Settings(solver="ida", tolerance=1e-6), native=False)) as fmu:
        for (t, after), expected in zip(pairwise(times), ida, strict=True):
            fmu["edge.y"], fmu["edge.vy"] = shake(t, after)
            fmu.step_to(float(after))
            assert fmu["corner1.y"] == pytest.approx(expected, abs=1e-9)


def test_a_clamp_at_one_end_of_the_edge_twists_the_sheet() -> None:
    def corners(span: tuple[float, float]) -> tuple[float, float]:
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        sheet = add_sheet(
            m, "sheet", length=LENGTH, width=WIDTH, thickness=1e-3, youngs_modulus=E, density=DENSITY, grid=(9, 7),
            supports=[Support("x1", span=span)], membrane=True,
        )  # fmt: skip
        for k in (0, -1):
            m.output(f"corner{k}", sheet.node(0, k).position("y"))
        found = still(Fixed(mechanism=m)).outputs
        return found["corner0"], found["corner-1"]

    near, far = corners((0.0, 0.07))
    assert far < near - 2e-3
    assert corners((WIDTH - 0.07, WIDTH)) == pytest.approx((far, near), rel=1e-8)


def linearization(at: CompiledMechanism, q: Any, lam: Any) -> Any:
    """Exact derivative (n, n) of h + J^T lambda at rest, by complex step on the dense twin."""
    from mbfmu.mechanics.recursions.dynamics import gather_free, inverse_dynamics_at_solution

    twin, n = at.complex_system(), at.system.n
    K, tau = np.zeros((n, n)), np.zeros(n, complex)
    for k in range(n):
        moved, step = q.astype(complex), np.zeros(n, complex)
        step[k] = 1e-30j
        twin.apply(moved, step)
        inverse_dynamics_at_solution(
            0.0, moved, np.zeros(n, complex), np.zeros(n, complex), lam.astype(complex), twin.pinned_data
        )
        gather_free(twin.data.state.tau, twin.data.arrays, tau)
        K[:, k] = tau.imag / 1e-30
    return K


@pytest.mark.parametrize("way", ["master", "guided", "simple"])
def test_saddle_system_is_the_exact_linearization(way: str) -> None:
    """At a bent position, with reactions: [K + M, J^T; J, 0] (x, y) = (f, g)."""
    at = CompiledMechanism(Held(nx=7, nz=6, way=way).build())
    system, rng = at.system, np.random.default_rng(0)
    q = at.assembly.start_positions()
    system.apply(q, 0.05 * rng.normal(size=system.n))
    lam, x, y = 0.01 * rng.normal(size=system.m), rng.normal(size=system.n), rng.normal(size=system.m)
    K = linearization(at, q, lam)
    saddle, rest = Saddle(system), np.zeros(system.n)
    saddle.set_penalties(0.0, q)
    saddle.residual(0.0, q, rest, rest, lam)
    assert saddle.factor(0.0, 1e4)
    J = saddle.terms.J
    f = K @ x + 1e4 * system.tangent.inertia(x) + J.T @ y
    got = saddle.solve(f, J @ x)
    np.testing.assert_allclose(got[0], x, atol=1e-7)
    np.testing.assert_allclose(got[1], y, atol=1e-11 * np.abs(f).max())


def test_accelerations_obey_the_equations_of_motion() -> None:
    """M a + h + J^T lambda = 0 and J a = gamma, moving."""
    at = CompiledMechanism(Held().build())
    system, rng = at.system, np.random.default_rng(1)
    q, v = at.assembly.start_positions(), rng.normal(size=system.n)
    system.apply(q, 0.02 * rng.normal(size=system.n))
    motion = Accelerations(system)
    assert motion.solve(0.0, q, v) == 0
    force = system.residual(0.0, q, v, motion.a, motion.lam)
    assert np.abs(force).max() < 1e-9 * np.abs(motion.lam).max()
    np.testing.assert_allclose(motion.terms.J @ motion.a, motion.terms.gamma, atol=1e-8 * np.abs(motion.a).max())


def test_springs_and_forces_on_a_large_sheet_are_those_of_the_dense_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """A spring at one corner, a force at the other, a torsion spring in the hinge: the sheet hangs and twists."""

    def build() -> Mechanism:
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        hinge = m.body("hinge", m.ground, Revolute(axis="z"), mass=0.01, inertia=(1e-5, 1e-5, 1e-5))
        sheet = add_sheet(
            m, "sheet", length=LENGTH, width=WIDTH, thickness=THICKNESS, youngs_modulus=E, density=DENSITY,
            grid=(8, 5), supports=[Support("x0", body=hinge)], membrane=True,
        )  # fmt: skip
        m.force("torsion", JointSpring(stiffness=0.5), hinge, m.ground)
        at_b = (LENGTH, 0.1, 0.0)
        m.force("spring", Spring(stiffness=2.0, free=0.05, at_b=at_b), sheet.node(-1, 0), m.ground)
        m.force("pull", PointForce(magnitude=0.02, axis="z"), sheet.node(-1, -1), m.ground)
        for k in (0, -1):
            m.output(f"tip{k}", sheet.node(-1, k).position("y"))
        m.output("hinge", hinge.coordinate())
        return m

    balance = build_problem(Fixed(build()))
    found = balance.solve()
    assert isinstance(found.compiled.system, TreeSystem)
    near = found.q + 1e-7 * np.random.default_rng(0).normal(size=len(found.q))
    assert balance.solve(near).iterations <= 3  # the tangent is exact
    monkeypatch.setattr(systems, "MAX_DENSE_TREE_COORDINATES", 10_000)
    expected = still(Fixed(build()))
    assert isinstance(expected.compiled.system, System)
    assert found.outputs == pytest.approx(expected.outputs, abs=1e-9)
    assert abs(found.outputs["tip0"] - found.outputs["tip-1"]) > 1e-3
    assert found.stability == expected.stability == "undamped"
    frequencies = [[mode.frequency for mode in state.modes[:4]] for state in (found, expected)]
    assert frequencies[0] == pytest.approx(frequencies[1], rel=1e-6)

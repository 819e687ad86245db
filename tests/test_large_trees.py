"""Chains and stars of thousands of links: what groups they fall into, how they move, and what they need."""

from __future__ import annotations

import tracemalloc
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbfmu as mb
from mbfmu.mechanics import Body, JointFriction, Mechanism, Polynomial, Revolute, Spring, rod
from mbfmu.mechanics.arrays import systems
from mbfmu.mechanics.tangent import find_groups
from mbfmu.mechanics.tangent.groups import MAX_BLOCK_BODIES
from mbfmu.modeling import Model, parameter
from mbfmu.modeling.model import as_model
from mbfmu.session.run import run
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.sheets import Support, add_sheet
from mbfmu.steady.equilibrium import build_problem
from mbfmu.util.errors import EquilibriumError, UserError


@dataclass(frozen=True, kw_only=True)
class Links(Model):
    """Chains of equal rods, 1 m long together, that hang side by side on a pivot, stretched out at first."""

    name = "links"
    links: int = parameter(300, min=1)
    chains: int = parameter(1, min=1)

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        for k in range(self.chains):
            hang(m, m.ground, self.links, -0.3 - 0.01 * k, f"{k}.")
        m.output("energy", m.energy)
        return m


def hang(m: Mechanism, body: Body, links: int, start: float, prefix: str) -> None:
    """Add one chain."""
    each = 1.0 / links
    for i in range(links):
        joint = Revolute(at=(each if i else 0.0, 0.0, 0.0), start=0.0 if i else start)
        body = m.body(f"{prefix}{i}", body, joint, **rod(mass=each, length=each))


def absolute(angles: Any, rates: Any) -> Any:
    """Accelerations of the links' angles from the horizontal: Lagrange's equations in absolute angles."""
    n, k = len(angles), np.arange(len(angles))
    beyond = n - 1 - np.maximum.outer(k, k)
    C = (beyond + 0.5 - np.eye(n) / 6.0) / n**3  # m l^2 = 1 / n^3; on the diagonal 1/3 + beyond
    difference = np.subtract.outer(angles, angles)
    load = 9.81 * (n - 1 - k + 0.5) / n**2 * np.cos(angles)
    return -np.linalg.solve(C * np.cos(difference), (C * np.sin(difference)) @ rates**2 + load)


@pytest.mark.parametrize("solver", ["ida", "adams", "esdirk"])
def test_accelerations_are_those_of_lagranges_equations(solver: str) -> None:
    simulation = Simulation(Links(), Settings(solver=solver))
    rng = np.random.default_rng(0)
    q, v = np.array([-0.3, *0.05 * rng.normal(size=299)]), rng.normal(size=300)
    stepper: Any = simulation.stepper
    stepper._q[:], stepper._v[:] = q, v
    expected = absolute(np.cumsum(q), np.cumsum(v))
    np.testing.assert_allclose(np.cumsum(stepper.accelerations()[0]), expected, atol=1e-9 * np.abs(expected).max())


def test_a_chain_falls_according_to_lagranges_equations() -> None:
    """The links jitter; ida's error is that of order two, in proportion to rtol to the power 2/3."""
    n = systems.MAX_DENSE_TREE_COORDINATES + 1
    start = np.concatenate((np.full(n, -0.3), np.zeros(n)))
    true = solve_ivp(
        lambda t, y: np.concatenate((y[n:], absolute(y[:n], y[n:]))), (0.0, 0.3), start, rtol=1e-9, atol=1e-9
    ).y[:n, -1]

    def error(solver: str, tolerance: float) -> float:
        simulation = Simulation(Links(links=n), Settings(solver=solver, tolerance=tolerance))
        assert simulation.advance(0.3).ok
        return float(np.abs(np.cumsum(simulation.stepper.q) - true).max())

    assert error("adams", 1e-8) < 1e-7
    loose, tight = error("ida", 1e-5), error("ida", 1e-8)
    assert loose < 1e-2
    assert tight < 1e-3 ** (2.0 / 3.0) * 3.0 * loose


@pytest.mark.parametrize("mass", [1e-3, 1.0, 1e3, 1e6])
def test_point_masses_fall_according_to_lagranges_equations_in_any_unit(mass: float) -> None:
    """Masses at the ends of links of 1 m, horizontal at the start: the links have no inertia about their centers."""
    n = systems.MAX_DENSE_TREE_COORDINATES + 1
    m, beyond = Mechanism(gravity=(0.0, -9.81, 0.0)), n - np.arange(n)
    body = m.ground
    for i in range(n):
        joint = Revolute(at=(1.0 if i else 0.0, 0.0, 0.0))
        body = m.body(f"{i}", body, joint, mass=mass, com=(1.0, 0.0, 0.0))

    def slope(t: float, y: Any) -> Any:
        angles, rates = np.split(y, 2)
        difference, C = np.subtract.outer(angles, angles), np.minimum.outer(beyond, beyond)
        load = (C * np.sin(difference)) @ rates**2 + 9.81 * beyond * np.cos(angles)
        return np.concatenate((rates, -np.linalg.solve(C * np.cos(difference), load)))

    true = solve_ivp(slope, (0.0, 0.1), np.zeros(2 * n), rtol=1e-9, atol=1e-11).y[:n, -1]
    simulation = Simulation(m, Settings(solver="ida", tolerance=1e-6))
    assert simulation.advance(0.1).ok
    assert simulation.statistics.steps < 100
    np.testing.assert_allclose(np.cumsum(simulation.stepper.q), true, atol=1e-5)


@pytest.mark.parametrize("solver", ["ida", "adams", "hybrid", "adams-lu", "esdirk"])
def test_five_thousand_links_run_under_every_solver(solver: str) -> None:
    simulation = Simulation(Links(links=5000), Settings(solver=solver, tolerance=1e-4))
    energy = float(simulation.outputs()[0])
    assert simulation.advance(2e-2 if solver == "ida" else 1e-4).ok
    assert abs(simulation.outputs()[0] - energy) < 1e-2 * 9.81  # of the weight times the length


def test_fifty_chains_of_a_hundred_links_run() -> None:
    simulation = Simulation(Links(links=100, chains=50), Settings(tolerance=1e-4))
    assert simulation.advance(2e-2).ok
    assert simulation.statistics.rhs_evals < 200


def test_memory_grows_with_the_links_and_not_with_their_square() -> None:
    """Factors and all: a dense matrix of 3000 links alone would take 72 MB."""
    tracemalloc.start()
    simulation = Simulation(Links(links=3000), Settings(tolerance=1e-4))
    simulation.advance(1e-4)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 50e6


@pytest.mark.parametrize(("links", "chains"), [(1000, 1), (100, 20)])
def test_groups_are_blocks_that_form_a_tree(links: int, chains: int) -> None:
    m = Mechanism()
    hub = m.body("hub", m.ground, Revolute(), mass=1.0, inertia=(1.0, 1.0, 1.0))
    for k in range(chains):
        hang(m, hub, links, 0.0, f"{k}.")
    groups = find_groups(m)
    sizes = np.bincount(groups.of[1:])
    assert sizes.max() <= MAX_BLOCK_BODIES
    assert len(sizes) < 2.0 * links * chains / MAX_BLOCK_BODIES
    assert (groups.inward[:-1] > np.arange(len(sizes) - 1)).all()
    assert groups.inward[-1] == -1
    for body in m.bodies[2:]:
        own, parents = groups.of[body.index], groups.of[body.parent]
        assert parents in (own, groups.inward[own])


def clamped(stiffness: float, grid: tuple[int, int] = (9, 7)) -> Mechanism:
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    add_sheet(
        m, "sheet", length=0.3, width=0.2, thickness=1e-3, youngs_modulus=stiffness, density=900.0,
        grid=grid, supports=[Support("x1")], membrane=True,
    )  # fmt: skip
    return m


@pytest.mark.parametrize(
    ("grid", "message"), [((5, 3), "a value that is not finite"), ((6, 5), "nothing resists a motion")]
)
def test_numbers_out_of_all_proportion_end_in_a_message(grid: tuple[int, int], message: str) -> None:
    """The small sheet is solved with dense matrices of complex numbers."""
    with pytest.raises(EquilibriumError, match=message), np.errstate(all="ignore"):
        build_problem(as_model(clamped(1e-300, grid))).solve()


def test_the_stiffest_sheet_bends_in_proportion() -> None:
    stiff, stiffest = (np.abs(build_problem(as_model(clamped(E))).solve().q).max() for E in (1e20, 1e300))
    assert stiffest * 1e280 == pytest.approx(stiff, rel=1e-6)


@pytest.mark.parametrize("solver", ["ida", "adams", "hybrid", "adams-lu", "esdirk"])
def test_what_is_driven_alone_runs_under_every_solver(solver: str) -> None:
    class Driven(Model):
        name = "driven"

        def build(self) -> Mechanism:
            m = Mechanism()
            arm = m.body("arm", m.ground, Revolute(drive=Polynomial((0.0, 2.0))), **rod(mass=1.0, length=1.0))
            m.output("angle", arm.angle())
            return m

    result = run(Driven(), Settings(solver=solver), np.array([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(result["angle"], (0.0, 1.0, 2.0), atol=1e-14)


def everything_tied() -> Mechanism:
    """Chains of links, each tied to the first one."""
    m = Mechanism()
    hang(m, m.ground, 100, 0.0, "link")
    for k in range(2, 100):
        m.force(f"spring{k}", Spring(stiffness=1.0), m.bodies[1], m.bodies[k])
    return m


def test_what_ties_everything_to_everything_is_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(systems, "MAX_GROUP_BODIES", 50)
    with pytest.raises(UserError, match=r"joints, forces and elements connect 9\d bodies, 'link98' among them"):
        Simulation(everything_tied(), Settings(solver="ida"))


@pytest.mark.parametrize("states", [False, True])
def test_explicit_solvers_do_not_solve_everything_at_once(states: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(systems, "MAX_GROUP_BODIES", 50)
    m = everything_tied()
    if states:
        m.force("friction", JointFriction(coulomb=1.0, deflection=0.1), m.bodies[1])
    assert Simulation(m, Settings(solver="adams")).advance(1e-3).ok


def test_short_loads_are_not_missed_by_adams() -> None:
    """A triangular pulse of 1 N s moves 1 kg at 1 m/s. Its short steps had errors of up to 0.3 m/s at a high order."""
    for begin in (0.31, 0.73, 1.14, 1.56):
        m = Mechanism()
        cart = m.body("cart", m.ground, mb.Translational(axis="x", nominal=1.0), mass=1.0)
        pulse = mb.Table([0, begin, begin + 1e-5, begin + 2e-5, 5], [0, 0, 1e5, 0, 0], "linear")
        m.force("pulse", mb.JointForce(pulse), cart)
        for k in range(60):
            mass = m.body(f"mass{k}", m.ground, mb.Translational(axis="y", start=0.1 - 0.003 * k), mass=1.0)
            m.force(f"spring{k}", mb.JointSpring(stiffness=1.0 + 0.5 * k), mass)
        m.output("rate", cart.rate())
        found = mb.simulate(m, 2.0, interval=0.2, solver="adams")
        assert found["rate"][-1] == pytest.approx(1.0, abs=5e-5)

"""IDA on sheets in contact: its products are exact, its weights make one coordinate count, closed forms come out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.mechanics import (
    CompiledMechanism,
    Floating,
    Gear,
    Mechanism,
    PointForce,
    Revolute,
    RunUp,
    SphericalCutJoint,
    Torque,
    Translational,
)
from mbfmu.sheets import Support, Wall, add_contact, add_nip, add_sheet
from solvers.compiled.kernel import COMPILED
from solvers.steppers.ida import tree
from solvers.steppers.ida.tree_callbacks import evaluate_residual, multiply_matrix

from .strips import CLAMP, DENSITY, LENGTH, RADIUS, THICKNESS, WIDTH, add_channel, add_driven, add_strip, run, sliding

pytestmark = pytest.mark.skipif(not COMPILED, reason="ida takes kernels for callbacks in contact")

PAPER: dict[str, Any] = {"thickness": 1e-4, "youngs_modulus": 4e9, "density": 800.0, "damping": 5e-4}


def crowded() -> Mechanism:
    """A sheet on a table in a nip whose roller turns freely, geared to a crank, and a triangle of links."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    at, tree = (0.0, -2e-5, 0.0), "master"
    sheet = add_sheet(m, "s", length=0.2, width=0.1, grid=(7, 5), tree=tree, membrane=True, at=at, **PAPER)
    free = m.body("roller", m.ground, Revolute(at=(0.13, -0.01, 0.05)), mass=0.1, inertia=(1e-5, 1e-5, 1e-5))
    nip = add_nip(m, "nip", sheet, free, radius=0.01, at=(0.13, 0.0, 0.05), width=0.04, force=1.5)
    add_contact(m, "table", sheet, Wall(at=(0.0, -6e-5, 0.0)), friction=0.3)
    crank = m.body("crank", m.ground, Revolute(at=(0.3, 0.0, 0.0)), mass=0.1, com=(0.05, 0.0, 0.0))
    m.couple("gear", Gear(ratio=-2.0), free, crank)
    rod = m.body("rod", crank, Revolute(at=(0.1, 0.0, 0.0)), mass=0.1, com=(0.05, 0.01, 0.0))
    ball = m.body("ball", m.ground, Floating(at=(0.5, 0.0, 0.0)), mass=0.1, inertia=(1e-4, 2e-4, 3e-4))
    m.cut("pin", SphericalCutJoint(at_a=(0.1, 0.0, 0.0)), rod, ball)
    m.output("slip", nip.slip())
    return m


def test_products_are_derivatives_of_the_residual() -> None:
    """With contact, friction, cut joints, couplings, quaternions; against central differences of small steps."""
    compiled = CompiledMechanism(crowded())
    system, random = compiled.system, np.random.default_rng(1)
    q, v = compiled.assemble()
    assert system.m == 4
    stepper = tree.TreeIDAStepper(system, 0.0, q, v)
    problem, N, c = stepper.integration, len(stepper._ida.y), 3e3
    rates = slice(system.nq, system.nq + system.n)
    y, slopes, product = (random.normal(size=N) for _ in range(3))
    y[: system.nq], y[rates] = q, 1e-3 * y[rates]
    above, below = np.zeros(N), np.zeros(N)
    x = 1e-10 * random.normal(size=N)  # at 1e-9 points of the sheet begin to touch
    multiply_matrix(0.0, y, slopes, x, c, product, problem)
    evaluate_residual(0.0, y + x, slopes + c * x, above, problem)
    evaluate_residual(0.0, y - x, slopes - c * x, below, problem)
    for rows in (slice(0, system.nq), rates, slice(-2 * system.m, None)):
        found, known = product[rows], 0.5 * (above - below)[rows]
        assert np.abs(found - known).max() < 1e-5 * np.abs(known).max() > 0.0


def test_the_library_that_takes_products_must_be_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tree, "is_library_supported", lambda: False)
    compiled = CompiledMechanism(crowded())
    with pytest.raises(ValueError, match=r"^solver 'ida' .* SUNDIALS 7 .*contact forces .* use 'esdirk' "):
        tree.TreeIDAStepper(compiled.system, 0.0, *compiled.assemble())


def test_a_strip_that_is_fed_falls_as_the_elastica_does() -> None:
    """Fed at 1 m/s from rest; the tip (mm) from Lagrange's equations of a strip with a moving end."""
    m, speed = Mechanism(gravity=(0.0, -9.81, 0.0)), 1.0
    sheet = add_strip(m, 37, 0.05)
    add_driven(m, "nip", sheet, RunUp(speed=-speed / RADIUS, duration=0.04))
    add_channel(m, sheet)
    for axis in "xy":
        m.output(axis, sheet.node(-1, 1).position(axis))
    m.output("tail", sheet.node(0, 1).position("x"))
    found = run(m, 0.221, 1e-3, solver="ida")
    out = LENGTH + found["tail"] - CLAMP
    for length, tip in ((0.15, (144.893, -36.458)), (0.25, (207.286, -132.021))):
        x, y = (1e3 * np.interp(length, out, found[axis]) for axis in "xy")
        assert np.hypot(x - 1e3 * CLAMP - tip[0], y - tip[1]) < 0.5  # as esdirk: the mesh's


@pytest.mark.parametrize("share", [0.2, 0.6, 0.9])
def test_under_a_load_a_nip_creeps(share: float) -> None:
    m = Mechanism()
    sheet = add_strip(m, 19, 0.1)
    nip, _ = add_driven(m, "nip", sheet, RunUp(speed=0.0, duration=1.0), force=0.2)
    m.force("pull", PointForce(magnitude=share * 0.2, axis="x"), sheet.node(-1, 1))
    m.output("slip", nip.slip())
    found = run(m, 0.05, 0.05, solver="ida")
    assert found["slip"][-1] == pytest.approx(1e-3 * sliding(share), rel=2e-2)


@pytest.mark.parametrize("size", [1e-2, 1.0, 1e2])
def test_a_thrown_sheet_slides_as_far_as_friction_allows(size: float) -> None:
    """v^2 / (2 mu g), at any size: lengths by it, speeds by its root, modulus so that it bends as much."""
    m, v = Mechanism(gravity=(0.0, -9.81, 0.0)), 0.5 * np.sqrt(size)
    paper = PAPER | {"thickness": 1e-4 * size, "youngs_modulus": 4e9 * size, "damping": 5e-4 * np.sqrt(size)}
    sheet = add_sheet(
        m, "s", length=0.297 * size, width=0.21 * size, grid=(9, 7), tree="master", membrane=True,
        at=(0.0, -4e-6 * size, 0.0), rate=(v, 0.0, 0.0, 0.0, 0.0, 0.0), **paper,
    )  # fmt: skip
    wall = Wall(at=(0.0, -5e-5 * size, 0.0))
    given = {"stiffness": 2e6, "depth": 2e-5 * size, "creep": 1e-3 * np.sqrt(size)}
    add_contact(m, "table", sheet, wall, friction=0.3, **given)
    m.output("x", sheet.node(4, 3).position("x"))
    last = 0.25 * np.sqrt(size)
    found = mb.simulate(m, last, interval=0.01 * last, solver="ida", tolerance=1e-5)
    assert found["x"][-1] - found["x"][0] == pytest.approx(v**2 / (2.0 * 0.3 * 9.81), rel=5e-3)


def test_a_held_sheet_rests_where_the_table_bears_it() -> None:
    """Clamped at its left 1 mm above a table without friction; all of its coordinates are the mesh's."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    held = {"tree": "spine", "supports": [Support("x0", "clamped")]}
    sheet = add_sheet(m, "s", length=0.2, width=0.1, grid=(11, 5), at=(0.0, 1e-3, 0.0), **(PAPER | held))
    add_contact(m, "table", sheet, Wall(at=(0.0, 0.0, 0.0)), damping=5.0)
    m.output("y", sheet.node(-1, 2).position("y"))
    found = run(m, 0.6, 0.1, 1e-5, "ida")
    assert found["y"][-1] == pytest.approx(5e-5, abs=5e-6)  # half the thickness less what it sinks in


@pytest.mark.parametrize(
    ("solver", "tolerance", "size"),
    [("ida", 1e-3, 1.0), ("ida", 1e-5, 1.0), ("esdirk", 1e-3, 1.0), ("ida", 1e-3, 1e-3), ("ida", 1e-3, 1e3)],
)
def test_torques_drive_a_sheet_through_free_rollers(solver: str, tolerance: float, size: float) -> None:
    """A4 on a table in two nips of rollers as heavy as it, which torques drive: all of it moves as one mass.

    At any size: lengths by it, times by its root, forces by its cube.
    """
    R, inertia, torque, mu = 0.01 * size, 2.5e-6 * size**5, 1e-3 * size**4, 0.3
    m, mass, pace = Mechanism(gravity=(0.0, -9.81, 0.0)), 0.297 * 0.21 * 1e-4 * 800.0 * size**3, np.sqrt(size)
    paper = PAPER | {"thickness": 1e-4 * size, "youngs_modulus": 4e9 * size, "damping": 5e-4 * pace}
    paper |= {"length": 0.297 * size, "width": 0.21 * size, "tree": "master", "membrane": True}
    sheet = add_sheet(m, "s", grid=(9, 7), at=size * np.array((-0.2, -5e-6, -0.105)), **paper)
    table = Wall(at=(0.0, -5e-5 * size, 0.0))
    add_contact(m, "table", sheet, table, friction=mu, creep=1e-3 * pace, damping=1.0 / pace)
    for k, z in enumerate((-0.05 * size, 0.05 * size)):
        axle = Revolute(at=(0.0, -R, z))
        roller = m.body(f"roller{k}", m.ground, axle, mass=0.05 * size**3, inertia=(inertia,) * 3)
        nip = {"radius": R, "at": (0.0, 0.0, z), "width": 0.02 * size, "force": 2.0 * size**3, "least": 1e-3 * pace}
        add_nip(m, f"nip{k}", sheet, roller, **nip)  # type: ignore[arg-type]
        m.force(f"motor{k}", Torque(magnitude=-torque, axis="z"), roller)
    m.output("v", sheet.node(4, 3).velocity("x"))
    found = run(m, 0.1 * pace, 0.05 * pace, tolerance, solver)
    a = (2.0 * torque / R - mu * mass * 9.81) / (mass + 2.0 * inertia / R**2)
    assert found["v"][-1] == pytest.approx(0.1 * pace * a, rel=5e-3)  # nips bear some of what the table should


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5])
def test_a_sheet_that_runs_into_a_free_roller_shares_its_momentum(tolerance: float) -> None:
    """A strip at 0.3 m/s in a nip whose roller rests, heavier than it: both go on at one speed."""
    m, v, inertia = Mechanism(), 0.3, 4e-7
    sheet = add_strip(m, 19, 0.1, rate=(v, 0.0, 0.0, 0.0, 0.0, 0.0))
    axle = Revolute(at=(0.0, -RADIUS, 0.0))
    roller = m.body("roller", m.ground, axle, mass=0.1, inertia=(inertia,) * 3)
    add_nip(m, "nip", sheet, roller, radius=RADIUS, at=(0.0, 0.0, 0.0), width=WIDTH, force=1.0)
    m.output("v", sheet.node(9, 1).velocity("x"))
    m.output("rate", roller.rate())
    found = run(m, 0.05, 0.01, tolerance, "ida")
    mass = LENGTH * WIDTH * THICKNESS * DENSITY
    together = mass * v / (mass + inertia / RADIUS**2)
    assert found["v"][-1] == pytest.approx(together, rel=1e-2)
    assert -RADIUS * found["rate"][-1] == pytest.approx(together, rel=1e-2)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5])
def test_a_roller_on_a_free_carriage_keeps_the_momentum_of_all(tolerance: float) -> None:
    """A torque turns it, the strip goes one way and the carriage the other, and the work is their energy."""
    m, inertia, torque = Mechanism(), 1e-5, 2e-3
    sheet = add_strip(m, 19, 0.1)
    carriage = m.body("carriage", m.ground, Translational(axis="x"), mass=0.001)
    axle = Revolute(at=(0.0, -RADIUS, 0.0))
    roller = m.body("roller", carriage, axle, mass=0.1, inertia=(inertia,) * 3)
    add_nip(m, "nip", sheet, roller, radius=RADIUS, at=(0.0, 0.0, 0.0), width=WIDTH, force=2.0)
    m.force("motor", Torque(magnitude=-torque, axis="z"), roller)
    m.output("v", sheet.node(9, 1).velocity("x"))
    m.output("carriage", carriage.velocity("x"))
    found = run(m, 0.05, 0.01, tolerance, "ida")
    mass = LENGTH * WIDTH * THICKNESS * DENSITY
    # rolling: R w = v - u, mass v + 0.101 u = 0, inertia w' = torque - R F, mass v' = F
    a = torque / RADIUS / (mass + inertia / RADIUS**2 * (1.0 + mass / 0.101))
    assert found["v"][-1] == pytest.approx(0.05 * a, rel=2e-3)
    assert 0.101 * found["carriage"][-1] == pytest.approx(-mass * found["v"][-1], rel=1e-3)

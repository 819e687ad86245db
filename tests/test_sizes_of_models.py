"""The table of sizes in the glossary states how solvers integrate models of every line, and which they refuse."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbfmu as mb
import solvers.steppers
from mbfmu.mechanics import CompiledMechanism
from solvers.steppers import describe_refusal, stepper
from solvers.system import AnySystem

PAGE = Path(__file__).parents[1] / "docs/glossary.md"
TABLES = {
    "SOLVERS": "dense",
    "TREE_SOLVERS": "recursions",
    "UNCONSTRAINED_SOLVERS": "recursions",
    "ELIMINATION_SOLVERS": "recursions",
    "IMPLICIT_ELIMINATION_SOLVERS": "recursions",
}


def wheels(n: int, gears: int = 0, lags: int = 0) -> tuple[mb.Mechanism, list[Any]]:
    """``n`` wheels, pairs of which gears couple, and filters of their angles."""
    m = mb.Mechanism()
    bodies = [m.body(f"wheel{k}", m.ground, mb.Revolute(), mass=1.0, inertia=(1, 1, 1)) for k in range(n)]
    for k in range(gears):
        m.couple(f"gear{k}", mb.Gear(ratio=2.0), bodies[2 * k], bodies[2 * k + 1])
    for k in range(lags):
        m.lag(f"lag{k}", bodies[k % n].angle(), time_constant=0.1)
    return m, bodies


def with_flexible_body(n: int) -> mb.Mechanism:
    m, bodies = wheels(n)
    beam = mb.Beam(length=2.0, mass=3.0, bending_stiffness=400.0, modes=2, ends=("clamped", "free"))
    m.flexible_body("arm", bodies[0], mb.Revolute(), beam)
    return m


def with_reaction(n: int) -> mb.Mechanism:
    m, bodies = wheels(n)
    m.force("bearing", mb.JointFriction(coulomb=0.1, normal_force=mb.Reaction(radius=0.01)), bodies[0])
    return m


def with_friction_of_joints(n: int) -> mb.Mechanism:
    """More than 200 states, all of friction of joints."""
    m = mb.Mechanism()
    shape: dict[str, Any] = {"mass": 1.0, "inertia": (1, 1, 1)}
    elements = [
        (mb.Revolute(), mb.JointFriction(coulomb=0.1)),
        (mb.Spherical(), mb.SphericalFriction(coulomb=0.1)),
        (mb.Cylindrical(), mb.CylindricalFriction(coulomb=0.1, radius=0.1)),
        (mb.Planar(), mb.PlanarFriction(coulomb=0.1)),
    ]
    for k in range(n):
        joint, friction = elements[k % 4]
        m.force(f"friction{k}", friction, m.body(f"body{k}", m.ground, joint, **shape))
    return m


def with_friction_of_points(n: int) -> mb.Mechanism:
    m, bodies = wheels(n)
    seal = mb.LineFriction(coulomb=1.0, at_a=(0, 1, 0), at_b=(0.1, 0, 0))
    for k in range(201):
        m.force(f"seal{k}", seal, m.ground, bodies[k % n])
    return m


LINES: dict[str, list[Callable[[], mb.Mechanism]]] = {
    "n up to 60": [lambda: wheels(60)[0], lambda: wheels(60, gears=2)[0], lambda: wheels(59, lags=1)[0]],
    "n above 60 and one of: no loops; m above 30; n above 100 and no first-order states": [
        lambda: wheels(61)[0],
        lambda: wheels(60, lags=1)[0],
        lambda: wheels(5, lags=200)[0],
        lambda: with_friction_of_joints(120),
        lambda: wheels(62, gears=31)[0],
        lambda: wheels(101, gears=31)[0],
        lambda: wheels(62, gears=31, lags=1)[0],
        lambda: wheels(101, gears=1)[0],
        lambda: wheels(101, gears=30)[0],
    ],
    "n above 60, others": [
        lambda: wheels(61, gears=1)[0],
        lambda: wheels(100, gears=30)[0],
        lambda: wheels(101, gears=30, lags=1)[0],
        lambda: with_flexible_body(61),
        lambda: with_flexible_body(101),
        lambda: wheels(61, lags=201)[0],
        lambda: wheels(62, gears=31, lags=201)[0],
        lambda: with_friction_of_points(61),
    ],
    "n above 60, friction in proportion to reactions": [lambda: with_reaction(61), lambda: with_reaction(101)],
}


def method(name: str, system: AnySystem) -> str:
    """Return how a solver integrates a system; the solvers are replaced by the entries of the table."""
    return "refused" if describe_refusal(name, system) else str(stepper(name, system, 0.0, np.zeros(0), np.zeros(0)))


def stated() -> dict[str, dict[str, str]]:
    """Return the entries of the table by its lines and the names of solvers."""
    text = PAGE.read_text().partition("## Size of models and solvers")[2]
    head, _, *lines = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("|")]
    found = {}
    for what, *entries in lines:
        columns = zip(head[1:], entries, strict=True)
        found[re.sub(r"\[(.*?)\]\(.*?\)", r"\1", what)] = {
            name: entry for heads, entry in columns for name in re.findall(r"`(.*?)`", heads)
        }
    return found


@pytest.fixture
def named_methods(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the solvers by how they work."""
    for table, how in TABLES.items():
        names = getattr(solvers.steppers, table)
        monkeypatch.setattr(solvers.steppers, table, {name: lambda *_, how=how: how for name in names})


def test_every_line_of_the_table_is_tested() -> None:
    assert list(stated()) == list(LINES)


@pytest.mark.parametrize("line", LINES)
@pytest.mark.usefixtures("named_methods")
def test_solvers_work_as_the_table_states(line: str) -> None:
    expected = stated()[line]
    for make in LINES[line]:
        system = CompiledMechanism(make()).system
        assert {name: method(name, system) for name in expected} == expected, (system.n, system.m)


@pytest.mark.usefixtures("named_methods")
def test_limits_of_dense_matrices() -> None:
    """``radau`` above 200 coordinates; dense matrices above 1000 with loops and first-order states, recursions not."""
    systems = {
        (gears, lags): CompiledMechanism(wheels(1001, gears, lags)[0]).system
        for gears, lags in ((0, 0), (0, 1), (30, 1), (31, 1))
    }
    found = {key: [method(name, system) for name in ("ida", "esdirk", "radau")] for key, system in systems.items()}
    assert found == {
        (0, 0): ["recursions", "recursions", "refused"],
        (0, 1): ["recursions", "recursions", "dense"],
        (30, 1): ["refused", "refused", "refused"],
        (31, 1): ["recursions", "recursions", "refused"],
    }

"""Steady states with supports that have moved: strips, against an elastica under gravity (SciPy), and masses on springs
that are compressed, in closed form. Every use of a steady state finds the same one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_bvp

import mbfmu as mb
from mbfmu.fmi import export
from mbfmu.modeling.settings import Settings
from mbfmu.native.data import native_model
from mbfmu.session.simulation import Simulation
from mbfmu.steady.equilibrium import build_problem, find_state
from mbfmu.steady.sweep import sweep
from mbfmu.studies.settling import settle
from mbfmu.util.diagnostics import without_details

LENGTH, WIDTH, THICKNESS, E, DENSITY = 0.3, 0.02, 5e-5, 4e9, 1000.0


def strip(
    moved: float, gravity: float, size: float = 1.0, thickness: float = THICKNESS, drive: Any = None
) -> mb.Mechanism:
    """A strip clamped at both ends, of which one has moved in; ``size`` scales lengths."""
    m = mb.Mechanism(gravity=(0.0, -gravity, 0.0))
    step = mb.Step(height=-moved * size, begin=0.0, duration=0.5)
    body = m.body("moved", m.ground, mb.Translational(axis="x", drive=drive or step))
    sheet = mb.add_sheet(
        m, "strip", length=LENGTH * size, width=WIDTH * size, thickness=thickness * size, youngs_modulus=E, poisson=0.0,
        density=DENSITY, grid=(21, 2), stretch=True, supports=[mb.Support("x0"), mb.Support("x1", body=body)],
    )  # fmt: skip
    m.output("sag", sheet.node(10, 0).position("y"))
    return m


def sag(moved: float, gravity: float, thickness: float = THICKNESS) -> float:
    """Deflection of the middle of an inextensible strip: half of it, from the clamp to where it is level again."""
    D, weight = E * thickness**3 / 12.0, DENSITY * thickness * gravity
    half = 0.5 * LENGTH

    def slope(s: Any, y: Any, p: Any, share: float) -> Any:
        _, _, angle, moment = y
        shear = weight * (half - s)  # less the vertical force in the strip; p: the horizontal one
        return np.array(
            [np.cos(angle), np.sin(angle), moment / D, p[0] * np.sin(angle) + share * shear * np.cos(angle)]
        )

    def ends(a: Any, b: Any, p: Any) -> Any:
        return np.array([a[0], a[1], a[2], b[2], b[0] - half + 0.5 * moved])

    s = np.linspace(0.0, half, 201)
    deep = 2.0 / np.pi * np.sqrt(moved * LENGTH)
    guess = np.array(
        [s, -0.5 * deep * (1.0 - np.cos(np.pi * s / half)), -0.5 * deep * np.pi / half * np.sin(np.pi * s / half),
         -0.5 * D * deep * (np.pi / half) ** 2 * np.cos(np.pi * s / half)]
    )  # fmt: skip
    force = np.array([-D * (np.pi / half) ** 2])
    for share in np.linspace(0.0, 1.0, 11):  # of the weight
        found = solve_bvp(partial(slope, share=share), ends, s, guess, p=force, tol=1e-6, max_nodes=20000)
        assert found.success, found.message
        guess, force = found.sol(s), found.p
    return float(found.sol(half)[1])


@pytest.mark.parametrize("moved", [3e-3, 30e-3])
def test_a_strip_sags_between_clamps_that_came_together(moved: float) -> None:
    found = mb.equilibrium(strip(moved, 9.81))
    assert found.stability == "undamped"
    assert found.outputs["sag"] == pytest.approx(sag(moved, 9.81), rel=0.015)
    if moved > 0.1 * LENGTH:  # farther than a search from the start finds
        assert "following their motion" in found.found_from


def test_a_strip_without_weight_buckles() -> None:
    """By the bifurcation, to either side."""
    found = mb.equilibrium(strip(5e-3, 0.0))
    assert found.stability in ("undamped", "neutral")
    assert abs(found.outputs["sag"]) == pytest.approx(-sag(5e-3, 0.0), rel=0.015)


def test_a_strip_pulled_taut_is_found_from_its_start() -> None:
    found = mb.equilibrium(strip(-1e-4, 9.81))
    assert found.stability == "undamped"
    assert found.found_from.startswith("the model")


def test_a_strip_whose_clamp_an_input_moves() -> None:
    """From zero if the input starts there; from the start of the input if a run gives it another value."""
    expected, push = sag(3e-3, 9.81), partial(mb.Input, name="push", unit="m")
    found = mb.equilibrium(strip(0.0, 9.81, drive=push(start=-3e-3)))
    assert found.stability == "undamped"
    assert found.outputs["sag"] == pytest.approx(expected, rel=0.015)
    settings = Settings(solver="esdirk", tolerance=1e-4, start_at_equilibrium=True)
    run = Simulation(strip(0.0, 9.81, drive=push()), settings, inputs={"push": -3e-3})
    assert run.outputs()[0] == pytest.approx(expected, rel=0.015)
    assert not run.diagnostics


FREE, DISTANCE = 1.0, 1.2  # m


@dataclass(frozen=True, kw_only=True)
class Compressed(mb.Model):
    """A mass slides along y; a spring connects it to a support on the x axis, ``DISTANCE - push`` away.

    Straight it is unstable if the spring is shorter than free; stable is y^2 = FREE^2 - (DISTANCE - push)^2.
    """

    name = "compressed"
    start: float = mb.parameter(0.0, unit="m", doc="Position of the support when the run begins")
    moved: float = mb.parameter(0.0, unit="m", doc="Height of the step of the support")
    gravity: float = mb.parameter(0.0, unit="m/s2", doc="Gravity")

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0.0, self.gravity, 0.0))
        drive: Any = mb.Input(name="push", unit="m", start=self.start)
        if self.moved:
            drive = mb.Step(height=self.moved, duration=1.0, offset=self.start)
        support = m.body("support", m.ground, mb.Translational(axis="x", at=(-DISTANCE, 0.0, 0.0), drive=drive))
        mass = m.body("mass", m.ground, mb.Translational(axis="y"), mass=1.0)
        m.force("spring", mb.Spring(stiffness=100.0, free=FREE), support, mass)
        m.force("damper", mb.JointSpring(damping=2.0), mass)
        m.output("y", mass.coordinate())
        return m


def height(push: float) -> float:
    return float(np.sqrt(max(0.0, FREE**2 - (DISTANCE - push) ** 2)))


@pytest.mark.parametrize(
    ("start", "moved"), [(0.0, 0.6), (0.1, 0.5), (0.0, 0.25), (0.6, 0.0), (0.4, 0.2), (0.0, 0.0), (0.1, 0.0)]
)
def test_a_mass_leaves_the_line_of_a_spring_that_is_compressed(start: float, moved: float) -> None:
    """By a step; with an input that starts there; with an input that has another value at the start of a run."""
    model, settings = Compressed(start=start, moved=moved), Settings(start_at_equilibrium=True)
    expected = pytest.approx(height(start + moved), abs=1e-6)
    found = mb.equilibrium(model)
    assert abs(found.outputs["y"]) == expected
    assert (found.stability == "stable") or moved == 0.0 == start
    run = Simulation(Compressed(start=start), settings, inputs={"push": start + moved})
    assert abs(run.outputs()[0]) == expected
    assert not run.diagnostics


def masses(frees: tuple[float, ...], push: float) -> mb.Mechanism:
    """Masses that slide along y, each on a spring of another free length to the same support."""
    m = mb.Mechanism()
    drive = mb.Input(name="push", unit="m", start=push)
    support = m.body("support", m.ground, mb.Translational(axis="x", at=(-DISTANCE, 0.0, 0.0), drive=drive))
    for k, free in enumerate(frees):
        mass = m.body(f"mass{k}", m.ground, mb.Translational(axis="y"), mass=1.0)
        m.force(f"spring{k}", mb.Spring(stiffness=100.0, free=free), support, mass)
        m.force(f"damper{k}", mb.JointSpring(damping=2.0), mass)
        m.output(f"y{k}", mass.coordinate())
    return m


@pytest.mark.parametrize("frees", [(1.0, 1.0), (1.0, 1.02), (1.02, 1.0), (1.05, 1.0, 1.02), (1.0, 1.01, 1.04, 1.1)])
def test_several_bifurcations_one_after_the_other(frees: tuple[float, ...]) -> None:
    """Each path is left for the one that crosses it first, until no mass is unstable."""
    found = mb.equilibrium(masses(frees, 0.6))
    assert found.stability == "stable"
    expected = [np.sqrt(free**2 - (DISTANCE - 0.6) ** 2) for free in frees]
    assert np.abs(list(found.outputs.values())[: len(frees)]) == pytest.approx(expected, abs=1e-6)


def test_a_bifurcation_is_along_the_motion_that_becomes_unstable() -> None:
    """The mass of the longer spring leaves first, and the path that crosses there moves that mass alone."""
    path = mb.equilibrium_path(masses((1.0, 1.02), 0.0), "push", (0.0, 0.6), second=True)
    assert [state.value for state in path.bifurcations] == pytest.approx([DISTANCE - 1.02, DISTANCE - 1.0], abs=1e-6)
    for branch, moved in zip(path.branches[1:], ("y1", "y1", "y0", "y0"), strict=True):
        first = branch.states[1].outputs
        assert abs(first[moved]) > 1e-3
        assert abs(first["y0" if moved == "y1" else "y1"]) < 1e-9


def test_every_use_of_a_steady_state_finds_the_same(tmp_path: Path) -> None:
    model, settings = Compressed(start=0.6), Settings(start_at_equilibrium=True)
    expected = pytest.approx(height(0.6), abs=1e-6)
    assert abs(find_state(build_problem(model)).outputs["y"]) == expected
    assert max(mode.eigenvalue.real for mode in mb.linearize(model).modes()) < 0.0
    stiffness = 100.0 * (height(0.6) / FREE) ** 2  # k y^2 / L^2 across the line
    assert [mode.mode.natural_frequency for mode in mb.modes(model)] == pytest.approx([np.sqrt(stiffness)])
    assert abs(mb.equilibrium_path(model, "push", (0.6, 0.5)).branches[0].output("y")[0]) == expected
    assert settle(model, tolerances=[1e-6], solvers=["adams"], repeats=1)[1].status == "ok"
    told: list[str] = []
    path = export(model, tmp_path / "compressed.fmu", settings, report=told.append, native=False)
    assert (path.is_file(), told) == (True, [])
    found = native_model(model, Settings(solver="adams", start_at_equilibrium=True)).diagnostics
    assert [d.code for d in found] == ["constant-input"]


def test_a_sweep_has_the_stable_states_and_the_straight_ones() -> None:
    values = [0.1, 0.3, 0.5, 0.6]
    found = {
        (value, round(abs(state.outputs["y"]), 6)): state.stability
        for branch in sweep(Compressed(), "start", values, scattered=0)
        for value, state in zip(branch.values, branch.states, strict=True)
    }
    for value in values:
        bent = height(value)
        assert found[value, round(bent, 6)] == "stable"
        assert found[value, 0.0] == ("unstable" if bent else "stable")


@dataclass(frozen=True, kw_only=True)
class Upright(mb.Model):
    """A rod that stands or hangs."""

    name = "upright"
    start: float = mb.parameter(0.5 * np.pi, unit="rad", doc="Angle from the x axis when the run begins")

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
        rod = m.body("rod", m.ground, mb.Revolute(start=self.start), **mb.rod(mass=1.0, length=1.0))
        m.output("angle", rod.angle())
        return m


def remarks_of_run(model: mb.Model, settings: Settings, _: Path) -> list[str]:
    return list(map(str, Simulation(model, settings).diagnostics))


def remarks_of_export(model: mb.Model, settings: Settings, folder: Path) -> list[str]:
    told: list[str] = []
    export(model, folder / "made.fmu", settings, report=told.append, native=False)
    return told


def remarks_of_native(model: mb.Model, settings: Settings, _: Path) -> list[str]:
    return list(map(str, native_model(model, settings).diagnostics))


@pytest.mark.parametrize("remarks", [remarks_of_run, remarks_of_export, remarks_of_native])
def test_a_start_that_remains_unstable_is_reported(remarks: Callable[..., list[str]], tmp_path: Path) -> None:
    """The rod leaves it with exp(w t), w^2 = 3 g / (2 L)."""
    settings = Settings(solver="adams", start_at_equilibrium=True)
    (text,) = remarks(Upright(), settings, tmp_path)
    assert text.endswith("[unstable-start]")
    assert "grow by exp(3.84 t)" in text
    assert remarks(Upright(start=-1.5), settings, tmp_path) == []


@dataclass(frozen=True, kw_only=True)
class Flat(mb.Model):
    """A parallelogram that starts flat, where two branches of its motion cross; its long bar starts along or turned."""

    name = "flat"
    rate: float = mb.parameter(0.0, unit="rad/s", doc="Rate of the crank when the run begins")

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0.0, 0.0, 0.0))
        left = m.body("left", m.ground, mb.Revolute(rate=self.rate), **mb.rod(mass=1.0, length=0.5))
        right = m.body("right", m.ground, mb.Revolute(at=(1.0, 0.0, 0.0)), **mb.rod(mass=1.0, length=0.5))
        bar = m.body("bar", left, mb.Revolute(at=(0.5, 0.0, 0.0)), **mb.rod(mass=2.0, length=1.0))
        m.cut("pin", mb.SphericalCutJoint(at_a=(1.0, 0.0, 0.0), at_b=(0.5, 0.0, 0.0)), bar, right)
        m.output("angle", left.angle())
        return m


def test_an_export_reports_a_singular_start_as_a_run_does(tmp_path: Path) -> None:
    expected = list(map(str, without_details(Simulation(Flat(), Settings()).diagnostics)))
    assert [text.rpartition(" ")[2] for text in expected] == ["[singular-start]"]
    assert remarks_of_export(Flat(), Settings(), tmp_path) == expected


def test_an_export_refuses_a_singular_start_as_a_run_does(tmp_path: Path) -> None:
    with pytest.raises(mb.UserError) as expected:
        Simulation(Flat(rate=1.0), Settings())
    with pytest.raises(mb.UserError) as refused:
        remarks_of_export(Flat(rate=1.0), Settings(), tmp_path)
    assert str(refused.value) == str(expected.value)
    assert refused.value.diagnostic.code == "singular-start"
    assert not list(tmp_path.iterdir())

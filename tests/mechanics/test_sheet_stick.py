"""Friction of a sheet that sticks: a stiff strip is a block whose friction has an elastic bristle."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.mechanics import (
    Body,
    Harmonic,
    Input,
    Mechanism,
    PointForce,
    Polynomial,
    Product,
    Revolute,
    RunUp,
    Translational,
)
from mbfmu.native.exchange_states import explain_missing_exchange
from mbfmu.session.simulation import Settings, Simulation, UnstartedSimulation
from mbfmu.sheets import NipHandle, Wall, add_contact, add_nip, add_sheet
from mbfmu.sheets.contact.bristles import ANCHOR_SIZE, FIRST_ANCHOR
from mbfmu.sheets.contact.surface_contact import SurfaceContact
from mbfmu.util.errors import UserError

from .random_mechanisms import random_rotation

FRICTION, GRAVITY = 0.3, 9.81
LENGTH, WIDTH, THICKNESS, DENSITY = 0.3, 0.03, 2e-3, 800.0
DEFLECTION, CREEP = 1e-4, 1e-2  # m, m/s
WEIGHT = DENSITY * LENGTH * WIDTH * THICKNESS * GRAVITY  # N
SLIDES = FRICTION * GRAVITY  # m/s^2, acceleration that friction gives at most
SECOND = FIRST_ANCHOR + ANCHOR_SIZE  # place of the second anchor of the first point in the history of a contact
Motion = Callable[[float], float]


def add_block(m: Mechanism, size: float = 1.0, axes: Any = None, nodes: int = 7, **options: Any) -> Any:
    """A strip that is so stiff that it is a block."""
    return add_sheet(
        m, "strip", length=LENGTH * size, width=WIDTH * size, thickness=THICKNESS * size, youngs_modulus=4e9 * size,
        poisson=0.0, density=DENSITY, grid=(nodes, 3), tree="master", membrane=True, damping=5e-4 * np.sqrt(size),
        rotation=axes, **options,
    )  # fmt: skip


def on_table(
    *, slope: float = 0.0, load: float = 0.0, table: Body | None = None, mechanism: Mechanism | None = None,
    size: float = 1.0, axes: Any = None, push: Any = None, law: dict[str, Any] | None = None, **options: Any,
) -> Mechanism:  # fmt: skip
    """A block that rests on a table at the depth at which this carries its weight.

    ``load`` is the amplitude of an acceleration along x by forces, at 1 Hz, and ``push`` an acceleration over mu g;
    ``law`` changes the contact. Times are in units of sqrt(``size``).
    """
    Q, rate = np.eye(3) if axes is None else axes, 1.0 / np.sqrt(size)
    m = Mechanism() if mechanism is None else mechanism
    m.gravity[:] = Q @ (GRAVITY * np.sin(slope), -GRAVITY * np.cos(slope), 0.0)
    strip = add_block(m, size, axes, **options)
    depth, weight = 1e-5 * size, DENSITY * THICKNESS * size * GRAVITY * np.cos(slope)  # m, N/m^2
    law = {
        "friction": FRICTION, "creep": CREEP * size * rate, "deflection": DEFLECTION * size, "points": (2, 2),
        "stiffness": 2.0 * weight / depth, "depth": depth, "damping": rate,
    } | (law or {})  # fmt: skip
    place = Q @ (0.0, depth - 0.5 * THICKNESS * size, 0.0)
    contact = add_contact(m, "table", strip, Wall(at=place, normal=Q[:, 1]), body=table, **law)
    for row in strip.nodes if load or push else ():
        for node in row:
            harmonic = Harmonic(amplitude=load * node.mass, frequency=rate)
            magnitude = Product(push, SLIDES * node.mass) if push else harmonic
            m.force(f"force.{node.name}", PointForce(magnitude=magnitude, axis=Q[:, 0]), node)
    for axis in "xyz":
        m.output(axis, strip.node(len(strip.nodes) // 2, 1).position(axis))
        m.output(f"end.{axis}", strip.node(-1, 1).position(axis))
    m.output("heat", contact.heat())
    m.output("friction", contact.force("x"))
    return m


def run(m: Mechanism, stop_time: float, interval: float, solver: str = "esdirk", **options: Any) -> mb.Result:
    """A run without an error, and without a warning about its energy."""
    found = mb.simulate(m, stop_time, interval=interval, solver=solver, **({"tolerance": 1e-5} | options))
    assert not found.failure
    assert not [d for d in found.diagnostics if d.code != "large-error"]
    return found


def block_motion(
    times: Any, acceleration: Motion, belt: Motion = lambda t: 0.0, steps: int = 2000, slides: float = SLIDES
) -> Any:
    """Positions (m) of a block on a belt with this velocity, whose bristle is elastic and perfectly plastic: Heun's
    method with ``steps`` between two times. It ``slides`` at this acceleration, m/s^2.
    """
    h, x, v, z = (times[1] - times[0]) / steps, 0.0, belt(0.0), 0.0
    found = [x]

    def rate(t: float, v: float, z: float) -> float:
        return acceleration(t) - slides * float(min(1.0, max(-1.0, z + (v - belt(t)) / CREEP)))

    for k in range(steps * (len(times) - 1)):
        t = times[0] + k * h
        a, s = rate(t, v, z), v - belt(t)
        w = v + h * a
        end = min(1.0, max(-1.0, z + 0.5 * h * (s + w - belt(t + h)) / DEFLECTION))
        following = v + 0.5 * h * (a + rate(t + h, w, end))
        x, v, z = x + 0.5 * h * (v + following), following, end
        if (k + 1) % steps == 0:
            found.append(x)
    return np.array(found)


@pytest.mark.parametrize(
    ("solver", "size", "tilted"),
    [("esdirk", 1.0, False), ("esdirk", 100.0, True), ("esdirk", 0.01, True), ("ida", 1.0, True)],
)
def test_a_sheet_on_a_slope_rests_for_an_hour(solver: str, size: float, tilted: bool) -> None:
    """Below the angle of friction, in any attitude; of any size it is displaced by less than its deflection."""
    axes = random_rotation(np.random.default_rng(3)) if tilted else np.eye(3)
    m = on_table(slope=np.arctan(0.7 * FRICTION), size=size, axes=axes)
    found = run(m, 3600.0, 360.0, solver, tolerance=1e-4)
    way = (np.stack([found[axis] for axis in "xyz"], axis=1) - [found[axis][0] for axis in "xyz"]) @ axes / size
    assert 0.6 * DEFLECTION < way[-1, 0] < DEFLECTION
    assert np.abs(way[1:] - way[1]).max() < 1e-6 * DEFLECTION


@pytest.mark.parametrize("solver", ["esdirk", "ida"])
def test_steps_of_a_sheet_that_sticks_are_as_long_as_without_friction(solver: str) -> None:
    """From 1 s to 1 h, after the motion in which it comes to rest."""
    count = []
    for slope, law in ((0.0, {"friction": 0.0}), (np.arctan(0.7 * FRICTION), {"static": 0.4, "stribeck": 0.01})):
        m = on_table(slope=slope, law=law | {"deflection": DEFLECTION})
        simulation = Simulation(m, Settings(solver=solver, tolerance=1e-4))
        assert simulation.advance(1.0).ok
        before = simulation.stepper.statistics.steps
        assert simulation.advance(3600.0).ok
        count.append(simulation.stepper.statistics.steps - before)
    assert count[1] <= count[0] + 2


def test_a_sheet_slides_down_a_steep_slope() -> None:
    """Above the angle of friction: g (sin a - mu cos a)."""
    slope = np.arctan(1.5 * FRICTION)
    found = run(on_table(slope=slope), 0.4, 0.1)
    a = GRAVITY * (np.sin(slope) - FRICTION * np.cos(slope))
    assert found["x"][4] - 2.0 * found["x"][3] + found["x"][2] == pytest.approx(0.01 * a, rel=1e-4)


def test_below_breakaway_a_sheet_returns() -> None:
    """The displacement is d F / (mu N), with the damping, and there is no creep under a load that alternates."""
    found = run(on_table(load=0.9 * SLIDES), 20.0, 0.05, max_step=0.02)
    x, t = found["x"] - found["x"][0], 0.05 * np.arange(401)
    expected = block_motion(t[:81], lambda t: 0.9 * SLIDES * np.sin(2.0 * np.pi * t))
    np.testing.assert_allclose(x[:81], expected, atol=2e-3 * DEFLECTION)
    np.testing.assert_allclose(x[-20:], x[21:41], atol=2e-4 * DEFLECTION)


@pytest.mark.parametrize("share", [1.2, 1.5, 2.0, 3.0])
def test_beyond_breakaway_a_sheet_sticks_and_slides_in_turn(share: float) -> None:
    """From 1.86 on it reverses without a rest. Steps that end at a breakaway keep the error below 5 tolerances."""
    tolerance = 1e-5
    found = run(on_table(load=share * SLIDES), 2.0, 0.05, tolerance=tolerance)
    x, t = found["x"] - found["x"][0], 0.05 * np.arange(41)
    expected = block_motion(t, lambda t: share * SLIDES * np.sin(2.0 * np.pi * t))
    np.testing.assert_allclose(x, expected, atol=5.0 * tolerance * LENGTH)


@pytest.mark.parametrize("share", [0.5, 1.5])
def test_a_belt_carries_a_sheet(share: float) -> None:
    """As long as its acceleration does not exceed mu g, else with slip."""
    amplitude = share * SLIDES / (2.0 * np.pi) ** 2
    m = Mechanism()
    drive = Harmonic(amplitude=amplitude, frequency=1.0, phase=0.5 * np.pi)
    belt = m.body("belt", m.ground, Translational(axis="x", drive=drive), mass=1.0)
    found = run(on_table(table=belt, mechanism=m), 2.0, 0.05)
    x, t = found["x"] - found["x"][0], 0.05 * np.arange(41)
    speed = lambda t: -2.0 * np.pi * amplitude * np.sin(2.0 * np.pi * t)  # noqa: E731
    expected = block_motion(t, lambda t: 0.0, speed)
    np.testing.assert_allclose(x, expected, atol=1e-3 * np.ptp(expected))
    if share < 1.0:
        np.testing.assert_allclose(x, amplitude * (np.cos(2.0 * np.pi * t) - 1.0), atol=DEFLECTION)


def test_a_turntable_carries_a_sheet_around() -> None:
    """Below w^2 r = mu g: twice around, displaced in the rotating axes by less than the deflection."""
    m = Mechanism()
    table = m.body("turntable", m.ground, Revolute(axis="y", drive=RunUp(speed=1.5, duration=1.0)), mass=1.0)
    found = run(on_table(table=table, mechanism=m, at=(0.0, 0.0, -0.5 * WIDTH)), 10.0, 0.5, tolerance=1e-6)
    angle = 1.5 * (10.0 - 0.5)
    expected = found["end.x"][0] * np.array((np.cos(angle), -np.sin(angle)))
    np.testing.assert_allclose((found["end.x"][-1], found["end.z"][-1]), expected, atol=DEFLECTION)


def test_energy_of_a_sheet_that_slides_to_rest_is_heat() -> None:
    """A sheet with the speed v stops after v^2 / (2 mu g), and its bristles return by d."""
    v = 0.5
    found = run(on_table(rate=(v, 0.0, 0.0, 0.0, 0.0, 0.0)), 0.3, 1e-3, tolerance=1e-7)
    stop = v**2 / (2.0 * SLIDES) - DEFLECTION
    assert found["x"][-1] - found["x"][0] == pytest.approx(stop, abs=1e-2 * DEFLECTION)
    heat = np.trapezoid(found["heat"], dx=1e-3)
    assert heat == pytest.approx(0.5 * WEIGHT / GRAVITY * v**2, rel=1e-4)


@pytest.mark.parametrize("solver", ["esdirk", "ida"])
def test_a_run_returns_to_a_checkpoint_and_a_saved_state(solver: str) -> None:
    """With its bristles: a sheet rests where it rested. After that ``ida`` takes other steps."""

    def begin() -> Simulation:
        return Simulation(on_table(slope=np.arctan(0.7 * FRICTION)), Settings(solver=solver, tolerance=1e-4))

    first = begin()
    first.advance(1.0)
    point, saved = first.checkpoint(), first.save()
    first.advance(2.0)
    place = first.stepper.q.copy()
    first.rollback(point)
    first.advance(2.0)
    second = begin()
    second.restore(saved)
    second.advance(2.0)
    for again in (first, second):
        error = 0.0 if solver == "esdirk" else 1e-3 * DEFLECTION
        np.testing.assert_allclose(again.stepper.q, place, rtol=0.0, atol=error)


def test_trials_of_solvers_leave_no_bristles() -> None:
    """With ``auto`` a run begins with the bristles that it has with the solver that is chosen: all at the start."""
    auto, chosen = (
        Simulation(on_table(slope=0.1), Settings(solver=name, tolerance=1e-4)) for name in ("auto", "esdirk")
    )
    assert auto.solver_choice.solver == "esdirk"
    (history,) = auto.compiled.histories
    np.testing.assert_array_equal(history, chosen.compiled.histories[0])
    first = int(auto.compiled.records(SurfaceContact)["history"][0])
    assert history[first] == 0.0
    assert history[first + SECOND] == 1.0
    assert history[first + SECOND + 1] == 0.0  # x of the first point


def test_model_exchange_is_refused_with_the_reason() -> None:
    simulation = UnstartedSimulation(on_table(), Settings(solver="esdirk", tolerance=1e-4))
    assert "the friction of a sheet that sticks has a history" in explain_missing_exchange(simulation)


@pytest.mark.parametrize(("solver", "nodes"), [("esdirk", 7), ("ida", 7), ("radau", 5), ("ida", 5)])
def test_anchors_are_those_of_the_end_of_a_step(solver: str, nodes: int) -> None:
    """Of solvers on trees and with matrices: of a block that slides the anchor of a point is d behind it."""
    v = 0.5
    m = on_table(rate=(v, 0.0, 0.0, 0.0, 0.0, 0.0), nodes=nodes)
    simulation = Simulation(m, Settings(solver=solver, tolerance=1e-6))
    assert simulation.advance(0.1).ok
    first = int(simulation.compiled.records(SurfaceContact)["history"][0])
    history = simulation.compiled.histories[0][first:]
    t = history[0]
    assert t == simulation.stepper.own_time
    is_anchored, x, *_ = history[SECOND : SECOND + 4]
    assert is_anchored
    assert x == pytest.approx(v * t - 0.5 * SLIDES * t**2 - DEFLECTION, abs=1e-3 * DEFLECTION)


@pytest.mark.parametrize("solver", ["esdirk", "ida"])
def test_a_load_that_an_importer_sets_deflects_a_sheet(solver: str) -> None:
    """Inputs that jump at communication points: it rests at d F / (mu N), until it slides in an overshoot."""
    shares = np.array((0.5, -0.5, 0.3, -0.9, 0.0))
    m = on_table(push=Input(name="share", unit="1", start=0.0))
    simulation = Simulation(m, Settings(solver=solver, tolerance=1e-6))
    x = [simulation.outputs()[0]]
    for t, value in enumerate(shares):
        simulation.set_input("share", value)
        assert simulation.advance(t + 1.0).ok
        x.append(simulation.outputs()[0])
    expected = block_motion(np.arange(6.0), lambda t: SLIDES * shares[min(int(t + 1e-9), 4)], steps=10000)
    np.testing.assert_allclose(expected[1:4], DEFLECTION * shares[:3], atol=1e-3 * DEFLECTION)
    error = 2e-2 * DEFLECTION if solver == "esdirk" else 30.0 * 1e-6 * LENGTH  # the latter as its warning states
    np.testing.assert_allclose(np.array(x) - x[0], expected, atol=error)


def in_nip(share: float, speed: float = 0.0, **options: Any) -> tuple[Mechanism, NipHandle]:
    """A block in a nip that is drawn along x by this share of mu N; the surface speed of the roller is ``speed``."""
    m, radius, friction, force = Mechanism(), 0.01, 0.5, 2.0
    strip = add_block(m, at=(-0.2, 0.0, -0.5 * WIDTH), rate=(speed, 0.0, 0.0, 0.0, 0.0, 0.0))
    inertia: dict[str, Any] = {"mass": 0.1, "inertia": (1e-5,) * 3}
    axle = Revolute(at=(0.0, -radius, 0.0), drive=Polynomial((0.0, -speed / radius)))
    roller = m.body("roller", m.ground, axle, **inertia)
    law = {"friction": friction, "creep": 2e-3, "least": CREEP, "deflection": DEFLECTION} | options
    nip = add_nip(m, "nip", strip, roller, radius=radius, at=(0.0, 0.0, 0.0), width=WIDTH, force=force, **law)
    for node, part in zip(strip.nodes[-1], (0.25, 0.5, 0.25), strict=True):
        magnitude = part * share * friction * force
        m.force(f"force.{node.name}", PointForce(magnitude=magnitude, axis="x"), node)
    m.output("x", strip.node(3, 1).position("x"))
    m.output("slip", nip.slip())
    m.output("traction", nip.traction())
    return m, nip


def test_an_idler_at_rest_holds_a_sheet_on_a_roller_that_turns_freely() -> None:
    """By its friction alone: a load of 0.7 of it."""
    m, nip, radius = Mechanism(), {"friction": 0.5, "idler_friction": 0.5, "deflection": DEFLECTION}, 0.01
    strip = add_block(m, at=(-0.2, 0.0, -0.5 * WIDTH))
    inertia: dict[str, Any] = {"mass": 0.1, "inertia": (1e-5,) * 3}
    roller = m.body("roller", m.ground, Revolute(at=(0.0, -radius, 0.0)), **inertia)
    idler = m.body("idler", m.ground, Revolute(at=(0.0, radius, 0.0), drive=Polynomial((0.0,))), **inertia)
    add_nip(m, "nip", strip, roller, radius=radius, at=(0.0, 0.0, 0.0), width=WIDTH, force=2.0, idler=idler, **nip)
    for node, part in zip(strip.nodes[-1], (0.25, 0.5, 0.25), strict=True):
        m.force(f"force.{node.name}", PointForce(magnitude=0.7 * part, axis="x"), node)
    m.output("x", strip.node(3, 1).position("x"))
    m.output("angle", roller.coordinate())
    found = run(m, 3600.0, 360.0, tolerance=1e-6)
    way = found["x"] - found["x"][0]
    assert 0.6 * DEFLECTION < way[-1] < DEFLECTION
    assert np.abs(way[1:] - way[1]).max() < 1e-6 * DEFLECTION
    assert -radius * found["angle"][-1] == pytest.approx(way[-1], rel=1e-2)  # it rolls


@pytest.mark.parametrize("solver", ["esdirk", "ida"])
def test_a_nip_at_rest_holds_a_sheet(solver: str) -> None:
    found = run(in_nip(0.7)[0], 3600.0, 360.0, solver, tolerance=1e-6)
    way = found["x"] - found["x"][0]
    assert 0.6 * DEFLECTION < way[-1] < DEFLECTION
    assert np.abs(way[1:] - way[1]).max() < 1e-6 * DEFLECTION
    assert found["traction"][-1] == pytest.approx(0.7)  # mu N is 1 N


@pytest.mark.parametrize(("share", "rate", "error"), [(0.9, 1.0, 1e-2), (1.3, 10.0, 0.1)])
def test_a_nip_at_rest_under_a_load_that_alternates(share: float, rate: float, error: float) -> None:
    """It holds a sheet below mu N, and beyond it lets it stick and slide in turn; errors are in deflections."""
    mass, w = WEIGHT / GRAVITY, 2.0 * np.pi * rate
    m, _ = in_nip(0.0)
    for node in (node for row in m.meshes[0].nodes for node in row):
        load = Harmonic(amplitude=share * node.mass / mass, frequency=rate)  # N; mu N is 1 N
        m.force(f"load.{node.name}", PointForce(magnitude=load, axis="x"), node)
    found = run(m, 2.0 / rate, 0.05 / rate, tolerance=1e-6)
    t = np.arange(41) * 0.05 / rate
    expected = block_motion(t, lambda t: share / mass * np.sin(w * t), slides=1.0 / mass)
    np.testing.assert_allclose(found["x"] - found["x"][0], expected, atol=error * DEFLECTION)


def test_beyond_its_friction_a_nip_lets_go() -> None:
    """(F - mu N) / m."""
    found = run(in_nip(1.05)[0], 0.1, 0.02)
    x = found["x"]
    assert x[5] - 2.0 * x[4] + x[3] == pytest.approx(0.02**2 * 0.05 / (WEIGHT / GRAVITY), rel=1e-3)


@pytest.mark.parametrize("speed", [1e-3, 0.1])
def test_bristles_leave_a_nip_that_turns(speed: float) -> None:
    """With S^2 = v_r^2 + (creep v)^2 the load F / (mu N) = s / v + s / S of steady rolling, at any step size."""
    found = run(in_nip(0.7, speed)[0], 0.5, 0.1, tolerance=1e-6)
    expected = 0.7 / (1.0 / speed + 1.0 / np.hypot(CREEP, 2e-3 * speed))
    assert found["slip"][-1] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("value", [0.0, -1e-5, np.nan])
def test_deflections_are_positive(value: float) -> None:
    m = Mechanism()
    strip = add_block(m)
    with pytest.raises(UserError, match="deflection of contact 'table' is"):
        add_contact(m, "table", strip, Wall(), friction=0.3, deflection=value)
    with pytest.raises(UserError, match="deflection of nip 'nip' is"):
        in_nip(0.5, deflection=value)


def test_the_examples_of_the_page_on_transport(capsys: pytest.CaptureFixture[str]) -> None:
    page = (Path(__file__).parents[2] / "docs/transport.md").read_text()
    names: dict[str, Any] = {}
    blocks = [text for text in re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL) if "deflection" in text]
    for block, values in zip(blocks, ("True True", "True"), strict=True):
        exec(compile(block, "docs/transport.md", "exec"), names)
        assert capsys.readouterr().out.strip() == values
        assert f"  # {values}" in block

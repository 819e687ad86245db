"""Starts at rest without gravity and drives: only the load determines how fast the motion will be.

References are closed forms: Newton's law for the mass center of a free body, and the response of an oscillator.
"""

from __future__ import annotations

from math import pi, sqrt
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbfmu import Result, Settings, Simulation, UserError, simulate
from mbfmu.mechanics import (
    Body,
    Floating,
    Harmonic,
    Input,
    JointForce,
    JointSpring,
    Mechanism,
    PointForce,
    Product,
    Signal,
    Step,
    Translational,
    rod,
)
from mbfmu.sheets import add_sheet
from mbfmu.util.diagnostics import without_details

Array = NDArray[np.float64]

DENSE = ("adams", "hybrid", "radau", "ida")
SHARES = (0.25, 0.5, 0.25)  # of the load, at the nodes of an edge
DENSITY, WIDTH, THICKNESS = 800.0, 0.15, 2.5e-4  # kg/m3; of the length
FREQUENCY = 30.0  # rad/s
ALMOST_ZERO = {  # N; 1.2e-15 N at the start, by rounding
    "signal": Harmonic(amplitude=10.0, frequency=FREQUENCY / (2.0 * pi), phase=pi),
    "input": "10*sin(pi+30*t)",
}


def pushed_sheet(length: float, signal: Signal, force: float) -> tuple[Mechanism, Array]:
    """A sheet of 9 x 3 nodes that is connected to nothing, with a load across one edge; and the nodes' masses."""
    m = Mechanism(gravity=(0.0, 0.0, 0.0))
    sheet = add_sheet(
        m, "s", length=length, width=WIDTH * length, thickness=THICKNESS * length, youngs_modulus=4e9, poisson=0.0,
        density=DENSITY, grid=(9, 3), damping=2.5e-3 * length, supports=(), membrane=True, tree="master",
    )  # fmt: skip
    for k, share in enumerate(SHARES):
        m.force(f"push{k}", PointForce(magnitude=Product(signal, share * force), axis="y"), sheet.node(8, k))
    nodes = [sheet.node(i, j) for i in range(9) for j in range(3)]
    for k, node in enumerate(nodes):
        m.output(f"y{k}", node.position("y", point=tuple(node.com)))
    return m, np.array([node.mass for node in nodes])


def mass_center(masses: Array, result: Result) -> Array:
    """Return the height of the mass center of a sheet (times,)."""
    return np.asarray(masses @ np.array([result[f"y{k}"] for k in range(len(masses))]) / masses.sum())


def twice_integrated_step(x: Array) -> Array:
    """Return the double integral from zero to x of a step that rises from 0 to 1 between 0 and 1."""
    rising, after = np.clip(x, 0.0, 1.0), np.maximum(x - 1.0, 0.0)
    return np.asarray(rising**5 * (0.5 - 0.5 * rising + rising**2 / 7.0) + 0.5 * after + 0.5 * after**2)


@pytest.mark.parametrize("solver", ["esdirk", "ida"])
@pytest.mark.parametrize("length", [1e-3, 0.2, 1e3])
def test_a_free_sheet_follows_a_load_of_any_size(solver: str, length: float) -> None:
    """The mass center moves by Newton's law, under a load that rises at the start or after it."""
    duration, mass = 0.25 * length, DENSITY * WIDTH * THICKNESS * length**3
    largest = 0.02 * mass * length / duration**2
    for begin, force in ((0.0, largest), (0.02, -largest), (0.02, 1e-4 * largest), (0.0, min(1e-12, largest))):
        load = Step(height=1.0, begin=begin * duration, duration=0.4 * duration)
        m, masses = pushed_sheet(length, load, force)
        result = simulate(m, duration, interval=duration / 10, solver=solver, tolerance=1e-4)
        assert not result.failure, (begin, force)
        assert not result.warning
        rises = twice_integrated_step((result.t / duration - begin) / 0.4)
        expected = force / mass * (0.4 * duration) ** 2 * rises
        assert np.abs(mass_center(masses, result) - expected).max() < 3e-4 * length


def sprung(m: Mechanism, name: str, length: float) -> Body:
    """A body on a spring, with a natural frequency of 10 rad/s, that 10 N move by some hundredths of the length."""
    body = m.body(
        name, m.ground, Translational(axis="x", start=0.0, fixed=True), **rod(mass=1.0 / length, length=length)
    )
    m.force(f"{name}.spring", JointSpring(stiffness=100.0 / length), body)
    return body


def response(t: Array, length: float) -> Array:
    """Return the position of such a body, x = 0 at rest, under -10 N sin(30 t)."""
    w, p = 10.0, FREQUENCY
    return np.asarray(-10.0 * length / (w**2 - p**2) * (np.sin(p * t) - p / w * np.sin(w * t)))


@pytest.mark.parametrize("solver", DENSE)
@pytest.mark.parametrize("length", [1e-3, 1.0, 1e3])
def test_a_load_that_is_zero_but_for_rounding_starts_a_body_on_a_spring(solver: str, length: float) -> None:
    m = Mechanism(gravity=(0.0, 0.0, 0.0))
    body = sprung(m, "body", length)
    m.force("push", JointForce(magnitude=ALMOST_ZERO["signal"]), body)
    m.output("x", body.coordinate())
    for tolerance in (1e-4, 1e-8):
        result = simulate(m, 1.0, interval=0.01, solver=solver, tolerance=tolerance)
        assert not result.failure
        assert not result.warning
        assert np.abs(result["x"] - response(result.t, length)).max() < 3.0 * tolerance * length


@pytest.mark.parametrize("solver", ["adams", "ida"])
@pytest.mark.parametrize("count", [59, 61])
def test_the_same_among_many_that_stay_at_rest(solver: str, count: int) -> None:
    """Dense matrices up to 60 coordinates, recursions above; by a signal, and by an input that is given as a text."""
    m = Mechanism(gravity=(0.0, 0.0, 0.0))
    bodies = [sprung(m, f"body{k}", 1.0) for k in range(count)]
    m.force("push", JointForce(magnitude=ALMOST_ZERO["signal"]), bodies[7])
    m.force("other", JointForce(magnitude=Input(name="F", unit="N")), bodies[6])
    m.output("x", bodies[7].coordinate())
    m.output("y", bodies[6].coordinate())
    m.output("still", bodies[8].coordinate())
    result = simulate(m, 1.0, interval=0.05, solver=solver, tolerance=1e-6, inputs={"F": ALMOST_ZERO["input"]})
    assert not result.failure
    assert not result.warning
    for name in "xy":
        assert np.abs(result[name] - response(result.t, 1.0)).max() < 1e-5
    assert np.abs(result["still"]).max() < 1e-9


@pytest.mark.parametrize("solver", DENSE)
@pytest.mark.parametrize("force", [0.0, 1e-9, 1.0])
def test_a_body_that_floats_is_pushed_by_little_or_stays_where_it_is(solver: str, force: float) -> None:
    m = Mechanism(gravity=(0.0, 0.0, 0.0))
    body = m.body("body", m.ground, Floating(), mass=2.0, inertia=(0.1, 0.2, 0.3))
    m.force("push", PointForce(magnitude=Input(name="F", unit="N"), axis="y"), body)
    m.output("y", body.position("y"))
    m.output("x", body.position("x"))
    for duration in (1e-2, 10.0):
        result = simulate(m, duration, interval=duration / 10, solver=solver, inputs={"F": force})
        assert not result.failure
        assert not result.warning
        assert not without_details(result.diagnostics)
        assert np.abs(result["y"] - force * result.t**2 / 4.0).max() <= 1e-6 * max(force * duration**2 / 4.0, 1e-6)
        assert not result["x"].any()
        if not force:
            assert not result["y"].any()


@pytest.mark.parametrize("solver", DENSE)
def test_a_host_pushes_a_body_that_has_been_at_rest(solver: str) -> None:
    m = Mechanism(gravity=(0.0, 0.0, 0.0))
    body = sprung(m, "body", 1.0)
    m.force("push", JointForce(magnitude=Input(name="F", unit="N")), body)
    m.output("x", body.coordinate())
    simulation = Simulation(m, Settings(solver=solver, tolerance=1e-6))
    assert simulation.advance(1.0).ok
    assert simulation.outputs()[0] == 0.0
    simulation.set_input("F", 1e-3)
    for t in (1.1, 1.3, 2.0):
        assert simulation.advance(t).ok
        assert abs(simulation.outputs()[0] - 1e-5 * (1.0 - np.cos(10.0 * (t - 1.0)))) < 1e-5 * 1e-2


@pytest.mark.parametrize("solver", DENSE)
def test_no_second_is_special_to_a_start_at_rest(solver: str) -> None:
    """Copies whose time is scaled by a power of two take the same steps to the same positions."""
    found = []
    for time in (1.0, 2.0**-20, 2.0**20):
        m = Mechanism(gravity=(0.0, 0.0, 0.0))
        body = m.body("body", m.ground, Translational(axis="x", start=0.0, fixed=True), **rod(mass=1.0, length=1.0))
        m.force("spring", JointSpring(stiffness=64.0 / time**2), body)
        load = Harmonic(amplitude=8.0 / time**2, frequency=4.0 / time, phase=pi)
        m.force("push", JointForce(magnitude=load), body)
        m.output("x", body.coordinate())
        result = simulate(m, time, interval=time / 16, solver=solver, tolerance=1e-6)
        assert not result.failure
        found.append((result.statistics.steps, result["x"]))
    for steps, x in found[1:]:
        assert steps == found[0][0]
        assert np.abs(x - found[0][1]).max() < 1e-12
    p, w, t = 8.0 * pi, sqrt(64.0), np.arange(17) / 16
    expected = -8.0 / (w**2 - p**2) * (np.sin(p * t) - p / w * np.sin(w * t))
    assert np.abs(found[0][1] - expected).max() < 1e-5


@pytest.mark.parametrize("duration", [-1.0, float("nan"), float("inf"), "1"])
def test_a_duration_that_is_none_is_refused(duration: Any) -> None:
    m = Mechanism()
    m.body("b", m.ground, Translational(axis="x"), mass=1.0)
    with pytest.raises(UserError, match="duration is "):
        Simulation(m, Settings(), duration=duration)

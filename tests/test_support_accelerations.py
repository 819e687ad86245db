"""Supports whose acceleration the host gives: order of the force of the drive, start, jumps, where it is listed."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism
from mbfmu.session.simulation import Settings, Simulation

A, W = 0.02, 30.0


def base(**names: str) -> mb.Mechanism:
    m = mb.Mechanism()
    moved = m.body("base", m.ground, mb.Translational(axis="x", drive=mb.Input(name="u", unit="m", **names)), mass=1.0)
    bob = m.body("bob", moved, mb.Translational(axis="x"), mass=2.0)
    m.force("k", mb.JointSpring(stiffness=200.0), bob)
    m.output("base", moved.coordinate())
    m.output("force", moved.effort())
    return m


def exact_force(t: Any) -> Any:
    """Of a bob that starts with the base."""
    bob = 100.0 * A / (100.0 - W**2) * (np.sin(W * t) - W / 10.0 * np.sin(10.0 * t)) + A * W / 10.0 * np.sin(10.0 * t)
    return -A * W**2 * np.sin(W * t) - 200.0 * (bob - A * np.sin(W * t))


def errors(steps: int, names: dict[str, str]) -> tuple[float, float]:
    """Return the largest errors of the place of the base and of its force, of the largest, over a run of 0.2 s."""
    given = {
        "u": lambda t: A * np.sin(W * t),
        "v": lambda t: A * W * np.cos(W * t),
        "a": lambda t: -A * W**2 * np.sin(W * t),
    }
    used = [name for name in given if name == "u" or name in names.values()]
    start = {name: given[name](0.0) for name in used}
    simulation = Simulation(base(**names), Settings(solver="adams", tolerance=1e-9), inputs=start)
    found, times = [], np.linspace(0.0, 0.2, steps + 1)
    for t, end in pairwise(times):
        for name in used:
            simulation.set_input(name, given[name](t))
        simulation.advance(end)
        found.append(simulation.outputs()[:2].copy())
    place, force = np.array(found)[steps // 20 :].T
    at = times[1 + steps // 20 :]
    return (
        float(np.abs(place - A * np.sin(W * at)).max() / A),
        float(np.abs(force - exact_force(at)).max() / np.abs(exact_force(at)).max()),
    )


def test_the_force_of_the_drive_converges_by_the_square() -> None:
    """And by the step alone where the host gives no acceleration."""
    both, rate = {"rate_name": "v", "acceleration_name": "a"}, {"rate_name": "v"}
    coarse, fine = errors(100, both), errors(200, both)
    assert np.log2(coarse[1] / fine[1]) > 1.8
    assert np.log2(coarse[0] / fine[0]) > 3.5
    assert fine[1] < 2e-3
    assert np.log2(errors(100, rate)[1] / errors(1600, rate)[1]) / 4.0 == pytest.approx(1.0, abs=0.3)
    assert errors(200, rate)[1] > 10.0 * fine[1]


def test_a_constant_acceleration_is_exact() -> None:
    """From the start; at a jump of the acceleration nothing overshoots."""
    simulation = Simulation(base(rate_name="v", acceleration_name="a"), Settings(solver="adams"), inputs={"a": 3.0})
    times = np.linspace(0.0, 1.0, 11)
    for t, end in pairwise(times):
        ends = min(t, 0.5)
        simulation.set_input("u", 1.5 * ends**2 + 3.0 * ends * (t - ends))
        simulation.set_input("v", 3.0 * ends)
        simulation.set_input("a", 3.0 if t < 0.499 else 0.0)
        simulation.advance(end)
        ends = min(end, 0.5)
        assert simulation.outputs()[0] == pytest.approx(1.5 * ends**2 + 3.0 * ends * (end - ends), abs=1e-12)
    assert not [text for text in map(str, simulation.diagnostics) if "jumps" in text]


def test_a_state_is_restored_with_its_acceleration() -> None:
    def go(simulation: Simulation, steps: range) -> Any:
        for k in steps:
            for name, value in (("u", np.sin(0.1 * k)), ("v", np.cos(0.1 * k)), ("a", -np.sin(0.1 * k))):
                simulation.set_input(name, value)
            simulation.advance(0.1 * (k + 1))
        return simulation.outputs().copy()

    model = base(rate_name="v", acceleration_name="a")
    first, second = (Simulation(model, Settings(solver="adams")) for _ in range(2))
    go(first, range(3))
    second.restore(first.save())
    np.testing.assert_array_equal(go(first, range(3, 6)), go(second, range(3, 6)))


def test_the_error_is_listed_with_the_input() -> None:
    def told(m: mb.Mechanism) -> str:
        return CompiledMechanism(m).inputs.variables[0].description

    assert "force of the drive without inertia" in told(base())
    assert "an error of O(h)" in told(base(rate_name="v"))
    both = CompiledMechanism(base(rate_name="v", acceleration_name="a"))
    assert both.inputs.variables[0].description == ""
    assert [(v.name, v.unit) for v in both.inputs.variables] == [("u", "m"), ("v", "m/s"), ("a", "m/s2")]


def test_an_acceleration_needs_a_rate_and_a_joint() -> None:
    with pytest.raises(mb.UserError, match="input 'u' has the acceleration_name 'a' and no rate_name"):
        mb.Input(name="u", unit="m", acceleration_name="a")
    m = mb.Mechanism()
    body = m.body("b", m.ground, mb.Translational(axis="x"), mass=1.0)
    m.force("f", mb.JointForce(mb.Input(name="F", unit="N", rate_name="dF", acceleration_name="ddF")), body)
    with pytest.raises(mb.UserError, match="input 'F' has an acceleration, 'ddF', and does not drive a joint"):
        CompiledMechanism(m)

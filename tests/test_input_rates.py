"""Inputs that are given with their rates: ramps over communication steps, against closed forms."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from input_ramps import KINDS, MASS, Ramps, exact

import mbfmu as mb
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.errors import UserError

RATE = 3.0  # of the input per second


def run(kind: str, times: Any, settings: Settings, values: Any, rates: Any) -> Any:
    """Return the outputs at the times but the first (steps, outputs); a rate or a value that is None is not given."""
    simulation, rows = Simulation(Ramps(kind=kind), settings), []
    for (t, end), value, rate in zip(pairwise(times), values, rates, strict=True):
        if value is not None:
            simulation.set_input("u", value, rate)
        status = simulation.advance(end)
        assert status.ok, t
        rows.append(simulation.outputs()[:4].copy())
    assert not simulation.warning
    return np.array(rows), simulation


@pytest.mark.parametrize("interpolation", ["hold", "linear"])
@pytest.mark.parametrize("solver", ["adams", "radau", "ida"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_ramp_is_exact(kind: str, solver: str, interpolation: str) -> None:
    """In long steps of different lengths, within the tolerance of the solver."""
    times = np.array([0.0, 0.3, 0.35, 0.8, 1.0])
    settings = Settings(solver=solver, tolerance=1e-9, input_interpolation=interpolation)
    found, _ = run(kind, times, settings, RATE * times[:-1], [RATE] * 4)
    wanted = np.transpose(list(exact(kind, times[1:], RATE).values()))
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=3e-7)


@pytest.mark.parametrize("kind", KINDS)
def test_it_continues_until_it_is_set_again(kind: str) -> None:
    times = np.array([0.0, 0.3, 0.35, 0.8, 1.0])
    settings = Settings(solver="adams", tolerance=1e-9)
    values, rates = [0.0, None, None, None], [RATE, None, None, None]
    found, _ = run(kind, times, settings, values, rates)
    wanted = np.transpose(list(exact(kind, times[1:], RATE).values()))
    np.testing.assert_allclose(found[:, 2:], wanted[:, 2:], rtol=0.0, atol=1e-9)
    if kind != "position":
        np.testing.assert_allclose(found[:, :2], wanted[:, :2], rtol=0.0, atol=3e-7)


@pytest.mark.parametrize(("kind", "output"), [("force", 1), ("speed", 2)])
def test_the_error_of_a_smooth_input_is_of_second_order(kind: str, output: int) -> None:
    """The force, or the speed, is sin(5 t); v = (1 - cos(5 t)) / 5 m and x = (1 - cos(5 t)) / 5 are its integrals."""
    errors = []
    for steps in (20, 40, 80):
        times = np.linspace(0.0, 1.0, steps + 1)
        settings = Settings(solver="adams", tolerance=1e-10)
        found, _ = run(kind, times, settings, np.sin(5.0 * times[:-1]), 5.0 * np.cos(5.0 * times[:-1]))
        exactly = (1.0 - np.cos(5.0 * times[1:])) / 5.0 / (MASS if kind == "force" else 1.0)
        errors.append(np.abs(found[:, output] - exactly).max())
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx([2.0, 2.0], abs=0.15)


def test_a_value_alone_is_held() -> None:
    """After a ramp: half a second of it, then a constant force."""
    times = np.array([0.0, 0.5, 1.0])
    found, _ = run("force", times, Settings(solver="adams", tolerance=1e-9), [0.0, 1.5], [RATE, None])
    first = exact("force", 0.5, RATE)
    after = exact("force", 0.5, 0.0, 1.5)
    assert found[1, 1] == pytest.approx(first["v"] + after["v"], abs=1e-8)
    assert found[1, 0] == pytest.approx(first["x"] + 0.5 * first["v"] + after["x"], abs=1e-8)


@pytest.mark.parametrize("kind", ["force", "spring", "speed"])
def test_a_ramp_that_continues_costs_no_restart(kind: str) -> None:
    times = np.linspace(0.0, 1.0, 101)
    settings = Settings(solver="adams", tolerance=1e-6)
    given, once = [RATE] * 100, [RATE] + [None] * 99
    _, often = run(kind, times, settings, RATE * times[:-1], given)
    values = [0.0] + [None] * 99
    _, rarely = run(kind, times, settings, values, once)
    held, changing = run(kind, times, settings, RATE * times[:-1], [None] * 100)
    assert rarely.statistics.restarts == 0
    assert often.statistics.restarts < 20
    assert changing.statistics.restarts > 90
    wanted = np.transpose(list(exact(kind, times[1:], RATE).values()))
    assert np.abs(held - wanted).max() > 1e-4  # an input that is held is late


def test_the_force_of_a_drive_has_the_acceleration() -> None:
    """At once, when the speed has its rate."""
    m = mb.Mechanism()
    drive = mb.SpeedInput(name="u", unit="m/s")
    base = m.body("base", m.ground, mb.Translational(axis="x", drive=drive), mass=4.0)
    m.body("free", m.ground, mb.Translational(axis="x"), mass=1.0)
    m.output("force", base.effort())
    simulation = Simulation(m, Settings(solver="adams"))
    simulation.set_input("u", 0.0, RATE)
    simulation.advance(0.1)
    assert simulation.outputs()[0] == pytest.approx(4.0 * RATE, rel=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_a_state_has_the_rate(kind: str) -> None:
    settings = Settings(solver="adams")
    first, second = (Simulation(Ramps(kind=kind), settings) for _ in range(2))
    first.set_input("u", 0.0, RATE)
    first.advance(0.2)
    second.restore(first.save())
    for simulation in (first, second):
        simulation.advance(0.5)
    np.testing.assert_array_equal(first.outputs(), second.outputs())


def test_which_inputs_take_a_rate() -> None:
    m = mb.Mechanism()
    body = m.body("b", m.ground, mb.Translational(axis="x"), mass=1.0)
    m.force("f", mb.JointForce(mb.Input(name="F", unit="N", rate_name="dF")), body)
    simulation = Simulation(m, Settings(solver="adams"))
    for name in ("F", "dF"):
        with pytest.raises(UserError, match=f"a rate was given for input '{name}'"):
            simulation.set_input(name, 0.0, 1.0)
    other = Simulation(Ramps(), Settings(solver="adams"))
    with pytest.raises(UserError, match=r"rate of input 'u' is nan"):
        other.set_input("u", 0.0, float("nan"))

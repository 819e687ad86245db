"""What begins while nothing else varies is not stepped over, whenever it begins and whenever outputs are requested."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mbfmu.mechanics import JointForce, JointSpring, Mechanism, Revolute, Signal, Step, Sum, Table, Translational
from mbfmu.modeling.settings import Settings
from mbfmu.session.run import simulate
from mbfmu.session.simulation import Simulation
from solvers.balance import energy_error_limit
from solvers.energy_account import ACCOUNT_SIZE
from solvers.steppers import SOLVERS

TOLERANCE = 1e-6
SMALL = [solver for solver in SOLVERS if solver != "adams-lu"]


def pulse(begin: float, width: float, duration: float) -> Signal:
    """Return 1 N or 1 N m for so long (s), rising and falling within ``duration``."""
    return Sum(
        Step(height=1.0, begin=begin, duration=duration), Step(height=-1.0, begin=begin + width, duration=duration)
    )


def pushed(force: Signal, mass: float = 1.0) -> Mechanism:
    m = Mechanism()
    body = m.body("mass", m.ground, Translational(axis="x"), mass=mass)
    m.force("push", JointForce(force), body)
    m.output("rate", body.rate())
    return m


@pytest.mark.parametrize("solver", SMALL)
@pytest.mark.parametrize("duration", [0.0, 0.01, 0.5])
def test_a_mass_at_rest_is_pushed(solver: str, duration: float):
    """Closed form: the impulse is the width of the pulse, however it rises."""
    for begin in (1.0, 3.3, 5.5, 8.0):
        for interval in (0.01, 0.1, 1.0):
            run = simulate(
                pushed(pulse(begin, 0.7, duration)), 10.0, interval=interval, solver=solver, tolerance=TOLERANCE
            )
            assert run["rate"][-1] == pytest.approx(0.7, abs=30.0 * TOLERANCE), (begin, interval)


@pytest.mark.parametrize("solver", SMALL)
def test_a_wheel_at_constant_speed_is_braked(solver: str):
    for begin in (0.5, 5.0, 8.0):
        m = Mechanism()
        wheel = m.body("wheel", m.ground, Revolute(axis="z", rate=20.0), mass=1.0, inertia=(1.0, 1.0, 1.0))
        brake = Sum(Step(height=-1.0, begin=begin, duration=0.5), Step(height=1.0, begin=begin + 0.7, duration=0.5))
        m.force("brake", JointForce(brake), wheel)
        m.output("rate", wheel.rate())
        run = simulate(m, 10.0, interval=0.1, solver=solver, tolerance=TOLERANCE)
        assert run["rate"][-1] == pytest.approx(19.3, abs=20.0 * 30.0 * TOLERANCE)


@pytest.mark.parametrize("solver", SMALL)
def test_a_table_that_begins_late_is_seen(solver: str):
    """Closed form: the area under a triangle of 0.4 s and 2 N."""
    table = Table([6.0, 6.2, 6.4], [0.0, 2.0, 0.0], kind="linear", beyond="hold")
    run = simulate(pushed(table), 10.0, interval=0.05, solver=solver, tolerance=TOLERANCE)
    assert run["rate"][-1] == pytest.approx(0.4, abs=30.0 * TOLERANCE)


@pytest.mark.parametrize("solver", SMALL)
def test_a_crane_that_moves_late_swings(solver: str):
    """A pendulum of 1 m on a trolley that moves by 1 m within 1 s; SciPy on its angle.

    The jerk of the trolley jumps: formulas of high order have errors of up to 200 tolerances there, and of 1 rad if
    they miss the jump.
    """
    for begin in (1.0, 3.0, 4.5):

        def slope(t: float, y: np.ndarray, begin: float = begin) -> list[float]:
            x = t - begin
            a = 60.0 * x - 180.0 * x**2 + 120.0 * x**3 if 0.0 < x < 1.0 else 0.0
            return [y[1], -9.81 * np.sin(y[0]) - a * np.cos(y[0])]

        times = np.linspace(0.0, 6.0, 61)
        begun = solve_ivp(slope, (begin, 6.0), [0.0, 0.0], t_eval=times[times > begin], rtol=1e-11, atol=1e-12)
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        drive = Step(height=1.0, begin=begin, duration=1.0)
        trolley = m.body("trolley", m.ground, Translational(axis="x", drive=drive), mass=1.0)
        bob = m.body("bob", trolley, Revolute(axis="z", start=-np.pi / 2), mass=1.0, com=(1.0, 0.0, 0.0))
        m.output("angle", bob.angle())
        run = simulate(m, 6.0, interval=0.1, solver=solver, tolerance=TOLERANCE)
        swing = run["angle"][times > begin] + np.pi / 2
        assert np.abs(swing - begun.y[0]).max() <= 300.0 * TOLERANCE


@pytest.mark.parametrize("solver", ["adams", "esdirk", "ida"])
def test_a_long_chain_at_rest_is_pushed(solver: str):
    """130 masses in a row, the last one pushed: the sum of their momenta is the impulse."""
    m = Mechanism()
    bodies = [m.body(f"b{k}", m.ground, Translational(axis="x"), mass=1.0) for k in range(130)]
    for k, body in enumerate(bodies):
        m.output(f"rate{k}", body.rate())
    m.force("push", JointForce(pulse(5.5, 0.7, 0.5)), bodies[-1])
    run = simulate(m, 10.0, interval=0.1, solver=solver, tolerance=TOLERANCE)
    assert run["rate129"][-1] == pytest.approx(0.7, abs=150.0 * TOLERANCE)
    assert run["rate0"][-1] == 0.0


@pytest.mark.parametrize("solver", SMALL)
def test_what_has_hardly_moved_is_not_called_inaccurate(solver: str):
    """A sled that rests on a spring until its drive begins has energies of rounding alone."""
    m = Mechanism()
    sled = m.body("sled", m.ground, Translational(axis="x", drive=Step(height=1.0, begin=8.0, duration=0.5)), mass=1.0)
    load = m.body("load", sled, Translational(axis="x"), mass=1.0)
    m.force("spring", JointSpring(stiffness=100.0, damping=1.0), load)
    m.output("load", load.coordinate())
    run = simulate(m, 10.0, interval=0.1, solver=solver, tolerance=TOLERANCE)
    assert not run.warning
    assert np.ptp(run["load"]) > 0.1


def test_a_drive_of_one_short_jerk_does_not_blind_the_energy_check():
    m = Mechanism()
    m.body("sled", m.ground, Translational(axis="x", drive=Step(height=1.0, begin=1.0, duration=1e-6)), mass=1.0)
    m.body("load", m.ground, Translational(axis="x"), mass=1.0)
    balance = Simulation(m, Settings(solver="adams", tolerance=TOLERANCE)).session.balance[0]
    assert balance["is_checked"]
    assert energy_error_limit(balance, 0.0, np.zeros(ACCOUNT_SIZE)) < 1e-11  # J


def test_steps_are_halved_on_the_way_to_what_begins():
    found = Simulation(pushed(Step(height=1.0, begin=8.0, duration=0.5)), Settings()).compiled
    t, ends = 0.0, []
    while t < 8.0:
        longest, until = found.system.input_step_limit(t)
        ends.append(until + longest)
        assert until > t
        t = until
    assert max(ends) <= 8.5 + 0.15 + 1e-12
    assert len(ends) < 12


def swinging(links: int) -> Mechanism:
    """A chain of rods, whose last one is pushed from 0.15 s on."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    link = m.ground
    for i in range(links):
        link = m.body(
            f"link{i}",
            link,
            Revolute(at=(0.1 if i else 0.0, 0, 0), start=0.3 if not i else 0.0),
            mass=1.0,
            com=(0.05, 0, 0),
            inertia=(0.01, 0.01, 0.01),
        )
        m.force(f"hinge{i}", JointSpring(stiffness=0.0 if links < 3 else 20.0, damping=0.01), link)
    m.force("push", JointForce(Step(height=3.0, begin=0.15)), link)
    m.output("angle", link.angle())
    return m


@pytest.mark.parametrize("kept", ["checkpoint", "save"])
@pytest.mark.parametrize(("solver", "links"), [("adams", 2), ("hybrid", 2), ("radau", 2), ("adams", 65)])
def test_a_run_that_returns_from_a_jump_of_a_load_repeats_its_bits(solver: str, links: int, kept: str):
    """The step that is discarded ends where the load jumps, so that steps were limited to next to nothing there."""
    found = []
    for discards in (False, True):
        simulation = Simulation(swinging(links), Settings(solver=solver, tolerance=TOLERANCE))
        simulation.advance(0.1)
        state = simulation.checkpoint() if kept == "checkpoint" else simulation.save()
        if discards:
            simulation.advance(0.15)
            (simulation.rollback if kept == "checkpoint" else simulation.restore)(state)  # type: ignore[operator]
        rows = [simulation.outputs().copy() for t in (0.12, 0.3) if simulation.advance(t).ok]
        found.append((*rows, simulation.statistics.steps))
    np.testing.assert_array_equal(np.hstack(found[1]), np.hstack(found[0]))

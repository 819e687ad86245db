"""Events of mechanisms whose loops are eliminated along the tree: a row of 31 four-bars, which moves as one rod."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from fmpy import simulate_fmu
from mechanisms import G, n_four_bar
from scipy.integrate import quad

import mbfmu as mb
from mbfmu.fmi.export import export
from mbfmu.modeling.model import as_model

LOOPS, STOP, SPEED = 31, 0.9, -1.0  # height of the couplers at the stop, m; rate at the start, rad/s
INERTIA, WEIGHT = (LOOPS + 1) / 3.0 + LOOPS, (0.5 * (LOOPS + 1) + LOOPS) * G  # kg m2; N m, of all rods of 1 m and 1 kg


def rate(angle: float, energy: float) -> float:
    """Return the speed of a column at an angle and an energy."""
    return float(np.sqrt(2.0 * (energy - WEIGHT * np.sin(angle)) / INERTIA))


def duration(first: float, last: float, energy: float) -> float:
    """Return the time between two angles."""
    return float(quad(lambda angle: 1.0 / rate(angle, energy), first, last, epsabs=1e-12)[0])


def kicked_row(ends: bool = True) -> tuple[mb.Mechanism, np.ndarray, float]:
    """Return the row, the times of its two events and the last rate, which are SciPy's integral of the time over the
    angle, whose rate follows from the energy.

    The height of a coupler hits a stop; the impulse acts on the last column where all are upright again.
    """
    e, impulse, m = 0.95, 7.0, n_four_bar(LOOPS).mechanism
    middle, last = m.bodies[LOOPS], m.bodies[-1]
    m.event("stop", middle.position("y"), crosses=STOP, direction="down", then=mb.Bounce(e))
    kick = [mb.Impulse(last, impulse), *([mb.EndRun()] if ends else [])]
    m.event("upright", m.bodies[1].angle(), crosses=0.5 * np.pi, direction="up", then=kick)
    m.output("rate", last.rate())
    m.output("residual", m.velocity_residual)
    angle, energy = np.arcsin(STOP), 0.5 * INERTIA * SPEED**2 + WEIGHT
    after = WEIGHT * STOP + 0.5 * INERTIA * (e * rate(angle, energy)) ** 2
    times = np.cumsum((duration(angle, 0.5 * np.pi, energy), duration(angle, 0.5 * np.pi, after)))
    return m, times, rate(0.5 * np.pi, after) + impulse / INERTIA


@pytest.mark.parametrize("solver", ["adams", "ida"])
def test_a_row_of_fourbars_bounces_and_is_kicked(solver: str) -> None:
    m, times, last_rate = kicked_row()
    result = mb.simulate(m, 5.0, interval=0.25, solver=solver, tolerance=1e-7)
    assert [event.name for event in result.events] == ["stop", "upright"]
    np.testing.assert_allclose([event.time for event in result.events], times, rtol=0.0, atol=2e-6)
    assert result["rate"][-1] == pytest.approx(last_rate, abs=1e-5)
    assert result["residual"].max() <= 1e-9
    assert not result.warning


@pytest.mark.parametrize("solver", ["adams", "hybrid"])
def test_a_row_of_fourbars_rests_on_a_stop(solver: str) -> None:
    """Closed form: the row moves as one rod, whose weight a growing torque exceeds."""
    m = n_four_bar(LOOPS).mechanism
    m.event("stop", m.bodies[LOOPS].position("y"), crosses=STOP, direction="down", then=mb.Bounce(0.0))
    m.force("lift", mb.JointForce(mb.Input(name="lift", unit="N*m", start=0.0)), m.bodies[1])
    m.output("angle", m.bodies[1].angle())
    lift = {"lift": "200.0 * (t - 3.0)"}
    result = mb.simulate(m, 4.1, interval=0.25, solver=solver, tolerance=1e-7, inputs=lift)
    held, angle = (result.t > 0.3) & (result.t < 4.0), float(np.arcsin(STOP))
    np.testing.assert_allclose(result["angle"][held], angle, rtol=0.0, atol=1e-9)
    (release,) = (event.time for event in result.events if event.direction == "up")
    assert release == pytest.approx(3.0 + WEIGHT * np.cos(angle) / 200.0, abs=1e-7)
    assert not result.warning


@pytest.mark.campaign
@pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="needs a C compiler")
@pytest.mark.parametrize("solver", ["adams", "ida"])
def test_a_native_fmu_of_the_row_bounces_and_is_kicked(solver: str, tmp_path: Path) -> None:
    """A millisecond after the impulse, which acts where the rate has an extremum: it changes by less than 1e-5."""
    m, times, last_rate = kicked_row(ends=False)
    m.output("angle", m.bodies[1].angle())
    path = export(as_model(m), tmp_path / "row.fmu", mb.Settings(solver=solver, tolerance=1e-7), native=True)
    stop = times[1] + 1e-3
    for kind, relative in (("CoSimulation", None), ("ModelExchange", 1e-9)):
        how = {"fmi_type": kind, "relative_tolerance": relative, "record_events": False}
        found = simulate_fmu(str(path), stop_time=stop, output_interval=stop / 4, **how)
        assert found["angle"][-1] == pytest.approx(0.5 * np.pi + 1e-3 * last_rate, abs=5e-6)
        assert found["rate"][-1] == pytest.approx(last_rate, abs=2e-5)
        assert abs(found["energy_error"][-1]) <= 1e-5 * WEIGHT


def parallelogram(angle: float, then: str) -> mb.Mechanism:
    """Return cranks of 1 m and a coupler that translates, which turn with 1 rad/s and are hit or locked at an angle.

    All are in one line at zero. A wheel is not connected to them.
    """
    m = mb.Mechanism()
    crank = m.body("crank", m.ground, mb.Revolute(start=0.5, rate=-1.0, fixed=True), **mb.rod(mass=1.0, length=1.0))
    joint = mb.Revolute(at=(1.0, 0.0, 0.0), start=-0.5)
    coupler = m.body("coupler", crank, joint, **mb.rod(mass=2.0, length=2.0))
    rocker = m.body("rocker", coupler, mb.Revolute(at=(2.0, 0.0, 0.0), start=0.5), **mb.rod(mass=1.0, length=1.0))
    m.cut("pivot", mb.RevoluteCutJoint(at_a=(-1.0, 0.0, 0.0), at_b=(2.0, 0.0, 0.0)), rocker, m.ground)
    wheel = m.body("wheel", m.ground, mb.Revolute(), inertia=(1, 1, 2.0))
    actions = {
        "impulse": mb.Impulse(rocker, -0.5),
        "bounce": mb.Bounce(0.5),
        "lock": mb.Lock(crank),
        "wheel": [mb.Impulse(wheel, 3.0), mb.EndRun()],
    }
    m.event("hit", crank.angle(), crosses=angle, direction="down", then=actions[then])
    m.output("crank", crank.rate())
    m.output("wheel", wheel.rate())
    return m


@pytest.mark.parametrize("then", ["impulse", "bounce", "lock"])
@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida", "radau"])
def test_an_event_in_a_singular_configuration_is_refused(solver: str, then: str) -> None:
    result = mb.simulate(parallelogram(0.0, then), 1.0, interval=0.1, solver=solver, tolerance=1e-6)
    (error,) = (d for d in result.diagnostics if d.severity == "error")
    assert (error.code, error.subject) == ("singular-event", "hit")
    assert error.time == pytest.approx(0.5, abs=1e-5)
    assert "event 'hit' at t = 0.5" in result.failure
    np.testing.assert_allclose(result["crank"], -1.0, rtol=0.0, atol=1e-6)


def test_an_event_of_another_body_occurs_while_a_loop_is_singular() -> None:
    """Closed form: the impulse divided by the moment of inertia."""
    result = mb.simulate(parallelogram(0.0, "wheel"), 1.0, interval=0.1, solver="adams", tolerance=1e-6)
    assert not result.failed
    assert result["wheel"][-1] == pytest.approx(1.5, rel=1e-9)


@pytest.mark.parametrize("then", ["impulse", "lock"])
def test_an_event_next_to_a_singular_configuration(then: str) -> None:
    """Closed form: the rods have the moments of inertia 1/3, 2 and 7/3 kg m^2 about their pivots."""
    result = mb.simulate(parallelogram(1e-3, then), 1.0, interval=0.1, solver="adams", tolerance=1e-6)
    expected = 0.0 if then == "lock" else -1.0 - 0.5 / (14.0 / 3.0)
    assert result["crank"][-1] == pytest.approx(expected, abs=1e-6)
    assert not result.failed

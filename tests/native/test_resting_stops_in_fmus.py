"""Stops of native FMUs that hold what rests on them, and impacts, impulses and locks on bodies that touch."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from fmpy import simulate_fmu
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import fmi2LastSuccessfulTime, fmi2Terminated

import mbfmu as mb
from mbfmu.fmi import Fmu
from mbfmu.fmi.export import export
from mbfmu.util.errors import UserError

pytestmark = pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="needs a C compiler")
G, SETTINGS = 9.81, mb.Settings(solver="adams", tolerance=1e-8)
BALL, CRATE, PULL, LIFT = 2.0, 3.0, 20.0, 1.713  # kg, kg, N/s, s: time from which the ball is lifted
NAMES = ("ball", "force", "crate", "hold", *(f"gap{k}" for k in range(3)), *(f"rate{k}" for k in range(3)))
LATER = 1e-4  # s, after an impact


@dataclass(frozen=True, kw_only=True)
class Yard(mb.Model):
    """A ball that bounces, rests and is lifted, a crate that a growing force lifts, and a pile of three bodies."""

    name = "resting"
    weights: int = mb.parameter(1, min=1, structural=True)
    restitution: float = mb.parameter(0.5, min=0.0, max=1.0, doc="Restitution of the ball")
    height: float = mb.parameter(0.5, unit="m", min=0.0, doc="Height of the pile at the start")
    level: float = mb.parameter(0.4, unit="m", min=0.4, doc="Height of the crate at the start")
    mass0: float = mb.parameter(2.0, unit="kg", min=0.01, doc="Mass of the lowest body")
    mass1: float = mb.parameter(1.0, unit="kg", min=0.01, doc="Mass of the second body")
    mass2: float = mb.parameter(1.5, unit="kg", min=0.01, doc="Mass of the highest body")
    e0: float = mb.parameter(0.3, min=0.0, max=1.0, doc="Restitution at the floor")
    e1: float = mb.parameter(0.2, min=0.0, max=1.0, doc="Restitution between the first two bodies")
    e2: float = mb.parameter(0.1, min=0.0, max=1.0, doc="Restitution between the last two bodies")
    kick: float = mb.parameter(2.0, unit="N.s", doc="Impulse at the joint of the second body")
    at: float = mb.parameter(10.0, unit="s", doc="Time of the impulse")
    lock: float = mb.parameter(10.0, unit="s", doc="Time at which the joint of the second body is locked")

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0.0, -G, 0.0))
        lift = mb.Input(name="lift", unit="N", start=0.0)
        ball = m.body("ball", m.ground, mb.Translational(axis="y", start=1.0, nominal=1.0), mass=BALL)
        m.force("lift", mb.JointForce(lift), ball)
        m.event("floor", ball.coordinate(), direction="down", then=mb.Bounce(self.restitution))
        m.event("lift", at=LIFT, then=mb.SetInput("lift", 2.0 * BALL * G))
        crate = m.body("crate", m.ground, mb.Translational(axis="y", start=self.level, nominal=1.0), mass=CRATE)
        m.force("pull", mb.JointForce(mb.Polynomial((0.0, PULL))), crate)
        m.event("ground", crate.coordinate(), crosses=0.4, direction="down", then=mb.Bounce(0.5))
        body, masses, restitutions = m.ground, (self.mass0, self.mass1, self.mass2), (self.e0, self.e1, self.e2)
        for k, (mass, e) in enumerate(zip(masses, restitutions, strict=True)):
            joint = mb.Translational(axis="y", start=0.0 if k else self.height, nominal=1.0)
            body = m.body(f"body{k}", body, joint, mass=mass)
            m.event(f"stop{k}", body.coordinate(), direction="down", then=mb.Bounce(e))
        m.event("kick", at=self.at, then=mb.Impulse(m.bodies[4], self.kick))
        m.event("lock", at=self.lock, then=mb.Lock(m.bodies[4]))
        for k in range(self.weights):
            weight = m.body(f"weight{k}", m.ground, mb.Translational(axis="x", start=0.1, nominal=1.0), mass=1.0)
            m.force(f"weight{k}", mb.JointSpring(stiffness=1.0 + k), weight)
        m.output("ball", ball.coordinate())
        m.output("force", ball.effort())
        m.output("crate", crate.coordinate())
        m.output("hold", crate.effort())
        for k in range(3):
            m.output(f"gap{k}", m.bodies[3 + k].coordinate())
        for k in range(3):
            m.output(f"rate{k}", m.bodies[3 + k].velocity("y"))
        return m


def ball(t: float, e: float) -> tuple[float, float]:
    """Return the height of the ball and the force of the floor: flights that start with e^n times the first speed, then
    rest until the ball is lifted.
    """
    fall, speed = np.sqrt(2.0 / G), np.sqrt(2.0 * G)
    if t <= fall:
        return 1.0 - 0.5 * G * t * t, 0.0
    if t > LIFT:  # all bounces have ended before
        return 0.5 * G * (t - LIFT) ** 2, 0.0
    t, speed = t - fall, e * speed
    while speed > 1e-6 and t > 2.0 * speed / G:
        t, speed = t - 2.0 * speed / G, e * speed
    return (0.0, BALL * G) if speed <= 1e-6 else (speed * t - 0.5 * G * t * t, 0.0)


def crate(t: float) -> tuple[float, float]:
    """Return the height of the crate and the force of the ground: it is lifted when the force reaches its weight."""
    lifted = CRATE * G / PULL
    if t <= lifted:
        return 0.4, CRATE * G - PULL * t
    return 0.4 + PULL * (t - lifted) ** 3 / (6.0 * CRATE), 0.0


def rates_after(masses: np.ndarray, rates: np.ndarray, e: np.ndarray, has_floor: bool) -> np.ndarray:
    """Return the velocities (3,) after an impact of three bodies that touch, by the impact law in absolute coordinates:
    of all sets of impulses the one whose impulses push, and after which no bodies approach more than is allowed.
    """
    contacts = np.eye(3) - np.eye(3, k=-1)
    contacts = contacts if has_floor else contacts[1:]
    leaving = contacts @ rates
    demand = -leaving * np.where(leaving < 0.0, 1.0 + (e if has_floor else e[1:]), 1.0)
    A = contacts / masses @ contacts.T
    for acting in product([False, True], repeat=len(contacts)):
        own, p = np.array(acting), np.zeros(len(contacts))
        p[own] = np.linalg.solve(A[np.ix_(own, own)], demand[own])
        if np.all(p >= 0.0) and np.all(A @ p - demand >= -1e-12):
            return rates + (p @ contacts) / masses
    raise AssertionError


@pytest.fixture(scope="module", params=[1, 70])
def path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    model = Yard(weights=request.param)
    return export(model, tmp_path_factory.mktemp("resting") / "resting.fmu", SETTINGS, native=True)


@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_what_rests_is_held_until_it_is_lifted(restitution: float, path: Path) -> None:
    """Closed forms; what is held does not move at all."""
    with Fmu(path, {"restitution": restitution}) as fmu:
        for k in range(1, 31):
            fmu.step(0.1)
            (height, force), (level, hold) = ball(0.1 * k, restitution), crate(0.1 * k)
            assert fmu["ball"] == pytest.approx(height, abs=3e-6 if height else 0.0)
            assert fmu["force"] == pytest.approx(force, abs=1e-9)
            assert fmu["crate"] == pytest.approx(level, abs=1e-7 if level > 0.4 else 0.0)
            assert fmu["hold"] == pytest.approx(hold, abs=1e-9)


def test_native_and_python_runs_are_the_same(path: Path) -> None:
    """Bounces, rest of the pile and of the ball, an impulse on the pile at rest, and the rest after it."""
    values = {"at": 1.53, "kick": 3.0}
    simulation = mb.Simulation(Yard(weights=70 if "70" in str(path.parent) else 1, **values), SETTINGS)
    with Fmu(path, values) as fmu:
        for k in range(1, 41):
            fmu.step(0.1)
            assert simulation.advance(0.1 * k).ok
            found = [fmu[name] for name in NAMES]
            np.testing.assert_allclose(found, simulation.outputs()[: len(NAMES)], rtol=0.0, atol=1e-6)
        assert found[4:7] == [0.0, 0.0, 0.0]


def draw(seed: int) -> tuple[dict[str, float], np.ndarray, np.ndarray]:
    """Return values of parameters, masses and restitutions of the pile."""
    rng = np.random.default_rng(seed)
    masses, e = 10.0 ** rng.uniform(-1.0, 1.0, 3), rng.uniform(0.0, 0.9, 3)
    values = {f"mass{k}": float(masses[k]) for k in range(3)} | {f"e{k}": float(e[k]) for k in range(3)}
    return values, masses, e


def rates_of(fmu: Fmu) -> list[float]:
    return [fmu[f"rate{k}"] for k in range(3)]


@pytest.mark.parametrize("seed", range(8))
def test_bodies_that_touch_hit_the_floor_together(seed: int, path: Path) -> None:
    """The impact law; gravity acts for a short time after it."""
    values, masses, e = draw(seed)
    fall = np.sqrt(1.0 / G)
    expected = rates_after(masses, np.full(3, -G * fall), e, True) - G * LATER
    with Fmu(path, values) as fmu:
        fmu.step(fall + LATER)
        assert rates_of(fmu) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_bodies_that_touch_in_model_exchange(seed: int, path: Path) -> None:
    """The impact law, after an impulse in free fall."""
    values, masses, e = draw(seed)
    rates = np.array([-1.0 / masses[0], 1.0 / masses[1], 0.0])
    found = simulate_fmu(
        str(path), stop_time=0.1, output_interval=0.05, output=NAMES, start_values=values | {"kick": 1.0, "at": 0.05},
        fmi_type="ModelExchange", relative_tolerance=1e-9, record_events=False,
    )  # fmt: skip
    expected = rates_after(masses, rates, e, False) - G * 0.1
    assert [found[f"rate{k}"][-1] for k in range(3)] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("interval", [0.02, 0.5])
@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_rest_in_model_exchange(restitution: float, interval: float, path: Path) -> None:
    check_exchange(path, restitution, interval, 1e-9, 1e-5)


@pytest.mark.parametrize("path", [1], indirect=True)
@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_rest_in_model_exchange_at_a_coarse_tolerance(restitution: float, path: Path) -> None:
    check_exchange(path, restitution, 0.5, 1e-6, 1e-3)


def check_exchange(path: Path, restitution: float, interval: float, tolerance: float, error: float) -> None:
    """Closed forms; the importing tool locates the time at which the force of a stop becomes zero."""
    found = simulate_fmu(
        str(path), stop_time=3.0, output_interval=interval, output=NAMES, start_values={"restitution": restitution},
        fmi_type="ModelExchange", relative_tolerance=tolerance, record_events=False,
    )  # fmt: skip
    for row in found[1:]:
        (height, force), (level, hold) = ball(row["time"], restitution), crate(row["time"])
        assert row["ball"] == pytest.approx(height, abs=error if height else 0.0)
        assert row["force"] == pytest.approx(force, abs=1e-9)
        assert row["crate"] == pytest.approx(level, abs=error if level > 0.4 else 0.0)
        assert row["hold"] == pytest.approx(hold, abs=1e-9)
    assert [found[f"gap{k}"][-1] for k in range(3)] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("is_held", [True, False])
@pytest.mark.parametrize("seed", range(8))
def test_an_impulse_on_bodies_that_touch(seed: int, is_held: bool, path: Path) -> None:
    """The same law, after an impulse between the first two bodies: on the floor, and in free fall."""
    values, masses, e = draw(seed)
    kick = float(np.random.default_rng(seed).choice([-1.0, 1.0]))
    rates = np.array([-kick / masses[0], kick / masses[1], 0.0])
    before = 0.0 if is_held else -0.2 * G
    expected = rates_after(masses, rates, e, is_held) + before
    with Fmu(path, values | {"kick": kick, "at": 0.2, "height": 0.0 if is_held else 0.5}) as fmu:
        fmu.step(0.2)
        assert rates_of(fmu) == pytest.approx(expected, abs=1e-8)


def test_a_lock_on_bodies_that_touch(path: Path) -> None:
    """The second body has left the first one and is locked to it. What rests on them takes part: momentum on a floor
    that pushes, and does not pull.
    """
    values, masses, _ = draw(1)
    kick, rates = 1.0, np.zeros(3)
    with Fmu(path, values | {"kick": kick, "at": 0.2, "lock": 0.2, "height": 0.5}) as fmu:
        fmu.step(0.2)
        rates = np.array(rates_of(fmu))
    assert rates[0] == pytest.approx(rates[1], abs=1e-9)
    assert masses @ rates == pytest.approx(-0.2 * G * masses.sum(), abs=1e-8)
    assert rates[2] >= rates[1] - 1e-9


def test_a_saved_state_contains_what_rests(path: Path) -> None:
    """The same bits in two instances, of which the second has not rested before."""
    with Fmu(path) as first, Fmu(path) as second:
        first.step(1.6)
        assert first["ball"] == 0.0
        saved, ends = first.save(), []
        for fmu in (first, second, first):
            fmu.restore(saved)
            fmu.t = 1.6
            fmu.step(0.05)
            assert fmu["ball"] == 0.0
            fmu.step(0.5)
            ends.append([fmu[name] for name in NAMES])
        assert ends[0] == ends[1] == ends[2]
        assert ends[0][0] == pytest.approx(ball(2.15, 0.5)[0], abs=3e-6)


@pytest.mark.campaign
@pytest.mark.parametrize("solver", ["hybrid", "radau", "ida"])
@pytest.mark.parametrize("weights", [1, 70])
def test_rest_with_other_solvers(solver: str, weights: int, tmp_path: Path) -> None:
    own = "esdirk" if weights > 1 and solver != "ida" else solver
    settings = mb.Settings(solver=own, tolerance=1e-8)
    path = export(Yard(weights=weights), tmp_path / "resting.fmu", settings, native=True)
    test_what_rests_is_held_until_it_is_lifted(0.5, path)
    for seed in range(3):
        test_an_impulse_on_bodies_that_touch(seed, True, path)
    test_a_saved_state_contains_what_rests(path)


@dataclass(frozen=True, kw_only=True)
class Point(mb.Model):
    """A ball whose stop is on its position, which native FMUs do not hold."""

    name = "point"
    restitution: float = mb.parameter(0.1, min=0.0, max=1.0)

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0.0, -G, 0.0))
        own = m.body("ball", m.ground, mb.Translational(axis="y", start=1.0, nominal=1.0), mass=1.0)
        m.event("floor", own.position("y"), direction="down", then=mb.Bounce(self.restitution))
        m.output("height", own.coordinate())
        return m


@pytest.fixture(scope="module")
def point(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(Point(), tmp_path_factory.mktemp("point") / "point.fmu", SETTINGS, native=True)


@pytest.mark.parametrize("restitution", [0.0, 0.3])
@pytest.mark.parametrize("interval", [0.05, 0.5])
def test_a_stop_of_a_position_holds_nothing_in_model_exchange(restitution: float, interval: float, point: Path) -> None:
    """The steps of the importing tool are longer than the last bounces: without an error the ball would sink."""
    logged: list[str] = []
    with pytest.raises(FMICallException):
        simulate_fmu(
            str(point), stop_time=1.4, output_interval=interval, start_values={"restitution": restitution},
            fmi_type="ModelExchange", relative_tolerance=1e-6, debug_logging=True,
            logger=lambda *call: logged.append(str(call[-1])),
        )  # fmt: skip
    assert any("event 'floor' comes to rest at its stop" in text for text in logged)


def test_a_stop_of_a_position_holds_nothing(point: Path) -> None:
    with Fmu(point) as fmu:
        fmu.step(0.5)
        before = fmu.reals().tolist()
        with pytest.raises(UserError, match="resting-bounce"):
            fmu.step(0.1)
        assert "event 'floor' comes to rest at its stop" in fmu.message()
        assert "A Bounce of a native FMU holds what rests on the stop if its sensor is the coordinate" in fmu.message()
        assert fmu.reals().tolist() == before
        assert not fmu.slave.getBooleanStatus(fmi2Terminated) or fmu.slave.getRealStatus(fmi2LastSuccessfulTime) == 0.5

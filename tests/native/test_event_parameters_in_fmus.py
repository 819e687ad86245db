"""Events of native FMUs that set parameters and restart the solver."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import extract, read_model_description, simulate_fmu
from fmpy.fmi2 import FMU2Model

import mbfmu as mb
from mbfmu.fmi import Fmu
from mbfmu.fmi.export import export
from mbfmu.util.errors import UserError

pytestmark = pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="needs a C compiler")
SETTINGS = mb.Settings(solver="adams", tolerance=1e-8)
START, TIMES, IMPULSE = 0.4, (0.9, 1.3), 4.0  # m, s, N s
PLACE, HALF, FORCE = 1.0, 0.002, 150.0  # of a thin barrier: m, m, N
NAMES = ("x", "angle", "sled")


@dataclass(frozen=True, kw_only=True)
class Tuned(mb.Model):
    """An oscillator whose stiffness and mass change, an arm whose length changes, and a sled that passes a barrier."""

    name = "tuned_by_events"
    stiffness: float = mb.parameter(8.0, unit="N/m", min=1.0, tunable=True)
    mass: float = mb.parameter(2.0, unit="kg", min=0.1, tunable=True)
    length: float = mb.parameter(0.5, unit="m", min=0.1, tunable=True)
    harder: float = mb.parameter(32.0, unit="N/m", min=1.0, doc="Stiffness that the event sets")
    weights: int = mb.parameter(0, min=0, structural=True)
    restarts: bool = mb.parameter(True, structural=True)

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism()
        body = m.body("body", m.ground, mb.Translational(axis="x", start=START, fixed=True), mass=self.mass)
        m.force("spring", mb.JointSpring(stiffness=self.stiffness), body)
        arm = m.body("arm", m.ground, mb.Revolute(start=0.3, fixed=True), mass=1.0, com=(self.length, 0.0, 0.0))
        m.force("torsion spring", mb.JointSpring(stiffness=1.0), arm)
        sled = m.body("sled", m.ground, mb.Translational(axis="x", rate=1.0), mass=1.0)
        barrier = mb.Table([-10.0, PLACE - HALF, PLACE, PLACE + HALF, 10.0], [0.0, 0.0, FORCE, 0.0, 0.0], "linear")
        free = mb.Polynomial((0.0,))  # a signal: with a number the narrow part of the table would declare restarts
        m.force("barrier", mb.JointSpring(stiffness=barrier, free=free), sled)
        m.event("middle", body.coordinate(), direction="down", then=mb.SetParameter("stiffness", self.harder))
        m.event("longer", at=TIMES[0], then=mb.SetParameter("length", 0.8))
        m.event("heavier", at=TIMES[1], then=[mb.SetParameter("mass", 8.0), mb.Impulse(body, IMPULSE)])
        for name, side in (("enter", -HALF), ("peak", 0.0), ("leave", HALF)) if self.restarts else ():
            m.event(name, sled.coordinate(), crosses=PLACE + side, direction="up", then=mb.Restart())
        for k in range(self.weights):
            m.body(f"weight{k}", m.ground, mb.Translational(axis="x", start=0.1), mass=1.0)
        for name, sensor in zip(NAMES, (body.coordinate(), arm.angle(), sled.coordinate()), strict=True):
            m.output(name, sensor)
        return m


def swing(x: float, v: float, w: float, t: float) -> tuple[float, float]:
    """Return position and rate of an oscillator of angular frequency w after a time."""
    return x * np.cos(w * t) + v / w * np.sin(w * t), v * np.cos(w * t) - x * w * np.sin(w * t)


def exact(t: float, stiffness: float = 8.0, harder: float = 32.0) -> list[float]:
    """Values of NAMES, at least 0.01 s before or after the barrier."""
    x, v, last = START, 0.0, 0.0
    first = np.sqrt(stiffness / 2.0)
    second, third = np.sqrt(harder / 2.0), np.sqrt(harder / 8.0)
    for until, w, kick in (
        (0.5 * np.pi / first, first, 0.0),
        (TIMES[1], second, IMPULSE / 8.0),
        (np.inf, third, 0.0),
    ):
        if t > last:
            x, v = swing(x, v, w, min(t, until) - last)
            v, last = v + (kick if t > until else 0.0), until
    angle, rate = swing(0.3, 0.0, 1.0 / 0.5, min(t, TIMES[0]))
    if t > TIMES[0]:
        angle, rate = swing(angle, rate, 1.0 / 0.8, t - TIMES[0])
    passed, slower = PLACE / 1.0, np.sqrt(1.0 - 2.0 * FORCE * HALF)
    return [x, angle, t if t < passed else PLACE + HALF + slower * (t - passed - HALF - delay())]


def delay() -> float:
    """Return by how much longer the sled is in the barrier than without it, s, by integration over the place."""
    s = np.linspace(0.0, HALF, 20001)
    up = 0.5 * FORCE * s**2 / HALF  # work until the middle, then from there
    middle = 0.5 * FORCE * HALF
    rates = np.concatenate((1.0 - 2.0 * up, 1.0 - 2.0 * (2.0 * middle - up[::-1])))
    slow = 1.0 / np.sqrt(rates)
    return float(np.trapezoid(slow[:20001], s) + np.trapezoid(slow[20001:], s) - 2.0 * HALF)


def check(rows: Any, names: tuple[str, ...] = NAMES, **values: float) -> None:
    found = np.array([[row[name] for name in names] for row in rows])
    expected = [exact(row["time"], **values)[: len(names)] for row in rows]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=3e-6)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(Tuned(), tmp_path_factory.mktemp("tuned") / "tuned.fmu", SETTINGS, native=True)


@pytest.mark.parametrize("values", [{}, {"stiffness": 18.0, "harder": 50.0}])
def test_events_set_parameters_within_communication_steps(path: Path, values: dict[str, float]) -> None:
    """Closed form. The impulse acts on the new mass, and the event sets the value that a parameter gives."""
    for interval in (0.07, 2.0):
        check(
            simulate_fmu(str(path), stop_time=2.0, output_interval=interval, output=NAMES, start_values=values),
            **values,
        )


def test_parameters_that_events_have_set_are_saved_read_and_set(path: Path) -> None:
    with Fmu(path) as first, Fmu(path) as second:
        first.step(1.0)
        assert (first["stiffness"], first["length"], first["mass"]) == (32.0, 0.8, 2.0)
        saved, ends = first.save(), []
        for fmu in (first, second, first):
            fmu.restore(saved)
            fmu.t = 1.0
            fmu.step(0.6)
            assert fmu["mass"] == 8.0
            ends.append([fmu[name] for name in NAMES])
        assert ends[0] == ends[1] == ends[2]
        assert ends[0] == pytest.approx(exact(1.6), abs=3e-6)
        first["mass"] = 2.0
        x, _ = swing(*oscillator(1.6), 4.0, 0.4)
        first.step(0.4)
        assert first["x"] == pytest.approx(x, abs=3e-6)
        assert first["mass"] == 2.0


def oscillator(t: float) -> tuple[float, float]:
    """Return position and rate of the oscillator after the last event."""
    h = 1e-6
    return exact(t)[0], (exact(t + h)[0] - exact(t - h)[0]) / (2.0 * h)


def test_a_run_without_restarts_misses_the_barrier() -> None:
    """The test of the restarts could fail: without them the solver steps over the barrier."""
    for restarts, end in ((True, exact(2.0)[2]), (False, 2.0)):
        result = mb.simulate(Tuned(restarts=restarts), 2.0, interval=2.0, solver="adams", tolerance=1e-8)
        assert result["sled"][-1] == pytest.approx(end, abs=3e-6)


@pytest.mark.parametrize("values", [{}, {"stiffness": 18.0, "harder": 50.0}])
def test_events_set_parameters_in_model_exchange(path: Path, values: dict[str, float]) -> None:
    """Closed form. An impulse after a `SetParameter` of the same event acts on the new mass."""
    rows = simulate_fmu(
        str(path), stop_time=2.0, output_interval=0.07, output=NAMES[:2], start_values=values,
        fmi_type="ModelExchange", relative_tolerance=1e-9, record_events=False,
    )  # fmt: skip
    check(rows, NAMES[:2], **values)


def test_parameters_of_events_in_model_exchange_are_read_differentiated_saved_and_set(path: Path) -> None:
    """Closed form: the acceleration is -k x / m with the k of the events and of the importing tool."""
    description = read_model_description(str(path))
    references = {v.name: v.valueReference for v in description.modelVariables}
    fmu = FMU2Model(
        guid=description.guid, unzipDirectory=extract(str(path)),
        modelIdentifier=description.modelExchange.modelIdentifier, instanceName="one",
    )  # fmt: skip
    names = list(references)
    state, rate = references["state.position.body"], references["der(state.velocity.body)"]

    def read(*wanted: str) -> list[float]:
        return [float(x) for x in fmu.getReal([references[name] for name in wanted])]

    def check_slope(stiffness: float, mass: float) -> None:
        fmu.setReal([state], [0.1])
        assert fmu.getReal([rate])[0] == pytest.approx(-0.1 * stiffness / mass, rel=1e-9)
        slope = fmu.getDirectionalDerivative([rate], [state], [1.0])
        assert slope == pytest.approx([-stiffness / mass], rel=1e-9)

    assert {"state.position.body", "der(state.velocity.body)"} <= {*names}
    fmu.instantiate()
    for _ in range(2):
        fmu.setupExperiment(startTime=0.0)
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        assert fmu.newDiscreteStates()[4:] == (True, TIMES[0])
        fmu.enterContinuousTimeMode()
        check_slope(8.0, 2.0)
        fmu.setTime(0.5)
        fmu.setReal([state], [-0.01])
        assert fmu.completedIntegratorStep() == (True, False)
        fmu.enterEventMode()
        assert fmu.newDiscreteStates()[2] is True  # nominal values have changed
        saved = fmu.getFMUState()
        assert read("stiffness", "mass") == [32.0, 2.0]
        fmu.setReal([references["stiffness"]], [5.0])
        assert read("stiffness") == [5.0]
        fmu.newDiscreteStates()
        fmu.enterContinuousTimeMode()
        check_slope(5.0, 2.0)
        fmu.setTime(TIMES[1])
        fmu.enterEventMode()
        fmu.newDiscreteStates()
        fmu.enterContinuousTimeMode()
        assert read("stiffness", "mass", "length") == [5.0, 8.0, 0.8]
        check_slope(5.0, 8.0)
        fmu.setFMUState(saved)
        fmu.setTime(0.5)
        assert read("stiffness", "mass", "length") == [32.0, 2.0, 0.5]
        fmu.enterContinuousTimeMode()
        check_slope(32.0, 2.0)
        fmu.freeFMUState(saved)
        fmu.terminate()
        fmu.reset()
    fmu.freeInstance()


@pytest.mark.campaign
@pytest.mark.parametrize(("solver", "weights"), [("radau", 0), ("ida", 0), ("adams", 70), ("esdirk", 70), ("ida", 70)])
def test_other_solvers(solver: str, weights: int, tmp_path: Path) -> None:
    path = export(Tuned(weights=weights), tmp_path / "t.fmu", mb.Settings(solver=solver, tolerance=1e-8), native=True)
    rows = simulate_fmu(str(path), stop_time=2.0, output_interval=0.07, output=NAMES)
    if solver != "esdirk":
        check(rows)
        return
    check(rows, NAMES[:2])  # errors of rates at corners of a force are not controlled by this solver
    result = mb.simulate(Tuned(weights=weights), 1.96, interval=0.07, solver=solver, tolerance=1e-8)
    np.testing.assert_allclose(rows["sled"][:29], result["sled"], rtol=0.0, atol=1e-9)


@dataclass(frozen=True, kw_only=True)
class Refused(mb.Model):
    """An event sets a parameter that is constant in an FMU, or a value that is not verified."""

    name = "refused"
    angle: float = mb.parameter(0.3, unit="rad", min=-1.0, max=1.0, tunable=True)
    value: float = mb.parameter(0.5, structural=True)

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism()
        turning = 1.0 + abs(self.angle) ** 1.5 + float(np.floor(10.0 * self.angle)) ** 2
        body = m.body("body", m.ground, mb.Revolute(), inertia=(turning, turning, turning))
        m.event("bend", at=0.5, then=mb.SetParameter("angle", self.value))
        m.output("angle", body.angle())
        return m


def test_parameters_that_are_constant_are_refused(tmp_path: Path) -> None:
    text = "event 'bend' sets the parameter 'angle' to 0.5, which a native FMU does not support: "
    with pytest.raises(UserError, match=text):
        export(Refused(), tmp_path / "refused.fmu", SETTINGS, native=True)

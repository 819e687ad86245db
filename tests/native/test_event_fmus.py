"""Events in native FMUs: located within communication steps, as closed forms and the run in Python have them."""

from __future__ import annotations

import shutil
from ctypes import POINTER, c_double
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import extract, read_model_description, simulate_fmu
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Model, fmi2Discard, fmi2LastSuccessfulTime, fmi2Terminated
from fmpy.fmi3 import FMU3Slave

import mbfmu as mb
from mbfmu.fmi import Fmu
from mbfmu.fmi.export import export

pytestmark = pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="needs a C compiler")
G = 9.81
SETTINGS = mb.Settings(solver="adams", tolerance=1e-8)
NAMES = ("height", "ball.rate", "sled", "sled.rate", "bend", "first", "second")
IMPULSE = 0.2  # N m s, at the second joint of the double pendulum


@dataclass(frozen=True, kw_only=True)
class Yard(mb.Model):
    """A ball that bounces, a sled that is pushed and braked, and a double pendulum that is hit."""

    name = "yard"

    restitution: float = mb.parameter(0.8, min=0.0, max=1.0, doc="Coefficient of restitution of the ball")
    mark: float = mb.parameter(0.5, unit="m", min=0.1, max=2.0, doc="Position at which the sled is braked")
    hit: float = mb.parameter(0.35, unit="s", min=0.0, max=2.0, doc="Time of the impulse")

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism()
        force = mb.Input(name="force", unit="N", start=1.0)
        ball = m.body("ball", m.ground, mb.Translational(axis="y", start=1.0, fixed=True), mass=1.0)
        m.force("weight", mb.JointForce(-G), ball)
        sled = m.body("sled", m.ground, mb.Translational(axis="x"), mass=1.0)
        m.force("push", mb.JointForce(force), sled)
        first = m.body("first", m.ground, mb.Revolute(), **mb.rod(mass=1.0, length=1.0))
        second = m.body("second", first, mb.Revolute(at=(1.0, 0.0, 0.0)), **mb.rod(mass=1.0, length=1.0))
        m.event("floor", ball.coordinate(), direction="down", then=mb.Bounce(self.restitution))
        m.event("mark", sled.coordinate(), crosses=self.mark, direction="up", then=mb.SetInput("force", -2.0))
        m.event("stop", sled.rate(), direction="down", then=mb.EndRun())
        m.event("hit", at=self.hit, then=mb.Impulse(second, IMPULSE))
        m.output("height", ball.coordinate())
        m.output("ball.rate", ball.rate())
        m.output("sled", sled.coordinate())
        m.output("sled.rate", sled.rate())
        m.output("bend", second.coordinate())
        m.output("first", first.rate())
        m.output("second", second.rate())
        return m


def ball(t: float, e: float) -> tuple[float, float]:
    """Return height and rate: a parabola from 1 m, then flights that start with e^n times the first speed."""
    fall, speed = np.sqrt(2.0 / G), np.sqrt(2.0 * G)
    t, speed = (t - fall, e * speed) if t > fall else (t + fall, speed)
    while t > 2.0 * speed / G:
        t, speed = t - 2.0 * speed / G, e * speed
    return speed * t - 0.5 * G * t * t, speed - G * t


def sled(t: float, mark: float) -> tuple[float, float]:
    """Return position and rate: 1 N up to the mark, then -2 N."""
    turn = np.sqrt(2.0 * mark)
    if t <= turn:
        return 0.5 * t * t, t
    return mark + turn * (t - turn) - (t - turn) ** 2, turn - 2.0 * (t - turn)


def check(rows: Any, restitution: float = 0.8, mark: float = 0.5, hit: float = 0.35, atol: float = 3e-6) -> None:
    """Compare outputs with closed forms.

    Of the double pendulum the angular momentum about the first joint remains zero, since the impulse acts within it,
    and the energy after the impulse is that of the jump in one line.
    """
    expected = np.array([[*ball(t, restitution), *sled(t, mark)] for t in rows["time"]])
    for name, exact in zip(NAMES[:4], expected.T, strict=True):
        np.testing.assert_allclose(rows[name], exact, rtol=0.0, atol=atol, err_msg=name)
    first, second, bend = rows["first"], rows["second"], np.cos(rows["bend"])
    moving = rows["time"] > hit
    np.testing.assert_allclose(second[~moving], 0.0, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose((5 / 3 + bend) * first + (1 / 3 + 0.5 * bend) * second, 0.0, rtol=0.0, atol=atol)
    energy = 0.5 * (5 / 3 + bend) * first**2 + (1 / 3 + 0.5 * bend) * first * second + second**2 / 6
    jump = np.linalg.solve([[8 / 3, 5 / 6], [5 / 6, 1 / 3]], [0.0, IMPULSE])
    np.testing.assert_allclose(energy[moving], 0.5 * IMPULSE * jump[1], rtol=0.0, atol=atol)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(Yard(), tmp_path_factory.mktemp("events") / "yard.fmu", SETTINGS, native=True)


@pytest.mark.parametrize("values", [{}, {"restitution": 0.5, "mark": 0.3, "hit": 0.21}])
def test_events_within_communication_steps(path: Path, values: dict[str, float]) -> None:
    """Closed forms, with parameters in the numbers of events; no event is at a communication point."""
    found = simulate_fmu(
        str(path), stop_time=5.0, output_interval=0.17, output=NAMES, start_values=values, fmi_type="CoSimulation"
    )
    end = 1.5 * np.sqrt(2.0 * values.get("mark", 0.5))
    assert found["time"][-1] == pytest.approx(end, abs=1e-7)
    check(found, **values)
    simulation = mb.Simulation(Yard(**values), SETTINGS)
    for row in found[1:-1]:
        assert simulation.advance(row["time"]).ok
        np.testing.assert_allclose(
            [row[name] for name in NAMES], simulation.outputs()[: len(NAMES)], rtol=0.0, atol=1e-7
        )


def rows_at(fmu: Fmu, t: float) -> dict[str, Any]:
    """Return the outputs of an FMU as rows with their time."""
    return {"time": np.array([t]), **{name: np.array([fmu[name]]) for name in NAMES}}


def test_steps_with_events_are_repeated(path: Path) -> None:
    """An importing tool returns to states before events; a second instance continues from them to the same bits."""
    with Fmu(path) as first, Fmu(path) as second:
        states, reached = [], []
        for _ in range(7):
            states.append(first.save())
            first.step(0.2)
            reached.append(first.reals().tolist())
        check(rows_at(first, first.t))
        for fmu in (first, second):
            for k in (3, 0, 5):
                fmu.restore(states[k])
                fmu.t = 0.2 * k
                for i in range(k, 7):
                    fmu.step(0.2)
                    assert fmu.reals().tolist() == reached[i]
        second.restore(states[1])
        second.t = 0.2
        second["force"] = 1.5  # from 0.2 s on
        second.step(0.5)
        assert second["sled"] == pytest.approx(0.02 + 0.2 * 0.5 + 0.75 * 0.5**2, abs=1e-6)
        assert first.reals().tolist() == reached[-1]


def test_a_step_beyond_the_end_of_the_run_stops_at_its_event(path: Path) -> None:
    """FMI 2.0, section 4.2.2: fmi2Discard, fmi2Terminated, and the time of the event."""
    with Fmu(path) as fmu:
        fmu.step(1.3)
        before, slave = fmu.save(), fmu.slave
        for _ in range(2):
            with pytest.raises(FMICallException) as raised:
                slave.doStep(currentCommunicationPoint=fmu.t, communicationStepSize=0.6)
            assert raised.value.status == fmi2Discard
            assert slave.getBooleanStatus(fmi2Terminated)
            fmu.t = slave.getRealStatus(fmi2LastSuccessfulTime)
            assert fmu.t == pytest.approx(1.5, abs=1e-7)
            check(rows_at(fmu, fmu.t))
        assert "event 'stop' has ended the run at t = 1.5" in fmu.message()
        assert "[run-ended]" in fmu.message()
        fmu.restore(before)
        fmu.t = 1.3
        fmu.step(0.1)
        assert not slave.getBooleanStatus(fmi2Terminated)
        check(rows_at(fmu, 1.4))


def test_a_step_that_is_much_longer_than_the_run_has_events_at_their_times(path: Path) -> None:
    """The impulse is not executed at a bounce before it: the spacing of floating-point numbers at 1e16 s is 2 s."""
    with Fmu(path, {"hit": 1.2}) as fmu:
        with pytest.raises(FMICallException):
            fmu.slave.doStep(currentCommunicationPoint=0.0, communicationStepSize=1e16)
        end = fmu.slave.getRealStatus(fmi2LastSuccessfulTime)
        assert end == pytest.approx(1.5, abs=1e-7)
        check(rows_at(fmu, end), hit=1.2)
        turned = fmu["bend"]
    with Fmu(path, {"hit": 1.2}) as fmu:
        fmu.step(end)
        assert fmu["bend"] == pytest.approx(turned, abs=1e-7)


@pytest.fixture(scope="module")
def fmi3_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(Yard(), tmp_path_factory.mktemp("events3") / "yard3.fmu", SETTINGS, native=True, fmi=3)


@pytest.mark.parametrize("early", [False, True])
def test_events_in_fmi_3(early: bool, fmi3_path: Path, tmp_path: Path) -> None:
    path = fmi3_path
    description = read_model_description(str(path))
    numbers = {v.name: v.valueReference for v in description.modelVariables}
    slave = FMU3Slave(
        guid=description.instantiationToken,
        unzipDirectory=extract(str(path), str(tmp_path / "unzipped")),
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="one",
    )
    slave.instantiate(earlyReturnAllowed=early)
    slave.enterInitializationMode(startTime=0.0)
    slave.exitInitializationMode()
    done = slave.doStep(currentCommunicationPoint=0.0, communicationStepSize=1.1)
    assert done[1:] == (False, False, pytest.approx(1.1))
    _, ends, has_returned, t = slave.doStep(currentCommunicationPoint=1.1, communicationStepSize=0.7)
    assert (ends, has_returned) == (True, early)
    assert t == pytest.approx(1.5, abs=1e-7)
    check({"time": np.array([t])} | {n: np.array(slave.getFloat64([numbers[n]])) for n in NAMES})
    values = slave.getFloat64([numbers[f"event.{name}"] for name in ("floor", "mark", "stop")])
    assert values == pytest.approx([ball(t, 0.8)[0], sled(t, 0.5)[0] - 0.5, 0.0], abs=3e-6)
    slave.terminate()
    slave.freeInstance()


@pytest.mark.parametrize("restitution", [0.5, 0.8])
def test_an_importing_tool_with_fixed_steps_passes_the_stop_before_each_bounce(path: Path, restitution: float) -> None:
    """Semi-implicit steps of 1 ms, with event mode at completed steps beyond the floor only; bounces are no rest."""
    description = read_model_description(str(path))
    fmu = FMU2Model(
        guid=description.guid,
        unzipDirectory=extract(str(path)),
        modelIdentifier=description.modelExchange.modelIdentifier,
        instanceName="fixed",
    )
    fmu.instantiate()
    fmu.setReal([next(v.valueReference for v in description.modelVariables if v.name == "restitution")], [restitution])
    fmu.setupExperiment(startTime=0.0, stopTime=1.0)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    fmu.newDiscreteStates()
    fmu.enterContinuousTimeMode()
    count = int(description.numberOfContinuousStates)
    x, slopes, step, bounces = np.zeros(count), np.zeros(count), 1e-3, 0
    state, slope = (array.ctypes.data_as(POINTER(c_double)) for array in (x, slopes))
    fmu.getContinuousStates(state, count)
    half = count // 2
    for k in range(1, 911):
        fmu.getDerivatives(slope, count)
        x[half:] += step * slopes[half:]
        x[:half] += step * x[half:]
        fmu.setTime(k * step)
        fmu.setContinuousStates(state, count)
        if fmu.completedIntegratorStep()[0]:
            bounces += x[half] < 0.0
            fmu.enterEventMode()
            fmu.newDiscreteStates()
            fmu.enterContinuousTimeMode()
            fmu.getContinuousStates(state, count)
    assert bounces == (2 if restitution == 0.5 else 1)  # closed form: at 0.4515 s, and 0.9030 s or 1.1739 s
    assert x[0] == pytest.approx(ball(0.91, restitution)[0], abs=0.02)
    fmu.freeInstance()


def test_an_event_ends_runs_of_many_without_a_failure() -> None:
    """Closed form; after the end there are no values."""
    marks = [0.3, 0.5, 1.9]
    batch = mb.simulate_many(
        Yard(), 1.6, interval=0.2, parameters={"mark": marks}, outputs=["sled"], solver="adams", tolerance=1e-8
    )
    assert batch.failures == ("", "", "")
    assert [[d.code for d in own] for own in batch.diagnostics] == [["run-ended"], ["run-ended"], []]
    for mark, found in zip(marks, batch["sled"], strict=True):
        runs = batch.t < 1.5 * np.sqrt(2.0 * mark)
        np.testing.assert_allclose(found[runs], [sled(t, mark)[0] for t in batch.t[runs]], rtol=0.0, atol=3e-6)
        assert np.isnan(found[~runs]).all()


@pytest.mark.parametrize("values", [{}, {"restitution": 0.5, "mark": 0.3, "hit": 0.21}])
@pytest.mark.parametrize("fmi", [2, 3])
def test_events_in_model_exchange(fmi: int, values: dict[str, float], request: pytest.FixtureRequest) -> None:
    """CVode locates the changes of sign of the event indicators; the FMU acts in event mode, and ends the run."""
    path = request.getfixturevalue("path" if fmi == 2 else "fmi3_path")
    description = read_model_description(str(path), validate=True)
    count = int(description.numberOfEventIndicators) if fmi == 2 else len(description.eventIndicators)
    assert count == 3
    found = simulate_fmu(
        str(path), stop_time=5.0, output_interval=0.17, output=NAMES, start_values=values, fmi_type="ModelExchange",
        relative_tolerance=1e-9, record_events=False,
    )  # fmt: skip
    end = 1.5 * np.sqrt(2.0 * values.get("mark", 0.5))
    assert found["time"][-1] == pytest.approx(0.17 * np.floor(end / 0.17), abs=1e-9)
    check(found, **values, atol=2e-5)


def test_a_completed_step_beyond_an_event_requires_event_mode(path: Path) -> None:
    """An importing tool without a search for changes of sign sets states beyond the mark of the sled."""
    description = read_model_description(str(path))
    fmu = FMU2Model(
        guid=description.guid,
        unzipDirectory=extract(str(path)),
        modelIdentifier=description.modelExchange.modelIdentifier,
        instanceName="one",
    )
    fmu.instantiate()
    fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    assert fmu.newDiscreteStates()[:2] == (False, False)
    assert fmu.newDiscreteStates()[4:] == (True, 0.35)
    fmu.enterContinuousTimeMode()
    count = int(description.numberOfContinuousStates)
    x, slopes, indicators = np.zeros(count), np.zeros(count), np.zeros(3)
    places = [array.ctypes.data_as(POINTER(c_double)) for array in (x, slopes, indicators)]
    fmu.getContinuousStates(places[0], count)
    fmu.setTime(0.25)
    x[1], x[count // 2 + 1] = 0.03125, 0.25
    fmu.setContinuousStates(places[0], count)
    fmu.getEventIndicators(places[2], 3)
    np.testing.assert_allclose(indicators, [1.0, 0.03125 - 0.5, 0.25], rtol=1e-12)
    assert fmu.completedIntegratorStep() == (False, False)
    fmu.setTime(0.3)
    x[1], x[count // 2 + 1] = 0.6, 1.0
    fmu.setContinuousStates(places[0], count)
    assert fmu.completedIntegratorStep() == (True, False)
    for force in (1.0, -2.0):
        fmu.getDerivatives(places[1], count)
        assert slopes[count // 2 + 1] == pytest.approx(force, rel=1e-9)
        fmu.enterEventMode()
        fmu.newDiscreteStates()
        fmu.enterContinuousTimeMode()
    assert fmu.completedIntegratorStep() == (False, False)
    fmu.terminate()
    fmu.freeInstance()

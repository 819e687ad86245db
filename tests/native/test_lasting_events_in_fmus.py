"""Native FMUs whose events require that a quantity remains beyond a value for a time."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import simulate_fmu
from numpy.typing import NDArray

import mbfmu as mb
from mbfmu.fmi import Fmu
from mbfmu.fmi.export import export

pytestmark = pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="needs a C compiler")
SETTINGS = mb.Settings(solver="adams", tolerance=1e-8)
FREQUENCY, AMPLITUDE = 2.0, 0.5  # rad/s, m
PERIOD = 2.0 * np.pi / FREQUENCY
DURATION = 2.0 * PERIOD
# direction and lasts (s) of each event; the oscillator is above 0.3 m for 0.927 s of each period, below for 2.214 s
EVENTS = (("down", 2.0), ("up", 0.4), ("up", 0.8), ("down", 2.3))
NAMES = (*(f"sled{k}" for k in range(len(EVENTS))), "drag", "x")


@dataclass(frozen=True, kw_only=True)
class Lasting(mb.Model):
    """An oscillator x = 0.5 cos(2 t), and sleds that are pushed when it has been beyond a level for a time.

    The position of a sled is the sum of the times since its events. Another sled starts from rest at the value of its
    event: a constant force of -1 N acts on it, and it is held after 0.5 s of motion to the negative side.
    """

    name = "lasting"
    level: float = mb.parameter(0.3, unit="m", min=-0.4, max=0.4)
    longer: float = mb.parameter(0.0, unit="s", min=0.0, max=1.0, doc="Time that is added to each time")

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism()
        mass = m.body("mass", m.ground, mb.Translational(axis="x", start=AMPLITUDE, fixed=True), mass=2.0)
        m.force("spring", mb.JointSpring(stiffness=2.0 * FREQUENCY**2), mass)
        for k, (direction, lasts) in enumerate(EVENTS):
            sled = m.body(f"sled{k}", m.ground, mb.Translational(axis="y"), mass=1.0)
            m.event(
                f"e{k}", mass.coordinate(), crosses=self.level, direction=direction, lasts=lasts + self.longer,
                then=mb.Impulse(sled, 1.0),
            )  # fmt: skip
            m.output(f"sled{k}", sled.coordinate())
        drag = m.body("drag", m.ground, mb.Translational(axis="z"), mass=1.0)
        m.force("drag force", mb.JointForce(-1.0), drag)
        m.event("back", drag.rate(), direction="down", lasts=0.5 + self.longer, then=mb.Impulse(drag, 10.0))
        m.output("drag", drag.coordinate())
        m.output("x", mass.coordinate())
        return m


def event_times(level: float = 0.3, longer: float = 0.0) -> list[NDArray[np.float64]]:
    """Times of the events: a period begins and ends above the level."""
    leave, count = np.arccos(level / AMPLITUDE) / FREQUENCY, np.arange(4)
    sides = {
        "down": (leave + PERIOD * count, PERIOD - 2.0 * leave),
        "up": (np.append(0.0, PERIOD - leave + PERIOD * count), 2.0 * leave),
    }
    found = []
    for direction, lasts in EVENTS:
        begins, remains = sides[direction]
        ends = begins + remains - (leave if direction == "up" else 0.0) * (begins == 0.0)
        found.append(begins[begins + lasts + longer < ends] + lasts + longer)
    return found


def exact(t: float, level: float = 0.3, longer: float = 0.0) -> list[float]:
    """Values of NAMES; the last sled does not return to negative rates within the duration if it is pushed."""
    sleds = [float(np.maximum(t - times, 0.0).sum()) for times in event_times(level, longer)]
    return [*sleds, -0.5 * t * t + 10.0 * max(t - 0.5 - longer, 0.0), AMPLITUDE * np.cos(FREQUENCY * t)]


def check(rows: Any, atol: float = 2e-6, **values: float) -> None:
    found = np.array([[row[name] for name in NAMES] for row in rows])
    expected = [exact(row["time"], **values) for row in rows]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=atol)


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    folder = tmp_path_factory.mktemp("lasting")
    return {fmi: export(Lasting(), folder / f"lasting{fmi}.fmu", SETTINGS, native=True, fmi=fmi) for fmi in (2, 3)}


VALUES = [{}, {"level": -0.1, "longer": 0.13}, {"level": 0.1, "longer": 0.3}]


@pytest.mark.parametrize("values", VALUES)
@pytest.mark.parametrize("interval", [0.037, 0.3, 10.0])
def test_co_simulation(interval: float, values: dict[str, float], paths: dict[int, Path]) -> None:
    """Closed form, and the run in Python. No event is at a communication point, and the longest step has all events."""
    found = simulate_fmu(
        str(paths[2]), stop_time=DURATION, output_interval=min(interval, DURATION), output=NAMES, start_values=values,
        fmi_type="CoSimulation",
    )  # fmt: skip
    check(found, **values)
    simulation = mb.Simulation(Lasting(**values), SETTINGS)
    for row in found[1:]:
        assert simulation.advance(row["time"]).ok
        np.testing.assert_allclose(
            [row[name] for name in NAMES], simulation.outputs()[: len(NAMES)], rtol=0.0, atol=1e-12
        )


@pytest.mark.parametrize("values", VALUES)
@pytest.mark.parametrize("interval", [0.17, 3.0])
@pytest.mark.parametrize("fmi", [2, 3])
def test_model_exchange(fmi: int, interval: float, values: dict[str, float], paths: dict[int, Path]) -> None:
    """The importing tool locates the crossings, and the FMU requests a time event at the end of the time. With the long
    interval no step is completed before the first crossing.
    """
    found = simulate_fmu(
        str(paths[fmi]), stop_time=DURATION, output_interval=interval, output=NAMES, start_values=values,
        fmi_type="ModelExchange", relative_tolerance=1e-9, record_events=False,
    )  # fmt: skip
    check(found, atol=2e-5, **values)


def rows_at(fmu: Fmu) -> list[dict[str, float]]:
    return [{"time": fmu.t, **{name: fmu[name] for name in NAMES}}]


def test_states_within_the_times_are_saved(paths: dict[int, Path]) -> None:
    """Times begin before a state is saved and end after it, in two instances; restored states lead to the same bits."""
    with Fmu(paths[2]) as first, Fmu(paths[2], {"longer": 0.2}) as second:
        states, reached = [], []
        for _ in range(12):
            states.append(first.save())
            first.step(0.5)
            reached.append(first.reals().tolist())
            second.step(0.5)
            check(rows_at(second), longer=0.2)
        check(rows_at(first))
        for fmu in (first, second):
            for k in (2, 5, 0, 7):
                fmu.restore(states[k])
                fmu.t = 0.5 * k
                for i in range(k, min(k + 5, 12)):
                    fmu.step(0.5)
                    assert fmu.reals().tolist() == reached[i]

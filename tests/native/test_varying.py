"""Signals of time: machine code evaluates them with the bits of a simulation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from running import Running, needs_linker

from mbfmu.mechanics import (
    Harmonic,
    Input,
    JointForce,
    JointSpring,
    Mechanism,
    PointForce,
    Product,
    Ramp,
    Revolute,
    RevoluteCutJoint,
    RunUp,
    Step,
    Sum,
    Table,
    Translational,
    rod,
)
from mbfmu.modeling import Model, parameter
from mbfmu.native.parameters import find_settable
from mbfmu.session.simulation import Settings, Simulation
from solvers.compiled.tuple_pointer import unpin
from solvers.outcome import OK

SOLVERS = ("adams", "hybrid", "radau")
TIMES = (0.01, 0.02, 1.0, 2.7, 2.71, 3.0, 4.5, 7.0, 7.01, 10.0)  # s; most of what happens is far from any of them
LATE = 5.3  # s

LOADS: dict[str, Any] = {
    "harmonic": Harmonic(amplitude=100.0, frequency=5.0),
    "step": Step(height=1.0, begin=LATE),
    "smooth step": Step(height=1.0, begin=LATE, duration=0.01),
    "ramp": Ramp(height=1.0, begin=LATE, duration=0.3),
    "run-up": RunUp(speed=1.0, duration=0.2),
    "table": Table((LATE, 5.5, 5.7), (0.0, 2.0, 0.0), kind="linear", beyond="hold"),
    "periodic table": Table((0.0, 0.1, 0.25), (0.0, 2.0, 0.0), beyond="periodic"),
    "pulse": Sum(Step(height=1.0, begin=LATE, duration=0.01), Step(height=-1.0, begin=6.0, duration=0.01)),
    "product": Product(Step(height=1.0, begin=LATE, duration=0.1), Sum(1.0, Harmonic(amplitude=3.0, frequency=4.0))),
}


def pushed(force: Any) -> Mechanism:
    """A mass that rests until something pushes it."""
    m = Mechanism()
    body = m.body("mass", m.ground, Translational(axis="x"), mass=1.0)
    m.force("push", JointForce(force), body)
    m.output("rate", body.rate())
    return m


DRIVES: dict[str, Any] = {
    "harmonic": Harmonic(amplitude=0.3, frequency=2.0, mean=0.1),
    "run-up": RunUp(speed=6.0, duration=0.4),
    "step": Step(height=1.0, begin=LATE, duration=0.2),
    "table": Table((2.0, 2.2, 2.5, 2.6), (0.0, 0.4, 0.1, 0.3), beyond="hold"),
    "sum": Sum(Step(height=1.0, begin=LATE, duration=0.2), RunUp(speed=2.0, duration=1.0)),
    "product": Product(Step(height=1.0, begin=2.1, duration=0.4), Harmonic(amplitude=0.2, frequency=3.0)),
}


def crane(drive: Any) -> Mechanism:
    """A four-bar with a rod that is connected to its coupler, on a hub that is driven."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    hub = m.body("hub", m.ground, Revolute(drive=drive), mass=1.0, inertia=(0.1, 0.1, 0.1))
    left = m.body("left", hub, Revolute(start=1.0, fixed=True), **rod(mass=1.0, length=0.5))
    right = m.body("right", hub, Revolute(at=(1.0, 0, 0), start=1.2), **rod(mass=1.0, length=0.6))
    bar = m.body("bar", left, Revolute(at=(0.5, 0, 0), start=-1.0), **rod(mass=2.0, length=1.0))
    m.cut("pin", RevoluteCutJoint(at_a=(1.0, 0, 0), at_b=(0.6, 0, 0)), bar, right)
    m.body("bob", bar, Revolute(at=(0.5, 0, 0), start=-1.5), **rod(mass=0.5, length=0.4))
    for body in (left, right):
        m.force(f"damper of {body.name}", JointSpring(damping=0.5), body)
    m.output("left", left.angle())
    m.output("bob", m.bodies[-1].angle())
    m.output("effort", hub.effort())
    return m


def follow(simulation: Simulation, native: Running, times: Any, entry: str = "step") -> None:
    """Go on to the same times, with equal rows of outputs and counters of steps."""
    for t in times:
        assert native.call(entry, t) == int(simulation.advance(t).code) == OK
        assert native.call("read") == OK
        np.testing.assert_array_equal(native.out, simulation.outputs())
    native.call("count")
    assert native.view(native.instance.counts)[0] == simulation.statistics.steps


def begun(make: Any, settings: Settings) -> tuple[Simulation, Running]:
    """A simulation and machine code of one like it."""
    native = Running(Simulation(make(), settings))
    assert native.call("begin", 0.0) == OK
    return Simulation(make(), settings), native


@needs_linker
@pytest.mark.parametrize("entry", ["step", "advance"])
@pytest.mark.parametrize("name", LOADS)
@pytest.mark.parametrize("solver", SOLVERS)
def test_what_pushes_a_mass_is_seen(solver: str, name: str, entry: str):
    simulation, native = begun(partial(pushed, LOADS[name]), Settings(solver=solver))
    follow(simulation, native, TIMES, entry)
    assert abs(native.out[0]) > 0.3 or name == "harmonic"


@needs_linker
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_pulse_within_one_communication_step_is_not_passed_by(solver: str):
    """Closed form: the impulse is the width of the pulse."""
    _, native = begun(partial(pushed, LOADS["pulse"]), Settings(solver=solver, tolerance=1e-6))
    assert native.call("step", 10.0) == OK
    assert native.call("read") == OK
    assert native.out[0] == pytest.approx(0.7, abs=3e-5)


@needs_linker
@pytest.mark.parametrize("name", DRIVES)
@pytest.mark.parametrize("solver", SOLVERS)
def test_what_drives_a_loop_is_seen(solver: str, name: str):
    simulation, native = begun(partial(crane, DRIVES[name]), Settings(solver=solver))
    follow(simulation, native, TIMES)


def shaken_and_pulled() -> Mechanism:
    """A rod on a shaken base that a host pulls."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    shaken = Translational(axis="x", drive=Step(height=0.2, begin=0.4, duration=0.1))
    base = m.body("base", m.ground, shaken, mass=1.0)
    bar = m.body("bar", base, Revolute(start=-1.2), **rod(mass=1.0, length=0.6))
    pull = Input(name="pull", unit="N")
    m.force("pull", PointForce(magnitude=pull, axis="x", at_a=(0.6, 0.0, 0.0)), bar)
    m.output("angle", bar.angle())
    return m


@needs_linker
@pytest.mark.parametrize("inputs", ["hold", "linear"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_inputs_come_on_top(solver: str, inputs: str):
    simulation, native = begun(shaken_and_pulled, Settings(solver=solver, input_interpolation=inputs))
    for k in range(60):
        simulation.set_input(0, float(np.sin(0.3 * k)))
        assert native.call("set", 0, float(np.sin(0.3 * k)), np.nan) == OK
        follow(simulation, native, [0.02 * (k + 1)])


def lifted() -> Mechanism:
    """A double pendulum in a lift that starts late, on a support whose tilt a host gives."""
    tilt = Input(name="tilt", unit="rad")
    m = Mechanism(gravity=(Product(9.81, tilt), Sum(-9.81, Step(height=-2.0, begin=0.4, duration=0.1)), 0.0))
    upper = m.body("upper", m.ground, Revolute(start=-1.2), **rod(mass=1.0, length=0.6))
    lower = m.body("lower", upper, Revolute(at=(0.6, 0.0, 0.0)), **rod(mass=2.0, length=0.5))
    m.output("angle", lower.angle())
    m.output("energy", m.energy)
    return m


@needs_linker
@pytest.mark.parametrize("solver", SOLVERS)
def test_gravity_is_a_signal(solver: str):
    simulation, native = begun(lifted, Settings(solver=solver))
    for k in range(60):
        simulation.set_input(0, float(0.1 * np.sin(0.3 * k)))
        assert native.call("set", 0, float(0.1 * np.sin(0.3 * k)), np.nan) == OK
        follow(simulation, native, [0.02 * (k + 1)])


@needs_linker
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_host_s_longest_step_holds_too(solver: str):
    follow(*begun(partial(pushed, LOADS["pulse"]), Settings(solver=solver, max_step=0.2)), TIMES)


@needs_linker
def test_a_state_that_was_saved_on_the_way_to_an_event_goes_on():
    make = partial(pushed, LOADS["product"])
    simulation, first = begun(make, Settings(solver="adams"))
    second = Running(Simulation(make(), Settings(solver="adams")))
    follow(simulation, first, TIMES[:6])
    second.block[: second.image.saved] = first.block[: first.image.saved]
    follow(simulation, second, TIMES[6:])


@dataclass(frozen=True, kw_only=True)
class Shaken(Model):
    """A mass that is shaken and pushed late."""

    frequency: float = parameter(2.0, unit="Hz", min=0.1, tunable=True, doc="of the shaking")
    height: float = parameter(0.5, unit="N", min=0.0, tunable=True, doc="of the late push")
    begin: float = parameter(4.0, unit="s", min=0.0, tunable=True, doc="of the push")

    def build(self) -> Mechanism:
        """Return the mechanism."""
        return pushed(
            Sum(
                Harmonic(amplitude=1.0, frequency=self.frequency),
                Step(height=self.height, begin=self.begin, duration=0.05),
                Table((self.begin, self.begin + 0.5, self.begin + 1.0), (0.0, self.height, 0.0), "linear", "hold"),
            )
        )


def put(memory: NDArray[np.uint8], at: int, value: float) -> None:
    """Write a number that is near what is there."""
    there = memory[at : at + 8].view(np.float64)
    there[0] = value


@needs_linker
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_host_changes_parameters_of_signals(solver: str):
    """On the way, with the late push still ahead; what follows parameters to the last digits is put into both."""
    simulation, native = begun(Shaken, Settings(solver=solver))
    follow(simulation, native, TIMES[:4])
    live = find_settable(Shaken())
    assert set(live.parameters) == {"frequency", "height", "begin"}
    changed = {"frequency": 16.0, "height": 1.0, "begin": 8.0}
    simulation.retune(Shaken(**changed))
    arrays, own = simulation.compiled.data.arrays, unpin(unpin(native.instance.given.eqs.data).arrays)
    assert native.call("note_energy") == OK
    for (name, offset), value in live.apply(changed).items():
        there = getattr(arrays, name).view(np.uint8)
        assert there[offset : offset + 8].view(np.float64)[0] == pytest.approx(value, rel=1e-12)
        put(there, offset, value)
        put(native.block, native.image.at(getattr(own, name)) + offset, value)
    assert native.call("retune") == OK
    pushed_before = native.out[0]
    follow(simulation, native, TIMES[4:])
    assert native.out[0] - pushed_before > 0.5

"""Inputs, supports and energy check at communication points: machine code agrees with a simulation bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from running import Running, needs_linker

from fmus.fourbar import FourBar
from mbfmu.mechanics import (
    Input,
    JointSpring,
    LineForce,
    Mechanism,
    PointForce,
    Revolute,
    RevoluteCutJoint,
    SpeedInput,
    SphericalCutJoint,
    Translational,
    rod,
)
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.errors import UserError
from solvers.compiled.tuple_pointer import unpin
from solvers.outcome import NOT_FINITE, OK, Code

STEPS, H = 60, 0.01  # s
SOLVERS = ("adams", "hybrid", "radau")
Given = Callable[[int], list[tuple[int, float]]]  # inputs and their values at the beginning of a step


def pair(make: Callable[[], Any], settings: Settings) -> Any:
    """A simulation and machine code of one like it, both begun."""
    native = Running(Simulation(make(), settings))
    assert native.call("begin", 0.0) == OK
    return Simulation(make(), settings), native


def assert_same_record(native: Any, simulation: Any) -> None:
    """Compare the fields of a record of the session, but for what native runs alone keep there."""
    for name in native.dtype.names:
        if name not in ("code", "before"):
            np.testing.assert_array_equal(native[name], simulation[name], name)


def follow(
    simulation: Simulation, native: Running, given: Given, first: int = 0, last: int = STEPS, ends: Any = (OK,)
) -> None:
    """Take steps with the same inputs, which end so, and compare rows of outputs."""
    codes = []
    for k in range(first, last):
        for index, value in given(k):
            simulation.set_input(index, value)
            assert native.call("set", index, float(value), np.nan) == OK
        codes.append(int(simulation.advance((k + 1) * H).code))
        assert native.call("step", (k + 1) * H) == codes[-1]
        assert native.call("read") == OK
        np.testing.assert_array_equal(native.out, simulation.outputs())
    memories = native.instance.session.memory(), simulation.session.memory()
    for array, here in zip(*memories, strict=True):
        for one, other in zip(native.view(array) if array.nbytes else (), here, strict=True):
            assert_same_record(one, other)
    assert native.run_status["lost"] == bool(simulation.warning)
    assert set(codes) == set(ends)


def torque(k: int) -> list[tuple[int, float]]:
    """Changes smoothly, jumps, and is left alone now and then."""
    return [] if k % 7 == 3 else [(0, float(np.sin(0.3 * k) + 5.0 * (k > 30)))]


@needs_linker
@pytest.mark.parametrize("inputs", ["hold", "linear"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_torque_that_a_host_sets(solver: str, inputs: str):
    follow(*pair(FourBar, Settings(solver=solver, input_interpolation=inputs)), torque)


@needs_linker
def test_without_an_energy_check_its_outputs_are_no_numbers():
    simulation, native = pair(FourBar, Settings(solver="adams", energy_check=False))
    follow(simulation, native, torque, last=5)
    assert np.isnan(native.out[-2:]).all()


@needs_linker
def test_an_energy_check_that_a_host_turns_on_is_that_of_a_simulation():
    """Also in what depends on the mechanism, such as the check of slow passages of one degree of freedom."""
    native = Running(Simulation(FourBar(), Settings(solver="adams", energy_check=False)))
    native.view(native.instance.options)["energy_check"] = 1
    assert native.call("begin", 0.0) == OK
    simulation = Simulation(FourBar(), Settings(solver="adams"))
    assert simulation.session.balance["has_one_freedom"]
    follow(simulation, native, torque, last=5)


def weighed() -> Mechanism:
    """A pendulum of two rods whose weight is an input, pulled and damped."""
    m = Mechanism(gravity=(0.0, Input(name="weight", unit="m/s2", start=-9.81), 0.0))
    upper = m.body("upper", m.ground, Revolute(start=0.3), **rod(mass=1.0, length=1.0))
    lower = m.body("lower", upper, Revolute(at=(1, 0, 0), start=-0.5), **rod(mass=1.0, length=1.0))
    m.force("friction", JointSpring(damping=0.05), lower)
    pull = Input(name="pull", unit="N", rate_name="pull_rate")
    m.force("pull", PointForce(magnitude=pull, axis="x", at_a=(1, 0, 0)), lower)
    m.output("angle", lower.angle())
    m.output("energy", m.energy)
    return m


@needs_linker
@pytest.mark.parametrize("inputs", ["hold", "linear"])
@pytest.mark.parametrize("solver", ["adams", "radau"])
def test_gravity_and_a_force_with_its_rate(solver: str, inputs: str):
    def given(k: int) -> list[tuple[int, float]]:
        return [(0, -9.81 - 0.3 * k), (1, 0.1 * k), (2, 10.0)] if k % 5 == 2 else [(1, 0.1 * k)]

    simulation, native = pair(weighed, Settings(solver=solver, input_interpolation=inputs))
    assert [v.name for v in simulation.compiled.inputs.variables] == ["weight", "pull", "pull_rate"]
    follow(simulation, native, given)
    assert simulation.discontinuity_work != 0.0


def lifted() -> Mechanism:
    """A bar on a hinge, with a cylinder whose force is an input."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    bar = m.body("bar", m.ground, Revolute(start=0.3), **rod(mass=1.0, length=1.0))
    push = LineForce(magnitude=Input(name="push", unit="N"), at_a=(0.4, -0.6, 0.1), at_b=(0.8, 0.0, 0.0))
    cylinder = m.force("cylinder", push, m.ground, bar)
    m.output("length", cylinder.length())
    m.output("rate", cylinder.length_rate())
    m.output("force", cylinder.force("y", on="b"))
    return m


@needs_linker
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_cylinder_whose_force_a_host_sets(solver: str):
    follow(*pair(lifted, Settings(solver=solver)), lambda k: [(0, 8.0 + 0.5 * (k > 30) + 0.1 * np.sin(0.3 * k))])


def hub() -> Mechanism:
    """A hub whose angle and rate are inputs, with a loop on it and a rod that swings."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    turned = m.body("hub", m.ground, Revolute(drive=Input(name="u", unit="rad", rate_name="du")), mass=1.0,
                    inertia=(0.1, 0.1, 0.1))  # fmt: skip
    left = m.body("left", turned, Revolute(start=1.0, fixed=True), **rod(mass=1.0, length=0.5))
    right = m.body("right", turned, Revolute(at=(1.0, 0, 0), start=1.2), **rod(mass=1.0, length=0.6))
    bar = m.body("bar", left, Revolute(at=(0.5, 0, 0), start=-1.0), **rod(mass=2.0, length=1.0))
    m.cut("pin", RevoluteCutJoint(at_a=(1.0, 0, 0), at_b=(0.6, 0, 0)), bar, right)
    m.output("left", left.angle())
    m.output("effort", turned.effort())
    m.output("hub", turned.angle())
    return m


def smooth(k: int) -> list[tuple[int, float]]:
    return [(0, 0.2 * np.sin(5.0 * k * H)), (1, np.cos(5.0 * k * H))]


MOTIONS: dict[str, Given] = {
    "position and rate": smooth,
    "position": lambda k: [(0, 0.2 * np.sin(5.0 * k * H))],
    "rate": lambda k: [(1, 0.5 if k < 20 else -0.3)],
    "jumps of both": lambda k: [(0, 0.01 * k + 0.2 * (k > 25)), (1, 1.0 + 0.5 * (k > 40))],
    "small jumps": lambda k: [(0, H * k + 0.005 * (k > 25)), (1, 1.0)],
    "constant rate": lambda k: [(0, H * k), (1, 1.0)],
    "now and then": lambda k: smooth(k) if k % 4 == 0 else [],
}


@needs_linker
@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_hub_that_a_host_turns(solver: str, name: str):
    simulation, native = pair(hub, Settings(solver=solver))
    follow(simulation, native, MOTIONS[name])
    assert simulation.discontinuity_work != 0.0
    assert native.run_status["jumps"] == any("its position differs by" in d.text for d in simulation.diagnostics)
    assert native.run_status["jumps"] == (name in ("jumps of both", "small jumps", "now and then"))


@needs_linker
def test_a_hub_starts_with_the_values_of_the_host():
    settings = Settings(solver="adams")
    simulation, native = Simulation(hub(), settings, inputs={0: 0.1, 1: 2.0}), Running(Simulation(hub(), settings))
    for index, value in ((0, 0.1), (1, 2.0)):
        assert native.call("start", index, value) == OK
    for array, found in zip(
        (native.instance.given.q, native.instance.given.v), simulation.compiled.assemble(), strict=True
    ):
        native.view(array)[:] = found
    assert native.call("begin", 0.0) == OK
    follow(simulation, native, lambda k: [(0, 0.1 + 2.0 * k * H)], last=20)


def table() -> Mechanism:
    """A rod on a table whose two speeds are inputs."""
    m = Mechanism()
    along = Translational(axis="x", drive=SpeedInput(name="x", unit="m/s", start=0.1))
    base = m.body("base_x", m.ground, along, mass=1.0)
    across = Translational(axis="y", drive=SpeedInput(name="y", unit="m/s"))
    base = m.body("base", base, across, mass=1.0)
    m.body("rod", base, Revolute(start=0.7), **rod(mass=1.0, length=0.6))
    m.output("base", base.position("x"))
    m.output("spin", m.bodies[-1].rate())
    return m


@needs_linker
@pytest.mark.parametrize("solver", ["adams", "radau"])
def test_speeds_that_a_host_sets(solver: str):
    follow(
        *pair(table, Settings(solver=solver)),
        lambda k: [(0, float(np.sin(0.2 * k))), (1, 1.0 - 0.1 * (k // 10))],
    )


@needs_linker
def test_a_state_has_what_inputs_remember():
    """Saved in the middle of a motion, with values given for the next step."""
    simulation, first = pair(hub, Settings(solver="adams"))
    second = Running(Simulation(hub(), Settings(solver="adams")))
    follow(simulation, first, smooth, last=20)
    for index, value in smooth(20):
        simulation.set_input(index, value)
        assert first.call("set", index, float(value), np.nan) == OK
    second.block[: second.image.saved] = first.block[: first.image.saved]
    follow(simulation, second, lambda k: smooth(k) if k > 20 else [], 20, 40)


def parallelogram() -> Mechanism:
    """Two cranks under a coupler, flat and at rest: branches of the motion cross."""
    m = Mechanism()
    base = m.body("base", m.ground, Translational(axis="x", drive=Input(name="u", unit="m", rate_name="du")))
    left = m.body("left", base, Revolute(fixed=True), **rod(mass=1.0, length=0.5))
    right = m.body("right", base, Revolute(at=(1.0, 0, 0)), **rod(mass=1.0, length=0.5))
    bar = m.body("bar", left, Revolute(at=(0.5, 0, 0)), **rod(mass=2.0, length=1.0))
    m.cut("pin", SphericalCutJoint(at_a=(1.0, 0, 0), at_b=(0.5, 0, 0)), bar, right)
    m.output("angle", left.angle())
    return m


@needs_linker
def test_an_impulse_that_is_not_determined_is_reported():
    simulation, native = pair(parallelogram, Settings(solver="adams"))
    simulation.set_input(1, 1.0)
    assert native.call("set", 1, 1.0, np.nan) == OK
    before = native.block.copy()
    with pytest.raises(UserError, match="where the impulse is not determined"):
        simulation.advance(0.1)
    assert native.call("step", 0.1) == Code.UNDECIDABLE
    assert native.run_status["unknown"] == 1
    memory = simulation_memory(native)
    at = native.image.at(memory)
    np.testing.assert_array_equal(native.block[at : at + memory.nbytes], before[at : at + memory.nbytes])


def simulation_memory(native: Running) -> NDArray[np.uint8]:
    """Return the records of signals and the like that an instance was made of."""
    data = unpin(native.instance.given.eqs.data)
    memory: NDArray[np.uint8] = unpin(data.arrays).memory
    return memory


@needs_linker
def test_a_lost_energy_balance_is_reported():
    simulation, native = pair(FourBar, Settings(solver="adams"))
    follow(simulation, native, torque, last=10)
    assert not native.run_status["lost"]
    native.view(native.instance.session.balance)["reference_energy"] += 1.0
    simulation.session.balance["reference_energy"] += 1.0
    follow(simulation, native, torque, first=10, last=12)
    told = native.run_status
    assert told["lost"]
    words = f"at t = {told['lost_at']:.6g} s: the energy has changed by {-told['energy_error']:.3g} J less than"
    assert words in simulation.warning
    assert f"of the {told['exchanged']:.3g} J of energy exchanged" in simulation.warning


@needs_linker
@pytest.mark.parametrize("solver", SOLVERS)
def test_inputs_after_a_step_that_failed(solver: str):
    settings = Settings(solver=solver, max_steps=2)
    follow(*pair(FourBar, settings), torque, last=30, ends=(OK, Code.MAX_STEPS))


@needs_linker
def test_a_value_that_is_no_number_is_refused():
    _, native = pair(FourBar, Settings(solver="adams"))
    before = native.block.copy()
    for value in (np.nan, np.inf):
        assert native.call("set", 0, value, np.nan) == NOT_FINITE
        assert native.call("start", 0, value) == NOT_FINITE
    np.testing.assert_array_equal(native.block, before)

"""Large trees in machine code: sheets and chains do what simulations of them do, bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from running import Running, adopt, follow, needs_linker, pair

from fmus.sheet import Sheet
from mbfmu.mechanics import Beam, Mechanism, Revolute
from mbfmu.mechanics.joints import Spherical
from mbfmu.native.entries import image_of
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.errors import UserError
from solvers.loop_closure import ASSEMBLED
from solvers.outcome import OK
from solvers.steppers.adams.tree import TreeAdamsStepper

ADAMS = Settings(solver="adams", tolerance=1e-5)
GRID = {"nx": 9, "nz": 7}
LINK = {"mass": 0.1, "com": (0.05, 0.0, 0.0), "inertia": (1e-5, 1e-4, 1e-4)}


def chain(links: int, joint: Any = Revolute, gravity: float = -9.81) -> Mechanism:
    """Rods that are connected to each other; the first is bent aside, or turns where nothing weighs."""
    m = Mechanism(gravity=(0.0, gravity, 0.0))
    on = m.ground
    for k in range(links):
        own = {"start": 0.0 if k else 0.3, "armature": 1e-4} if joint is Revolute else {}
        turning = {} if gravity or k else {"rate": 2.0 if joint is Revolute else (0.5, -1.0, 2.0)}
        at = (0.1 if k else 0.0, 0.0, 0.0)
        on = m.body(f"link {k}", on, joint(at=at, **own, **turning), **LINK)
    m.output("tip", on.position("y"))
    m.output("turned", m.bodies[1].joint_force("y"))
    m.output("energy", m.energy)
    return m


def beams(count: int) -> Mechanism:
    """Elastic beams that are connected to each other, and a state that follows the height of the last."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    own, on = Beam(length=0.1, mass=0.1, bending_stiffness=0.05, modes=2), m.ground
    for k in range(count):
        on = m.flexible_body(f"beam {k}", on, Revolute(start=0.0 if k else 0.3), own).section(own.length)
    m.lag("height", on.position("y"), time_constant=0.01)
    m.output("tip", on.position("y"))
    m.output("turned", m.bodies[1].joint_force("y"))
    m.output("energy", m.energy)
    return m


MODELS = {
    "elastic beams": (lambda: beams(25), 1e-3),
    "sheet": (lambda: Sheet(**GRID), 2e-3),
    "sheet that flies": (lambda: Sheet(**GRID, support="free", start_spin=20.0, gravity_y=0.0), 1e-3),
    "sheet in air": (lambda: Sheet(**GRID, damping=1e-5, drag=1.4, pressure=0.5), 1e-3),
    "chain": (lambda: chain(200), 1e-2),
    "chain of balls": (lambda: chain(30, Spherical), 1e-2),
    "chain that nothing pulls": (lambda: chain(70, gravity=0.0), 1e-2),
}


@needs_linker
@pytest.mark.parametrize("name", MODELS)
def test_outputs_are_those_of_a_simulation(name: str):
    make, length = MODELS[name]
    simulation, native = pair(make, ADAMS)
    assert isinstance(simulation.stepper, TreeAdamsStepper)
    start = simulation.outputs().copy()
    assert native.call("read") == OK
    np.testing.assert_array_equal(native.out, start)
    follow(simulation, native, length)
    assert not np.array_equal(native.out, start)
    assert native.call("count") == OK
    counts, told = native.view(native.instance.counts), simulation.statistics
    assert list(counts[:3]) == [told.steps, told.rejected, told.rhs_evals]


@needs_linker
@pytest.mark.parametrize("energy_check", [False, True])
@pytest.mark.parametrize("inputs", ["hold", "linear"])
def test_gravity_and_an_edge_that_a_host_moves(inputs: str, energy_check: bool):
    settings = Settings(solver="adams", tolerance=1e-5, input_interpolation=inputs, energy_check=energy_check)
    simulation, native = pair(lambda: Sheet(**GRID, support="moved"), settings)
    numbers = {v.name: k for k, v in enumerate(simulation.compiled.inputs.variables)}
    for k in range(12):
        t, given = 1e-3 * k, {}
        if k % 3 != 2:
            given |= {"edge.y": 1e-3 * np.sin(100.0 * t), "edge.vy": 0.1 * np.cos(100.0 * t) + 0.2 * (k > 6)}
        if k == 5:
            given["gravity.x"] = 3.0
        for name, value in given.items():
            simulation.set_input(name, value)
            assert native.call("set", numbers[name], float(value), np.nan) == OK
        follow(simulation, native, 1e-3, k, k + 1)
    assert simulation.discontinuity_work != 0.0


@needs_linker
@pytest.mark.parametrize("model", [Sheet(**GRID, thickness=0.5e-3, gravity_y=-3.0), Sheet(**GRID, density=3000.0)])
def test_a_changed_sheet_runs_as_one_that_was_built(model: Sheet):
    native, simulation = Running(Simulation(Sheet(**GRID), ADAMS)), Simulation(model, ADAMS)
    adopt(native, simulation.compiled)
    start = native.instance.start
    native.view(start.q)[:], native.view(start.v)[:] = simulation.stepper.q, simulation.stepper.v
    assert native.call("assemble", 0.0) == ASSEMBLED
    assert native.call("begin", 0.0) == OK
    for k in range(10):
        assert native.call("step", 1e-3 * (k + 1)) == int(simulation.advance(1e-3 * (k + 1)).code) == OK
        assert native.call("read") == OK
        np.testing.assert_array_equal(native.out[:-2], simulation.outputs()[:-2])


@needs_linker
def test_a_pressure_that_is_tuned():
    simulation, native = pair(lambda: Sheet(**GRID, pressure=0.5), ADAMS)
    follow(simulation, native, 1e-3, last=4)
    other = Sheet(**GRID, pressure=2.0)
    assert native.call("note_energy") == OK
    adopt(native, other.compile(), at_work=True)
    assert native.call("retune") == OK
    simulation.retune(other)
    follow(simulation, native, 1e-3, 4, 10)


@needs_linker
def test_a_state_goes_to_another_instance():
    simulation, first = pair(lambda: Sheet(**GRID), ADAMS)
    second = Running(Simulation(Sheet(**GRID), ADAMS))
    follow(simulation, first, 1e-3, last=4)
    second.block[: second.image.saved] = first.block[: first.image.saved]
    follow(simulation, second, 1e-3, 4, 10)


@needs_linker
@pytest.mark.parametrize("grid", [(4, 3), (9, 7)])  # a small mechanism, and a large tree
def test_the_bending_angle_of_plates_is_reported(grid: tuple[int, int]):
    make = lambda: Sheet(nx=grid[0], nz=grid[1], support="free", start_spin=300.0)  # noqa: E731
    simulation, native = pair(make, ADAMS)
    for k in range(6):
        t = 2e-3 * (k + 1)
        assert native.call("step", t) == int(simulation.advance(t).code) == OK
        ratio = simulation.compiled.limit_ratio(t, simulation.stepper.q)
        assert native.run_status["limit_ratio"] == ratio > 0.0


@needs_linker
def test_an_inertia_that_is_missing_ends_a_step():
    def make() -> Mechanism:
        m = chain(70)
        m.body("nothing", m.bodies[-1], Revolute(at=(0.1, 0.0, 0.0)))
        return m

    simulation, native = pair(make, ADAMS)
    code = int(simulation.advance(1e-3).code)
    assert code != OK
    assert native.call("step", 1e-3) == code


def test_large_trees_that_machine_code_has_no_way_for_are_refused():
    with pytest.raises(UserError, match=r"do not support solver 'radau' for this large model of 70 joint coordinates"):
        image_of(Simulation(chain(70), Settings(solver="radau")))


def test_an_image_has_no_matrices():
    """So that it is copied in no time at every step."""
    simulation = Simulation(Sheet(**GRID), ADAMS)
    n = simulation.compiled.system.n
    assert image_of(simulation)[1].saved < 8 * n * n

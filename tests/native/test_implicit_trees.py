"""Large trees with implicit solvers in machine code: sheets and the feeder do what simulations do, bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from controlled_sheets import carried_sheet
from running import Running, adopt, follow, needs_linker, pair

from fmus.feeder import Feeder
from fmus.sheet import Sheet
from mbfmu.mechanics import Mechanism, Revolute, SphericalCutJoint
from mbfmu.native.entries import image_of
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.sheets import Wall, add_contact, add_sheet
from mbfmu.util.errors import UserError
from solvers.loop_closure import ASSEMBLED
from solvers.outcome import OK

GRID = {"nx": 7, "nz": 5}


def fallen_sheet() -> Mechanism:
    """A free sheet that falls on a table and rubs on it."""
    m = Mechanism(gravity=(1.0, -9.81, 0.0))
    paper = {"thickness": 1e-3, "youngs_modulus": 1e7, "density": 800.0, "grid": (7, 5), "tree": "master"}
    sheet = add_sheet(m, "sheet", length=0.3, width=0.2, **paper)
    add_contact(m, "table", sheet, Wall(at=(0.0, -2e-3, 0.0)), friction=0.3)
    m.output("corner", sheet.node(0, 0).position("y"))
    m.output("slip", sheet.node(0, 0).position("x"))
    return m


MODELS = {
    "sheet": (lambda: Sheet(**GRID), 5e-3),
    "sheet in air": (lambda: Sheet(**GRID, damping=1e-5, drag=1.4, pressure=0.5), 5e-3),
    "sheet that flies": (lambda: Sheet(**GRID, support="free", start_spin=20.0, gravity_y=0.0), 2e-3),
    "stretched sheet": (lambda: Sheet(**GRID, stretch=True), 5e-3),
    "sheet on a table": (fallen_sheet, 4e-3),
    "controlled sheet": (carried_sheet, 5e-3),
    "feeder": (Feeder, 1e-3),
}


def settings_of(solver: str, **more: Any) -> Settings:
    """Settings of all runs here."""
    return Settings(solver=solver, tolerance=1e-4, **more)


@needs_linker
@pytest.mark.parametrize("name", MODELS)
def test_outputs_are_those_of_a_simulation(name: str):
    make, length = MODELS[name]
    simulation, native = pair(make, settings_of("esdirk"))
    assert not simulation.compiled.system.has_matrices
    start = simulation.outputs().copy()
    assert native.call("read") == OK
    np.testing.assert_array_equal(native.out, start)
    follow(simulation, native, length)
    assert not np.array_equal(native.out, start)
    assert native.call("count") == OK
    counts, told = native.view(native.instance.counts), simulation.statistics
    assert list(counts[:3]) == [told.steps, told.rejected, told.rhs_evals]


@needs_linker
@pytest.mark.parametrize("inputs", ["hold", "linear"])
def test_gravity_and_an_edge_that_a_host_moves(inputs: str):
    simulation, native = pair(lambda: Sheet(**GRID, support="moved"), settings_of("esdirk", input_interpolation=inputs))
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


@needs_linker
@pytest.mark.parametrize("name", ["sheet", pytest.param("feeder", marks=pytest.mark.campaign)])
def test_a_state_goes_to_another_instance_bit_for_bit(name: str):
    """Factors are not in the state: they are made again from the state that they were made at."""
    make, length = MODELS[name]
    simulation, first = pair(make, settings_of("esdirk"))
    second = Running(Simulation(make(), settings_of("esdirk")))
    follow(simulation, first, length, last=6)
    saved = first.block[: first.image.saved].copy()
    follow(simulation, first, length, 6, 9)
    out = first.out.copy()
    for other in (first, second):  # the second was never begun
        other.block[: other.image.saved] = saved
        assert other.call("restore") == OK
        for k in range(6, 9):
            assert other.call("step", (k + 1) * length) == OK
        assert other.call("read") == OK
        np.testing.assert_array_equal(other.out, out)


@needs_linker
def test_a_changed_sheet_runs_as_one_that_was_built():
    """What the tangent is made of changes too."""
    model, settings = Sheet(**GRID, thickness=0.5e-3, gravity_y=-3.0), settings_of("esdirk")
    native, simulation = Running(Simulation(Sheet(**GRID), settings)), Simulation(model, settings)
    adopt(native, simulation.compiled)
    start = native.instance.start
    native.view(start.q)[:], native.view(start.v)[:] = simulation.stepper.q, simulation.stepper.v
    assert native.call("assemble", 0.0) == ASSEMBLED
    assert native.call("begin", 0.0) == OK
    for k in range(6):
        assert native.call("step", 5e-3 * (k + 1)) == int(simulation.advance(5e-3 * (k + 1)).code) == OK
        assert native.call("read") == OK
        np.testing.assert_array_equal(native.out[:-2], simulation.outputs()[:-2])


def test_large_models_that_machine_code_has_no_way_for_are_refused():
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    on = m.ground
    for k in range(120):
        on = m.body(f"link {k}", on, Revolute(at=(0.1 if k else 0.0, 0.0, 0.0)), mass=0.1, inertia=(1e-5, 1e-4, 1e-4))
    m.cut("pin", SphericalCutJoint(at_a=(0.1, 0.0, 0.0), at_b=(1.0, -5.0, 0.0)), on, m.ground)
    with pytest.raises(UserError, match=r"of 120 joint coordinates and 2 constraint equations; allowed: 'adams'"):
        image_of(Simulation(m, settings_of("esdirk")))

"""Large mechanisms with loops in machine code: they do what simulations of them do, bit for bit.

The simulations themselves are compared with exact motions in tests/loops.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from exchange_models import many_loops
from mechanisms import ladder, n_four_bar
from running import Running, adopt, follow, needs_linker, pair
from towers import tower

from mbfmu.mechanics import Beam, Mechanism, PlaneCutJoint, Revolute, rod
from mbfmu.modeling import Model, parameter
from mbfmu.native.entries import family_of, image_of
from mbfmu.native.exchange_states import explain_missing_derivatives, explain_missing_exchange
from mbfmu.session.simulation import Settings, Simulation, UnstartedSimulation
from mbfmu.util.errors import UserError
from solvers.loop_closure import ASSEMBLED
from solvers.outcome import OK

ADAMS = Settings(solver="adams", tolerance=1e-6)


def held_beams(count: int, off: float = 0.0) -> Mechanism:
    """A row of elastic beams with a loop over each but the first, open by ``off`` rad at the start."""
    m, own = Mechanism(gravity=(0.0, -9.81, 0.0)), Beam(length=0.1, mass=0.1, bending_stiffness=0.05, modes=2)
    place = m.ground
    for k in range(count):
        start = 0.3 if k else -1.2
        beam = m.flexible_body(f"beam {k}", place, Revolute(start=start), own)
        if k:
            hinge = Revolute(start=start + off, at=(0.0, 0.05, 0.0))
            link = m.body(f"rod {k}", place, hinge, **rod(mass=0.1, length=0.1))
            m.cut(f"end {k}", PlaneCutJoint(at_b=(0.1, 0.05, 0.0), at_a=(0.1, 0.0, 0.0), axis="y"), link, beam.body)
        place = beam.section(own.length)
    m.output("tip", place.position("y"))
    m.output("energy", m.energy)
    return m


MODELS: dict[str, tuple[Callable[[], Mechanism], float]] = {
    "row through singular configurations": (lambda: n_four_bar(40).mechanism, 0.2),
    "row of columns on the ground": (lambda: n_four_bar(40, grounded=True).mechanism, 0.2),
    "row that misses a singular configuration": (lambda: n_four_bar(31, longer={1: 1e-3}).mechanism, 0.2),
    "ladder": (lambda: ladder(35).mechanism, 0.05),
    "controlled tower": (lambda: tower(19), 0.05),
    "elastic beams": (lambda: held_beams(20), 0.01),
    "elastic beams, more than are closed by matrices": (lambda: held_beams(30), 0.01),
    "driven row": (lambda: many_loops(32), 0.02),
    "driven row without matrices": (lambda: many_loops(60), 0.02),
}


@needs_linker
@pytest.mark.parametrize("name", MODELS)
def test_outputs_are_those_of_a_simulation(name: str) -> None:
    make, length = MODELS[name]
    simulation, native = pair(make, ADAMS)
    assert family_of(simulation) == "eliminated"
    start = simulation.outputs().copy()
    assert native.call("read") == OK
    np.testing.assert_array_equal(native.out, start)
    follow(simulation, native, length)
    assert not np.array_equal(native.out, start)
    assert native.call("count") == OK
    counts, told = native.view(native.instance.counts), simulation.statistics
    assert list(counts[:3]) == [told.steps, told.rejected, told.rhs_evals]


@needs_linker
@pytest.mark.parametrize(
    "make",
    [
        lambda off: many_loops(32, torque=True, start=1.2 + off),
        lambda off: many_loops(60, torque=True, start=1.2 + off),
        lambda off: held_beams(30, off),
    ],
)
def test_loops_are_closed_as_in_python(make: Callable[[float], Mechanism]) -> None:
    """With matrices, and by the elimination."""
    for off in (0.0, 0.05):  # closed, and open
        simulation = Simulation(make(off), ADAMS)
        native = Running(simulation)
        native.view(native.instance.q)[:] = np.nan
        native.view(native.instance.v)[:] = np.nan
        assert native.call("assemble", 0.0) == ASSEMBLED
        np.testing.assert_array_equal(native.view(native.instance.q), simulation.start[0])
        np.testing.assert_array_equal(native.view(native.instance.v), simulation.start[1])


@needs_linker
@pytest.mark.parametrize("energy_check", [False, True])
@pytest.mark.parametrize("inputs", ["hold", "linear"])
def test_a_torque_that_a_host_changes(inputs: str, energy_check: bool) -> None:
    settings = Settings(solver="hybrid", tolerance=1e-5, input_interpolation=inputs, energy_check=energy_check)
    simulation, native = pair(lambda: many_loops(31, torque=True), settings)
    for k in range(8):
        value = 2.0 + np.sin(1.0 * k)
        simulation.set_input("torque", value)
        assert native.call("set", 0, value, np.nan) == OK
        follow(simulation, native, 0.01, k, k + 1)


@needs_linker
def test_a_state_goes_to_another_instance() -> None:
    simulation, first = pair(lambda: many_loops(32), ADAMS)
    second = Running(Simulation(many_loops(32), ADAMS))
    follow(simulation, first, 0.02, last=4)
    second.block[: second.image.saved] = first.block[: first.image.saved]
    follow(simulation, second, 0.02, 4, 10)


@dataclass(frozen=True, kw_only=True)
class Row(Model):
    """Row of four-bars whose lengths are a parameter."""

    length: float = parameter(1.0, unit="m", doc="Length of all links", min=0.1)

    def build(self) -> Mechanism:
        return many_loops(32, self.length)


@needs_linker
def test_a_changed_length_runs_as_one_that_was_built() -> None:
    """A power of two changes the units without rounding errors."""
    native, simulation = Running(Simulation(Row(), ADAMS)), Simulation(Row(length=2.0), ADAMS)
    adopt(native, simulation.compiled)
    start = native.instance.start
    native.view(start.q)[:] = simulation.compiled.assembly.start_positions()
    native.view(native.instance.known)[2] = simulation.compiled.length
    assert native.call("assemble", 0.0) == ASSEMBLED
    assert native.call("begin", 0.0) == OK
    for k in range(5):
        assert native.call("step", 0.02 * (k + 1)) == int(simulation.advance(0.02 * (k + 1)).code) == OK
        assert native.call("read") == OK
        np.testing.assert_array_equal(native.out, simulation.outputs())


@needs_linker
def test_an_inertia_that_is_missing_ends_a_step() -> None:
    def make() -> Mechanism:
        m = ladder(35).mechanism
        m.body("nothing", m.bodies[-1], Revolute(at=(0.1, 0.0, 0.0)))
        return m

    simulation, native = pair(make, ADAMS)
    code = int(simulation.advance(1e-3).code)
    assert code != OK
    assert native.call("step", 1e-3) == code


def test_model_exchange_and_derivatives_are_supported() -> None:
    simulation = UnstartedSimulation(ladder(35).mechanism, ADAMS)
    assert explain_missing_exchange(simulation) == explain_missing_derivatives(simulation) == ""


@pytest.mark.parametrize("loops", [25, 35])
def test_esdirk_is_refused(loops: int) -> None:
    with pytest.raises(UserError, match=r"do not support solver 'esdirk' .* allowed: 'adams', 'hybrid' and 'ida'\."):
        image_of(UnstartedSimulation(ladder(loops).mechanism, Settings(solver="esdirk")))


def test_ida_is_refused_with_few_constraints() -> None:
    """Then it does not eliminate them."""
    m = ladder(1).mechanism
    for _ in range(100):
        m.body(f"link{len(m.bodies)}", m.bodies[-1], Revolute(at=(0.1, 0.0, 0.0)), **rod(mass=1.0, length=0.1))
    with pytest.raises(UserError, match=r"do not support solver 'ida' .* allowed: 'adams' and 'hybrid'\."):
        image_of(UnstartedSimulation(m, Settings(solver="ida")))


def test_an_image_has_no_history_of_matrices() -> None:
    simulation = UnstartedSimulation(ladder(100).mechanism, ADAMS)
    n, m = simulation.compiled.system.n, simulation.compiled.system.m
    assert image_of(simulation)[1].saved < 8 * m * n

"""Machine code assembles a mechanism with the bits of Python, or reports why it cannot."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from mechanisms import Scale, bricard, grashof, three_cranks
from running import Running, adopt, needs_linker

from fmus.fourbar import FourBar
from fmus.governor import Governor
from mbfmu.mechanics import (
    CompiledMechanism,
    Floating,
    Mechanism,
    Revolute,
    RevoluteCutJoint,
    Translational,
    TranslationalCutJoint,
    WeldCutJoint,
    rod,
)
from mbfmu.mechanics.arrays.closing import assemble_positions, assemble_velocities
from mbfmu.modeling.settings import Settings
from mbfmu.native.start_checks import Flaw
from mbfmu.session.simulation import Simulation
from mbfmu.util.errors import AssemblyError
from solvers.loop_closure import ASSEMBLED, NO_MASS, OPEN, OPENS

pytestmark = needs_linker

SMALL, LARGE = Scale(lengths=1e-3), Scale(lengths=1e3)


class Change(NamedTuple):
    """A model, and what is to be made of it: one of the same structure with other numbers."""

    model: Any
    other: Any
    off: float = 0.0  # what is added to guesses that are not held, in units of the coordinates


CHANGES = {
    "another angle": Change(FourBar(), FourBar(start_angle=0.7, start_rate=2.0), 0.1),
    "other lengths": Change(FourBar(), FourBar(ground_length=3.4, coupler_length=2.7, crank_length=1.2)),
    "a bad guess": Change(FourBar(), FourBar(start_angle=0.5), 0.3),
    "elastic": Change(FourBar(coupler_modes=2), FourBar(coupler_modes=2, ground_length=3.05)),
    "governor": Change(Governor(), Governor(arm_length=0.3, rod_length=0.15, start_angle=0.4), 0.1),
    "free governor": Change(Governor(driven=False), Governor(driven=False, rod_position=0.06, spindle_speed=3.0), 0.1),
    "redundant rows": Change(three_cranks().mechanism, three_cranks(start=50.0, rate=2.0, eps=0.2).mechanism, 0.01),
    "spatial": Change(bricard().mechanism, bricard(scale=Scale(lengths=1.7)).mechanism, 0.01),
    "sliver": Change(grashof(1e-3).mechanism, grashof(1e-7).mechanism, 0.02),
    "a thousandth": Change(grashof(1e-2).mechanism, grashof(1e-4, scale=SMALL).mechanism, 0.02),
    "a thousand times": Change(bricard().mechanism, bricard(scale=LARGE).mechanism, 0.01),
}


def guess(compiled: CompiledMechanism, off: float) -> tuple[Any, Any, Any]:
    """First positions and velocities, positions off by a part of their units where they are not held; what is held."""
    q, held, n = compiled.assembly.start_positions(), compiled.assembly.held(), compiled.system.n
    if off and not held.any():
        held[0] = True
    compiled.system.apply(q, np.where(held, 0.0, off * compiled.system.size * np.cos(1.0 + np.arange(n))))
    return q, compiled.assembly.start_velocities(), held


def assembled(native: Running, q: Any, v: Any, held: Any) -> int:
    """Assemble an instance from these guesses; return the code."""
    start = native.instance.start
    native.view(start.q)[:], native.view(start.v)[:], native.view(start.scratch.free)[:] = q, v, ~held
    return native.call("assemble", 0.0)


@pytest.mark.parametrize("name", CHANGES)
def test_what_is_assembled_has_the_bits_of_python(name: str):
    model, other, off = CHANGES[name]
    native = Running(Simulation(model, Settings(solver="adams")))
    compiled = Simulation(other, Settings(solver="adams")).compiled
    adopt(native, compiled)
    q, v, held = guess(compiled, off)
    given = compiled.assembly.given()
    wanted = assemble_positions(compiled.system, 0.0, q, held, given)
    wanted = wanted, assemble_velocities(compiled.system, 0.0, wanted, v, held, given)
    assert assembled(native, q, v, held) == ASSEMBLED
    for array, numbers in zip((native.instance.given.q, native.instance.given.v), wanted, strict=True):
        np.testing.assert_array_equal(native.view(array), numbers)
    assert not np.array_equal(wanted[0], q)


@pytest.mark.parametrize("name", ["another angle", "other lengths", "redundant rows"])
def test_a_changed_mechanism_runs_as_one_that_was_built(name: str):
    model, other, _ = CHANGES[name]
    native, simulation = (
        Running(Simulation(model, Settings(solver="adams"))),
        Simulation(other, Settings(solver="adams")),
    )
    adopt(native, simulation.compiled)
    assert assembled(native, *guess(simulation.compiled, 0.0)) == ASSEMBLED
    assert native.call("begin", 0.0) == 0
    for t in 0.02 * np.arange(1, 26):
        assert native.call("advance", t) == int(simulation.stepper.advance(t).code) == 0
        assert native.call("read") == 0
        np.testing.assert_array_equal(native.out[:-2], simulation.outputs()[:-2])


def refused(compiled: CompiledMechanism) -> str:
    """Return the message of Python for a compiled mechanism that cannot be assembled."""
    with pytest.raises(AssemblyError) as error:
        compiled.assemble()
    return str(error.value)


def test_a_start_that_python_assembled_is_assembled_by_machine_code_again():
    for model in (FourBar(), Governor()):
        simulation = Simulation(model, Settings(solver="adams"))
        native = Running(simulation)
        before = native.view(native.instance.given.q).copy()
        assert native.call("assemble", 0.0) == ASSEMBLED
        np.testing.assert_array_equal(native.view(native.instance.given.q), before)


def test_a_loop_that_cannot_close_is_reported_by_constraint_and_gap():
    native, compiled = Running(Simulation(FourBar(), Settings(solver="adams"))), FourBar(ground_length=12.0).compile()
    adopt(native, compiled)
    assert assembled(native, *guess(compiled, 0.0)) == OPEN
    row, gap = native.view(native.instance.start.scratch.worst)[0]
    assert f"{compiled.system.constraint_names[row]!r} is violated by {gap:.3g} (SI units) in" in refused(compiled)


def test_rates_that_open_a_loop_are_reported_by_constraint_and_rate():
    def cranks(rate: float) -> Mechanism:
        return pair(lambda k: {"fixed": True, "rate": 1.0 if k == 0 else rate})

    native, compiled = Running(Simulation(cranks(1.0), Settings(solver="adams"))), CompiledMechanism(cranks(1.5))
    assert assembled(native, *guess(compiled, 0.0)) == OPENS
    row, gap = native.view(native.instance.start.scratch.worst)[0]
    assert f"{compiled.system.constraint_names[row]!r} changes by {gap:.3g} (SI units) per second" in refused(compiled)


def test_a_motion_without_inertia_is_reported_by_its_coordinates():
    def arms(mass: float) -> Mechanism:
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        arm = m.body("arm", m.ground, Revolute(start=0.2), **rod(mass=1.0, length=1.0))
        m.body("tip", arm, Revolute(at=(1.0, 0.0, 0.0)), **rod(mass=mass, length=0.5))
        m.output("energy", m.energy)
        return m

    native, compiled = Running(Simulation(arms(1.0), Settings(solver="adams"))), CompiledMechanism(arms(0.0))
    adopt(native, compiled)
    assert assembled(native, *guess(compiled, 0.0)) == NO_MASS
    told = np.flatnonzero(native.view(native.instance.start.scratch.massless))
    assert [compiled.system.coordinate_names[k] for k in told] == ["tip"]
    assert "coordinate(s) 'tip' can move" in refused(compiled)


@pytest.mark.parametrize(("turn", "axis"), [(120.0, (1, 1, 1)), (180.0, (1, 0, 0)), (180.0, (0, 0, 1))])
def test_a_weld_that_closes_turned_is_reported_by_cut_joint_and_angle(turn: float, axis: tuple[float, ...]):
    def glued(angle: float) -> Mechanism:
        half, along = np.radians(0.5 * angle), np.array(axis) / np.linalg.norm(axis)
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        lift = m.body("lift", m.ground, Translational(axis="y", start=0.1), mass=1.0)
        start = 0.0, 0.0, 0.0, np.cos(half), *(np.sin(half) * along)
        box = m.body("box", lift, Floating(start=start), mass=1.0, inertia=(1.0, 2.0, 3.0))
        m.cut("sleeve", TranslationalCutJoint(axis="y"), m.ground, lift)
        m.cut("glue", WeldCutJoint(), lift, box)
        m.output("energy", m.energy)
        return m

    native, compiled = Running(Simulation(glued(0.0), Settings(solver="adams"))), CompiledMechanism(glued(turn))
    adopt(native, compiled)
    assert assembled(native, *guess(compiled, 0.0)) == Flaw.TURNED
    cut, angle = native.view(native.instance.start.scratch.worst)[0]
    assert (cut, angle) == (1, turn)
    assert (
        f"loop 'glue' closes with a wrong orientation: the frames of its cut joint are rotated by {turn:.0f} deg"
        in refused(compiled)
    )


def pair(options: Callable[[int], dict[str, Any]]) -> Mechanism:
    """Two parallel cranks with a coupler; ``options`` of the joint of each crank."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    cranks = [
        m.body(f"crank{k}", m.ground, Revolute(at=(2.0 * k, 0, 0), start=0.5, **options(k)), **rod(mass=1, length=1))
        for k in range(2)
    ]
    coupler = m.body("coupler", cranks[0], Revolute(at=(1, 0, 0), start=-0.5), **rod(mass=2, length=2))
    m.cut("pin", RevoluteCutJoint(at_a=(1, 0, 0), at_b=(2, 0, 0)), cranks[1], coupler)
    m.output("energy", m.energy)
    return m

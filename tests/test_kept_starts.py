"""Runs that start from the compiled mechanism of an earlier run are that run, bit for bit; what differs is compiled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from fmus.fourbar import FourBar
from mbfmu.mechanics import Harmonic, Input, JointForce, Mechanism, Revolute, RevoluteCutJoint, rod
from mbfmu.modeling import Model
from mbfmu.session import kept_starts
from mbfmu.session.result import Result
from mbfmu.session.run import simulate
from mbfmu.session.simulation import Simulation

LENGTHS = [1.0]  # m, on which a model below depends besides its parameters


@pytest.fixture(autouse=True)
def compiled(monkeypatch: pytest.MonkeyPatch) -> list[Mechanism]:
    """Return the mechanisms that runs of a test compile; nothing is kept before and after it."""
    found: list[Mechanism] = []

    class Counted(kept_starts.CompiledMechanism):
        def __init__(self, mechanism: Mechanism, *given: Any) -> None:
            found.append(mechanism)
            super().__init__(mechanism, *given)

    monkeypatch.setattr(kept_starts, "CompiledMechanism", Counted)
    monkeypatch.setattr(kept_starts, "_kept", type(kept_starts._kept)())
    return found


def run(model: Model | Mechanism, **settings: Any) -> Result:
    """Return a short run."""
    return simulate(model, 0.3, interval=0.05, **{"solver": "adams"} | settings)


def assert_same_bits(found: Result, expected: Result) -> None:
    """Check that two runs have the same numbers and say the same."""
    assert found.values.tobytes() == expected.values.tobytes()
    assert [str(d) for d in found.diagnostics] == [str(d) for d in expected.diagnostics]
    assert (found.inputs, found.statistics) == (expected.inputs, expected.statistics)


def pendulum(length: float = 1.0, **given: Any) -> Mechanism:
    """Return a rod on a pivot."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    bar = m.body("bar", m.ground, Revolute(start=0.2, **given), **rod(mass=1.0, length=length))
    m.force("motor", JointForce(magnitude=Input(name="torque", unit="N.m")), bar)
    m.output("angle", bar.angle())
    return m


@dataclass(frozen=True, kw_only=True)
class Hidden(Model):
    """A pendulum whose length is no parameter."""

    def build(self) -> Mechanism:
        """Return the mechanism."""
        return pendulum(LENGTHS[-1])


@pytest.mark.parametrize("solver", ["adams", "ida", "radau", "auto"])
def test_a_second_run_is_the_first(solver: str, compiled: list[Mechanism]) -> None:
    first = run(FourBar(), solver=solver)
    for _ in range(2):
        assert_same_bits(run(FourBar(), solver=solver), first)
    assert len(compiled) == 1


def test_runs_in_between_leave_no_trace(compiled: list[Mechanism]) -> None:
    first, pushed = run(Hidden()), run(Hidden(), inputs={"torque": 3.0})
    steady = run(Hidden(), start_at_equilibrium=True)
    assert_same_bits(run(Hidden()), first)
    assert_same_bits(run(Hidden(), inputs={"torque": 3.0}), pushed)
    assert_same_bits(run(Hidden(), start_at_equilibrium=True), steady)
    assert len(compiled) == 3
    assert abs(pushed["angle"][-1] - first["angle"][-1]) > 1e-2


def test_a_model_that_depends_on_more_than_its_parameters_is_followed() -> None:
    model, found = Hidden(), []
    for length in (1.0, 2.0, 1.0):
        LENGTHS.append(length)
        found.append(run(model))
    assert_same_bits(found[2], found[0])
    expected = run(pendulum(2.0))
    np.testing.assert_array_equal(found[1].values, expected.values)
    assert not np.array_equal(found[1].values, found[0].values)


def test_a_mechanism_that_is_changed_is_compiled_again() -> None:
    mechanism = pendulum()
    first = run(mechanism)
    mechanism.gravity[1] = -1.62
    found = run(mechanism)
    mechanism.gravity[1] = -9.81
    again = run(mechanism)
    assert_same_bits(again, first)
    assert abs(found["angle"][-1] - first["angle"][-1]) > 1e-2


def test_a_mechanism_has_its_own_compiled_mechanism(compiled: list[Mechanism]) -> None:
    first, second = pendulum(), pendulum()
    for mechanism in (first, second) * 3:
        run(mechanism)
    assert {id(mechanism) for mechanism in compiled} == {id(first), id(second)}


def test_a_mechanism_with_a_function_is_compiled_again(compiled: list[Mechanism]) -> None:
    m = Mechanism()
    bar = m.body("bar", m.ground, Revolute(), **rod(mass=1.0, length=1.0))
    m.force("motor", JointForce(magnitude=lambda t: 2.0 * t), bar)
    m.output("angle", bar.angle())
    assert_same_bits(run(m), run(m))
    assert kept_starts.fingerprint_of(m) is None
    assert len(compiled) == 2


def test_fingerprints_are_of_contents() -> None:
    fingerprint = kept_starts.fingerprint_of
    assert fingerprint(pendulum()) == fingerprint(pendulum()) is not None
    assert fingerprint(pendulum(1.0 + 2.0**-52)) != fingerprint(pendulum())


def test_a_mechanism_with_a_type_of_a_user_is_compiled_again(compiled: list[Mechanism]) -> None:
    """Its methods may use anything, here a global number."""

    class Drive(Harmonic):
        def fill(self, record: Any, site: Any) -> None:
            super().fill(record, site)
            record["amplitude"] = LENGTHS[-1]

    LENGTHS.append(0.1)
    m = pendulum_driven(Drive(amplitude=0.1, frequency=1.0))
    first = run(m)
    LENGTHS.append(0.2)
    np.testing.assert_allclose(run(m)["angle"], 2.0 * first["angle"], rtol=1e-12)
    assert kept_starts.fingerprint_of(m) is None
    assert len(compiled) == 2


def pendulum_driven(drive: Harmonic) -> Mechanism:
    """Return a driven rod."""
    m = Mechanism()
    bar = m.body("bar", m.ground, Revolute(drive=drive), **rod(mass=1.0, length=1.0))
    m.output("angle", bar.angle())
    return m


def test_a_simulation_that_is_shown_stays_usable() -> None:
    shown: list[Simulation] = []
    run(Hidden(), watch=shown.append)
    run(Hidden())
    run(Hidden())
    simulation, untouched = shown[-1], Simulation(Hidden(), shown[-1].settings)
    for held in (simulation, untouched):
        held.advance(0.6)
    assert simulation.outputs()[0] == pytest.approx(untouched.outputs()[0], abs=1e-5)


def test_warnings_are_those_of_the_first_run() -> None:
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    crank = m.body("crank", m.ground, Revolute(start=1.0), **rod(mass=1.0, length=0.3))
    coupler = m.body("coupler", crank, Revolute(at=(0.3, 0, 0), start=-0.9), **rod(mass=1.0, length=0.8))
    rocker = m.body("rocker", m.ground, Revolute(at=(0.7, 0, 0), start=1.2), **rod(mass=1.0, length=0.5))
    m.cut("pin", RevoluteCutJoint(at_a=(0.8, 0, 0), at_b=(0.5, 0, 0)), coupler, rocker)
    m.output("angle", crank.angle())
    results = [run(m) for _ in range(3)]
    assert any(d.code == "changed-start" for d in results[0].diagnostics)
    for result in results[1:]:
        assert_same_bits(result, results[0])


def test_few_starts_are_kept() -> None:
    for k in range(2 * kept_starts.MAX_KEPT_STARTS):
        LENGTHS.append(1.0 + k)
        run(Hidden())
    assert len(kept_starts._kept) == kept_starts.MAX_KEPT_STARTS

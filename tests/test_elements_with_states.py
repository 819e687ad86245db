"""User-defined elements with first-order states: their motion, their energy and its bound, and their identities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism, FirstOrderState, Load, Mechanism, kernel
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.testing import check_element


@kernel
def creep(element: Any, t: float, arrays: Any, state: Any) -> None:
    force, speed = state.v[element.first], state.v[element.v]
    state.Q[element.v] -= force
    state.Q[element.first] += element.stiffness * (speed - force / element.damping)
    state.Q[element.first + 1] += force * force / element.damping


@kernel
def stored(element: Any, arrays: Any, state: Any) -> Any:
    return 0.5 * state.v[element.first] ** 2 / element.stiffness


@kernel
def lost(element: Any, t: float, arrays: Any, state: Any) -> Any:
    return -(state.v[element.first] ** 2) / element.damping


@dataclass(frozen=True, kw_only=True)
class Maxwell(Load):
    """A spring and a damper in series on the coordinate of a joint; its states are the force and the heat."""

    record = np.dtype([("v", np.int64), ("first", np.int64), ("stiffness", np.float64), ("damping", np.float64)])
    apply, potential, power = creep, stored, lost
    on_joint = True
    stiffness: float
    damping: float

    @property
    def states(self) -> tuple[FirstOrderState, ...]:
        return FirstOrderState(name="force", unit="N"), FirstOrderState(name="heat", unit="J", nominal=0.1)

    def fill(self, record: Any, site: Any) -> None:
        super().fill(record, site)
        record["v"], record["first"] = site.v, site.first_state


def slider_on_maxwell() -> Mechanism:
    m = Mechanism()
    slider = m.body("slider", m.ground, mb.Translational(axis="x", rate=1.0), mass=1.0)
    m.load("mount", Maxwell(stiffness=50.0, damping=2.0), slider)
    m.output("energy", m.energy)
    return m


def test_element_with_two_states_is_evaluated_with_its_force() -> None:
    """Energy that it stores and dissipates is in the account."""
    compiled = CompiledMechanism(slider_on_maxwell())
    assert compiled.system.coordinate_names == ("slider", "mount.force", "mount.heat")

    def rates(t: float, y: Any) -> list[float]:
        _, speed, force, _ = y
        return [speed, -force, 50.0 * (speed - force / 2.0), force * force / 2.0]

    start, accuracy = (0.0, 1.0, 0.0, 0.0), {"rtol": 1e-12, "atol": 1e-13}
    expected = solve_ivp(rates, (0.0, 1.5), start, "DOP853", **accuracy).y[:, -1]
    simulation = Simulation(slider_on_maxwell(), Settings(solver="radau", tolerance=1e-8))
    simulation.advance(1.5)
    np.testing.assert_allclose(np.concatenate((simulation.stepper.q, simulation.stepper.v)), expected, atol=1e-6)
    assert simulation.energy() == pytest.approx(0.5 * expected[1] ** 2 + 0.01 * expected[2] ** 2, abs=1e-7)
    assert simulation.stepper.energy_account[0] == pytest.approx(-expected[3], abs=1e-7)  # the work
    assert not simulation.inaccurate


@kernel
def call_energy_bound(function: Any, rtol: float, place: Any, rate: Any, data: Any, out: Any) -> None:
    function(rtol, place, rate, data, out)


def test_energy_bound_contains_the_energy_that_an_element_stores_by_its_state() -> None:
    """U = F^2 / (2 k): an error e of F changes it by (F + e / 2) e / k."""
    compiled = CompiledMechanism(slider_on_maxwell())
    q, v = compiled.assemble()
    v[:2] = 0.0, 7.0
    system, out, error = compiled.system, np.zeros(2), np.array([0.0, 0.3, 0.0])
    system.fill(0.0, q, v, system.allocate_terms())
    for relative, e in ((0.0, 0.3), (0.1, 1.0)):
        call_energy_bound(system.evaluate_energy_bound, relative, np.zeros(3), error, system.pinned_data, out)
        assert out[0] == pytest.approx((7.0 + 0.5 * e) * e / 50.0, rel=1e-12)


def test_element_with_states_is_checked_by_its_identities() -> None:
    assert check_element(Maxwell(stiffness=50.0, damping=2.0), bodies=1, states=3).passed
